"""Predicted maps in a file (schema `xfreqbench/predictions/1`). Only maps that were stored are scored."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Num

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import (
    PACKED,
    Variable,
    create_sealed,
    open_sealed,
    read_array,
    require_layout,
    text_attributes,
    unpacked,
    verify_sealed,
)
from xfreqbench.errors import DataError
from xfreqbench.maps.bartlett import RANGE_TOLERANCE
from xfreqbench.system.files import require_own
from xfreqbench.types import IntArray, NDArray

SCHEMA = "xfreqbench/predictions/1"
_ADVICE = "Delete it and run again."
MapBatch = tuple[IntArray, NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Predictions:
    """Stored predictions for N rows of a data set, whose maps are read in batches."""

    path: Path
    rows: Int[IntArray, "N"]
    dataset_sha256: str
    split_sha256: str

    def batches(self, size: int) -> Iterator[tuple[IntArray, Float[NDArray[np.float32], "n E A"]]]:
        """Yield rows (n,) with their maps (n, E, A), at most `size` at a time; raises `DataError`."""
        with open_sealed(self.path, SCHEMA) as file:
            for start in range(0, len(self.rows), size):
                part = slice(start, start + size)
                maps = unpacked(file["pas"][part])
                if fault := fault_of_maps(maps):
                    raise DataError(f"{self.path}, map of row {self.rows[start + fault[0]]}: it {fault[1]} {_ADVICE}")
                yield self.rows[part], maps

    def require_of(self, dataset: PasDataset) -> None:
        """Raise `DataError` unless the rows are those of samples of a data set, and the maps are on its grid."""
        with open_sealed(self.path, SCHEMA) as file:
            shape = file["pas"].shape[1:]
        rows = self.rows
        is_ascending = len(rows) and rows[0] >= 0 and (np.diff(rows) > 0).all() and rows[-1] < len(dataset)
        if shape != dataset.grid.shape or not is_ascending:
            raise DataError(f"{self.path} does not hold maps of rows of {dataset.path}. {_ADVICE}")

    def maps_of(self, rows: Int[IntArray, "n"], batch_size: int) -> Float[NDArray[np.float32], "n E A"]:
        """Maps (n, E, A) of given rows, in the order given; raises `DataError`, and `KeyError` for a row not stored."""
        wanted = set(rows.tolist())
        found: dict[int, NDArray[np.float32]] = {}
        for batch, maps in self.batches(batch_size):
            found |= {row: maps[i].copy() for i, row in enumerate(batch.tolist()) if row in wanted}
        return np.stack([found[row] for row in rows.tolist()]) if len(rows) else maps[:0]


def fault_of_maps(values: Num[NDArray[Any], "n E A"]) -> tuple[int, str] | None:
    """Index of the first of n arrays that is no map to be scored, and why in words; None if all are.

    A map has values in [0, 1] and peak 1, or is zero everywhere. Maps of runs and of files are judged alike, here.
    """
    with np.errstate(invalid="ignore"):
        in_range = (values >= -RANGE_TOLERANCE) & (values <= 1 + RANGE_TOLERANCE)  # nan is not
    if not in_range.all():
        place = np.argwhere(~in_range)[0].tolist()
        value = values[tuple(place)]
        return place[0], f"has {value:g} at {place[1:]}; maps are finite numbers from 0 to 1, their peak 1."
    peaks = values.max(axis=(1, 2))
    # a peak between two grid points may be lower; a map that was not divided by it is far off
    for low in np.flatnonzero(peaks < 1 - 1e-2):
        if values[low].any():
            return int(low), f"has its peak at {peaks[low]:g}. Divide each map by its own maximum."
    return None


def require_no_others(path: Path, schema: str = SCHEMA) -> None:
    """Raise `OutputExistsError` where a file lies that holds no predictions, which are not to replace it."""

    def fault_of(file: Path) -> str | None:
        try:
            with open_sealed(file, schema):
                return None
        except DataError as error:
            return f"holds no predictions that can be read: {error}"

    require_own(path, fault_of, "Move it elsewhere, and run again.")


def write_predictions(
    path: Path,
    batches: Iterable[MapBatch],
    num_rows: int,
    grid_shape: tuple[int, int],
    dataset_sha256: str,
    split_sha256: str,
) -> None:
    """Store batches of rows (n,) and maps (n, E, A), packed; the file is written whole or not at all.

    Raises `StorageError`, what `require_no_others` raises, and `DataError` if the batches do not hold `num_rows` rows
    together.
    """
    require_no_others(path)
    attributes = {"schema": SCHEMA, "dataset_sha256": dataset_sha256, "split_sha256": split_sha256}
    with create_sealed(path, _variables(num_rows, grid_shape), attributes) as writer:
        writer.append("elevation", np.arange(grid_shape[0]))
        writer.append("azimuth", np.arange(grid_shape[1]))
        for rows, maps in batches:
            writer.append("row", rows)
            writer.append("pas", maps)


def read_predictions(path: Path) -> Predictions:
    """Open stored predictions after checking every byte and the layout of the file; raises `DataError`."""
    verify_sealed(path, SCHEMA)
    with open_sealed(path, SCHEMA) as file:
        attributes = text_attributes(file)
        rows = read_array(file, "row")
        num_elevations, num_azimuths = (read_array(file, name).size for name in ("elevation", "azimuth"))
        require_layout(file, _variables(rows.size, (num_elevations, num_azimuths)))
        return Predictions(path, rows, attributes["dataset_sha256"], attributes["split_sha256"])


def _variables(num_rows: int, grid_shape: tuple[int, int]) -> list[Variable]:
    E, A = grid_shape
    axes = ("row", "elevation", "azimuth")
    return [
        Variable("row", "<i8", (num_rows,), ("row",), "1", "row of the data set: tx · F + carrier"),
        Variable("elevation", "<i4", (E,), ("elevation",), "1", "index of the data set's elevation"),
        Variable("azimuth", "<i4", (A,), ("azimuth",), "1", "index of the data set's azimuth"),
        Variable("pas", PACKED, (num_rows, E, A), axes, "1", "predicted map", chunk=(1, E, A)),
    ]
