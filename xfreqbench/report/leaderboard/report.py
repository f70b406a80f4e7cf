"""The report in Markdown, made from stored records alone: equal records give equal bytes on every machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path

from xfreqbench.data.unseen_rooms import ROOM_PROTOCOLS
from xfreqbench.errors import OutputExistsError
from xfreqbench.report.drawing.markdown import heading, literal, paragraph, prose, table
from xfreqbench.report.leaderboard.boards import Board, boards, slug_of
from xfreqbench.report.leaderboard.captions import data_statement, leak_statement, legend, origin_statement
from xfreqbench.report.leaderboard.columns import BRIEF
from xfreqbench.report.leaderboard.comparison import Resampling, comparisons_of
from xfreqbench.report.leaderboard.figures import (
    bench_figure,
    draw_bench,
    draw_board,
    figure_links,
    require_own_figures,
)
from xfreqbench.report.leaderboard.origins import machine_name, short_commit
from xfreqbench.report.leaderboard.overview import main_scene, overview_markdown
from xfreqbench.report.leaderboard.paper import MapGrid, has_counterparts, paper_figures, paper_maps, paper_markdown
from xfreqbench.report.leaderboard.published import published_section
from xfreqbench.report.leaderboard.results import RankedResults, read_results
from xfreqbench.report.leaderboard.tables import curve_tables, ranking_table, ranking_tables, split_tables
from xfreqbench.runs.records import BenchRecord, RunRecord
from xfreqbench.system.files import require_own, require_space, write_text

BEGIN, END = "<!-- xfreqbench report: begin -->", "<!-- xfreqbench report: end -->"
_WHAT_WAS_RUN, _WHAT_WAS_RUN_TITLE = "benchmark", "What was run"
_BENCH_SECTIONS = {
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


@dataclass(frozen=True)
class WrittenReport:
    """The files that were written, the report first, then its figures.

    `num_truncated` counts records that were left out because only a part of their line was written.
    """

    paths: tuple[Path, ...]
    num_truncated: int


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


def write_report(results: Path | Sequence[Path], output_md: Path, details: Path | None = None) -> WrittenReport:
    """Write a Markdown report and its figures from `results`: results folders or files of records, one or several.

    With a folder `details` the report is a short one, and a page for each scene and one of the measurements are
    written there. In an existing page only the text between the two marker comments is replaced. Raises `DataError`
    where there are no records and as `boards` does, `OutputExistsError` where a page or a figure is another file,
    and `StorageError`.
    """
    found = read_results(results)
    if details is None:
        text = report_markdown(found.boards, found.benches)
        pages = [_Page(output_md, "Benchmark", text, found.boards, found.benches)]
    else:
        pages = _pages(found, output_md, details)
    _require_files_of_their_own([page.path for page in pages])
    kept = [_kept_text(page) for page in pages]
    for page in pages:
        require_own_figures(page.boards, page.benches, page.drawn, page.path.parent)
    figures = []
    for page, (before, after) in zip(pages, kept, strict=True):
        figures += [path for board in page.boards for path in draw_board(board, page.path.parent)]
        figures += [draw_bench(record, page.path.parent) for record in page.benches if record.figure]
        for link, draw in page.drawn.items():
            draw(page.path.parent / link)
            figures.append(page.path.parent / link)
        generated = page.generated.replace("<!--", "&lt;!--")  # no marker but ours
        write_text(page.path, f"{before}{BEGIN}\n\n{generated}\n{END}{after}")
    return WrittenReport((*(page.path for page in pages), *figures), found.num_truncated)


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


def _pages(found: RankedResults, output_md: Path, details: Path) -> list[_Page]:
    """The short report, a page for each scene, one of the paper's claims if it has any, and one of the measurements."""
    by_scene: dict[str, list[Board]] = {}
    for board in found.boards:
        by_scene.setdefault(board.scene, []).append(board)
    names = {scene: slug_of(scene) + ".md" for scene in by_scene}
    of_main = by_scene.get(main_scene(found.boards), [])
    has_paper = any(map(has_counterparts, of_main))
    folder = Path(os.path.relpath(details, output_md.parent)).as_posix()
    links = {scene: f"{folder}/{name}" for scene, name in names.items()}
    paper = []
    if has_paper:
        grids = paper_maps(of_main, found)
        drawn = paper_figures(of_main) | {link: partial(_draw_maps, grid) for link, grid in grids.items()}
        text = paper_markdown(of_main, grids)
        paper = [_Page(details / _PAPER_PAGE, "The paper's claims", text, drawn=drawn)]
    linked = links | ({"the paper's claims": f"{folder}/{_PAPER_PAGE}"} if has_paper else {})
    page_links = f"{folder}/{_MEASUREMENTS_PAGE}", f"{folder}/{_ROOMS_PAGE}"
    short = overview_markdown(found.boards, found.benches, linked, *page_links)
    of_rooms = [bench for bench in found.benches if bench.bench == ROOM_PROTOCOLS[0]]
    measured = [bench for bench in found.benches if bench not in of_rooms]
    rooms = [_Page(details / _ROOMS_PAGE, "Rooms that were never seen", _sections(of_rooms), (), of_rooms)]
    return [
        _Page(output_md, "Benchmark", short),
        *(
            _Page(details / names[scene], heading(scene), report_markdown(ranked, ()), ranked)
            for scene, ranked in by_scene.items()
        ),
        *paper,
        *(rooms if of_rooms else []),
        _Page(details / _MEASUREMENTS_PAGE, "Measurements", _sections(measured), (), measured),
    ]


def _sections(benches: Sequence[BenchRecord]) -> str:
    return "\n\n".join([*_what_was_run(benches), *_bench_sections(benches)]) + "\n"


def _draw_maps(grid: MapGrid, path: Path) -> None:
    from xfreqbench.report.leaderboard.plots import plot_map_grid

    names = [f"({', '.join(f'{coordinate:.1f}' for coordinate in position)}) m" for position in grid.tx_position_m]
    plot_map_grid(grid.columns, names, path)


def report_markdown(ranked: Iterable[Board], benches: Sequence[BenchRecord]) -> str:
    """The generated part of a whole report: tables of every board and of every measurement, with links to figures."""
    sections = [_what_was_run(benches), map(_board_section, ranked), _bench_sections(benches), [legend()]]
    return "\n\n".join(chain.from_iterable(sections)) + "\n"


def _what_was_run(benches: Sequence[BenchRecord]) -> list[str]:
    """The section of the benchmark's own records, which say which runs there were."""
    return _bench_section(_WHAT_WAS_RUN_TITLE, [bench for bench in benches if bench.bench == _WHAT_WAS_RUN])


def _board_section(board: Board) -> str:
    resampling, title = Resampling(), heading(board.title)
    links = figure_links(board)
    time = [f"![SSIM against seconds of fitting, {title}]({links['time']})"] if "time" in links else []
    parts = [
        f"## {title}",
        f"{prose(data_statement(board))}. **{leak_statement(board)}** {literal(origin_statement(board))}",
        *ranking_tables(board, resampling),
        *curve_tables(board),
        *time,
        *split_tables(board, resampling),
        f"![Distribution of SSIM, {title}]({links['cdf']})",
        *published_section(board.protocol),
    ]
    return "\n\n".join(parts)


def _bench_sections(benches: Sequence[BenchRecord]) -> list[str]:
    by_title: dict[str, list[BenchRecord]] = {title: [] for title in (*_BENCH_SECTIONS.values(), _OTHER_BENCHES)}
    for record in benches:
        if record.bench != _WHAT_WAS_RUN:
            by_title[_BENCH_SECTIONS.get(record.bench, _OTHER_BENCHES)].append(record)
    return [section for title, found in by_title.items() for section in _bench_section(title, found)]


def _bench_section(title: str, benches: Sequence[BenchRecord]) -> list[str]:
    return [f"## {title}", *map(_bench, benches)] if benches else []


def _bench(record: BenchRecord) -> str:
    taken = f"{machine_name(record.hardware)}; commit {short_commit(record.git_commit)}; {record.time_utc[:10]}."
    parts = [
        f"### {heading(record.title)}" if record.title != _WHAT_WAS_RUN_TITLE else "",
        "\n".join(f"    {line}" for line in record.command.splitlines()),
        paragraph(record.note, prose),
        table(record.columns, record.rows, prose),
        paragraph(taken),
        f"![{heading(record.title)}]({bench_figure(record)})" if record.figure else "",
    ]
    return "\n\n".join(part for part in parts if part)


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
