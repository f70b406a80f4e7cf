"""The report in Markdown, made from stored records alone: equal records give equal bytes on every machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from xfreqbench.errors import OutputExistsError
from xfreqbench.report.drawing.markdown import heading, literal, paragraph, prose, table
from xfreqbench.report.leaderboard.boards import Board, machine_name, short_commit, slug_of
from xfreqbench.report.leaderboard.captions import data_statement, leak_statement, legend, origin_statement
from xfreqbench.report.leaderboard.comparison import comparisons_of
from xfreqbench.report.leaderboard.figures import bench_figure, figures_of
from xfreqbench.report.leaderboard.overview import overview_markdown, worth
from xfreqbench.report.leaderboard.paper import paper_page
from xfreqbench.report.leaderboard.results import RankedResults, Results, read_results
from xfreqbench.report.leaderboard.side_by_side import NOTHING_WORSE, WORSE_HEADER, got_worse
from xfreqbench.report.leaderboard.tables import csv_tables, ranking_table, require_own_table, write_csv
from xfreqbench.report.leaderboard.unseen_rooms import ROOMS
from xfreqbench.runs.records import BenchRecord
from xfreqbench.system.files import require_own, require_space, write_text

BEGIN, END = "<!-- xfreqbench report: begin -->", "<!-- xfreqbench report: end -->"
_MOST_ROWS = 12  # of a measurement; all of them are in a file beside the page


@dataclass(frozen=True)
class _Page:
    """A file of a report: its title, its generated part, and the boards and measurements whose figures are beside it.

    `drawn` has what draws further figures, by the links to them.
    """

    path: Path
    title: str
    generated: str
    boards: Sequence[Board] = ()
    benches: Sequence[BenchRecord] = ()
    drawn: Mapping[str, Callable[[Path], None]] = field(default_factory=dict)

    @cached_property
    def figures(self) -> dict[Path, Callable[[Path], None]]:
        """What draws the figures of the page, by their files."""
        drawn = figures_of(self.boards, self.benches) | dict(self.drawn)
        return {self.path.parent / link: draw for link, draw in drawn.items()}

    @cached_property
    def tables(self) -> dict[Path, list[dict[str, Any]]]:
        """The files of CSV beside the page, with their rows."""
        folder, stem = self.path.parent, self.path.stem
        long = [bench for bench in self.benches if len(bench.rows) > _MOST_ROWS]
        return {folder / f"{stem}-{name}.csv": rows for name, rows in csv_tables(self.boards).items()} | {
            folder / _bench_csv(bench): _bench_rows(bench) for bench in long
        }

    @property
    def text(self) -> str:
        """The generated part, with links to the tables of its boards."""
        links = [f"[{path.name}]({path.name})" for path in self.tables if path.stem.startswith(f"{self.path.stem}-")]
        beside = f"\nEvery split, metric, cost, pair of methods and learning curve: {', '.join(links)}.\n"
        return self.generated.replace("<!--", "&lt;!--") + (beside if links else "")  # no marker but ours


def write_report(
    results: Results, output_md: Path | None, details: Path | None = None, since: Path | None = None
) -> list[Path]:
    """Write a Markdown report, its figures and tables from `results`: read ones, results folders or files of records.

    Returns the files, the report first, then other pages, then figures and tables. With a folder `details` the report
    is a short one, and a page for each scene, one of the paper's claims, one of unseen rooms and one of the
    measurements are written there, without `output_md` these alone. With earlier results `since` it says what got
    worse. In an existing page only the text between the two marker comments is replaced. Raises `DataError` where there
    are no records and as `boards` does, `OutputExistsError` where a page, a figure or a table is another file, and
    `StorageError`.
    """
    from xfreqbench.report.drawing.figures import require_own_figure

    found = read_results(results)
    pages = []
    if details is not None:
        pages = _pages(found, output_md or Path(), details, since)[0 if output_md is not None else 1 :]
    elif output_md is not None:
        text = report_markdown(found.boards, found.benches, _worse(found, since))
        pages = [_Page(output_md, "Benchmark", text, found.boards, found.benches)]
    places = [os.path.realpath(page.path) for page in pages]
    for page, place in zip(pages, places, strict=True):
        if places.count(place) > 1:
            raise OutputExistsError(
                f"Two pages of the report would both be {page.path}: each scene has a page of its name, beside "
                "measurements.md, paper.md and unseen-rooms.md. Give another --output or --details, or name the "
                "scene otherwise."
            )
    kept = [_kept_text(page) for page in pages]
    for page in pages:
        for path in page.figures:
            require_own_figure(path)
        for path in page.tables:
            require_own_table(path)
    for page, (before, after) in zip(pages, kept, strict=True):
        for path, draw in page.figures.items():
            draw(path)
        for path, rows in page.tables.items():
            write_csv(rows, path)
        write_text(page.path, f"{before}{BEGIN}\n\n{page.text}\n{END}{after}")
    return [page.path for page in pages] + [path for page in pages for path in (*page.figures, *page.tables)]


def report_text(results: Results, details: Path | None = None, since: Path | None = None) -> str:
    """The report as a text that has every metric in itself, or the short one of `write_report` with `details`.

    Raises `DataError` as `write_report` does.
    """
    found = read_results(results)
    if details is not None:
        return _pages(found, Path(), details, since)[0].text
    return _Page(Path(), "", report_markdown(found.boards, found.benches, _worse(found, since), is_alone=True)).text


def _worse(found: RankedResults, since: Path | None) -> str:
    """The section on what got worse; empty without earlier results."""
    if since is None:
        return ""
    rows, most = got_worse(read_results(since).records, found.records), 6
    shown = f" The largest losses of {len(rows)}:" if len(rows) > most else ""
    caption = f"Average median SSIM beside that in {literal(since.stem)}, paired by transmitters.{shown}"
    said = table(WORSE_HEADER, rows[:most], prose) if rows else NOTHING_WORSE
    return f"## What got worse\n\n{caption}\n\n{said}"


def _pages(found: RankedResults, output_md: Path, details: Path, since: Path | None) -> list[_Page]:
    """The short report, a page for each scene, and those of claims, unseen rooms and measurements that there are."""
    by_scene: dict[str, list[Board]] = {}
    for board in found.boards:
        by_scene.setdefault(board.scene, []).append(board)
    folder = Path(os.path.relpath(details, output_md.parent)).as_posix()
    pages = [
        (
            scene,
            _Page(details / f"{slug_of(scene)}.md", heading(scene), report_markdown(ranked, (), worth(ranked)), ranked),
        )
        for scene, ranked in by_scene.items()
    ]
    claims = ""
    if paper := paper_page(found):
        claims, text, drawn = paper
        pages.append(("the paper's claims", _Page(details / "paper.md", "The paper's claims", text, drawn=drawn)))
    if of_rooms := [bench for bench in found.benches if bench.bench == ROOMS]:
        text = "\n\n".join(_bench_sections(of_rooms)) + "\n"
        pages.append((ROOMS, _Page(details / "unseen-rooms.md", "Rooms that were never seen", text, (), of_rooms)))
    others = [bench for bench in found.benches if bench.bench != ROOMS]
    text = "\n\n".join(_bench_sections(others)) + "\n"
    measurements = _Page(details / "measurements.md", "Measurements", text, (), others)
    links = {name: f"{folder}/{page.path.name}" for name, page in pages}
    measured = f"{folder}/{measurements.path.name}"
    short = overview_markdown(found.boards, found.benches, links, measured, claims, _worse(found, since))
    return [_Page(output_md, "Benchmark", short), *(page for _, page in pages), measurements]


def report_markdown(
    ranked: Iterable[Board], benches: Sequence[BenchRecord], more: str = "", is_alone: bool = False
) -> str:
    """The generated part of a whole report: tables of every board, what `more` says, and every measurement.

    If it `is_alone`, no files are beside it: there are no links, and every metric and row is in a table.
    """
    own = [bench for bench in benches if bench.bench == "benchmark"]
    others = [bench for bench in benches if bench.bench != "benchmark"]
    shown = [_board_section(board, is_alone) for board in ranked]
    parts = [*_bench_sections(own, is_alone), *shown, more, *_bench_sections(others, is_alone), legend()]
    return "\n\n".join(filter(None, parts)) + "\n"


def _board_section(board: Board, is_alone: bool) -> str:
    title, link = heading(board.title), "" if is_alone else board.time_figure
    parts = [
        f"## {title}",
        f"{prose(data_statement(board))}. **{leak_statement(board)}** {literal(origin_statement(board))}",
    ]
    parts += [ranking_table(comparison, has_others=is_alone) for comparison in comparisons_of(board)]
    return "\n\n".join([*parts, *([f"![SSIM against seconds of fitting, {title}]({link})"] if link else [])])


def _bench_sections(benches: Sequence[BenchRecord], is_alone: bool = False) -> list[str]:
    titles = {
        "benchmark": "What was run",
        "unseen-rooms": "Unseen rooms",
        **dict.fromkeys(["generate", "peers", "plain"], "Generator"),
        "render": "Rendering and training",
        "savings": "Savings",
        "scale-out": "Scale-out",
        "stress": "Stress",
    }
    by_title: dict[str, list[str]] = {title: [] for title in (*titles.values(), "Other measurements")}
    for record in benches:
        by_title[titles.get(record.bench, "Other measurements")].append(_bench(record, is_alone))
    return [part for title, found in by_title.items() if found for part in (f"## {title}", *found)]


def _bench(record: BenchRecord, is_alone: bool) -> str:
    is_cut = len(record.rows) > _MOST_ROWS and not is_alone
    taken = f"{machine_name(record.hardware)}; commit {short_commit(record.git_commit)}; {record.time_utc[:10]}."
    parts = [
        f"### {heading(record.title)}",
        "\n".join(f"    {line}" for line in record.command.splitlines()),
        paragraph(record.note, prose),
        table(record.columns, record.rows[: _MOST_ROWS if is_cut else None], prose),
        f"[All {len(record.rows)} rows]({_bench_csv(record)})" if is_cut else "",
        paragraph(taken),
        f"![{heading(record.title)}]({bench_figure(record)})" if record.figure and not is_alone else "",
    ]
    return "\n\n".join(part for part in parts if part)


def _bench_csv(record: BenchRecord) -> str:
    """The link to the file of all rows of a measurement."""
    return f"{Path(bench_figure(record)).stem}.csv"


def _bench_rows(record: BenchRecord) -> list[dict[str, Any]]:
    """The rows of a measurement; columns of one name are numbered."""
    names = [
        f"{name} {place}" if record.columns.count(name) > 1 else name for place, name in enumerate(record.columns, 1)
    ]
    return [{"measurement": record.title, **dict(zip(names, row, strict=True))} for row in record.rows]


def _kept_text(page: _Page) -> tuple[str, str]:
    """Text before and after the generated part of a page, which is kept; raises `OutputExistsError`."""

    def fault_of(path: Path) -> str | None:
        try:
            text = path.read_text("utf-8")
        except UnicodeDecodeError:
            return "is not a text"
        if END in text.partition(BEGIN)[2]:
            return None
        return f"has no generated part to replace: put {BEGIN!r} and {END!r} where it belongs"

    require_space(page.path, 1)
    if not require_own(page.path, fault_of):
        return f"# {page.title}\n\n", "\n"
    before, _, rest = page.path.read_text("utf-8").partition(BEGIN)
    return before, rest.partition(END)[2]
