"""Families of rooms: distributions, read from TOML, from which a seed draws a room (`xfreqbench.scene.drawn_rooms`)."""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, PositiveFloat, PositiveInt, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass as record

from xfreqbench.scene.dice import Dice
from xfreqbench.scene.materials import SceneMaterial, Thickness
from xfreqbench.scene.model import PositiveMetres
from xfreqbench.scene.toml_files import form_errors, load_toml, shipped_families, toml_content
from xfreqbench.system.arguments import FilePath, only_given
from xfreqbench.system.files import json_sha256

DRAWING = 1  # version of what a seed makes of a family; part of the family's hash
_STRICT = ConfigDict(extra="forbid")

Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0, le=1000)]
Name = Annotated[str, Field(pattern=r"^\w[\w -]*$")]


def _ascends(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError(f"a span is its least and its greatest value, but {list(span)} descends")
    return span


# all values between are equally likely
Span = Annotated[tuple[PositiveMetres, PositiveMetres], AfterValidator(_ascends)]
Counts = Annotated[tuple[Count, Count], AfterValidator(_ascends)]
Fraction3 = tuple[Share, Share, Share]


@record(frozen=True, config=_STRICT)
class SlabChoice:
    """A material with the span of its thickness, or one with layers, which has a thickness of its own."""

    material: str
    thickness_m: Annotated[tuple[Thickness, Thickness], AfterValidator(_ascends)] | None = None

    _json = only_given


Slabs = Annotated[tuple[SlabChoice, ...], Field(min_length=1)]  # one is drawn, all are equally likely


@record(frozen=True, config=_STRICT)
class Outline:
    """Corners of a floor plan in turn, counter-clockwise, in shares of its length and width.

    A corner's coordinate may be the name of a span in `spans`, which holds the shares between which it is drawn.
    """

    name: Name
    corners: Annotated[tuple[tuple[Share | str, Share | str], ...], Field(min_length=3)]
    spans: dict[str, Annotated[tuple[Share, Share], AfterValidator(_ascends)]] = field(default_factory=dict)

    @model_validator(mode="after")
    def _names_its_spans(self) -> Outline:
        for name in {share for corner in self.corners for share in corner if isinstance(share, str)}:
            if name not in self.spans:
                raise ValueError(f"outline {self.name!r} has no span {name!r}")
        return self


@record(frozen=True, config=_STRICT)
class PiecePart:
    """A part of a piece of furniture, in shares of its size: a `box` from corner to corner, or a mesh of flat `faces`.

    A box may be flat along one axis. Faces are the numbers of `vertices` in turn. With `mirrors = false` the part
    blocks and transmits, and mirrors nothing, as small things do.
    """

    name: Name
    slabs: Slabs
    box: tuple[Fraction3, Fraction3] | None = None
    vertices: tuple[Fraction3, ...] = ()
    faces: tuple[Annotated[tuple[Count, ...], Field(min_length=3)], ...] = ()
    mirrors: bool = True

    @model_validator(mode="after")
    def _has_one_shape(self) -> PiecePart:
        if (self.box is None) == (not self.faces):
            raise ValueError(f"part {self.name!r} needs either a box, or vertices and faces")
        if any(number >= len(self.vertices) for face in self.faces for number in face):
            raise ValueError(f"a face of part {self.name!r} names a vertex that does not exist")
        return self


@record(frozen=True, config=_STRICT)
class Piece:
    """A piece of furniture: spans of width, depth and height, its place, and its parts.

    At a `wall` its back, y = 0 of its parts, is at a wall; in the `room` it is anywhere, turned by quarters or, if
    `turned`, by any angle; under the `ceiling` it hangs.
    """

    name: Name
    size_m: tuple[Span, Span, Span]
    part: Annotated[tuple[PiecePart, ...], Field(min_length=1)]
    at: Literal["wall", "room", "ceiling"] = "room"
    turned: bool = False


@record(frozen=True, config=_STRICT)
class Furniture:
    """How many of a piece there are in a room; one for which no free place is found is left out."""

    piece: str
    number: Counts


@record(frozen=True, config=_STRICT)
class ArrayPlace:
    """Where the array is: so far below the `ceiling`, looking down, or before a `wall`, looking into the room."""

    at: Literal["ceiling", "wall"]
    away_m: Span
    height_m: Span = (1.0, 2.0)


@record(frozen=True, config=_STRICT)
class RoomType:
    """The distribution of one type of room.

    `share` is how often it is drawn, relative to the other types; with `held_out` its rooms are only for the test.
    Whole numbers and choices are equally likely; an outline that is named twice is twice as likely. Partitions run from
    wall to wall, with a doorway, or, `partial` of them, end before. Of the doorways of partitions `open` have no door.
    """

    name: Name
    share: PositiveFloat
    outlines: Annotated[tuple[str, ...], Field(min_length=1)]
    length_m: Span
    width_m: Span
    height_m: Span
    floor: Slabs
    ceiling: Slabs
    walls: Slabs
    partition: Slabs
    door: Slabs
    window: Slabs
    arrays: Annotated[tuple[ArrayPlace, ...], Field(min_length=1)]
    furniture: tuple[Furniture, ...] = ()
    partitions: Counts = (0, 0)
    partial: Share = 0.0
    open: Share = 0.5
    doors: Counts = (1, 1)
    windows: Counts = (0, 0)
    sill_m: Span = (0.8, 1.0)
    window_height_m: Span = (1.0, 1.4)
    tx_height_m: Span = (0.5, 1.8)
    held_out: bool = False


@record(frozen=True, config=_STRICT)
class Family:
    """A distribution of rooms: their types, and the outlines, pieces of furniture and materials that these name."""

    name: Name
    description: str
    type: Annotated[tuple[RoomType, ...], Field(min_length=1)]
    outline: Annotated[tuple[Outline, ...], Field(min_length=1)]
    piece: tuple[Piece, ...] = ()
    material: tuple[SceneMaterial, ...] = ()
    rows: PositiveInt = 4
    cols: PositiveInt = 4

    @model_validator(mode="after")
    def _knows_what_it_names(self) -> Family:
        outlines, pieces = ({item.name for item in items} for items in (self.outline, self.piece))
        for room_type in self.type:
            named = [("outline", name, outlines) for name in room_type.outlines]
            named += [("piece of furniture", furniture.piece, pieces) for furniture in room_type.furniture]
            for kind, name, known in named:
                if name not in known:
                    raise ValueError(
                        f"type {room_type.name!r} names {kind} {name!r}; there are {', '.join(sorted(known))}"
                    )
        if len({room_type.name for room_type in self.type}) < len(self.type):
            raise ValueError("two types have the same name")
        return self

    @property
    def recipe(self) -> dict[str, Any]:
        """The family as JSON holds it, with the version of what a seed makes of it."""
        content: dict[str, Any] = TypeAdapter(Family).dump_python(self, mode="json", exclude={"description"})
        return {**content, "drawing": DRAWING}

    @property
    def sha256(self) -> str:
        """Hash of the recipe: families of equal hash have the same room at every seed."""
        return json_sha256(self.recipe)

    def type_of(self, seed: int) -> RoomType:
        """The type of the room that a seed draws."""
        left = Dice(seed, 2).share() * sum(room_type.share for room_type in self.type)
        for room_type in self.type:
            left -= room_type.share
            if left < 0:
                return room_type
        return self.type[-1]


def load_family(name_or_path: FilePath) -> Family:
    """A shipped family by its name, or one by the path of its TOML file, which ends in `.toml`.

    Raises `UnknownNameError`, and `SceneError` that names the faults of a file which describes no family.
    """
    return load_toml(name_or_path, "family of rooms", shipped_families(), _parsed)


def _parsed(text: str, folder: Path) -> Family:
    content = toml_content(text)
    with form_errors("family", Family):
        return TypeAdapter(Family).validate_python(content)


def family_schema() -> dict[str, Any]:
    """JSON Schema of a family's file, with which editors complete and check TOML."""
    return TypeAdapter(Family).json_schema()
