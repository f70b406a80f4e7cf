"""Pictures and tables as a page shows them, and the mark by which a page is known as one of ours."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

SOFTWARE = (
    "xfreqbench"  # the mark in our figures and models, by which they are known when they are written over
)
_MEDIA = {"png": "image/png", "svg": "image/svg+xml"}


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure: its file's name, which ends in `png` or `svg`, what it shows in words, and its bytes."""

    name: str
    alt: str
    content: bytes

    @property
    def source(self) -> str:
        """The bytes as a `data:` address."""
        media = _MEDIA[self.name.rpartition(".")[2]]
        return f"data:{media};base64,{b64encode(self.content).decode()}"


@dataclass(frozen=True)
class PageTable:
    """Texts under their header; columns of numbers are aligned to the right, others to the left."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    @property
    def is_numeric(self) -> list[bool]:
        """For every column, whether each of its cells begins as a number does; False in a table without rows."""
        columns = list(zip(*self.rows, strict=True))
        if not columns:
            return [False] * len(self.header)
        return [all(text[:1] in "-−–+0123456789" for text in column) for column in columns]


def owner_mark(subject: str) -> Markup:
    """The element in a page's head that names what the page is about: a data set, a scene, or a record."""
    return Markup('<meta name="xfreqbench-subject" content="{}">').format(subject)


def is_of_subject(html: str, subject: str) -> bool:
    """Whether a text is a page that carries the mark of this subject."""
    return owner_mark(subject) in html
