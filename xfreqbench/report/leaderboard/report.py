"""The report in Markdown, made from stored records alone: equal records give equal bytes on every machine."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from xfreqbench.maps.metrics import METRICS, NUM_RESAMPLES
from xfreqbench.methods.contract import TRIVIAL
from xfreqbench.report.drawing.markdown import heading, literal, paragraph, prose, table
from xfreqbench.report.leaderboard.boards import Board, boards, short_commit
from xfreqbench.report.leaderboard.captions import (
    data_statement,
    leak_statement,
    machine_name,
    origin_statement,
)
from xfreqbench.report.leaderboard.columns import BRIEF, COSTS, metric_title
from xfreqbench.report.leaderboard.comparison import MIN_SEEDS, Resampling, comparisons_of
from xfreqbench.report.leaderboard.figures import (
    bench_figure,
    draw_bench,
    draw_board,
    figure_links,
    require_own_figures,
)
from xfreqbench.report.leaderboard.published import PUBLISHED_TITLE, published_section
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.report.leaderboard.tables import curve_tables, ranking_table, ranking_tables, split_tables
from xfreqbench.runs.records import BenchRecord, RunRecord
from xfreqbench.system.files import require_own, require_space, write_text

BEGIN, END = "<!-- xfreqbench report: begin -->", "<!-- xfreqbench report: end -->"
_WHAT_WAS_RUN, _WHAT_WAS_RUN_TITLE = "benchmark", "What was run"
_BENCH_SECTIONS = {
    "ceiling": "No methods: what is left for whom",
    "generate": "Generator",
    "peers": "Generator",
    "plain": "Generator",
    "render": "Rendering and training",
    "savings": "Savings",
    "scale-out": "Scale-out",
    "stress": "Stress",
}
_OTHER_BENCHES = "Other measurements"
_EXPLAINED_COSTS = ("seconds", "milliseconds", "memory", "parameters")


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
        f"{paragraph(board.title)}. {leak_statement(board)}\n\n{ranking_table(each, BRIEF)}"
        for board in boards(records)
        for each in comparisons_of(board)
    )


def write_report(results: Path | Sequence[Path], output_md: Path) -> WrittenReport:
    """Write a Markdown report and its figures from `results`: results folders or files of records, one or several.

    In an existing report only the text between the two marker comments is replaced. Raises `DataError` where there
    are no records and as `boards` does, `OutputExistsError` where `output_md` or a figure is another file, and
    `StorageError`.
    """
    found = read_results(results)
    before, after = _kept_text(output_md)
    require_own_figures(found.boards, found.benches, output_md.parent)
    figures = [path for board in found.boards for path in draw_board(board, output_md.parent)]
    figures += [draw_bench(record, output_md.parent) for record in found.benches if record.figure]
    generated = report_markdown(found.boards, found.benches).replace("<!--", "&lt;!--")  # no marker but ours
    write_text(output_md, f"{before}{BEGIN}\n\n{generated}\n{END}{after}")
    return WrittenReport((output_md, *figures), found.num_truncated)


def report_markdown(ranked: Iterable[Board], benches: Sequence[BenchRecord]) -> str:
    """The generated part of a report: tables of every board and of every measurement, with links to their figures."""
    was_run = [each for each in benches if each.bench == _WHAT_WAS_RUN]
    measured = [each for each in benches if each.bench != _WHAT_WAS_RUN]
    sections = [
        *_bench_section(_WHAT_WAS_RUN_TITLE, was_run),
        *map(_board_section, ranked),
        *_bench_sections(measured),
        _legend(),
    ]
    return "\n\n".join(sections) + "\n"


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
    by_title: dict[str, list[BenchRecord]] = {
        title: [] for title in (*_BENCH_SECTIONS.values(), _OTHER_BENCHES)
    }
    for record in benches:
        by_title[_BENCH_SECTIONS.get(record.bench, _OTHER_BENCHES)].append(record)
    return [section for title, found in by_title.items() for section in _bench_section(title, found)]


def _bench_section(title: str, benches: Sequence[BenchRecord]) -> list[str]:
    return [f"## {title}", *map(_bench, benches)] if benches else []


def _bench(record: BenchRecord) -> str:
    taken = (
        f"{machine_name(record.hardware)}; commit {short_commit(record.git_commit)}; {record.time_utc[:10]}."
    )
    parts = [
        f"### {heading(record.title)}" if record.title != _WHAT_WAS_RUN_TITLE else "",
        "\n".join(f"    {line}" for line in record.command.splitlines()),
        paragraph(record.note, prose),
        table(record.columns, record.rows, prose),
        paragraph(taken),
        f"![{heading(record.title)}]({bench_figure(record)})" if record.figure else "",
    ]
    return "\n\n".join(part for part in parts if part)


def _legend() -> str:
    skill = "1 − (1 − SSIM) / (1 − SSIM of the best of " + ", ".join(TRIVIAL) + " on the same split)"
    lines = [
        *(f"**{metric_title(name)}**: {metric.description}" for name, metric in METRICS.items()),
        "**mean**, **10th pct.**: mean SSIM of the test maps, and the SSIM that a tenth of them lies below",
        f"**skill**: {skill}; negative where a method is worse than that predictor, a dash unless all of them were "
        "run. Every resample finds the best predictor anew",
        f"**[low, high]**: 95 % percentile interval of {NUM_RESAMPLES:,} bootstrap resamples, which draw "
        "transmitters with all their samples, the same ones for every method (paired), and seeds, whose deviations "
        "are widened as Student's t asks for their number. Of a hundred pairs of equally good methods, five may "
        "still be told apart",
        "**rank**: best and worst place that the intervals of the differences leave open; not corrected for the "
        f"number of comparisons. A dash: fewer than {MIN_SEEDS} seeds, so not ranked (a trivial predictor has no seed)",
        "**seeds**: fits of each split, over which every number is a mean. **± seeds**: standard deviation of the "
        "average over the seeds",
        "**best trivial reached after**: time of the first point of the learning curve at which the SSIM is that of "
        "the best trivial predictor or higher; the fit may have reached it earlier",
        *(
            f"**{COSTS[name].title}**: {COSTS[name].hint}, mean over splits and seeds"
            for name in _EXPLAINED_COSTS
        ),
        f"**{PUBLISHED_TITLE}**: median SSIM from the paper named below the table, of other data and another "
        "machine; not comparable",
    ]
    return "\n".join(["## What the columns say", "", *(f"* {line}" for line in lines)])


def _kept_text(output_md: Path) -> tuple[str, str]:
    """Text before and after the generated part of a report, which is kept; raises `OutputExistsError`."""
    require_space(output_md, 1)
    if not require_own(output_md, _fault_of_report):
        return "# Benchmark\n\n", "\n"
    before, _, rest = output_md.read_text("utf-8").partition(BEGIN)
    return before, rest.partition(END)[2]


def _fault_of_report(path: Path) -> str | None:
    try:
        text = path.read_text("utf-8")
    except UnicodeDecodeError:
        return "is not a text"
    if END in text.partition(BEGIN)[2]:
        return None
    return f"has no generated part to replace: put {BEGIN!r} and {END!r} where it belongs"
