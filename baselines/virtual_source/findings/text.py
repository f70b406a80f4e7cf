"""What a run learned as text: tables and numbers in Markdown, and files that replace those of the same record alone."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from xfreqbench.scene.glb_writer import is_own_model
from xfreqbench.system.files import require_own, require_space

ABSENT = "–"
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]  # a header, and rows of as many cells


def printable(text: object) -> str:
    """A text on one line, without what would steer a terminal or turn the order of letters round."""
    return "".join(letter if letter.isprintable() else " " for letter in str(text))


def literal(text: str) -> str:
    """A text as one line of Markdown that shows it as it is: nothing of it is markup."""
    return re.sub(r"[\\`*<>&$~|#\[\]]|(?<![^\W_])_|_(?![^\W_])", r"\\\g<0>", printable(text))


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table whose columns are as wide as their cells, for a terminal too; `None.` where it has no row."""
    lines = [[literal(cell) for cell in row] for row in (header, *rows)]
    if len(lines) == 1:
        return "None."
    widths = [max(3, *map(len, column)) for column in zip(*lines, strict=True)]
    lines.insert(1, ["-" * width for width in widths])
    padded = [[cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in padded)


def number(value: float, decimals: int) -> str:
    """A number as text, or a dash where it is nan."""
    return ABSENT if value != value else f"{value:.{decimals}f}"


def claim(record_id: str, first_line: str, text: Path, *models: Path) -> None:
    """See that a text, which begins with `first_line`, and its models may be written: nothing else's output is there.

    Raises `OutputExistsError` where something lies there that was not written for the same record, and `StorageError`.
    """
    written = text.read_text("utf-8", "replace") if text.is_file() else ""
    is_same = written.partition("\n")[0] == first_line

    def fault_of(path: Path) -> str | None:
        is_ours = is_same and (path == text or is_own_model(path))
        return None if is_ours else f"was not written for record {record_id}"

    for path in (text, *models):
        require_own(path, fault_of)
    require_space(text, 1)
