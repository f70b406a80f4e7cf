"""The PNG layout in which the field publishes its maps (that of Wideband3DGS), read into a data set.

The only module that opens PNGs. A folder of the layout holds, for its samples n = 1, 2, …:

    spectrum/%05d.png    map of sample n, 8-bit grey: amplitude over its maximum
    tx_pos.csv           header x,y,z, then its transmitter's position in metres on line n + 1
    freq.txt             its carrier in GHz on line n
    gateway_info.yml     the receiver: position in metres, orientation as a quaternion x, y, z, w

`train_index.txt` and `test_index.txt` are ignored: protocols make the splits here. No file says how a map is
drawn. What is assumed was settled on the published example, by measurement (tests/test_interchange.py):

* Columns are azimuths from −180° to 180°, rows polar angles from 0° (the zenith, row 0) to 90°, evenly spaced
  with both ends included, so that the last column repeats the first. Both are kept as published; rows are
  turned over, because elevations ascend in a data set.
* The hemisphere's pole is the world's +z and azimuth 0 its +x: lone waves from the transmitters in sight
  peak there, and under no other of the 48 permutations and reflections of the axes (but x, which the array
  cannot tell from −x).
* The array is 4 × 4, half a wavelength apart, in the world's y–z plane: the squared maps lie in the span of
  its 49 spatial lags to the rounding of the PNG.

Paths, antennas, visibility and received power are not published: see `DatasetHeader` for what stands there.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from PIL import Image

from xfreqbench.angles import AngularGrid, FloatArray
from xfreqbench.dataset import DatasetHeader, PasWriter
from xfreqbench.errors import DataError
from xfreqbench.generate import job_sha256, require_same_job
from xfreqbench.scene import Point, ReceiverArray
from xfreqbench.units import format_ghz, ghz_to_hz

POSITIONS, CARRIERS, RECEIVER, MAPS = "tx_pos.csv", "freq.txt", "gateway_info.yml", "spectrum"
IGNORED = ("train_index.txt", "test_index.txt")
CONVENTION = {
    "maps": "8-bit amplitude over its maximum",
    "rows": "polar angle 0 to 90 degrees, both ends included, turned over on import",
    "columns": "azimuth -180 to 180 degrees, both ends included",
    "frame": "pole along the world's +z, azimuth 0 along +x",
    "array": "4 x 4 in the y-z plane, half a wavelength apart",
    "not_published": "paths, antennas, received power and visibility (all transmitters count as in sight)",
}
_BATCH = 16  # transmitters whose maps are held at once


@dataclass(frozen=True, eq=False)
class PngFolder:
    """A checked folder: `sample[t, f]` numbers the map of transmitter t at carrier f."""

    folder: Path
    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    sample: Int[NDArray[np.int64], "T F"]
    receiver: ReceiverArray
    grid: AngularGrid
    sha256: str

    @property
    def ignored(self) -> list[str]:
        """Files of the layout that are there and not read."""
        return [name for name in IGNORED if (self.folder / name).exists()]

    @property
    def header(self) -> DatasetHeader:
        """The data set's header; its scene is known by the files' hash alone."""
        name = self.folder.resolve().name
        return DatasetHeader(
            scene_name=name,
            scene_json=json.dumps({"name": name}),
            scene_sha256=self.sha256,
            receiver=self.receiver,
            carrier_hz=self.carrier_hz,
            num_tx=len(self.tx_position_m),
            pas_kind="amplitude",
            maps=True,
            settings={"imported_from": "wideband3dgs layout", "convention": CONVENTION},
            software={package: metadata.version(package) for package in ("xfreqbench", "numpy", "pillow")},
            rejected={},
            channels=False,
        )

    def maps(self, transmitters: slice) -> Float[NDArray[np.float32], "t F E A"]:
        """Maps of some transmitters, peak 1, in the data set's order of rows; raises `DataError`."""
        samples = self.sample[transmitters]
        maps = [_read_map(_map_path(self.folder, number)) for number in samples.ravel().tolist()]
        return np.stack(maps).reshape(*samples.shape, *self.grid.shape)


def read_png_folder(folder: Path) -> PngFolder:
    """Check every file of a folder before anything is written; raises `DataError` naming file and line."""
    position_m = _read_positions(folder / POSITIONS)
    carrier_hz = _read_carriers_hz(folder / CARRIERS)
    if len(position_m) != len(carrier_hz) or not len(position_m):
        raise DataError(
            f"{folder / POSITIONS} has {len(position_m)} samples and {folder / CARRIERS} {len(carrier_hz)}; "
            "both need one line a sample."
        )
    paths = [_map_path(folder, number) for number in range(1, len(position_m) + 1)]
    _check_numbers(folder / MAPS, paths)
    shape = _common_shape(paths)
    transmitters, carriers = _distinct(position_m), sorted(set(carrier_hz))
    return PngFolder(
        folder=folder,
        tx_position_m=np.array(transmitters),
        carrier_hz=np.array(carriers),
        sample=_sample_table(folder, position_m, carrier_hz, transmitters, carriers),
        receiver=_read_receiver(folder / RECEIVER),
        grid=published_grid(*shape),
        sha256=_content_sha256([folder / POSITIONS, folder / CARRIERS, folder / RECEIVER, *paths]),
    )


def published_grid(num_rows: int, num_columns: int) -> AngularGrid:
    """Directions of a published map once its rows ascend in elevation: both ends of both axes included."""
    return AngularGrid(np.linspace(0, np.pi / 2, num_rows), np.linspace(-np.pi, np.pi, num_columns))


def import_png_folder(source: PngFolder, path: Path) -> bool:
    """Write a folder as a data set; False where `path` holds that already.

    Raises `OutputExistsError` for a file that holds something else, `DataError` and `StorageError`.
    """
    header = source.header
    if path.exists():
        require_same_job(path, job_sha256(header, source.tx_position_m), "data set")
        return False
    with PasWriter(path, header, source.grid) as writer:
        for start in range(0, header.num_tx, _BATCH):
            part = slice(start, start + _BATCH)
            positions = source.tx_position_m[part]
            writer.append_maps(positions, np.ones(len(positions), bool), source.maps(part))
    return True


def _lines(path: Path) -> list[str]:
    """Lines of a text file without blank ones at its end."""
    try:
        return path.read_text().rstrip().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(
            f"{path} cannot be read: {error}. A folder of this layout holds {POSITIONS}, {CARRIERS}, "
            f"{RECEIVER} and {MAPS}/00001.png, …"
        ) from error


def _numbers(text: str, count: int) -> tuple[float, ...] | None:
    """Comma-separated finite numbers, or None where they are not `count` of them."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        return None
    return numbers if len(numbers) == count and np.isfinite(numbers).all() else None


def _read_positions(path: Path) -> list[tuple[float, ...]]:
    header, *lines = _lines(path) or [""]
    if header.replace(" ", "").lower() != "x,y,z":
        raise DataError(f"{path}, line 1, is {header!r}; it must be x,y,z.")
    return [_position(path, number, line) for number, line in enumerate(lines, start=2)]


def _position(path: Path, number: int, line: str) -> tuple[float, ...]:
    position_m = _numbers(line, 3)
    if position_m is None:
        raise DataError(
            f"{path}, line {number}, is {line!r}; it must be three finite numbers, x,y,z in metres."
        )
    return position_m


def _read_carriers_hz(path: Path) -> list[float]:
    return [_carrier_hz(path, number, line) for number, line in enumerate(_lines(path), start=1)]


def _carrier_hz(path: Path, number: int, line: str) -> float:
    carrier_ghz = _numbers(line, 1)
    if carrier_ghz is None or carrier_ghz[0] <= 0:
        raise DataError(f"{path}, line {number}, is {line!r}; it must be a carrier in GHz, above 0.")
    return ghz_to_hz(carrier_ghz[0])


def _read_receiver(path: Path) -> ReceiverArray:
    """The receiver's place from the two lines of YAML that the layout has; a turned one is refused."""
    text = "\n".join(_lines(path))
    orientation = _list_of(path, text, "orientation", 4)
    if not np.allclose(orientation, (0, 0, 0, 1)) and not np.allclose(orientation, (0, 0, 0, -1)):
        raise DataError(
            f"{path} turns the receiver by the quaternion {orientation}; only [0, 0, 0, 1], no turn, can be "
            "read. Turn the transmitters instead."
        )
    x, y, z = _list_of(path, text, "position", 3)
    return ReceiverArray(position_m=(x, y, z), rows=4, cols=4, boresight=(0.0, 0.0, 1.0), plane="yz")


def _list_of(path: Path, text: str, key: str, count: int) -> tuple[float, ...]:
    """The one `key: [numbers]` of a YAML file."""
    found = re.findall(rf"^\s*{key}\s*:\s*\[([^\]]*)\]\s*(?:#.*)?$", text, re.MULTILINE)
    numbers = _numbers(found[0], count) if len(found) == 1 else None
    if numbers is None:
        example: Point | tuple[int, ...] = tuple(range(count))
        raise DataError(
            f"{path} must hold one line like '{key}: {list(example)}', of {count} finite numbers."
        )
    return numbers


def _map_path(folder: Path, number: int) -> Path:
    return folder / MAPS / f"{number:05d}.png"


def _check_numbers(folder: Path, paths: list[Path]) -> None:
    missing = next((path for path in paths if not path.is_file()), None)
    if missing:
        raise DataError(f"There is no {missing}; {POSITIONS} and {CARRIERS} have {len(paths)} samples.")
    surplus = sorted({*folder.glob("*.png")} - {*paths})
    if surplus:
        raise DataError(f"{surplus[0]} belongs to no line of {POSITIONS}, which has {len(paths)} samples.")


def _common_shape(paths: list[Path]) -> tuple[int, int]:
    """Rows and columns of every map, from the PNG headers."""
    shape = _shape(paths[0])
    for path in paths[1:]:
        if _shape(path) != shape:
            raise DataError(
                f"{path} has {_shape(path)} rows and columns, but {paths[0].name} {shape}; all must agree."
            )
    return shape


def _shape(path: Path) -> tuple[int, int]:
    with _opened(path) as image:
        if image.mode != "L":
            raise DataError(f"{path} has pixels of mode {image.mode}; maps are 8-bit grey, mode L.")
        if min(image.size) < 2:
            raise DataError(f"{path} has {image.size} columns and rows; a map has 2 of each or more.")
        return image.height, image.width


def _read_map(path: Path) -> Float[NDArray[np.float32], "E A"]:
    with _opened(path) as image:
        try:
            levels = np.asarray(image, dtype=np.float32)
        except (OSError, SyntaxError, ValueError) as error:
            raise _unreadable(path, error) from error
    return np.ascontiguousarray(levels[::-1] / max(1.0, levels.max()))


def _opened(path: Path) -> Image.Image:
    try:
        return Image.open(io.BytesIO(path.read_bytes()), formats=["PNG"])
    except (OSError, SyntaxError, ValueError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> DataError:
    return DataError(f"{path} cannot be read as a PNG ({error}). Fetch the file again.")


def _distinct(position_m: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Each position once, in the order in which they first occur."""
    return list(dict.fromkeys(position_m))


def _sample_table(
    folder: Path,
    position_m: list[tuple[float, ...]],
    carrier_hz: list[float],
    transmitters: list[tuple[float, ...]],
    carriers: list[float],
) -> Int[NDArray[np.int64], "T F"]:
    """Number of the sample of every (transmitter, carrier): each must occur once. Raises `DataError`."""
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
    _check_complete(folder, table, position_m, carriers)
    return table


def _check_complete(
    folder: Path,
    table: Int[NDArray[np.int64], "T F"],
    position_m: list[tuple[float, ...]],
    carriers: list[float],
) -> None:
    missing = np.argwhere(table == 0)
    if len(missing):
        transmitter, carrier = missing[0].tolist()
        number = int(table[transmitter].max())
        raise DataError(
            f"{folder / POSITIONS}, line {number + 1}: the transmitter at {position_m[number - 1]} m has no "
            f"sample at {format_ghz(carriers[carrier])}; every one needs each carrier of {CARRIERS} once."
        )


def _content_sha256(paths: list[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
