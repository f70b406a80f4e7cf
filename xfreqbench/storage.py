"""Files that are whole or absent, and one wording for a disk that cannot take them."""

from __future__ import annotations

import fcntl
import glob
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from xfreqbench.errors import OutputExistsError, StorageError


@contextmanager
def atomic_path(target: Path, num_bytes: int = 0) -> Iterator[Path]:
    """Temporary path beside `target`, renamed to it when the block ends without an exception.

    The folder is made where it is missing, and `num_bytes` of free space are asked for first. After an
    exception the temporary file is removed and `target` is what it was; what a killed process left, a
    hidden `.NAME.PID.partial`, goes with the next try. Raises `StorageError`.
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
    """Remove what killed processes left of this very file; a living one may still be writing its own."""
    for path in target.parent.glob(f".{glob.escape(target.name)}.*.partial"):
        process = path.name.split(".")[-2]
        if process.isdigit() and not Path(f"/proc/{process}").exists() and Path("/proc/self").exists():
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


@contextmanager
def atomic_folder(target: Path) -> Iterator[Path]:
    """Temporary folder beside `target`, renamed to it when the block ends without an exception.

    `target` must be absent, or an empty folder: raises `OutputExistsError` else, and `StorageError`. What a
    killed process left, a hidden `.NAME.PID.partial`, goes with the next try.
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


def require_empty(folder: Path) -> None:
    """Raise `OutputExistsError` for anything but an empty folder, or nothing, at a path."""
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise OutputExistsError(
            f"{folder} exists, and is no empty folder; nothing is written over it. Choose another, or empty it."
        )


def write_text(target: Path, text: str) -> None:
    """Write a text file atomically; raises `StorageError`."""
    content = text.encode()
    with atomic_path(target, len(content)) as temporary, storage_errors(target, len(content)):
        temporary.write_bytes(content)


@contextmanager
def storage_errors(path: Path, num_bytes: int = 0) -> Iterator[None]:
    """Turn an `OSError` of a write into a `StorageError` that names the path and the bytes needed."""
    try:
        yield
    except OSError as error:
        needed = f", which needs {num_bytes:,} bytes" if num_bytes else ""
        raise StorageError(
            f"{path}{needed}, cannot be written: {error.strerror or error}. "
            "Free some space, mend the folder's permissions, or choose another place."
        ) from error


def require_space(target: Path, num_bytes: int) -> None:
    """Make the folder of a file; raises `StorageError` where the file has no room or no permission."""
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
    """Claim and release the space: quotas and limits show now, not within HDF5, which crashes on them."""
    if num_bytes and hasattr(os, "posix_fallocate"):
        with temporary.open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, num_bytes)


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on disk before this returns."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def exclusive(lock: Path) -> Iterator[None]:
    """Hold a lock file that one process holds at a time, waiting for it; the file is gone afterwards.

    A killed process lets go of it. Raises `StorageError`.
    """
    with storage_errors(lock):
        lock.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _locked(lock)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def _locked(lock: Path) -> int:
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        if _is_open_at(lock, descriptor):
            return descriptor
        os.close(descriptor)  # whoever held it has removed it


def _is_open_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False
