"""The paths of a data set as rectangular arrays, as other projects keep them, and a folder of them as in Sionna RT."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Shaped

from xfreqbench.data.dataset import PasDataset, open_dataset, stored_paths
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors
from xfreqbench.tracing.paths import RaggedPaths
from xfreqbench.types import FloatArray, IntArray, NDArray, ProgressCallback, ignore_progress


class PaddedPaths:
    """The paths of T transmitters as arrays of T × L, L the longest list, and of T × L × D for their interactions.

    `gain` (P,) are the gains of all P paths at one carrier, by which paths are ordered, the strongest of a transmitter
    first, where `strongest_first`; otherwise the earliest is first.
    """

    def __init__(self, paths: RaggedPaths, carrier: int, strongest_first: bool = False) -> None:
        self.paths = paths
        self.gain: Complex[NDArray[np.complex128], "P"] = paths.gain[:, carrier].astype(np.complex128)
        tx = np.repeat(np.arange(len(paths.num_paths)), paths.num_paths)
        first = np.cumsum(paths.num_paths) - paths.num_paths
        place = np.arange(len(tx)) - first[tx]
        if strongest_first:
            order = np.lexsort((place, -np.abs(self.gain), tx))
            place[order] = np.arange(len(tx)) - first[tx]
        self._place: tuple[IntArray, IntArray] = (tx, place)
        self.shape = len(paths.num_paths), int(paths.num_paths.max(initial=0))
        self.depth = int(paths.num_interactions.max(initial=0))

    def of_paths(self, values: Shaped[NDArray[Any], "P"], padding: complex) -> Shaped[NDArray[Any], "T L"]:
        """A number of each path, in its transmitter's row."""
        table = np.full(self.shape, padding, values.dtype)
        table[self._place] = values
        return table

    def of_interactions(
        self, values: Shaped[NDArray[Any], "I *S"], padding: complex, backwards: bool = False
    ) -> Shaped[NDArray[Any], "T L D *S"]:
        """What belongs to each interaction, along its path from the transmitter, or from the receiver, `backwards`."""
        count = self.paths.num_interactions
        path = np.repeat(np.arange(len(count)), count)
        step = np.arange(len(path)) - (np.cumsum(count) - count)[path]
        step = count[path] - 1 - step if backwards else step
        table = np.full((*self.shape, self.depth, *values.shape[1:]), padding, values.dtype)
        table[self._place[0][path], self._place[1][path], step] = values
        return table

    def zenith_rad(self, elevation_rad: Float[NDArray[np.float32], "P"], padding: float) -> Float[FloatArray, "T L"]:
        """Angles from the world's z axis, from elevations above its xy plane."""
        return self.of_paths(np.pi / 2 - elevation_rad.astype(np.float64), padding)


def carrier_names(dataset: PasDataset) -> Iterator[tuple[int, float, str]]:
    """Number and frequency of each carrier, and a name for what is written of it, such as `office_24.25ghz`."""
    letters = (letter if letter.isalnum() else "_" for letter in dataset.header.scene_name.lower())
    scene = "".join(letters)
    for carrier, carrier_hz in enumerate(dataset.header.carrier_hz.tolist()):
        yield carrier, carrier_hz, f"{scene}_{carrier_hz / 1e9:.12g}ghz"


def export_sionna_npz(path: Path, folder: Path, progress: ProgressCallback = ignore_progress) -> PasDataset:
    """Write the paths of the data set at `path` as `SCENE_24.25ghz.npz`, …; returns the data set.

    Arrays are those of a solve with synthetic arrays and one receiver of one antenna, the array's centre. T
    transmitters, L paths at most, D interactions at most: `a` (1, 1, T, 1, L); `valid`, `tau`, `theta_t`, `phi_t`,
    `theta_r` and `phi_r` (1, T, L); `interactions` and `objects` (D, 1, T, L); `vertices` (D, 1, T, L, 3); `sources`
    (T, 3); `targets` (1, 3). `objects` number `object_names`, and `frequency` is the carrier in hertz.

    `progress` is called with the number of carriers that are done and of all. Raises `OutputExistsError` unless
    `folder` is absent or empty, `DataError` if no paths are stored, and `StorageError`.
    """
    require_empty(folder)
    dataset = open_dataset(path)
    paths, surface_names = stored_paths(dataset)
    with atomic_folder(folder) as temporary, storage_errors(folder):
        for carrier, carrier_hz, name in carrier_names(dataset):
            padded = PaddedPaths(paths, carrier)
            # where there is none, Sionna RT has -1 for a path's delay, and 0xFFFFFFFF for an object
            tables: dict[str, Any] = {
                "valid": padded.of_paths(np.ones(len(padded.gain), bool), False),
                "tau": padded.of_paths(paths.delay_s, -1.0),
                "theta_t": padded.zenith_rad(paths.departure_elevation_rad, 0.0),
                "phi_t": padded.of_paths(paths.departure_azimuth_rad, 0.0),
                "theta_r": padded.zenith_rad(paths.arrival_elevation_rad, 0.0),
                "phi_r": padded.of_paths(paths.arrival_azimuth_rad, 0.0),
            }
            along: dict[str, Any] = {
                "interactions": padded.of_interactions(paths.interaction.astype(np.uint32), 0),
                "objects": padded.of_interactions(paths.surface.astype(np.uint32), 0xFFFFFFFF),
                "vertices": padded.of_interactions(paths.vertex_m, 0.0),
            }
            np.savez_compressed(
                temporary / f"{name}.npz",
                a=padded.of_paths(padded.gain, 0.0)[None, None, :, None],
                sources=dataset.tables["tx_position_m"],
                targets=np.array([dataset.header.receiver.position_m]),
                object_names=np.array(surface_names, np.str_),
                frequency=np.array(carrier_hz),
                **{key: table[None] for key, table in tables.items()},
                **{key: np.moveaxis(table, 2, 0)[:, None] for key, table in along.items()},
            )
            progress(carrier + 1, dataset.header.num_carriers)
    return dataset
