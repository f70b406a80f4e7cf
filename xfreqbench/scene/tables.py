"""Reads tables of positions as people, spreadsheets and programs write them; what has two meanings is refused."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import DataError
from xfreqbench.scene.model import FAR_M
from xfreqbench.system.files import read_text
from xfreqbench.types import FloatArray
from xfreqbench.units import parse_number

_NAME = re.compile(r"([xyz])(?:_m| ?\[m\]| ?\(m\))?", re.IGNORECASE)
_ANY_UNIT = re.compile(r"([xyz])(?:_\w+| ?\[.*\]| ?\(.*\))?", re.IGNORECASE)
_ADVICE = (
    "Write x,y,z into its first line, and into every other line a position: x,y,z in metres, three finite numbers with "
    "decimal points, and in each line as many cells. Columns of other names are left out."
)


@dataclass(frozen=True, eq=False)
class Table:
    """The texts of a table by column, all names empty if it has none, and the numbers of the lines in the file."""

    path: Path
    names: list[str]
    columns: list[tuple[str, ...]]
    lines: list[int]

    def position_m(self, height_m: float | None = None) -> Float[FloatArray, "T 3"]:
        """The positions in metres, all at a height where it is given; raises `DataError` as `axes` and `numbers`."""
        position_m = np.full((len(self.lines), 3), height_m, np.float64)
        for axis, column in enumerate(self.axes("xyz" if height_m is None else "xy")):
            position_m[:, axis] = self.numbers(column)
        return position_m

    def axes(self, wanted: str = "xyz") -> list[int]:
        """The columns of x, y and z by their names, or where they have none the three that hold numbers.

        Raises `DataError` if one has no column or several, and without names where the first may be an index.
        """
        if any(self.names):
            axes = _axes(self.names, _NAME)
            if any(axes.count(axis) != 1 for axis in wanted):
                fault = f"the columns {', '.join(self.names)!r}, not one each for {' and '.join(wanted)}"
                raise DataError(f"{self.path} has {fault}. {_ADVICE}")
            return [axes.index(axis) for axis in wanted]
        held = [n for n, cells in enumerate(self.columns) if not all(map(_is_word, cells))]
        first = list(self.columns[held[0]]) if held else []
        counts = first in ([str(n + start) for n in range(len(first))] for start in (0, 1))
        is_index = counts and any("." in cell for n in held[1:] for cell in self.columns[n])
        is_header = [self.columns[n][0] for n in held] == ["0", "1", "2"]  # as pandas names the columns of an array
        if len(held) != 3 or (len(first) > 1 and (is_index or is_header)):
            fault = (
                f"{len(held)} columns of numbers" if len(held) != 3 else "0, 1, 2, …, which may count lines or columns,"
            )
            raise DataError(f"{self.path} has {fault} and no names of columns. {_ADVICE}")
        return held[: len(wanted)]

    def numbers(self, column: int, missing: Collection[str] = ()) -> Float[FloatArray, "T"]:
        """The numbers of a column, nan for texts that are `missing`; raises `DataError` for what is not a number."""
        found = list[float]()
        for line, text in zip(self.lines, self.columns[column], strict=True):
            try:
                found.append(np.nan if text.lower() in missing else parse_number(text))
                if abs(found[-1]) > FAR_M:
                    raise ValueError
            except ValueError as error:
                raise DataError(
                    f"{self.path}, line {line}, has {text!r} in column {self.names[column] or column + 1}, which is "
                    f"not a finite number with a decimal point, up to {FAR_M:g}. "
                    f"{'Leave the cell empty if nothing was measured.' if missing else _ADVICE}"
                ) from error
        return np.array(found)


def read_table(path: Path) -> Table:
    """A table in a text file with one position a line, and perhaps what was measured there.

    Columns are separated by semicolons, tabs, commas or blanks: the first of these that is in the first line. A
    first line of names, after `#` or not, says which columns are x, y and z, in any order and among others. Without it
    there are three columns of numbers; others may hold words. Lines of nothing but separators, and what follows `#`,
    are left out. Raises `DataError` that names the line where one has more or fewer cells, as of decimal commas.
    """
    try:
        text = read_text(path).splitlines()
        lines = {number: bare for number, line in enumerate(text, start=1) if (bare := line.partition("#")[0].strip())}
        first = min(lines, default=1)
        separator = _separator(lines.get(first, ""))
        rows = {number: cells for number, line in lines.items() if any(cells := _cells(line, separator))}
        titles = [_cells(line.lstrip("# ").rpartition(":")[2].strip()) for line in text[: first - 1][-100:]]
    except (OSError, UnicodeError, csv.Error) as error:
        fault = error.strerror if isinstance(error, OSError) else error
        raise DataError(f"{path} cannot be read: {fault}. {_ADVICE}") from error
    names = rows.get(first, [])
    # a remark before the first position may name the columns, with separators of its own
    told = [cells for cells in titles if set("xyz") <= set(_axes(cells, _ANY_UNIT))]
    if all(map(_is_word, names)) or {"x", "y"} <= set(_axes(names, _ANY_UNIT)):
        rows.pop(first, None)
    elif told:  # as NumPy writes a header
        is_whole = len(told[-1]) == len(names)  # or it has other words too
        names = told[-1] if is_whole else [cell for cell in told[-1] if _ANY_UNIT.fullmatch(cell)]
    else:
        names = [""] * len(names)
    for number, cells in rows.items():
        if len(cells) != len(names):
            counts = f"{len(cells)} cells for {len(names)} columns"
            raise DataError(f"{path}, line {number}, is {lines[number]!r}, {counts}. {_ADVICE}")
    if not rows:
        raise DataError(f"{path} has no position. {_ADVICE}")
    return Table(path, names, list(zip(*rows.values(), strict=True)), list(rows))


def _separator(line: str) -> str:
    return next((each for each in ";\t, " if each in line), ",")


def _cells(line: str, separator: str = "") -> list[str]:
    separator = separator or _separator(line)
    spaced = " ".join(line.split()) if separator == " " else line
    return [cell.strip() for cell in next(csv.reader([spaced], delimiter=separator, skipinitialspace=True), [])]


def _axes(names: list[str], form: re.Pattern[str]) -> list[str]:
    return [found[1].lower() if (found := form.fullmatch(name)) else "" for name in names]


def _is_word(cell: str) -> bool:
    return not cell or (cell[0].isalpha() and cell.lower() not in ("nan", "inf"))
