"""Arrays of a long work, kept piece by piece until it is whole."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.errors import DataError, StorageError
from xfreqbench.system.array_files import unpacked
from xfreqbench.system.files import atomic_path, storage_errors
from xfreqbench.types import NDArray


class Pieces:
    """The pieces of one work in a folder, by their numbers; `key` is the hash of everything that determines them.

    `kept` are the numbers of those that were there at the beginning, from processes before this one.

    A file's name has the number of the piece, the key and the sha256 of its bytes, and these bytes hold number and key
    once more. It is written under another name, synced and renamed. One with the right sha256 and key is therefore a
    complete piece of this very work, whatever process wrote it; one that is cut short, damaged or of another work is
    not there.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.folder = folder
        self._key = key[:16]
        pattern = f"[0-9]*-{self._key}-*.npz"
        self._paths = {_number(path): path for path in folder.glob(pattern) if self._arrays(path) is not None}
        self.kept = sorted(self._paths)

    def __contains__(self, number: int) -> bool:
        return number in self._paths

    def put(self, number: int, **arrays: Any) -> None:
        """Keep a piece; raises `StorageError`."""
        buffer = io.BytesIO()
        np.savez(buffer, batch=self._name(number), **arrays)
        content = buffer.getvalue()
        path = self.folder / f"{self._name(number)}-{hashlib.sha256(content).hexdigest()}.npz"
        with atomic_path(path, len(content), is_claimed=True) as temporary, storage_errors(path, len(content)):
            temporary.write_bytes(content)
        self._paths[number] = path

    def get(self, number: int) -> dict[str, NDArray[Any]]:
        """The arrays of a piece; raises `StorageError` if it is there no longer, or was changed."""
        arrays = self._arrays(self._paths[number])
        if arrays is None:
            raise StorageError(f"Piece {number} is missing in {self.folder}. Run the same command again.")
        return arrays

    def _arrays(self, path: Path) -> dict[str, NDArray[Any]] | None:
        """The arrays in a file; None if it is not a complete piece of this work. Links are not followed."""
        if path.is_symlink() or not path.is_file():
            return None
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != path.stem.rpartition("-")[2]:
            return None
        try:
            stored = unpacked(path, content, None, "")
            return stored if str(stored.pop("batch")) == self._name(_number(path)) else None
        except (DataError, LookupError):
            return None

    def _name(self, number: int) -> str:
        return f"{number:06d}-{self._key}"


def _number(path: Path) -> int:
    return int(path.name.partition("-")[0])
