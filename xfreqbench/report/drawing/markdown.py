"""Tables, texts and numbers as Markdown, aligned for a terminal too. Text from outside is never markup in it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from math import isnan

ABSENT = "–"
_MARKUP = re.compile(
    r"[\\`*$~]"  # escapes, code, emphasis, formulas, struck text
    r"|(?<=\])\("  # the address of a link or picture
    r"|<(?=[A-Za-z/!?])|&(?=#?\w+;)"  # tags, comments, addresses, entities
    r"|(?<![^\W_])_|_(?![^\W_])"  # emphasis; not within a word
)

Cells = Sequence[str]


def plain(text: str) -> str:
    """A text on one line: blanks in place of line ends, control characters and marks that turn the direction."""
    return "".join(
        " " if unicodedata.category(character)[0] == "C" or character in "\u2028\u2029" else character
        for character in text
    )


def literal(text: str) -> str:
    """A text as Markdown that shows it as it is, within a line or a cell: no tag, link, code or emphasis."""
    tags = {"<": "&lt;", "&": "&amp;"}
    return _MARKUP.sub(lambda found: tags.get(found[0], f"\\{found[0]}"), plain(text))


def prose(text: str) -> str:
    """As `literal`, but what stands between backticks is code."""
    parts = re.split("(`[^`]+`)", plain(text))
    return "".join(part if index % 2 else literal(part) for index, part in enumerate(parts))


def heading(text: str) -> str:
    """As `literal`, for a heading or the words of a picture."""
    return re.sub(r"[#\[\]]", r"\\\g<0>", literal(text))


def paragraph(text: str, inline: Callable[[str], str] = literal) -> str:
    """As `inline`, for a paragraph of its own, which is no list, quotation or heading whatever it begins with."""
    shown = inline(text).lstrip().replace("#", "\\#")
    start = re.match(r"[>+=\[-]|\d+(?=[.)])", shown)
    if not start:
        return shown
    number = start[0] if start[0].isdecimal() else ""
    return f"{number}\\{shown[len(number) :]}"


def table(header: Cells, rows: Iterable[Cells], inline: Callable[[str], str] = literal) -> str:
    """A Markdown table: the first column and columns of words aligned to the left, columns of numbers to the right.

    `inline`, either `literal` or `prose`, makes Markdown of a cell.
    """
    lines = [[inline(cell).replace("|", "\\|") for cell in row] for row in (header, *rows)]
    columns = list(zip(*lines, strict=True))
    widths = [max(3, *map(len, column)) for column in columns]
    like_number = re.compile(r"[-−–+±=∞]|\d|$")  # so begins a cell that is aligned to the right
    right = [index > 0 and all(map(like_number.match, column[1:])) for index, column in enumerate(columns)]
    rule = ["-" * (width - 1) + ":" if is_right else "-" * width for width, is_right in zip(widths, right, strict=True)]
    text = []
    for row in (lines[0], rule, *lines[1:]):
        cells = [
            cell.rjust(width) if is_right else cell.ljust(width)
            for cell, width, is_right in zip(row, widths, right, strict=True)
        ]
        text.append(f"| {' | '.join(cells)} |")
    return "\n".join(text)


def number(value: float, decimals: int) -> str:
    """A number as text, or a dash where it is nan."""
    return ABSENT if isnan(value) else f"{value:.{decimals}f}"


def with_interval(value: float, interval: tuple[float, float], decimals: int) -> str:
    """A number followed by its interval in brackets; without interval where that is nan."""
    low, high = (number(bound, decimals) for bound in interval)
    return number(value, decimals) if isnan(interval[0]) else f"{number(value, decimals)} [{low}, {high}]"
