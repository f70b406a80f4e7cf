"""Data sets and collections for loaders without this toolkit: shards of WebDataset, or Parquet for `datasets`."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Mapping
from math import degrees
from pathlib import Path
from typing import Any, Literal

import numpy as np

from xfreqbench.data.collection import PARTS, Collection, open_collection
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors
from xfreqbench.types import IntArray, NDArray, ProgressCallback, ignore_progress

MAPS_A_SHARD = 1000
_README = """---
configs:
- config_name: default
  data_files:
{splits}
---
{name}: {number} power angular spectra of {rows} elevations (rows) × {columns} azimuths, with peak 1, in half precision.
Of each: `tx_position_m` (x, y, z), `carrier_hz`, `peak_power` by which the map was divided{cfr}{room}.
Rows are elevations from {low:g} to {high:g} degrees, columns azimuths from {first:g} to {last:g}, in even steps, in
the frame of the array.
{array}

```python
{code}
```
"""
Columns = dict[str, NDArray[Any]]  # by name, a row a sample
_CODE = {
    "webdataset": """import glob, webdataset
files = sorted(glob.glob("{split}-*.tar"))
data = webdataset.WebDataset(files, shardshuffle=False).decode().to_tuple("map.npy", "json")
maps, about = next(iter(data))""",
    "datasets": """import os
from datasets import load_dataset  # which takes no "." for a folder
data = load_dataset(os.getcwd(), split="{split}").with_format("numpy")
maps = data[:32]["map"].reshape(-1, {rows}, {columns})""",
}


def export_shards(
    path: Path, folder: Path, to: Literal["webdataset", "datasets"], progress: ProgressCallback = ignore_progress
) -> int:
    """Write a data set, or a collection of rooms, as a folder of shards, whole or not at all; returns how many maps.

    The parts of a collection are splits of their own: `train`, `validation`, `test`, `other_type`. `progress` is called
    with the number of maps that are done and of all. Raises `OutputExistsError` unless `folder` is absent or empty,
    `XFreqBenchError` for a collection without rooms, `DataError` and `StorageError`.
    """
    require_empty(folder)
    write = _write_parquet if to == "datasets" else _write_tar
    splits = _splits(path)
    total, done = sum(map(_num_maps, splits.values())), 0
    with atomic_folder(folder) as temporary, storage_errors(folder):
        for split, data in splits.items():
            num_shards = -(-_num_maps(data) // MAPS_A_SHARD)
            for shard in range(num_shards):
                first = shard * MAPS_A_SHARD
                numbers = np.arange(first, min(first + MAPS_A_SHARD, _num_maps(data)))
                write(temporary / f"{split}-{shard:05d}-of-{num_shards:05d}", _columns(data, numbers), first)
                done += len(numbers)
                progress(done, total)
        (temporary / "README.md").write_text(_readme(splits, total, to), "utf-8")
    return total


def _splits(path: Path) -> Mapping[str, PasDataset | Collection]:
    if not path.is_dir():
        return {"train": open_dataset(path)}
    collection = open_collection(path)
    parts = {part.replace("-", "_"): collection.part(part) for part in PARTS}
    if found := {name: rooms for name, rooms in parts.items() if len(rooms)}:
        return found
    raise XFreqBenchError(f"{path} has no rooms: its generation was not finished. Run the same command again.")


def _num_maps(data: PasDataset | Collection) -> int:
    return data.num_samples if isinstance(data, Collection) else len(data)


def _columns(data: PasDataset | Collection, numbers: IntArray) -> Columns:
    """Columns of the samples of these numbers, which ascend."""
    if isinstance(data, PasDataset):
        return _columns_of(data[numbers])
    found = []
    for room, _, rows in data.by_room(numbers):
        part = data[room][rows]
        receiver = part.header.receiver
        told = {
            "room": data.rooms[room].seed,
            "rx_position_m": receiver.position_m,
            "frame_rotation": receiver.rotation.ravel(),
        }
        repeated = {name: np.stack([np.asarray(value)] * len(part)) for name, value in told.items()}
        found.append(repeated | _columns_of(part))
    return {name: np.concatenate([each[name] for each in found]) for name in found[0]}


def _columns_of(part: PasDataset) -> Columns:
    columns: Columns = {"tx_position_m": part.tx_position_m, "carrier_hz": part.carrier_hz}
    columns["peak_power"] = part.tables["peak_power"].flat[part.rows]
    if part.header.channels:
        columns |= {"cfr_real": part.cfr.real, "cfr_imag": part.cfr.imag}
    return columns | {"map": part.pas().astype(np.float16)}


def _write_tar(path: Path, columns: Columns, first: int) -> None:
    """Two members a sample: `00000000.map.npy` and `00000000.json`. Equal samples give equal bytes."""
    with tarfile.open(path.with_suffix(".tar"), "w") as tar:
        for row, pas_map in enumerate(columns["map"]):
            stored = io.BytesIO()
            np.save(stored, pas_map)
            told = {name: values[row].tolist() for name, values in columns.items() if name != "map"}
            for ending, content in (("map.npy", stored.getvalue()), ("json", json.dumps(told).encode())):
                member = tarfile.TarInfo(f"{first + row:08d}.{ending}")
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))


def _write_parquet(path: Path, columns: Columns, first: int) -> None:
    """A row a sample; a map is a list of fixed length, row by row."""
    import pyarrow.parquet

    arrays = {}
    for name, values in columns.items():
        flat = pyarrow.array(np.ascontiguousarray(values).ravel())
        arrays[name] = flat if values.ndim == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, values[0].size)
    pyarrow.parquet.write_table(pyarrow.table(arrays), path.with_suffix(".parquet"), row_group_size=100)


def _readme(splits: Mapping[str, PasDataset | Collection], total: int, to: str) -> str:
    ending = ".tar" if to == "webdataset" else ".parquet"
    split, data = next(iter(splits.items()))
    one = data[0] if isinstance(data, Collection) else data
    receiver = one.header.receiver
    of_array = receiver.position_m, receiver.rotation, receiver.element_position_wavelengths
    position_m, rotation, elements = (np.round(values, 6).tolist() for values in of_array)
    array = (
        f"The array is at {position_m} m; {rotation} takes its frame to the world, and its elements are at "
        f"{elements} wavelengths in its frame."
    )
    rows, columns = one.grid.shape
    elevation_rad, azimuth_rad = one.grid.elevation_rad, one.grid.azimuth_rad
    room = (
        "; the seed of its `room`, `rx_position_m` (x, y, z) and `frame_rotation`, 3 × 3 row by row, from the array's "
        "axes to the world. Splits are the collection's parts"
    )
    return _README.format(
        splits="\n".join(f"  - split: {name}\n    path: {name}-*{ending}" for name in splits),
        name=f"rooms of family {data.record.name}" if isinstance(data, Collection) else data.recipe,
        number=total,
        rows=rows,
        columns=columns,
        cfr=", and the channel of every element, `cfr_real` and `cfr_imag`" if one.header.channels else "",
        room=room if isinstance(data, Collection) else "",
        low=degrees(elevation_rad[0]),
        high=degrees(elevation_rad[-1]),
        first=degrees(azimuth_rad[0]),
        last=degrees(azimuth_rad[-1]),
        array="" if isinstance(data, Collection) else array,
        code=_CODE[to].format(split=split, rows=rows, columns=columns),
    )
