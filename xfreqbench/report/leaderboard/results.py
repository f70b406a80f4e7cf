"""The stored results that a report or a page is made from, checked and grouped into boards."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

from xfreqbench.data.shipped import fetch_file, registered
from xfreqbench.errors import DataError
from xfreqbench.report.leaderboard.boards import Board, boards, record_key
from xfreqbench.report.leaderboard.maps import ShownMaps, read_maps
from xfreqbench.report.leaderboard.unseen_rooms import is_of_rooms, room_tables
from xfreqbench.runs.folder import RECORDS_NAME, ResultsFolder
from xfreqbench.runs.records import BenchRecord, RunRecord
from xfreqbench.system.files import read_bytes
from xfreqbench.system.remote import MOST_BYTES

VERSIONS = "versions.txt"  # beside our methods, with a line for each frozen version: file, sha256 and maybe address


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

    @cached_property
    def maps(self) -> dict[str, ShownMaps]:
        """The maps in the files beside the records, by the ids of records; raises `DataError`."""
        return {key: maps for folder in self.folders for key, maps in read_maps(folder.maps_path).items()}


Results = RankedResults | Path | Sequence[Path]


def results_at(name: str | Path) -> Path:
    """Where results are that somebody names: by their path, their address (http, https), or as a frozen version, `v2`.

    A file at an address is downloaded each time, as boards grow. A frozen version is a file of records whose hash
    is in `versions.txt`. Raises `DataError` where nothing answers, or a frozen version is no longer what it was.
    """
    text = str(name)
    if text.startswith(("http://", "https://")):
        return fetch_file(text, _require_records, fresh=True, most_bytes=MOST_BYTES)
    folder = Path(str(files("xfreqbench.baselines")))
    known = registered(folder / VERSIONS, ".parquet")
    if text not in known or Path(text).exists():
        return Path(text)
    file, sha256, url = known[text]
    if url is not None:
        return fetch_file(url, _require_records, sha256)
    path = folder / file
    if not path.exists() or hashlib.sha256(read_bytes(path)).hexdigest() != sha256:
        raise DataError(f"{path} is not the frozen version {text!r}: its sha256 is not that of {folder / VERSIONS}.")
    return path


def read_results(results: Results) -> RankedResults:
    """Read results folders, or files of records: one of them, or several, whose records are ranked together.

    What has been read is returned as it is. Raises `DataError` where one holds no records, where a record cannot be
    read or lacks a metric, and as `boards` does.
    """
    if isinstance(results, RankedResults):
        return results
    paths = [results] if isinstance(results, Path) else results
    for path in paths:
        if not path.exists():
            raise DataError(f"{path} does not exist. Give a results folder, which `xfreqbench run` writes, or a file.")
    folders = tuple(map(ResultsFolder.holding, paths))
    for folder in folders:
        _require_records(folder)
    shown = [folder.path if folder.records_path.name == RECORDS_NAME else folder.records_path for folder in folders]
    names = [path.absolute().stem for path in shown]
    if len({*names}) < len({*shown}):  # two are named alike: the whole paths tell them apart
        names = [path.as_posix() for path in shown]
    by_key = [{record_key(record): record for record in folder.records} for folder in folders]
    records = {key: record for found in by_key for key, record in found.items()}
    sources = {key: name for name, found in zip(names[::-1], by_key[::-1], strict=True) for key in found}
    taken = sorted((bench for folder in folders for bench in folder.stored.benches), key=lambda bench: bench.time_utc)
    latest = {(bench.bench, bench.title): bench for bench in taken}.values()  # of one that was taken twice, the later
    benches = sorted(latest, key=lambda bench: (bench.time_utc, bench.title)) + room_tables(records.values())
    num_truncated = sum(folder.stored.num_truncated for folder in folders)
    every = tuple(record for record in records.values() if not is_of_rooms(record))  # each once
    return RankedResults(folders, every, boards(every, sources if len(folders) > 1 else None), benches, num_truncated)


def _require_records(results: ResultsFolder | Path) -> None:
    """Raise `DataError` where there are no records, or one has no SSIM. Records of older metrics lack newer ones."""
    folder = ResultsFolder.holding(results) if isinstance(results, Path) else results
    path = folder.records_path
    if not (folder.records or folder.stored.benches):
        raise DataError(f"{path} holds no records. Run `xfreqbench run` first, or fix the path.")
    for record in folder.records:
        if "ssim" not in record.scores:
            raise DataError(
                f"{path}: the record {record.id} has no ssim. Delete its line; the run it stood for is then run again."
            )
