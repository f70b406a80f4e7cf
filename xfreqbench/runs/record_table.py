"""Records as a table, as they are committed and shipped: Parquet, one row a run, compressed by zstd."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from xfreqbench.errors import DataError
from xfreqbench.runs.records import BenchRecord, RunRecord, StoredRecords, fault_of_fields
from xfreqbench.system.files import atomic_path, read_bytes, storage_errors


def write_table(path: Path, stored: StoredRecords) -> None:
    """Write runs, and tables of measurements, as a Parquet file.

    A column has a field of `RunRecord`, as JSON where it is neither a number nor a text. `ssim` (int16) has the scores
    of all test samples in units of 1e-4, and `num_samples` how many of them each transmitter has, or each room.
    Raises `StorageError`.
    """
    import pyarrow
    import pyarrow.parquet

    rows = []
    for record in stored.records:
        row = record.model_dump(mode="json", exclude={"ssim_by_tx"})
        row |= {name: json.dumps(value) for name, value in row.items() if isinstance(value, dict | list)}
        ssim = np.concatenate([np.zeros(0), *map(np.asarray, record.ssim_by_tx)])
        row |= {"ssim": np.rint(ssim * 1e4).astype(np.int16), "num_samples": [*map(len, record.ssim_by_tx)]}
        rows.append(row)
    rows += [{"bench": bench.model_dump_json()} for bench in stored.benches]
    names = dict.fromkeys(name for row in rows for name in row)
    of_type = {"ssim": pyarrow.list_(pyarrow.int16()), "num_samples": pyarrow.list_(pyarrow.int32())}
    columns = {name: pyarrow.array([row.get(name) for row in rows], of_type.get(name)) for name in names}
    encoded = {"column_encoding": {"ssim.list.element": "BYTE_STREAM_SPLIT"}, "write_page_checksum": True}
    dictionaries = [name for name in names if name not in of_type]
    with atomic_path(path) as temporary, storage_errors(path):
        pyarrow.parquet.write_table(
            pyarrow.table(columns),
            temporary,
            compression="zstd",
            compression_level=19,
            use_dictionary=dictionaries,
            **encoded,
        )


def read_table(path: Path) -> StoredRecords:
    """The records of a file of `write_table`, in its order; raises `DataError` for another file or a damaged one."""
    import pyarrow
    import pyarrow.parquet

    try:
        content = pyarrow.BufferReader(read_bytes(path))
        table = pyarrow.parquet.read_table(content, page_checksum_verification=True)
        rest = table.drop_columns(["ssim", "num_samples"]).to_pylist()
        samples, ssim = (table[name].combine_chunks() for name in ("num_samples", "ssim"))
    except (OSError, KeyError, pyarrow.ArrowException) as error:
        raise DataError(f"{path} is damaged, or no table of records: {str(error).splitlines()[0]}.") from error
    runs, benches = list[RunRecord](), list[BenchRecord]()
    for number, row in enumerate(rest):
        bench = row.pop("bench", None)
        try:
            if bench is not None:
                benches.append(BenchRecord.model_validate(json.loads(bench)))
            else:
                by_tx = [samples[number].values.to_numpy(), ssim[number].values.to_numpy() / 10**4]
                fields = {name: _plain(name, value) for name, value in row.items()}
                runs.append(RunRecord.model_validate({**fields, "ssim_by_tx": by_tx}))
        except (ValidationError, ValueError, LookupError) as error:
            fault = fault_of_fields(error) if isinstance(error, ValidationError) else error
            raise DataError(f"{path}, row {number}, is no record: {fault}.") from error
    return StoredRecords(tuple(runs), tuple(benches))


def _plain(name: str, value: Any) -> Any:
    """The value of a field, of which lists and dictionaries are JSON; a text, such as a scene's name, may look so."""
    is_json = isinstance(value, str) and value[:1] in ("{", "[") and RunRecord.model_fields[name].annotation is not str
    return json.loads(value) if is_json else value
