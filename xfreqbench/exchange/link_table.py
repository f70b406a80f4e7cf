"""A data set as a table: one row for each transmitter, carrier and link, with powers and what the paths say."""

from __future__ import annotations

from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset, links, open_dataset, stored_paths
from xfreqbench.data.power import power_db, received_power_dbm
from xfreqbench.data.statistics import of_paths
from xfreqbench.errors import DataError
from xfreqbench.system.files import atomic_path, require_own, storage_errors, write_columns
from xfreqbench.types import NDArray, ProgressCallback, ignore_progress

_OF_PATHS = {  # columns, by the names of `LinkStatistics`
    "num_paths": ("num_paths", 1.0),
    "k_factor_db": ("k_factor_db", 1.0),
    "delay_spread_ns": ("delay_spread_s", 1e9),
    **{
        name: (name, 1.0)
        for end in ("arrival", "departure")
        for name in (f"{end}_azimuth_spread_deg", f"{end}_zenith_spread_deg")
    },
}


def export_link_table(
    path: Path, output: Path, transmit_power_dbm: float | None = None, progress: ProgressCallback = ignore_progress
) -> PasDataset:
    """Write the table of the data set at `path` as CSV, or as Parquet where `output` ends in `.parquet`.

    Columns are those of `link_columns`, of one link after the other; what is not known is empty. `progress` is called
    with the number of links that are done and of all. Raises `OutputExistsError` if `output` exists, `DataError` for
    data without channels, and `StorageError`.
    """
    require_own(output, lambda _: "is not written over.")
    dataset = open_dataset(path)
    num_links, parts = prod(dataset.file_header.link_axes.values()), []
    for done, link in enumerate(links(dataset), start=1):
        parts.append(link_columns(link, transmit_power_dbm))
        progress(done, num_links)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    with atomic_path(output) as temporary, storage_errors(output):
        if output.suffix == ".parquet":
            import pyarrow.parquet

            pyarrow.parquet.write_table(pyarrow.table(columns), temporary)
        else:
            write_columns(temporary, {name: _cells(column) for name, column in columns.items()})
    return dataset


def link_columns(dataset: PasDataset, transmit_power_dbm: float | None = None) -> dict[str, NDArray[Any]]:
    """Columns (N,) of the samples of a link, by name; nan where nothing is known.

    `gain_db` is received over transmitted power, the mean over the array, and `received_power_dbm` is that at a
    transmitter's power, by default the one that the scene states. `local_mean_db` and what follows are of stored paths,
    as in `power_db` and `LinkStatistics`. Raises `DataError` for data without channels.
    """
    header, carrier = dataset.header, dataset.rows % dataset.header.num_carriers
    receiver, pair = dataset.link
    sent = header.settings.get("transmitter_polarization", header.receiver.polarization)
    position_m, unknown = dataset.tx_position_m, np.full(len(dataset), np.nan)
    try:
        received_dbm = received_power_dbm(dataset, transmit_power_dbm)
    except DataError:
        received_dbm = unknown
    columns = {
        "sample": dataset.rows,
        "tx": dataset.tx_index,
        "carrier": carrier,
        "receiver": np.full(len(dataset), receiver or header.receiver.name or ""),
        "polarization": np.full(len(dataset), pair or sent + header.receiver.polarization),
        **{f"{axis}_m": position_m[:, number] for number, axis in enumerate("xyz")},
        "carrier_hz": dataset.carrier_hz,
        "carrier_ghz": dataset.carrier_hz / 1e9,
        "distance_m": np.linalg.norm(position_m - header.receiver.position_m, axis=1),
        "in_sight": dataset.tables["line_of_sight"][dataset.tx_index],
        "gain_db": power_db(dataset),
        "received_power_dbm": received_dbm,
        "local_mean_db": power_db(dataset, 1.0) if header.paths else unknown,
        **dict.fromkeys(_OF_PATHS, unknown),
    }
    if header.paths:
        paths = stored_paths(dataset)[0]
        found = [of_paths(paths, number) for number in range(dataset.header.num_carriers)]
        for column, (name, scale) in _OF_PATHS.items():
            columns[column] = np.stack([each[name] for each in found], axis=1)[dataset.tx_index, carrier] * scale
    return columns


def _cells(values: NDArray[Any]) -> list[Any]:
    """Ten digits of each number, 0 or 1 for no and yes, and nothing for nan."""
    if values.dtype.kind != "f":
        return (values.astype(int) if values.dtype.kind == "b" else values).tolist()
    return ["" if value != value else f"{value:.10g}" for value in values.tolist()]
