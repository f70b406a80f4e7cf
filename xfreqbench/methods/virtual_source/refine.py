"""Changes a learned room until what is traced in it is nearest to the training rows of its run.

Learning knows planes to parts of a millimetre, but edges to a cell, and of furniture only the sides that mirror. So
faces are tried without, of other materials, with other edges, and as the fronts of boxes of some depth. Then boxes are
put where something hides paths, and their faces moved. What raises the mean SSIM of some training rows is kept. No
tested row is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.virtual_source.boxes import (
    THICKNESSES,
    WAYS_M,
    Box,
    BoxFrame,
    Faces,
    Ways,
    box_slabs,
    holds_any,
)
from xfreqbench.methods.virtual_source.materials import NamedSlab, SlabNames
from xfreqbench.methods.virtual_source.obstacles import MOST_OBSTACLES, obstacles
from xfreqbench.methods.virtual_source.search.cross_terms import IsOver, never
from xfreqbench.methods.virtual_source.surfaces import (
    RoomSurface,
    is_clear,
    learned_surfaces,
    standing,
    surface_from_json,
    surface_json,
)
from xfreqbench.methods.virtual_source.told import StoredFindings
from xfreqbench.methods.virtual_source.traced import RoomScore
from xfreqbench.types import FloatArray

_MIN_GAIN = 1e-3  # of the mean SSIM, for which a room gets another box
_MIN_CHANGE = 3e-4  # for which one of its surfaces is changed
_LISTED = 6  # changes that are compared on all rows, of those that are best on a few
_REPEATS = 4  # most changes of one kind of one face, one after another
_EDGES_M = (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)
_MIN_WIDTH_M = 0.1
_TO_WALL_M = 1.0  # an edge that is so near may reach the wall
_DEPTHS_M = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6)
_FINER_M = (-0.04, -0.02, -0.01, -0.005, -0.002, -0.001, 0.001, 0.002, 0.005, 0.01, 0.02, 0.04)
_THINNER = (1.0, 0.9, 0.8, 0.5)  # of sheets in front and behind that were learned as one
_FIRST_WAYS_M = (WAYS_M[0], {**WAYS_M[1], "top": WAYS_M[0]["top"]})  # of a box that is new
_BEHIND_M = 0.3  # depth at first of a box that is put behind a face
_NUM_NEAR_TX = 16  # those that a box matters to most
_NEARLY = (0.96, 0.98, 0.99, 1.01, 1.02, 1.04)  # of thicknesses of walls
_THICK_M = 0.05  # with more, all carriers tell of the front alone
_BACK_M = 0.15  # a plane that is found so little behind a face may be what is seen of its back
_WORSE = 0.05  # by which a slab may be farther from what was learned than the nearest one

Room = list[RoomSurface]


class Trial(NamedTuple):
    """Changes of a room that are tried, and whether the lowest carriers judge too, to which a centimetre is little."""

    changes: Callable[[Room], Iterator[Room]]
    at_lowest: bool = False


@dataclass(eq=False)
class Refinement:
    """A room that is changed in steps, until what is traced in it is nearest to some training rows.

    Faces are changed in turn, the largest first, and then the slabs of walls. A step tries changes of one kind of one
    face, and keeps the best of them, again and again, while they raise the mean SSIM. Then boxes are put behind faces
    that have none. One step more looks for boxes that hide paths; each of these is fitted twice, and faces are changed
    again. `room` is the room after the first `done` steps.
    """

    found: Sequence[RoomSurface]
    known: Mapping[
        tuple[int, int], Sequence[NamedSlab]
    ]  # slabs that may be the one of a plane and a slab of findings
    train: PasDataset
    room: Room
    done: int = 0
    boxes: list[Box] | None = None  # where something hides paths, once it was sought

    @classmethod
    def of(cls, findings: StoredFindings, train: PasDataset) -> Refinement | None:
        """The refinement of findings before the first step; None where they hold no surfaces."""
        carriers = np.unique(train.carrier_hz)
        found = learned_surfaces(findings, carriers.tolist(), _standing(train))
        if not found:
            return None
        names = SlabNames(carriers.tolist())
        slabs = dict.fromkeys((each.plane, each.found_slab) for each in found)
        known = {key: _slabs(names.nearest(findings.planes[key[0]].slabs[key[1]])) for key in slabs}
        return cls(found, known, train, found)

    @cached_property
    def score(self) -> RoomScore:
        """How near a room is to training rows."""
        return RoomScore.of(self.train)

    @cached_property
    def _at_lowest(self) -> RoomScore:
        return RoomScore.of(self.train, at_lowest=True)

    def _at_all(self, room: Room) -> float:
        """Mean score at the lowest carriers and at others: the lowest tell places, the others materials too."""
        return (self._at_lowest(room) + self.score(room)) / 2

    @cached_property
    def _standing_m(self) -> Float[FloatArray, "N 3"]:
        return _standing(self.train)

    @cached_property
    def steps(self) -> list[Callable[[IsOver], None]]:
        """What is done until boxes are sought: faces in turn, again where the others are, walls, and faces as boxes."""
        of_faces = [self._trials_of(own) for own in self._fronts]
        first = [trial for own in of_faces for trial in own]
        again = [trial for own in of_faces for trial in own[1:3]]
        of_walls = [Trial(partial(_other_slabs, key, slabs)) for key, slabs in self.known.items()]
        as_boxes = [partial(self._fit_behind, own.number) for own in self._fronts]
        return [*(partial(self._change, trial) for trial in [*first, *again, *of_walls]), *as_boxes]

    @cached_property
    def last_steps(self) -> list[Callable[[IsOver], None]]:
        """What is done once boxes are in their places: edges, depths and thicknesses of faces again."""
        trials = [self._trials_of(own) for own in self._fronts]
        return [partial(self._change, trial) for edges, _, *rest, _ in trials for trial in (edges, *rest)]

    @property
    def _fronts(self) -> list[RoomSurface]:
        return sorted((each for each in self.found if not each.is_wall), key=lambda each: -each.area_m2)

    def _trials_of(self, own: RoomSurface) -> list[Trial]:
        known = self.known[own.plane, own.found_slab]
        others = [each for each in self._slabs if each.material not in {one.material for one in known}]
        slabs = (
            known if known[0].material == "metal" else [*known, *others]
        )  # nothing else is taken for metal
        edges, finer = (partial(_with_edges, own.number, steps_m) for steps_m in (_EDGES_M, _FINER_M))
        return [
            Trial(edges, at_lowest=True),
            Trial(partial(_with_depths, own.number, slabs), at_lowest=True),
            Trial(partial(_deeper, own.number)),
            Trial(edges),
            Trial(finer),
            Trial(partial(_without, own.number)),
        ]

    @property
    def num_steps(self) -> int:
        """Number of all steps; until boxes are sought as many of them are expected as there may be."""
        num_boxes = MOST_OBSTACLES if self.boxes is None else len(self.boxes)
        return len(self.steps) + 1 + len(WAYS_M) * num_boxes + len(self.last_steps)

    @property
    def is_over(self) -> bool:
        """Whether all steps are done."""
        return self.done == self.num_steps

    def step(self, is_over: IsOver = never) -> None:
        """Do one step more, or what of it can be done before a time is over."""
        later = self.done - len(self.steps)
        left = self.num_steps - self.done
        if later < 0:
            self.steps[self.done](is_over)
        elif self.boxes is None:
            self.boxes = obstacles(self.room, self.train, self._standing_m, is_over)
        elif left <= len(self.last_steps):
            self.last_steps[-left](is_over)
        else:
            turn, nth = divmod(later - 1, len(self.boxes))
            self._fit_obstacle(nth, self.boxes[nth], turn, is_over)
        self.done += 1

    def _change(self, trial: Trial, is_over: IsOver) -> None:
        """Keep the best changes of one kind."""
        roughly = (self._at_lowest if trial.at_lowest else self.score).roughly
        exactly = self._at_all if trial.at_lowest else self.score
        best = exactly(self.room)
        for _ in range(_REPEATS):
            candidates = [each for each in trial.changes(self.room) if self._stands(each)]
            if len(candidates) > _LISTED:
                scores = _scores(roughly(self.room, candidates[0]), candidates, is_over)
                candidates = [candidates[index] for index in np.argsort(-scores, kind="stable")[:_LISTED]]
            scores = _scores(exactly, candidates, is_over)
            if not len(scores) or scores.max() < best + _MIN_CHANGE:
                break
            best = float(scores.max())
            self.room = candidates[int(scores.argmax())]

    def _fit_behind(self, number: int, is_over: IsOver) -> None:
        """Put a box behind a face, if it has none yet and stands along the walls, and change all but that face."""
        own = next((each for each in self.room if each.number == number), None)
        frame = BoxFrame.of(self.found)
        if own is not None and not own.depth_m and (held := frame.face_of(own)):
            box = frame.box_of(own.with_depth(_BEHIND_M, frame.walls))
            self._fit(frame.surface(box, number, own.slab), _FIRST_WAYS_M, is_over, [own.slab], held)

    def _fit_obstacle(self, nth: int, box: Box, turn: int, is_over: IsOver) -> None:
        """Put a box into the room, or change that which is there."""
        number = 1 + nth + max(each.number for each in self.found)
        own = next((each for each in self.room if each.number == number), None)
        if own is not None:
            self._fit(own, WAYS_M[turn:], is_over, self._slabs)
        elif not turn:  # else it was tried in vain
            new = BoxFrame.of(self.found).surface(box, number, self._slabs[0])
            self._fit(new, _FIRST_WAYS_M, is_over, self._slabs)

    def _fit(
        self,
        own: RoomSurface,
        ways_m: Sequence[Ways],
        is_over: IsOver,
        slabs: Sequence[NamedSlab],
        held: Faces | None = None,
    ) -> None:
        """Change a box, its slab and all its faces but the one held, and keep it where the room is nearer with it.

        Rooms are compared at the lowest carriers, for the transmitters that the box matters most to.
        """
        frame = BoxFrame.of(self.found)
        array_m, standing_m = np.array(self.train.header.receiver.position_m), frame.along(self._standing_m)
        others = [each for each in self.room if each.number != own.number]
        is_new = not any(each is own for each in self.room)
        near, best = self._at_lowest.roughly(others, [*others, own], _NUM_NEAR_TX), -np.inf
        for ways in ways_m:
            for change in frame.changes(frame.box_of(own), slabs, array_m, ways, held):
                free = (each for each in change(own) if not holds_any(frame.box_of(each), standing_m))
                candidates = [own, *(each for each in free if is_clear(each, self._standing_m))]
                scores = _scores(near, [[*others, each] for each in candidates], is_over)
                if scores.max() > best:
                    own, best = candidates[int(scores.argmax())], float(scores.max())
            if is_new and best < near(others) + _MIN_GAIN:
                return
        room, least = [*others, own], self._at_lowest(self.room) + (_MIN_GAIN if is_new else 0.0)
        if not is_over() and self._at_lowest(room) > least:
            self.room = room

    @cached_property
    def _slabs(self) -> list[NamedSlab]:
        """Slabs that a box may be made of."""
        return box_slabs(SlabNames(np.unique(self.train.carrier_hz).tolist()).materials)

    def as_json(self) -> dict[str, Any]:
        """What of it does not follow from the training rows, for `resumed`."""
        return {
            "found": [surface_json(each) for each in self.found],
            "known": [[*key, slabs] for key, slabs in self.known.items()],
            "room": [surface_json(each) for each in self.room],
            "done": self.done,
            "boxes": self.boxes and [box.tolist() for box in self.boxes],
        }

    @classmethod
    def resumed(cls, stored: Mapping[str, Any], train: PasDataset) -> Refinement:
        """The refinement that `as_json` told of, to go on with the same training rows."""
        found, room = ([surface_from_json(each) for each in stored[name]] for name in ("found", "room"))
        known = {
            (plane, slab): [NamedSlab(*each) for each in slabs] for plane, slab, slabs in stored["known"]
        }
        boxes = stored.get("boxes")
        places = None if boxes is None else [np.array(box, np.float64) for box in boxes]
        return cls(found, known, train, room, stored["done"], places)

    def _stands(self, room: Room) -> bool:
        """Whether nothing stands on the surfaces that would change."""
        changed = (each for each in room if not any(each is other for other in self.room))
        return all(is_clear(each, self._standing_m) for each in changed)


def _standing(train: PasDataset) -> Float[FloatArray, "N 3"]:
    return standing(train.header.receiver, train.carrier_hz, np.unique(train.tx_position_m, axis=0))


def _scores(score: Callable[[Room], float], rooms: Sequence[Room], is_over: IsOver) -> Float[FloatArray, "n"]:
    """The score of each room; −∞ of those for which there is no time."""
    return np.array([-np.inf if is_over() else score(each) for each in rooms])


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
    for slab in [*slabs, *(own.thinned(factor) for factor in _NEARLY)]:
        yield [replace(each, slab=slab) if (each.plane, each.found_slab) == key else each for each in room]


def _without(number: int, room: Room) -> Iterator[Room]:
    """The room without a face."""
    if any(each.number == number for each in room):
        yield [each for each in room if each.number != number]


def _with_edges(number: int, steps_m: Sequence[float], room: Room) -> Iterator[Room]:
    """The room with one edge of a face moved."""
    walls = [each for each in room if each.is_wall]
    for own in room:
        if own.number == number:
            for changed in _edged(own, walls, steps_m):
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
                    sheet = replace(own, slab=slab.thinned(factor))
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
            changed += [replace(own, slab=own.slab.thinned(factor)) for factor in THICKNESSES]
            for box in changed:
                yield [box if each is own else each for each in room]


def _is_back(other: RoomSurface, front: RoomSurface) -> bool:
    """Whether a face is parallel to another one, and little behind it."""
    behind_m = float((other.corners_m[0] - front.corners_m[0]) @ front.normal)
    return not other.is_wall and 0 < behind_m < _BACK_M and float(other.normal @ front.normal) > 0.999


def _edged(
    own: RoomSurface, walls: Sequence[RoomSurface], by_m: Sequence[float] = _EDGES_M
) -> Iterator[RoomSurface]:
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
        steps_m = {min(step_m, room_m) for step_m in by_m if size_m + step_m > _MIN_WIDTH_M}
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
