"""A data set as a folder to hand on: data, README card, Croissant metadata, checksums, a sample, how to make it."""

from __future__ import annotations

import csv
import hashlib
import json
import shlex
import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.statistics import ChannelStatistics
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.report.view.describe import describe
from xfreqbench.report.view.pictures import draw_maps
from xfreqbench.report.view.statistics import plot_statistics
from xfreqbench.scene.model import load_scene, shipped_scenes
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors
from xfreqbench.system.version import __version__
from xfreqbench.units import format_ghz_list

CARD, METADATA, SUMS = "README.md", "croissant.json", "SHA256SUMS"
SAMPLE, TRANSMITTERS, SCENE = "sample.csv", "transmitters.csv", "scene.toml"
MAPS, STATISTICS = "maps.png", "statistics.png"
_FILES = {  # what is written beside the data, its type and what it is
    SAMPLE: ("text/csv", "some of the samples, evenly spread: place, carrier, power"),
    TRANSMITTERS: ("text/csv", "positions of the transmitters in metres, in the order of the data"),
    SCENE: ("application/toml", "the scene that was traced"),
    MAPS: ("image/png", "maps of one transmitter"),
    STATISTICS: ("image/png", "path loss, spreads, K and mechanisms by carrier, beside standards"),
}
_COLUMNS = {  # of the sample: type and meaning
    "sample": ("Integer", "number of the sample in the data set: transmitter · number of carriers + carrier"),
    "x_m": ("Float", "transmitter's position in the world, in metres"),
    "y_m": ("Float", "transmitter's position in the world, in metres"),
    "z_m": ("Float", "transmitter's position in the world, in metres"),
    "carrier_hz": ("Float", "carrier in hertz"),
    "in_sight": ("Bool", "whether nothing stands between transmitter and array"),
    "power_db": ("Float", "received over transmitted power in dB, the mean over the array; empty without a path"),
}
_OF_CHANNELS = ("in_sight", "power_db")  # columns that maps which others published do not have
_MAX_SAMPLES, _MAX_MAPS, _RANGE_DB = 1000, 9, 30.0
_HDF5 = "application/x-hdf5"
_SIZES = (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M")


def write_card(path: Path, folder: Path, license_id: str, tell: Callable[[str], None]) -> None:
    """Write the folder, which is absent or empty, whole or not at all; `tell` is told what takes long.

    `license_id` is the identifier of the data's licence in the list of SPDX, in any case of letters. Raises
    `DataError` for a file that is no data set or is damaged, `XFreqBenchError` for another licence, or where
    mlcroissant is not installed, `OutputExistsError` and `StorageError`.
    """
    croissant, license_id = _croissant(), _spdx(license_id)
    require_empty(folder)
    verify(path)
    dataset, name, statistics = open_dataset(path), path.with_suffix(".h5").name, None
    with suppress(DataError):  # of data that do not say how they were traced
        tell("computing statistics: where no paths are stored, those of 200 transmitters are traced again")
        statistics = dataset.statistics()
    with atomic_folder(folder) as written, storage_errors(folder, path.stat().st_size):
        shutil.copyfile(path, written / name)
        columns = [each for each in _COLUMNS if dataset.header.channels or each not in _OF_CHANNELS]
        _write_csv(written / SAMPLE, columns, ([row[each] for each in columns] for row in _sample_rows(dataset)))
        _write_csv(written / TRANSMITTERS, ["x_m", "y_m", "z_m"], dataset.tables["tx_position_m"].tolist())
        carriers_hz = dataset.header.carrier_hz
        shown = np.unique(np.linspace(0, len(carriers_hz) - 1, _MAX_MAPS).astype(int))
        draw_maps(path, dataset.header.num_tx // 2, carriers_hz[shown].tolist(), _RANGE_DB, written / MAPS)
        if statistics:
            plot_statistics(statistics, name, written / STATISTICS)
        command, scene = _command(dataset, name)
        if scene:
            (written / SCENE).write_text(scene, encoding="utf-8")
        files = sorted(each.name for each in written.iterdir())
        metadata = _metadata(croissant, dataset, license_id, columns, [written / each for each in files])
        (written / METADATA).write_text(json.dumps(metadata, indent=2) + "\n", encoding="utf-8")
        told = describe(path).replace(f"{path}: ", "", 1)
        card = _card(name, dataset, license_id, told, statistics, command, files)
        (written / CARD).write_text(card, encoding="utf-8")
        sums = [f"{_sha256(each)}  {each.name}\n" for each in sorted(written.iterdir())]
        (written / SUMS).write_text("".join(sums), encoding="utf-8")


def _croissant() -> ModuleType:
    try:
        import mlcroissant
    except ImportError as error:
        raise XFreqBenchError('A card needs the extra "share". Run: pip install "xfreqbench[share]"') from error
    return mlcroissant


def _spdx(license_id: str) -> str:
    with suppress(InvalidLicenseExpression):
        found = canonicalize_license_expression(license_id)
        if " " not in found:
            return found
    raise XFreqBenchError(
        f"There is no licence {license_id!r} in the list of SPDX. Name that of the data, as in CC-BY-4.0, CC0-1.0 or "
        "LicenseRef-Ours; only who owns the data may choose it."
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _write_csv(path: Path, header: list[str], rows: Iterable[list[Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _sample_rows(dataset: PasDataset) -> Iterable[dict[str, Any]]:
    rows = np.unique(np.linspace(0, len(dataset) - 1, _MAX_SAMPLES).astype(int))
    some = dataset[rows]
    power_db = some.power_db if dataset.header.channels else np.zeros(len(some))
    for index, (sample, place, carrier_hz) in enumerate(zip(rows, some.tx_position_m, some.carrier_hz, strict=True)):
        known = np.isfinite(power_db[index])
        yield {
            "sample": int(sample),
            **dict(zip(("x_m", "y_m", "z_m"), place.tolist(), strict=True)),
            "carrier_hz": float(carrier_hz),
            "in_sight": bool(some.line_of_sight[index]),
            "power_db": round(float(power_db[index]), 3) if known else "",
        }


def _metadata(mlc: Any, dataset: PasDataset, license_id: str, columns: list[str], files: list[Path]) -> Any:
    """The content of `croissant.json`."""
    types = {"Integer": mlc.DataType.INTEGER, "Float": mlc.DataType.FLOAT, "Bool": mlc.DataType.BOOL}
    of_data = (_HDF5, f"the data set {dataset.recipe}, an HDF5 file")
    distribution = [
        mlc.FileObject(
            id=path.name,
            name=path.name,
            description=_FILES.get(path.name, of_data)[1],
            content_url=path.name,
            content_size=f"{path.stat().st_size} B",
            encoding_formats=[_FILES.get(path.name, of_data)[0]],
            sha256=_sha256(path),
        )
        for path in files
    ]
    fields = [
        mlc.Field(
            id=f"sample/{name}",
            name=name,
            description=_COLUMNS[name][1],
            data_types=[types[_COLUMNS[name][0]]],
            source=mlc.Source(file_object=SAMPLE, extract=mlc.Extract(column=name)),
        )
        for name in columns
    ]
    return mlc.Metadata(
        name=_title(dataset),
        description=_summary(dataset),
        license=[f"https://spdx.org/licenses/{license_id}.html"],
        cite_as=f"The xfreqbench contributors: xfreqbench {__version__}, data set {dataset.recipe}",
        version=f"{dataset.header.physics}.0.0",
        distribution=distribution,
        record_sets=[mlc.RecordSet(id="sample", name="sample", description=_FILES[SAMPLE][1], fields=fields)],
    ).to_json()


def _title(dataset: PasDataset) -> str:
    return f"Power angular spectra of scene {dataset.header.scene_name}"


def _summary(dataset: PasDataset) -> str:
    header = dataset.header
    what = "Channels and power angular spectra" if header.channels else "Power angular spectra"
    return (
        f"{what} of {header.num_tx} transmitters in scene {header.scene_name}, at {len(header.carrier_hz)} carriers: "
        f"{format_ghz_list(header.carrier_hz)}. Recipe {dataset.recipe}."
    )


def _command(dataset: PasDataset, name: str) -> tuple[str, str]:
    """The command that makes the data again, and the scene's TOML where it does not ship; empty where nothing tells."""
    try:
        settings, header = dataset.trace_settings, dataset.file_header
    except DataError:
        return "", ""
    receivers = header.receivers or ((header.receiver.name,) if header.receiver.name else ())
    ships = header.scene_name in shipped_scenes() and any(
        header.scene_json == load_scene(header.scene_name).with_receiver(*names).canonical_json
        for names in ((), receivers)
    )
    options = {
        "tx-positions": TRANSMITTERS,
        "freqs": ",".join(f"{carrier / 1e9:.12g}" for carrier in header.carrier_hz),
        "solver": settings.solver,
        "interactions": ",".join(settings.named_interactions),
        "rays": settings.rays,
        "max-depth": settings.max_depth,
        "seed": settings.seed,
        "pas-kind": header.pas_kind,
        "materials": settings.materials,
        **({"receiver": ",".join(receivers)} if receivers else {}),
        **({"polarization": ",".join(header.polarizations)} if header.polarizations else {}),
        "output": name,
    }
    words = ["xfreqbench", "generate", header.scene_name if ships else SCENE]
    words += [word for name, value in options.items() for word in (f"--{name}", str(value))]
    words += ["--paths"] * header.paths + ["--no-maps"] * (not header.maps)
    return shlex.join(words), "" if ships else _toml(json.loads(header.scene_json))


def _toml(scene: dict[str, Any]) -> str:
    """A scene's JSON as a TOML file: its tables are the receiver, the transmitters, each surface and each material."""

    def value(given: Any) -> str:
        if isinstance(given, dict):
            return f"{{ {', '.join(f'{key} = {value(each)}' for key, each in given.items() if each is not None)} }}"
        if isinstance(given, list):
            return f"[{', '.join(map(value, given))}]"
        return json.dumps(given, ensure_ascii=False)

    def is_table(given: Any) -> bool:
        return isinstance(given, dict) or (isinstance(given, list) and bool(given) and isinstance(given[0], dict))

    told = {key: each for key, each in scene.items() if each is not None}
    if others := told.pop("other_receivers", []):
        told["receiver"] = [told["receiver"], *others]
    lines = [f"{key} = {value(each)}" for key, each in told.items() if not is_table(each)]
    for key, each in told.items():
        if is_table(each):
            for table in each if isinstance(each, list) else [each]:
                lines += ["", f"[[{key}]]" if isinstance(each, list) else f"[{key}]"]
                lines += [f"{name} = {value(entry)}" for name, entry in table.items() if entry is not None]
    return "\n".join(lines) + "\n"


def _card(
    name: str,
    dataset: PasDataset,
    license_id: str,
    told: str,
    statistics: ChannelStatistics | None,
    command: str,
    files: list[str],
) -> str:
    """The README: front matter as Hugging Face reads it, then what is there, how to read it, and how to make it."""
    size = next((words for limit, words in _SIZES if len(dataset) < limit), "n>1M")
    hub_license = "other" if license_id.startswith("LicenseRef") else license_id.lower()
    listed = "\n".join(f"* `{each}`: {_FILES[each][1]}" for each in files if each in _FILES)
    imported = "" if not command or dataset.scene.scene is None else "\nThe meshes of the scene have to be at hand.\n"
    made = f"""
## Make it again

```sh
pip install xfreqbench=={__version__}
{command}
```

It makes data of the same recipe, `{dataset.recipe}`, sha256 `{dataset.recipe.sha256}`; the last digits may differ from
processor to processor. `xfreqbench info {shlex.quote(name)}` prints the recipe.
{imported}"""
    measured = f"""
## Statistics

![{_FILES[STATISTICS][1]}]({STATISTICS})

```text
{statistics}
```
"""
    return f"""---
license: {hub_license}
pretty_name: {json.dumps(_title(dataset))}
size_categories:
- {size}
tags:
- wireless
- channel
- power-angular-spectrum
- ray-tracing
- radiance-field
configs:
- config_name: sample
  data_files: {SAMPLE}
---

# {_title(dataset)}

{_summary(dataset)} The data are in `{name}`, under {license_id}. Beside them:

{listed}
* `{METADATA}`: the same as Croissant metadata, for search engines and loaders
* `{SUMS}`: check them by `sha256sum --check {SUMS}`

![{_FILES[MAPS][1]}]({MAPS})

## Read it

```python
import xfreqbench as xb  # pip install xfreqbench

data = xb.open_dataset({name!r})
print(data[0].map.shape, data[0].tx_position_m, data[0].carrier_hz)
```

## What it holds

```text
{told}
```
{measured if statistics else ""}{made if command else ""}"""
