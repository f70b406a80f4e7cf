"""Makes data sets from folders of the PNG layout, and such folders from data sets.

Nothing is lost on the way in and out: a folder that is exported with the convention with which it was imported has the
same level at every pixel (and PNGs of the same bytes, if Pillow wrote them), and the same positions, carriers and
receiver to the last bit. Only the samples are numbered again, carrier by carrier, and numbers in text files may be
written in another way. The levels are recovered from the packed maps, which are exact enough for 256 levels, and from
`peak_power`, which gives the level of the brightest pixel.

If a data set has channels, its maps are computed again on the grid of the convention, and rounded to the nearest level.
The layout has no place for paths, antennas, visibility and received power; `DatasetHeader` says what a data set holds
instead of them after an import.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from xfreqbench.data.dataset import PasDataset, holds_same_job, open_dataset
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError
from xfreqbench.exchange.conventions import Convention
from xfreqbench.exchange.png_folder import (
    BRIGHTEST,
    CARRIERS,
    MAPS,
    POSITIONS,
    RECEIVER,
    PngFolder,
    map_path,
    write_levels,
)
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.system.files import atomic_folder, require_empty, require_text, storage_errors
from xfreqbench.types import IntArray, NDArray, ProgressCallback, ignore_progress

# Transmitters, or maps to export, that are in memory at once.
_BATCH = 16


def import_png_folder(source: PngFolder, path: Path, progress: ProgressCallback = ignore_progress) -> bool:
    """Write a folder as a data set; returns False, and writes nothing, if `path` holds that data set already.

    `progress` is called with the number of transmitters that are done and of all. Raises `OutputExistsError` if `path`
    holds something else, `DataError` and `StorageError`.
    """
    header = _header(source)
    if holds_same_job(path, header, source.tx_position_m):
        return False
    pixels = len(source.carrier_hz) * math.prod(source.grid.shape)
    batch = max(1, min(_BATCH, 30_000_000 // pixels))
    with PasWriter(path, header, source.grid) as writer:
        for start in range(0, header.num_tx, batch):
            part = slice(start, start + batch)
            positions = source.tx_position_m[part]
            samples = SampleBlock.of_maps(*source.maps(part))
            writer.append(positions, np.ones(len(positions), bool), samples)
            progress(start + len(positions), header.num_tx)
    return True


def _header(source: PngFolder) -> DatasetHeader:
    """The header of the data set; nothing is known of the scene but the hash of the folder's files."""
    name = require_text(source.folder.resolve().name, "a data set")
    return DatasetHeader(
        scene_name=name,
        scene_json=json.dumps({"name": name}),
        scene_sha256=source.sha256,
        receiver=source.receiver,
        carrier_hz=source.carrier_hz,
        num_tx=len(source.tx_position_m),
        pas_kind=source.convention.pas_kind,
        maps=True,
        settings={
            "imported_from": "PNG layout",
            "convention": asdict(source.convention),
            "not_published": "paths, antennas, received power and visibility (all transmitters count as in sight)",
        },
        software={package: metadata.version(package) for package in ("xfreqbench", "numpy", "pillow")},
        rejected={},
        channels=False,
    )


def export_png_folder(
    path: Path, folder: Path, convention: Convention, progress: ProgressCallback = ignore_progress
) -> PasDataset:
    """Write the data set at `path` as a folder of the PNG layout, whole or not at all; returns the data set.

    `progress` is called with the number of maps that are done and of all. Raises `OutputExistsError` unless `folder` is
    absent or empty, `DataError` if the data set does not fit the convention, and `StorageError`.
    """
    require_empty(folder)
    dataset = open_dataset(path)
    _check_array(dataset, convention)
    position_m = dataset.tables["tx_position_m"]
    if len(np.unique(position_m, axis=0)) < len(position_m):
        raise DataError(
            f"{dataset.path} has two transmitters at one position. The layout identifies transmitters only by their "
            "positions, so it cannot distinguish these two."
        )
    if not dataset.header.channels:
        _check_maps(dataset, convention)
    with atomic_folder(folder) as temporary:
        with storage_errors(folder):
            (temporary / MAPS).mkdir()
            _write_texts(temporary, dataset, convention)
        done = 0
        for rows, levels in _levels(dataset, convention):
            transmitter, carrier = np.divmod(dataset.rows[rows], dataset.header.num_carriers)
            numbers = carrier * dataset.header.num_tx + transmitter + 1  # carrier by carrier, as others do
            for number, image in zip(numbers.tolist(), levels, strict=True):
                write_levels(map_path(temporary, number), image)
            done += len(rows)
            progress(done, len(dataset))
    return dataset


def _levels(
    dataset: PasDataset, convention: Convention
) -> Iterator[tuple[IntArray, UInt8[NDArray[np.uint8], "n R C"]]]:
    """Numbers of samples, and their maps as grey levels in the order in which the convention publishes them."""
    grid = convention.grid(convention.num_rows, convention.num_columns)
    beam = BartlettBeam(dataset.beam.element_position_wavelengths, grid)
    for start in range(0, len(dataset), _BATCH):
        rows = np.arange(start, min(start + _BATCH, len(dataset)))
        part = dataset[rows]
        if part.header.channels:
            is_phase_only = convention.values == "phase-only-amplitude"
            maps, _ = beam.maps(part.cfr, "phase-only" if is_phase_only else convention.pas_kind)
            maps = np.sqrt(maps) if is_phase_only else maps
            if convention.darkest == "minimum":
                darkest = maps.min(axis=(1, 2), keepdims=True)
                maps = (maps - darkest) / np.where(darkest < 1, 1 - darkest, 1)
        else:  # as bright as they were published
            peak_power = part.tables["peak_power"].flat[part.rows]
            maps = part.pas() * convention.brightest(peak_power).clip(0, 1)[:, None, None]
        yield rows, convention.ascending(np.rint(maps * BRIGHTEST).astype(np.uint8))


def _write_texts(folder: Path, dataset: PasDataset, convention: Convention) -> None:
    header = dataset.header
    position_m = dataset.tables["tx_position_m"].tolist() * dataset.header.num_carriers
    lines = ["x,y,z", *(",".join(map(repr, position)) for position in position_m)]
    (folder / POSITIONS).write_text("\n".join(lines) + "\n", encoding="utf-8")
    carrier_ghz = np.repeat(header.carrier_hz / 1e9, header.num_tx).tolist()
    (folder / CARRIERS).write_text("".join(f"{carrier:.15g}\n" for carrier in carrier_ghz), encoding="utf-8")
    quaternion = convention.published_quaternion(header.receiver.quaternion_xyzw)
    receiver = (
        f"convention: {json.dumps(convention.drawing_fields())}  # how xfreqbench drew the maps\n"
        f"dataset_name: {json.dumps(header.scene_name)}\n"
        "gateway1:\n"
        f"  position: {list(header.receiver.position_m)}\n"
        f"  orientation: {list(quaternion)}  # quaternion {convention.quaternion}\n"
    )
    (folder / RECEIVER).write_text(receiver, encoding="utf-8")


def _check_array(dataset: PasDataset, convention: Convention) -> None:
    """Raise `DataError` unless the array is the convention's: no file of the layout says how the array is built."""
    receiver = dataset.header.receiver
    stated = {
        "plane": (receiver.plane, convention.plane),
        "array_rows": (receiver.rows, convention.array_rows),
        "array_cols": (receiver.cols, convention.array_cols),
        "spacing_wavelengths": (receiver.spacing_wavelengths, convention.spacing_wavelengths),
    }
    options = [f"--set {name}={has}" for name, (has, expected) in stated.items() if has != expected]
    if options:
        raise DataError(
            f"The array of {dataset.path} is {receiver.rows} × {receiver.cols} in plane {receiver.plane}, "
            f"{receiver.spacing_wavelengths:g} wavelengths apart, that of the convention {convention.array_rows} × "
            f"{convention.array_cols} in plane {convention.plane}, {convention.spacing_wavelengths:g} apart, and no "
            f"file of the layout can say so. Give {' '.join(options)}, here and wherever the folder is read."
        )


def _check_maps(dataset: PasDataset, convention: Convention) -> None:
    """Raise `DataError` unless maps without channels are as the convention draws them: they can only be copied."""
    kinds = {"amplitude": "amplitude", "power": "power", "phase-only": "phase-only power"}
    guessed = {"values": kinds[dataset.header.pas_kind], "darkest": "zero"}
    named = dataset.header.settings.get("convention")
    imported = named if isinstance(named, dict) else {}
    for name in ("values", "darkest"):
        drawn, expected = imported.get(name, guessed[name]), getattr(convention, name)
        if drawn != expected:
            raise DataError(
                f"{dataset.path} has maps without channels, whose {name} are {drawn}; they cannot be drawn "
                f"as {expected}. Export them with the convention of their import, or give --set {name}={drawn}."
            )
    grid = convention.grid(*dataset.grid.shape)
    for name in ("elevation_rad", "azimuth_rad"):
        has_deg, expected_deg = np.degrees(getattr(dataset.grid, name)), np.degrees(getattr(grid, name))
        if not np.allclose(has_deg, expected_deg, atol=1e-6):
            raise DataError(
                f"{dataset.path} has maps without channels, with {name.removesuffix('_rad')}s from {has_deg[0]:g} to "
                f"{has_deg[-1]:g} degrees; they cannot be drawn from {expected_deg[0]:g} to "
                f"{expected_deg[-1]:g}. Export them with the convention of their import, or set their own "
                "rows and columns with --set."
            )
