"""Reads and checks a folder of the PNG layout, in which other projects publish their maps (it is NeRF2's).

A folder of the layout holds, for its samples n = 1, 2, …:

    spectrum/%05d.png    map of sample n, 8-bit grey
    tx_pos.csv           header x,y,z, then its transmitter's position in metres on line n + 1
    freq.txt             its carrier in GHz on line n; absent where all have one
    gateway_info.yml     the receiver: position in metres, orientation as a quaternion, frame to world

How the maps are drawn is not in the files of other projects: see `conventions`. It is in `gateway_info.yml` of a
folder that this toolkit exported. `train_index.txt` and `test_index.txt` are not used, because the protocols of this
toolkit make the splits. They are checked nevertheless: if they name a sample that is not there, files were lost, or
the folder has another convention.
"""

from __future__ import annotations

import hashlib
import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float, Int, UInt8
from PIL import Image
from pydantic import ValidationError

from xfreqbench.errors import DataError
from xfreqbench.exchange.conventions import Convention
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.runs.records import fault_of_fields
from xfreqbench.scene.array import quaternion_rotation
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.scene.tables import Table, read_table
from xfreqbench.system.files import read_bytes, read_text, require_regular, storage_errors
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import format_ghz, ghz_to_hz, parse_number

BRIGHTEST = 255
# Of a map; one with a step of a fifth of a degree has 810,000.
MAX_PIXELS = 1_000_000
Levels = UInt8[NDArray[np.uint8], "R C"]
POSITIONS, CARRIERS, RECEIVER, MAPS = "tx_pos.csv", "freq.txt", "gateway_info.yml", "spectrum"
IGNORED = ("train_index.txt", "test_index.txt")


def shape_of(path: Path) -> tuple[int, int]:
    """Numbers of rows and columns of a map, from the header of its PNG; raises `DataError` unless it is 8-bit grey."""
    with _opened(path) as image:
        if image.mode != "L":
            raise DataError(f"{path} has pixels of mode {image.mode}; maps are 8-bit grey, mode L.")
        if min(image.size) < 2:
            raise DataError(f"{path} has {image.size} columns and rows; a map has 2 of each or more.")
        return image.height, image.width


def read_levels(path: Path) -> Levels:
    """Grey levels (R, C) of a PNG, from 0 to 255, every byte checked by the file's sums; raises `DataError`."""
    with _opened(path) as image:
        image.verify()  # decoding does not check the checksums of pixels
    with _opened(path) as image:
        return np.array(image)


def write_levels(path: Path, levels: Levels) -> None:
    """Write grey levels (R, C) as a PNG; raises `StorageError`."""
    with storage_errors(path):
        Image.fromarray(levels).save(path, format="PNG")


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """The image in a file; what fails within the block, too, is a `DataError`, also where it is too large."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # its limit is above ours
            image = Image.open(io.BytesIO(read_bytes(require_regular(path, 4_000_000))), formats=["PNG"])
        with image:
            if image.width * image.height > MAX_PIXELS:
                raise Image.DecompressionBombError
            yield image
    except Image.DecompressionBombError as error:
        raise DataError(
            f"{path} has more than {MAX_PIXELS:,} pixels, the limit for a map. Export it with fewer."
        ) from error
    except (OSError, SyntaxError, ValueError) as error:
        fault = getattr(error, "strerror", None) or error
        raise DataError(f"{path} cannot be read as a PNG ({fault}). Download the file again.") from error


@dataclass(frozen=True, eq=False)
class PngFolder:
    """A checked folder; `sample[t, f]` is the number of the map of transmitter t at carrier f."""

    folder: Path
    convention: Convention
    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    sample: Int[NDArray[np.int64], "T F"]
    receiver: ReceiverArray
    grid: AngularGrid
    sha256: str

    @property
    def ignored(self) -> list[str]:
        """Names of the files of the layout that are there, but are not used."""
        return [name for name in IGNORED if (self.folder / name).exists()]

    def maps(self, transmitters: slice) -> tuple[Float[NDArray[np.float32], "t F E A"], Float[FloatArray, "t F"]]:
        """Maps of some transmitters, each divided by its peak, and the power at the peaks.

        The power is relative to that of a white pixel. Raises `DataError` for a PNG that cannot be read.
        """
        samples = self.sample[transmitters]
        levels = np.stack([read_levels(map_path(self.folder, number)) for number in samples.ravel().tolist()])
        brightest = levels.max(axis=(1, 2), initial=0)
        maps = self.convention.ascending(levels) / np.maximum(brightest, 1).astype(np.float32)[:, None, None]
        peak_power = self.convention.peak_power(brightest / BRIGHTEST)
        return maps.reshape(*samples.shape, *self.grid.shape), peak_power.reshape(samples.shape)


def read_png_folder(folder: Path, convention: Convention, carrier_ghz: float | None = None) -> PngFolder:
    """Check every file of a folder; raises `DataError` naming file and line.

    `carrier_ghz` is the carrier of all samples, for a folder without `freq.txt`.
    """
    if not folder.is_dir():
        raise DataError(f"There is no folder {folder}. Give the folder with {POSITIONS} and {MAPS}.")
    table = read_table(folder / POSITIONS)
    position_m = [tuple(place_m) for place_m in table.position_m().tolist()]
    _check_order(table)
    sample_carrier_hz = _carriers_hz(folder / CARRIERS, carrier_ghz, len(position_m))
    if len(position_m) != len(sample_carrier_hz):
        raise DataError(
            f"{folder / POSITIONS} has {len(position_m)} samples and {folder / CARRIERS} "
            f"{len(sample_carrier_hz)}; both need one line a sample."
        )
    paths = [map_path(folder, number) for number in range(1, len(position_m) + 1)]
    _check_numbers(folder / MAPS, paths)
    _check_index_files(folder, convention, len(paths))
    shape = shape_of(paths[0])
    for path in paths[1:]:
        if (found := shape_of(path)) != shape:
            raise DataError(f"{path} has {found} rows and columns, but {paths[0].name} {shape}; all must agree.")
    transmitters, carriers = list(dict.fromkeys(position_m)), sorted(set(sample_carrier_hz))
    digest = hashlib.sha256()
    for path in (folder / POSITIONS, folder / CARRIERS, folder / RECEIVER, *paths):
        if path.exists():
            with require_regular(path).open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    return PngFolder(
        folder=folder,
        convention=convention,
        tx_position_m=np.array(transmitters),
        carrier_hz=np.array(carriers),
        sample=_sample_table(folder, position_m, sample_carrier_hz, transmitters, carriers),
        receiver=_read_receiver(folder / RECEIVER, convention),
        grid=convention.grid(*shape),
        sha256=digest.hexdigest(),
    )


def map_path(folder: Path, number: int) -> Path:
    """The PNG file of a sample; samples are numbered from 1."""
    return folder / MAPS / f"{number:05d}.png"


def _lines(path: Path, most_bytes: float = inf) -> list[str]:
    """The lines of a text file, without blank lines at its end."""
    try:
        return read_text(path, most_bytes).rstrip().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        fault = error.strerror if isinstance(error, OSError) else error
        raise DataError(
            f"{path} cannot be read: {fault}. A folder of this layout has {POSITIONS}, {CARRIERS}, "
            f"{RECEIVER} and {MAPS}/00001.png, …"
        ) from error


def _numbers(text: str, count: int) -> tuple[float, ...] | None:
    """The numbers of a comma-separated text; None unless they are `count` finite numbers."""
    try:
        numbers = tuple(parse_number(part) for part in text.split(","))
    except ValueError:
        return None
    return numbers if len(numbers) == count else None


def _carriers_hz(path: Path, given_ghz: float | None, num_samples: int) -> list[float]:
    """Carrier of every sample in hertz, from `freq.txt`, or `given_ghz` for all if there is no such file."""
    if given_ghz is not None and path.exists():
        raise DataError(f"{path} gives the carriers, and --freq {given_ghz:g} another; leave out --freq.")
    if given_ghz is not None:
        return [_carrier_hz("--freq", str(given_ghz))] * num_samples
    if not path.exists():
        raise DataError(f"There is no {path}. If all samples have the same carrier, give it in GHz with --freq.")
    return [_carrier_hz(f"{path}, line {number},", line) for number, line in enumerate(_lines(path), start=1)]


def _carrier_hz(place: str, text: str) -> float:
    numbers = _numbers(text, 1)
    try:
        return ghz_to_hz(nan if numbers is None else numbers[0])
    except ValueError as error:
        raise DataError(f"{place} is {text!r}: {error}.") from error


def _read_receiver(path: Path, convention: Convention) -> ReceiverArray:
    """The receiver in `gateway_info.yml`, the mapping with position and orientation; its array is the convention's."""
    content = _yaml(path)
    _check_declared(path, content, convention)
    found = [content, *content.values()]
    gateways = [frame for frame in found if isinstance(frame, dict) and {"position", "orientation"} <= frame.keys()]
    if len(gateways) != 1:
        raise DataError(
            f"{path} describes {len(gateways)} receivers; it must describe one, as in 'gateway1: {{position: "
            "[x, y, z], orientation: [x, y, z, w]}'."
        )
    published, position_m = (_listed(path, gateways[0], key, n) for key, n in (("orientation", 4), ("position", 3)))
    quaternion = convention.quaternion_xyzw(published)
    if not 1e-6 < max(map(abs, quaternion)) < 1e6:
        raise DataError(
            f"{path} has the orientation {list(published)}, a quaternion whose length is not 1; [0, 0, 0, 1], in the "
            "order x, y, z, w, means no rotation."
        )
    is_turned = quaternion != (0.0, 0.0, 0.0, 1.0)
    boresight = quaternion_rotation(quaternion)[:, 2].tolist() if is_turned else (0.0, 0.0, 1.0)
    try:
        return ReceiverArray(
            position_m=position_m,  # type: ignore[arg-type]
            rows=convention.array_rows,
            cols=convention.array_cols,
            spacing_wavelengths=convention.spacing_wavelengths,
            boresight=tuple(boresight),
            plane=convention.plane,
            orientation=quaternion if is_turned else None,
        )
    except ValidationError as error:
        raise DataError(f"{path} does not describe a receiver: {fault_of_fields(error)}.") from error


def _yaml(path: Path) -> dict[Any, Any]:
    """The mapping in a YAML file, all values as texts: YAML takes 010 for 8. Empty if the file holds something else."""
    try:
        text = "\n".join(_lines(path, 100_000))
        content = yaml.load(text, yaml.BaseLoader)  # which makes no objects but texts, lists and mappings
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DataError(f"{path} is not YAML: {' '.join(str(error).split())}.") from error
    return content if isinstance(content, dict) else {}


def _check_declared(path: Path, content: dict[Any, Any], convention: Convention) -> None:
    """Raise `DataError` if the folder says that its maps are drawn in another way than the convention."""
    declared, stated = content.get("convention"), convention.drawing_fields()
    declared = declared if isinstance(declared, dict) else {}
    texts = {name: text for name, text in declared.items() if isinstance(text, str)}
    differing = [name for name, value in stated.items() if declared.get(name, value) not in (value, str(value))]
    differing = [name for name in differing if _numbers(texts.get(name, ""), 1) != (stated[name],)]
    if not all(map(texts.get, differing)):
        raise DataError(
            f"{path} has no value for {', '.join(differing)} under 'convention'. Remove that line, and give its "
            "meaning with --set."
        )
    if differing:
        raise DataError(
            f"{path} says that its maps differ from the given convention in {', '.join(differing)}. "
            f"Give {' '.join(f'--set {name}={declared[name]}' for name in differing)} too."
        )


def _listed(path: Path, gateway: dict[Any, Any], key: str, count: int) -> tuple[float, ...]:
    """The numbers in the list under a key of the receiver."""
    listed = gateway[key] if isinstance(gateway[key], list) else []
    numbers = _numbers(",".join(entry if isinstance(entry, str) else "" for entry in listed), count)
    if numbers is None:
        raise DataError(f"{path} must have a list of {count} finite numbers as {key!r}, like {list(range(count))}.")
    return numbers


def _check_numbers(folder: Path, paths: list[Path]) -> None:
    missing = next((path for path in paths if not path.is_file()), None)
    surplus = sorted({*folder.glob("*.png")} - {*paths})
    found = f"; {surplus[0].name} is there, but maps are named 00001.png, 00002.png, …" if surplus else ""
    if missing:
        raise DataError(f"There is no {missing}, though {POSITIONS} has {len(paths)} samples{found}.")
    if surplus:
        raise DataError(f"{surplus[0]} belongs to no line of {POSITIONS}, which has {len(paths)} samples.")


def _check_index_files(folder: Path, convention: Convention, num_samples: int) -> None:
    first = 0 if convention.index == "zero-based" else 1
    for path in (folder / name for name in IGNORED if (folder / name).exists()):
        for number, line in enumerate(_lines(path), start=1):
            text = line.strip()
            is_number = text.isdecimal() and len(text) < 19
            if not is_number or not first <= int(text) < first + num_samples:
                raise DataError(
                    f"{path}, line {number}, is {line!r}; {num_samples} samples are numbered {first} to "
                    f"{first + num_samples - 1} (--set index=…). Protocols make the splits, so this file "
                    "may also be deleted."
                )


def _check_order(table: Table) -> None:
    """Raise `DataError` if a column says which map each line belongs to, in another order than that of the lines.

    Such a column holds 0, 1, … or 1, 2, …, or names of images, or different numbers under such a name or none.
    """
    numbered = re.compile(r"(?<![\d.])(?<!^[-+])(\d{1,18})(\.[a-z]\w*)?$", re.IGNORECASE | re.ASCII)
    for column in {*range(len(table.names))}.difference(table.axes()):
        name, num_lines = table.names[column], len(table.lines)
        found = [each for cell in table.columns[column] if (each := numbered.search(cell))]
        numbers = [int(each[1]) for each in found]
        is_order = name in ("", "index", "sample") or all(each[2] for each in found) or max(numbers) <= num_lines
        if len({*numbers}) == num_lines and is_order and numbers != (ascending := sorted(numbers)):
            row = next(row for row, number in enumerate(numbers) if number != ascending[row])
            raise DataError(
                f"{table.path}, line {table.lines[row]}, is of {table.columns[column][row]!r} by its column {name!r}, "
                "but lines need the order of maps. Sort them by that column, or remove it if it means something else."
            )


def _sample_table(
    folder: Path,
    position_m: list[tuple[float, ...]],
    carrier_hz: list[float],
    transmitters: list[tuple[float, ...]],
    carriers: list[float],
) -> Int[NDArray[np.int64], "T F"]:
    """The number of the sample of every (transmitter, carrier); raises `DataError` unless each occurs once."""
    row = {position: index for index, position in enumerate(transmitters)}
    column = {carrier: index for index, carrier in enumerate(carriers)}
    table = np.zeros((len(row), len(column)), dtype=np.int64)
    for number, (position, carrier) in enumerate(zip(position_m, carrier_hz, strict=True), start=1):
        place = row[position], column[carrier]
        if table[place]:
            raise DataError(
                f"{folder / POSITIONS}, line {number + 1}, repeats line {table[place] + 1}: the transmitter at "
                f"{position} m has two samples at {format_ghz(carrier)}; it must have one."
            )
        table[place] = number
    missing = np.argwhere(table == 0)
    if len(missing):
        transmitter, absent = missing[0].tolist()
        number = int(table[transmitter].max())
        raise DataError(
            f"{folder / POSITIONS}, line {number + 1}: the transmitter at {position_m[number - 1]} m has no "
            f"sample at {format_ghz(carriers[absent])}; every one needs each carrier of {CARRIERS} once."
        )
    return table
