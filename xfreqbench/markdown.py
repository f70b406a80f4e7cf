"""Tables and numbers as Markdown that also lines up in a terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from math import isnan

ABSENT = "–"
_NUMBER_LIKE = re.compile(r"[-−–+±=]|\d|$")  # how a cell begins that stands to the right

Cells = Sequence[str]


def table(header: Cells, rows: Iterable[Cells]) -> str:
    """Markdown table: the first column and texts to the left, numbers to the right."""
    lines = [[_escaped(cell) for cell in row] for row in (header, *rows)]
    columns = list(zip(*lines, strict=True))
    widths = [max(3, *map(len, column)) for column in columns]
    right = [index > 0 and all(map(_NUMBER_LIKE.match, column[1:])) for index, column in enumerate(columns)]
    rule = [
        "-" * (width - 1) + ":" if is_right else "-" * width
        for width, is_right in zip(widths, right, strict=True)
    ]
    return "\n".join(_aligned(row, widths, right) for row in (lines[0], rule, *lines[1:]))


def number(value: float, decimals: int) -> str:
    """A number, or a dash where it is unknown."""
    return ABSENT if isnan(value) else f"{value:.{decimals}f}"


def with_interval(value: float, interval: tuple[float, float], decimals: int) -> str:
    """A number with its interval in brackets, where that is known."""
    low, high = (number(bound, decimals) for bound in interval)
    return number(value, decimals) if isnan(interval[0]) else f"{number(value, decimals)} [{low}, {high}]"


def seconds(value: float) -> str:
    """Seconds to three digits, at most hundredths: `0.01 s`, `4.69 s`, `75 s`, `1200 s`."""
    return f"{value:.2f} s" if value < 1 else f"{value:.3g} s" if value < 1000 else f"{value:.0f} s"


def _aligned(row: Cells, widths: Sequence[int], right: Sequence[bool]) -> str:
    cells = [
        cell.rjust(width) if is_right else cell.ljust(width)
        for cell, width, is_right in zip(row, widths, right, strict=True)
    ]
    return f"| {' | '.join(cells)} |"


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")
