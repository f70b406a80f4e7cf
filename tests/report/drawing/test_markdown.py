from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from xfreqbench.report.drawing.markdown import heading, literal, paragraph, plain, prose, table

PARSER = MarkdownIt("commonmark").enable(["table", "strikethrough"])
HOSTILE = (
    *("a|b", "\\|", "a\\", "two\nlines", "`code`", "`", "<script>alert(1)</script>", "<https://example.org>"),
    *("[x](javascript:alert(1))", "![x](y.png)", "&lt;b&gt;", "*x* **y** _z_ __w__ ~~v~~ $m$", "# x #", "- x", "1. x"),
    *("> x", "===", "---", "    indented", "[x]: https://example.org", "<!-- xfreqbench report: end -->"),
    *("snake_case, a < b & c > d, [low, high]", "\x1b[31m \x00 \u202e \u2028"),
)
TEXTS = st.sampled_from(HOSTILE) | st.text(max_size=20) | st.text("|\\`<>[]()*_#!&$~-=+.1a \n", max_size=12)


def shown(markdown: str) -> list[tuple[str, str]]:
    """The kinds of parts that a Markdown parser finds, with their texts."""
    parts = PARSER.parse(markdown)
    return [(part.type, part.content) for block in parts for part in (block, *(block.children or ()))]


@pytest.mark.parametrize("block", ["paragraph", "heading"])
@settings(max_examples=150)
@given(text=TEXTS)
def test_a_paragraph_or_a_heading_of_any_text_is_that_text(block: str, text: str) -> None:
    parts = shown(paragraph(text) if block == "paragraph" else f"## {heading(text)}")
    kinds = {kind for kind, _ in parts}
    assert kinds <= {f"{block}_open", "inline", "text", "text_special", f"{block}_close"}, (kinds, text)
    read = "".join(content for kind, content in parts if kind in ("text", "text_special"))
    assert read.strip() == plain(text).strip(" \t").strip()  # blanks at the ends of a text are not seen


@settings(max_examples=100)
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
