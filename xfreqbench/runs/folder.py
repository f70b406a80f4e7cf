"""A folder of results: where records, predictions, checkpoints and locks are in it. No other module knows.

records.jsonl            one line for each run and for each table of a measurement
records_maps.jsonl       maps of a dozen samples, shown where predictions are not beside the records
predictions/ID.h5        the predicted maps of the run whose record has that id
predictions/ID.lock      exists while that run is made, and names the process that makes it
driver.lock              exists while a process runs jobs in the folder, and names it
checkpoints/ID/NUMBER/   how far the fit of that run has come, until its record is stored
methods/ID/NUMBER/       the method as that run fitted it
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import InstanceOf

from xfreqbench.data.unseen_rooms import ROOM_PROTOCOLS
from xfreqbench.errors import ClusterError, DataError
from xfreqbench.methods.contract import Method
from xfreqbench.methods.registry import build_method
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.predictions import Predictions, read_predictions
from xfreqbench.runs.record_table import read_table
from xfreqbench.runs.records import BenchRecord, RunRecord, StoredRecords, append, read
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.system.arguments import FilePath, checked
from xfreqbench.system.files import require_regular, require_space, sole_worker, storage_errors
from xfreqbench.types import NDArray

RECORDS_NAME = "records.jsonl"


class ResultsFolder:
    """Records of runs with their predictions and checkpoints, in one folder.

    `records_path` is the file of records. The file is read when something of it is first asked for, and what is new
    in it after it has changed.
    """

    def __init__(self, path: Path, records_name: str = RECORDS_NAME) -> None:
        self.path = path
        self.records_path = path / records_name
        self._stored = StoredRecords(())
        self._read_at: tuple[int, ...] | None = None  # inode, size and time of the file when it was read

    @classmethod
    def holding(cls, results: Path) -> ResultsFolder:
        """Results to read: `results` is such a folder, or a file of records, whose predictions lie beside it."""
        return cls(results) if results.is_dir() else cls(results.parent, results.name)

    @property
    def stored(self) -> StoredRecords:
        """Everything that the file of records holds; raises `DataError`."""
        now = self._file_state()
        if now != self._read_at:
            is_table = self.records_path.suffix == ".parquet" and now is not None
            stored = read_table(self.records_path) if is_table else read(self.records_path, self._stored)
            self._stored, self._read_at = stored, now
        return self._stored

    @property
    def records(self) -> tuple[RunRecord, ...]:
        """The records of runs, in the order in which they were stored; raises `DataError`."""
        return self.stored.records

    def finished(self, record_id: str) -> RunRecord | None:
        """The latest record with an id, if its predictions are stored or were removed on purpose; raises `DataError`.

        Else it is None.
        """
        is_stored = self.predictions_path(record_id).exists()
        known = (record for record in reversed(self.records) if record.id == record_id)
        return next((record for record in known if is_stored or record.removed_predictions_sha256), None)

    def append(self, record: RunRecord | BenchRecord) -> None:
        """Store a record behind the others; raises `StorageError`, and `DataError` for a file of something else."""
        append(self.records_path, record)

    def keep(self, record: RunRecord, with_predictions: bool = True) -> RunRecord:
        """Store the record of a run, and remove the run's checkpoints; returns what was stored.

        Without predictions their file is removed after that, and the record has its hash. Raises `ClusterError` where
        the predictions are not here: a worker has lost this folder and uses its own disk.
        """
        path = self.predictions_path(record.id)
        if not path.exists():
            self.require_writable()  # a file that is made here has NFS forget that the name was absent
        if not path.exists():
            raise ClusterError(
                f"A worker made this run, but its predictions are not at {path}. Nothing of it is recorded; mount the "
                "folder at the same path on every machine."
            )
        if not with_predictions:
            with storage_errors(path), path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            record = record.model_copy(update={"removed_predictions_sha256": digest})
        self.append(record)
        self.checkpoints(record.id).remove()
        if not with_predictions:
            with storage_errors(path):
                path.unlink()
        return record

    @property
    def maps_path(self) -> Path:
        """The file for maps to be shown beside the file of records, whether it exists or not."""
        return self.records_path.with_name(f"{self.records_path.stem}_maps.jsonl")

    def predictions_path(self, record_id: str) -> Path:
        """The file for the predictions of the run with an id, whether it exists or not."""
        return self.path / "predictions" / f"{record_id}.h5"

    def predictions_paths(self) -> list[Path]:
        """All files of predictions, by name."""
        return sorted((self.path / "predictions").glob("*.h5"))

    def predictions(self, record: RunRecord) -> Predictions:
        """The predictions of a record; raises `DataError` if they are absent, damaged or of another split."""
        path = self.predictions_path(record.id)
        if not path.exists():
            if record.removed_predictions_sha256:
                raise DataError(
                    f"The predictions of record {record.id} were removed after they were scored, as `benchmark "
                    "--predictions shown` does. Run the same in another results folder, which keeps them."
                )
            raise DataError(
                f"The predictions of record {record.id} are not at {path}. Run the same `xfreqbench run` again, "
                "which stores them, or choose another record."
            )
        predictions = read_predictions(path)
        if (predictions.dataset_sha256, predictions.split_sha256) != (record.dataset_sha256, record.split_sha256):
            raise DataError(f"{path} holds predictions of another split. Delete it and run again.")
        return predictions

    def checkpoints(self, record_id: str) -> CheckpointFolder:
        """The checkpoints of the run whose record will have that id."""
        return CheckpointFolder(self.path / "checkpoints" / record_id, record_id)

    def fitted(self, fit_id: str) -> CheckpointFolder:
        """The method as a fit has left it: that of the run with that id, or of several that share it."""
        path = self.path / "methods" / fit_id
        predictions = self.predictions_path(fit_id)
        also = f"{predictions} and " if predictions.exists() else ""
        return CheckpointFolder(
            path, fit_id, "method", f"Delete {also}{path}, and run the same again, which fits anew."
        )

    def alone(self) -> AbstractContextManager[str]:
        """Hold the folder, as the one process that runs jobs in it; raises `InUseError` where another one does."""
        return sole_worker(self.path / "driver.lock", self.path)

    def lock(self, record_id: str) -> AbstractContextManager[str]:
        """A lock that whoever makes a run or a fit holds while it writes for it; see `sole_worker`."""
        return sole_worker(self.run_lock_path(record_id), self.predictions_path(record_id))

    def run_lock_path(self, record_id: str) -> Path:
        """The file of `lock`."""
        return self.predictions_path(record_id).with_suffix(".lock")

    def require_writable(self) -> None:
        """Make the folders; raises `StorageError` where a record or predictions could not be stored in them."""
        for path in (self.records_path, self.predictions_path("any")):
            require_space(path, 1)
            with storage_errors(path.parent), tempfile.TemporaryFile(dir=path.parent):
                pass
        if self.records_path.exists():
            with storage_errors(self.records_path), require_regular(self.records_path).open("ab"):
                pass

    def _file_state(self) -> tuple[int, ...] | None:
        try:
            found = self.records_path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return None
        return found.st_ino, found.st_size, found.st_mtime_ns


@checked
def load_method(results: FilePath, run: str | InstanceOf[RunRecord]) -> Method:
    """The method that a run has fitted and stored in a results folder: `predict` can be called, or `fit` go on.

    `run` is a record of the folder, or its `id`. Every byte is compared with its hash before the method's own `load`
    reads it. The code is that which is installed now, whatever it was when the method was fitted. Methods of this
    package store numbers and texts alone; what a plug-in stores may run code, so load only results that you trust.

    Raises `DataError` where no such run is recorded, or its method is not stored, damaged or another run's, and
    `UnknownNameError` or `MethodError` where the method is not installed or fails to load.
    """
    folder, record_id = ResultsFolder.holding(Path(results)), run if isinstance(run, str) else run.id
    found = [record for record in folder.records if record.id == record_id]
    if not found:
        raise DataError(f"{folder.records_path} has no run {record_id!r}; xfreqbench.read_records lists its runs.")
    job, stored = found[-1].job, folder.fitted(record_id)
    if job.protocol.startswith(ROOM_PROTOCOLS):
        raise DataError(f"Run {record_id} is of protocol {job.protocol}: its method is adapted to each room, not kept.")
    if stored.read() is None:
        elsewhere = found[-1].external is not None
        advice = "Its predictions were made elsewhere." if elsewhere else stored.advice
        raise DataError(f"The method of run {record_id} is not at {stored.path}. {advice}")
    return stored.load(build_method(job.method, job.overrides))


@checked
def read_records(results: FilePath) -> tuple[RunRecord, ...]:
    """The records of all runs in a results folder, or in one file of records; none where there is no such file.

    Raises `DataError` naming file and line for a line that is no record.
    """
    return ResultsFolder.holding(Path(results)).records


@checked
def load_predictions(
    results: FilePath, run: InstanceOf[RunRecord], rows: Sequence[int] | None = None
) -> Float[NDArray[np.float32], "n E A"]:
    """The maps (n, E, A) that a run predicted and stored, in the order of `rows`, which are rows of its data set.

    They are those of all tested rows, ascending, if `rows` is absent. `results` is the run's folder, or its file of
    records. Raises `DataError` where predictions are absent, damaged or another split's, or a row is not among them.
    """
    stored = ResultsFolder.holding(Path(results)).predictions(run)
    asked = stored.rows if rows is None else np.asarray(rows, np.int64)
    if missing := sorted(set(asked.tolist()) - set(stored.rows.tolist())):
        raise DataError(f"{stored.path} holds no prediction of row {missing[0]}. Choose among the rows that it tested.")
    return stored.maps_of(asked, BATCH_SIZE)
