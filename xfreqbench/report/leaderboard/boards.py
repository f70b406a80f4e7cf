"""Run records grouped into boards: runs that may be ranked together, one row for each configured method."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from math import inf, isnan, nan
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.recipe import recipe_name
from xfreqbench.data.splits import VALIDATIONS, protocols
from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import quantiles, skill
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.origins import Origin, RecordKey, origin_labels, record_key
from xfreqbench.report.leaderboard.rows import (
    LANE_NAMES,
    NO_LANE,
    BoardRow,
    board_rows,
    is_trivial,
    lane_of,
    median_ssim,
)
from xfreqbench.runs.records import NUM_QUANTILES, RunRecord

GroupKey = tuple[str, str, str]  # scene, recipe of the data, protocol


@dataclass(frozen=True)
class Board:
    """Rows that may be ranked together: they share data, protocol, budget, and the versions of protocol and metrics.

    `data` is the recipe of the data set. `settings` are those of the data of the oldest record. `sources` names the
    results that a record lies in, where those of the board lie in several. `lane` is the budget of its fits as text,
    `NO_LANE` where none has a budget; trivial predictors, which are not fitted, stand on the board of every lane.
    """

    scene: str
    data: str
    protocol: str
    lane: str
    pas_kind: str
    settings: Mapping[str, Any]
    splits: tuple[str, ...]
    rows: tuple[BoardRow, ...]
    sources: Mapping[RecordKey, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Scene, protocol, kind of map and budget, as a heading."""
        parts = [self.scene, self.protocol, f"{self.pas_kind} maps", self.lane_title]
        return " · ".join(filter(None, parts))

    @property
    def lane_title(self) -> str:
        """The budget of its fits, with the name of the lane if it has one: `quick (≤ 64,000 maps)`."""
        name = LANE_NAMES.get(self.lane)
        return f"{name} ({self.lane})" if name else self.lane

    @property
    def records(self) -> list[RunRecord]:
        """The records of all rows."""
        return [record for row in self.rows for record in row.records]

    @property
    def data_name(self) -> str:
        """The data set as it is shown: `office@2-3f9c2ab1`."""
        return recipe_name(self.scene, self.data)

    def is_of(self, dataset: PasDataset) -> bool:
        """Whether the records are of a data set; digits in which processors differ do not count."""
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
        data = self.data_name.rpartition("@")[2]
        lane = re.sub("[^0-9a-z_]+", "", self.lane.replace(".", "_"))
        return f"{named}-{data}" + (f"-{lane}" if lane else "")

    def best_trivial(self, split: str) -> float:
        """The largest median SSIM of the trivial predictors on a split; nan where `trivial_rows` are none."""
        return self._best_trivial.get(split, nan)

    @cached_property
    def _best_trivial(self) -> dict[str, float]:
        trivial = {split: self.trivial_rows(split) for split in self.splits}
        return {split: max(row.value(split, median_ssim) for row in rows) for split, rows in trivial.items() if rows}

    def trivial_rows(self, split: str) -> list[BoardRow]:
        """The rows of the trivial predictors on a split; none without one of `NEEDED_TRIVIAL`, which might be the best.

        Those that were added later count where they were run.
        """
        rows = [row for row in self.rows if row.is_trivial and split in row.by_split]
        return rows if set(NEEDED_TRIVIAL) <= {row.job.method for row in rows} else []

    def skill(self, record: RunRecord) -> float:
        """Skill of a record: its median SSIM against that of the best trivial predictor on the same split."""
        return skill(median_ssim(record), self.best_trivial(record.job.split))

    def split_sets(self) -> list[tuple[str, ...]]:
        """The sets of splits that rows were run on, the set that most rows cover first.

        Averages are compared over the same set only. Sets of a single split are left out, unless there are no
        larger ones.
        """
        sets = {frozenset(row.by_split) for row in self.rows}
        num_rows = {splits: sum(splits <= set(row.by_split) for row in self.rows) for splits in sets}
        ordered = sorted(sets, key=lambda splits: (-num_rows[splits], -len(splits), sorted(splits)))
        shown = [splits for splits in ordered if len(splits) > 1] or ordered
        return [tuple(split for split in self.splits if split in splits) for splits in shown]

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
    records: Iterable[RunRecord], sources: Mapping[RecordKey, str] | None = None, *, by_budget: bool = True
) -> list[Board]:
    """One board for each data set, protocol and budget.

    They stand in the order of scenes, data sets, `protocols()` and then `VALIDATIONS`, the board with most runs first.
    Without `by_budget` rows of all budgets share a board. Data sets are told apart by their
    recipes, and `sources` tells which results records lie in. Of a job
    that was run twice, the later record counts; of the same job on other bytes of the same data there is another row,
    but for trivial predictors, whose first stays. Raises `DataError` where records of a board are of different
    versions of the protocol or of the metrics, or test other samples.
    """

    def key(record: RunRecord) -> GroupKey:
        return record.scene, record.recipe, record.job.protocol

    ordered = sorted(records, key=lambda record: (*key(record), record.time_utc, record.id))
    grouped = [
        _board(of, lane, records, sources or {})
        for of, group in groupby(ordered, key)
        for lane, records in _by_lane(list(group), by_budget).items()
    ]
    order = {protocol: place for place, protocol in enumerate((*protocols(), *VALIDATIONS))}

    def place(board: Board) -> tuple[object, ...]:
        protocol = order.get(board.protocol, len(order))
        return board.scene, board.data, protocol, -len(board.records), _natural(board.lane)

    return sorted(grouped, key=place)


def slug_of(text: str) -> str:
    """The beginning of a text as the name of a file, with a hyphen for all that is no letter, digit or underscore."""
    return file_stem(re.sub(r"[^\w-]+", "-", text))


def file_stem(text: str) -> str:
    """The beginning of a text that is short enough for the name of a file."""
    return text.encode()[:150].decode("utf-8", "ignore")


def or_nan(value: float | None) -> float:
    """A number of a record, nan in place of None."""
    return nan if value is None else value


def pooled_quantiles(records: Sequence[RunRecord], metric: str) -> list[float]:
    """Quantiles from 0 to 1 of the scores of all seeds together; every seed tests equally many maps."""
    pooled = np.concatenate([record.scores[metric].quantiles for record in records])
    return quantiles(pooled, np.linspace(0, 1, NUM_QUANTILES).tolist()).tolist()


def short_name(split: str) -> str:
    """A split's name without its protocol: `lofo-2.4GHz` becomes `2.4GHz`."""
    starts = [f"{protocol}-" for protocol in (*protocols(), *VALIDATIONS) if split.startswith(f"{protocol}-")]
    return split.removeprefix(max(starts, key=len, default=""))


def comparable(record: RunRecord) -> tuple[object, ...]:
    """What two records have to have in common to be ranked together."""
    versions = record.protocol_version, record.metrics_version
    return record.scene, record.recipe, record.job.protocol, *versions


def _by_lane(records: Sequence[RunRecord], by_budget: bool) -> dict[str, list[RunRecord]]:
    """The records of each budget, each time with those of the trivial predictors, which need none."""
    if not by_budget:
        return {NO_LANE: list(records)}
    lanes = dict.fromkeys(lane_of(record) for record in records if not is_trivial(record)) or {NO_LANE: None}
    return {lane: [record for record in records if is_trivial(record) or lane_of(record) == lane] for lane in lanes}


def _board(key: GroupKey, lane: str, records: Sequence[RunRecord], sources: Mapping[RecordKey, str]) -> Board:
    versions = sorted({(record.protocol_version, record.metrics_version) for record in records})
    if len(versions) > 1:
        described = ", ".join(f"protocol {protocol} with metrics {metrics}" for protocol, metrics in versions)
        raise DataError(
            f"Records of {key[0]!r} and {key[2]!r} are of different versions ({described}) and cannot be "
            "ranked together. Delete the older lines and run those jobs again."
        )
    splits = sorted({record.job.split for record in records}, key=_natural)
    require_same_samples(key, records)

    def place(row: BoardRow) -> tuple[float, str]:
        average = row.average(splits, median_ssim)
        return inf if isnan(average) else -average, row.label

    rows = sorted(board_rows(records), key=place)
    data = records[0]  # all records of a board describe the same data set
    named = {sources.get(record_key(record), "") for record in records}
    named_sources = sources if len(named) > 1 else {}
    return Board(*key, lane, data.pas_kind, data.settings, tuple(splits), tuple(rows), named_sources)


def require_same_samples(key: GroupKey, records: Sequence[RunRecord]) -> None:
    """Raise `DataError` for records of two files of data that test other samples on a split of the same name."""
    first: dict[str, RunRecord] = {}
    for record in records:
        known = first.setdefault(record.job.split, record)
        if record.dataset_sha256 != known.dataset_sha256 and record.split_sha256 != known.split_sha256:
            raise DataError(
                f"Records {known.id} and {record.id} of {recipe_name(*key[:2])} test other samples on the split "
                f"{record.job.split!r} ({known.num_test} and {record.num_test}), so that they cannot be ranked "
                "together: the data of one lack paths that those of the other have. Generate them anew with the "
                "default solver and number of rays, or leave out the results of one."
            )


def _natural(name: str) -> tuple[int, list[tuple[float, str]]]:
    """Sort key under which 2.4GHz comes before 24.25GHz, and few training carriers before many."""
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return len(parts), [(float(part), "") if index % 2 else (0.0, part) for index, part in enumerate(parts)]
