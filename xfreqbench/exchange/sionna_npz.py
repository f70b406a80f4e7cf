"""Paths as NumPy archives, one for each carrier, whose arrays are named and padded as those of Sionna RT's `Paths`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.exchange.path_arrays import PaddedPaths, carrier_names, stored_paths
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors
from xfreqbench.types import ProgressCallback, ignore_progress

INVALID_SHAPE = 0xFFFFFFFF  # Sionna RT's mark for no object
_NO_DELAY_S = -1.0  # Sionna RT's mark for no path


def export_sionna_npz(path: Path, folder: Path, progress: ProgressCallback = ignore_progress) -> PasDataset:
    """Write the paths of the data set at `path` as `SCENE_24.25ghz.npz`, …; returns the data set.

    Arrays are those of a solve with synthetic arrays and one receiver of one antenna, the array's centre. T
    transmitters, L paths at most, D interactions at most: `a` (1, 1, T, 1, L); `valid`, `tau`, `theta_t`, `phi_t`,
    `theta_r` and `phi_r` (1, T, L); `interactions` and `objects` (D, 1, T, L); `vertices` (D, 1, T, L, 3); `sources`
    (T, 3); `targets` (1, 3). `objects` number `object_names`, and `frequency` is the carrier in hertz.

    `progress` is told how many carriers are done and how many there are. Raises `OutputExistsError` unless `folder`
    is absent or empty, `DataError` where no paths are stored, and `StorageError`.
    """
    require_empty(folder)
    verify(path)
    dataset = open_dataset(path)
    paths, surface_names = stored_paths(dataset)
    with atomic_folder(folder) as temporary, storage_errors(folder):
        for carrier, carrier_hz, name in carrier_names(dataset):
            padded = PaddedPaths(paths, carrier)
            tables: dict[str, Any] = {
                "valid": padded.is_path,
                "tau": padded.of_paths(paths.delay_s, _NO_DELAY_S),
                "theta_t": padded.zenith_rad(paths.departure_elevation_rad, 0.0),
                "phi_t": padded.of_paths(paths.departure_azimuth_rad, 0.0),
                "theta_r": padded.zenith_rad(paths.arrival_elevation_rad, 0.0),
                "phi_r": padded.of_paths(paths.arrival_azimuth_rad, 0.0),
            }
            along: dict[str, Any] = {
                "interactions": padded.of_interactions(paths.interaction.astype(np.uint32), 0),
                "objects": padded.of_interactions(paths.surface.astype(np.uint32), INVALID_SHAPE),
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
            progress(carrier + 1, dataset.num_carriers)
    return dataset
