"""Run records grouped into boards: runs that may be ranked together, one row for each configured method."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, count, groupby
from math import inf, isnan, nan
from statistics import mean, stdev
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import PROTOCOLS, VALIDATIONS
from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import quantiles, skill
from xfreqbench.methods.contract import TRIVIAL, Budget
from xfreqbench.report.leaderboard.origins import (
    Origin,
    RecordKey,
    data_identities,
    data_name,
    origin_labels,
    record_key,
    short_commit,
)
from xfreqbench.runs.records import NUM_QUANTILES, Job, RunRecord

Configured = tuple[str, str, str | None, str]  # label, config as JSON, hash of the code, of the data's bytes
Runs = dict[tuple[str, int], RunRecord]  # by split and seed
GroupKey = tuple[str, str, str]  # scene, identity of the data, protocol
Identity = Callable[[RunRecord], str]
_MAX_STEM_BYTES = 150  # a name of a file may have 255
Quantity = Callable[[RunRecord], float]


@dataclass(frozen=True)
class BoardRow:
    """One configured method, with its records for each split: one for each seed, by increasing seed."""

    label: str
    by_split: Mapping[str, tuple[RunRecord, ...]]

    @property
    def job(self) -> Job:
        """The job of its first record; the jobs of a row differ only in their split and seed."""
        return self.records[0].job

    @property
    def records(self) -> list[RunRecord]:
        """The records of all splits and seeds."""
        return [record for records in self.by_split.values() for record in records]

    @property
    def budget(self) -> str:
        """The most that a fit may take, such as `≤ 300 s`; empty without a limit and for trivial predictors."""
        return "" if self.is_trivial else _budget(self.job)

    @property
    def label_without_budget(self) -> str:
        """The label for a table that shows the budget in a column of its own."""
        if not self.budget:
            return self.label
        return self.label.replace(f" ({self.budget})", "").replace(f", {self.budget}", "")

    @property
    def is_trivial(self) -> bool:
        """Whether this is a trivial predictor without options. Budget and seed do not matter, as it is not fitted."""
        return _is_trivial(self.records[0])

    @property
    def is_external(self) -> bool:
        """Whether the predictions were made elsewhere and only scored here."""
        return self.records[0].external is not None

    @property
    def family(self) -> str:
        """`trivial`, `external`, `ablation` where options other than the device are not the defaults, or `learned`."""
        if self.is_trivial:
            return "trivial"
        if self.is_external:
            return "external"
        changed = [option for option in self.job.overrides if not option.startswith("device=")]
        return "ablation" if changed else "learned"

    def value(self, split: str, quantity: Quantity) -> float:
        """Mean of a quantity over the seeds of a split; nan where the split was not run."""
        return mean(map(quantity, self.by_split[split])) if split in self.by_split else nan

    def average(self, splits: Sequence[str], quantity: Quantity) -> float:
        """Mean of a quantity over splits; nan where one was not run, as means over other splits do not compare."""
        return mean(self.value(split, quantity) for split in splits)

    def num_seeds(self, splits: Sequence[str]) -> tuple[int, int]:
        """The smallest and the largest number of seeds that one of the splits was run with."""
        numbers = [len(self.by_split.get(split, ())) for split in splits]
        return min(numbers), max(numbers)

    def seed_spread(self, splits: Sequence[str], quantity: Quantity) -> float:
        """Standard deviation over seeds of the average over splits; nan with fewer than two seeds.

        It takes the seeds that all the splits were run with.
        """
        values: dict[int, list[float]] = {}
        for split in splits:
            for record in self.by_split.get(split, ()):
                values.setdefault(record.job.seed, []).append(quantity(record))
        averages = [mean(each) for each in values.values() if len(each) == len(splits)]
        return stdev(averages) if len(averages) > 1 else nan


@dataclass(frozen=True)
class Board:
    """Rows that may be ranked together: they share a data set, a protocol, and the versions of protocol and metrics.

    `data` identifies the data set by its recipe, or by the sha256 of its bytes; see `data_identities`. `settings` are
    those of the data of the oldest record. `sources` names the results that a record lies in, where those of
    the board lie in several.
    """

    scene: str
    data: str
    protocol: str
    pas_kind: str
    settings: Mapping[str, Any]
    splits: tuple[str, ...]
    rows: tuple[BoardRow, ...]
    sources: Mapping[RecordKey, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Scene, protocol and kind of map, as a heading."""
        return f"{self.scene} · {self.protocol} · {self.pas_kind} maps"

    @property
    def records(self) -> list[RunRecord]:
        """The records of all rows."""
        return [record for row in self.rows for record in row.records]

    @property
    def data_name(self) -> str:
        """The data set as it is shown: `office@1-3f9c2ab1`, or digits of a hash."""
        return data_name(self.scene, self.data)

    def is_of(self, dataset: PasDataset) -> bool:
        """Whether the records are of a data set, whatever processor made its last digits."""
        same_bytes = any(record.dataset_sha256 == dataset.sha256 for record in self.records)
        return same_bytes or self.data == dataset.recipe.id

    @cached_property
    def origins(self) -> Mapping[Origin, str]:
        """A label for each origin of its records; empty where one machine made all of them from one file of data."""
        return origin_labels(self.records, self.origin)

    def origin(self, record: RunRecord) -> Origin:
        """The machine, code, data and results that a record comes from."""
        return Origin.of(record, self.sources)

    @property
    def slug(self) -> str:
        """What the file names of its figures begin with."""
        named = slug_of(f"{self.scene}-{self.protocol}")
        return f"{named}-{self.data_name.rpartition('@')[2] if '-' in self.data else self.data[:8]}"

    def best_trivial(self, split: str) -> float:
        """The largest median SSIM of the trivial predictors on a split; nan unless all of them were run."""
        return max((row.value(split, median_ssim) for row in self.trivial_rows(split)), default=nan)

    def trivial_rows(self, split: str) -> list[BoardRow]:
        """The rows of all trivial predictors on a split; none where one is missing: it might be the best."""
        rows = [row for row in self.rows if row.is_trivial and split in row.by_split]
        return rows if {row.job.method for row in rows} == set(TRIVIAL) else []

    def skill(self, record: RunRecord) -> float:
        """Skill of a record: its median SSIM against that of the best trivial predictor on the same split."""
        return skill(median_ssim(record), self.best_trivial(record.job.split))

    def split_sets(self) -> list[tuple[str, ...]]:
        """The sets of splits that rows were run on, the set that most rows cover first.

        Averages are compared over the same set only. Sets of a single split are left out, unless there are no
        larger ones.
        """
        sets = {frozenset(row.by_split) for row in self.rows}
        num_rows = {each: sum(each <= set(row.by_split) for row in self.rows) for each in sets}
        ordered = sorted(sets, key=lambda each: (-num_rows[each], -len(each), sorted(each)))
        shown = [each for each in ordered if len(each) > 1] or ordered
        return [tuple(split for split in self.splits if split in each) for each in shown]

    def lone_splits(self) -> list[str]:
        """Splits of rows that cover none of the sets of splits, such as ablations that were run at one carrier."""
        summed_up = {row.label for splits in self.split_sets() for row in self.rows_on(splits)}
        lone = {split for row in self.rows if row.label not in summed_up for split in row.by_split}
        return [split for split in self.splits if split in lone]

    def rows_on(self, splits: Sequence[str]) -> list[BoardRow]:
        """The rows that were run on all of these splits, the best average of median SSIM first."""
        rows = [row for row in self.rows if set(splits) <= set(row.by_split)]
        return sorted(rows, key=lambda row: (-row.average(splits, median_ssim), row.label))


def boards(
    records: Iterable[RunRecord],
    sources: Mapping[RecordKey, str] | None = None,
    identity: Identity | None = None,
) -> list[Board]:
    """One board for each data set and protocol, by scene, data set and the order of `PROTOCOLS`, then of `VALIDATIONS`.

    Data sets are told apart by `identity`, which is `data_identities` of the records where it is absent, and
    `sources` tells which results records lie in. Of a job that was run twice, the later record counts; of the same
    job on other bytes of the same data there is another row, but for trivial predictors, whose first stays. Raises
    `DataError` where records of a board are of different versions of the protocol or of the metrics, or test other
    samples.
    """
    every = list(records)
    data = identity or data_identities(every)

    def key(record: RunRecord) -> GroupKey:
        return record.scene, data(record), record.job.protocol

    ordered = sorted(every, key=lambda record: (*key(record), record.time_utc, record.id))
    grouped = [_board(of, list(group), sources or {}) for of, group in groupby(ordered, key)]
    order = {protocol: place for place, protocol in enumerate((*PROTOCOLS, *VALIDATIONS))}
    return sorted(grouped, key=lambda board: (board.scene, board.data, order.get(board.protocol, len(order))))


def slug_of(text: str) -> str:
    """The beginning of a text as the name of a file, with a hyphen for all that is no letter, digit or underscore."""
    return file_stem(re.sub(r"[^\w-]+", "-", text))


def file_stem(text: str) -> str:
    """The beginning of a text that is short enough for the name of a file."""
    return text.encode()[:_MAX_STEM_BYTES].decode("utf-8", "ignore")


def median_ssim(record: RunRecord) -> float:
    """The median SSIM of a record's test maps."""
    return record.scores["ssim"].median


def or_nan(value: float | None) -> float:
    """A number of a record, nan in place of None."""
    return nan if value is None else value


def pooled_quantiles(records: Sequence[RunRecord], metric: str) -> list[float]:
    """Quantiles from 0 to 1 of the scores of all seeds together; every seed tests equally many maps."""
    pooled = np.concatenate([record.scores[metric].quantiles for record in records])
    return quantiles(pooled, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist()


def short_name(split: str) -> str:
    """A split's name without its protocol: `lofo-2.4GHz` becomes `2.4GHz`."""
    starts = [f"{protocol}-" for protocol in (*PROTOCOLS, *VALIDATIONS) if split.startswith(f"{protocol}-")]
    return split.removeprefix(max(starts, key=len, default=""))


def comparable(record: RunRecord, identity: Identity) -> tuple[object, ...]:
    """What two records have to have in common to be ranked together; `identity` is that of their data."""
    versions = record.protocol_version, record.metrics_version
    return record.scene, identity(record), record.job.protocol, *versions


def _board(key: GroupKey, records: Sequence[RunRecord], sources: Mapping[RecordKey, str]) -> Board:
    versions = sorted({(record.protocol_version, record.metrics_version) for record in records})
    if len(versions) > 1:
        described = ", ".join(f"protocol {protocol} with metrics {metrics}" for protocol, metrics in versions)
        raise DataError(
            f"Records of {key[0]!r} and {key[2]!r} are of different versions ({described}) and cannot be "
            "ranked together. Delete the older lines and run those jobs again."
        )
    splits = sorted({record.job.split for record in records}, key=_natural)
    _require_same_samples(key, records)

    def place(row: BoardRow) -> tuple[float, str]:
        average = row.average(splits, median_ssim)
        return inf if isnan(average) else -average, row.label

    rows = sorted(_rows(records), key=place)
    data = records[0]  # all records of a board describe the same data set
    named = {sources.get(record_key(record), "") for record in records}
    told = sources if len(named) > 1 else {}
    return Board(*key, data.pas_kind, data.settings, tuple(splits), tuple(rows), told)


def _require_same_samples(key: GroupKey, records: Sequence[RunRecord]) -> None:
    """Raise `DataError` for records of two files of data that test other samples on a split of the same name."""
    first: dict[str, RunRecord] = {}
    for each in records:
        known = first.setdefault(each.job.split, each)
        if each.dataset_sha256 != known.dataset_sha256 and each.split_sha256 != known.split_sha256:
            raise DataError(
                f"Records {known.id} and {each.id} of {data_name(*key[:2])} test other samples on the split "
                f"{each.job.split!r} ({known.num_test} and {each.num_test}), so that they cannot be ranked together: "
                "the data of one lack paths that those of the other have. Generate them anew with the default solver "
                "and number of rays, or leave out the results of one."
            )


def _rows(records: Sequence[RunRecord]) -> list[BoardRow]:
    """One row for each label, configuration, code and file of data; rows of equal labels are told apart."""
    by_config: dict[Configured, Runs] = {}
    editions = _editions(records)
    for record in records:
        label = _label(record)
        source = editions[label, record.external.sha256] if record.external else record.code_sha256
        is_fitted = not (_is_trivial(record) or record.external)
        config, data = json.dumps(record.config, sort_keys=True), record.dataset_sha256 if is_fitted else ""
        found = by_config.setdefault((label, config, source, data), {})
        known = found.setdefault((record.job.split, record.job.seed), record)
        if known.dataset_sha256 == record.dataset_sha256:
            found[record.job.split, record.job.seed] = record
    return [BoardRow(label, _by_split(found)) for label, found in _told_apart(by_config).items()]


def _editions(records: Sequence[RunRecord]) -> dict[tuple[str, str], str]:
    """For each label and file of external predictions, the hash of the first file of its row.

    Files of one method share a row, whether each holds a seed or a split, unless two hold the same split and seed.
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
    """The runs of each row by a label of its own.

    Equal labels get their commit added, then the first digits of the hash of their data, and then a number where they
    are still equal; external predictions get the first digits of their file's hash in place of a commit.
    """
    versions = {key: _version(next(iter(found.values()))) for key, found in by_config.items()}
    times = Counter(label for label, *_ in by_config)
    data_of: dict[tuple[str, str], set[str]] = {}
    for key, version in versions.items():
        data_of.setdefault((key[0], version), set()).add(key[3])
    named: dict[str, Runs] = {}
    for key, found in by_config.items():
        (label, *_, data), version = key, versions[key]
        name = label if times[label] == 1 else f"{label} @ {version}"
        name += f", data {data[:7]}" if len(data_of[label, version]) > 1 else ""
        others = (f"{name} #{number}" for number in count(2))
        named[next(each for each in chain([name], others) if each not in named)] = found
    return named


def _version(record: RunRecord) -> str:
    return record.external.sha256[:7] if record.external else short_commit(record.git_commit)


def _by_split(found: Mapping[tuple[str, int], RunRecord]) -> dict[str, tuple[RunRecord, ...]]:
    by_split: dict[str, tuple[RunRecord, ...]] = {}
    for split, seed in sorted(found):
        by_split[split] = (*by_split.get(split, ()), found[split, seed])
    return by_split


def _label(record: RunRecord) -> str:
    """The method's name and, in parentheses, options and budget that are not the defaults."""
    job = record.job
    if _is_trivial(record):
        return job.method
    if record.external:
        return f"{job.method} (external)"
    differences = sorted(job.overrides)
    if job.budget != Budget():
        differences.append(_budget(job))
    return f"{job.method} ({', '.join(differences)})" if differences else job.method


def _budget(job: Job) -> str:
    limits = {"steps": job.budget.max_steps, "s": job.budget.max_seconds}
    return ", ".join(f"≤ {limit:g} {unit}" for unit, limit in limits.items() if limit is not None)


def _is_trivial(record: RunRecord) -> bool:
    return record.job.method in TRIVIAL and not record.job.overrides and record.external is None


def _natural(name: str) -> tuple[int, list[tuple[float, str]]]:
    """Sort key under which 2.4GHz comes before 24.25GHz, and few training carriers before many."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return len(parts), [(float(part), "") if index % 2 else (0.0, part) for index, part in enumerate(parts)]
