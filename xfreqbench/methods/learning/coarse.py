"""A data set seen on a coarser grid, whose maps are read once and kept: what trivial predictors are compared on."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset, Rows, chosen_rows
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.types import NDArray

_AT_ONCE = 256  # maps of the fine grid in memory


@dataclass(frozen=True, eq=False, repr=False)
class CoarseDataset(PasDataset):
    """Samples on every `stride`-th row and column of their grid.

    Its maps are those of the `fine` samples, there, scaled as these are. They stay in memory, 14 kB each where the
    stride is 3, and subsets share them.
    """

    fine: PasDataset | None = None
    stride: int = 1
    kept: dict[int, Float[NDArray[np.float32], "E A"]] = field(default_factory=dict)

    @classmethod
    def of(cls, fine: PasDataset, stride: int) -> CoarseDataset:
        """The samples of a data set, coarsely."""
        grid = AngularGrid(fine.grid.elevation_rad[::stride], fine.grid.azimuth_rad[::stride])
        known: dict[str, Any] = {entry.name: getattr(fine, entry.name) for entry in fields(PasDataset)}
        known["beam"] = BartlettBeam(fine.beam.element_position_wavelengths, grid)
        return cls(**known, fine=fine, stride=stride)

    def pas(self, rows: Rows | int = slice(None)) -> Float[NDArray[np.float32], "n E A"]:
        """As `PasDataset.pas`, with maps of the coarse grid."""
        asked = self.rows[chosen_rows(rows, len(self))]
        missing = np.array([row for row in np.unique(asked).tolist() if row not in self.kept], np.int64)
        assert self.fine is not None
        for start in range(0, len(missing), _AT_ONCE):
            part = replace(self.fine, rows=missing[start : start + _AT_ONCE])
            coarse = part.pas()[:, :: self.stride, :: self.stride].copy()
            self.kept.update(zip(part.rows.tolist(), coarse, strict=True))
        return np.array([self.kept[row] for row in asked.tolist()], np.float32).reshape(-1, *self.grid.shape)
