"""Files with one bit changed."""

from __future__ import annotations

from pathlib import Path

import h5py


def flip(path: Path, offset: int) -> None:
    """Change the lowest bit of one byte."""
    with path.open("r+b") as file:
        file.seek(offset)
        byte = file.read(1)[0]
        file.seek(offset)
        file.write(bytes([byte ^ 1]))


def data_offset(path: Path, name: str) -> int:
    """Where the values of a dataset begin; of one in chunks, those of its second chunk."""
    with h5py.File(path) as file:
        dataset = file[name]
        return dataset.id.get_chunk_info(1).byte_offset if dataset.chunks else dataset.id.get_offset()
