"""Writes a data set of channels and maps, some transmitters at a time."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from xfreqbench.data.hdf5 import create_sealed
from xfreqbench.data.paths import GROUP, INTERACTION_OFFSET, OFFSET, RAGGED, PathTotals, path_variables
from xfreqbench.data.schema import UNKNOWN_NUM_PATHS, DatasetHeader, constants, variables
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.tracing.paths import RaggedPaths
from xfreqbench.types import FloatArray, NDArray


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """The samples of T transmitters at F carriers, of each link of the file, as a data set stores them.

    Each map has peak 1, or is zero if no path arrives. `cfr` is None for maps without channels.
    """

    maps: Float[NDArray[np.float32], "T *L F E A"]
    peak_power: Float[FloatArray, "T *L F"]
    num_paths: Int[NDArray[np.integer], "T *L F"]
    cfr: Complex[NDArray[np.complex64], "T *L F M"] | None = None

    @classmethod
    def of_channels(
        cls,
        cfr: Complex[NDArray[np.complexfloating], "T *L F M"],
        num_paths: Int[NDArray[np.integer], "T *L F"],
        beam: BartlettBeam,
        kind: PasKind,
    ) -> SampleBlock:
        """Samples of channels, with the maps (Eqs. 2–3) of the channels as they are stored, in complex64.

        All maps are in memory at once: 1.3 MB a transmitter at ten carriers.
        """
        stored = cfr.astype(np.complex64)
        maps, peak_power = beam.maps(stored.reshape(-1, stored.shape[-1]), kind)
        sample_shape = stored.shape[:-1]
        return cls(maps.reshape(*sample_shape, *beam.grid.shape), peak_power.reshape(sample_shape), num_paths, stored)

    @classmethod
    def of_maps(
        cls, maps: Float[NDArray[np.float32], "T F E A"], peak_power: Float[FloatArray, "T F"] | None = None
    ) -> SampleBlock:
        """Samples of maps without channels; `peak_power` is 1 unless it is given, and 0 where the map is zero."""
        is_heard = np.asarray(maps.any(axis=(2, 3)))
        power = is_heard.astype(np.float64) if peak_power is None else peak_power
        return cls(maps, power, np.where(is_heard, UNKNOWN_NUM_PATHS, 0))


class PasWriter(ExitStack):
    """Writes one data set: a context manager that takes samples in blocks and leaves a complete file, or none.

    Maps are on `grid`, by default the hemisphere, and are stored if the header says so. If the header says that paths
    are stored, `paths` are the numbers of those that will be appended. Raises `StorageError` if the file cannot be
    written, at the beginning if there is too little space, and `DataError` if the number of appended transmitters is
    not that of the header. A file at `path` is replaced only at the end: `prove` is called with the path of the sealed
    file, which is removed if that raises. Raises `OutputExistsError` if somebody else has written `path` since.
    """

    def __init__(
        self,
        path: Path,
        header: DatasetHeader,
        grid: AngularGrid | None = None,
        prove: Callable[[Path], None] | None = None,
        paths: PathTotals | None = None,
    ) -> None:
        super().__init__()
        self._header = header
        self._grid = grid or AngularGrid.hemisphere()
        self._num_paths = self._num_points = 0
        stored, groups = variables(header, self._grid), dict[str, dict[str, str]]()
        if header.paths:
            totals = paths or PathTotals(0, 0, ())
            stored += path_variables(header, totals)
            groups[GROUP] = totals.attributes
        attributes: dict[str, str | int] = {**header.attributes(), "num_tx": header.num_tx}  # a number as such
        self._context = create_sealed(path, stored, attributes, groups, prove)

    def __enter__(self) -> PasWriter:
        self._file = self.enter_context(self._context)
        for name, values in constants(self._header, self._grid).items():
            self._file.append(name, values)
        if self._header.paths:
            for offset in (OFFSET, INTERACTION_OFFSET):
                self._file.append(offset, np.zeros(1))
        return self

    def append(
        self,
        tx_position_m: Float[FloatArray, "T 3"],
        line_of_sight: Bool[NDArray[np.bool_], "T *R"],
        samples: SampleBlock,
        paths: RaggedPaths | None = None,
    ) -> None:
        """Write the next T transmitters with their samples; raises `DataError` if they do not fit the header.

        Their `paths` are needed if the header says that paths are stored.
        """
        stored: dict[str, NDArray[Any]] = {"pas": samples.maps} if samples.cfr is None else {"cfr": samples.cfr}
        stored["peak_power"] = samples.peak_power
        if self._header.maps:  # the order is that of the file: equal data have had equal bytes since 0.1
            stored["pas"] = samples.maps
        stored |= {"tx_position_m": tx_position_m, "line_of_sight": line_of_sight, "num_paths": samples.num_paths}
        for name, rows in (stored | {"complete": np.ones(len(tx_position_m))}).items():
            self._file.append(name, rows)
        if not self._header.paths or paths is None:
            return
        num_paths, num_points = len(paths.delay_s), len(paths.interaction)
        self._file.append(OFFSET, self._num_paths + np.cumsum(paths.num_paths))
        self._file.append(INTERACTION_OFFSET, self._num_points + np.cumsum(paths.num_interactions))
        self._file.append(f"{GROUP}/path", self._num_paths + np.arange(num_paths))
        self._file.append(f"{GROUP}/point", self._num_points + np.arange(num_points))
        for name in RAGGED:
            self._file.append(f"{GROUP}/{name}", getattr(paths, name))
        self._num_paths, self._num_points = self._num_paths + num_paths, self._num_points + num_points
