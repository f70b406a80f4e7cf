"""The report in Markdown, made from stored records alone: equal records give equal bytes on every machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain
from pathlib import Path

from xfreqbench.errors import OutputExistsError
from xfreqbench.report.drawing.markdown import heading, literal, paragraph, prose, table
from xfreqbench.report.leaderboard.boards import Board, boards, slug_of
from xfreqbench.report.leaderboard.captions import data_statement, leak_statement, legend, origin_statement
from xfreqbench.report.leaderboard.columns import BRIEF
from xfreqbench.report.leaderboard.comparison import comparisons_of
from xfreqbench.report.leaderboard.figures import bench_figure, figures_of, time_link
from xfreqbench.report.leaderboard.origins import machine_name, short_commit
from xfreqbench.report.leaderboard.overview import main_scene, overview_markdown
from xfreqbench.report.leaderboard.paper import (
    CLAIMS_CAPTION,
    MapGrid,
    claims_table,
    has_counterparts,
    paper_figures,
    paper_maps,
    paper_markdown,
)
from xfreqbench.report.leaderboard.results import RankedResults, Results, read_results
from xfreqbench.report.leaderboard.side_by_side import NOTHING_WORSE, WORSE_HEADER, got_worse
from xfreqbench.report.leaderboard.tables import (
    CsvRow,
    csv_tables,
    measurement_rows,
    other_scores_table,
    ranking_table,
    ranking_tables,
    require_own_csv,
    write_csv,
)
from xfreqbench.report.leaderboard.unseen_rooms import ROOMS
from xfreqbench.runs.records import BenchRecord, RunRecord
from xfreqbench.system.files import require_own, require_space, write_text

BEGIN, END = "<!-- xfreqbench report: begin -->", "<!-- xfreqbench report: end -->"
_WHAT_WAS_RUN = "benchmark"
_BENCH_SECTIONS = {
    _WHAT_WAS_RUN: "What was run",
    "unseen-rooms": "Unseen rooms",
    "generate": "Generator",
    "peers": "Generator",
    "plain": "Generator",
    "render": "Rendering and training",
    "savings": "Savings",
    "scale-out": "Scale-out",
    "stress": "Stress",
}
_OTHER_BENCHES = "Other measurements"
_MEASUREMENTS_PAGE, _PAPER_PAGE, _ROOMS_PAGE = "measurements.md", "paper.md", "unseen-rooms.md"
_MOST_WORSE = 6
_MOST_ROWS = 12  # of a measurement; all of them stand in a file beside the page


@dataclass(frozen=True)
class WrittenReport:
    """The text of the report, and the files that were written, the report first, then its figures.

    `num_truncated` counts records that were left out because only a part of their line was written.
    """

    paths: tuple[Path, ...]
    num_truncated: int
    text: str


def leaderboard_summary(records: Iterable[RunRecord]) -> str:
    """The ranking of every data set and protocol in a few columns, to be read in a terminal.

    Raises as `boards` does.
    """
    return "\n\n".join(
        f"{paragraph(board.title)}. {leak_statement(board)}\n\n{ranking_table(comparison, BRIEF)}"
        for board in boards(records)
        for comparison in comparisons_of(board)
    )


@dataclass(frozen=True)
class _Page:
    """A file of a report: its title, its generated part, and the boards and measurements whose figures stand by it.

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
    def tables(self) -> dict[Path, list[CsvRow]]:
        """The files of CSV beside the page, with their rows."""
        folder, stem = self.path.parent, self.path.stem
        long = [bench for bench in self.benches if len(bench.rows) > _MOST_ROWS]
        return {folder / f"{stem}-{name}.csv": rows for name, rows in csv_tables(self.boards).items()} | {
            folder / _bench_csv(bench): measurement_rows(bench.title, bench.columns, bench.rows) for bench in long
        }

    @property
    def text(self) -> str:
        """The generated part, with links to the tables of its boards."""
        links = [f"[{path.name}]({path.name})" for path in self.tables if path.stem.startswith(f"{self.path.stem}-")]
        beside = f"\nEvery split, metric, cost, pair of methods and learning curve: {', '.join(links)}.\n"
        return self.generated.replace("<!--", "&lt;!--") + (beside if links else "")  # no marker but ours


def write_report(
    results: Results, output_md: Path | None, details: Path | None = None, since: Path | None = None
) -> WrittenReport:
    """Write a Markdown report, its figures and tables from `results`: read ones, results folders or files of records.

    Without `output_md` the report is not written, but returned as a text that has every metric in itself.
    With a folder `details` the report is a short one, and a page for each scene, one of the paper's claims, one of
    unseen rooms and one of the measurements are written there. With earlier results `since` it says what got worse.
    In an existing page only the text between the two marker comments is replaced. Raises `DataError` where there are
    no records and as `boards` does, `OutputExistsError` where a page, a figure or a table is another file, and
    `StorageError`.
    """
    from xfreqbench.report.drawing.figures import require_own_figure

    found = read_results(results)
    worse = _worse(found, since)
    if details is not None:
        report, *pages = _pages(found, output_md or Path(), details, worse)
    elif output_md is not None:
        text = report_markdown(found.boards, found.benches, worse)
        report, pages = _Page(output_md, "Benchmark", text, found.boards, found.benches), []
    else:
        report, pages = _Page(Path(), "Benchmark", report_markdown(found.boards, found.benches, worse, True)), []
    pages = [report, *pages] if output_md is not None else pages
    _require_files_of_their_own([page.path for page in pages])
    kept = [_kept_text(page) for page in pages]
    for page in pages:
        for path in page.figures:
            require_own_figure(path)
        for path in page.tables:
            require_own_csv(path)
    for page, (before, after) in zip(pages, kept, strict=True):
        for path, draw in page.figures.items():
            draw(path)
        for path, rows in page.tables.items():
            write_csv(rows, path)
        write_text(page.path, f"{before}{BEGIN}\n\n{page.text}\n{END}{after}")
    beside = [path for page in pages for path in (*page.figures, *page.tables)]
    return WrittenReport((*(page.path for page in pages), *beside), found.num_truncated, report.text)


def _worse(found: RankedResults, since: Path | None) -> list[str]:
    """The section on what got worse; empty without earlier results."""
    if since is None:
        return []
    rows = got_worse(read_results(since).records, found.records)
    shown = f" The largest losses of {len(rows)}:" if len(rows) > _MOST_WORSE else ""
    caption = f"Average median SSIM beside that in {literal(since.stem)}, paired by transmitters.{shown}"
    said = table(WORSE_HEADER, rows[:_MOST_WORSE], prose) if rows else NOTHING_WORSE
    return [f"## What got worse\n\n{caption}\n\n{said}"]


def _require_files_of_their_own(paths: Sequence[Path]) -> None:
    """Raise `OutputExistsError` where two pages would be one file."""
    places = [os.path.realpath(path) for path in paths]
    twice = next((path for path, place in zip(paths, places, strict=True) if places.count(place) > 1), None)
    if twice is not None:
        raise OutputExistsError(
            f"Two pages of the report would both be {twice}: each scene has a page of its name, beside "
            f"{_MEASUREMENTS_PAGE}, {_PAPER_PAGE} and {_ROOMS_PAGE}. Give another --output or --details, or name the "
            "scene otherwise."
        )


def _pages(found: RankedResults, output_md: Path, details: Path, worse: Sequence[str]) -> list[_Page]:
    """The short report, a page for each scene, and those of claims, unseen rooms and measurements that there are."""
    by_scene: dict[str, list[Board]] = {}
    for board in found.boards:
        by_scene.setdefault(board.scene, []).append(board)
    names = {scene: slug_of(scene) + ".md" for scene in by_scene}
    of_main = by_scene.get(main_scene(found.boards), [])
    folder = Path(os.path.relpath(details, output_md.parent)).as_posix()
    links = {scene: f"{folder}/{name}" for scene, name in names.items()}
    of_rooms = [bench for bench in found.benches if bench.bench == ROOMS]
    others = [bench for bench in found.benches if bench.bench != ROOMS]
    pages, claims = [], []
    if any(map(has_counterparts, of_main)):
        grids = paper_maps(of_main, found)
        drawn = paper_figures(of_main) | {link: partial(_draw_maps, grid) for link, grid in grids.items()}
        text = paper_markdown(of_main, grids)
        pages.append(_Page(details / _PAPER_PAGE, "The paper's claims", text, drawn=drawn))
        links["the paper's claims"] = f"{folder}/{_PAPER_PAGE}"
        claimed = claims_table(of_main)
        claims = [f"## The paper's claims\n\n{CLAIMS_CAPTION}\n\n{claimed}"] if claimed else []
    if of_rooms:
        text = "\n\n".join(_bench_sections(of_rooms)) + "\n"
        pages.append(_Page(details / _ROOMS_PAGE, "Rooms that were never seen", text, (), of_rooms))
        links[ROOMS] = f"{folder}/{_ROOMS_PAGE}"
    short = overview_markdown(
        found.boards, found.benches, links, f"{folder}/{_MEASUREMENTS_PAGE}", claims=claims, worse=worse
    )
    measured = "\n\n".join(_bench_sections(others)) + "\n"
    return [
        _Page(output_md, "Benchmark", short),
        *(
            _Page(details / names[scene], heading(scene), report_markdown(ranked, ()), ranked)
            for scene, ranked in by_scene.items()
        ),
        *pages,
        _Page(details / _MEASUREMENTS_PAGE, "Measurements", measured, (), others),
    ]


def _draw_maps(grid: MapGrid, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_map_grid

    names = [f"({', '.join(f'{coordinate:.1f}' for coordinate in position)}) m" for position in grid.tx_position_m]
    plot_map_grid(grid.columns, names, path)


def report_markdown(
    ranked: Iterable[Board], benches: Sequence[BenchRecord], worse: Sequence[str] = (), is_alone: bool = False
) -> str:
    """The generated part of a whole report: tables of every board and of every measurement, with links to figures.

    If it `is_alone`, no files are beside it: there are no links, and every metric and row is in a table.
    """
    own = [bench for bench in benches if bench.bench == _WHAT_WAS_RUN]
    others = [bench for bench in benches if bench.bench != _WHAT_WAS_RUN]
    shown = [_board_section(board, is_alone) for board in ranked]
    sections = [_bench_sections(own, is_alone), shown, worse, _bench_sections(others, is_alone), [legend()]]
    return "\n\n".join(chain.from_iterable(sections)) + "\n"


def _board_section(board: Board, is_alone: bool) -> str:
    title, link = heading(board.title), "" if is_alone else time_link(board)
    tables = ranking_tables(board)
    if is_alone:
        scores = map(other_scores_table, comparisons_of(board))
        tables = [part for pair in zip(tables, scores, strict=True) for part in pair]
    parts = [
        f"## {title}",
        f"{prose(data_statement(board))}. **{leak_statement(board)}** {literal(origin_statement(board))}",
        *tables,
        *([f"![SSIM against seconds of fitting, {title}]({link})"] if link else []),
    ]
    return "\n\n".join(parts)


def _bench_sections(benches: Sequence[BenchRecord], is_alone: bool = False) -> list[str]:
    by_title: dict[str, list[BenchRecord]] = {title: [] for title in (*_BENCH_SECTIONS.values(), _OTHER_BENCHES)}
    for record in benches:
        by_title[_BENCH_SECTIONS.get(record.bench, _OTHER_BENCHES)].append(record)
    shown = {title: [_bench(record, is_alone) for record in found] for title, found in by_title.items() if found}
    return [part for title, found in shown.items() for part in (f"## {title}", *found)]


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


def _kept_text(page: _Page) -> tuple[str, str]:
    """Text before and after the generated part of a page, which is kept; raises `OutputExistsError`."""
    require_space(page.path, 1)
    if not require_own(page.path, _fault_of_report):
        return f"# {page.title}\n\n", "\n"
    before, _, rest = page.path.read_text("utf-8").partition(BEGIN)
    return before, rest.partition(END)[2]


def _fault_of_report(path: Path) -> str | None:
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError:
        return "is not a text"
    if END in text.partition(BEGIN)[2]:
        return None
    return f"has no generated part to replace: put {BEGIN!r} and {END!r} where it belongs"
