"""Files on web servers; only the bytes that are asked for are read.

They are read by remfile, in the thread that asks. fsspec, which asks in a thread of its own, waits forever where the
garbage collector frees an object of HDF5 in that thread: HDF5 is locked by the one that waits for it.
"""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path, PosixPath
from typing import Any

from xfreqbench.errors import DataError, XFreqBenchError

MOST_BYTES = 200_000_000  # of records, or of what describes a collection; the reference records have 25 MB


class RemotePath(PosixPath):
    """The address of a file on a web server (http, https) in the place of its path: `str` gives the address."""

    def __str__(self) -> str:
        return super().__str__().replace(":/", "://", 1)

    def resolve(self, strict: bool = False) -> RemotePath:
        """The address, as it is."""
        return self

    def ranges(self) -> Any:
        """The file, opened to read, which asks the server for ranges of bytes; the same one at each call.

        What was read is kept in memory, up to 1 GB. Raises `DataError` if there is no such file, and `XFreqBenchError`
        if the extra is not installed.
        """
        return _opened(str(self), os.getpid())

    def read_bytes(self) -> bytes:
        """All bytes of the file; raises as `ranges`, and `DataError` if the server fails, or has too many."""
        file = self.ranges()
        try:
            if file.length > MOST_BYTES:
                raise ValueError(f"it has {file.length:,} bytes, more than {MOST_BYTES:,}")
            file.seek(0)
            return bytes(file.read(file.length))
        except Exception as error:  # remfile's have no other type
            raise DataError(f"{self} cannot be read: {error}. Try again later.") from error


def located(path: str | Path) -> Path:
    """The path, or the address where it is one."""
    is_address = str(path).startswith(("http://", "https://"))
    return RemotePath(path) if is_address else Path(path)


@lru_cache(maxsize=8)
def _opened(address: str, process: int) -> Any:  # a forked process opens it again, because connections are not shared
    try:
        import remfile
        import requests
    except ImportError as error:
        advice = 'Run: pip install "xfreqbench[remote]"'
        raise XFreqBenchError(f'Reading from a server needs the extra "remote". {advice}') from error
    try:
        with requests.get(address, headers={"Range": "bytes=0-0"}, stream=True, timeout=30.0) as answer:
            answer.raise_for_status()
            gives_ranges = answer.status_code == requests.codes.partial_content
        if gives_ranges:
            return remfile.File(address)
    except Exception as error:  # remfile's have no other type
        raise DataError(f"{address} cannot be opened: {error}. Correct the address, or try again later.") from error
    raise DataError(f"The server of {address} does not send parts of files. Download it: xfreqbench.fetch({address!r})")
