"""Fits one box of a learned room: its slab, its form, and where its faces are.

What a box hides tells of its edges, a step of some centimetres at a time. The lengths of the paths that it reflects
tell where its faces are, to millimetres, once it is roughly there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from xfreqbench.data.dataset import PasDataset

from ..search.cross_terms import IsOver, LagAverages, never
from ..search.planes import Points
from .boxes import BoxFrame, Change, Faces, Ways, holds_any
from .changes import Room
from .lengths import ReflectedPaths, around, moved, peaks
from .surfaces import NamedSlab, RoomSurface, is_clear
from .traced import RoomScore, mean_scores

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

    @cached_property
    def _free_m(self) -> Points:
        """Along the axes of the room, the places where nothing stands."""
        return self.frame.along(self.standing_m)

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
        """A box beside other surfaces, with the best of some slabs, and its faces moved, except the face `held`.

        None for a new box that brings no gain, or where the time is over.
        """
        array_m = np.array(self.at_lowest.samples.header.receiver.position_m)
        for nth, ways_m in enumerate(all_ways_m):
            near, best = self.at_lowest.roughly(others, [*others, own], _NUM_NEAR_TX), -np.inf
            agreeing = partial(self._where_lengths_agree, others, near.samples, held)
            of_slabs, *changes = self.frame.changes(self.frame.box_of(own), slabs, array_m, ways_m, held)
            steps: list[Change] = [agreeing, *changes, agreeing]
            if not nth:  # in the end slabs were changed
                steps.insert(0, partial(self._forms, agreeing, slabs) if is_new else of_slabs)
            for change in steps:
                candidates = [own, *(each for each in change(own) if self._fits(each))]
                scores = mean_scores([near], [[*others, each] for each in candidates], is_over)
                if scores.max() > best:
                    own, best = candidates[int(scores.argmax())], float(scores.max())
            if is_over() or (is_new and self.at_lowest([*others, own]) < self.at_lowest(others)):
                return None
        return own

    def _forms(self, agreeing: Change, slabs: Sequence[NamedSlab], own: RoomSurface) -> Iterator[RoomSurface]:
        """A box of every slab: as it is, as a board, and standing on the floor; there, and where path lengths agree.

        A board of metal is not tried here: it hides and mirrors nearly what a metal cabinet does.
        """
        of_boards = [slab for slab in slabs if slab.material != "metal"]
        boards = [(each, of_boards) for each in self.frame.as_board((0.0,), own)]
        for form, among in [(own, slabs), *boards, *((each, slabs) for each in self.frame.to_floor(own))]:
            for each in [form, *agreeing(form)]:
                yield from (replace(each, slab=slab) for slab in among)

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
        return is_within and not holds_any(place, self._free_m) and is_clear(box, self.standing_m)
