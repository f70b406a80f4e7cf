"""Finished batches of a generation, kept on disk until the data set is complete."""

from __future__ import annotations

import glob
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path

from xfreqbench.data.plan import Plan
from xfreqbench.data.recipe import job_differences
from xfreqbench.errors import OutputExistsError
from xfreqbench.system.files import require_own, sole_writer, storage_errors, write_text
from xfreqbench.system.pieces import Pieces
from xfreqbench.tracing.paths import RaggedPaths
from xfreqbench.tracing.tracer import Channel

_MARKER, _BATCHES = "job.json", "[0-9]*-*.npz"
_ADVICE = "Rename it, or choose another output with -o."


class BatchStore:
    """Finished batches of one job in a folder, which `claimed_batches` gives to one process at a time.

    `kept` are the numbers of those that were there at the beginning; see `Pieces`.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.plan = plan
        self._pieces = Pieces(folder, plan.sha256)
        self.kept = self._pieces.kept

    def missing(self) -> list[tuple[int, slice]]:
        """Batches that have to be traced, each with its index and its transmitters."""
        return [(i, rows) for i, rows in enumerate(self.plan.batches) if i not in self._pieces]

    def write(self, index: int, channel: Channel) -> None:
        """Keep a batch; raises `StorageError`."""
        paths = {} if channel.paths is None else {f"paths.{k}": v for k, v in vars(channel.paths).items()}
        self._pieces.put(index, cfr=channel.cfr, num_paths=channel.num_paths, **paths)

    def read(self, index: int) -> Channel:
        """A batch that was kept; raises `StorageError` if it is missing or was changed."""
        stored = self._pieces.get(index)
        paths = {name.removeprefix("paths."): stored.pop(name) for name in [*stored] if "." in name}
        return Channel(**stored, paths=RaggedPaths(**paths) if self.plan.header.paths else None)


@contextmanager
def claimed_batches(output: Path, plan: Plan) -> Iterator[BatchStore]:
    """The batches of a job, in `OUTPUT.parts` next to its output; only this process uses them during the block.

    They are removed when the block ends without an exception. Raises `OutputExistsError` if the folder belongs to
    another job or somebody else, and `StorageError` if another process writes the output.
    """
    folder = batch_folder(output)
    with sole_writer(output):
        with storage_errors(folder):
            if folder.is_symlink():
                raise OutputExistsError(f"{folder} is a symbolic link, which is not followed. {_ADVICE}")
            if folder.exists() and not folder.is_dir():
                raise OutputExistsError(f"{folder} is in the way: batches are kept in a folder of that name. {_ADVICE}")
            content = [path.name for path in folder.iterdir()] if folder.exists() else []
            foreign = sorted(name for name in content if not fnmatch(name, f".{_MARKER}.*"))  # not yet a marker
            if foreign and not (folder / _MARKER).is_file():
                raise OutputExistsError(
                    f"{folder} holds {foreign[0]!r} and no {_MARKER}: it is not a folder of batches. {_ADVICE}"
                )
        advice = f"Run that one to its end, delete {folder}, or choose another output with -o."
        if not require_own(folder / _MARKER, lambda file: _fault_of_marker(file, plan), advice):
            write_text(folder / _MARKER, json.dumps(plan.job))
        yield BatchStore(folder, plan)
        with storage_errors(folder):
            _remove(folder)


def batch_folder(output: Path) -> Path:
    """Where the batches of an output are kept."""
    return output.with_name(output.name + ".parts")


def holds_batches_of(output: Path, plan: Plan) -> bool:
    """Whether a process that was killed at its very end left the batches of a job next to the output."""
    folder = batch_folder(output)
    marker = folder / _MARKER
    return not folder.is_symlink() and marker.is_file() and not _fault_of_marker(marker, plan)


def _fault_of_marker(marker: Path, plan: Plan) -> str | None:
    """How the job that a marker names differs from that of a plan, in words; None if it is the same."""
    try:
        marked = json.loads(marker.read_bytes())
    except (ValueError, RecursionError):
        return "is damaged"
    if marked == plan.job:
        return None
    if not isinstance(marked, dict):
        return "is damaged"
    return f"marks the batches of another unfinished run: {job_differences(plan.job, marked)}"


def _remove(folder: Path) -> None:
    """Remove a folder of batches, and the remains of removals that were killed; anything else in it is kept.

    It is renamed first, so that a kill never leaves half of it under its name, without its marker.
    """
    doomed = Path(tempfile.mkdtemp(".removed", f".{folder.name}.", folder.parent))
    folder.replace(doomed)
    for removed in folder.parent.glob(f".{glob.escape(folder.name)}.*.removed"):
        if not removed.is_symlink():
            _empty(removed)
    if doomed.exists():
        doomed.rename(folder)


def _empty(folder: Path) -> None:
    """Remove batches and marker from a folder, and the folder if nothing else is in it."""
    for pattern in (_BATCHES, f".{_BATCHES}.*", _MARKER, f".{_MARKER}.*"):
        for path in folder.glob(pattern):
            if path.is_symlink() or path.is_file():
                path.unlink(missing_ok=True)
    with suppress(OSError):  # something else is in it
        folder.rmdir()
