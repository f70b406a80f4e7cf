"""Run records grouped into boards: what may be ranked together, a row for every method as it was configured."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count, groupby
from math import inf, isnan, nan
from statistics import mean, stdev
from typing import Any

import numpy as np

from xfreqbench.errors import DataError
from xfreqbench.method import TRIVIAL, Budget
from xfreqbench.metrics import quantiles, skill
from xfreqbench.protocols import PROTOCOLS
from xfreqbench.records import NUM_QUANTILES, Job, RunRecord

Configured = tuple[str, str, str | None]  # label, config as JSON, hash of the code
Runs = dict[tuple[str, int], RunRecord]  # by split and seed
GroupKey = tuple[str, str, str]  # scene, data set's sha256, protocol
Quantity = Callable[[RunRecord], float]


@dataclass(frozen=True)
class Row:
    """One method as it was configured, with its records of each split: one a seed, in the seeds' order."""

    label: str
    by_split: Mapping[str, tuple[RunRecord, ...]]

    @property
    def job(self) -> Job:
        """What was run; jobs of a row differ in their split and seed alone."""
        return self.records[0].job

    @property
    def records(self) -> list[RunRecord]:
        """Records of every split and seed."""
        return [record for records in self.by_split.values() for record in records]

    @property
    def is_trivial(self) -> bool:
        """Whether this is a trivial predictor as it comes; budget and seed change nothing in it."""
        return _is_trivial(self.records[0])

    @property
    def is_external(self) -> bool:
        """Whether the predictions were made elsewhere, and only scored here."""
        return self.records[0].external is not None

    def value(self, split: str, quantity: Quantity) -> float:
        """Mean over the seeds; nan where the split was not run."""
        return mean(map(quantity, self.by_split[split])) if split in self.by_split else nan

    def average(self, splits: Sequence[str], quantity: Quantity) -> float:
        """Mean over the splits; nan where one was not run, for a mean of others is not comparable."""
        return mean(self.value(split, quantity) for split in splits)

    def num_seeds(self, splits: Sequence[str]) -> tuple[int, int]:
        """Fewest and most seeds of a split."""
        numbers = [len(self.by_split.get(split, ())) for split in splits]
        return min(numbers), max(numbers)

    def seed_spread(self, splits: Sequence[str], quantity: Quantity) -> float:
        """Standard deviation, over the seeds that all the splits were run with, of the average; nan below two."""
        values: dict[int, list[float]] = {}
        for split in splits:
            for record in self.by_split.get(split, ()):
                values.setdefault(record.job.seed, []).append(quantity(record))
        averages = [mean(each) for each in values.values() if len(each) == len(splits)]
        return stdev(averages) if len(averages) > 1 else nan


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
        return [record for row in self.rows for record in row.records]

    @property
    def slug(self) -> str:
        """Name of its figures."""
        return re.sub(r"[^\w-]+", "-", f"{self.scene}-{self.protocol}-{self.dataset_sha256[:8]}")

    def best_trivial(self, split: str) -> float:
        """Largest median SSIM of the trivial predictors in a split; nan where none was run."""
        trivial = (row.value(split, median_ssim) for row in self.rows if row.is_trivial)
        return max((value for value in trivial if not isnan(value)), default=nan)

    def skill(self, record: RunRecord) -> float:
        """Skill in SSIM over the best trivial predictor of the record's split."""
        return skill(median_ssim(record), self.best_trivial(record.job.split))

    def split_sets(self) -> list[tuple[str, ...]]:
        """Sets of splits that some row was run on, those of most rows first: averages over others don't compare.

        What was run on one split alone is not among them, unless there is nothing else.
        """
        sets = {frozenset(row.by_split) for row in self.rows}
        num_rows = {each: sum(each <= set(row.by_split) for row in self.rows) for each in sets}
        ordered = sorted(sets, key=lambda each: (-num_rows[each], -len(each), sorted(each)))
        shown = [each for each in ordered if len(each) > 1] or ordered
        return [tuple(split for split in self.splits if split in each) for each in shown]

    def lone_splits(self) -> list[str]:
        """Splits on which a row was run that is in none of the sets of splits, as ablations of one carrier are."""
        summed_up = {row.label for splits in self.split_sets() for row in self.rows_on(splits)}
        lone = {split for row in self.rows if row.label not in summed_up for split in row.by_split}
        return [split for split in self.splits if split in lone]

    def rows_on(self, splits: Sequence[str]) -> list[Row]:
        """Rows that were run on all of these splits, the best average of median SSIM first."""
        rows = [row for row in self.rows if set(splits) <= set(row.by_split)]
        return sorted(rows, key=lambda row: (-row.average(splits, median_ssim), row.label))


def boards(records: Iterable[RunRecord]) -> list[Board]:
    """Group records by data set and protocol, in the protocols' order; of one job run twice, the later counts.

    Raises `DataError` where a group mixes versions of the protocol or of the metrics.
    """
    ordered = sorted(records, key=lambda record: (*_group_key(record), record.time_utc, record.id))
    grouped = [_board(key, list(group)) for key, group in groupby(ordered, _group_key)]
    return sorted(grouped, key=lambda board: (board.scene, board.dataset_sha256, _place(board.protocol)))


def median_ssim(record: RunRecord) -> float:
    """Median SSIM over the test samples."""
    return record.scores["ssim"].median


def or_nan(value: float | None) -> float:
    """A number of a record; nan where nobody told it."""
    return nan if value is None else value


def family(row: Row) -> str:
    """`trivial` as it comes, `external`, `ablation` with other options, `learned`; a device is no option."""
    if row.is_trivial:
        return "trivial"
    if row.is_external:
        return "external"
    changed = [option for option in row.job.overrides if not option.startswith("device=")]
    return "ablation" if changed else "learned"


def pooled_quantiles(records: Sequence[RunRecord], metric: str) -> list[float]:
    """Quantiles from 0 to 1 of the samples of all seeds together: every seed tests as many."""
    pooled = np.concatenate([record.scores[metric].quantiles for record in records])
    return quantiles(pooled, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist()


def short_name(split: str) -> str:
    """The split's name without its protocol: `lofo-2.4GHz` → `2.4GHz`."""
    starts = [f"{protocol}-" for protocol in PROTOCOLS if split.startswith(f"{protocol}-")]
    return split.removeprefix(max(starts, key=len, default=""))


def short_commit(commit: str | None) -> str:
    """The first seven digits, and whether the source was edited; `?` where the commit is unknown."""
    digits, plus, changes = (commit or "?").partition("+")
    return digits[:7] + plus + changes


def _group_key(record: RunRecord) -> GroupKey:
    return record.scene, record.dataset_sha256, record.job.protocol


def _place(protocol: str) -> int:
    return PROTOCOLS.index(protocol) if protocol in PROTOCOLS else len(PROTOCOLS)


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
    rows.sort(key=lambda row: (-_or_lowest(row.average(splits, median_ssim)), row.label))
    data = records[0]  # of one data set, which they all describe alike
    return Board(*key, data.pas_kind, data.settings, tuple(splits), tuple(rows))


def _rows(records: Sequence[RunRecord]) -> list[Row]:
    """A row for every method as it was configured; where defaults changed since, the commit tells rows apart."""
    by_config: dict[Configured, Runs] = {}
    editions = _editions(records)
    for record in records:
        label = _label(record)
        source = editions[label, record.external.sha256] if record.external else record.code_sha256
        key = label, json.dumps(record.config, sort_keys=True), source
        by_config.setdefault(key, {})[record.job.split, record.job.seed] = record
    return [Row(label, _by_split(found)) for label, found in _told_apart(by_config).items()]


def _editions(records: Sequence[RunRecord]) -> dict[tuple[str, str], str]:
    """For every label and file of predictions from elsewhere, the first file of its row.

    Files of one method share a row, be they one a seed or one a split, unless they hold the same part.
    """
    files: dict[tuple[str, str], set[tuple[str, int]]] = {}
    for record in records:
        if record.external:
            parts = files.setdefault((_label(record), record.external.sha256), set())
            parts.add((record.job.split, record.job.seed))
    editions: dict[tuple[str, str], str] = {}
    taken: dict[tuple[str, str], set[tuple[str, int]]] = {}
    for file, parts in files.items():
        row = next((row for row in taken if row[0] == file[0] and not taken[row] & parts), file)
        taken[row] = taken.get(row, set()) | parts
        editions[file] = row[1]
    return editions


def _told_apart(by_config: Mapping[Configured, Runs]) -> dict[str, Runs]:
    """Runs by labels of which no two are equal: with their commit where the label alone is, or a number.

    Predictions from elsewhere have the first digits of their file's hash.
    """
    times = Counter(label for label, *_ in by_config)
    named: dict[str, Runs] = {}
    for (label, *_), found in by_config.items():
        version = _version(next(iter(found.values())))
        name = label if times[label] == 1 else f"{label} @ {version}"
        others = (f"{name} #{number}" for number in count(2))
        named[next(each for each in chain([name], others) if each not in named)] = found
    return named


def _by_split(found: Mapping[tuple[str, int], RunRecord]) -> dict[str, tuple[RunRecord, ...]]:
    by_split: dict[str, tuple[RunRecord, ...]] = {}
    for split, seed in sorted(found):
        by_split[split] = (*by_split.get(split, ()), found[split, seed])
    return by_split


def _version(record: RunRecord) -> str:
    return record.external.sha256[:7] if record.external else short_commit(record.git_commit)


def _label(record: RunRecord) -> str:
    """The method's name, with whatever differs from a plain run."""
    job = record.job
    if _is_trivial(record):
        return job.method
    if record.external:
        return f"{job.method} (external)"
    differences = sorted(job.overrides)
    if job.budget != Budget():
        limits = {"steps": job.budget.max_steps, "s": job.budget.max_seconds}
        differences += [f"≤ {limit:g} {unit}" for unit, limit in limits.items() if limit is not None]
    return f"{job.method} ({', '.join(differences)})" if differences else job.method


def _is_trivial(record: RunRecord) -> bool:
    return record.job.method in TRIVIAL and not record.job.overrides and record.external is None


def _or_lowest(value: float) -> float:
    return -inf if isnan(value) else value


def _natural(name: str) -> tuple[int, list[tuple[float, str]]]:
    """Sort key under which 2.4GHz comes before 24.25GHz, and few training carriers before many."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return len(parts), [(float(part), "") if index % 2 else (0.0, part) for index, part in enumerate(parts)]
