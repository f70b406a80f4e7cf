from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from xfreqbench.report.drawing.markdown import heading, literal, paragraph, plain, prose, table

PARSER = MarkdownIt("commonmark").enable(["table", "strikethrough"])
HOSTILE = (
    "a|b",
    "\\|",
    "a\\",
    "two\nlines",
    "`code`",
    "`",
    "<script>alert(1)</script>",
    "<https://example.org>",
    "[x](javascript:alert(1))",
    "![x](y.png)",
    "&lt;b&gt;",
    "*x* **y** _z_ __w__ ~~v~~ $m$",
    "snake_case, a < b & c > d, [low, high]",
    "# x #",
    "- x",
    "1. x",
    "> x",
    "===",
    "---",
    "    indented",
    "[x]: https://example.org",
    "<!-- xfreqbench report: end -->",
    "\x1b[31m \x00 \u202e \u2028",
)
TEXTS = st.sampled_from(HOSTILE) | st.text(max_size=20) | st.text("|\\`<>[]()*_#!&$~-=+.1a \n", max_size=12)


def shown(markdown: str) -> list[tuple[str, str]]:
    """The kinds of parts that a Markdown parser finds, with their texts."""
    parts = PARSER.parse(markdown)
    return [(part.type, part.content) for block in parts for part in (block, *(block.children or ()))]


def text_alone(parts: list[tuple[str, str]]) -> str:
    return "".join(content for kind, content in parts if kind in ("text", "text_special"))


def as_read(text: str) -> str:
    """What a reader of Markdown sees of a text: blanks at the ends of it do not count."""
    return plain(text).strip(" \t")


@settings(max_examples=300, derandomize=True)
@given(text=TEXTS)
def test_a_paragraph_of_any_text_is_that_text(text: str) -> None:
    parts = shown(paragraph(text))
    kinds = {kind for kind, _ in parts}
    assert kinds <= {"paragraph_open", "inline", "text", "text_special", "paragraph_close"}, (kinds, text)
    assert text_alone(parts).strip() == as_read(text).strip()


@settings(max_examples=300, derandomize=True)
@given(text=TEXTS)
def test_a_heading_of_any_text_is_that_text(text: str) -> None:
    parts = shown(f"## {heading(text)}")
    assert {kind for kind, _ in parts} <= {"heading_open", "inline", "text", "text_special", "heading_close"}
    assert text_alone(parts).strip() == as_read(text).strip()


@settings(max_examples=300, derandomize=True)
@given(cells=st.lists(st.tuples(TEXTS, TEXTS, TEXTS), min_size=1, max_size=3))
@example(cells=[(each, each, each) for each in HOSTILE])
def test_a_table_has_the_rows_and_columns_that_it_was_given(cells: list[tuple[str, str, str]]) -> None:
    parts = shown(table(("one", "two", "three"), cells))
    assert not [kind for kind, _ in parts if kind.startswith(("html", "link", "image", "em", "strong", "code", "s_"))]
    assert sum(kind == "tr_open" for kind, _ in parts) == 1 + len(cells)
    read = [content for kind, content in parts if kind == "inline"]
    assert len(read) == 3 * (1 + len(cells))


@pytest.mark.parametrize("text", ["x86_64", "a < b", "[0.1, 0.2]", "≤ 300 s", "hidden=128", "a & b", "½ (±)"])
def test_what_is_no_markup_stays_as_it_is(text: str) -> None:
    assert literal(text) == prose(text) == paragraph(f"x {text}")[2:] == text


def test_prose_keeps_its_code_and_no_other_markup() -> None:
    assert prose("as `fit_*` takes *it* `") == "as `fit_*` takes \\*it\\* \\`"
