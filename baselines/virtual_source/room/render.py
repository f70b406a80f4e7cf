"""The room behind a learned field: reconstructed and refined during the fit, and traced for predictions."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import TypeAdapter

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import SceneError
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.mixing import WEIGHTS, Predict, mixed, similarities_by_weight
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.types import FloatArray, Maps

from ..search.cross_terms import IsOver
from ..stored import StoredFindings
from .refine import Refinement
from .surfaces import surface_from_json, surface_json
from .traced import DIFFRACTING, PREDICTING, MapCount, RoomScore, RoomTracer, evenly

_NEAR_M, _NEAR_OCTAVES = 0.6, 2.0  # standard deviations of the distance at which a validation row counts
_ANYWHERE = 0.01  # what a validation row counts for at least
_AT_ONCE = 64
# Shares of a budget after which a room is reconstructed, furniture is sought, all is settled, and weights are chosen.
# The refinement takes its part of seconds and of maps, and learning goes on beside it and after it. Of a budget in
# steps it takes nothing, and what is learned is best at the end.
FROM, FURNITURE_AT, SETTLE_AT, CHOOSE_AT = 0.25, 0.5, 0.87, 0.93
FROM_OF_STEPS, CHOOSE_AT_OF_STEPS = 0.95, 0.99
_LEAST_SECONDS = 8.0  # for both; with less, the learned field stands
_LEAST_COMPARISONS = 150  # of rooms, that a budget in maps leaves; in the quick lane's 100 no room was worth its maps
_NUM_TX, _LEAST_TX = 100, 3  # validation transmitters, at most and at least
_THIRD = 3  # one of so many transmitters validates, and is kept out of the refinement
_FILE = "room.json"
Mode = Literal["learned", "traced", "blended"]


@dataclass(frozen=True, eq=False)
class LocalWeights:
    """The SSIM of n validation rows for each of W weights of the learned maps, `WEIGHTS`."""

    position_m: Float[FloatArray, "n 3"]
    carrier_hz: Float[FloatArray, "n"]
    similar: Float[FloatArray, "W n"]

    @classmethod
    def of_all(cls, rows: PasDataset, learned: Predict, traced: Sequence[Predict]) -> list[LocalWeights]:
        """For each of several traced rooms, the comparison with the learned maps of validation rows."""
        similar = [[np.zeros((len(WEIGHTS), 0))] for _ in traced]
        for start in range(0, len(rows), _AT_ONCE):
            some = rows[start : start + _AT_ONCE]
            asked = some.tx_position_m, some.carrier_hz
            maps, truth = learned(*asked), some.pas()
            for parts, own in zip(similar, traced, strict=True):
                parts.append(similarities_by_weight(maps, own(*asked), truth))
        return [cls(rows.tx_position_m, rows.carrier_hz, np.concatenate(parts, axis=1)) for parts in similar]

    @property
    def of_mixed(self) -> float:
        """Mean SSIM of maps that are mixed by these weights, at the rows by which they are chosen."""
        chosen = np.searchsorted(WEIGHTS, self.at(self.position_m, self.carrier_hz))
        return float(self.similar[chosen, np.arange(len(chosen))].mean())

    def at(self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Float[FloatArray, "B"]:
        """The weight of the learned map for every query: the best at validation rows nearby, the largest of equals."""
        away_m = np.linalg.norm(tx_position_m[:, None] - self.position_m, axis=2)
        octaves = np.log2(carrier_hz[:, None] / self.carrier_hz)
        near = np.exp(-0.5 * ((away_m / _NEAR_M) ** 2 + (octaves / _NEAR_OCTAVES) ** 2))
        mean = (near + _ANYWHERE) @ self.similar.T[:, ::-1]
        return np.array(WEIGHTS[::-1])[mean.argmax(axis=1)]

    def as_json(self) -> dict[str, Any]:
        """All numbers, for `from_json`."""
        return {name: values.tolist() for name, values in vars(self).items()}

    @classmethod
    def from_json(cls, stored: dict[str, Sequence[Any]]) -> LocalWeights:
        """Inverse of `as_json`."""
        return cls(**{name: np.array(values, np.float64) for name, values in stored.items()})


@dataclass(eq=False)
class RoomRender:
    """A room that is reconstructed from findings, refined, and weighed against the learned field on validation rows.

    Until it is weighed, and where nothing can be reconstructed, the learned field predicts alone. No row that the
    refinement compares is of a validation transmitter.
    """

    mode: Mode
    refinement: Refinement | None = None
    tracer: RoomTracer | None = None  # of the room as it is when it is weighed
    weights: LocalWeights | None = None
    has_begun: bool = False
    count: MapCount = field(default_factory=MapCount)  # maps that the refinement compared, which a budget pays for
    _stored: dict[str, Any] = field(default_factory=dict)  # of a refinement that goes on

    def advance(
        self,
        train: PasDataset,
        budget: Budget,
        share: float,
        findings: Callable[[], Mapping[str, Any]],
        learned: Predict,
    ) -> None:
        """Do what a share of the budget calls for: make a room, refine it during its part, or choose weights."""
        is_paid = _pays(budget)
        begins, ends = (FROM, CHOOSE_AT) if is_paid else (FROM_OF_STEPS, CHOOSE_AT_OF_STEPS)
        if self.mode == "learned" or share < begins or self.tracer is not None:
            return
        try:
            if not self.has_begun:
                self.has_begun = True
                rows = _split(train)[0]
                if _affords(budget, share, rows):
                    self.refinement = Refinement.of(StoredFindings.model_validate(findings()), rows)
            elif self._stored:
                self.refinement = Refinement.resumed(self._stored, _split(train)[0])
                self._stored = {}
            if self.refinement is not None:
                self.refinement.count = self.count
                self.refinement = self._refine(self.refinement, budget, share)
                if share >= ends or (not is_paid and self.refinement.is_over):
                    self._weigh(self.refinement, train, learned)
        except SceneError:  # of a room that cannot be traced
            self.refinement = None

    def _refine(self, refinement: Refinement, budget: Budget, share: float) -> Refinement:
        """Do the next steps of a refinement, or begin another round if the budget allows; returns the current one."""
        if _pays(budget):
            if share < SETTLE_AT:
                if refinement.is_over:
                    return refinement.again() or refinement
                if share >= FURNITURE_AT:
                    refinement.done = max(refinement.done, len(refinement.steps))  # skip what precedes boxes
                refinement.step(self._timer(budget, SETTLE_AT - share))
            elif share < CHOOSE_AT and not refinement.is_over:
                refinement.settle(self._timer(budget, CHOOSE_AT - share))
            return refinement
        due = (share - FROM_OF_STEPS) / (CHOOSE_AT_OF_STEPS - FROM_OF_STEPS)
        while not refinement.is_over and refinement.done < due * refinement.num_steps:
            refinement.step()
        return refinement

    def _timer(self, budget: Budget, share: float) -> IsOver:
        """A function that says whether a share of the budget's seconds or maps has been spent since now."""
        is_late, most = budget.timer(share), self.count.maps + share * (budget.max_maps or np.inf)
        return lambda: is_late() or self.count.maps >= most

    def _weigh(self, refinement: Refinement, train: PasDataset, learned: Predict) -> None:
        """Take the room as it is now; choose weights, and whether it diffracts, on rows of validation transmitters."""
        rows, room = _split(train)[1], refinement.room
        self.refinement = None
        if len(np.unique(rows.tx_index)) < _LEAST_TX:
            if self.mode == "traced":
                self.tracer = RoomTracer.of_each_kind(train, room)[0]
            return
        tracers = RoomTracer.of_each_kind(train, room)
        compared = LocalWeights.of_all(rows, learned, [tracer.maps for tracer in tracers])
        is_blended = self.mode == "blended"
        scores = [weights.of_mixed if is_blended else float(weights.similar[0].mean()) for weights in compared]
        best = int(np.argmax(scores))
        self.tracer = tracers[best]
        self.weights = compared[best] if is_blended else None

    def findings(self) -> dict[str, Any]:
        """The surfaces of the room that is traced, as JSON holds them; empty where none is."""
        return {"room": [surface_json(surface) for surface in self.tracer.room]} if self.tracer else {}

    def maps(self, learned: Maps, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Maps:
        """Learned maps of some queries, mixed with traced ones; where no path arrives they stay as they are."""
        if self.tracer is None or not len(learned):
            return learned
        weight = np.zeros(len(learned))
        if self.weights is not None:
            weight = self.weights.at(tx_position_m, carrier_hz)
        chosen = np.flatnonzero(weight < 1)
        if not len(chosen):
            return learned
        traced = self.tracer.maps(tx_position_m[chosen], carrier_hz[chosen])
        is_heard = np.isfinite(traced).all(axis=(1, 2)) & (traced.max(axis=(1, 2)) > 0)
        chosen, traced = chosen[is_heard], traced[is_heard]
        result = learned.copy()
        result[chosen] = mixed(weight[chosen].astype(np.float32), learned[chosen], traced)
        return result

    def save(self, directory: Path) -> None:
        """Store all of it in a folder, once there is anything to store."""
        if not self.has_begun:
            return
        receiver = TypeAdapter(ReceiverArray)
        tracer = self.tracer and {
            "receiver": receiver.dump_python(self.tracer.receiver, mode="json"),
            "room": [surface_json(surface) for surface in self.tracer.room],
            "diffracts": self.tracer.settings == DIFFRACTING,
        }
        stored = {
            "refinement": self._stored or (self.refinement and self.refinement.as_json()),
            "tracer": tracer,
            "weights": self.weights and self.weights.as_json(),
            "compared_maps": self.count.maps,
        }
        (directory / _FILE).write_text(json.dumps(stored), encoding="utf-8")

    @classmethod
    def load(cls, mode: Mode, directory: Path, beam: BartlettBeam, kind: PasKind) -> RoomRender:
        """What `save` stored in a folder, for maps of a kind."""
        if not (directory / _FILE).is_file():
            return cls(mode)
        stored = json.loads((directory / _FILE).read_text(encoding="utf-8"))
        count = MapCount(stored.get("compared_maps", 0))
        render = cls(mode, has_begun=True, count=count, _stored=stored["refinement"] or {})
        if traced := stored["tracer"]:
            receiver = TypeAdapter(ReceiverArray).validate_python(traced["receiver"])
            room = [surface_from_json(surface) for surface in traced["room"]]
            settings = DIFFRACTING if traced.get("diffracts") else PREDICTING
            render.tracer = RoomTracer(receiver, room, beam, kind, settings)
        if stored["weights"]:
            render.weights = LocalWeights.from_json(stored["weights"])
        return render


def _pays(budget: Budget) -> bool:
    """Whether a refinement spends the budget."""
    return budget.max_seconds is not None or budget.max_maps is not None


def _affords(budget: Budget, share: float, rows: PasDataset) -> bool:
    """Whether what is left of a budget allows to refine a room, which is compared with these rows."""
    maps = sum(len(RoomScore.of(rows, MapCount(), at_lowest=is_lowest).samples) for is_lowest in (False, True))
    limits = (budget.max_seconds, _LEAST_SECONDS), (budget.max_maps, _LEAST_COMPARISONS * maps)
    return all(most is None or (1 - share) * most > least for most, least in limits)


def _split(train: PasDataset) -> tuple[PasDataset, PasDataset]:
    """Training rows with a path: those without validation transmitters (at most every third), and their rows."""
    tx = np.unique(train.tx_index[train.has_path])
    of_third = tx[_THIRD // 2 :: _THIRD]
    is_validating = np.isin(train.tx_index, evenly(of_third, _NUM_TX) if len(of_third) else of_third)
    left, validating = (train.has_path & chosen for chosen in (~is_validating, is_validating))
    return train[np.flatnonzero(left)], train[np.flatnonzero(validating)]
