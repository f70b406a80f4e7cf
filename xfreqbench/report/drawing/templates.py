"""Web pages from Jinja2 templates: every value that a template shows is escaped, unless it is `Markup`."""

from __future__ import annotations

import re
import shlex
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

# The mark in our figures and models, by which they are known when they are replaced.
SOFTWARE = "xfreqbench"
# The colours of lines and points, on white paper and on dark: each has a contrast of 3 or more to both, and any two
# differ by 0.16 or more in OKLab. The first ones differ most.
COLOURS = (
    *("#0096fa", "#ff5f00", "#008700", "#be00a0", "#af9100", "#9600ff", "#cd0032", "#32a596"),
    *("#8c5a19", "#1e4bff", "#ff4ba0", "#af78ff", "#146e73", "#af7d91", "#7355aa", "#f500ff"),
)


def render(template: str, **values: Any) -> str:
    """A page as HTML from a template of `xfreqbench.report`, such as `leaderboard/page.html`.

    Equal values give equal text. A value that the template names and nobody gives is an error.
    """
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("xfreqbench.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"prose": prose, "quoted": shlex.quote, "literal": repr}
    # a style sheet or script of the package, such as `drawing/page.css`, as it is
    environment.globals["file_text"] = lambda name: Markup((files("xfreqbench.report") / name).read_text("utf-8"))
    json_options = {"ensure_ascii": False, "allow_nan": False, "separators": (",", ":")}
    environment.policies["json.dumps_kwargs"] = json_options  # the filter `tojson` escapes < > & '
    return environment


def prose(text: str) -> Markup:
    """A text, escaped, in which what stands between backticks is code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure: what it shows in words, and the bytes of its SVG."""

    alt: str
    content: bytes

    @property
    def source(self) -> str:
        """The bytes as a `data:` address."""
        return f"data:image/svg+xml;base64,{b64encode(self.content).decode()}"


@dataclass(frozen=True)
class PageTable:
    """Texts under their header; columns of numbers are aligned to the right, others to the left."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    @property
    def is_numeric(self) -> list[bool]:
        """For every column, whether each of its cells begins as a number does; False in a table without rows."""
        places = range(len(self.header))
        return [bool(self.rows) and all(row[at][:1] in "-−–+0123456789" for row in self.rows) for at in places]


def owner_mark(subject: str) -> Markup:
    """The element in a page's head that names what the page is about: a data set, a scene, or a record."""
    return Markup('<meta name="xfreqbench-subject" content="{}">').format(subject)


def is_of_subject(html: str, subject: str) -> bool:
    """Whether a text is a page that carries the mark of this subject."""
    return owner_mark(subject) in html
