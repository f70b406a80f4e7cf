"""The leaderboard, made from records alone: the same records give the same bytes, anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from xfreqbench.board_tables import curve_table, split_tables, summary_table, summary_tables
from xfreqbench.boards import Board, boards, short_commit
from xfreqbench.captions import leak_statement, machine_name, machine_names, tracing
from xfreqbench.comparison import MIN_SEEDS, Comparison, Resampling
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.markdown import table
from xfreqbench.method import TRIVIAL
from xfreqbench.metrics import METRICS, NUM_RESAMPLES
from xfreqbench.published import published_section
from xfreqbench.records import RECORDS_FILE, BenchRecord, RunRecord, StoredRecords, read
from xfreqbench.report_figures import bench_figure, draw_bench, draw_board, figure_links
from xfreqbench.storage import require_space, storage_errors, write_text

BEGIN, END = "<!-- xfreqbench report: begin -->", "<!-- xfreqbench report: end -->"
_WHAT_WAS_RUN, _WHAT_WAS_RUN_TITLE = "benchmark", "What was run"
_BENCH_SECTIONS = {
    "generate": "Generator",
    "plain": "Generator",
    "render": "Rendering and training",
    "savings": "Savings",
    "scale-out": "Scale-out",
    "stress": "Stress",
}
_OTHER_BENCHES = "Other measurements"


@dataclass(frozen=True)
class WrittenReport:
    """The files of a report, itself first; `num_truncated` lines of the records were half a line."""

    paths: tuple[Path, ...]
    num_truncated: int


def leaderboard_markdown(records: Iterable[RunRecord], benches: Iterable[BenchRecord] = ()) -> str:
    """Tables of every data set and protocol, and of every measurement; with links to no figure.

    Raises `DataError` as `boards` does. Rows that lose to a trivial predictor stand as they are.
    """
    return _markdown(boards(records), latest_benches(benches), with_figures=False)


def leaderboard_summary(records: Iterable[RunRecord]) -> str:
    """The first table of every data set and protocol, to be read in a terminal."""
    return "\n\n".join(
        f"{board.title}. {leak_statement(board)}\n\n{summary_table(Comparison(board, splits))}"
        for board in boards(records)
        for splits in [*board.split_sets(), *((split,) for split in board.lone_splits())]
    )


def latest_benches(benches: Iterable[BenchRecord]) -> list[BenchRecord]:
    """Measurements in the order they were taken; of one taken twice, the later counts."""
    ordered = sorted(benches, key=lambda record: record.time_utc)
    latest = {(record.bench, record.title): record for record in ordered}
    return sorted(latest.values(), key=lambda record: (record.time_utc, record.title))


def write_report(results: Path, output_md: Path) -> WrittenReport:
    """Rebuild a Markdown report and its figures from `results`: a results folder, or one file of records.

    Text outside the two marker comments of an existing report is kept. Raises `DataError` where there are no
    records, `OutputExistsError` where `output_md` is no report, and `StorageError`.
    """
    stored = _read(results)
    before, after = _kept_text(output_md)
    ranked, benches = boards(stored.records), latest_benches(stored.benches)
    figures = [path for board in ranked for path in draw_board(board, output_md.parent)]
    figures += [draw_bench(record, output_md.parent) for record in benches if record.figure]
    generated = _markdown(ranked, benches, with_figures=True)
    write_text(output_md, f"{before}{BEGIN}\n\n{generated}\n{END}{after}")
    return WrittenReport((output_md, *figures), stored.num_truncated)


def _read(results: Path) -> StoredRecords:
    path = results / RECORDS_FILE if results.is_dir() else results
    stored = read(path)
    if not (stored.records or stored.benches):
        raise DataError(f"{path} holds no records. Run `xfreqbench run` first, or mend the path.")
    require_scores(path, stored.records)
    return stored


def require_scores(path: Path, records: Iterable[RunRecord]) -> None:
    """Raise `DataError` for the first record that lacks a metric, as no run leaves it."""
    for record in records:
        missing = METRICS.keys() - record.scores.keys()
        if missing:
            raise DataError(
                f"{path}: the record {record.id} has no {', '.join(sorted(missing))}. Delete its line; the run it "
                "stood for is then run again."
            )


def _markdown(ranked: Iterable[Board], benches: Sequence[BenchRecord], *, with_figures: bool) -> str:
    sections = [
        *_bench_section(
            "What was run", [each for each in benches if each.bench == _WHAT_WAS_RUN], with_figures
        ),
        *(_board_section(board, with_figures) for board in ranked),
        *_bench_sections([each for each in benches if each.bench != _WHAT_WAS_RUN], with_figures),
        _legend(),
    ]
    return "\n\n".join(sections) + "\n"


def _board_section(board: Board, with_figures: bool) -> str:
    resampling = Resampling()
    links = figure_links(board) if with_figures else {}
    parts = [
        f"## {board.title}",
        _conditions(board),
        *summary_tables(board, resampling),
        *curve_table(board),
        *_picture(links, "time", f"SSIM against seconds of fitting, {board.title}"),
        *split_tables(board, resampling),
        *_picture(links, "cdf", f"Distribution of SSIM, {board.title}"),
        *published_section(board.protocol),
    ]
    return "\n\n".join(parts)


def _picture(links: Mapping[str, str], name: str, title: str) -> list[str]:
    return [f"![{title}]({links[name]})"] if name in links else []


def _conditions(board: Board) -> str:
    """Where the data come from, what is shared between training and test, and whose times these are."""
    machines = machine_names(board.records)
    times = f"Times were taken on {'; '.join(machines)}. " if machines else ""
    commits = sorted({short_commit(record.git_commit) for record in board.records})
    seeds = sorted({record.job.seed for record in board.records})
    return (
        f"Data set `{board.dataset_sha256[:16]}`: {tracing(board)}. **{leak_statement(board)}** "
        f"{times}{_counted('Commit', commits)}; {_counted('seed', seeds)}."
    )


def _counted(name: str, values: Sequence[object]) -> str:
    return f"{name}{'s' if len(values) > 1 else ''} {', '.join(map(str, values))}"


def _bench_sections(benches: Sequence[BenchRecord], with_figures: bool) -> list[str]:
    order = [*dict.fromkeys(_BENCH_SECTIONS.values()), _OTHER_BENCHES]
    placed = sorted(benches, key=lambda record: order.index(_bench_title(record)))
    return [
        section
        for title, records in groupby(placed, _bench_title)
        for section in _bench_section(title, list(records), with_figures)
    ]


def _bench_title(record: BenchRecord) -> str:
    return _BENCH_SECTIONS.get(record.bench, _OTHER_BENCHES)


def _bench_section(title: str, benches: Sequence[BenchRecord], with_figures: bool) -> list[str]:
    return [f"## {title}", *(_bench(record, with_figures) for record in benches)] if benches else []


def _bench(record: BenchRecord, with_figures: bool) -> str:
    figure = [f"![{record.title}]({bench_figure(record)})"] if with_figures and record.figure else []
    taken = (
        f"{machine_name(record.hardware)}; commit {short_commit(record.git_commit)}; {record.time_utc[:10]}."
    )
    command = "\n".join(f"    {line}" for line in record.command.splitlines())
    heading = f"### {record.title}" if record.title != _WHAT_WAS_RUN_TITLE else ""
    parts = [heading, command, record.note, table(record.columns, record.rows), taken, *figure]
    return "\n\n".join(part for part in parts if part)


def _legend() -> str:
    metrics = [f"* **{name}**{_unit(name)}: {metric.description}" for name, metric in METRICS.items()]
    skill = "1 − (1 − SSIM) / (1 − SSIM of the best of " + ", ".join(TRIVIAL) + " on the same split)"
    lines = [
        *metrics,
        f"* **skill**: {skill}; negative below it. In every resample the best of them is found anew",
        f"* **[low, high]**: 95 % percentile interval of {NUM_RESAMPLES:,} bootstrap resamples, which draw "
        "transmitters with all their samples, the same ones for every method (paired), and seeds, whose deviations "
        "are widened as Student's t asks for their number. Of methods that are level, five pairs in a hundred may "
        "still be told apart",
        "* **rank**: best and worst place that the intervals of the differences leave open; not corrected for the "
        f"number of comparisons. A dash: fewer than {MIN_SEEDS} seeds, so not ranked (a trivial predictor has no seed)",
        "* **seeds**: fits of each split, over which every number is a mean. **± seeds**: their standard deviation",
        "* **best trivial reached after**: at the first point of the learning curve that stands as high, so at most",
        "* **fit s, ms/map, peak MiB**: means over splits and seeds",
        "* **published, other data**: median SSIM from the paper named below the table, of other data and another "
        "machine; not comparable",
    ]
    return "\n".join(["## What the columns say", "", *lines])


def _unit(name: str) -> str:
    return f" ({METRICS[name].unit})" if METRICS[name].unit else ""


def _kept_text(output_md: Path) -> tuple[str, str]:
    """What stands before and after the generated part."""
    require_space(output_md, 1)
    if not output_md.exists():
        return "# Benchmark\n\n", "\n"
    try:
        with storage_errors(output_md):
            text = output_md.read_text("utf-8")
    except UnicodeDecodeError as error:
        raise OutputExistsError(f"{output_md} exists and is not a text. Give another path.") from error
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise OutputExistsError(
            f"{output_md} exists and has no generated part to replace. Put {BEGIN!r} and {END!r} where it "
            "belongs, or give another path."
        )
    return before, after
