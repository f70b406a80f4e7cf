"""Writes split files (schema `xfreqbench/split/1`): what a method elsewhere may know, and no map that it is tested on.

A file has one group for each split, named as the split:

    train_row, test_row                          rows of the data set, (n,) and (N,)
    train_tx_position_m, test_tx_position_m      transmitter positions in the world, (n, 3) and (N, 3)
    train_carrier_hz, test_carrier_hz            carriers, (n,) and (N,)
    elevation_deg, azimuth_deg                   directions of the maps, (E,) and (A,)
    rx_position_m, element_position_wavelengths, frame_rotation      the receiver
    train_pas                                    if maps are asked for: training maps (n, E, A), float32, peak 1

The attributes of a group are the kind of map, the receiver in JSON, the protocol with its version, and the sha256 of
data set and split. `xfreqbench.exchange.score_file` says which of them a file of predictions copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import Variable, create_sealed, open_sealed, text_attributes, verify_sealed
from xfreqbench.data.schema import CARRIER, TX, constants, variables
from xfreqbench.data.splits import Split
from xfreqbench.errors import DataError, ProtocolError
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.system.files import json_sha256, require_own
from xfreqbench.types import NDArray, ProgressCallback, ignore_progress

SCHEMA = "xfreqbench/split/1"


def write_splits(
    dataset: PasDataset,
    splits: Sequence[Split],
    path: Path,
    maps: bool = False,
    progress: ProgressCallback = ignore_progress,
) -> bool:
    """Write a split file of splits of one protocol; returns False, and writes nothing, if it is there already.

    With `maps`, their training maps come along. `progress` is called with the number of maps that are written and of
    all; a few of them are in memory at once. Raises `ProtocolError` for splits that a file cannot hold,
    `OutputExistsError` if `path` holds something else, `StorageError`, and `DataError` if a map cannot be read.
    """
    if any(split.receivers for split in splits):
        raise ProtocolError(
            f"Protocol {splits[0].protocol!r} trains on other receivers, which a split file cannot hold. "
            "Choose another protocol."
        )
    if maps:
        _require_untold(splits)
    sha256 = json_sha256([SCHEMA, dataset.sha256, [split.sha256 for split in splits], maps])
    if require_own(path, lambda file: _fault_of(file, sha256)):
        return False
    known = [entry for split in splits for entry in _known(dataset, split, maps)]
    stored = [variable for variable, _ in known]
    groups = {split.name: _attributes(dataset, split) for split in splits}
    done, num_maps = 0, sum(len(split.train) for split in splits)
    with create_sealed(path, stored, {"schema": SCHEMA, "content_sha256": sha256}, groups) as writer:
        for variable, values in known:
            if values is not None:
                writer.append(variable.name, values)
        for split in splits if maps else ():
            for start in range(0, len(split.train), BATCH_SIZE):
                part = dataset.pas(split.train[start : start + BATCH_SIZE])
                writer.append(f"{split.name}/train_pas", part)
                done += len(part)
                progress(done, num_maps)
    return True


def _require_untold(splits: Sequence[Split]) -> None:
    """Raise `ProtocolError` if a training map of one split is tested by another."""
    for split in splits:
        for other in splits:
            if np.isin(split.train, other.test).any():
                raise ProtocolError(
                    f"With its training maps, split {split.name!r} contains maps that {other.name!r} tests. "
                    "Choose one of them with --targets, leave --maps out, or choose a protocol that never "
                    "trains on a map that it also tests: sparse, held-out-tx, held-out-block, lofo-unseen-tx or "
                    "random-samples."
                )


def _fault_of(path: Path, sha256: str) -> str | None:
    """In words, what a file holds other than the splits with that hash; None if it holds these."""
    try:
        verify_sealed(path, SCHEMA)
        with open_sealed(path, SCHEMA) as file:
            found = text_attributes(file)["content_sha256"]
    except DataError as error:
        return f"holds no splits that can be read: {error}"
    return None if found == sha256 else "holds other splits, or those of another data set"


def _attributes(dataset: PasDataset, split: Split) -> dict[str, str]:
    header = dataset.header.attributes()
    return {
        "split_sha256": split.sha256,
        "dataset_sha256": dataset.sha256,
        "protocol": split.protocol,
        "protocol_version": split.version,
        **{name: header[name] for name in ("scene_name", "pas_kind", "receiver_json")},
    }


def _known(dataset: PasDataset, split: Split, with_maps: bool) -> list[tuple[Variable, NDArray[Any] | None]]:
    """The variables of a split with their values, which are None for maps."""
    header, (E, A) = dataset.header, dataset.grid.shape
    # axes, grid and receiver as a data set stores them: what every method may know
    geometry = {name: values for name, values in constants(header, dataset.grid).items() if name not in (TX, CARRIER)}
    known: list[tuple[Variable, NDArray[Any] | None]] = [
        (variable, geometry[variable.name]) for variable in variables(header, dataset.grid) if variable.name in geometry
    ]
    for part, rows in (("train", split.train), ("test", split.test)):
        samples, row, shape = dataset[rows], f"{part}_row", (len(rows),)
        place = Variable(f"{part}_tx_position_m", "<f8", (*shape, 3), (row, "axis"), "m", "transmitter position")
        known += [
            (Variable(row, "<i8", shape, (row,), "1", "row of the data set: tx · F + carrier"), rows),
            (place, samples.tx_position_m),
            (Variable(f"{part}_carrier_hz", "<f8", shape, (row,), "Hz", "carrier frequency"), samples.carrier_hz),
        ]
    if with_maps:
        axes = ("train_row", "elevation_deg", "azimuth_deg")
        long_name = f"power angular spectrum ({header.pas_kind}), peak 1"
        maps = Variable("train_pas", "<f4", (len(split.train), E, A), axes, "1", long_name, chunk=(1, E, A))
        known.append((maps, None))
    prefix = f"{split.name}/"
    return [
        (replace(variable, name=prefix + variable.name, axes=tuple(prefix + axis for axis in variable.axes)), values)
        for variable, values in known
    ]
