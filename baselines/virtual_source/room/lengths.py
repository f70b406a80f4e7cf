"""Parts of a learned room moved to where the lengths of the paths that they reflect agree with training rows.

A face that moves by x along its normal n lengthens a path that comes along a and leaves along b by about
(a − b)·n x, and leaves its gain nearly as it is. So all paths are traced once, and any displacement of a part is a
turn of the phases of some of them. That is far cheaper than to trace each room, and so precise at high carriers that
parts are found to a small share of a wavelength. Carriers are taken from the lowest on, a few at a time: where long
waves put a part, shorter ones need to look at nearby places only. Each part is sought alone first, on a grid, and then
all of them are moved together, in least squares.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.optimize import least_squares

from xfreqbench.data.dataset import PasDataset
from xfreqbench.tracing.paths import SPECULAR, Paths
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from ..search.cross_terms import ComplexArray, IsOver, LagAverages, Lags, never
from ..search.planes import Points, Vector
from .boxes import MOST_BOARD_M
from .surfaces import NO_PLANE, RoomSurface, Surfaces, is_clear
from .traced import UNHIDDEN, evenly, tracer_in, waves_of

_NUM_TX = 120  # whose paths are traced
_AT_ONCE = 3  # carriers
_LOWEST = 6.0  # times the lowest carrier: up to there parts that are a centimetre off are found
_REACH_M = 0.03  # of the first search of a part, in either direction
_STEPS_PER_WAVELENGTH = 16  # of the highest carrier
_FLAT = 0.05  # metres that the paths of a part become longer when it moves by a metre, at least
_NEAR, _MOST_STEPS = 1 / 8, 3  # wavelengths, and steps, of least squares
_REACH = 1.5  # steps of the carriers before, within which a part is sought again
_HERE_M = 0.02  # a part that is so near another place is there
LEAST_GAIN = 0.05  # maps, by which training rows have to be nearer

# The vector by which a point of a part moves for each metre that the part moves.
Motion = Callable[[Vector], Vector]


class RoomPart(NamedTuple):
    """What moves along a normal: the wall of a plane, evenly or the more the farther along an axis, or a face.

    A board is the front and the back of a thin box together. `number` is that of the plane of a wall, of any other
    surface its own; `nth` is that of the axis, or of the first corner of a side.
    """

    kind: Literal["wall", "tilt", "front", "back", "board", "side"]
    number: int
    nth: int = 0


def parts_at(surface: RoomSurface, point_m: Vector) -> list[RoomPart]:
    """The parts that move the point of a surface at which a path is reflected."""
    number = surface.number
    if surface.is_wall:
        return [RoomPart("wall", surface.plane), *(RoomPart("tilt", surface.plane, nth) for nth in (0, 1))]
    if not surface.depth_m:
        return [RoomPart("front", number)]
    behind_m = float((point_m - surface.corners_m[0]) @ surface.normal)
    front, back = RoomPart("front", number), RoomPart("back", number)
    away_m = {front: abs(behind_m), back: abs(behind_m - surface.depth_m)}
    beside_m = np.einsum("nc,nc->n", point_m - surface.corners_m, surface.outward)
    away_m |= {RoomPart("side", number, side): abs(by_m) for side, by_m in enumerate(beside_m.tolist())}
    nearest = min(away_m, key=away_m.__getitem__)
    is_board = nearest.kind != "side" and surface.depth_m < MOST_BOARD_M
    return [nearest, RoomPart("board", number)] if is_board else [nearest]


def moves_with(own: RoomSurface) -> tuple[int, int]:
    """The same for all parts of a wall, which move together, and for no other surfaces."""
    return (own.plane, NO_PLANE) if own.is_wall else (NO_PLANE, own.number)


def motion_of(room: Surfaces, part: RoomPart) -> Motion:
    """How the points of a part move; those of a tilted wall by their distance from its middle along an axis."""
    own = _own(room, part)[0]
    if part.kind == "tilt":
        middle_m, axis = _axis(room, part)
        return lambda point_m: float((point_m - middle_m) @ axis) * own.normal
    direction = own.outward[part.nth] if part.kind == "side" else own.normal
    return lambda point_m: direction


def moved(room: Surfaces, part: RoomPart, by_m: float) -> list[RoomSurface]:
    """The room with a part moved along its normal, which leads away from the array or out of a box."""
    changed = list(room)
    for own in _own(room, part):
        corners_m, depth_m, normal = own.corners_m.copy(), own.depth_m, own.normal
        if part.kind == "side":
            corners_m[[part.nth, (part.nth + 1) % len(corners_m)]] += by_m * own.outward[part.nth]
        elif part.kind == "back":
            depth_m += by_m
        elif part.kind == "tilt":
            centre_m, axis = _axis(room, part)
            corners_m += by_m * ((corners_m - centre_m) @ axis)[:, None] * normal
            normal = normal - by_m * axis
            normal = normal / np.linalg.norm(normal)
        else:
            corners_m += by_m * normal
            depth_m -= by_m if part.kind == "front" and depth_m else 0.0
        changed[changed.index(own)] = replace(own, corners_m=corners_m, depth_m=depth_m, normal=normal)
    return changed


def _own(room: Surfaces, part: RoomPart) -> list[RoomSurface]:
    """The surfaces of which a part consists."""
    if part.kind in ("wall", "tilt"):
        return [surface for surface in room if surface.is_wall and surface.plane == part.number]
    return [surface for surface in room if not surface.is_wall and surface.number == part.number]


def _axis(room: Surfaces, part: RoomPart) -> tuple[Vector, Vector]:
    """The middle of a wall, and the axis in it along which it tilts."""
    own = _own(room, part)
    corners_m, normal = np.concatenate([surface.corners_m for surface in own]), own[0].normal
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    along = along / np.linalg.norm(along)
    middle_m = (corners_m.min(axis=0) + corners_m.max(axis=0)) / 2
    return middle_m, (along, np.cross(normal, along))[part.nth]


def settled(
    room: Surfaces, train: PasDataset, lags: LagAverages, standing_m: Points, is_over: IsOver = never
) -> list[RoomSurface]:
    """A room with its parts moved to where they agree best with training rows; ends early when its time is over."""
    hz, reach_m = np.unique(train.carrier_hz), _REACH_M
    best = ReflectedPaths.of(room, train, lags)
    for last in _ends(hz):
        carriers = np.arange(max(0, last - _AT_ONCE), last)
        if last <= _AT_ONCE:
            step_m = SPEED_OF_LIGHT_M_S / float(hz[last - 1]) / _STEPS_PER_WAVELENGTH
            best = best.nearest(best.alone(around(step_m, reach_m), carriers, standing_m, is_over), train)
            reach_m = min(reach_m, _REACH * step_m)
        if is_over():
            break
        best = best.nearest(best.together(carriers, standing_m), train)
    return best.room


def sharpened(room: Surfaces, train: PasDataset, lags: LagAverages, standing_m: Points) -> list[RoomSurface]:
    """A room whose parts are off by a share of the shortest wave, with all of them moved to where they belong."""
    paths = ReflectedPaths.of(room, train, lags)
    return paths.together(np.arange(len(paths.carrier_hz))[-_AT_ONCE:], standing_m)


def _ends(carrier_hz: Float[FloatArray, "F"]) -> list[int]:
    """Ends of the ranges of carriers that are taken one after another: the lowest, then more, then overlapping ones."""
    number = len(carrier_hz)
    lowest = int(np.count_nonzero(carrier_hz <= _LOWEST * carrier_hz[0]))
    growing = range(min(lowest, _AT_ONCE), min(number, _AT_ONCE))
    return [*growing, *range(min(_AT_ONCE, number), number, _AT_ONCE - 1), number]


def around(step_m: float, reach_m: float) -> Float[FloatArray, "n"]:
    """Displacements up to a reach, 0 first."""
    steps = np.arange(1, int(np.ceil(reach_m / step_m)) + 1)
    return step_m * np.concatenate([[0], -steps[::-1], steps])


_PLACES_M = around(0.01, 0.5)  # displacements that are tried of a wall


@dataclass(eq=False)
class ReflectedPaths:
    """P paths of some transmitters to the array, traced in a room at F carriers, and which parts reflect them.

    `wave` is the channel of each path at the array's elements, `channel` their sum for each of T transmitters.
    `reflected` holds for each part the paths that it reflects, and how much longer each becomes by a metre that the
    part moves. `rows` are compared with `measured`, their lag averages; theirs are transmitter `of_tx` and carrier
    `of_carrier`.
    """

    room: list[RoomSurface]
    carrier_hz: Float[FloatArray, "F"]
    lags: LagAverages
    wave: Complex[ComplexArray, "P F M"]
    length_m: Float[FloatArray, "P"]
    tx: Int[IntArray, "P"]
    reflected: dict[RoomPart, tuple[Int[IntArray, "n"], Float[FloatArray, "n"]]]
    of_tx: Int[IntArray, "B"]
    of_carrier: Int[IntArray, "B"]
    measured: Lags

    @classmethod
    def of(
        cls, room: Surfaces, train: PasDataset, lags: LagAverages, carrier_hz: Float[FloatArray, "F"] | None = None
    ) -> ReflectedPaths:
        """The paths from evenly drawn transmitters of training rows, at all or some carriers of theirs."""
        hz = np.unique(train.carrier_hz) if carrier_hz is None else carrier_hz
        receiver = train.header.receiver
        tracer = tracer_in(room, receiver, hz.tolist(), UNHIDDEN)
        element = train.beam.element_position_wavelengths
        lengthened = defaultdict[RoomPart, list[tuple[int, float]]](list)
        waves, lengths_m, owners, rows = [], list[FloatArray](), list[IntArray](), []
        motions, num_paths = dict[RoomPart, Motion](), 0
        for number, tx in enumerate(evenly(np.unique(train.tx_index), _NUM_TX)):
            own = np.flatnonzero((train.tx_index == tx) & np.isin(train.carrier_hz, hz))
            if not len(own):
                continue
            position_m = train.tx_position_m[own[0]]
            paths = tracer.paths(position_m)
            for part, path, slope in _slopes(paths, room, position_m, receiver.position_m, motions):
                lengthened[part].append((num_paths + path, slope))
            waves.append(waves_of(paths, receiver.rotation, element))
            lengths_m.append(paths.delay_s * SPEED_OF_LIGHT_M_S)
            owners.append(np.full(len(paths.delay_s), number))
            num_paths += len(paths.delay_s)
            rows.append(np.stack([own, np.full(len(own), number)], axis=1))
        rows, of_tx = np.concatenate(rows).T
        return cls(
            list(room),
            hz,
            lags,
            np.concatenate(waves),
            np.concatenate(lengths_m),
            np.concatenate(owners),
            {part: (np.array([p for p, _ in of]), np.array([s for _, s in of])) for part, of in lengthened.items()},
            of_tx,
            np.searchsorted(hz, train.carrier_hz[rows]),
            lags.measured(rows),
        )

    def __post_init__(self) -> None:
        shape = int(self.of_tx.max(initial=-1)) + 1, *self.wave.shape[1:]
        self.channel = np.zeros(shape, complex)
        np.add.at(self.channel, self.tx, self.wave)

    def nearest(self, room: Surfaces, train: PasDataset) -> ReflectedPaths:
        """The paths in a changed room, or these, whichever rows agree with better."""
        there = ReflectedPaths.of(room, train, self.lags)
        return there if there.score > self.score else self

    @property
    def score(self) -> float:
        """Mean likeness of the rows."""
        lags = self.lags.of_channels(self.channel[self.of_tx, self.of_carrier])
        return float(self.lags.likeness(self.measured, lags).mean())

    @property
    def strongest_first(self) -> list[RoomPart]:
        """The parts, ordered by the power that they reflect."""
        power = (np.abs(self.wave) ** 2).sum(axis=(1, 2))
        return sorted(self.reflected, key=lambda part: -power[self.reflected[part][0]].sum())

    def alone(
        self, by_m: Float[FloatArray, "n"], carriers: Int[IntArray, "K"], standing_m: Points, is_over: IsOver = never
    ) -> list[RoomSurface]:
        """The room with parts moved one after another, by the displacement (0 first) that rows agree with best."""
        paths = replace(self, wave=self.wave.copy())
        for part in self.strongest_first:
            if is_over():
                break
            likeness = paths.likeness(part, by_m, carriers)
            best = int(likeness.argmax())
            if likeness[best] >= likeness[0] + LEAST_GAIN:
                paths._move(part, float(by_m[best]), standing_m)
        return paths.room

    def _move(self, part: RoomPart, by_m: float, standing_m: Points) -> None:
        """Move a part and turn the waves that it reflects, if it may stand there."""
        room = moved(self.room, part, by_m)
        if _may_become(self.room, room, standing_m):
            paths, _ = self.reflected[part]
            turn = self._turn(part, by_m, np.arange(len(self.carrier_hz)))
            change = self.wave[paths] * (turn - 1)[:, :, None]
            np.add.at(self.channel, self.tx[paths], change)
            self.wave[paths] += change
            self.room = room

    def together(self, carriers: Int[IntArray, "K"], standing_m: Points) -> list[RoomSurface]:
        """The room with all parts moved a little, so that rows at some carriers agree best, in least squares.

        No part lengthens its paths by more than a share of the shortest wavelength in the root mean square.
        """
        parts, rows = self.strongest_first, np.isin(self.of_carrier, carriers)
        if not (parts and rows.any()):
            return self.room
        slopes, unit_m = np.zeros((len(self.length_m), len(parts))), np.ones(len(parts))
        for column, part in enumerate(parts):
            paths, slope = self.reflected[part]
            unit_m[column] = 1 / np.sqrt((slope**2).mean()).clip(_FLAT)
            slopes[paths, column] = slope * unit_m[column]
        wave = self.wave[:, carriers]
        place = self.of_tx[rows], np.searchsorted(carriers, self.of_carrier[rows])
        wavenumber = 2 * np.pi / SPEED_OF_LIGHT_M_S * self.carrier_hz[carriers]
        reach_m = _NEAR * 2 * np.pi / float(wavenumber.max())
        measured, channel = self.measured[rows], np.zeros_like(self.channel[:, carriers])
        tx, first = np.unique(self.tx, return_index=True)

        def left(by: Float[FloatArray, "n"]) -> Float[FloatArray, "r"]:
            turn = np.exp(-1j * (slopes @ by)[:, None] * wavenumber)
            channel[tx] = np.add.reduceat(wave * turn[:, :, None], first, axis=0)
            return self.lags.left(measured, self.lags.of_channels(channel[place])).view(np.float64).ravel()

        bounds = (-reach_m, reach_m)
        best = least_squares(left, np.zeros(len(parts)), bounds=bounds, x_scale=reach_m, max_nfev=_MOST_STEPS)
        room = self.room
        for part, by_m in zip(parts, (best.x * unit_m).tolist(), strict=True):
            changed = moved(room, part, by_m)
            room = changed if _may_become(room, changed, standing_m) else room
        return room

    def likeness(
        self, part: RoomPart, by_m: Float[FloatArray, "n"], carriers: Int[IntArray, "K"]
    ) -> Float[FloatArray, "n"]:
        """Summed likeness of the rows at some carriers that a part matters to, with each displacement of it."""
        paths, _ = self.reflected[part]
        tx, first = np.unique(self.tx[paths], return_index=True)
        rows = np.isin(self.of_tx, tx) & np.isin(self.of_carrier, carriers)
        place = np.searchsorted(tx, self.of_tx[rows]), np.searchsorted(carriers, self.of_carrier[rows])
        wave, channel = self.wave[np.ix_(paths, carriers)], self.channel[np.ix_(tx, carriers)]
        measured = self.measured[rows]

        def of(step_m: float) -> float:
            turn = self._turn(part, step_m, carriers) - 1
            there = channel + np.add.reduceat(wave * turn[:, :, None], first, axis=0)
            return float(self.lags.likeness(measured, self.lags.of_channels(there[place])).sum())

        return np.array([of(step_m) for step_m in by_m.tolist()])

    def elsewhere(self, part: RoomPart, carriers: Int[IntArray, "K"]) -> list[float]:
        """Displacements of a part with which training rows agree better than without, in metres, the best first."""
        likeness = self.likeness(part, _PLACES_M, carriers)
        here = likeness[np.abs(_PLACES_M) <= _HERE_M].max()
        return [by_m for by_m, value in peaks(_PLACES_M, likeness) if abs(by_m) > _HERE_M and value > here + LEAST_GAIN]

    def _turn(
        self, part: RoomPart, by_m: float, carriers: Int[IntArray, "K"]
    ) -> Complex[NDArray[np.complex128], "n K"]:
        """The factor on the waves of paths when the part that reflects them is displaced.

        The image of the transmitter moves by twice as much, which is exact for a path that the part reflects once.
        """
        paths, slope = self.reflected[part]
        length_m = self.length_m[paths]
        bend = 0.0 if part.kind == "tilt" else (2 * by_m) ** 2
        longer_m = np.sqrt(length_m**2 + 2 * length_m * slope * by_m + bend) - length_m
        return np.exp(-2j * np.pi / SPEED_OF_LIGHT_M_S * longer_m[:, None] * self.carrier_hz[carriers])


def _may_become(room: Surfaces, changed: Surfaces, standing_m: Points) -> bool:
    """Whether all changed surfaces of a room may stand where they are."""
    new = (surface for surface, old in zip(changed, room, strict=True) if surface is not old)
    return all(is_clear(surface, standing_m) and surface.depth_m >= 0 for surface in new)


def _slopes(
    paths: Paths,
    room: Surfaces,
    tx_position_m: Vector,
    receiver_m: tuple[float, float, float],
    motions: dict[RoomPart, Motion],
) -> list[tuple[RoomPart, int, float]]:
    """For each part, the paths it reflects, and how much longer they get per metre it moves. Fills `motions`."""
    found = []
    for path, codes in enumerate(paths.interactions):
        number = int(np.count_nonzero(codes))
        line_m = np.concatenate([tx_position_m[None], paths.vertices_m[path, :number], [receiver_m]])
        way = np.diff(line_m, axis=0)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        slopes = defaultdict[RoomPart, float](float)
        for at in np.flatnonzero(codes[:number] == SPECULAR).tolist():
            point_m, turn = line_m[at + 1], way[at] - way[at + 1]
            for part in parts_at(room[paths.surfaces[path, at]], point_m):
                if part not in motions:
                    motions[part] = motion_of(room, part)
                slopes[part] += float(turn @ motions[part](point_m))
        found += [(part, path, slope) for part, slope in slopes.items()]
    return found


def peaks(places_m: Float[FloatArray, "n"], likeness: Float[FloatArray, "n"]) -> list[tuple[float, float]]:
    """Local maxima of the likeness, the highest first: each place with its likeness."""
    order = np.argsort(places_m)
    places_m, likeness = places_m[order], likeness[order]
    padded = np.pad(likeness, 1, constant_values=-np.inf)
    at = np.flatnonzero((likeness >= padded[:-2]) & (likeness > padded[2:]))
    return sorted(zip(places_m[at].tolist(), likeness[at].tolist(), strict=True), key=lambda place: -place[1])
