"""The room that a seed draws from a family: its walls, its array and its furniture, the same on every machine.

Only sums, products, quotients and square roots are computed of the random numbers, because IEEE 754 fixes their every
digit. Coordinates are rounded to millimetres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field

from xfreqbench.errors import PlacementError, SceneError
from xfreqbench.scene.dice import Dice
from xfreqbench.scene.families import Family, Fraction3, Piece, RoomType, Slabs, load_family
from xfreqbench.scene.model import Point, ReceiverArray, Scene, Surface
from xfreqbench.scene.toml_files import form_errors
from xfreqbench.system.arguments import FilePath, checked
from xfreqbench.types import FloatArray

_MOST_TRIES = 10_000  # for the places of the array and of all transmitters
_BESIDE_OPENING_M = 0.15
_LIFTED_M, _GAP_M, _BELOW_CEILING_M = 0.02, 0.04, 0.05  # of furniture: off the floor, other things and the ceiling
_ARRAY_GAP_M, _TX_GAP_M, _TX_FROM_ARRAY_M = 0.45, 0.1, 0.5
Wall = tuple[FloatArray, FloatArray]  # its ends (2,), along it the room is on the left
_Slab = tuple[str, float | None]  # material and thickness in metres


@dataclass(frozen=True, eq=False)
class Solid:
    """What takes up space: a convex outline on the floor (n, 2), or a line (2, 2), between two heights, in metres."""

    outline_m: Float[FloatArray, "n 2"]
    low_m: float
    high_m: float


@dataclass(frozen=True, eq=False)
class DrawnRoom:
    """A room that a seed drew from a family: its type, its scene, and the possible positions of transmitters."""

    seed: int
    type: RoomType
    scene: Scene
    outline_m: Float[FloatArray, "n 2"]
    solids: tuple[Solid, ...]

    def transmitters(self, number: int) -> Float[FloatArray, "T 3"]:
        """Random places for transmitters, the first of more; in the room, outside of furniture, off walls and array.

        Raises `PlacementError` if there is hardly any free space.
        """
        dice, found = Dice(self.seed, 1), list[Point]()
        array_m = np.asarray(self.scene.receiver.position_m)
        for _ in range(_MOST_TRIES + 100 * number):
            if len(found) == number:
                return np.array(found)
            x, y = _within(dice, self.outline_m)
            z = _rounded(dice.between(self.type.tx_height_m))
            apart_m = float(np.sqrt(((np.array([x, y, z]) - array_m) ** 2).sum()))
            if apart_m > _TX_FROM_ARRAY_M and _is_free(_point(x, y, z), self.outline_m, self.solids, _TX_GAP_M):
                found.append((x, y, z))
        raise PlacementError(
            f"Room {self.seed} of type {self.type.name!r} has no free places for {number} transmitters. Give it less "
            "furniture, or ask for fewer."
        )


@checked
def draw_room(family: FilePath | Family, seed: Annotated[int, Field(ge=0, lt=2**63)]) -> DrawnRoom:
    """The room that a seed draws from a family, which is given by name, path or itself.

    Raises as `load_family`, and `SceneError` for a family that leaves no place for the array, or draws an invalid room.
    """
    family = family if isinstance(family, Family) else load_family(family)
    dice, kind = Dice(seed), family.type_of(seed)
    with form_errors(f"room {seed} of family {family.name!r}", Scene):
        outline_m = _outline(family, kind, dice)
        height_m = _rounded(dice.between(kind.height_m))
        shell = _Shell(kind, outline_m, height_m, dice)
        surfaces, lines = list(shell.surfaces()), shell.lines
        receiver = _receiver(family, kind, outline_m, height_m, lines, dice)
        pieces = {piece.name: piece for piece in family.piece}
        solids = [*lines, _point(*receiver.position_m, _ARRAY_GAP_M)]
        names = count(1)
        for furniture in kind.furniture:
            for _ in range(dice.whole(furniture.number)):
                placed = _placed(pieces[furniture.piece], outline_m, height_m, solids, dice)
                if placed:
                    solids.append(placed.solid)
                    surfaces += placed.surfaces(f"{furniture.piece} {next(names)}", dice)
        used = {surface.material for surface in surfaces}
        layered = (material for material in family.material if material.name in used)
        used |= {layer.material for material in layered for layer in material.layers or ()}
        materials = tuple(material for material in family.material if material.name in used)
        scene = Scene(room_name(family, seed), receiver, surface=tuple(surfaces), material=materials)
    return DrawnRoom(seed, kind, scene, outline_m, tuple(solids))


def room_name(family: Family, seed: int) -> str:
    """The name of the scene that a seed draws from a family."""
    return f"{family.name}-{family.type_of(seed).name}-{seed}"


def _outline(family: Family, kind: RoomType, dice: Dice) -> Float[FloatArray, "n 2"]:
    """Corners of the floor plan in turn, counter-clockwise; it may be mirrored along either axis."""
    name = dice.one_of(kind.outlines)
    outline = next(outline for outline in family.outline if outline.name == name)
    drawn = {name: dice.between(span) for name, span in outline.spans.items()}
    share = np.array([[drawn[at] if isinstance(at, str) else at for at in corner] for corner in outline.corners])
    for axis in range(2):
        if dice.share() < 0.5:
            share[:, axis] = 1 - share[:, axis]
            share = share[::-1]
    return _rounded_all(share * [dice.between(kind.length_m), dice.between(kind.width_m)])


class _Shell:
    """Floor, ceiling, walls and partitions with their doors and windows."""

    def __init__(self, kind: RoomType, outline_m: Float[FloatArray, "n 2"], height_m: float, dice: Dice) -> None:
        self._kind, self._outline_m, self._height_m, self._dice = kind, outline_m, height_m, dice
        self.walls: list[Wall] = list(zip(outline_m, np.roll(outline_m, -1, axis=0), strict=True))
        self.partitions = self._partitions()
        self.lines = [Solid(np.array(wall), 0.0, height_m) for wall in (*self.walls, *self.partitions)]

    def surfaces(self) -> Iterator[Surface]:
        """All surfaces; walls face the room, and so do floor and ceiling."""
        kind, dice, height_m = self._kind, self._dice, self._height_m
        for name, choice, z, corners_m in (
            ("floor", kind.floor, 0.0, self._outline_m),
            ("ceiling", kind.ceiling, height_m, self._outline_m[::-1]),
        ):
            yield _surface(name, _slab(choice, dice), [(x, y, z) for x, y in corners_m.tolist()])
        doors, windows = dice.whole(kind.doors), dice.whole(kind.windows)
        wall_slab, door_slab, window_slab = (_slab(slabs, dice) for slabs in (kind.walls, kind.door, kind.window))
        by_wall: list[list[str]] = [[] for _ in self.walls]
        for opening in ["door"] * doors + ["window"] * windows:
            by_wall[dice.whole((0, len(self.walls) - 1))].append(opening)
        slabs = {"wall": wall_slab, "door": door_slab, "window": window_slab}
        for number, (wall, openings) in enumerate(zip(self.walls, by_wall, strict=True)):
            yield from self._panels(f"wall {number}", wall, openings, slabs)
        partition_slab = _slab(kind.partition, dice) if self.partitions else wall_slab
        for number, wall in enumerate(self.partitions):
            leads_through = ["open" if dice.share() < kind.open else "door"]
            yield from self._panels(f"partition {number}", wall, leads_through, slabs | {"wall": partition_slab})

    def _panels(self, name: str, wall: Wall, openings: list[str], slabs: dict[str, _Slab]) -> Iterator[Surface]:
        """A wall around its openings, in each of equal shares of its length one, and what fills these.

        An opening that does not fit into its share is left out.
        """
        start_m, end_m = wall
        length_m = float(np.sqrt(((end_m - start_m) ** 2).sum()))
        along = (end_m - start_m) / length_m
        panels = count(1)

        def panel(kind: str, span_m: tuple[float, float], low_m: float, high_m: float) -> Surface:
            (ax, ay), (bx, by) = (_rounded_all(start_m + along * at).tolist() for at in span_m)
            corners_m = [(ax, ay, low_m), (bx, by, low_m), (bx, by, high_m), (ax, ay, high_m)]
            return _surface(f"{name}.{next(panels)} {kind}", slabs[kind], corners_m)

        left_m = 0.0
        for place, opening in enumerate(openings):
            share_m = length_m / len(openings)
            width_m, low_m, high_m = self._opening(opening)
            free_m = share_m - 2 * _BESIDE_OPENING_M - width_m
            if free_m < 0:
                continue
            first_m = _rounded(place * share_m + _BESIDE_OPENING_M + free_m * self._dice.share())
            last_m = _rounded(first_m + width_m)
            yield panel("wall", (left_m, first_m), 0.0, self._height_m)
            if low_m > 0:
                yield panel("wall", (first_m, last_m), 0.0, low_m)
            yield panel("wall", (first_m, last_m), high_m, self._height_m)
            if opening != "open":
                yield panel(opening, (first_m, last_m), low_m, high_m)
            left_m = last_m
        yield panel("wall", (left_m, length_m), 0.0, self._height_m)

    def _opening(self, opening: str) -> tuple[float, float, float]:
        """Width of a door or window, and the heights between which it is open."""
        if opening != "window":
            return _rounded(self._dice.between((0.8, 1.0))), 0.0, 2.05
        low_m = _rounded(self._dice.between(self._kind.sill_m))
        high_m = min(_rounded(low_m + self._dice.between(self._kind.window_height_m)), self._height_m - 0.1)
        return _rounded(self._dice.between((0.8, 2.4))), low_m, _rounded(high_m)

    def _partitions(self) -> list[Wall]:
        """Partitions along x or y, from a wall or another partition to the next, or, if partial, not so far."""
        kind, dice, found = self._kind, self._dice, list[Wall]()
        for _ in range(dice.whole(kind.partitions)):
            axis = dice.whole((0, 1))
            low_m, high_m = self._outline_m[:, axis].min(), self._outline_m[:, axis].max()
            place_m = _rounded(dice.between((float(low_m), float(high_m))))
            picked, share = dice.share(), dice.between((0.4, 0.8))
            is_partial, is_from_end = dice.share() < kind.partial, dice.share() < 0.5
            parallel = [start[axis] for start, end in found if start[axis] == end[axis]]
            spans_m = _spans_across(self.walls, found, axis, place_m)
            is_near = np.abs(self._outline_m[:, axis] - place_m).min() < 0.8
            if is_near or not spans_m or any(abs(at - place_m) < 1.6 for at in parallel):
                continue
            first_m, last_m = spans_m[int(picked * len(spans_m))]
            if is_partial and is_from_end:
                first_m = _rounded(last_m - (last_m - first_m) * share)
            elif is_partial:
                last_m = _rounded(first_m + (last_m - first_m) * share)
            if last_m - first_m > 1.0:
                ends_m = np.full((2, 2), place_m)
                ends_m[:, 1 - axis] = first_m, last_m
                found.append((ends_m[0], ends_m[1]))
        return found


def _spans_across(
    walls: Sequence[Wall], partitions: Sequence[Wall], axis: int, place_m: float
) -> list[tuple[float, float]]:
    """The stretches of a line across the room, on which one coordinate has a value, from wall to wall or partition."""

    def crossed(lines: Sequence[Wall]) -> list[float]:
        ends = [(start, end) for start, end in lines if (start[axis] < place_m) != (end[axis] < place_m)]
        shares = ((place_m - start[axis]) / (end[axis] - start[axis]) for start, end in ends)
        other = 1 - axis
        return sorted(
            _rounded(float(start[other] + share * (end[other] - start[other])))
            for (start, end), share in zip(ends, shares, strict=True)
        )

    outer, inner = crossed(walls), crossed(partitions)
    spans = list[tuple[float, float]]()
    for low_m, high_m in zip(outer[::2], outer[1::2], strict=True):
        spans += pairwise([low_m, *(at for at in inner if low_m < at < high_m), high_m])
    return spans


def _receiver(
    family: Family,
    kind: RoomType,
    outline_m: Float[FloatArray, "n 2"],
    height_m: float,
    lines: Sequence[Solid],
    dice: Dice,
) -> ReceiverArray:
    """The array at a random place under the ceiling, or before one of the walls."""
    array = dice.one_of(kind.arrays)
    for _ in range(_MOST_TRIES):
        away_m = dice.between(array.away_m)
        if array.at == "ceiling":
            x, y = _within(dice, outline_m)
            z, boresight = _rounded(height_m - away_m), (0.0, 0.0, -1.0)
        else:
            wall = lines[dice.whole((0, len(outline_m) - 1))].outline_m
            inward = _inward(wall)
            x, y = _rounded_all(wall[0] + dice.share() * (wall[1] - wall[0]) + away_m * inward).tolist()
            z, boresight = _rounded(min(dice.between(array.height_m), height_m - 0.3)), (*inward.round(9).tolist(), 0.0)
        others = [line for line in lines if array.at == "ceiling" or line.outline_m is not wall]
        if _is_free(_point(x, y, z), outline_m, others, _ARRAY_GAP_M):
            return ReceiverArray((x, y, z), family.rows, family.cols, boresight=boresight)
    raise SceneError(
        f"Type {kind.name!r} of family {family.name!r} leaves no place for the array, which stays {_ARRAY_GAP_M:g} m "
        "off walls and partitions. Make the rooms larger."
    )


@dataclass(frozen=True, eq=False)
class _Placed:
    """A piece of furniture at its place: what takes its parts, in shares of its size, to metres of the room."""

    piece: Piece
    origin_m: Float[FloatArray, "3"]
    size_m: tuple[float, float, float]
    along: Float[FloatArray, "2"]  # direction of its width, of length 1

    @property
    def solid(self) -> Solid:
        """The box about the piece."""
        corners_m = self.places_m([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
        return Solid(corners_m[:, :2], float(self.origin_m[2]), float(self.origin_m[2] + self.size_m[2]))

    def places_m(self, shares: Sequence[Sequence[float]]) -> Float[FloatArray, "n 3"]:
        """Places in the room of some places in the piece."""
        local_m = np.asarray(shares, float) * self.size_m
        (c, s), x, y = self.along, local_m[:, 0], local_m[:, 1]
        turned_m = np.column_stack([c * x - s * y, s * x + c * y, local_m[:, 2]])
        return _rounded_all(self.origin_m + turned_m)

    def surfaces(self, name: str, dice: Dice) -> Iterator[Surface]:
        """The surfaces of all parts; a box that no turn tilts is one."""
        is_straight = not self.along.all()
        for part in self.piece.part:
            slab, title = _slab(part.slabs, dice), f"{name} {part.name}"
            if part.box is not None and is_straight:
                ends_m = self.places_m(part.box)
                yield _surface(title, slab, None, (ends_m.min(axis=0), ends_m.max(axis=0)), part.mirrors)
                continue
            vertices, faces = (part.vertices, part.faces) if part.box is None else _faces_of(part.box)
            vertices_m = self.places_m(vertices)
            for number, face in enumerate(faces, 1):
                yield _surface(f"{title} {number}", slab, vertices_m[list(face)].tolist(), None, part.mirrors)


def _faces_of(box: tuple[Fraction3, Fraction3]) -> tuple[list[Fraction3], list[tuple[int, ...]]]:
    """Corners and faces of a box; one that is flat along an axis has one face."""
    low, high = box
    vertices = [
        (x, y, z)
        for z in (low[2], high[2])
        for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
    ]
    faces: list[tuple[int, ...]] = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (2, 3, 7, 6), (1, 2, 6, 5), (0, 4, 7, 3)]
    flat = [axis for axis in range(3) if low[axis] == high[axis]]
    return vertices, [{0: faces[5], 1: faces[2], 2: faces[0]}[flat[0]]] if flat else faces


def _placed(
    piece: Piece, outline_m: Float[FloatArray, "n 2"], height_m: float, solids: Sequence[Solid], dice: Dice
) -> _Placed | None:
    """A piece at a free place; None if none of some places is free."""
    width_m, depth_m, tall_m = (_rounded(dice.between(span)) for span in piece.size_m)
    tall_m = min(tall_m, _rounded(height_m - _LIFTED_M - _BELOW_CEILING_M))
    low_m = _rounded(height_m - _BELOW_CEILING_M - tall_m) if piece.at == "ceiling" else _LIFTED_M
    walls = list(zip(outline_m, np.roll(outline_m, -1, axis=0), strict=True))
    for _ in range(30):
        if piece.at == "wall":
            start, end = walls[dice.whole((0, len(walls) - 1))]
            length_m = float(np.sqrt(((end - start) ** 2).sum()))
            along = (end - start) / length_m
            free_m = length_m - width_m
            x, y = (start + along * (dice.share() * free_m) + _inward(np.array([start, end])) * (1.5 * _GAP_M)).tolist()
            if free_m < 0:
                continue
        else:
            along = np.array(dice.one_of([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]))
            if piece.turned:  # by any angle: a point of the circle with rational coordinates
                half = 2 * dice.share() - 1
                c, s = (1 - half * half) / (1 + half * half), 2 * half / (1 + half * half)
                along = np.array([c * along[0] - s * along[1], s * along[0] + c * along[1]])
            x, y = _within(dice, outline_m)
        placed = _Placed(piece, np.array([_rounded(x), _rounded(y), low_m]), (width_m, depth_m, tall_m), along)
        if _is_free(placed.solid, outline_m, solids, _GAP_M):
            return placed
    return None


def _is_free(solid: Solid, outline_m: Float[FloatArray, "n 2"], solids: Sequence[Solid], gap_m: float) -> bool:
    """Whether a solid is in the room, and apart from all solids that are as high."""
    return _is_inside(solid.outline_m.mean(axis=0), outline_m) and all(
        other.low_m - gap_m >= solid.high_m
        or solid.low_m - gap_m >= other.high_m
        or _apart_m(solid.outline_m, other.outline_m) >= gap_m
        for other in solids
    )


def _apart_m(first_m: Float[FloatArray, "n 2"], second_m: Float[FloatArray, "k 2"]) -> float:
    """The widest gap between two convex outlines along and across all their sides; negative where they overlap."""
    sides_m = np.concatenate(
        [np.roll(corners_m, -1, axis=0) - corners_m for corners_m in (first_m, second_m) if len(corners_m) > 1]
    )
    across = np.concatenate([sides_m, np.column_stack([-sides_m[:, 1], sides_m[:, 0]])])
    across /= np.sqrt((across**2).sum(axis=1))[:, None]
    first, second = (across[:, :1] * ring[:, 0] + across[:, 1:] * ring[:, 1] for ring in (first_m, second_m))
    return float(np.maximum(first.min(axis=1) - second.max(axis=1), second.min(axis=1) - first.max(axis=1)).max())


def _is_inside(point_m: Float[FloatArray, "2"], outline_m: Float[FloatArray, "n 2"]) -> bool:
    """Whether a point is inside an outline: a line to the right of it crosses an odd number of sides."""
    (x, y), start, end = point_m, outline_m, np.roll(outline_m, -1, axis=0)
    crosses = (start[:, 1] > y) != (end[:, 1] > y)
    rise = np.where(crosses, end[:, 1] - start[:, 1], 1)
    at = start[:, 0] + (y - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return bool(np.count_nonzero(crosses & (at > x)) % 2)


def _within(dice: Dice, outline_m: Float[FloatArray, "n 2"]) -> tuple[float, float]:
    """A random point of the rectangle about an outline, in whole millimetres."""
    low_m, high_m = outline_m.min(axis=0).tolist(), outline_m.max(axis=0).tolist()
    x, y = (_rounded(dice.between(span)) for span in zip(low_m, high_m, strict=True))
    return x, y


def _inward(wall_m: Float[FloatArray, "2 2"]) -> Float[FloatArray, "2"]:
    """The unit vector into the room, across a wall of an outline that turns counter-clockwise."""
    x, y = wall_m[1] - wall_m[0]
    return np.array([-y, x]) / np.sqrt(x * x + y * y)


def _point(x: float, y: float, z: float, reach_m: float = 0.0) -> Solid:
    """A solid about a point: a square that reaches so far to every side, and as far above and below."""
    reach = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * reach_m
    return Solid(np.array([[x, y]]) + (reach if reach_m else 0), z - reach_m, z + reach_m)


def _slab(slabs: Slabs, dice: Dice) -> _Slab:
    """One of some slabs, its thickness in tenths of a millimetre."""
    chosen = dice.one_of(slabs)
    share = dice.share()
    if chosen.thickness_m is None:
        return chosen.material, None
    low_m, high_m = chosen.thickness_m
    return chosen.material, round(low_m + (high_m - low_m) * share, 4)


def _surface(name: str, slab: _Slab, corners_m: Any, bounds_m: Any = None, mirrors: bool = True) -> Surface:
    """A surface as a polygon, or from its lowest to its highest corner."""
    material, thickness_m = slab
    said: Literal[False] | None = None if mirrors else False
    if bounds_m is None:
        return Surface(name, material, thickness_m, vertices_m=tuple(map(tuple, corners_m)), mirrors=said)
    low_m, high_m = (tuple(corner_m.tolist()) for corner_m in bounds_m)
    return Surface(name, material, thickness_m, low_m, high_m, mirrors=said)


def _rounded(metres: float) -> float:
    return round(metres, 3)


def _rounded_all(metres: FloatArray) -> FloatArray:
    return np.vectorize(_rounded, otypes=[float])(metres)
