"""Traces a learned room: channels and maps, and how near the maps are to training rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Complex, Float, Int, Shaped

from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer, can_solve
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import FloatArray, IntArray, Maps, NDArray

from ..search.cross_terms import IsOver, never, spherical_waves
from .surfaces import RoomSurface, Surfaces

NUM_TX, NUM_CARRIERS = 80, 3  # of the training rows that are compared
NUM_ROUGH_TX = 12  # to find which changes deserve all of them
_MOST_TRACERS = 32  # that are kept for more predictions
COMPARING = TraceSettings(
    interactions=WITHOUT_DIFFRACTION, solver="image", materials="extrapolate", max_depth=4, rays=20_000
)
PREDICTING = replace(COMPARING, max_depth=5)  # a fifth interaction is worth .003 at 2.4 GHz
DIFFRACTING = replace(PREDICTING, interactions=("specular", "refraction", "diffraction"))
# For what changes from one room to another.
ROUGHLY, FEW = replace(COMPARING, rays=5_000), ImageSavings(max_reflections=2)
UNHIDDEN = replace(COMPARING, max_depth=3)  # paths that something may hide
_MOST_KNOWN = 8  # rooms whose maps are remembered
_STRIDE, _WINDOW = 3, 3  # of the rows and columns of maps that are compared, and of the SSIM


def tracer_in(
    room: Surfaces,
    receiver: ReceiverArray,
    carrier_hz: Sequence[float],
    settings: TraceSettings = COMPARING,
    savings: ImageSavings = ImageSavings(),
) -> ImageTracer:
    """A tracer of a room, for an array and carriers."""
    scene, geometry = Scene("learned", receiver.in_plane_xy), Geometry([surface.mesh for surface in room])
    return ImageTracer(scene, carrier_hz, settings, savings, geometry)


def channels_in(
    room: Surfaces, samples: PasDataset, settings: TraceSettings = COMPARING, savings: ImageSavings = ImageSavings()
) -> Complex[NDArray[np.complex128], "n M"]:
    """Channels (n, M) of n samples, traced in a room."""
    carriers, of_carrier = np.unique(samples.carrier_hz, return_inverse=True)
    tx, of_tx = np.unique(samples.tx_index, return_inverse=True)
    tracer = tracer_in(room, samples.header.receiver, carriers.tolist(), settings, savings)
    cfr = tracer.channel(samples.tables["tx_position_m"][tx]).cfr
    return cfr[of_tx.reshape(-1), of_carrier.reshape(-1)]


def waves_of(
    paths: Paths, rotation: Float[FloatArray, "3 3"], element: Float[FloatArray, "M 3"]
) -> Complex[NDArray[np.complex128], "P F M"]:
    """Channels of each path at the elements of an array, `element` being their places in wavelengths."""
    cycles = paths.carrier_hz[:, None] * paths.delay_s
    centre = paths.gain * np.exp(-2j * np.pi * cycles)
    source = cycles[:, :, None] * (paths.arrival @ rotation)
    pairs = zip(centre, source, strict=True)
    return np.stack([own[:, None] * spherical_waves(there, element) for own, there in pairs], axis=1)


class RoomTracer:
    """A room that is traced to an array, at whichever carriers are asked for, as maps of some kind."""

    def __init__(
        self,
        receiver: ReceiverArray,
        room: Surfaces,
        beam: BartlettBeam,
        kind: PasKind,
        settings: TraceSettings = PREDICTING,
    ) -> None:
        self.receiver, self.room, self.settings = receiver, list(room), settings
        self._beam, self._kind = beam, kind
        self._tracers: dict[float, ImageTracer] = {}

    @classmethod
    def of_each_kind(cls, train: PasDataset, room: Surfaces) -> list[RoomTracer]:
        """Tracers of a room without diffraction, and with it where the solver takes it."""
        kinds = [PREDICTING]
        if can_solve(Geometry([surface.mesh for surface in room]), DIFFRACTING):
            kinds.append(DIFFRACTING)
        header = train.header
        return [cls(header.receiver, room, train.beam, header.pas_kind, kind) for kind in kinds]

    def maps(self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Float[Maps, "B E A"]:
        """Maps of pairs of a transmitter and a carrier; zeros where no path arrives."""
        cfr = np.zeros((len(carrier_hz), self.receiver.num_elements), np.complex128)
        for carrier in np.unique(carrier_hz).tolist():
            if carrier not in self._tracers:
                if len(self._tracers) == _MOST_TRACERS:
                    self._tracers.clear()
                self._tracers[carrier] = tracer_in(self.room, self.receiver, [carrier], self.settings)
            here = np.flatnonzero(carrier_hz == carrier)
            cfr[here] = self._tracers[carrier].channel(tx_position_m[here]).cfr[:, 0]
        return self._beam.maps(cfr, self._kind)[0]


@dataclass
class MapCount:
    """How many times a map was compared with the one that is traced in a room."""

    maps: int = 0


@dataclass(frozen=True, eq=False)
class RoomScore:
    """How near what is traced in a room is to some training rows, of some transmitters at some carriers."""

    samples: PasDataset
    settings: TraceSettings = COMPARING
    savings: ImageSavings = ImageSavings()
    others: Complex[NDArray[np.complex128], "n M"] | float = 0.0  # channels of the paths that are not traced
    count: MapCount = field(default_factory=MapCount)

    @classmethod
    def of(cls, train: PasDataset, count: MapCount, *, at_lowest: bool = False) -> RoomScore:
        """All pairs of some transmitters and carriers of training rows, evenly drawn, or at the lowest carriers.

        Long waves forgive a surface whose place is known to a centimetre only.
        """
        carriers, tx = np.unique(train.carrier_hz), np.unique(train.tx_index)
        chosen_hz = carriers[:NUM_CARRIERS] if at_lowest else evenly(carriers, NUM_CARRIERS + 2)[1:-1]
        is_chosen = np.isin(train.carrier_hz, chosen_hz if len(chosen_hz) else carriers)
        is_chosen &= np.isin(train.tx_index, evenly(tx, NUM_TX))
        return cls(train[np.flatnonzero(is_chosen & train.has_path)], count=count)

    @cached_property
    def _beam(self) -> BartlettBeam:
        grid = self.samples.grid
        coarse = AngularGrid(grid.elevation_rad[::_STRIDE], grid.azimuth_rad[::_STRIDE])
        return BartlettBeam(self.samples.beam.element_position_wavelengths, coarse)

    @cached_property
    def _truth(self) -> Float[NDArray[np.float32], "n e a"]:
        return self.samples.pas()[:, ::_STRIDE, ::_STRIDE]

    @cached_property
    def _known(self) -> dict[tuple[RoomSurface, ...], Complex[NDArray[np.complex128], "n M"]]:
        """Channels in the rooms that were traced last."""
        return {}

    def __call__(self, room: Surfaces) -> float:
        """Mean SSIM of the maps that are traced in a room."""
        self.count.maps += len(self.samples)
        maps, truth = torch.as_tensor(self._maps(room)), torch.as_tensor(self._truth)
        return 1 - float(map_loss(maps, truth, 1.0, _WINDOW, _STRIDE))  # compiled, unlike `mean_ssim`

    def _maps(self, room: Surfaces) -> Float[NDArray[np.float32], "n e a"]:
        """Maps that are traced in a room."""
        return self._beam.maps(self._cfr(room) + self.others, self.samples.header.pas_kind)[0]

    def _cfr(self, room: Surfaces) -> Complex[NDArray[np.complex128], "n M"]:
        """Channels that are traced in a room; those of the last few rooms are remembered."""
        key = tuple(room)
        if key not in self._known:
            if len(self._known) == _MOST_KNOWN:
                del self._known[next(iter(self._known))]
            self._known[key] = channels_in(room, self.samples, self.settings, self.savings)
        return self._known[key]

    def roughly(self, room: Surfaces, other: Surfaces, num_tx: int = NUM_ROUGH_TX) -> RoomScore:
        """`near` the second room, for the transmitters whose maps differ most between the two rooms."""
        changes = np.abs(self._maps(room) - self._maps(other)).sum((1, 2))
        tx, of_tx = np.unique(self.samples.tx_index, return_inverse=True)
        most = tx[np.argsort(-np.bincount(of_tx.reshape(-1), changes), kind="stable")[:num_tx]]
        return self.near(other, np.flatnonzero(np.isin(self.samples.tx_index, most)))

    def near(self, room: Surfaces, rows: Int[IntArray, "n"] | None = None) -> RoomScore:
        """A faster score for rooms like this one, whose paths of many reflections are not traced again."""
        rows = np.arange(len(self.samples)) if rows is None else rows
        score = RoomScore(self.samples[rows], ROUGHLY, FEW, count=self.count)
        return replace(score, others=self._cfr(room)[rows] - score._cfr(room))


def best_rooms(
    rooms: Sequence[list[RoomSurface]], judge: RoomScore, number: int, is_over: IsOver
) -> list[list[RoomSurface]]:
    """The `number` rooms with the highest scores, the highest first."""
    scores = mean_scores([judge], rooms, is_over)
    return [rooms[index] for index in np.argsort(-scores, kind="stable")[:number]]


def mean_scores(
    judges: Sequence[RoomScore], rooms: Sequence[Surfaces], is_over: IsOver = never
) -> Float[FloatArray, "n"]:
    """The mean score of each room; −∞ for rooms that are not scored because the time is over."""
    return np.array([-np.inf if is_over() else np.mean([judge(room) for judge in judges]) for room in rooms])


def evenly(values: Shaped[NDArray[Any], "n"], number: int) -> Shaped[NDArray[Any], "m"]:
    """`number` of some ascending values, evenly spaced, with the first and the last; all where there are fewer."""
    return values[np.unique(np.linspace(0, len(values) - 1, number).round().astype(int))]
