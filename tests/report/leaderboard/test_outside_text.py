"""Whatever text records hold, every board is made, with all its rows, and none of the text becomes markup."""

from __future__ import annotations

import json
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from tests.support.leaderboard_records import leaderboard_markdown, make_bench, make_followed, make_records, with_job
from tests.support.stored_records import external, make_record, store
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.report import BEGIN, END, report_text, write_report
from xfreqbench.runs.records import BenchFigure, BenchPoint, BenchRecord, RunRecord

PARSER = MarkdownIt("commonmark").enable(["table", "strikethrough"])
HOSTILE = (
    "$\\frac{1}$ a | b `x` [x](javascript:alert(1)) ![x](https://example.org/x.png) <br> &amp; a\\",
    '" onmouseover="alert(1)</script><script>alert(1)</script></summary></details>',
    f"$\\frac{{1}}$ _one_\ntwo\r\n\x00\x1b[31m 名前 🛰 \u202e\n{END}\n{BEGIN}" + "x" * 500,
    "- # 1. > ===",
)


def records_of(text: str) -> tuple[list[RunRecord], list[BenchRecord]]:
    """Records in which every text from outside is the one given."""
    split, method, machine = f"s{text}", f"m{text}", {"processor": text}
    common = {
        "scene": f"s{text}",
        "pas_kind": text,
        "settings": {"solver": text, "interactions": [text]},
        "hardware": machine,
        "software": machine,
        "git_commit": text,
        "findings": {text: text},
        "config": {"name": text},
        "recipe": f"1-{'d' * 64}",
    }
    runs = [record.model_copy(update=common) for record in make_records()]
    own = make_record(method, 0.7, **common)
    runs += [own, with_job(own, split=split), with_job(make_followed(method), overrides=(text,))]
    declared = {"sha256": "a" * 64, "hardware": text, "url": text}
    runs.append(external(method=method, external=declared, **common | {"hardware": {}}))
    runs[-2] = runs[-2].model_copy(update=common)
    guest = {"hardware": {"processor": f"other {text}"}, "dataset_sha256": "c" * 64}
    runs.append(make_record(f"guest {method}", 0.6, **common | guest))
    label = text.replace("`", "'")  # code in the notes and cells of a measurement is its own
    point = BenchPoint(series=label, label=label, x=1.0, y=2.0)
    figure = BenchFigure(x_label=label, y_label=label, log_x=True, points=(point,))
    cells = {"columns": (label, label), "rows": ((label, label),)}
    bench = make_bench(title=label, note=f"n{label}", command=f"c{label}", figure=figure, hardware=machine, **cells)
    return runs, [bench]


PLAIN = records_of("plain")


def markup_of(markdown: str) -> Counter[tuple[str, str]]:
    """How many parts of each kind Markdown has, HTML with its content; texts and their escapes do not count."""
    blocks = PARSER.parse(markdown)
    parts = [part for block in blocks for part in (block, *(block.children or ()))]
    kinds = Counter((part.type, part.tag) for part in parts if not part.type.startswith(("text", "inline")))
    return kinds - Counter({each: count for each, count in kinds.items() if each[0] == "softbreak"})


class _Tags(HTMLParser):
    def __init__(self, html: str) -> None:
        super().__init__()
        self.found: Counter[tuple[str, ...]] = Counter()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found[tag, *sorted(name for name, _ in attrs if name != "aria-sort")] += 1


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_of_a_record_is_markdown(text: str) -> None:
    markdown = leaderboard_markdown(*records_of(text))
    assert markup_of(markdown) == markup_of(leaderboard_markdown(*PLAIN))


@pytest.mark.parametrize("text", HOSTILE[:2])
def test_no_text_of_a_record_is_markdown_in_a_short_report(tmp_path: Path, text: str) -> None:
    hostile, plain = (
        report_text(store(tmp_path / name, *records_of(of)[0]), tmp_path / "all")
        for name, of in (("hostile", text), ("plain", "plain"))
    )
    findings = [PARSER.render(each.partition("## Findings")[2].partition("\n## ")[0]) for each in (hostile, plain)]
    assert _Tags(findings[0]).found == _Tags(findings[1]).found


@pytest.mark.slow
@pytest.mark.parametrize("text", HOSTILE[1:3])
def test_report_figures_and_page_are_made_of_any_text(tmp_path: Path, text: str) -> None:
    folder, (runs, benches) = tmp_path / "hostile", records_of(text)
    store(folder, *runs, *benches)
    before, after = "# Ours\n\n", "\n\nOur own end.\n"
    (folder / "BENCHMARK.md").write_text(f"{before}{BEGIN}\n{END}{after}", encoding="utf-8")
    for _ in range(2):  # a report is written over as well
        write_report(folder, folder / "BENCHMARK.md")
    written = (folder / "BENCHMARK.md").read_text(encoding="utf-8")
    assert written.startswith(before + BEGIN) and written.endswith(END + after)
    assert written.count(END) == written.count(BEGIN) == 1
    for figure in (folder / "figures").iterdir():
        assert "\x00" not in figure.read_text(encoding="utf-8")
    page = write_page(folder, folder / "page.html").read_text(encoding="utf-8")
    expected = write_page(store(folder / "plain", *PLAIN[0], *PLAIN[1]), folder / "plain.html").read_text(
        encoding="utf-8"
    )
    assert _Tags(page).found == _Tags(expected).found
    json.loads(page.partition('id="content">')[2].partition("</script>")[0])
