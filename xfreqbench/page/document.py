"""A report as one web page that loads nothing and runs nothing: facts, figures, tables and code."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template

_MEDIA = {"png": "image/png", "svg": "image/svg+xml"}
_OWNER = '<meta name="xfreqbench-subject" content="{}">'


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure by its file's name, what it shows in words, and its bytes; `png` or `svg`."""

    name: str
    alt: str
    content: bytes


@dataclass(frozen=True)
class Table:
    """Cells under their header; the first column and words stand to the left."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Link:
    """A file beside the page."""

    name: str
    text: str


Part = str | Picture | Table | Link


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it, in turn; a text is a paragraph with `code`, one with line ends all code."""

    title: str
    parts: Sequence[Part]


def document(
    title: str, lead: str, subject: str, facts: Mapping[str, str], sections: Sequence[Section]
) -> str:
    """The page as HTML; equal contents give equal text. `is_of_subject` tells whose it is."""
    return Template(_asset("document.html")).substitute(
        style=_asset("page.css") + _asset("document.css"),
        owner=_OWNER.format(escape(subject)),
        title=escape(title),
        lead=_prose(lead),
        facts="\n".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts.items()),
        sections="\n".join(map(_section, sections)),
    )


def is_of_subject(html: str, subject: str) -> bool:
    """Whether a text is a page that `document` made of this subject."""
    return _OWNER.format(escape(subject)) in html


def _section(section: Section) -> str:
    parts = "\n".join(_part(part, section.title) for part in section.parts)
    return f"<section>\n<h2>{escape(section.title)}</h2>\n{parts}\n</section>"


def _part(part: Part, title: str) -> str:
    if isinstance(part, Picture):
        return _picture(part)
    if isinstance(part, Table):
        return _table(part, title)
    if isinstance(part, Link):
        return f'<p><a href="{escape(part.name)}">{escape(part.text)}</a></p>'
    if "\n" in part:
        return f'<div class="scroll" role="region" aria-label="code" tabindex="0"><pre>{escape(part)}</pre></div>'
    return f"<p>{_prose(part)}</p>"


def _prose(text: str) -> str:
    return re.sub("`([^`]*)`", r"<code>\1</code>", escape(text))


def _picture(picture: Picture) -> str:
    media = _MEDIA[picture.name.rpartition(".")[2]]
    content = b64encode(picture.content).decode()
    return f'<figure><img alt="{escape(picture.alt)}" src="data:{media};base64,{content}"></figure>'


def _table(table: Table, title: str) -> str:
    numeric = [_is_numeric(column) for column in zip(*table.rows, strict=True)] or [False] * len(table.header)
    head = _cells(table.header, numeric, "th")
    body = "\n".join(f"<tr>{_cells(row, numeric, 'td')}</tr>" for row in table.rows)
    return (
        f'<div class="scroll" role="region" aria-label="{escape(title)}" tabindex="0"><table class="report">\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )


def _cells(texts: Iterable[str], numeric: Sequence[bool], tag: str) -> str:
    starts = [f"<{tag}>" if right else f'<{tag} class="words">' for right in numeric]
    return "".join(f"{start}{escape(text)}</{tag}>" for start, text in zip(starts, texts, strict=True))


def _is_numeric(column: Iterable[str]) -> bool:
    """Whether every cell begins as a number does."""
    return all(text[:1] in "-−–+0123456789" for text in column)


def _asset(name: str) -> str:
    return (files("xfreqbench.page") / name).read_text("utf-8")
