"""Reads and writes maps as 8-bit grey PNGs; the only module that does."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray
from PIL import Image

from xfreqbench.errors import DataError
from xfreqbench.system.files import storage_errors

BRIGHTEST = 255
Levels = UInt8[NDArray[np.uint8], "R C"]


def shape_of(path: Path) -> tuple[int, int]:
    """Numbers of rows and columns of a map, from the header of its PNG; raises `DataError` unless it is 8-bit grey."""
    with _opened(path) as image:
        if image.mode != "L":
            raise DataError(f"{path} has pixels of mode {image.mode}; maps are 8-bit grey, mode L.")
        if min(image.size) < 2:
            raise DataError(f"{path} has {image.size} columns and rows; a map has 2 of each or more.")
        return image.height, image.width


def read_levels(path: Path) -> Levels:
    """Grey levels (R, C) of a PNG, from 0 to 255; raises `DataError`."""
    with _opened(path) as image:
        try:
            return np.array(image)
        except (OSError, SyntaxError, ValueError) as error:
            raise _unreadable(path, error) from error


def write_levels(path: Path, levels: Levels) -> None:
    """Write grey levels (R, C) as a PNG; raises `StorageError`."""
    with storage_errors(path):
        Image.fromarray(levels).save(path, format="PNG")


def _opened(path: Path) -> Image.Image:
    try:
        return Image.open(io.BytesIO(path.read_bytes()), formats=["PNG"])
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> DataError:
    return DataError(f"{path} cannot be read as a PNG ({error}). Fetch the file again.")
