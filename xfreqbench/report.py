"""The leaderboard, made from run records alone: the same records give the same bytes, anywhere."""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import groupby
from math import inf, isnan, nan
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.method import TRIVIAL, Budget
from xfreqbench.metrics import METRICS, skill
from xfreqbench.records import CURVE_SHARES, RECORDS_FILE, CurvePoint, Job, RunRecord, read
from xfreqbench.storage import require_space, storage_errors, write_text

BEGIN, END = "<!-- xfreqbench report: begin -->", "<!-- xfreqbench report: end -->"
FIGURES_FOLDER = "figures"  # beside the report
_ABSENT = "–"
_DECIMALS = {"ssim": 4, "ssim_wrapped": 4, "psnr": 2, "power_error": 2, "aoa_error": 2, "beam_loss": 3}
_TITLES = {
    "ssim_wrapped": "SSIM wrapped",
    "psnr": "PSNR",
    "power_error": "power error",
    "aoa_error": "AoA error",
    "beam_loss": "beam loss",
}

Cells = list[str]
GroupKey = tuple[str, str, str]  # scene, data set's sha256, protocol


@dataclass(frozen=True)
class Row:
    """One method as it was configured, with its record of each split."""

    label: str
    by_split: Mapping[str, RunRecord]

    @property
    def job(self) -> Job:
        """What was run; jobs of a row differ in their split alone."""
        return next(iter(self.by_split.values())).job

    def average(self, splits: Sequence[str], value: Callable[[RunRecord], float]) -> float:
        """Mean over the splits; nan where one was not run, for a mean of others is not comparable."""
        if any(split not in self.by_split for split in splits):
            return nan
        return sum(value(self.by_split[split]) for split in splits) / len(splits)


@dataclass(frozen=True)
class Board:
    """Rows that may be ranked together: one data set, one protocol, one version of each."""

    scene: str
    dataset_sha256: str
    protocol: str
    pas_kind: str
    settings: Mapping[str, Any]
    splits: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def title(self) -> str:
        """Scene, protocol and kind of map."""
        return f"{self.scene} · {self.protocol} · {self.pas_kind} maps"

    @property
    def records(self) -> list[RunRecord]:
        """Records of all rows."""
        return [record for row in self.rows for record in row.by_split.values()]

    @property
    def slug(self) -> str:
        """Name of its figure."""
        return re.sub(r"[^\w-]+", "-", f"{self.scene}-{self.protocol}-{self.dataset_sha256[:8]}")

    def best_trivial(self, split: str) -> float:
        """Largest median SSIM of the trivial predictors in a split; nan where none was run."""
        trivial = [record for record in self.records if record.job.split == split and _is_trivial(record.job)]
        return max(map(_median_ssim, trivial), default=nan)

    def skill(self, record: RunRecord) -> float:
        """Skill in SSIM over the best trivial predictor of the record's split."""
        return skill(_median_ssim(record), self.best_trivial(record.job.split))


def boards(records: Iterable[RunRecord]) -> list[Board]:
    """Group records by data set and protocol; of one job run twice, the later record counts.

    Raises `DataError` where a group mixes versions of the protocol or of the metrics.
    """
    ordered = sorted(records, key=lambda record: (*_group_key(record), record.time_utc, record.id))
    return [_board(key, list(group)) for key, group in groupby(ordered, _group_key)]


def leaderboard_markdown(records: Iterable[RunRecord], figures: Mapping[str, str] | None = None) -> str:
    """Tables of every data set and protocol; `figures` maps a board's slug to its figure's link.

    Raises `DataError` as `boards` does. Rows that lose to a trivial predictor stand as they are.
    """
    return _markdown(boards(records), figures or {})


def _markdown(ranked: Iterable[Board], figures: Mapping[str, str]) -> str:
    sections = [_section(board, figures.get(board.slug)) for board in ranked]
    return "\n\n".join([*sections, _legend()]) + "\n"


def leaderboard_summary(records: Iterable[RunRecord]) -> str:
    """The first table of every data set and protocol, to be read in a terminal."""
    return "\n\n".join(f"{board.title}. {_summary_tables(board)}" for board in boards(records))


def write_report(results: Path, output_md: Path) -> list[Path]:
    """Rebuild a Markdown report and its figures from `results`: a results folder, or one file of records.

    Text outside the two marker comments of an existing report is kept. Returns the files written. Raises
    `DataError` where there are no records, `OutputExistsError` where `output_md` is no report, and
    `StorageError`.
    """
    path = results / RECORDS_FILE if results.is_dir() else results
    records = read(path).records
    if not records:
        raise DataError(f"{path} holds no records. Run `xfreqbench run` first, or mend the path.")
    before, after = _kept_text(output_md)
    ranked = boards(records)
    figures = {board.slug: f"{FIGURES_FOLDER}/{board.slug}-cdf.svg" for board in ranked}
    for board in ranked:
        _draw_cdf(board, output_md.parent / figures[board.slug])
    generated = _markdown(ranked, figures)
    write_text(output_md, f"{before}{BEGIN}\n\n{generated}\n{END}{after}")
    return [output_md, *(output_md.parent / name for name in figures.values())]


def _group_key(record: RunRecord) -> GroupKey:
    return record.scene, record.dataset_sha256, record.job.protocol


def _board(key: GroupKey, records: Sequence[RunRecord]) -> Board:
    versions = sorted({(record.protocol_version, record.metrics_version) for record in records})
    if len(versions) > 1:
        described = ", ".join(f"protocol {protocol} with metrics {metrics}" for protocol, metrics in versions)
        raise DataError(
            f"Records of {key[0]!r} and {key[2]!r} are of different versions ({described}) and cannot be "
            "ranked together. Delete the older lines and run those jobs again."
        )
    splits = sorted({record.job.split for record in records}, key=_natural)
    rows = _rows(records)
    rows.sort(key=lambda row: (-_or_lowest(row.average(splits, _median_ssim)), row.label))
    data = records[0]  # of one data set, which they all describe alike
    return Board(*key, data.pas_kind, data.settings, tuple(splits), tuple(rows))


def _rows(records: Sequence[RunRecord]) -> list[Row]:
    """A row for every method as it was configured; where defaults changed since, the commit tells rows apart."""
    by_config: dict[tuple[str, str], dict[str, RunRecord]] = {}
    for record in records:
        key = _label(record), json.dumps(record.config, sort_keys=True)
        by_config.setdefault(key, {})[record.job.split] = record
    times = Counter(label for label, _ in by_config)
    return [
        Row(label if times[label] == 1 else f"{label} @ {_commit(by_split)}", by_split)
        for (label, _), by_split in by_config.items()
    ]


def _commit(by_split: Mapping[str, RunRecord]) -> str:
    return (next(iter(by_split.values())).git_commit or "?")[:7]


def _or_lowest(value: float) -> float:
    return -inf if isnan(value) else value


def _natural(name: str) -> tuple[int, list[tuple[float, str]]]:
    """Sort key under which 2.4GHz comes before 24.25GHz, and few training carriers before many."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return len(parts), [(float(part), "") if index % 2 else (0.0, part) for index, part in enumerate(parts)]


def _is_trivial(job: Job) -> bool:
    """Whether this is a trivial predictor as it comes; budget and seed change nothing in it."""
    return job.method in TRIVIAL and not job.overrides


def _label(record: RunRecord) -> str:
    """The method's name, with whatever differs from a plain run."""
    seed = [f"seed {record.job.seed}"] if record.job.seed else []
    return _labelled(record.job, seed)


def _labelled(job: Job, more: Sequence[str] = ()) -> str:
    if _is_trivial(job):
        return job.method
    differences = [*job.overrides]
    if job.budget != Budget():
        limits = {"steps": job.budget.max_steps, "s": job.budget.max_seconds}
        differences += [f"≤ {limit:g} {unit}" for unit, limit in limits.items() if limit is not None]
    differences += more
    return f"{job.method} ({', '.join(differences)})" if differences else job.method


def _median_ssim(record: RunRecord) -> float:
    return record.scores["ssim"].median


def _section(board: Board, figure: str | None) -> str:
    parts = [
        f"## {board.title}",
        _conditions(board),
        _summary_tables(board),
        *_curve_table(board),
        *(_split_table(board, split) for split in board.splits),
    ]
    if figure:
        parts.append(f"![Distribution of SSIM, {board.title}]({figure})")
    return "\n\n".join([*parts, *_published(board.protocol)])


def _conditions(board: Board) -> str:
    """Where the data come from, what is shared between training and test, and whose times these are."""
    machines = sorted({_machine(record.hardware) for record in board.records})
    sentences = [f"Data set `{board.dataset_sha256[:16]}`: {_tracing(board)}."]
    if any(record.shares_transmitters for record in board.records):
        sentences.append("Tested transmitters are trained on at other carriers.")
    return " ".join([*sentences, f"Times were taken on {'; '.join(machines)}."])


def _tracing(board: Board) -> str:
    settings = board.settings
    parts = [f"{board.pas_kind} maps"]
    if "solver" in settings:
        parts.append(f"{settings['solver']} solver")
    if "interactions" in settings:
        parts.append(" and ".join(settings["interactions"]) or "no interactions")
    if "max_depth" in settings:
        parts.append(f"depth {settings['max_depth']}")
    return ", ".join(parts)


def _machine(hardware: Mapping[str, str]) -> str:
    return ", ".join(_counted(value) if name == "cores" else value for name, value in hardware.items())


def _counted(cores: str) -> str:
    return "1 core" if cores == "1" else f"{cores} cores"


def _summary_tables(board: Board) -> str:
    """One table for every set of splits that a row was run on: averages over different ones don't compare.

    What was run on one split alone stands in that split's own table, unless there is nothing else.
    """
    sets = sorted(
        {frozenset(row.by_split) for row in board.rows}, key=lambda each: (-len(each), sorted(each))
    )
    shown = [splits for splits in sets if len(splits) > 1] or sets
    ordered = [tuple(split for split in board.splits if split in splits) for splits in shown]
    return "\n\n".join([*(_summary_table(board, splits) for splits in ordered), *_seed_lines(board)])


def _summary_table(board: Board, splits: Sequence[str]) -> str:
    counts = ["Gaussians"] if _counts_gaussians(board) else []
    costs = ["average", "skill", "fit s", "ms/map", "peak MiB"]
    header = ["method", *map(_short, splits), *costs, *counts]
    rows = [row for row in board.rows if set(splits) <= set(row.by_split)]
    rows.sort(key=lambda row: (-row.average(splits, _median_ssim), row.label))
    title = "Median SSIM (95 % bootstrap interval over transmitters), best average first:"
    return f"{title}\n\n{_table(header, [_summary_cells(board, row, splits) for row in rows])}"


def _summary_cells(board: Board, row: Row, splits: Sequence[str]) -> Cells:
    def average(value: Callable[[RunRecord], float], decimals: int) -> str:
        return _number(row.average(splits, value), decimals)

    return [
        row.label,
        *(_ssim_cell(row.by_split[split]) for split in splits),
        average(_median_ssim, 4),
        average(board.skill, 3),
        average(lambda record: record.fit_seconds, 2),
        average(lambda record: record.predict_ms_per_map, 2),
        average(lambda record: record.peak_memory_mib, 0),
        *([average(_num_gaussians, 0)] if _counts_gaussians(board) else []),
    ]


def _num_gaussians(record: RunRecord) -> float:
    return record.counts.get("gaussians", nan)


def _counts_gaussians(board: Board) -> bool:
    return any("gaussians" in record.counts for record in board.records)


def _seed_lines(board: Board) -> list[str]:
    """How much the seed alone changes each method that was run with several."""
    by_label: dict[str, list[Row]] = {}
    for row in board.rows:
        by_label.setdefault(_labelled(row.job), []).append(row)
    groups = sorted((label, rows) for label, rows in by_label.items() if len(rows) > 1)
    return ["\n".join(f"* {label}: {_over_seeds(board, rows)}." for label, rows in groups)] if groups else []


def _over_seeds(board: Board, rows: Sequence[Row]) -> str:
    seeds = ", ".join(str(seed) for seed in sorted(row.job.seed for row in rows))
    shared = [split for split in board.splits if all(split in row.by_split for row in rows)]
    columns = {_short(split): [row.average([split], _median_ssim) for row in rows] for split in shared}
    if len(shared) > 1:
        columns["average"] = [row.average(shared, _median_ssim) for row in rows]
    spreads = ", ".join(f"{name} {_spread(values)}" for name, values in columns.items()) or _ABSENT
    return f"median SSIM, mean ± standard deviation over seeds {seeds}: {spreads}"


def _spread(values: Sequence[float]) -> str:
    return f"{mean(values):.4f} ± {stdev(values):.4f}"


def _curve_table(board: Board) -> list[str]:
    """How soon each fit with a budget got where it got; nothing where no record says it."""
    followed = [
        (row.label, split, row.by_split[split])
        for row in board.rows
        for split in board.splits
        if split in row.by_split and row.by_split[split].curve
    ]
    if not followed:
        return []
    shares = [f"1/{1 / share:.0f}" for share in CURVE_SHARES]
    header = ["method", "split", *shares, "end"]
    rows = [[label, _short(split), *_curve_cells(record)] for label, split, record in followed]
    title = "Median SSIM on a fixed sample of test maps (after seconds of fitting), by share of the budget:"
    return [f"{title}\n\n{_table(header, rows)}"]


def _curve_cells(record: RunRecord) -> Cells:
    *points, end = record.curve
    spent = {point: record.job.budget.share(point.step, point.seconds) for point in points}
    reached = {max(filter(spent[point].__ge__, CURVE_SHARES)): point for point in points}
    return [*(_point_cell(reached.get(share)) for share in CURVE_SHARES), _point_cell(end)]


def _point_cell(point: CurvePoint | None) -> str:
    return f"{point.ssim:.4f} ({point.seconds:.3g} s)" if point else _ABSENT


def _split_table(board: Board, split: str) -> str:
    others = [name for name in METRICS if name != "ssim"]
    counts = ["Gaussians"] if _counts_gaussians(board) else []
    costs = ["fit s", "ms/map", "peak MiB", "parameters", *counts]
    header = ["method", "SSIM", "skill", *(f"{_TITLES[name]}{_unit(name)}" for name in others), *costs]
    tested = [row for row in board.rows if split in row.by_split]
    tested.sort(key=lambda row: -_median_ssim(row.by_split[split]))
    rows = [[row.label, *_split_cells(board, row.by_split[split], others)] for row in tested]
    record = tested[0].by_split[split]
    left_out = f"; {record.num_without_path} without any path are left out" if record.num_without_path else ""
    return (
        f"### {_short(split)}\n\nMedians over {record.num_test} samples{left_out}.\n\n{_table(header, rows)}"
    )


def _split_cells(board: Board, record: RunRecord, others: Sequence[str]) -> Cells:
    return [
        _ssim_cell(record),
        _number(board.skill(record), 3),
        *(_number(record.scores[name].median, _DECIMALS[name]) for name in others),
        _number(record.fit_seconds, 2),
        _number(record.predict_ms_per_map, 2),
        _number(record.peak_memory_mib, 0),
        f"{record.parameters:,}",
        *([_number(_num_gaussians(record), 0)] if _counts_gaussians(board) else []),
    ]


def _ssim_cell(record: RunRecord | None) -> str:
    if record is None:
        return _ABSENT
    low, high = record.scores["ssim"].interval
    return f"{_median_ssim(record):.4f} [{low:.4f}, {high:.4f}]"


def _published(protocol: str) -> list[str]:
    content = tomllib.loads((files("xfreqbench.baselines") / "paper_results.toml").read_text("utf-8"))
    tables = [table for table in content["table"] if table["protocol"] == protocol]
    if not tables:
        return []
    note = f"{content['citation']}: {content['conditions']}."
    return ["### Published, other data, not comparable", note, *map(_published_table, tables)]


def _published_table(table: Mapping[str, Any]) -> str:
    rows = [[name, *values] for name, values in table["rows"].items()]
    return f"{table['title']}:\n\n{_table(['method', *table['columns']], rows)}"


def _legend() -> str:
    metrics = [f"* **{name}**{_unit(name)}: {metric.description}" for name, metric in METRICS.items()]
    meaning = "1 − (1 − SSIM) / (1 − SSIM of the best of " + ", ".join(TRIVIAL) + " on the same split)"
    return "\n".join(["## What the columns say", "", *metrics, f"* **skill**: {meaning}; negative below it"])


def _table(header: Sequence[str], rows: Iterable[Cells]) -> str:
    """Markdown table whose columns line up in a terminal too: the first to the left, numbers to the right."""
    lines = [[_escaped(cell) for cell in row] for row in (header, *rows)]
    widths = [max(3, *map(len, column)) for column in zip(*lines, strict=True)]
    rule = ["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])]
    return "\n".join(_aligned(row, widths) for row in (lines[0], rule, *lines[1:]))


def _aligned(row: Cells, widths: Sequence[int]) -> str:
    cells = [row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))]
    return f"| {' | '.join(cells)} |"


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")


def _number(value: float, decimals: int) -> str:
    return _ABSENT if isnan(value) else f"{value:.{decimals}f}"


def _unit(name: str) -> str:
    return f" ({METRICS[name].unit})" if METRICS[name].unit else ""


def _short(split: str) -> str:
    """The split's name without its protocol: `lofo-2.4GHz` → `2.4GHz`."""
    return split.partition("-")[2] or split


def _draw_cdf(board: Board, path: Path) -> None:
    from xfreqbench.plots import plot_score_cdf  # matplotlib takes a second to load; tables need none

    panels = {
        _short(split): {
            row.label: row.by_split[split].scores["ssim"].quantiles
            for row in board.rows
            if split in row.by_split
        }
        for split in board.splits
    }
    plot_score_cdf(panels, "SSIM", path)


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
