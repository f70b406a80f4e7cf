"""What stands in a learned room though no plane of it was found: it hides paths that the room lets through.

A cabinet or a desk mirrors for few transmitters, but takes away what floor and walls reflect behind it. So every path
that is traced in the room is left out once. Where a map is nearer to the training row without it, something may be in
its way, and where it is farther away, nothing is. Sought are the boxes that hide most of the first and none of the
second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.tracing.paths import Paths
from xfreqbench.types import FloatArray, IntArray

from ..search.cross_terms import IsOver, LagAverages, never
from ..search.planes import Points
from .boxes import GAP_M, Box, BoxFrame, holds_any
from .obstacle_kernels import hidden_by
from .surfaces import Surfaces
from .traced import UNHIDDEN, evenly, tracer_in, waves_of

MOST_OBSTACLES = 8
_NUM_TX = 450  # whose paths are left out
_LEAST_DOUBT = 0.005  # maps; of paths with less nothing is known
_MOST_DOUBT = 1.0  # maps; no path counts for more
_A_PATH = 5e-4  # maps that a path counts for which a box hides without reason
_LEAST_SHARE = 6e-4  # of all maps, by which they are nearer with a box
_APART_M, _LEVELS_M = 0.4, (0.0, 0.5, 0.8, 1.4)  # between the places and heights at which boxes are begun
_NUM_GROWN = 8  # of the boxes that are begun, those that promise most
_GROWTH_M = (0.4, 0.2, 0.1, 0.05, 0.025)
_THINNEST_M = 0.03
# One face, or two opposite ones together, by one step in either direction.
_MOVES = [by * np.outer(sides, axis) for axis in np.eye(3) for sides in ((1, 0), (0, 1), (1, 1)) for by in (-1.0, 1.0)]


def obstacles(room: Surfaces, train: PasDataset, standing_m: Points, is_over: IsOver = never) -> list[Box]:
    """Boxes along a room's axes, roughly where furniture stands, the most certain first, as many as time allows."""
    frame = BoxFrame.of(room)
    paths = DoubtfulPaths.of(room, train, frame, is_over)
    free_m, found = frame.along(standing_m), list[Box]()
    around = frame.bounds if frame.walls else np.stack([free_m.min(axis=0), free_m.max(axis=0)])
    bounds = around + np.array([[GAP_M], [-GAP_M]])
    begun = np.array([box for box in _begun(bounds) if not holds_any(box, free_m)]).reshape(-1, 2, 3)
    while len(begun) and len(found) < MOST_OBSTACLES and not is_over():
        first = np.argsort(-paths.promise(begun), kind="stable")[:_NUM_GROWN]
        grown = [_grown(box, bounds, free_m, paths.promise) for box in begun[first]]
        promise, best = max(grown, key=lambda pair: pair[0])
        if promise < _LEAST_SHARE * paths.num_maps:
            break
        found.append(best)
        paths.explain(best)
    return found


@dataclass(eq=False)
class DoubtfulPaths:
    """P paths that are traced in a room, along axes of it, and by how many maps each is doubtful.

    Path p runs along the segments first[p]:first[p + 1], from `start_m` by `way_m`. `doubt` is how much nearer the maps
    of all carriers are to `num_maps` training rows without it: 1 for a map that agrees without it, and not with it.
    """

    first: Int[IntArray, "Q"]  # Q = P + 1
    start_m: Float[FloatArray, "S 3"]
    way_m: Float[FloatArray, "S 3"]
    doubt: Float[FloatArray, "P"]
    num_maps: int

    @classmethod
    def of(cls, room: Surfaces, train: PasDataset, frame: BoxFrame, is_over: IsOver = never) -> DoubtfulPaths:
        """The paths to the array centre from some transmitters of training rows."""
        carriers = np.unique(train.carrier_hz)
        tracer = tracer_in(room, train.header.receiver, carriers.tolist(), UNHIDDEN)
        lags = LagAverages(train, never)
        lines: list[FloatArray] = []
        doubts, num_maps = [np.zeros(0)], 0
        for tx in evenly(np.unique(train.tx_index), _NUM_TX):
            if is_over():
                break
            rows = np.flatnonzero(train.tx_index == tx)
            position_m = train.tx_position_m[rows[0]]
            paths = tracer.paths(position_m)
            doubt = _doubts(paths, lags, train, rows).clip(-_MOST_DOUBT, _MOST_DOUBT)
            chosen = np.flatnonzero(np.abs(doubt) > _LEAST_DOUBT)
            met = (line[~np.isnan(line[:, 0])] for line in paths.vertices_m[chosen])
            lines += [frame.along(np.stack([position_m, *line, train.header.receiver.position_m])) for line in met]
            doubts.append(doubt[chosen])
            num_maps += len(rows)
        first = np.cumsum([0, *(len(line) - 1 for line in lines)])
        start_m = np.concatenate([np.zeros((0, 3)), *(line[:-1] for line in lines)])
        way_m = np.concatenate([np.zeros((0, 3)), *(np.diff(line, axis=0) for line in lines)])
        return cls(first, start_m, way_m, np.concatenate(doubts), num_maps)

    def promise(self, boxes: Float[FloatArray, "B 2 3"]) -> Float[FloatArray, "B"]:
        """How many maps' worth nearer the training rows are with each box, by the paths that it hides."""
        hidden = hidden_by(np.ascontiguousarray(boxes), self.first, self.start_m, self.way_m)
        return np.array([self.doubt[paths].sum() - _A_PATH * np.count_nonzero(self.doubt[paths]) for paths in hidden])

    def explain(self, box: Box) -> None:
        """Set the doubt of the paths that a box hides to 0."""
        self.doubt[hidden_by(box[None], self.first, self.start_m, self.way_m)[0]] = 0.0


def _doubts(paths: Paths, lags: LagAverages, train: PasDataset, rows: Int[IntArray, "B"]) -> Float[FloatArray, "P"]:
    """How much nearer training rows of one transmitter are without each path, summed over them."""
    receiver, hz = train.header.receiver, train.carrier_hz[rows]
    of_carrier = np.searchsorted(paths.carrier_hz, hz)
    element = train.beam.element_position_wavelengths
    waves = waves_of(paths, receiver.rotation, element)[:, of_carrier]
    whole = waves.sum(axis=0)
    measured = lags.measured(rows)
    far = 1 - lags.likeness(measured, lags.of_channels(whole))
    without = (1 - lags.likeness(measured, lags.of_channels(whole - wave)) for wave in waves)
    return np.array([(far - similar).sum() for similar in without])


def _begun(bounds: Box) -> list[Box]:
    """Small boxes at all places between bounds, of several heights."""
    (low_m, high_m), half_m = bounds, _APART_M / 2
    places = [np.arange(low + half_m, high, _APART_M) for low, high in zip(low_m[:2], high_m[:2], strict=True)]
    tops = (*_LEVELS_M[1:], high_m[2] - low_m[2])
    boxes = [
        np.array([[x - half_m, y - half_m, low_m[2] + level], [x + half_m, y + half_m, low_m[2] + top]])
        for x in places[0]
        for y in places[1]
        for level, top in zip(_LEVELS_M, tops, strict=True)
    ]
    return [box.clip(low_m, high_m) for box in boxes]


def _grown(box: Box, bounds: Box, free_m: Points, promise: Callable[..., Float[FloatArray, "B"]]) -> tuple[float, Box]:
    """A box whose faces are moved, one or two opposite ones at a time, while it promises more; and its promise."""
    best = float(promise(box[None])[0])
    for step_m in _GROWTH_M:
        while True:
            moved = [box + by * step_m for by in _MOVES]
            around = [box_m.clip(*bounds) for box_m in moved]
            possible = [
                box_m for box_m in around if (box_m[1] - box_m[0]).min() >= _THINNEST_M and not holds_any(box_m, free_m)
            ]
            if not possible:
                break
            promised = promise(np.array(possible))
            if promised.max() <= best + 1e-6:
                break
            box, best = possible[int(promised.argmax())], float(promised.max())
    return best, box
