"""What every page owes to its templates: escaping, strictness, and no request to anywhere."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest
from jinja2 import UndefinedError

from xfreqbench.report.drawing.templates import prose, render

HOSTILE = '"><script>alert(1)</script>'
TEMPLATES = [
    f"{room.name}/{file.name}"
    for room in files("xfreqbench.report").iterdir()
    if room.is_dir()
    for file in room.iterdir()
    if file.name.endswith(".html")
]


def test_values_are_escaped_and_our_own_style_is_not() -> None:
    html = render("drawing/page.html", title=HOSTILE)
    assert "<script" not in html and "&lt;script&gt;alert(1)" in html
    assert 'font: 15px/1.5 system-ui, -apple-system, "Segoe UI"' in html


def test_a_page_may_load_nothing_and_run_nothing_unless_it_says_so() -> None:
    html = render("drawing/page.html", title="empty")
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'\">"
    assert policy in html


def test_a_value_that_is_missing_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="title"):
        render("drawing/page.html")


def test_what_stands_between_backticks_is_code_and_all_of_it_is_escaped() -> None:
    assert prose("run `a < b` & wait") == "run <code>a &lt; b</code> &amp; wait"


@pytest.mark.parametrize("name", TEMPLATES)
def test_no_template_marks_a_value_as_safe(name: str) -> None:
    text = (files("xfreqbench.report") / name).read_text("utf-8")
    assert not re.search(r"\|\s*safe\b|autoescape", text)
