"""Reads tables of positions as people, spreadsheets and programs write them; what has two meanings is refused."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import DataError
from xfreqbench.scene.model import FAR_M
from xfreqbench.system.files import read_text
from xfreqbench.types import FloatArray

_NAME = re.compile(r"([xyz])(?:_m| ?\[m\]| ?\(m\))?", re.IGNORECASE)
_ANY_UNIT = re.compile(r"([xyz])(?:_\w+| ?\[.*\]| ?\(.*\))?", re.IGNORECASE)
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?", re.IGNORECASE | re.ASCII)
_SEPARATORS = ";\t, "
_ADVICE = (
    "Write x,y,z into its first line, and into every other line a position: x,y,z in metres, three finite numbers with "
    "decimal points. Columns of other names are left out."
)


def read_positions(path: Path) -> Float[FloatArray, "T 3"]:
    """Positions (T, 3) in metres from a text file with one a line.

    Columns are separated by semicolons, tabs, commas or blanks: the first of these that stands in the first line. A
    first line of names, after `#` or not, tells which columns are x, y and z, in any order and among others. Without it
    there are three columns of numbers; others may hold words. Lines of nothing but separators, and what follows `#`,
    are left out. Raises `DataError` that names the line, also for numbers with decimal commas and for a first column
    that may be an index.
    """
    try:
        text = read_text(path).splitlines()
        lines = {number: bare for number, line in enumerate(text, start=1) if (bare := line.partition("#")[0].strip())}
        first = min(lines, default=1)
        separator = _separator(lines.get(first, ""))
        rows = {number: cells for number, line in lines.items() if any(cells := _cells(line, separator))}
        titles = {number: _title(line) for number, line in enumerate(text[: first - 1], start=1)}
    except (OSError, UnicodeError, csv.Error) as error:
        fault = error.strerror if isinstance(error, OSError) else error
        raise DataError(f"{path} cannot be read: {fault}. {_ADVICE}") from error
    names = rows.get(first, [])
    told = [number for number, cells in titles.items() if set("xyz") <= set(_axes(cells, _ANY_UNIT))]
    if not any(map(_is_number, names)):
        rows.pop(first, None)
        columns = _named_columns(path, first, names)
    elif told:  # as NumPy writes a header
        title = titles[told[-1]]
        is_whole = len(title) == len(names)  # or it has other words too
        names = title if is_whole else [cell for cell in title if _ANY_UNIT.fullmatch(cell)]
        columns = _named_columns(path, told[-1], names)
    else:
        columns = _unnamed_columns(path, list(rows.values()))
    for number, cells in rows.items():
        if len(cells) != len(names) or not all(_is_position(cells[column]) for column in columns):
            raise DataError(f"{path}, line {number}, is {lines[number]!r}. {_ADVICE}")
    if not rows:
        raise DataError(f"{path} holds no position. {_ADVICE}")
    return np.array([[float(cells[column]) for column in columns] for cells in rows.values()])


def _separator(line: str) -> str:
    return next((each for each in _SEPARATORS if each in line), ",")


def _title(line: str) -> list[str]:
    """Cells of a remark before the first position, which may name the columns, with separators of its own."""
    words = line.lstrip("# ").rpartition(":")[2].strip()
    return _cells(words, _separator(words))


def _cells(line: str, separator: str) -> list[str]:
    spaced = " ".join(line.split()) if separator == " " else line
    return [cell.strip() for cell in next(csv.reader([spaced], delimiter=separator, skipinitialspace=True), [])]


def _named_columns(path: Path, line: int, names: list[str]) -> list[int]:
    axes = _axes(names, _NAME)
    if any(axes.count(axis) != 1 for axis in "xyz"):
        raise DataError(f"{path}, line {line}, is {', '.join(names)!r}, not x,y,z nor numbers. {_ADVICE}")
    return [axes.index(axis) for axis in "xyz"]


def _axes(names: list[str], form: re.Pattern[str]) -> list[str]:
    return [found[1].lower() if (found := form.fullmatch(name)) else "" for name in names]


def _unnamed_columns(path: Path, rows: list[list[str]]) -> list[int]:
    """The three columns that hold numbers, where the others hold words or nothing, and the first counts no lines."""
    columns = list(zip(*rows, strict=False))
    held = [n for n, cells in enumerate(columns) if not all(map(_is_word, cells))]
    first = list(columns[held[0]]) if held else []
    counts = first in ([str(n + start) for n in range(len(rows))] for start in (0, 1))
    is_index = counts and any("." in cell for n in held[1:] for cell in columns[n])
    is_header = [rows[0][n] for n in held] == ["0", "1", "2"]  # as pandas names the columns of an array
    if len(held) != 3 or (len(rows) > 1 and (is_index or is_header)):
        fault = f"{len(held)} columns of numbers" if len(held) != 3 else "0, 1, 2, …, which may count lines or columns,"
        raise DataError(f"{path} has {fault} and no names of columns. {_ADVICE}")
    return held


def _is_word(cell: str) -> bool:
    return not cell or (cell[0].isalpha() and cell.lower() not in ("nan", "inf"))


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _is_position(cell: str) -> bool:
    return _is_number(cell) and abs(float(cell)) <= FAR_M
