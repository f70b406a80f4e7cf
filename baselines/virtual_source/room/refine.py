"""Changes a learned room until what is traced in it is nearest to the training rows of its run.

Learning knows planes to parts of a millimetre, but edges to a cell, and of furniture only the sides that mirror. So
faces are tried without, of other materials, with other edges, and as the fronts of boxes of some depth. Then boxes are
put where something hides paths, and their faces moved. What raises the mean SSIM of some training rows is kept. Last,
all parts are moved to where the lengths of paths agree. No tested row is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset

from ..search.cross_terms import IsOver, LagAverages, never
from ..search.planes import Points
from ..stored import StoredFindings
from .boxes import GAP_M, WAYS_M, Box, BoxFrame, Change, Faces, Ways, box_slabs, holds_any
from .changes import (
    MIN_CHANGE,
    NEARLY,
    OTHERWISE,
    Room,
    Trial,
    as_one,
    trials_of_face,
    trials_of_slabs,
    with_patches,
    with_wall_at,
    without_patches,
)
from .lengths import ReflectedPaths, RoomPart, around, moved, moves_with, peaks, settled, sharpened
from .obstacles import MOST_OBSTACLES, obstacles
from .surfaces import (
    NO_PLANE,
    NamedSlab,
    RoomSurface,
    SlabNames,
    Surfaces,
    is_clear,
    learned_surfaces,
    likely_slabs,
    standing,
    surface_from_json,
    surface_json,
)
from .traced import NUM_CARRIERS, MapCount, RoomScore, best_rooms, mean_scores

_NUM_NEAR_TX = 16  # those that a box matters to most
_FACES_M = around(0.002, 0.25)  # by which faces are moved, as the lengths of paths tell
_AT_WALL_M = 1e-3  # a box that ends so far behind a wall ends there
_MOST_PLACES = 2  # of a face that are tried
_LEAST_GAIN = 0.01  # maps, by which rows have to be nearer with a face elsewhere


@dataclass(frozen=True, eq=False)
class BoxFit:
    """What boxes are fitted to: training rows at the lowest carriers, of the transmitters that each matters most to.

    Nothing is at `standing_m`.
    """

    at_lowest: RoomScore
    frame: BoxFrame
    standing_m: Points

    def fitted(
        self,
        others: Room,
        own: RoomSurface,
        all_ways_m: Sequence[Ways],
        slabs: Sequence[NamedSlab],
        is_over: IsOver,
        held: Faces | None = None,
        *,
        is_new: bool,
    ) -> RoomSurface | None:
        """A box beside other surfaces with the best slab, and faces moved but `held`; None if it is new and no gain."""
        array_m = np.array(self.at_lowest.samples.header.receiver.position_m)
        for nth, ways_m in enumerate(all_ways_m):
            near, best = self.at_lowest.roughly(others, [*others, own], _NUM_NEAR_TX), -np.inf
            agreeing = partial(self._where_lengths_agree, others, near.samples, held)
            of_slabs, *changes = self.frame.changes(self.frame.box_of(own), slabs, array_m, ways_m, held)
            steps: list[Change] = [agreeing, *changes, agreeing]
            if not nth:  # in the end slabs were changed
                steps.insert(0, partial(self._forms, agreeing, slabs) if is_new else of_slabs)
            for change in steps:
                candidates = [own, *(form for form in change(own) if self._fits(form))]
                scores = mean_scores([near], [[*others, form] for form in candidates], is_over)
                if scores.max() > best:
                    own, best = candidates[int(scores.argmax())], float(scores.max())
            if is_over() or (is_new and self.at_lowest([*others, own]) < self.at_lowest(others)):
                return None
        return own

    def _forms(self, agreeing: Change, slabs: Sequence[NamedSlab], own: RoomSurface) -> Iterator[RoomSurface]:
        """A box of every slab, as it is, as a board (not of metal), on the floor; there, and where lengths agree."""
        of_boards = [slab for slab in slabs if slab.material != "metal"]
        boards = [(form, of_boards) for form in self.frame.as_board((0.0,), own)]
        for form, among in [(own, slabs), *boards, *((other, slabs) for other in self.frame.to_floor(own))]:
            for placed in [form, *agreeing(form)]:
                yield from (replace(placed, slab=slab) for slab in among)

    def _where_lengths_agree(
        self, others: Room, rows: PasDataset, held: Faces | None, own: RoomSurface
    ) -> Iterator[RoomSurface]:
        """A box with one of its faces, or all of a thin one, where the lengths of the paths that it reflects agree."""
        paths = ReflectedPaths.of([*others, own], rows, LagAverages(rows, never))
        for part in paths.strongest_first:
            if part.kind in ("wall", "tilt") or part.number != own.number:
                continue
            likeness = paths.likeness(part, _FACES_M, np.arange(len(paths.carrier_hz)))
            for by_m, value in peaks(_FACES_M, likeness)[:_MOST_PLACES]:
                box = moved([own], part, by_m)[0]
                is_held = held is None or bool(
                    np.allclose(self.frame.box_of(own)[held], self.frame.box_of(box)[held], rtol=0)
                )
                if value > likeness[0] + _LEAST_GAIN and box.depth_m > 0 and is_held:
                    yield box

    def _fits(self, box: RoomSurface) -> bool:
        """Whether a box stands within the walls, where nothing else does."""
        place, (low_m, high_m) = self.frame.box_of(box), self.frame.bounds
        is_within = bool((place > low_m - _AT_WALL_M).all() and (place < high_m + _AT_WALL_M).all())
        return is_within and not holds_any(place, self.frame.along(self.standing_m)) and is_clear(box, self.standing_m)


_MIN_GAIN = 1e-3  # of the mean SSIM, that a new box has to bring
_SAME = 1e-6  # of the mean SSIM: a smaller difference is rounding
_LISTED = 5  # changes that are compared on all rows, of those that are best on a few
_WITH_MORE = 10  # changes that are tried together with further ones, on a few rows too
_BEHIND_M = 0.3  # depth at first of a box that is put behind a face
_BESIDE_M = 0.3  # from a box, where a face is found that is one of its own, or its echo


@dataclass(eq=False)
class Refinement:
    """A room that is changed in steps, until what is traced in it is nearest to some training rows.

    Faces are changed in turn, the largest first, and then the slabs of walls. A step tries changes of one kind of one
    face, and keeps the best of them, again and again, while they raise the mean SSIM. Then boxes are put behind faces
    that have none. One step more looks for boxes that hide paths; each of these is fitted twice, faces are changed
    again, and all parts are settled. `room` is the room after the first `done` steps.
    """

    found: Surfaces
    known: Mapping[tuple[int, int], Sequence[NamedSlab]]  # slabs that one of a plane in findings may be
    train: PasDataset
    room: Room
    done: int = 0
    boxes: list[Box] | None = None  # where something hides paths; None before they are sought
    count: MapCount = field(default_factory=MapCount)

    def __post_init__(self) -> None:
        self._standing_m, self._frame = _standing(self.train), BoxFrame.of(self.found)
        self._lags = LagAverages(self.train, never)
        self._slabs = box_slabs(SlabNames(np.unique(self.train.carrier_hz).tolist()).materials)

    @classmethod
    def of(cls, findings: StoredFindings, train: PasDataset) -> Refinement | None:
        """The refinement of findings before the first step; None where they hold no surfaces."""
        carriers = np.unique(train.carrier_hz)
        found = learned_surfaces(findings, carriers.tolist(), _standing(train))
        if not found:
            return None
        names = SlabNames(carriers.tolist())
        slabs = dict.fromkeys((surface.plane, surface.found_slab) for surface in found)
        known = {key: likely_slabs(names.nearest(findings.planes[key[0]].slabs[key[1]])) for key in slabs}
        return cls(found, known, train, found)

    def take(self, room: Room) -> None:
        """Take a room that was refined before; no step remains then."""
        self.room, self.boxes = room, []
        self.done = self.num_steps

    def again(self) -> Refinement | None:
        """Another round from the search for boxes on, in the room as it is now; None where this one changed nothing."""
        stored = self.as_json()
        if stored["room"] == stored["found"]:
            return None
        another = Refinement(self.room, self.known, self.train, self.room, count=self.count)
        another.done = len(another.steps)
        return another

    @cached_property
    def score(self) -> RoomScore:
        """How near a room is to training rows."""
        return RoomScore.of(self.train, self.count)

    @cached_property
    def _at_lowest(self) -> RoomScore:
        return RoomScore.of(self.train, self.count, at_lowest=True)

    @property
    def _judges(self) -> list[RoomScore]:
        """Their mean says which room is nearer: one compares the lowest carriers, one those in the middle."""
        return [self._at_lowest, self.score]

    @cached_property
    def steps(self) -> list[Callable[[IsOver], None]]:
        """Steps before boxes are sought: place walls, join and change faces, the largest first, and make them boxes."""
        of_faces = [self._trials_of(own) for own in self._fronts]
        of_planes = dict.fromkeys(own.plane for own in self._fronts)
        whole = [Trial(partial(as_one, plane), at_lowest=True, least=0.0) for plane in of_planes]
        first = [trial for own in of_faces for trial in own]
        again = [trial for own in of_faces[:1] for trial in own[1:3]]
        plain = [Trial(partial(without_patches, plane), at_lowest=True, least=0.0) for plane in self._walls]
        of_walls = trials_of_slabs(self.known, NEARLY)
        as_boxes = [partial(self._fit_behind, own.number) for own in self._fronts]
        changed = [partial(self._change, trial) for trial in [*whole, *plain, *first, *again, *of_walls]]
        return [self._place_walls, self._sharpen, *changed, *as_boxes]

    @cached_property
    def last_steps(self) -> list[Callable[[IsOver], None]]:
        """The steps after boxes are in their places: edges, depths and thicknesses of faces again, and walls."""
        trials = [self._trials_of(own) for own in self._fronts]
        again = [partial(self._fit_again, own.number) for own in self._fronts]
        changed = [trial for edges, _, *rest, _ in trials for trial in (edges, *rest)]
        slabs = trials_of_slabs(self.known, OTHERWISE, at_lowest=True)
        patches = [Trial(partial(with_patches, plane), at_lowest=True) for plane in self._walls]
        return [*again, *(partial(self._change, trial) for trial in [*slabs, *patches, *changed])]

    def _numbered(self, number: int) -> RoomSurface | None:
        return next((surface for surface in self.room if surface.number == number), None)

    @property
    def _fronts(self) -> list[RoomSurface]:
        return sorted((surface for surface in self.found if not surface.is_wall), key=lambda surface: -surface.area_m2)

    @property
    def _walls(self) -> list[int]:
        """The planes that bound the room."""
        return list(dict.fromkeys(surface.plane for surface in self.found if surface.is_wall))

    def _trials_of(self, own: RoomSurface) -> list[Trial]:
        return trials_of_face(own, self.known.get((own.plane, own.found_slab), [own.slab]), self._slabs)

    @property
    def num_steps(self) -> int:
        """Number of all steps; before boxes are sought, the largest possible number of boxes is assumed."""
        num_boxes = MOST_OBSTACLES if self.boxes is None else len(self.boxes)
        return len(self.steps) + 1 + len(WAYS_M) * num_boxes + len(self.last_steps) + 1

    @property
    def is_over(self) -> bool:
        """Whether all steps are done."""
        return self.done == self.num_steps

    def step(self, is_over: IsOver = never) -> None:
        """Do the next step; if the time is over before its end, only a part of it."""
        later = self.done - len(self.steps)
        left = self.num_steps - self.done
        if later < 0:
            self.steps[self.done](is_over)
        elif self.boxes is None:
            self.boxes = obstacles(self.room, self.train, self._standing_m, is_over)
        elif left == 1:
            self.settle(is_over)
            return
        elif left <= len(self.last_steps) + 1:
            self.last_steps[1 - left](is_over)
        else:
            turn, nth = divmod(later - 1, len(self.boxes))
            self._fit_obstacle(nth, self.boxes[nth], turn, is_over)
        self.done += 1

    def settle(self, is_over: IsOver = never) -> None:
        """Do the last step, and skip all others that remain: move parts to where the lengths of paths agree.

        A part stays where it is if the room is not nearer to the training rows with the part moved.
        """
        self.done = self.num_steps
        room = settled(self.room, self.train, self._lags, self._standing_m, is_over)
        near = [judge.near(room) for judge in self._judges]
        best = mean_scores(near, [room])[0]
        has_moved = [moves_with(new) for old, new in zip(self.room, room, strict=True) if new is not old]
        for part in dict.fromkeys(has_moved):
            if is_over():
                break
            pairs = zip(self.room, room, strict=True)
            back = [old if moves_with(old) == part else new for old, new in pairs]
            if (score := mean_scores(near, [back])[0]) >= best:
                room, best = back, score
        before, after = mean_scores(self._judges, [self.room, room])
        if after > before:
            self.room = room

    def _place_walls(self, is_over: IsOver) -> None:
        """Move walls by up to half a metre: far walls that few paths reflect at may be found some wavelengths off."""
        carriers = np.unique(self.train.carrier_hz)[:NUM_CARRIERS]
        paths = ReflectedPaths.of(self.room, self.train, self._lags, carriers)
        walls = {wall.plane: wall for wall in self.room if wall.is_wall}
        for plane, own in walls.items():
            part = RoomPart("wall", plane)
            if is_over() or part not in paths.reflected:
                continue
            places_m = paths.elsewhere(part, np.arange(len(carriers)))
            of_others = [wall.slab for wall in walls.values() if wall is not own]
            slabs = {slab.material: slab for slab in [*self._slabs[:1], *of_others, own.slab]}
            if places_m:
                changes = partial(with_wall_at, plane, places_m[:_LISTED], list(slabs.values()))
                self._change(Trial(changes, at_lowest=True, repeats=1), is_over)

    def _sharpen(self, is_over: IsOver) -> None:
        """Move all parts a little, if the room is nearer to the training rows then."""
        room = sharpened(self.room, self.train, self._lags, self._standing_m)
        if not is_over() and self._is_nearer(room, self._judges):
            self.room = room

    def _change(self, trial: Trial, is_over: IsOver) -> None:
        """Keep the best of the changes of one kind, if it is good enough, and repeat that."""
        judges = self._judges if trial.at_lowest else [self.score]
        for _ in range(trial.repeats):
            candidates = [room for room in trial.changes(self.room) if self._stands(room)]
            if len(candidates) > _LISTED:
                few = judges[0].roughly(candidates[0], self.room)
                if trial.besides:
                    best = best_rooms(candidates, few, _WITH_MORE, is_over)
                    more = [other for room in best for other in trial.besides(room) if self._stands(other)]
                    candidates = [*best, *more]
                candidates = best_rooms(candidates, few, _LISTED, is_over)
            scores = mean_scores([judge.near(self.room) for judge in judges], candidates, is_over)
            if not len(scores) or is_over():
                break
            changed = candidates[int(scores.argmax())]
            asked = [judges] if trial.at_lowest else [judges, self._judges]
            if not all(self._is_nearer(changed, some, trial.least) for some in asked):
                break
            self.room = changed

    def _is_nearer(self, room: Room, judges: Sequence[RoomScore], least: float = MIN_CHANGE) -> bool:
        """Whether a changed room is nearer to the training rows, by at least `least`."""
        before, after = mean_scores(judges, [self.room, room])
        return bool(after >= before + least)

    def _fit_behind(self, number: int, is_over: IsOver) -> None:
        """Make a face that stands along the walls the front of a box, and change all of the box but that face."""
        own = self._numbered(number)
        frame = self._frame
        if own is not None and (held := frame.face_of(own)):
            box = frame.box_of(own if own.depth_m else own.with_depth(_BEHIND_M, frame.walls))
            self._fit(frame.surface(box, number, own.slab), WAYS_M, is_over, [own.slab], held)

    def _fit_again(self, number: int, is_over: IsOver) -> None:
        """Change the box that was put behind a face, if it has one."""
        own = self._numbered(number)
        if own is not None and own.depth_m and own.plane == NO_PLANE:
            self._fit(own, WAYS_M[1:], is_over, [own.slab])

    def _fit_obstacle(self, nth: int, box: Box, turn: int, is_over: IsOver) -> None:
        """Put a box into the room, or change the one that is there."""
        number = 1 + nth + max(surface.number for surface in self.found)
        own = self._numbered(number)
        if own is not None:
            self._fit(own, WAYS_M[turn:], is_over, self._slabs)
        elif not turn:  # later, the box has been tried and dropped
            new = self._frame.surface(box, number, self._slabs[0])
            self._fit(new, WAYS_M, is_over, self._slabs)
            self._join(number, is_over)
            (low_m, high_m), faces = box[:, :2], []
            for face in self.room:  # seen from above, what was found of the furniture itself, or its echo
                middle_m = self._frame.box_of(face).mean(axis=0)[:2]
                is_there = (middle_m > low_m - _BESIDE_M) & (middle_m < high_m + _BESIDE_M)
                if face.plane != NO_PLANE and not face.is_wall and is_there.all():
                    faces.append(face)
            if faces:
                own = self._numbered(number) or new
                self._fit(own, WAYS_M, is_over, self._slabs, instead_of=faces)

    def _join(self, number: int, is_over: IsOver) -> None:
        """Try a box and every other one that it overlaps as a single box, since two objects are never in one place."""
        for other in [surface for surface in self.room if not surface.is_wall and surface.number != number]:
            own = self._numbered(number)
            if own is None:
                return
            low_m, high_m = np.stack([self._frame.box_of(surface) for surface in (own, other)], axis=1)
            if (low_m.max(axis=0) < high_m.min(axis=0) + GAP_M).all():
                box = np.stack([low_m.min(axis=0), high_m.max(axis=0)])
                whole = self._frame.surface(box, other.number, other.slab)
                self._fit(whole, WAYS_M, is_over, [other.slab, own.slab], instead_of=[own])

    def _fit(
        self,
        own: RoomSurface,
        ways_m: Sequence[Ways],
        is_over: IsOver,
        slabs: Sequence[NamedSlab],
        held: Faces | None = None,
        instead_of: Surfaces = (),
    ) -> None:
        """Change a box, its slab and its faces except `held`; keep it if the room is nearer to the training rows."""
        replaced = {surface.number for surface in (own, *instead_of)}
        others = [surface for surface in self.room if surface.number not in replaced]
        is_new = not any(surface is own for surface in self.room)
        box = self._box_fit.fitted(others, own, ways_m, slabs, is_over, held, is_new=is_new)
        least = self._at_lowest(self.room) + (_MIN_GAIN if is_new else 0.0)
        if box is not None and self._at_lowest([*others, box]) > least - _SAME:
            self.room = [*others, box]

    @cached_property
    def _box_fit(self) -> BoxFit:
        return BoxFit(self._at_lowest, self._frame, self._standing_m)

    def as_json(self) -> dict[str, Any]:
        """What `resumed` needs besides the training rows, as values of JSON."""
        return {
            "found": [surface_json(surface) for surface in self.found],
            "known": [[*key, slabs] for key, slabs in self.known.items()],
            "room": [surface_json(surface) for surface in self.room],
            "done": self.done,
            "boxes": self.boxes and [box.tolist() for box in self.boxes],
        }

    @classmethod
    def resumed(cls, stored: Mapping[str, Any], train: PasDataset) -> Refinement:
        """The refinement that `as_json` described, to go on with the same training rows."""
        found, room = ([surface_from_json(surface) for surface in stored[name]] for name in ("found", "room"))
        known = {
            (plane, slab): [NamedSlab(*slab_json) for slab_json in slabs] for plane, slab, slabs in stored["known"]
        }
        boxes = stored.get("boxes")
        places = None if boxes is None else [np.array(box, np.float64) for box in boxes]
        return cls(found, known, train, room, stored["done"], places)

    def _stands(self, room: Room) -> bool:
        """Whether no changed surface of a room is at a place where nothing can be."""
        changed = (surface for surface in room if not any(surface is other for other in self.room))
        return all(is_clear(surface, self._standing_m) for surface in changed)


def _standing(train: PasDataset) -> Points:
    return standing(train.header.receiver, train.carrier_hz, np.unique(train.tx_position_m, axis=0))
