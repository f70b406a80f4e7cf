"""Data sets from folders of the field's PNG layout, and folders from data sets.

What comes in goes out again without loss: a folder that is exported under the convention by which it was
imported holds the same levels at every pixel (in PNGs of the same bytes, where they were written by Pillow),
and the same positions, carriers and receiver to the last bit. Samples are then numbered carrier by carrier,
and the numbers of text files may be spelled otherwise. Levels are recovered from a data set's float16 maps,
which hold 255 of them apart, and from its `peak_power`, which tells the brightest.

Maps of a data set with channels are evaluated anew, on the convention's own grid, and rounded to the nearest
level. Paths, antennas, visibility and received power have no place in the layout: see `DatasetHeader` for what
stands there after an import.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.conventions import Convention
from xfreqbench.dataset import DatasetHeader, IntArray, PasDataset, PasWriter, open_dataset, verify
from xfreqbench.errors import DataError
from xfreqbench.generate import job_sha256, require_same_job
from xfreqbench.pas import BartlettBeam
from xfreqbench.png_folder import CARRIERS, CONVENTION, MAPS, POSITIONS, RECEIVER, PngFolder, map_path
from xfreqbench.png_maps import BRIGHTEST, write_levels
from xfreqbench.storage import atomic_folder, require_empty, storage_errors

ProgressCallback = Callable[[int, int], None]
_BATCH = 16  # transmitters, or maps to export, that are held at once


def _ignore(done: int, total: int) -> None:
    """Progress that nobody watches."""


def import_png_folder(source: PngFolder, path: Path, progress: ProgressCallback = _ignore) -> bool:
    """Write a folder as a data set; False where `path` holds that already.

    `progress` is told transmitters done and in all. Raises `OutputExistsError` for a file that holds
    something else, `DataError` and `StorageError`.
    """
    header = _header(source)
    if path.exists():
        require_same_job(path, job_sha256(header, source.tx_position_m), "data set")
        return False
    with PasWriter(path, header, source.grid) as writer:
        for start in range(0, header.num_tx, _BATCH):
            part = slice(start, start + _BATCH)
            positions = source.tx_position_m[part]
            writer.append_maps(positions, np.ones(len(positions), bool), *source.maps(part))
            progress(start + len(positions), header.num_tx)
    return True


def _header(source: PngFolder) -> DatasetHeader:
    """The data set's header; its scene is known by the files' hash alone."""
    name = source.folder.resolve().name
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
    path: Path, folder: Path, convention: Convention, progress: ProgressCallback = _ignore
) -> PasDataset:
    """Write a data set as a folder of the PNG layout, whole or not at all.

    `progress` is told maps done and in all. Raises `OutputExistsError` unless `folder` is absent or empty,
    `DataError` where the convention cannot hold the data set, and `StorageError`.
    """
    require_empty(folder)
    verify(path)
    dataset = open_dataset(path)
    _check_array(dataset, convention)
    _check_transmitters(dataset)
    if not dataset.header.channels:
        _check_maps(dataset, convention)
    with atomic_folder(folder) as temporary:
        with storage_errors(folder):
            (temporary / MAPS).mkdir()
            _write_texts(temporary, dataset, convention)
        done = 0
        for rows, levels in _levels(dataset, convention):
            for number, image in zip(_sample_numbers(dataset, rows), levels, strict=True):
                write_levels(map_path(temporary, number), image)
            done += len(rows)
            progress(done, len(dataset))
    return dataset


def _sample_numbers(dataset: PasDataset, rows: Int[IntArray, "n"]) -> list[int]:
    """Samples are numbered from 1, carrier by carrier, as publishers do."""
    transmitter, carrier = np.divmod(dataset.rows[rows], dataset.num_carriers)
    return (carrier * dataset.header.num_tx + transmitter + 1).tolist()


def _levels(
    dataset: PasDataset, convention: Convention
) -> Iterator[tuple[IntArray, UInt8[NDArray[np.uint8], "n R C"]]]:
    """Rows of the data set and their maps as published."""
    grid = convention.grid(convention.num_rows, convention.num_columns)
    beam = BartlettBeam(dataset.beam.element_position_wavelengths, grid)
    for start in range(0, len(dataset), _BATCH):
        rows = np.arange(start, min(start + _BATCH, len(dataset)))
        part = dataset.subset(rows)
        maps = _evaluated(part, beam, convention) if part.header.channels else _stored(part, convention)
        yield rows, convention.ascending(np.rint(maps * BRIGHTEST).astype(np.uint8))


def _stored(dataset: PasDataset, convention: Convention) -> Float[FloatArray, "N E A"]:
    """Stored maps, as bright as they were published."""
    brightest = convention.brightest(dataset.peak_power).clip(0, 1)
    return dataset.pas() * brightest[:, None, None]


def _evaluated(
    dataset: PasDataset, beam: BartlettBeam, convention: Convention
) -> Float[NDArray[np.float32], "N E A"]:
    """Maps of the channels, as the convention draws them."""
    of_phases = convention.values == "phase-only-amplitude"
    maps, _ = beam.maps(dataset.cfr, "phase-only" if of_phases else convention.pas_kind)
    maps = np.sqrt(maps) if of_phases else maps
    if convention.darkest == "zero":
        return maps
    darkest = maps.min(axis=(1, 2), keepdims=True)
    return (maps - darkest) / np.where(darkest < 1, 1 - darkest, 1)


def _write_texts(folder: Path, dataset: PasDataset, convention: Convention) -> None:
    header = dataset.header
    position_m = dataset.tables["tx_position_m"].tolist() * dataset.num_carriers
    lines = ["x,y,z", *(",".join(map(repr, position)) for position in position_m)]
    (folder / POSITIONS).write_text("\n".join(lines) + "\n")
    carrier_ghz = np.repeat(header.carrier_hz / 1e9, header.num_tx).tolist()
    (folder / CARRIERS).write_text("".join(f"{carrier:.15g}\n" for carrier in carrier_ghz))
    (folder / RECEIVER).write_text(_receiver_yaml(header, convention))


def _receiver_yaml(header: DatasetHeader, convention: Convention) -> str:
    quaternion = convention.published_quaternion(header.receiver.quaternion_xyzw)
    return (
        f"{CONVENTION}: {json.dumps(convention.of_maps())}  # how xfreqbench drew the maps\n"
        f"dataset_name: {json.dumps(header.scene_name)}\n"
        "gateway1:\n"
        f"  position: {list(header.receiver.position_m)}\n"
        f"  orientation: {list(quaternion)}  # quaternion {convention.quaternion}\n"
    )


def _check_array(dataset: PasDataset, convention: Convention) -> None:
    """A folder cannot tell its array, so that it must be the convention's."""
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
            f"file of the layout can tell. Give {' '.join(options)}, here and to whoever reads the folder."
        )


def _check_transmitters(dataset: PasDataset) -> None:
    position_m = dataset.tables["tx_position_m"]
    if len(np.unique(position_m, axis=0)) < len(position_m):
        raise DataError(
            f"{dataset.path} has two transmitters at one position, which the layout, knowing them by their "
            "positions, cannot tell apart."
        )


def _drawn(dataset: PasDataset) -> dict[str, str]:
    """How imported maps were drawn, as far as the data set tells."""
    told = dataset.header.settings.get("convention", {})
    return {name: told[name] for name in ("values", "darkest") if name in told}


def _check_maps(dataset: PasDataset, convention: Convention) -> None:
    """Maps alone can be copied, and not drawn anew."""
    kinds = {"amplitude": "amplitude", "power": "power", "phase-only": "phase-only power"}
    known = {"values": kinds[dataset.header.pas_kind], "darkest": "zero"} | _drawn(dataset)
    for name in ("values", "darkest"):
        drawn, expected = known[name], getattr(convention, name)
        if drawn != expected:
            raise DataError(
                f"{dataset.path} holds maps alone, whose {name} are {drawn}; without channels they cannot be drawn "
                f"as {expected}. Export them under the convention by which they came, or give --set {name}={drawn}."
            )
    grid = convention.grid(*dataset.grid.shape)
    for name in ("elevation_rad", "azimuth_rad"):
        has_deg, expected_deg = np.degrees(getattr(dataset.grid, name)), np.degrees(getattr(grid, name))
        if not np.allclose(has_deg, expected_deg, atol=1e-6):
            raise DataError(
                f"{dataset.path} holds maps alone, with {name.removesuffix('_rad')}s from {has_deg[0]:g} to "
                f"{has_deg[-1]:g} degrees; without channels they cannot be drawn from {expected_deg[0]:g} to "
                f"{expected_deg[-1]:g}. Export them under the convention by which they came, or state their own "
                "rows and columns by --set."
            )
