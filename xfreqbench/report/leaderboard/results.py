"""The stored results that a report or a page is made from, checked and grouped into boards."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from xfreqbench.errors import DataError
from xfreqbench.maps.metrics import METRICS
from xfreqbench.report.leaderboard.boards import Board, boards, comparable
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import BenchRecord, RunRecord


@dataclass(frozen=True)
class RankedResults:
    """All run records of some folders and the boards they make, and their measurements, of each the latest.

    `num_truncated` counts records of which only a part of the line was written; they are left out.
    """

    folders: tuple[ResultsFolder, ...]
    records: tuple[RunRecord, ...]
    boards: list[Board]
    benches: list[BenchRecord]
    num_truncated: int


def read_results(results: Path | Sequence[Path]) -> RankedResults:
    """Read results folders, or files of records: one of them, or several, whose records are ranked together.

    Raises `DataError` where one holds no records, where a record cannot be read or lacks a metric, and as `boards`
    does.
    """
    paths = [results] if isinstance(results, Path) else results
    folders = tuple(map(ResultsFolder.holding, paths))
    for folder in folders:
        if not (folder.records or folder.stored.benches):
            raise DataError(
                f"{folder.records_path} holds no records. Run `xfreqbench run` first, or mend the path."
            )
        _require_scores(folder.records_path, folder.records)
    found = (record for folder in folders for record in folder.records)
    records = {(record.id, record.job, record.time_utc): record for record in found}
    benches = latest_benches(bench for folder in folders for bench in folder.stored.benches)
    num_truncated = sum(folder.stored.num_truncated for folder in folders)
    every = tuple(records.values())  # each once, though several folders may hold it
    return RankedResults(folders, every, boards(every), benches, num_truncated)


def ranked_beside(results: Path, records: Iterable[RunRecord]) -> list[RunRecord]:
    """The records of a results folder that stand on the same boards as these, which are among them.

    Those of other versions of protocol or metrics, which cannot be ranked beside them, are left out.
    """
    keys = set(map(comparable, records))
    return [each for each in ResultsFolder(results).stored.records if comparable(each) in keys]


def latest_benches(benches: Iterable[BenchRecord]) -> list[BenchRecord]:
    """Measurements in the order in which they were taken; of one that was taken twice, only the later."""
    ordered = sorted(benches, key=lambda record: record.time_utc)
    latest = {(record.bench, record.title): record for record in ordered}
    return sorted(latest.values(), key=lambda record: (record.time_utc, record.title))


def _require_scores(path: Path, records: Iterable[RunRecord]) -> None:
    """Raise `DataError` for the first record that lacks a metric. No run writes such a record."""
    for record in records:
        missing = METRICS.keys() - record.scores.keys()
        if missing:
            raise DataError(
                f"{path}: the record {record.id} has no {', '.join(sorted(missing))}. Delete its line; the run it "
                "stood for is then run again."
            )
