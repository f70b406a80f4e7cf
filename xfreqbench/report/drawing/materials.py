"""Colours of materials, the same in figures, models and pages."""

from __future__ import annotations

_COLOURS = {
    "concrete": "#7f7f7f",
    "plasterboard": "#b8a37a",
    "stud-wall": "#b8a37a",
    "glass": "#56b4e9",
    "double-glazing": "#56b4e9",
    "wood": "#a0522d",
    "solid-door": "#a0522d",
    "hollow-door": "#a0522d",
    "chipboard": "#cd853f",
    "plywood": "#d2a679",
    "metal": "#3b5b92",
    "brick": "#b5482f",
    "brick-wall": "#b5482f",
    "marble": "#9d8fa8",
    "ceiling_board": "#a9b39b",
    "floorboard": "#8b6b3d",
}


def material_hex(material: str) -> str:
    """Colour of a material as `#rrggbb`; one for all that have no name of ours."""
    return _COLOURS.get(material, "#6b8e6b")


def material_colour(material: str, opacity: int) -> tuple[int, int, int, int]:
    """Colour of a material as red, green, blue and opacity, each from 0 to 255."""
    red, green, blue = bytes.fromhex(material_hex(material)[1:])
    return red, green, blue, opacity
