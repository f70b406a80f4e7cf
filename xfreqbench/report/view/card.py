"""A data set, or a collection of rooms, as a folder to publish: README card, Croissant metadata, checksums, sample."""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from xfreqbench.data.collection import FILE, Collection, open_collection
from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.power import power_db
from xfreqbench.data.statistics import ChannelStatistics
from xfreqbench.data.statistics import statistics as statistics_of
from xfreqbench.errors import DataError, SceneError, XFreqBenchError
from xfreqbench.report.drawing.markdown import heading, literal
from xfreqbench.report.view.describe import describe
from xfreqbench.report.view.pictures import draw_maps, plot_statistics
from xfreqbench.scene.families import DRAWING, load_family
from xfreqbench.scene.model import load_scene
from xfreqbench.scene.toml_files import shipped_families, shipped_scenes
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors, write_columns
from xfreqbench.system.version import __version__
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import format_ghz_list

CARD, METADATA, SUMS = "README.md", "croissant.json", "SHA256SUMS"
SAMPLE, ROOMS, TRANSMITTERS, SCENE, FAMILY = "sample.csv", "rooms.csv", "transmitters.csv", "scene.toml", "family.toml"
MAPS, STATISTICS = "maps.png", "statistics.png"
_FILES = {  # the files that are added to the data: type and description
    SAMPLE: ("text/csv", "some of the samples, evenly spread: position, carrier, power"),
    ROOMS: ("text/csv", "the rooms: seed, type, part, number of transmitters, file"),
    FILE: ("application/json", "the collection: its family, its options, its rooms"),
    TRANSMITTERS: ("text/csv", "positions of the transmitters in metres, in the order of the data"),
    SCENE: ("application/toml", "the scene that was traced"),
    FAMILY: ("application/toml", "the family that the rooms are drawn from"),
    MAPS: ("image/png", "maps of one transmitter"),
    STATISTICS: ("image/png", "path loss, spreads, K and mechanisms by carrier, with those of standards"),
}
_COLUMNS = {  # of the tables: type and meaning
    "room": ("INTEGER", "seed of the room"),
    "sample": ("INTEGER", "number of the sample in the data set: transmitter · number of carriers + carrier"),
    "x_m": ("FLOAT", "transmitter's position in the world, in metres"),
    "y_m": ("FLOAT", "transmitter's position in the world, in metres"),
    "z_m": ("FLOAT", "transmitter's position in the world, in metres"),
    "carrier_hz": ("FLOAT", "carrier in hertz"),
    "in_sight": ("BOOL", "whether nothing is between transmitter and array"),
    "power_db": ("FLOAT", "received over transmitted power in dB, the mean over the array; empty without a path"),
    "type": ("TEXT", "type of the room"),
    "part": ("TEXT", "train, validation, test, or other-type, which is never trained on"),
    "num_tx": ("INTEGER", "number of transmitters"),
    "file": ("TEXT", "data set of the room, an HDF5 file"),
}
Table = dict[str, list[Any]]  # columns by name


@dataclass(frozen=True)
class _Content:
    """What a card says of a data set or a collection; `tables` are files of CSV, which are record sets, too."""

    title: str
    summary: str
    recipe: str
    sha256: str
    physics: str
    num_samples: int
    data: str
    told: str
    read: str
    commands: list[str]
    tables: dict[str, Table]
    note: str = ""
    statistics: ChannelStatistics | None = None


def write_card(path: Path, folder: Path, license_id: str, tell: Callable[[str], None]) -> None:
    """Write the card of a data set, or of a collection's folder: completely or not at all, into a new or empty folder.

    `license_id` is the identifier of the data's licence in the list of SPDX, in any case of letters; `tell` is called
    before long steps. Raises `DataError` for a path without data or with damaged data, `XFreqBenchError` for another
    licence, or if mlcroissant is not installed, `OutputExistsError` and `StorageError`.
    """
    try:
        import mlcroissant
    except ImportError as error:
        raise XFreqBenchError('A card needs the extra "share". Run: pip install "xfreqbench[share]"') from error
    license_id = _spdx(license_id)
    require_empty(folder)
    rooms = open_collection(path) if path.is_dir() else None
    if rooms:
        rooms.verify()
        files = {name: path / name for name in (FILE, *(room.file for room in rooms.rooms))}
    else:
        verify(path)
        files = {path.with_suffix(".h5").name: path}
    with atomic_folder(folder) as written, storage_errors(folder, sum(each.stat().st_size for each in files.values())):
        for name, file in files.items():
            (written / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, written / name)
        content = _of_rooms(rooms, written) if rooms else _of_dataset(path, written, tell)
        for name, table in content.tables.items():
            write_columns(written / name, table)
        sums = {name: _sha256(written / name) for name in _names(written)}
        metadata = _metadata(mlcroissant, content, license_id, written, sums)
        (written / METADATA).write_text(json.dumps(metadata, indent=2) + "\n", encoding="utf-8")
        (written / CARD).write_text(_card(content, license_id, written), encoding="utf-8")
        sums |= {name: _sha256(written / name) for name in (CARD, METADATA)}
        lines = [f"{sums[name]}  {name}\n" for name in sorted(sums)]
        (written / SUMS).write_text("".join(lines), encoding="utf-8")


def _of_dataset(path: Path, written: Path, tell: Callable[[str], None]) -> _Content:
    """Write the files that are added to a data set, and return their description."""
    dataset, name, statistics = open_dataset(path), path.with_suffix(".h5").name, None
    header = dataset.header
    with suppress(DataError, SceneError):  # of data that do not say how they were traced, or whose meshes are not here
        tell("computing statistics: where no paths are stored, those of 200 transmitters are traced again")
        statistics = statistics_of(dataset)
        plot_statistics(statistics, name, written / STATISTICS)
    write_columns(written / TRANSMITTERS, _positions(dataset.tables["tx_position_m"]))
    _draw_maps(dataset, written)
    commands = _dataset_command(dataset, name, written)
    is_imported = bool(commands) and dataset.scene.scene is not None
    return _Content(
        title=f"Power angular spectra of scene {header.scene_name}",
        summary=f"{_kind(dataset)} of {header.num_tx} transmitters in scene {header.scene_name}, at "
        f"{len(header.carrier_hz)} carriers: {format_ghz_list(header.carrier_hz)}. Recipe {dataset.recipe}.",
        recipe=str(dataset.recipe),
        sha256=dataset.recipe.sha256,
        physics=header.physics,
        num_samples=len(dataset),
        data=name,
        told=describe(path).replace(f"{path}: ", "", 1),
        read=f"data = xb.open_dataset({name!r})",
        commands=commands,
        note="\nThis needs the meshes of the scene.\n" if is_imported else "",
        tables={SAMPLE: _sample(dataset[_spread(len(dataset))])},
        statistics=statistics,
    )


def _of_rooms(rooms: Collection, written: Path) -> _Content:
    """Write the files that are added to the data sets of a collection, and return their description."""
    record, first = rooms.record, rooms[0]
    _draw_maps(first, written)
    parts = [
        {"room": [rooms.rooms[room].seed] * len(rows), **_sample(rooms[room][rows])}
        for room, _, rows in rooms.by_room(_spread(rooms.num_samples))
    ]
    told = [
        {"room": room.seed, "type": room.type, "part": rooms.part_of(room), "num_tx": room.num_tx, "file": room.file}
        for room in rooms.rooms
    ]
    return _Content(
        title=f"Power angular spectra of {len(rooms)} rooms of family {record.name}",
        summary=f"{_kind(first)} of transmitters in {len(rooms)} rooms that are drawn from family {record.name}, at "
        f"{len(record.carrier_hz)} carriers: {format_ghz_list(record.carrier_hz)}.",
        recipe=f"family {record.name}",
        sha256=record.family_sha256,
        physics=first.header.physics,
        num_samples=rooms.num_samples,
        data=".",
        told=rooms.description.partition("\n")[2],
        read='data = xb.open_collection(".")[0]  # of the first room',
        commands=_room_commands(rooms, written),
        tables={
            SAMPLE: {name: [value for part in parts for value in part[name]] for name in parts[0]},
            ROOMS: {name: [room[name] for room in told] for name in told[0]},
        },
    )


def _kind(dataset: PasDataset) -> str:
    return "Channels and power angular spectra" if dataset.header.channels else "Power angular spectra"


def _draw_maps(dataset: PasDataset, written: Path) -> None:
    """Draw the maps of the middle transmitter at up to nine carriers."""
    carriers_hz = dataset.header.carrier_hz
    shown = np.unique(np.linspace(0, len(carriers_hz) - 1, 9).astype(int))
    draw_maps(dataset.path, dataset.header.num_tx // 2, carriers_hz[shown].tolist(), 30.0, written / MAPS)


def _spread(num_samples: int) -> IntArray:
    """At most a thousand of the samples, evenly spread."""
    return np.unique(np.linspace(0, num_samples - 1, 1000).astype(int))


def _positions(position_m: Float[FloatArray, "T 3"]) -> Table:
    return dict(zip(("x_m", "y_m", "z_m"), position_m.T.tolist(), strict=True))


def _sample(some: PasDataset) -> Table:
    columns = {"sample": some.rows.tolist(), **_positions(some.tx_position_m), "carrier_hz": some.carrier_hz.tolist()}
    if some.header.channels:
        columns["in_sight"] = some.tables["line_of_sight"][some.tx_index].tolist()
        columns["power_db"] = [round(each, 3) if np.isfinite(each) else "" for each in power_db(some).tolist()]
    return columns


def _spdx(license_id: str) -> str:
    with suppress(InvalidLicenseExpression):
        found = canonicalize_license_expression(license_id)
        if " " not in found:
            return found
    raise XFreqBenchError(
        f"There is no licence {license_id!r} in the list of SPDX. Name that of the data, as in CC-BY-4.0, CC0-1.0 or "
        "LicenseRef-Ours; only the owner of the data may choose it."
    )


def _names(folder: Path) -> list[str]:
    """All files of a folder, by their paths there."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _metadata(mlc: Any, content: _Content, license_id: str, written: Path, sums: Mapping[str, str]) -> Any:
    """The content of `croissant.json`; many data sets are one set of files, whose sums are in `SHA256SUMS`."""
    hdf5 = "application/x-hdf5"
    of_data = (hdf5, f"the data set {content.recipe}, an HDF5 file")
    distribution = [
        mlc.FileObject(
            id=name,
            name=name,
            description=_FILES.get(name, of_data)[1],
            content_url=name,
            content_size=f"{(written / name).stat().st_size} B",
            encoding_formats=[_FILES.get(name, of_data)[0]],
            sha256=sha256,
        )
        for name, sha256 in sums.items()
        if "/" not in name
    ]
    if ROOMS in content.tables:
        told = "the data sets of the rooms, HDF5 files"
        distribution.append(
            mlc.FileSet(id="data", name="data", description=told, includes=["*/*.h5"], encoding_formats=[hdf5])
        )
    record_sets = [
        mlc.RecordSet(
            id=table,
            name=table,
            description=_FILES[file][1],
            fields=[
                mlc.Field(
                    id=f"{table}/{name}",
                    name=name,
                    description=_COLUMNS[name][1],
                    data_types=[getattr(mlc.DataType, _COLUMNS[name][0])],
                    source=mlc.Source(file_object=file, extract=mlc.Extract(column=name)),
                )
                for name in columns
            ],
        )
        for file, columns in content.tables.items()
        for table in [file.removesuffix(".csv")]
    ]
    return mlc.Metadata(
        name=content.title,
        description=content.summary,
        license=[f"https://spdx.org/licenses/{license_id}.html"],
        cite_as=f"The xfreqbench contributors: xfreqbench {__version__}, data set {content.recipe}",
        version=f"{content.physics}.0.0",
        distribution=distribution,
        record_sets=record_sets,
    ).to_json()


def _room_commands(rooms: Collection, written: Path) -> list[str]:
    """The commands that make a collection again, one for each row of seeds, and its family's TOML if it does not ship.

    None if another version of the toolkit drew the rooms.
    """
    record, options, seeds = rooms.record, dict(rooms.record.options), [room.seed for room in rooms.rooms]
    if record.family.get("drawing") != DRAWING:
        return []
    family = record.name
    if family not in shipped_families() or load_family(family).sha256 != record.family_sha256:
        family = FAMILY
        told = {"description": f"Family {record.name}.", **record.family}
        del told["drawing"]
        (written / family).write_text(_toml(json.dumps(told)), encoding="utf-8")
    flags = ["--paths"] * options.pop("paths") + ["--maps"] * options.pop("maps") + ["--output", rooms.path.name]
    starts = [number for number, seed in enumerate(seeds) if seed - 1 not in seeds]
    asked = {"freqs": _ghz(record.carrier_hz), **options}
    return [
        _generate(family, {"rooms": end - start, "seed": seeds[start], **asked}, flags)
        for start, end in pairwise([*starts, len(seeds)])
    ]


def _generate(scene: str, options: Mapping[str, Any], flags: list[str]) -> str:
    """The command that generates; options that are None are left out."""
    words = ["xfreqbench", "generate", scene]
    for name, value in options.items():
        if value is not None:
            text = ",".join(value) if isinstance(value, list | tuple) else str(value)
            words += [f"--{name.replace('_', '-')}", text]
    return shlex.join(words + flags)


def _ghz(carrier_hz: Iterable[float]) -> list[str]:
    return [f"{carrier / 1e9:.12g}" for carrier in carrier_hz]


def _dataset_command(dataset: PasDataset, name: str, written: Path) -> list[str]:
    """The command that makes a data set again, and its scene's TOML if it does not ship; none if they are not known."""
    try:
        settings, header = dataset.trace_settings, dataset.file_header
    except DataError:
        return []
    receivers = header.receivers or ((header.receiver.name,) if header.receiver.name else ())
    ships = header.scene_name in shipped_scenes() and any(
        header.scene_json == load_scene(header.scene_name).with_receiver(*names).canonical_json
        for names in ((), receivers)
    )
    options = {
        "tx-positions": TRANSMITTERS,
        "freqs": _ghz(header.carrier_hz),
        "solver": settings.solver,
        "interactions": settings.named_interactions,
        "rays": settings.rays,
        "max-depth": settings.max_depth,
        "seed": settings.seed,
        "pas-kind": header.pas_kind,
        "materials": settings.materials,
        "receiver": receivers or None,
        "polarization": header.polarizations or None,
        "output": name,
    }
    flags = ["--paths"] * header.paths + ["--no-maps"] * (not header.maps)
    if not ships:
        (written / SCENE).write_text(_toml(header.scene_json), encoding="utf-8")
    return [_generate(header.scene_name if ships else SCENE, options, flags)]


def _toml(text: str) -> str:
    """A scene's or family's JSON as a TOML file, which has no nulls."""
    import tomli_w

    told = json.loads(text, object_hook=lambda table: {key: each for key, each in table.items() if each is not None})
    if others := told.pop("other_receivers", []):
        told["receiver"] = [told["receiver"], *others]
    return tomli_w.dumps(told)


def _card(content: _Content, license_id: str, written: Path) -> str:
    """The README: front matter as Hugging Face reads it, then what is there, how to read it, and how to make it."""
    sizes = {10**3: "n<1K", 10**4: "1K<n<10K", 10**5: "10K<n<100K", 10**6: "100K<n<1M", 10**7: "1M<n<10M"}
    size = next((words for limit, words in sizes.items() if content.num_samples < limit), "10M<n<100M")
    hub_license = "other" if license_id.startswith("LicenseRef") else license_id.lower()
    configs = "\n".join(f"- config_name: {file.removesuffix('.csv')}\n  data_files: {file}" for file in content.tables)
    listed = "\n".join(f"* `{name}`: {_FILES[name][1]}" for name in _names(written) if name in _FILES)
    commands = "\n".join(content.commands)
    made = f"""
## Make it again

```sh
pip install xfreqbench=={__version__}
{commands}
```

It makes data of the same recipe, {literal(content.recipe)}, sha256 `{content.sha256}`; the last digits may differ from
processor to processor. `xfreqbench info {shlex.quote(content.data)}` prints the recipe.
{content.note}"""
    measured = f"""
## Statistics

![{_FILES[STATISTICS][1]}]({STATISTICS})

```text
{content.statistics}
```
"""
    return f"""---
license: {hub_license}
pretty_name: {json.dumps(content.title)}
size_categories:
- {size}
tags:
- wireless
- channel
- power-angular-spectrum
- ray-tracing
- radiance-field
configs:
{configs}
---

# {heading(content.title)}

{literal(content.summary)} The data are in `{content.data}`, under {license_id}. Other files:

{listed}
* `{METADATA}`: the same as Croissant metadata, for search engines and loaders
* `{SUMS}`: check them by `sha256sum --check {SUMS}`

![{_FILES[MAPS][1]}]({MAPS})

## Read it

```python
import xfreqbench as xb  # pip install xfreqbench

{content.read}
print(data[0].map.shape, data[0].tx_position_m, data[0].carrier_hz)
```

## What it holds

```text
{content.told}
```
{measured if content.statistics else ""}{made if content.commands else ""}"""
