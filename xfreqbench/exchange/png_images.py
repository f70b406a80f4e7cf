"""Reads and writes maps as 8-bit grey PNGs; the only module that does."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray
from PIL import Image

from xfreqbench.errors import DataError
from xfreqbench.system.files import require_regular, storage_errors

BRIGHTEST = 255
MAX_PIXELS = 1_000_000  # a map with a step of a fifth of a degree has 810,000
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
    """Grey levels (R, C) of a PNG, from 0 to 255, every byte checked by the file's sums; raises `DataError`."""
    try:
        with _opened(path) as image:
            image.verify()  # decoding alone does not look at the sums of pixels
        with _opened(path) as image:
            return np.array(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise _unreadable(path, error) from error


def write_levels(path: Path, levels: Levels) -> None:
    """Write grey levels (R, C) as a PNG; raises `StorageError`."""
    with storage_errors(path):
        Image.fromarray(levels).save(path, format="PNG")


def _opened(path: Path) -> Image.Image:
    """The image in a file, of which only the header is read yet; raises `DataError`, also where it is too large."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # its limit is above ours
            image = Image.open(require_regular(path), formats=["PNG"])
    except Image.DecompressionBombError as error:
        raise _too_large(path) from error
    except (OSError, SyntaxError, ValueError) as error:
        raise _unreadable(path, error) from error
    if image.width * image.height > MAX_PIXELS:
        image.close()
        raise _too_large(path)
    return image


def _too_large(path: Path) -> DataError:
    return DataError(f"{path} has more than {MAX_PIXELS:,} pixels, the most of a map. Export it with fewer.")


def _unreadable(path: Path, error: Exception) -> DataError:
    fault = getattr(error, "strerror", None) or error
    return DataError(f"{path} cannot be read as a PNG ({fault}). Fetch the file again.")
