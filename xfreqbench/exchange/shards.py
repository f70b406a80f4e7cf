"""A data set for loaders without this toolkit: shards of WebDataset, or Parquet as Hugging Face `datasets` reads it."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path
from typing import Any, Literal

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors
from xfreqbench.types import NDArray, ProgressCallback, ignore_progress

MAPS_A_SHARD = 1000
_README = """---
configs:
- config_name: default
  data_files: "*{ending}"
---
{name}: {number} power angular spectra of {rows} elevations (rows) × {columns} azimuths, with peak 1, in half precision.
Of each: `tx_position_m` (x, y, z), `carrier_hz`, `peak_power` by which the map was divided{cfr}.

```python
{code}
```
"""
Columns = dict[str, NDArray[Any]]  # by name, a row a sample
_CFR = ", and the channel of every element, `cfr_real` and `cfr_imag`"
_CODE = {
    "webdataset": """import glob, webdataset
data = webdataset.WebDataset(sorted(glob.glob("*.tar")), shardshuffle=False).decode().to_tuple("map.npy", "json")
maps, about = next(iter(data))""",
    "datasets": """from datasets import load_dataset
data = load_dataset(".", split="train").with_format("numpy")
maps = data[:32]["map"].reshape(-1, {rows}, {columns})""",
}


def export_shards(
    path: Path, folder: Path, to: Literal["webdataset", "datasets"], progress: ProgressCallback = ignore_progress
) -> PasDataset:
    """Write the data set at `path` as a folder of shards, whole or not at all; returns the data set.

    `progress` is told how many maps are done and how many there are. Raises `OutputExistsError` unless `folder` is
    absent or empty, `XFreqBenchError` where pyarrow, which writes Parquet, is not installed, and `StorageError`.
    """
    require_empty(folder)
    write = _write_tar if to == "webdataset" else _parquet_writer()
    dataset = open_dataset(path)
    num_shards = -(-len(dataset) // MAPS_A_SHARD)
    with atomic_folder(folder) as temporary, storage_errors(folder):
        for number in range(num_shards):
            first = number * MAPS_A_SHARD
            part = dataset[first : first + MAPS_A_SHARD]
            write(temporary / f"train-{number:05d}-of-{num_shards:05d}", _columns(part), first)
            progress(first + len(part), len(dataset))
        (temporary / "README.md").write_text(_readme(dataset, to), "utf-8")
    return dataset


def _columns(part: PasDataset) -> Columns:
    columns = {name: getattr(part, name) for name in ("tx_position_m", "carrier_hz", "peak_power")}
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


def _parquet_writer() -> Any:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise XFreqBenchError('Parquet needs the extra "parquet". Run: pip install "xfreqbench[parquet]"') from error

    def write(path: Path, columns: Columns, first: int) -> None:
        """A row a sample; a map is a list of fixed length, row by row."""
        arrays = {}
        for name, values in columns.items():
            flat = pyarrow.array(np.ascontiguousarray(values).ravel())
            size = values[0].size
            arrays[name] = flat if values.ndim == 1 else pyarrow.FixedSizeListArray.from_arrays(flat, size)
        pyarrow.parquet.write_table(pyarrow.table(arrays), path.with_suffix(".parquet"), row_group_size=100)

    return write


def _readme(dataset: PasDataset, to: str) -> str:
    rows, columns = dataset.grid.shape
    return _README.format(
        ending=".tar" if to == "webdataset" else ".parquet",
        name=dataset.recipe,
        number=len(dataset),
        rows=rows,
        columns=columns,
        cfr=_CFR if dataset.header.channels else "",
        code=_CODE[to].format(rows=rows, columns=columns),
    )
