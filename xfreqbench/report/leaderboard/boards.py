"""Run records grouped into boards: runs that may be ranked together, one row for each configured method."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib.resources import files
from itertools import chain, count, groupby
from math import inf, isnan, nan
from statistics import mean, stdev
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.recipe import recipe_name
from xfreqbench.data.splits import VALIDATIONS, protocols
from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import quantiles, skill
from xfreqbench.methods.contract import BUDGETS, Budget
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.runs.records import NUM_QUANTILES, Job, RunRecord
from xfreqbench.types import FloatArray


@cache
def published() -> dict[str, Any]:
    """Numbers that others published for other data, and which of our rows belong to which: `paper_results.toml`.

    They are shown beside ours and never ranked with them.
    """
    return tomllib.loads((files("xfreqbench.baselines") / "paper_results.toml").read_text("utf-8"))


def _median_ssim(record: RunRecord) -> float:
    """The median SSIM of a record's test maps."""
    return record.scores["ssim"].median


@dataclass(frozen=True)
class BoardRow:
    """One configured method, with its records for each split: one for each seed, by increasing seed."""

    label: str
    by_split: Mapping[str, tuple[RunRecord, ...]]

    @cached_property
    def records(self) -> list[RunRecord]:
        """The records of all splits and seeds."""
        return list(chain.from_iterable(self.by_split.values()))

    @property
    def job(self) -> Job:
        """The job of its first record; the jobs of a row differ only in their split and seed."""
        return self.records[0].job

    @property
    def time_utc(self) -> str:
        """When its first record was made: of two versions of a method, the newer has the later time."""
        return min(record.time_utc for record in self.records)

    @property
    def budget(self) -> str:
        """The most that a fit may take, such as `≤ 300 s`; empty without a limit and for trivial predictors."""
        return _lane_of(self.records[0])

    @cached_property
    def timing_machines(self) -> list[str]:
        """The machine of every fit whose budget is a time."""
        timed = [record for record in self.records if _lane_of(record) and record.job.budget.max_seconds is not None]
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
        return _is_trivial(self.records[0])

    @property
    def is_external(self) -> bool:
        """Whether the predictions were made elsewhere and only scored here."""
        return self.records[0].external is not None

    @property
    def changed(self) -> set[str]:
        """The options that are not the defaults, but for the device, as texts `key=value`."""
        return {option for option in self.job.overrides if not option.startswith("device=")}

    @property
    def family(self) -> str:
        """`trivial`, `external`, `ablation` where options other than the device are not the defaults, or `learned`."""
        if self.is_trivial or self.is_external:
            return "trivial" if self.is_trivial else "external"
        return "ablation" if self.changed else "learned"

    @property
    def whose(self) -> str:
        """`ours`, `reduced`, `authors' code`, `verified`, or `self-reported`; see the legend of a report."""
        if self.is_external or self.is_trivial:
            return "ours" if self.is_trivial else "self-reported"
        method = self.job.method
        named = {"reduced": published()["reduced"], **published()["whose"]}
        return next((whose for whose, methods in named.items() if method in methods), "self-reported")

    @cached_property
    def drawn(self) -> dict[str, FloatArray]:
        """What `comparison.medians_of` has drawn, by split."""
        return {}

    def average(self, splits: Sequence[str], quantity: Callable[[RunRecord], float] = _median_ssim) -> float:
        """Mean over splits of the mean over seeds; nan where one was not run, as means over other splits differ."""
        if not self.by_split.keys() >= set(splits):
            return nan
        return mean(mean(map(quantity, self.by_split[split])) for split in splits)

    def num_seeds(self, splits: Sequence[str]) -> tuple[int, int]:
        """The smallest and the largest number of seeds that one of the splits was run with."""
        numbers = [len(self.by_split.get(split, ())) for split in splits]
        return min(numbers), max(numbers)

    def seed_spread(self, splits: Sequence[str]) -> float:
        """Standard deviation over seeds of the average median SSIM; nan with fewer than two seeds.

        It takes the seeds that all the splits were run with.
        """
        values: dict[int, list[float]] = {}
        for record in chain.from_iterable(self.by_split.get(split, ()) for split in splits):
            values.setdefault(record.job.seed, []).append(_median_ssim(record))
        averages = [mean(of_seed) for of_seed in values.values() if len(of_seed) == len(splits)]
        return stdev(averages) if len(averages) > 1 else nan


@dataclass(frozen=True)
class Board:
    """Rows that may be ranked together: they share data, protocol, budget, and the versions of protocol and metrics.

    `data` is the recipe of the data set. `settings` are those of the data of the oldest record. `sources` names the
    results that a record lies in, by `record_key`, where those of the board lie in several. `lane` is the budget of
    its fits as text, empty where none has a budget; trivial predictors are not fitted, and are on the board of every
    budget.
    """

    scene: str
    data: str
    protocol: str
    lane: str
    pas_kind: str
    settings: Mapping[str, Any]
    splits: tuple[str, ...]
    rows: tuple[BoardRow, ...]
    sources: Mapping[tuple[str, Job, str], str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Scene, protocol, kind of map and budget, as a heading."""
        return " · ".join(filter(None, [self.scene, self.protocol, f"{self.pas_kind} maps", self.lane_title]))

    @property
    def lane_title(self) -> str:
        """The budget of its fits, with its name if it has one: `quick (≤ 64,000 maps)`."""
        named = (f"{name} ({self.lane})" for name, budget in BUDGETS.items() if budget_text(budget) == self.lane)
        return next(named, self.lane)

    @cached_property
    def records(self) -> list[RunRecord]:
        """The records of all rows."""
        return [record for row in self.rows for record in row.records]

    @cached_property
    def cells(self) -> dict[tuple[str, int], tuple[int, ...]]:
        """The cell of each tested transmitter, by split and their number; older records do not say it."""
        known = [record for record in self.records if record.cell_of_tx]
        return {(record.job.split, len(record.cell_of_tx)): record.cell_of_tx for record in known}

    @property
    def data_name(self) -> str:
        """The data set as it is shown: `office@2-3f9c2ab1`."""
        return recipe_name(self.scene, self.data)

    @property
    def is_imported(self) -> bool:
        """Whether its maps were not traced here, but published by others."""
        return "imported_from" in self.settings

    def is_of(self, dataset: PasDataset) -> bool:
        """Whether the records are of a data set; digits in which processors differ do not count."""
        same_bytes = any(record.dataset_sha256 == dataset.sha256 for record in self.records)
        return same_bytes or self.data == dataset.recipe.id

    def origin(self, record: RunRecord) -> tuple[str, str]:
        """Where a record comes from: machine, data and, where results lie in several, which; and the code's commit."""
        machine = "predicted elsewhere" if record.external else machine_name(record.hardware)
        source = self.sources.get(record_key(record))
        place = f"{machine}, data {record.dataset_sha256[:8]}" + (f", from {source}" if source else "")
        return place, short_commit(record.git_commit)

    @cached_property
    def origins(self) -> dict[tuple[str, str], str]:
        """A label for each origin, m1, m2, …, that of the oldest record first.

        It is empty where one machine made all from one file of data.
        """
        made = {(machine_name(each.hardware), each.dataset_sha256) for each in self.records if not each.external}
        ordered = map(self.origin, sorted(self.records, key=lambda record: (record.time_utc, record.id)))
        return {each: f"m{number}" for number, each in enumerate(dict.fromkeys(ordered), 1)} if len(made) > 1 else {}

    @property
    def slug(self) -> str:
        """What the file names of its figures begin with."""
        data = self.data_name.rpartition("@")[2]
        lane = re.sub("[^0-9a-z_]+", "", self.lane.replace(".", "_"))
        return f"{slug_of(f'{self.scene}-{self.protocol}')}-{data}" + (f"-{lane}" if lane else "")

    @property
    def time_figure(self) -> str:
        """The link from a report to the figure of error against time; empty where no fit has a learning curve."""
        return f"figures/{self.slug}-time.svg" if any(record.curve for record in self.records) else ""

    @cached_property
    def best_trivial(self) -> dict[str, float]:
        """The largest median SSIM of the trivial predictors, by splits; those without `trivial_rows` are left out."""
        trivial = {split: self.trivial_rows(split) for split in self.splits}
        return {split: max(row.average([split]) for row in rows) for split, rows in trivial.items() if rows}

    def trivial_rows(self, split: str) -> list[BoardRow]:
        """The rows of the trivial predictors on a split; none without one of `NEEDED_TRIVIAL`, which might be the best.

        Those that were added later count where they were run.
        """
        rows = [row for row in self.rows if row.is_trivial and split in row.by_split]
        return rows if set(NEEDED_TRIVIAL) <= {row.job.method for row in rows} else []

    def skill(self, record: RunRecord) -> float:
        """Skill of a record: its median SSIM against that of the best trivial predictor on the same split."""
        return skill(_median_ssim(record), self.best_trivial.get(record.job.split, nan))

    @cached_property
    def without_ablations(self) -> Board:
        """The board with all rows but those of ablations, perhaps with none."""
        return replace(self, rows=tuple(row for row in self.rows if row.family != "ablation"))

    def split_sets(self) -> list[tuple[str, ...]]:
        """The sets of splits that rows were run on, that with most runs of rows that cover it first.

        Averages are compared over one set only. Sets of a single split are left out, unless there are no larger ones.
        """
        sets = {frozenset(row.by_split) for row in self.rows}

        def num_runs(splits: frozenset[str]) -> int:
            return sum(len(row.by_split[split]) for row in self.rows if splits <= set(row.by_split) for split in splits)

        ordered = sorted(sets, key=lambda splits: (-num_runs(splits), -len(splits), sorted(splits)))
        shown = [splits for splits in ordered if len(splits) > 1] or ordered
        return [tuple(split for split in self.splits if split in splits) for splits in shown]

    def rows_on(self, splits: Sequence[str]) -> list[BoardRow]:
        """The rows that were run on all of these splits, the best average of median SSIM first."""
        rows = [row for row in self.rows if set(splits) <= set(row.by_split)]
        return sorted(rows, key=lambda row: (-row.average(splits), row.label))


def boards(
    records: Iterable[RunRecord], sources: Mapping[tuple[str, Job, str], str] | None = None, *, by_budget: bool = True
) -> list[Board]:
    """One board for each data set, protocol and budget.

    They are in the order of scenes, data sets, of newer physics first, `protocols()` and `VALIDATIONS`, and of runs.
    Without `by_budget` rows of all budgets share a board. Data sets are told apart by their recipes, and `sources`
    names the results that records lie in. Of a job that was run twice, the later record counts; of the same job on
    other bytes of the same data there is another row, but for trivial predictors, whose first stays. Raises
    `DataError` where records of a board are of different versions of the protocol or of the metrics, or test other
    samples.
    """

    def key(record: RunRecord) -> tuple[str, str, str]:
        return record.scene, record.recipe, record.job.protocol

    found = []
    ordered = sorted(records, key=lambda record: (*key(record), record.time_utc, record.id))
    for where, group in groupby(ordered, key):
        every = list(group)
        lanes = dict.fromkeys(_lane_of(record) for record in every if not _is_trivial(record)) if by_budget else ()
        for lane in lanes or [""]:
            of_lane = [each for each in every if not lanes or _is_trivial(each) or _lane_of(each) == lane]
            found.append(_board(where, lane, of_lane, sources or {}))
    order = {protocol: place for place, protocol in enumerate((*protocols(), *VALIDATIONS))}

    def place(board: Board) -> tuple[object, ...]:
        return board.data, order.get(board.protocol, len(order)), -len(board.records), _natural(board.lane)

    found.sort(key=place)
    found.sort(key=lambda board: _natural(board.data.partition("-")[0]), reverse=True)
    return sorted(found, key=lambda board: board.scene)


def _board(
    where: tuple[str, str, str], lane: str, records: Sequence[RunRecord], sources: Mapping[tuple[str, Job, str], str]
) -> Board:
    versions = sorted({(record.protocol_version, record.metrics_version) for record in records})
    if len(versions) > 1:
        described = ", ".join(f"protocol {protocol} with metrics {metrics}" for protocol, metrics in versions)
        raise DataError(
            f"Records of {where[0]!r} and {where[2]!r} are of different versions ({described}) and cannot be "
            "ranked together. Delete the older lines and run those jobs again."
        )
    splits = sorted({record.job.split for record in records}, key=_natural)
    require_same_samples(*where[:2], records)

    def place(row: BoardRow) -> tuple[float, str]:
        average = row.average(splits)
        return inf if isnan(average) else -average, row.label

    rows = sorted(_rows(records), key=place)
    data = records[0]  # all records of a board describe the same data set
    named = sources if len({sources.get(record_key(record), "") for record in records}) > 1 else {}
    return Board(*where, lane, data.pas_kind, data.settings, tuple(splits), tuple(rows), named)


def require_same_samples(scene: str, recipe: str, records: Sequence[RunRecord]) -> None:
    """Raise `DataError` for records of two files of data that test other samples on a split of the same name."""
    first: dict[str, RunRecord] = {}
    for record in records:
        known = first.setdefault(record.job.split, record)
        if record.dataset_sha256 != known.dataset_sha256 and record.split_sha256 != known.split_sha256:
            raise DataError(
                f"Records {known.id} and {record.id} of {recipe_name(scene, recipe)} test other samples on the split "
                f"{record.job.split!r} ({known.num_test} and {record.num_test}), so that they cannot be ranked "
                "together: the data of one lack paths that those of the other have. Generate them again with the "
                "default solver and number of rays, or leave out the results of one."
            )


def _rows(records: Sequence[RunRecord]) -> list[BoardRow]:
    """One row for each label, configuration, code and file of data.

    Rows with equal labels get an addition that differs: the time and the code of their first record,
    `mine (2026-11-28 10:02, code 3fa9c1)`, for external predictions the hash of their file in place of the code. Where
    only the data differ, they get the hash of these, and a number where they are still equal.
    """
    rows: dict[tuple[str, str, str | None, str], dict[tuple[str, int], RunRecord]] = {}
    editions = _editions(records)
    for record in records:
        label = _label(record)
        source = editions[label, record.external.sha256] if record.external else record.code_sha256
        data = "" if _is_trivial(record) or record.external else record.dataset_sha256
        found = rows.setdefault((label, json.dumps(record.config, sort_keys=True), source, data), {})
        known = found.setdefault((record.job.split, record.job.seed), record)
        if known.dataset_sha256 == record.dataset_sha256:
            found[record.job.split, record.job.seed] = record
    versions: dict[str, set[tuple[str, str]]] = {}
    data_of: dict[tuple[str, ...], set[str]] = {}
    for (label, config, _, data), found in rows.items():
        version, _ = version_of(next(iter(found.values())))
        versions.setdefault(label, set()).add((config, version))
        data_of.setdefault((label, config, version), set()).add(data)
    named: dict[str, BoardRow] = {}
    for (label, config, _, data), found in rows.items():
        first = next(iter(found.values()))
        version, time = version_of(first)
        kind = "file" if first.external else "code"
        added = [time, f"{kind} {version[:6]}"] if len(versions[label]) > 1 else []
        added += [f"data {data[:7]}"] if len(data_of[label, config, version]) > 1 else []
        name = f"{label} ({', '.join(added)})" if added else label
        name = next(each for each in chain([name], (f"{name} #{n}" for n in count(2))) if each not in named)
        by_split: dict[str, tuple[RunRecord, ...]] = {}
        for split, seed in sorted(found):
            by_split[split] = (*by_split.get(split, ()), found[split, seed])
        named[name] = BoardRow(name, by_split)
    return list(named.values())


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


def _label(record: RunRecord) -> str:
    """The method's name and, in parentheses, options and budget that are not the defaults."""
    job = record.job
    if _is_trivial(record):
        return job.method
    if record.external:
        return f"{job.method} (external)"
    differences = sorted(job.overrides) + ([budget_text(job.budget)] if job.budget != Budget() else [])
    return f"{job.method} ({', '.join(differences)})" if differences else job.method


def _lane_of(record: RunRecord) -> str:
    """The budget as text; empty where there was none, and for trivial predictors and predictions made elsewhere."""
    return "" if _is_trivial(record) or record.external else budget_text(record.job.budget)


def _is_trivial(record: RunRecord) -> bool:
    """Whether a record is of a trivial predictor without options that was run here."""
    return record.job.is_trivial and record.external is None


def budget_text(budget: Budget) -> str:
    """The limits of a budget: `≤ 64,000 maps`."""
    limits = {"steps": budget.max_steps, "s": budget.max_seconds, "maps": budget.max_maps}
    return ", ".join(
        f"≤ {limit:{',' if unit == 'maps' else 'g'}} {unit}" for unit, limit in limits.items() if limit is not None
    )


def version_of(record: RunRecord) -> tuple[str, str]:
    """The hash of a method's code or of its file of external predictions, `?` if unknown, and when the record was made.

    The time is in UTC to the minute: `2026-11-28 10:02`.
    """
    version = record.external.sha256 if record.external else record.code_sha256
    return version or "?", record.time_utc[:16].replace("T", " ")


def machine_name(hardware: Mapping[str, str]) -> str:
    """A machine in one line: its processor, cores, system, threads where they are fewer, and GPUs."""
    named = {name: f"{value} {name.removesuffix('s') if value == '1' else name}" for name, value in hardware.items()}
    return ", ".join(named[name] if name in ("cores", "threads") else value for name, value in hardware.items())


def short_commit(commit: str | None) -> str:
    """The first seven digits of a commit with the mark of an edited source; `?` where the commit is unknown."""
    digits, plus, changes = (commit or "?").partition("+")
    return digits[:7] + plus + changes


def record_key(record: RunRecord) -> tuple[str, Job, str]:
    """Values that identify a record, whichever file it is stored in: no two have id, job and time in common."""
    return record.id, record.job, record.time_utc


def comparable(record: RunRecord) -> tuple[object, ...]:
    """What two records have to have in common to be ranked together."""
    versions = record.protocol_version, record.metrics_version
    return record.scene, record.recipe, record.job.protocol, *versions


def pooled_quantiles(records: Sequence[RunRecord], metric: str) -> list[float]:
    """Quantiles from 0 to 1 of the scores of all records together; each of them tests equally many maps.

    Those of SSIM are of the samples where the records hold them. Of other metrics they are of the records' quantiles,
    of which the smallest and the largest stand for half a step of one per cent, and every other one for a whole step.
    """
    levels = np.linspace(0, 1, NUM_QUANTILES)
    if metric == "ssim" and all(record.ssim_by_tx for record in records):
        of_tx = chain.from_iterable(record.ssim_by_tx for record in records)
        return quantiles(np.fromiter(chain.from_iterable(of_tx), np.float64), levels.tolist()).tolist()
    weight = np.where((levels == 0) | (levels == 1), 0.5, 1.0)
    pooled = np.concatenate([record.scores[metric].quantiles for record in records])
    return np.quantile(pooled, levels, weights=np.tile(weight, len(records)), method="inverted_cdf").tolist()


def short_name(split: str) -> str:
    """A split's name without its protocol: `lofo-2.4GHz` becomes `2.4GHz`."""
    starts = [f"{protocol}-" for protocol in (*protocols(), *VALIDATIONS) if split.startswith(f"{protocol}-")]
    return split.removeprefix(max(starts, key=len, default=""))


def slug_of(text: str) -> str:
    """The beginning of a text as the name of a file, with a hyphen for all that is no letter, digit or underscore."""
    return re.sub(r"[^\w-]+", "-", text).encode()[:150].decode("utf-8", "ignore")


def _natural(name: str) -> tuple[int, list[tuple[float, str]]]:
    """Sort key under which 2.4GHz comes before 24.25GHz, and few training carriers before many."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return len(parts), [(float(part), "") if index % 2 else (0.0, part) for index, part in enumerate(parts)]
