"""Finished batches of a generation, kept on disk until the data set is whole."""

from __future__ import annotations

import hashlib
import io
import shutil
from pathlib import Path

import numpy as np

from xfreqbench.data.plan import Plan
from xfreqbench.errors import StorageError
from xfreqbench.system.files import atomic_path, require_own, storage_errors, write_text
from xfreqbench.tracing.tracer import Channel


class BatchStore:
    """Finished batches of one job in a folder; each file's name carries the sha256 of its bytes.

    A file is written under another name, synced and renamed. One that is there with the right digest is
    therefore whole, and a batch that is lost, cut short or damaged is traced again.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder = folder
        self.plan = plan
        self._claim()
        self._paths = self._found()

    def _claim(self) -> None:
        """Make the folder this job's, or raise `OutputExistsError` where it is another's."""
        marker, sha256 = self.folder / "job.sha256", self.plan.sha256
        fault = "marks batches of an unfinished run with other settings, software or transmitters"
        advice = f"Run that one to its end, delete {self.folder}, or choose another output with -o."
        require_own(marker, lambda file: None if file.read_text() == sha256 else fault, advice)
        write_text(marker, sha256)

    def _found(self) -> dict[int, Path]:
        """Whole batches by index; the others are removed."""
        found = {}
        for path in self.folder.glob("[0-9]*-*.npz"):
            index, _, sha256 = path.stem.partition("-")
            if _sha256(path) == sha256:
                found[int(index)] = path
            else:
                path.unlink()
        return found

    def missing(self) -> list[tuple[int, slice]]:
        """Batches that have to be traced, each with its index and its transmitters."""
        return [(i, rows) for i, rows in enumerate(self.plan.batches) if i not in self._paths]

    def write(self, index: int, channel: Channel) -> None:
        """Keep a batch; raises `StorageError`."""
        buffer = io.BytesIO()
        np.savez(buffer, cfr=channel.cfr, num_paths=channel.num_paths)
        content = buffer.getvalue()
        path = self.folder / f"{index:06d}-{hashlib.sha256(content).hexdigest()}.npz"
        with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
            temporary.write_bytes(content)
        self._paths[index] = path

    def read(self, index: int) -> Channel:
        """A batch that was kept; raises `StorageError` where it is there no longer, or was changed."""
        path = self._paths[index]
        if not path.is_file() or _sha256(path) != path.stem.partition("-")[2]:
            raise StorageError(f"Batch {index} has gone from {self.folder}. Run the same command again.")
        with np.load(path) as content:
            return Channel(content["cfr"], content["num_paths"])

    def remove(self) -> None:
        """Delete the folder, once the data set is whole."""
        shutil.rmtree(self.folder)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
