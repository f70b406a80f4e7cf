"""Writing files: complete or not at all, never over files of others, and with one error for a full disk."""

from __future__ import annotations

import codecs
import csv
import errno
import glob
import hashlib
import json
import math
import os
import platform
import re
import shutil
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from xfreqbench.errors import InUseError, OutputExistsError, StorageError
from xfreqbench.system.machine import now

_LONGEST_WAIT_S = 60.0  # for what takes others a moment, unless they have been suspended


@contextmanager
def atomic_path(target: Path, num_bytes: int = 0, is_claimed: bool = False) -> Iterator[Path]:
    """Yield a temporary path next to `target`, which is renamed to `target` if the block ends without an exception.

    The folder of `target` is made if it is missing, and `num_bytes` of free space are checked first. After an
    exception the temporary file is removed and `target` is as it was. A killed process leaves hidden files
    `.NAME.HOST-PID.partial` and `.NAME.lock`, which the next writer of the same file removes. Raises what `sole_writer`
    raises, unless the caller has claimed the folder for itself, and `OutputExistsError` if somebody else has written
    `target` since `require_own` looked at it, or since the block began. Theirs stays.
    """
    with nullcontext() if is_claimed else sole_writer(target):
        _remove_abandoned(target)
        require_space(target, num_bytes)
        temporary, before = _partial(target), _looked_at.pop(target.absolute(), _state(target))
        _require_unchanged(target, before)
        try:
            with storage_errors(target, num_bytes):
                if num_bytes and hasattr(os, "posix_fallocate"):
                    # a quota or limit is an error here; within HDF5 it would be a crash
                    with temporary.open("wb") as file:
                        os.posix_fallocate(file.fileno(), 0, num_bytes)
            yield temporary
            with storage_errors(target, num_bytes):
                sync(temporary)
                _require_unchanged(target, before)
                temporary.replace(target)
                sync(target.parent)  # or the rename itself may be lost with the power
        finally:
            temporary.unlink(missing_ok=True)


# States of outputs when `require_own` looked at them, until they are written.
_looked_at: dict[Path, tuple[int, ...] | None] = {}


def _require_unchanged(target: Path, before: tuple[int, ...] | None) -> None:
    """Raise `OutputExistsError` if `target` is there, and not in the state that it had before."""
    if _state(target) not in (before, None):
        raise OutputExistsError(
            f"{target} was written by another process in the meantime, and is not overwritten. Choose another "
            "path for the output, or delete this one and try again."
        )


def _state(path: Path) -> tuple[int, ...] | None:
    """Inode, size and time of what lies at a path, which differ after somebody has written it; None for nothing."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def _partial(target: Path) -> Path:
    """The hidden path next to `target` where this process, on this machine, writes it."""
    return target.with_name(f".{target.name}.{platform.node()}-{os.getpid()}.partial")


def _remove_abandoned(target: Path) -> None:
    """Remove partial files of `target` whose processes, on this machine, have ended; others may still be writing."""
    ours = re.compile(rf"{re.escape(f'.{target.name}.{platform.node()}')}-(\d+)\.partial")
    for path in target.parent.glob(f".{glob.escape(target.name)}.*.partial"):
        if found := ours.fullmatch(path.name):
            has_ended = Path("/proc/self").exists() and not Path(f"/proc/{found[1]}").exists()
            if has_ended or int(found[1]) == os.getpid():
                remove(path)


def remove(path: Path) -> None:
    """Remove a file, a folder with all that is in it, or a symbolic link, but never what a link points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def atomic_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder next to `target`, which is renamed to `target` if the block ends without an exception.

    Raises `OutputExistsError` unless `target` is absent or an empty folder, and `StorageError`. A killed process
    leaves a hidden folder `.NAME.HOST-PID.partial`, which the next writer of the same folder removes.
    """
    target = target.absolute()
    require_empty(target)
    with sole_writer(target):
        _remove_abandoned(target)
        temporary = _partial(target)
        with storage_errors(target):
            temporary.mkdir(parents=True)
        try:
            yield temporary
            with storage_errors(target):
                os.sync()
                require_empty(target)  # nor has somebody else written it in the meantime
                temporary.replace(target)
                sync(target.parent)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def require_own(
    path: Path,
    fault_of: Callable[[Path], str | None],
    advice: str = "Choose another path for the output, or delete this one.",
) -> bool:
    """Decide whether a command may write to `path`: True if its own earlier output is there, False if nothing is.

    This is the only place that makes the decision. `fault_of(path)` reads the file and returns None if the
    command may replace it or leave it as it is; otherwise it returns words that follow "PATH exists and".
    Raises `OutputExistsError` with those words and `advice`, and `StorageError` for what is not a regular file
    or cannot be read. What appears at the path after this look is not replaced, see `atomic_path`.
    """
    with storage_errors(path):
        _looked_at[path.absolute()] = _state(path)
        if not path.exists() and not path.is_symlink():
            require_name(path)
            return False
        if not path.is_file():
            raise StorageError(f"{path} is not a file, and nothing can be written in its place. {advice}")
        fault = fault_of(path)
    if fault:
        raise OutputExistsError(f"{path} exists and {fault.rstrip('.')}. {advice}")
    return True


def require_empty(folder: Path) -> None:
    """As `require_own`, for a whole folder: raise `OutputExistsError` unless it is absent or empty."""
    with storage_errors(folder):
        if not folder.exists():
            require_name(folder)
        elif not folder.is_dir() or any(folder.iterdir()):
            raise OutputExistsError(
                f"{folder} exists and is not an empty folder; nothing is written over it. Choose another, or empty it."
            )


def write_text(target: Path, text: str) -> None:
    """Write a text file atomically, with names of files that are not UTF-8 escaped; raises `StorageError`."""
    content = text.encode(errors="backslashreplace")
    with atomic_path(target, len(content)) as temporary, storage_errors(target, len(content)):
        temporary.write_bytes(content)


def write_columns(path: Path, columns: Mapping[str, Iterable[Any]]) -> None:
    """Write columns, by name, as CSV. A text that a spreadsheet would compute as a formula gets an apostrophe first.

    Names of files that are not UTF-8 are escaped. Raises `OSError`.
    """
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(map(_inert, columns))
        writer.writerows(map(_inert, row) for row in zip(*columns.values(), strict=True))


def _inert(cell: Any) -> Any:
    if not isinstance(cell, str) or not cell.startswith(("=", "+", "-", "@", "\t", "\r")):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


@contextmanager
def storage_errors(path: Path, num_bytes: int = 0) -> Iterator[None]:
    """Turn an `OSError` within the block into a `StorageError` that names the path and the bytes needed."""
    try:
        yield
    except OSError as error:
        needed = f", which needs {num_bytes:,} bytes" if num_bytes else ""
        raise StorageError(
            f"{path}{needed}, cannot be written: {error.strerror or error}. "
            "Free some space, correct the folder's permissions, or choose another place."
        ) from error


# Errors that say what is at a path; others say only that the system could not read it.
_OF_THE_PATH = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL)


@contextmanager
def system_errors(path: Path) -> Iterator[None]:
    """Turn errors within the block that say nothing about a file's content into a `StorageError`.

    These are too little memory, a missing permission, and failures of a disk or a server, which may pass.
    """
    try:
        yield
    except MemoryError as error:
        raise StorageError(
            f"{path} cannot be read: there is not enough memory. Close other programs, or use a machine with more."
        ) from error
    except OSError as error:
        if error.errno is None or error.errno in _OF_THE_PATH:  # without a number: a library's, of the content
            raise
        advice = "Correct its permissions" if isinstance(error, PermissionError) else "Try again later"
        raise StorageError(f"{path} cannot be read: {os.strerror(error.errno)}. {advice}.") from error


def require_name(target: Path) -> None:
    """Raise `StorageError` if the name of a new output is too long for the files next to it while it is written."""
    names = _partial(target), target.with_name(f".{target.name}.parts.01234567.removed")
    longest = max(names, key=lambda path: len(os.fsencode(path.name)))
    with storage_errors(target):
        folder = next(parent for parent in target.absolute().parents if parent.exists())
        for given, kept, limit in (
            (target.name, longest.name, os.pathconf(folder, "PC_NAME_MAX")),
            # 256 bytes are left for names within the folder of batches of an output
            (target, longest, os.pathconf(folder, "PC_PATH_MAX") - 256),
        ):
            surplus = len(os.fsencode(kept)) - limit
            if surplus > 0:
                raise StorageError(
                    f"{given} has {len(os.fsencode(given))} bytes, {surplus} too many: temporary files next to it "
                    "have longer names. Choose a shorter name or another place."
                )


def require_text(given: str | Path, use: str = "a record") -> str:
    """A path or another text as it is stored; raises `StorageError` for bytes that are not UTF-8."""
    try:
        str(given).encode()
    except UnicodeEncodeError as error:
        raise StorageError(
            f"{str(given)!r} is not UTF-8, and {use} cannot hold it. Rename it, in letters of UTF-8."
        ) from error
    return str(given)


def require_space(target: Path, num_bytes: int) -> None:
    """Make the folder of a file; raises `StorageError` if there is no space or no permission for `num_bytes` in it."""
    with storage_errors(target, num_bytes):
        target.parent.mkdir(parents=True, exist_ok=True)
        free_bytes = shutil.disk_usage(target.parent).free
    if target.is_dir():
        raise StorageError(f"{target} is a folder; give the path of a file.")
    require_name(target)
    if free_bytes < num_bytes:
        raise StorageError(
            f"{target} needs {num_bytes:,} bytes, but its disk has {free_bytes:,} free. "
            "Free some space or choose another place."
        )


def sync(path: Path) -> None:
    """Write a file's content, or a folder's list of names, to the disk itself before returning."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def exclusive(lock: Path) -> Iterator[None]:
    """Hold a lock for the moment that the block takes; processes that want it take turns.

    Raises as `sole_worker`: `InUseError` only where a process, which may have been suspended, holds it for a minute.
    """
    deadline_s = time.monotonic() + _LONGEST_WAIT_S
    with ExitStack() as held:
        while True:
            try:
                held.enter_context(sole_worker(lock, lock))
                break
            except InUseError:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.02)
        yield


@contextmanager
def sole_worker(lock: Path, output: Path) -> Iterator[str]:
    """Hold a lock during the block, or raise `InUseError` at once, which names the process that works on `output`.

    `lock` is a file that is made for this and removed afterwards; it may be removed during the block. Its first line
    is the text that is yielded: which process this is, and since when. The system releases the lock of a process that
    is killed, whose file stays. Within the block the same thread may hold it once more. Raises `StorageError` where
    the file cannot be made, and where the file system has no locks.
    """
    with storage_errors(output):
        lock.parent.mkdir(parents=True, exist_ok=True)
        held = FileLock(lock, is_singleton=True, fallback_to_soft=False)
        try:
            held.acquire(blocking=False)
        except Timeout as error:
            holder = "another process"
            with suppress(FileNotFoundError):  # it ends at this moment
                holder = lock.read_text(encoding="utf-8").partition("\n")[0] or holder
            raise InUseError(
                f"{output} is being written by {holder}. Wait until that one ends, or choose another output."
            ) from error
        except OSError as error:
            if error.errno not in (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK):
                raise
            raise StorageError(
                f"The file system of {lock.parent} has no locks (flock: {error.strerror}), so two processes could "
                "write the same output. Choose a folder on another one, or mount it with locks (Lustre: -o flock)."
            ) from error
        since = now().isoformat(" ", "seconds")
        holder = f"process {os.getpid()} on {platform.node()}, since {since}"
        is_first = held.lock_counter == 1
    try:
        if is_first:
            with storage_errors(output):
                lock.write_text(holder, encoding="utf-8")
        yield holder
    finally:
        if is_first:
            lock.unlink(missing_ok=True)  # while it is held: a process that waits for it notices, and makes it again
        held.release()


def sole_writer(output: Path) -> AbstractContextManager[object]:
    """Hold the one lock of an output, `.NAME.lock` next to it, during the block; see `sole_worker`.

    Code that works long between checking an output and writing it holds the lock from before the check.
    """
    return sole_worker(output.with_name(f".{output.name}.lock"), output)


def require_regular(path: Path, most_bytes: float = math.inf) -> Path:
    """Return `path`, which is to be read, unless a pipe or a device is there, whose reading may never end.

    Raises `OSError` that names the path, as opening it would: for what is neither a file nor a folder, or is missing,
    and for a file of more than `most_bytes`.
    """
    state = path.stat()
    if not (stat.S_ISREG(state.st_mode) or stat.S_ISDIR(state.st_mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
    if state.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"it has {state.st_size:,} bytes, and at most {most_bytes:,} are allowed", str(path))
    return path


def read_text(path: Path, most_bytes: float = math.inf) -> str:
    """The text in a file, of UTF-8 or, where its byte order mark says so, UTF-16; `\\r\\n` and `\\r` end lines too.

    Raises as `require_regular`, and `UnicodeError`.
    """
    with require_regular(path, most_bytes).open("rb") as file:
        is_utf_16 = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    return path.read_text("utf-16" if is_utf_16 else "utf-8-sig")


def read_bytes(path: Path) -> bytes:
    """The bytes in a file; raises as `require_regular` and `system_errors`."""
    with system_errors(path):
        return require_regular(path).read_bytes()


def json_sha256(content: Any) -> str:
    """Hash of a value that JSON can hold; the order of keys does not matter."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
