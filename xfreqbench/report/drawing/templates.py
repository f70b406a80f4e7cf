"""Web pages from Jinja2 templates: every value that a template shows is escaped, unless it is `Markup`."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape


def render(template: str, **values: Any) -> str:
    """A page as HTML from a template of `xfreqbench.report`, such as `leaderboard/page.html`, and its values.

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
    environment.filters["prose"] = prose
    environment.globals["file_text"] = _file_text
    json_options = {"ensure_ascii": False, "allow_nan": False, "separators": (",", ":")}
    environment.policies["json.dumps_kwargs"] = json_options  # the filter `tojson` escapes < > & '
    return environment


def prose(text: str) -> Markup:
    """A text, escaped, in which what stands between backticks is code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def _file_text(name: str) -> Markup:
    """A style sheet or script of the package, such as `drawing/page.css`, as it is."""
    loader = _environment().loader
    assert loader is not None
    return Markup(loader.get_source(_environment(), name)[0])
