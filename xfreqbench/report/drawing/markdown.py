"""Tables and numbers as Markdown whose columns are also aligned in a terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from math import isnan

ABSENT = "–"
_NUMBER_LIKE = re.compile(r"[-−–+±=∞]|\d|$")  # the beginning of a cell that is aligned to the right

Cells = Sequence[str]


def table(header: Cells, rows: Iterable[Cells]) -> str:
    """A Markdown table: the first column and columns of words aligned to the left, columns of numbers to the right."""
    lines = [[cell.replace("|", "\\|") for cell in row] for row in (header, *rows)]
    columns = list(zip(*lines, strict=True))
    widths = [max(3, *map(len, column)) for column in columns]
    right = [index > 0 and all(map(_NUMBER_LIKE.match, column[1:])) for index, column in enumerate(columns)]
    rule = [
        "-" * (width - 1) + ":" if is_right else "-" * width
        for width, is_right in zip(widths, right, strict=True)
    ]
    return "\n".join(_aligned(row, widths, right) for row in (lines[0], rule, *lines[1:]))


def number(value: float, decimals: int) -> str:
    """A number as text, or a dash where it is nan."""
    return ABSENT if isnan(value) else f"{value:.{decimals}f}"


def with_interval(value: float, interval: tuple[float, float], decimals: int) -> str:
    """A number followed by its interval in brackets; without interval where that is nan."""
    low, high = (number(bound, decimals) for bound in interval)
    return number(value, decimals) if isnan(interval[0]) else f"{number(value, decimals)} [{low}, {high}]"


def seconds(value: float) -> str:
    """Seconds with three digits and at most two decimals: `0.01 s`, `4.69 s`, `75 s`, `1200 s`."""
    return f"{value:.2f} s" if value < 1 else f"{value:.3g} s" if value < 1000 else f"{value:.0f} s"


def _aligned(row: Cells, widths: Sequence[int], right: Sequence[bool]) -> str:
    cells = [
        cell.rjust(width) if is_right else cell.ljust(width)
        for cell, width, is_right in zip(row, widths, right, strict=True)
    ]
    return f"| {' | '.join(cells)} |"
