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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.hdf5 import SealedWriter, Variable, create_sealed, open_sealed, text_attributes, verify_sealed
from xfreqbench.data.schema import constants, variables
from xfreqbench.data.splits import Split
from xfreqbench.errors import DataError, ProtocolError
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.system.files import json_sha256, require_own
from xfreqbench.types import NDArray, ProgressCallback, ignore_progress

SCHEMA = "xfreqbench/split/1"
MAPS = "train_pas"


@dataclass(frozen=True, eq=False)
class Handout:
    """What goes into a split file: splits of one protocol of a data set, with their training maps if `maps`."""

    dataset: PasDataset
    splits: Sequence[Split]
    maps: bool = False

    def __post_init__(self) -> None:
        if any(split.receivers for split in self.splits):
            raise ProtocolError(
                f"Protocol {self.splits[0].protocol!r} trains on other receivers, which a split file does not hold. "
                "Hand out another protocol."
            )
        if self.maps:
            _require_untold(self.splits)

    @property
    def sha256(self) -> str:
        """Hash of everything that determines the file's content."""
        return json_sha256([SCHEMA, self.dataset.sha256, [split.sha256 for split in self.splits], self.maps])

    @property
    def num_maps(self) -> int:
        """Number of training maps to be written."""
        return sum(len(split.train) for split in self.splits) if self.maps else 0


def write_handout(handout: Handout, path: Path, progress: ProgressCallback = ignore_progress) -> bool:
    """Write a split file; returns False, and writes nothing, if `path` holds the same file already.

    `progress` is told how many maps are written and how many there are; a few of them are in memory at once. Raises
    `OutputExistsError` if `path` holds something else, `StorageError`, and `DataError` if a map cannot be read.
    """
    if require_own(path, lambda file: _fault_of(file, handout.sha256)):
        return False
    variables = [variable for split in handout.splits for variable in _variables(handout, split)]
    groups = {split.name: _attributes(handout.dataset, split) for split in handout.splits}
    header = {"schema": SCHEMA, "content_sha256": handout.sha256}
    done = 0
    with create_sealed(path, variables, header, groups) as writer:
        for split in handout.splits:
            _append_known(writer, handout.dataset, split)
        for split in handout.splits if handout.maps else ():
            for start in range(0, len(split.train), BATCH_SIZE):
                maps = handout.dataset.pas(split.train[start : start + BATCH_SIZE])
                writer.append(f"{split.name}/{MAPS}", maps)
                done += len(maps)
                progress(done, handout.num_maps)
    return True


def _require_untold(splits: Sequence[Split]) -> None:
    """Raise `ProtocolError` if a training map of one split is tested by another."""
    for split in splits:
        for other in splits:
            if np.isin(split.train, other.test).any():
                raise ProtocolError(
                    f"With its training maps, split {split.name!r} hands out maps that {other.name!r} tests. "
                    "Choose one of them with --targets, leave --maps out, or take a protocol that trains on no "
                    "map that it tests elsewhere: sparse, held-out-tx, held-out-block, lofo-unseen-tx or "
                    "random-samples."
                )


def _fault_of(path: Path, sha256: str) -> str | None:
    """In words, what a file holds other than the handout with that hash; None if it holds that handout."""
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


def _variables(handout: Handout, split: Split) -> list[Variable]:
    E, A = handout.dataset.grid.shape
    header, grid = handout.dataset.header, handout.dataset.grid
    known = [variable for variable in variables(header, grid) if variable.name in _geometry(handout.dataset)]
    for part, rows in (("train", split.train), ("test", split.test)):
        row, shape = f"{part}_row", (len(rows),)
        known += [
            Variable(row, "<i8", shape, (row,), "1", "row of the data set: tx · F + carrier"),
            Variable(f"{part}_tx_position_m", "<f8", (*shape, 3), (row, "axis"), "m", "transmitter position"),
            Variable(f"{part}_carrier_hz", "<f8", shape, (row,), "Hz", "carrier frequency"),
        ]
    if handout.maps:
        axes = ("train_row", "elevation_deg", "azimuth_deg")
        long_name = f"power angular spectrum ({handout.dataset.header.pas_kind}), peak 1"
        maps = Variable(MAPS, "<f4", (len(split.train), E, A), axes, "1", long_name, chunk=(1, E, A))
        known.append(maps)
    prefix = f"{split.name}/"
    return [
        replace(variable, name=prefix + variable.name, axes=tuple(prefix + axis for axis in variable.axes))
        for variable in known
    ]


def _geometry(dataset: PasDataset) -> dict[str, NDArray[Any]]:
    """Axes, grid and receiver as a data set stores them: what every method may know."""
    known = constants(dataset.header, dataset.grid)
    return {name: values for name, values in known.items() if name not in ("tx", "carrier_hz")}


def _append_known(writer: SealedWriter, dataset: PasDataset, split: Split) -> None:
    """Write everything of a split but its maps."""
    values = _geometry(dataset)
    for part, rows in (("train", split.train), ("test", split.test)):
        samples = dataset[rows]
        values[f"{part}_row"] = rows
        values[f"{part}_tx_position_m"] = samples.tx_position_m
        values[f"{part}_carrier_hz"] = samples.carrier_hz
    for name, known in values.items():
        writer.append(f"{split.name}/{name}", known)
