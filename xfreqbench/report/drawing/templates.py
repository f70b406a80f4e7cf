"""Web pages from Jinja2 templates: every value that a template shows is escaped, unless it is `Markup`."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from xfreqbench.report.drawing.three_js import three_js

_REPORT = "xfreqbench.report"


def render(template: str, package: str = _REPORT, **values: Any) -> str:
    """A page as HTML from a template of a package, such as `leaderboard/page.html` of `xfreqbench.report`.

    A template of another package may extend and import those of `xfreqbench.report`. Equal values give equal text. A
    value that the template names and nobody gives is an error.
    """
    return _environment(package).get_template(template).render(values)


@cache
def _environment(package: str = _REPORT) -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, ".") for name in (package, _REPORT)]),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["prose"] = prose
    environment.globals["file_text"] = _file_text
    environment.globals["three_js"] = lambda: Markup(three_js() or "")
    json_options = {"ensure_ascii": False, "allow_nan": False, "separators": (",", ":")}
    environment.policies["json.dumps_kwargs"] = json_options  # the filter `tojson` escapes < > & '
    return environment


def prose(text: str) -> Markup:
    """A text, escaped, in which what stands between backticks is code."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(text))))


def _file_text(name: str) -> Markup:
    """A style sheet or script of the package, such as `drawing/page.css`, as it is: both are our own."""
    loader = _environment().loader
    assert loader is not None
    return Markup(loader.get_source(_environment(), name)[0])
