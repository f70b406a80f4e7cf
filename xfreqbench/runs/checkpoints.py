"""Checkpoints: a fit is saved while it runs, so that a killed run can go on.

A job has a folder of its own, with a numbered folder for each checkpoint. That one holds what the method saved, in
`method/`, and `checkpoint.json`, which says how the fit stood. Only the newest checkpoint is kept. At any moment
there is a whole one, and every byte of it is checked before a fit goes on from it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from uuid import uuid4

from pydantic import ValidationError

from xfreqbench.errors import DataError, StorageError
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Method, RoomMethod
from xfreqbench.methods.fitting import Fit
from xfreqbench.methods.guard import method_code
from xfreqbench.runs.records import Amount, Count, CurvePoint, fault_of_fields
from xfreqbench.runs.sealed import SealedModel
from xfreqbench.system.files import read_bytes, remove, storage_errors, sync, system_errors

Loaded = TypeVar("Loaded", Method, RoomMethod)
CHECKPOINT_SECONDS = 30.0  # fitting time between two checkpoints
_METHOD_FOLDER, _STATE_FILE, _UNFINISHED = "method", "checkpoint.json", ".partial"


class Checkpoint(SealedModel):
    """How a fit stood when its method was saved; `sha256` holds the hash of every file that the method wrote."""

    task_id: str
    step: Count
    loss: float
    seconds: Amount
    share: Amount
    counts: dict[str, float]
    curve: tuple[CurvePoint, ...]
    sha256: dict[str, str]
    processor_seconds: Amount = 0.0

    @property
    def fit(self) -> Fit:
        """The state from which `fit_within` goes on."""
        return Fit(self.step, self.loss, self.seconds, self.share, self.counts, self.processor_seconds)


@dataclass(frozen=True)
class CheckpointFolder:
    """The folder of one job's checkpoints; `task_id` is the id that the job's record will have.

    A method that was fitted to its end is stored in the same way, in another folder. `what` is the name of either in
    errors, and `advice` says what to do about a damaged one.
    """

    path: Path
    task_id: str
    what: str = "checkpoint"
    advice: str = "Delete that folder to fit anew."

    def write(self, method: Method | RoomMethod, fit: Fit, curve: tuple[CurvePoint, ...]) -> None:
        """Save a method and how its fit stands, then remove the checkpoint before.

        A process that is killed at any moment leaves a whole checkpoint: this one, or the one before. Raises
        `StorageError`, and what `method.save` raises.
        """
        unfinished = self._unfinished()
        numbers = self._numbers()
        with storage_errors(self.path):
            for abandoned in self.path.glob(f".*{_UNFINISHED}"):
                remove(abandoned)
            (unfinished / _METHOD_FOLDER).mkdir(parents=True)
            method.save(unfinished / _METHOD_FOLDER)
            hashes = _sha256_by_name(unfinished / _METHOD_FOLDER)
            state = Checkpoint(**vars(fit), task_id=self.task_id, curve=curve, sha256=hashes)
            (unfinished / _STATE_FILE).write_bytes(state.sealed_json())
            for path in (*unfinished.rglob("*"), unfinished):
                sync(path)
            unfinished.rename(self.path / str(max(numbers, default=0) + 1))
            sync(self.path)  # or the rename itself may be lost with the power
            for number in filter(self._is_own, numbers):
                remove((self.path / str(number)).rename(self._unfinished()))

    def _unfinished(self) -> Path:
        return self.path / f".{uuid4().hex}{_UNFINISHED}"

    def _is_own(self, number: int) -> bool:
        """Whether a folder of a checkpoint's name holds one, and not what somebody else has put there."""
        try:
            Checkpoint.model_validate_json(read_bytes(self.path / str(number) / _STATE_FILE))
        except (OSError, ValidationError):
            return False
        return True

    def newest(self) -> Path | None:
        """The folder of the newest checkpoint; None if there is none yet."""
        numbers = self._numbers()
        return self.path / str(max(numbers)) if numbers else None

    def read(self) -> Checkpoint | None:
        """The newest checkpoint, after every byte of it has been checked; None if there is none.

        Raises `DataError` if it is damaged or belongs to another job.
        """
        newest = self.newest()
        if newest is None:
            return None
        try:
            return self._checked(newest)
        except DataError:
            if self.newest() == newest:
                raise
            return self.read()  # its fit, in another process, has gone on

    def _checked(self, newest: Path) -> Checkpoint:
        try:
            checkpoint = Checkpoint.model_validate_json(read_bytes(newest / _STATE_FILE))
            sha256 = _sha256_by_name(newest / _METHOD_FOLDER)
        except (OSError, ValidationError) as error:
            fault = error.strerror if isinstance(error, OSError) else fault_of_fields(error)
            raise self._refusal(f"cannot be read: {fault}") from error
        if checkpoint.task_id != self.task_id:
            raise self._refusal(f"belongs to job {checkpoint.task_id}, not to {self.task_id}")
        if sha256 != checkpoint.sha256:
            names = sorted(name for name, _ in sha256.items() ^ checkpoint.sha256.items())
            raise self._refusal(f"is damaged: {', '.join(dict.fromkeys(names))} changed since it was written")
        return checkpoint

    def load(self, method: Loaded) -> Loaded:
        """The method as the newest checkpoint holds it; its class and configuration are those of `method`.

        Raises `MethodError` if the method fails to load it, `DataError` if it has another configuration, and
        `StorageError` if the system cannot read it.
        """
        failed = f"The {self.what} in {self.path} cannot be loaded: {type(method).__name__}.load raised"
        with method_code(failed, self.advice, passed=(StorageError,)), system_errors(self.path):
            loaded = type(method).load((self.newest() or self.path) / _METHOD_FOLDER)
            config = getattr(loaded, "config", None)
        if as_json(config) != as_json(method.config):
            raise self._refusal(f"has configuration {config!r}, but the job has {method.config!r}")
        return loaded

    def remove(self) -> None:
        """Remove the folder, or a link in its place. It is renamed first: a kill never leaves half of it.

        Raises `DataError` where somebody else has put something there, or what we have put there is damaged.
        """
        is_link = self.path.is_symlink()
        if not is_link and (self.path.is_file() or not all(map(self._is_own, self._numbers()))):
            raise DataError(f"{self.path} holds what is no whole {self.what}, and is not removed. Move it elsewhere.")
        removed = self.path.with_name(f".{self.path.name}.removed")
        with storage_errors(self.path):
            remove(removed)
            if self.path.exists():
                self.path.rename(removed)
                remove(removed)

    def _numbers(self) -> list[int]:
        if self.path.is_symlink():  # numbered folders are removed here, and this one may be anybody's
            raise self._refusal("is a symbolic link, which is not followed")
        names = [path.name for path in self.path.glob("*")]
        return sorted(int(name) for name in names if name.isascii() and name.isdigit())

    def _refusal(self, fault: str) -> DataError:
        return DataError(f"The {self.what} in {self.path} {fault}. {self.advice}")


def _sha256_by_name(folder: Path) -> dict[str, str]:
    """The hash of every file, by its path within the folder; raises `OSError`."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(read_bytes(path)).hexdigest() for path in files}
