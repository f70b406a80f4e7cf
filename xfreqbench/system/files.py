"""Writing files: whole or not at all, never over what somebody else wrote, and with one wording of a full disk."""

from __future__ import annotations

import glob
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock

from xfreqbench.errors import OutputExistsError, StorageError

_LOCK_POLL_S = 0.02  # between two tries for a lock that another process holds


@contextmanager
def atomic_path(target: Path, num_bytes: int = 0) -> Iterator[Path]:
    """Yield a temporary path beside `target`, which is renamed to `target` if the block ends without an exception.

    The folder of `target` is made if it is missing, and `num_bytes` of free space are checked first. After an
    exception the temporary file is removed and `target` is as it was. A killed process leaves a hidden file
    `.NAME.PID.partial`, which the next writer of the same file removes. Raises `StorageError`.
    """
    _remove_abandoned(target)
    require_space(target, num_bytes)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        with storage_errors(target, num_bytes):
            _try_allocating(temporary, num_bytes)
        yield temporary
        with storage_errors(target, num_bytes):
            sync(temporary)
            temporary.replace(target)
            sync(target.parent)  # or the rename itself may be lost with the power
    finally:
        temporary.unlink(missing_ok=True)


def _remove_abandoned(target: Path) -> None:
    """Remove the partial files of `target` whose processes have ended; a running one may still be writing its own."""
    for path in target.parent.glob(f".{glob.escape(target.name)}.*.partial"):
        process = path.name.split(".")[-2]
        if process.isdigit() and not Path(f"/proc/{process}").exists() and Path("/proc/self").exists():
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


@contextmanager
def atomic_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `target`, which is renamed to `target` if the block ends without an exception.

    Raises `OutputExistsError` unless `target` is absent or an empty folder, and `StorageError`. A killed process
    leaves a hidden folder `.NAME.PID.partial`, which the next writer of the same folder removes.
    """
    target = target.absolute()
    require_empty(target)
    _remove_abandoned(target)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.partial")
    with storage_errors(target):
        temporary.mkdir(parents=True)
    try:
        yield temporary
        with storage_errors(target):
            os.sync()
            temporary.replace(target)
            sync(target.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def require_own(
    path: Path,
    fault_of: Callable[[Path], str | None],
    advice: str = "Choose another path for the output, or delete this one.",
) -> bool:
    """Decide whether a command may write to `path`: True where its own earlier output lies there, False where nothing.

    This is the only place that makes the decision. `fault_of(path)` reads the file and returns None where the
    command may replace it or leave it as it is; otherwise it returns words that go on after "PATH exists and".
    Raises `OutputExistsError` with those words and `advice`, and `StorageError` for what is not a regular file
    or cannot be read.
    """
    with storage_errors(path):
        if not path.exists():
            return False
        if not path.is_file():
            raise StorageError(f"{path} is not a file, and nothing can be written in its place. {advice}")
        fault = fault_of(path)
    if fault:
        raise OutputExistsError(f"{path} exists and {fault.rstrip('.')}. {advice}")
    return True


def require_empty(folder: Path) -> None:
    """As `require_own`, for a whole folder: raise `OutputExistsError` unless it is absent or empty."""
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise OutputExistsError(
            f"{folder} exists and is no empty folder; nothing is written over it. Choose another, or empty it."
        )


def write_text(target: Path, text: str) -> None:
    """Write a text file atomically; raises `StorageError`."""
    content = text.encode()
    with atomic_path(target, len(content)) as temporary, storage_errors(target, len(content)):
        temporary.write_bytes(content)


@contextmanager
def storage_errors(path: Path, num_bytes: int = 0) -> Iterator[None]:
    """Turn an `OSError` within the block into a `StorageError` that names the path and the bytes needed."""
    try:
        yield
    except OSError as error:
        needed = f", which needs {num_bytes:,} bytes" if num_bytes else ""
        raise StorageError(
            f"{path}{needed}, cannot be written: {error.strerror or error}. "
            "Free some space, mend the folder's permissions, or choose another place."
        ) from error


def require_space(target: Path, num_bytes: int) -> None:
    """Make the folder of a file; raises `StorageError` if there is no room or no permission for `num_bytes` in it."""
    with storage_errors(target, num_bytes):
        target.parent.mkdir(parents=True, exist_ok=True)
        free_bytes = shutil.disk_usage(target.parent).free
    if target.is_dir():
        raise StorageError(f"{target} is a folder; give the path of a file.")
    if free_bytes < num_bytes:
        raise StorageError(
            f"{target} needs {num_bytes:,} bytes, but its disk has {free_bytes:,} free. "
            "Free some space or choose another place."
        )


def _try_allocating(temporary: Path, num_bytes: int) -> None:
    """Reserve the space of a file, so that a quota or limit is an error here; within HDF5 it would be a crash."""
    if num_bytes and hasattr(os, "posix_fallocate"):
        with temporary.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, num_bytes)


def sync(path: Path) -> None:
    """Write a file's content, or a folder's list of names, to the disk itself before returning."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def exclusive(lock: Path) -> Iterator[None]:
    """Hold a lock during the block; only one process at a time holds it, and others wait here until they do.

    `lock` is a file that is made for this and removed afterwards. The system releases the lock of a process that
    is killed. Raises `StorageError`.
    """
    with storage_errors(lock):
        lock.parent.mkdir(parents=True, exist_ok=True)
        held = FileLock(lock)
        held.acquire(poll_interval=_LOCK_POLL_S)
    try:
        yield
    finally:
        lock.unlink(
            missing_ok=True
        )  # while it is held: a process that waits for it notices, and makes it anew
        held.release()
