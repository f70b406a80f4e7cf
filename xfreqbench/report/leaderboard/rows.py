"""The rows of a board: one for each configured method, with its records."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from math import nan
from statistics import mean, stdev

from xfreqbench.methods.contract import LANES, Budget
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.report.leaderboard.origins import machine_name
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.types import FloatArray

Configured = tuple[str, str, str | None, str]  # label, config as JSON, hash of the code, of the data's bytes
Runs = dict[tuple[str, int], RunRecord]  # by split and seed
Quantity = Callable[[RunRecord], float]
NO_LANE = ""
VERSION_DIGITS = 6


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
    def time_utc(self) -> str:
        """When its first record was made: of two versions of a method, the newer has the later time."""
        return min(record.time_utc for record in self.records)

    @property
    def budget(self) -> str:
        """The most that a fit may take, such as `≤ 300 s`; empty without a limit and for trivial predictors."""
        return lane_of(self.records[0])

    @cached_property
    def timing_machines(self) -> list[str]:
        """The machine of every fit whose budget is a time."""
        timed = [record for record in self.records if lane_of(record) and record.job.budget.max_seconds is not None]
        return [machine_name(record.hardware) for record in timed]

    @property
    def short_label(self) -> str:
        """The label without the budget, for a board whose rows have the same."""
        if not self.budget:
            return self.label
        return self.label.replace(f" ({self.budget})", "").replace(f", {self.budget}", "")

    @property
    def is_trivial(self) -> bool:
        """Whether this is a trivial predictor without options. Budget and seed do not matter, as it is not fitted."""
        return is_trivial(self.records[0])

    @property
    def is_external(self) -> bool:
        """Whether the predictions were made elsewhere and only scored here."""
        return self.records[0].external is not None

    @cached_property
    def drawn(self) -> dict[tuple[str, int], FloatArray]:
        """What `comparison.medians_of` has drawn, by split and number of resamples."""
        return {}

    @cached_property
    def differences(self) -> dict[tuple[tuple[str, ...], str], tuple[float, float]]:
        """What `Comparison.paired_difference` has found, by splits and the label of the other row of the board."""
        return {}

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
        averages = [mean(of_seed) for of_seed in values.values() if len(of_seed) == len(splits)]
        return stdev(averages) if len(averages) > 1 else nan


def board_rows(records: Sequence[RunRecord]) -> list[BoardRow]:
    """One row for each label, configuration, code and file of data; equal labels get an addition that differs."""
    by_config: dict[Configured, Runs] = {}
    editions = _editions(records)
    for record in records:
        label = _label(record)
        source = editions[label, record.external.sha256] if record.external else record.code_sha256
        is_fitted = not (is_trivial(record) or record.external)
        config, data = json.dumps(record.config, sort_keys=True), record.dataset_sha256 if is_fitted else ""
        found = by_config.setdefault((label, config, source, data), {})
        known = found.setdefault((record.job.split, record.job.seed), record)
        if known.dataset_sha256 == record.dataset_sha256:
            found[record.job.split, record.job.seed] = record
    rows = []
    for label, found in _by_unique_label(by_config).items():
        by_split: dict[str, tuple[RunRecord, ...]] = {}
        for split, seed in sorted(found):
            by_split[split] = (*by_split.get(split, ()), found[split, seed])
        rows.append(BoardRow(label, by_split))
    return rows


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


def _by_unique_label(by_config: Mapping[Configured, Runs]) -> dict[str, Runs]:
    """The runs of each row, by labels that differ.

    Equal labels get the time and the code of the row's first record, `mine (2026-11-28 10:02, code 3fa9c1)`, external
    predictions the hash of their file in place of the code. Where only the data differ, they get the hash of these, and
    a number where they are still equal.
    """
    rows = {key: next(iter(found.values())) for key, found in by_config.items()}
    versions: dict[str, set[tuple[str, str]]] = {}
    data_of: dict[tuple[str, ...], set[str]] = {}
    for key, record in rows.items():
        versions.setdefault(key[0], set()).add((key[1], version_of(record)))
        data_of.setdefault((*key[:2], version_of(record)), set()).add(key[3])
    named: dict[str, Runs] = {}
    for key, found in by_config.items():
        (label, config, _, data), record = key, rows[key]
        kind = "file" if record.external else "code"
        several = (
            [shown_time(record), f"{kind} {version_of(record)[:VERSION_DIGITS]}"] if len(versions[label]) > 1 else []
        )
        differing = [f"data {data[:7]}"] if len(data_of[label, config, version_of(record)]) > 1 else []
        name = f"{label} ({', '.join(several + differing)})" if several + differing else label
        others = (f"{name} #{number}" for number in count(2))
        named[next(label for label in chain([name], others) if label not in named)] = found
    return named


def version_of(record: RunRecord) -> str:
    """The hash of a method's code, or of its file of external predictions; `?` if unknown."""
    return (record.external.sha256 if record.external else record.code_sha256) or "?"


def shown_time(record: RunRecord) -> str:
    """When a record was made, in UTC to the minute: `2026-11-28 10:02`."""
    return record.time_utc[:16].replace("T", " ")


def _label(record: RunRecord) -> str:
    """The method's name and, in parentheses, options and budget that are not the defaults."""
    job = record.job
    if is_trivial(record):
        return job.method
    if record.external:
        return f"{job.method} (external)"
    differences = sorted(job.overrides)
    if job.budget != Budget():
        differences.append(budget_text(job.budget))
    return f"{job.method} ({', '.join(differences)})" if differences else job.method


def budget_text(budget: Budget) -> str:
    """The limits of a budget: `≤ 64,000 maps`."""
    limits = {"steps": budget.max_steps, "s": budget.max_seconds, "maps": budget.max_maps}
    return ", ".join(
        f"≤ {limit:{',' if unit == 'maps' else 'g'}} {unit}" for unit, limit in limits.items() if limit is not None
    )


def lane_of(record: RunRecord) -> str:
    """The budget as text; `NO_LANE` where there was none, and for trivial predictors and predictions made elsewhere."""
    return NO_LANE if is_trivial(record) or record.external else budget_text(record.job.budget)


LANE_NAMES = {budget_text(budget): name for name, budget in LANES.items()}


def is_trivial(record: RunRecord) -> bool:
    """Whether a record is of a trivial predictor without options that was run here."""
    return record.job.method in EVERY_TRIVIAL and not record.job.overrides and record.external is None


def median_ssim(record: RunRecord) -> float:
    """The median SSIM of a record's test maps."""
    return record.scores["ssim"].median
