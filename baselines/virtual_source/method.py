"""This project's method `virtual-source`: transmitters mirrored in planes that are found in the maps."""

from __future__ import annotations

import json
from collections.abc import Generator
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.learning.network import NetworkConfig
from xfreqbench.methods.learning.targets import GridView, Targets, of_peak
from xfreqbench.methods.learning.training import Count, LearnedMethod, Positive, Training, TrainingConfig
from xfreqbench.types import FloatArray, IntArray, NDArray

from ..xfreq_gs import XFreqGS, XFreqGSConfig
from .config import SourceConfig
from .field.field import TracedPairs, VirtualSourceField
from .room.render import RoomRender
from .search.cross_terms import Explained

_TX_AT_ONCE = 32
_LEAST_SECONDS = 12.0  # of a budget, for a search for planes and something learned after it
_INSTEAD_FILE = "instead.json"


@dataclass(frozen=True)
class VirtualSourceConfig(SourceConfig, NetworkConfig, TrainingConfig):
    """Options. A training step uses all carriers of a few transmitters, so that each one's paths serve many rows."""

    device: Annotated[Literal["cpu"], Doc("it runs on the processor")] = "cpu"
    batch_size: Annotated[Count, Doc("transmitters of a step, with all their maps")] = 8
    learning_rate: Positive = 3e-3


class VirtualSource(LearnedMethod):
    """Virtual sources: planes found in the maps mirror the transmitter, exact in phase at every carrier."""

    Config = VirtualSourceConfig
    position_kind = torch.float64

    def __init__(self, config: Any = None) -> None:
        super().__init__(config)
        self._rows: _TransmitterRows | None = None
        self._train: PasDataset | None = None
        self._budget = Budget()
        self._render = RoomRender(self.config.render)
        self._instead: XFreqGS | None = None
        self._told: dict[str, Any] = {}  # what was found of a room, where `XFreqGS` learns instead

    def field(self) -> VirtualSourceField:
        """The field without planes, before training."""
        field = VirtualSourceField(self.config, self.config)
        field.budget = self._budget
        return field

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Generator[Progress, float, None]:
        """Search for planes, then minimise Eq. 12 by Adam, with further searches on the way.

        Of a budget in seconds, each search takes a share at most, and goes on with what it has found by then. After
        a quarter of it, or of a budget in maps, a room is made of what was learned, and refined beside the training;
        near its end where the budget is in steps. A map counts each time a changed room is compared with it, too.

        Where too few planes are found, phases follow from nothing, and `XFreqGS` learns the maps instead; and where the
        budget has too few seconds for a search. Raises `MethodError` for antennas whose fields it does not know.
        """
        _require_known_antennas(train)
        self._train, self._budget = train, budget
        if self._training is not None:
            _field(self._training).budget = budget
        elif self._instead is None:
            self._begin(train, seed)
        if self._instead is not None:
            yield from self._instead.fit(train, budget, seed)
            return
        training = self._trained()
        shown = self.maps_a_step(train) * training.step + self._render.count.maps  # of a fit that goes on
        training.share = max(training.share, budget.share(training.step, 0.0, shown))
        steps = super().fit(train, budget, seed)
        with closing(steps), suppress(StopIteration):
            progress = next(steps)
            while True:
                spent = budget.share(progress.step, 0.0, progress.counts["maps"] + self._render.count.maps)
                spent = max(spent, self._trained().share, progress.step / self.config.steps)
                self._render.advance(train, budget, spent, self.findings, self._learned)
                maps = progress.counts["maps"] + self._render.count.maps
                share = yield replace(progress, counts={**progress.counts, "maps": maps})
                progress = steps.send(share)

    def _begin(self, train: PasDataset, seed: int) -> None:
        """Search for planes where the budget allows it, and decide which field learns."""
        is_long = self._budget.max_seconds is None or self._budget.max_seconds >= _LEAST_SECONDS
        if is_long or not self.field().searches:
            training = self.started(train, seed)
            field = _field(training)
            if not field.has_too_few_planes:
                self._training = training
                return
            self._told = field.room.findings(field.array_m)
        self._instead = XFreqGS(XFreqGSConfig(steps=self.config.steps))

    @property
    def num_parameters(self) -> int:
        """Number of values that training sets."""
        return self._instead.num_parameters if self._instead else super().num_parameters

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Maps with peak 1, on the grid of the training data and of their kind, as `render` says."""
        if self._instead:
            return self._instead.predict(tx_position_m, carrier_hz)
        learned = super().predict(tx_position_m, carrier_hz)
        return self._render.maps(learned, tx_position_m, carrier_hz)

    def save(self, directory: Path) -> None:
        """Store the field as `LearnedMethod` does, and the room beside it; or what learned instead."""
        if self._instead:
            stored = {"config": as_json(self.config), "told": self._told}
            (directory / _INSTEAD_FILE).write_text(json.dumps(stored), encoding="utf-8")
            self._instead.save(directory)
            return
        super().save(directory)
        self._render.save(directory)

    @classmethod
    def load(cls, directory: Path) -> VirtualSource:
        """The method as it was saved; its `fit` continues from there."""
        if (directory / _INSTEAD_FILE).is_file():
            stored = json.loads((directory / _INSTEAD_FILE).read_text(encoding="utf-8"))
            other = cls(cls.Config(**stored["config"]))
            instead = XFreqGS.load(directory)
            assert isinstance(instead, XFreqGS)
            other._instead, other._told = instead, stored["told"]
            return other
        method = super().load(directory)
        assert isinstance(method, VirtualSource)
        beams, kind = method._trained().beams, method._trained().kind
        beam = BartlettBeam(beams.element_position_wavelengths, beams.grid)
        method._render = RoomRender.load(method.config.render, directory, beam, kind)
        return method

    def maps_a_step(self, train: PasDataset) -> int:
        """Mean number of training maps of a step: all maps of some transmitters."""
        heard_tx = train.tx_index[train.has_path]
        return max(1, round(self.config.batch_size * len(heard_tx) / max(1, len(np.unique(heard_tx)))))

    def batch_loss(self, training: Training, targets: Targets) -> Tensor:
        """Eq. 12 for all rows of some transmitters, plus a small weight on the contents of the cells."""
        field, generator = _field(training), training.generator
        rows = self._rows_of(training, targets)
        chosen = torch.randint(rows.num_tx, (self.config.batch_size,), generator=generator)
        view = GridView.draw(self.config.stride, generator)
        nth, of_tx, of_carrier = rows.of(chosen)
        _, blurred_hz = targets.queries(nth, self.config.carrier_blur, generator)
        pairs = TracedPairs(rows.offset_m[chosen], rows.traces[chosen], rows.carrier_hz, of_tx, of_carrier, blurred_hz)
        power = of_peak(field.power_of(pairs, view, training.beams))
        loss = self.loss_of(power, targets.maps(nth, view), training)
        return loss + self.config.sparsity * field.room.clutter()

    def findings(self) -> dict[str, Any]:
        """Planes with materials and uncertainties, and images, as `LearnedRoom.findings` describes them.

        With them are the surfaces of the room that is traced for predictions, once it is weighed.
        Where `XFreqGS` learns instead, they are the few planes found, and its own findings.
        """
        if self._instead:
            return {**self._told, **self._instead.findings()}
        field = _field(self._trained())
        return {**field.room.findings(field.array_m), **self._render.findings()}

    def _rows_of(self, training: Training, targets: Targets) -> _TransmitterRows:
        """The training rows with traced paths, after another search for planes where it is time for one."""
        field = _field(training)
        rows = self._rows
        if rows is None or rows.targets is not targets or rows.sequence is not field.room.sequence:
            self._rows = rows = _TransmitterRows(field, targets)
        if field.is_time_to_look(training.step, training.share):
            element = torch.as_tensor(training.beams.element_position_wavelengths, dtype=torch.float32)
            assert self._train is not None, "fit has it"
            explained = rows.channels(field, element)
            field.look_again(self._train, explained, training.step, training.generator)
            training.optimizer = self.new_optimizer(field)
            self._rows = rows = _TransmitterRows(field, targets)
        return rows


def _require_known_antennas(train: PasDataset) -> None:
    """Raise `MethodError` unless both ends have one upright antenna without a side, whose field `antenna_field` is."""
    header = train.header
    pattern, polarization, turned_deg = header.receiver.antenna
    others = {name: value for name, value in header.settings.items() if name.startswith("transmitter_")}
    if pattern == "tr38901" or any(turned_deg) or others:
        antenna = f"pattern {pattern!r}, polarization {polarization!r}, turned by {list(turned_deg)} degrees"
        raise MethodError(
            "virtual-source knows antennas of pattern iso or dipole, not turned, the same at both ends, but in "
            f"{train.path.name} the receiver's are of {antenna}, and the transmitters' {others or 'are the same'}. "
            "Take another method, such as xfreq-gs."
        )


def _field(training: Training) -> VirtualSourceField:
    assert isinstance(training.field, VirtualSourceField)
    return training.field


class _TransmitterRows:
    """The training rows sorted by transmitter, with the paths of each transmitter traced once."""

    def __init__(self, field: VirtualSourceField, targets: Targets) -> None:
        self.targets, self.sequence = targets, field.room.sequence
        position_m, carrier_hz = targets.positions_and_carriers
        unique_m, of_tx = np.unique(position_m, axis=0, return_inverse=True)
        carriers, of_carrier = np.unique(carrier_hz, return_inverse=True)
        self.num_tx = len(unique_m)
        self.offset_m = field.offsets(unique_m)
        self.carrier_hz = torch.as_tensor(carriers)
        self.traces = field.room.traced(self.offset_m)
        self._places = of_tx.reshape(-1), of_carrier.reshape(-1)
        table = np.full((len(unique_m), len(carriers)), -1)
        table[of_tx.reshape(-1), of_carrier] = np.arange(len(carrier_hz))
        self._row = torch.as_tensor(table)

    def channels(self, field: VirtualSourceField, element: Float[Tensor, "M 3"]) -> Explained:
        """A function that returns the field's channels of rows of the training data: Q that do not interfere."""
        carriers, parts = self.carrier_hz, []
        with torch.no_grad():
            for some in torch.arange(self.num_tx).split(_TX_AT_ONCE):
                offset_m = self.offset_m[some]
                queries = offset_m.repeat_interleave(len(carriers), 0), carriers.repeat(len(some))
                free = field.free_channels(*queries, element).unflatten(1, (len(some), len(carriers)))
                virtual = field.channels(offset_m, self.traces[some], carriers, element)
                parts.append(torch.cat([virtual[None], free]))
        cfr = torch.cat(parts, dim=1).numpy().astype(complex)
        place = dict(zip(self.targets.rows.tolist(), zip(*self._places, strict=True), strict=True))

        def explained(rows: IntArray) -> NDArray[np.complex128]:
            tx, carrier = zip(*(place[row] for row in rows.tolist()), strict=True)
            return cfr[:, tx, carrier]

        return explained

    def of(self, chosen: Int[Tensor, "t"]) -> tuple[Int[Tensor, "B"], Int[Tensor, "B"], Int[Tensor, "B"]]:
        """For all rows of the chosen transmitters: the row, and the indices of its transmitter and its carrier."""
        rows = self._row[chosen]
        of_tx, of_carrier = (rows >= 0).nonzero(as_tuple=True)
        return rows[of_tx, of_carrier], of_tx, of_carrier
