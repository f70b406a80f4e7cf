"""Changes a learned room until what is traced in it is nearest to the training rows of its run.

Learning knows planes to parts of a millimetre, but edges to a cell, and of furniture only the sides that mirror. So
faces are tried without, of other materials, with other edges, and as the fronts of boxes of some depth. What raises
the mean SSIM of some training rows is kept. No tested row is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.protocols import find_split
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.report.findings.materials import NamedSlab, SlabNames
from xfreqbench.report.findings.room import RoomSurface, channels_in, is_clear, standing
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, ProgressCallback, ignore_progress

NUM_TX, NUM_CARRIERS = 40, 4  # of the training rows that are compared
_MAX_DEPTH, _RAYS = 4, 20_000  # of the tracing for comparison, at most those of the data
_STRIDE = 2  # of the rows and columns of maps that are compared
_MIN_GAIN = 1e-3  # of the mean SSIM, for which a room is changed
_REPEATS = 4  # most changes of one kind of one face, one after another
_EDGES_M = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)
_MIN_WIDTH_M = 0.1
_TO_WALL_M = 1.0  # an edge that is so near may reach the wall
_DEPTHS_M = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6)
_FINER_M = (-0.04, -0.02, -0.01, -0.005, -0.002, -0.001, 0.001, 0.002, 0.005, 0.01, 0.02, 0.04)
_THINNER = (1.0, 0.9, 0.8, 0.5)  # of sheets in front and behind that were learned as one
_THICKNESSES = (0.5, 0.7, 0.96, 0.98, 0.99, 1.01, 1.02, 1.04, 1.4, 2.0, 2.8)
_THICK_M = 0.05  # with more, all carriers tell of the front alone
_BACK_M = 0.15  # a plane that is found so little behind a face may be what is seen of its back
_WORSE = 0.05  # by which a slab may be farther from what was learned than the nearest one

Room = list[RoomSurface]


@dataclass(frozen=True, eq=False)
class RoomScore:
    """How near what is traced in a room is to some training rows, of some transmitters at some carriers."""

    samples: PasDataset

    @classmethod
    def of(cls, compared: ComparedFindings) -> RoomScore:
        """Training rows of the record's run: all pairs of some transmitters and carriers, evenly drawn."""
        dataset, job = compared.dataset, compared.record.job
        train = dataset.subset(find_split(dataset, job.protocol, job.split).train)
        carriers = np.unique(train.carrier_hz)
        chosen_hz = carriers[
            np.unique(np.linspace(0, len(carriers) - 1, NUM_CARRIERS + 2)[1:-1].round().astype(int))
        ]
        tx = np.unique(train.tx_index)
        chosen_tx = tx[np.unique(np.linspace(0, len(tx) - 1, NUM_TX).round().astype(int))]
        is_chosen = np.isin(train.carrier_hz, chosen_hz) & np.isin(train.tx_index, chosen_tx)
        return cls(train.subset(np.flatnonzero(is_chosen & train.has_path)))

    @cached_property
    def _truth(self) -> NDArray[np.float32]:
        return self.samples.pas()[:, ::_STRIDE, ::_STRIDE]

    @cached_property
    def _settings(self) -> TraceSettings:
        told = self.samples.trace_settings
        depth, rays = min(told.max_depth, _MAX_DEPTH), min(told.rays, _RAYS)
        return replace(told, solver="image", materials="extrapolate", max_depth=depth, rays=rays)

    def __call__(self, room: Sequence[RoomSurface]) -> float:
        """Mean SSIM of the maps that are traced in a room."""
        samples = self.samples
        cfr = channels_in(room, samples, self._settings)
        maps = samples.beam.maps(cfr, samples.header.pas_kind)[0][:, ::_STRIDE, ::_STRIDE]
        return float(ssim(maps, self._truth, AngularGrid.hemisphere(*maps.shape[1:])).mean())


def refined_room(
    compared: ComparedFindings, surfaces: Sequence[RoomSurface], progress: ProgressCallback = ignore_progress
) -> Room:
    """The room after all changes that raise the mean SSIM of the compared training rows.

    Faces are changed in turn, the largest first, and then the slabs of walls. `progress` is told how many of all
    are done.
    """
    score, standing_m = RoomScore.of(compared), standing(compared.dataset)
    room = list(surfaces)
    best = score(room)
    numbers = [each.number for each in sorted(room, key=lambda each: -each.area_m2) if not each.is_wall]
    slabs = list(dict.fromkeys((each.plane, each.found_slab) for each in room))
    names = SlabNames(compared.dataset.header.carrier_hz.tolist())
    known = {key: _slabs(names.nearest(compared.findings.planes[key[0]].slabs[key[1]])) for key in slabs}
    kinds: list[Callable[[Room], Iterator[Room]]] = []
    for number in numbers:
        slabs_here = known[next((each.plane, each.found_slab) for each in room if each.number == number)]
        kinds.append(partial(_with_depths, number, slabs_here))
        kinds += [partial(change, number) for change in (_deeper, _without, _with_edges)]
    kinds += [partial(_other_slabs, key, known[key]) for key in slabs]
    for done, change in enumerate(kinds, start=1):
        for _ in range(_REPEATS):
            candidates = [each for each in change(room) if _stands(each, room, standing_m)]
            scores = [score(each) for each in candidates]
            if not scores or max(scores) < best + _MIN_GAIN:
                break
            best = max(scores)
            room = candidates[scores.index(best)]
        progress(done, len(kinds))
    return room


def _stands(room: Room, before: Room, standing_m: Float[FloatArray, "N 3"]) -> bool:
    """Whether nothing stands on the surfaces that have changed."""
    return all(is_clear(each, standing_m) for each in room if not any(each is other for other in before))


def _slabs(nearest: Sequence[NamedSlab]) -> list[NamedSlab]:
    """Slabs that may be the learned one: those about as near as the nearest, and metal."""
    return [
        each for each in nearest if each.distance < nearest[0].distance + _WORSE or each.material == "metal"
    ]


def _other_slabs(key: tuple[int, int], slabs: Sequence[NamedSlab], room: Room) -> Iterator[Room]:
    """The room with another slab, or another thickness, in all parts of a plane that were found to be of one slab."""
    own = next((each.slab for each in room if (each.plane, each.found_slab) == key), None)
    if own is None:
        return
    for slab in [*slabs, *(_thinned(own, factor) for factor in _THICKNESSES)]:
        yield [replace(each, slab=slab) if (each.plane, each.found_slab) == key else each for each in room]


def _thinned(slab: NamedSlab, factor: float) -> NamedSlab:
    return slab._replace(thickness_m=slab.thickness_m * factor)


def _without(number: int, room: Room) -> Iterator[Room]:
    """The room without a face."""
    if any(each.number == number for each in room):
        yield [each for each in room if each.number != number]


def _with_edges(number: int, room: Room) -> Iterator[Room]:
    """The room with one edge of a face moved."""
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number:
            for changed in _edged(own, walls):
                yield [changed if each is own else each for each in room]


def _with_depths(number: int, slabs: Sequence[NamedSlab], room: Room) -> Iterator[Room]:
    """The room with a face as the front of a box, in place of what was found just behind it.

    Two thin sheets that were learned as one are thinner than that.
    """
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number and not own.depth_m:
            others = [each for each in room if not _is_back(each, own)]
            for slab in slabs:
                is_thin = slab.thickness_m < _THICK_M and slab.material != "metal"
                for factor in _THINNER if is_thin else (1.0,):
                    sheet = replace(own, slab=_thinned(slab, factor))
                    for depth_m in _DEPTHS_M:
                        box = sheet.with_depth(depth_m, walls)
                        yield [box if each is own else each for each in others]


def _deeper(number: int, room: Room) -> Iterator[Room]:
    """The room with a box of another depth, or of another thickness."""
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number and own.depth_m:
            changed = [
                own.with_depth(own.depth_m + by_m, walls) for by_m in _FINER_M if own.depth_m + by_m > 0
            ]
            changed += [replace(own, slab=_thinned(own.slab, factor)) for factor in _THICKNESSES]
            for box in changed:
                yield [box if each is own else each for each in room]


def _is_back(other: RoomSurface, front: RoomSurface) -> bool:
    """Whether a face is parallel to another one, and little behind it."""
    behind_m = float((other.corners_m[0] - front.corners_m[0]) @ front.normal)
    return not other.is_wall and 0 < behind_m < _BACK_M and float(other.normal @ front.normal) > 0.999


def _edged(own: RoomSurface, walls: Sequence[RoomSurface]) -> Iterator[RoomSurface]:
    """The surface with one edge moved within its plane, up to a wall at most."""
    number = len(own.corners_m)
    for edge in range(number):
        ends = [edge, (edge + 1) % number]
        along = own.corners_m[ends[1]] - own.corners_m[ends[0]]
        outward = np.cross(along, own.normal)
        outward = outward / np.linalg.norm(outward)
        if outward @ (own.corners_m[edge] - own.corners_m.mean(0)) < 0:
            outward = -outward
        room_m = _way_to_wall(own.corners_m[ends], outward, walls)
        size_m = np.ptp(own.corners_m @ outward)
        steps_m = {min(step_m, room_m) for step_m in _EDGES_M if size_m + step_m > _MIN_WIDTH_M}
        if room_m < _TO_WALL_M:
            steps_m.add(room_m)
        for step_m in sorted(steps_m - {0.0}):
            corners_m = own.corners_m.copy()
            corners_m[ends] += step_m * outward
            yield replace(own, corners_m=corners_m).with_depth(own.depth_m, walls)


def _way_to_wall(
    points_m: Float[FloatArray, "2 3"], outward: Float[FloatArray, "3"], walls: Sequence[RoomSurface]
) -> float:
    """How far points can go before one of them meets the plane of a wall; infinite without a wall there."""
    ways_m = [np.inf]
    for wall in walls:
        slope = float(wall.normal @ outward)
        if slope > 1e-3:
            ways_m += (((wall.corners_m[0] - points_m) @ wall.normal) / slope).clip(0).tolist()
    return min(ways_m)
