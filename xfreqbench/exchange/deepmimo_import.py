"""Makes data sets from scenarios of DeepMIMO v4: paths as they are, and the channels that they sum up to at an array.

Its base station becomes the receiver, an array of 4 × 4 elements that faces down, and its users the transmitters: the
channel is the same in both directions. See `deepmimo` for the way out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import BaseModel, Field, ValidationError

from xfreqbench.data.dataset import holds_same_job
from xfreqbench.data.paths import PathTotals
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.exchange.deepmimo import DIGITS
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.runs.records import fault_of_fields
from xfreqbench.scene.model import FAR_M, ReceiverArray
from xfreqbench.system.array_files import read_arrays
from xfreqbench.system.files import read_bytes, require_text
from xfreqbench.tracing.paths import RaggedPaths, directions, element_delays_s
from xfreqbench.types import FloatArray, IntArray, NDArray, ProgressCallback, ignore_progress
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz

Elevations = Literal["zenith", "horizon"]
_OF_PATHS = ("power", "phase", "delay", "aoa_az", "aoa_el", "aod_az", "aod_el", "inter")
_CODES = {digit: code for code, digit in DIGITS.items()}
_ADVICE = "Convert the scenario again, with all its matrices."


class _Tracing(BaseModel):
    frequency: Annotated[float, Field(ge=1e6, lt=1e15)]  # what is lower is in another unit
    raytracer_name: str


class _Antennas(BaseModel):
    id: int
    is_tx: bool


class _Parameters(BaseModel):
    """What is read of `params.json`."""

    rt_params: _Tracing
    txrx_sets: dict[str, _Antennas]


@dataclass(frozen=True, eq=False)
class Scenario:
    """One scenario, of one carrier: U users with L paths at most, each of D interactions at most, from the station."""

    carrier_hz: float
    station_m: Float[FloatArray, "3"]
    user_m: Float[FloatArray, "U 3"]
    of_paths: dict[str, Float[FloatArray, "U L"]]
    point_m: Float[FloatArray, "U L D 3"]
    raytracer: str
    sha256: str
    files: dict[str, Path]

    @property
    def is_path(self) -> Bool[NDArray[np.bool_], "U L"]:
        """Where the tables hold a path."""
        return ~np.isnan(self.of_paths["power"])


def import_deepmimo(
    folder: Path,
    path: Path,
    pair: str | None = None,
    elevations: Elevations = "zenith",
    progress: ProgressCallback = ignore_progress,
) -> bool:
    """Write a scenario, or a folder of scenarios at several carriers, as a data set; False if it is there already.

    Scenarios of a folder must have the same station and users. What they say of a path is stored once where it is the
    same to the last bit, with gain 0 at the carriers that do not have it. Users without a path are left out. `pair` is
    the part of the files' names for station and users, as `t000_tx000_r001`, if there are several. Elevations are
    counted from the `zenith`, as DeepMIMO does, or from the `horizon` upwards, as its scenarios from AODT have them;
    angles that do not point along the paths are refused. `progress` is called with the number of users that are done
    and of all. Raises `DataError` that names the file, `UnknownNameError` for a pair that is not there,
    `OutputExistsError` and `StorageError`.
    """
    is_one = (folder / "params.json").exists()
    folders = [folder] if is_one else sorted(path.parent for path in folder.glob("*/params.json"))
    if not folders:
        raise DataError(f"{folder} is not a scenario of DeepMIMO v4, and contains none: params.json is missing.")
    read = (_read(subfolder, pair, elevations) for subfolder in folders)
    first, *others = scenarios = sorted(read, key=lambda scenario: scenario.carrier_hz)
    if len({scenario.carrier_hz for scenario in scenarios}) < len(scenarios):
        raise DataError(f"{folder} holds two scenarios at the same carrier; import them one by one.")
    for other in others:
        same = np.array_equal(other.station_m, first.station_m) and np.array_equal(other.user_m, first.user_m)
        if not same:
            raise DataError(
                f"{folder}: station or users at {format_ghz(other.carrier_hz)} are not those at "
                f"{format_ghz(first.carrier_hz)}; import the scenarios one by one."
            )
    is_heard = np.any([scenario.is_path.any(axis=1) for scenario in scenarios], axis=0)
    users = np.flatnonzero(is_heard)
    if not len(users):
        raise DataError(f"{folder} has no path. Choose another pair of sets with --pair.")
    header = _header(folder, scenarios, users, elevations)
    if holds_same_job(path, header, first.user_m[users]):
        return False
    parts = np.split(users, range(64, len(users), 64))  # whose paths and maps are made together
    paths = [_ragged(scenarios, part) for part in parts]
    beam = BartlettBeam(header.receiver.element_position_wavelengths, AngularGrid.hemisphere())
    done = 0
    with PasWriter(path, header, paths=PathTotals.of(paths, ("unknown",))) as writer:
        for part, own in zip(parts, paths, strict=True):
            cfr, num_paths = _channels(own, header)
            samples = SampleBlock.of_channels(cfr, num_paths, beam, header.pas_kind)
            direct = [(scenario.of_paths["inter"][part] == 0) & scenario.is_path[part] for scenario in scenarios]
            in_sight = np.any([is_direct.any(axis=1) for is_direct in direct], axis=0)
            writer.append(first.user_m[part], in_sight, samples, own)
            done += len(part)
            progress(done, len(users))
    return True


def _read(folder: Path, pair: str | None, elevations: Elevations) -> Scenario:
    digest, parameters = hashlib.sha256(), folder / "params.json"
    try:
        content = read_bytes(parameters)
        told = _Parameters.model_validate_json(content)
    except (OSError, ValidationError) as error:
        fault = error.strerror if isinstance(error, OSError) else fault_of_fields(error)
        raise DataError(f"{parameters} is not that of a DeepMIMO v4 scenario: {fault}.") from error
    digest.update(content)
    name = _chosen(folder, pair, {antennas.id for antennas in told.txrx_sets.values() if antennas.is_tx})
    forms = dict.fromkeys(_OF_PATHS, "real U L") | {
        "inter_pos": "real U L D 3",
        "tx_pos": "real 1 3",
        "rx_pos": "real U 3",
    }
    files, sizes = {key: _file(folder, f"{key}_{name}") for key in forms}, dict[str, int]()
    stored = {key: read_arrays(path, {key: forms[key]}, _ADVICE, sizes, digest)[key] for key, path in files.items()}
    codes = stored["inter"]
    if codes.dtype.kind == "f" and (codes >= (limit := 2 ** (np.finfo(codes.dtype).nmant + 1))).any():
        raise DataError(
            f"{files['inter']} holds codes of interactions from {limit:,} on in {codes.dtype}, which rounds their last "
            "digits. Convert the scenario again with codes in float64, or with fewer interactions a path."
        )
    tables = {key: table.astype(np.float64, copy=False) for key, table in stored.items()}
    scenario = Scenario(
        told.rt_params.frequency,
        tables["tx_pos"][0],
        tables["rx_pos"],
        {key: tables[key] for key in _OF_PATHS},
        tables["inter_pos"],
        told.rt_params.raytracer_name,
        digest.hexdigest(),
        files,
    )
    _require_meaning(scenario)
    _require_geometry(scenario, elevations)
    if elevations == "horizon":
        scenario.of_paths.update({key: 90 - scenario.of_paths[key] for key in ("aoa_el", "aod_el")})
    return scenario


def _chosen(folder: Path, pair: str | None, stations: set[int]) -> str:
    """The part of file names for station and users; without `pair`, the only one whose receivers are users."""
    found = sorted({path.stem.partition("power_")[2] for path in folder.glob("power_t*_r*.*")})
    if pair is not None:
        if pair not in found:
            raise UnknownNameError("pair of sets", pair, found)
        return pair
    users = [name for name in found if (end := name.rpartition("r")[2]).isdecimal() and int(end) not in stations]
    if len(users) != 1:
        raise DataError(
            f"{folder} holds {'no table of powers' if not found else 'the pairs ' + ', '.join(found)}; "
            + ("is it complete?" if not found else "choose one with --pair.")
        )
    return users[0]


def _file(folder: Path, stem: str) -> Path:
    for path in (folder / f"{stem}.npz", folder / f"{stem}.mat"):
        if path.exists():
            return path
    raise DataError(f"{folder} has no {stem}.npz. {_ADVICE}")


def _require_meaning(scenario: Scenario) -> None:
    is_path, tables, files = scenario.is_path, scenario.of_paths, scenario.files
    for key, table in tables.items():
        if not np.isfinite(table[is_path]).all():
            raise DataError(f"{files[key]} has numbers that are not finite at places with power.")
    for key, place_m in (("tx_pos", scenario.station_m), ("rx_pos", scenario.user_m)):
        if not (np.abs(place_m) <= FAR_M).all():
            raise DataError(f"{files[key]} has positions beyond {FAR_M:g} m, or that are not numbers.")
    angles = ((key, -360.0, 360.0) for key in ("aoa_az", "aoa_el", "aod_az", "aod_el"))
    for key, low, high in (("delay", 1e-12, 1.0), ("power", -600.0, 0.0), *angles):
        if not ((tables[key][is_path] >= low) & (tables[key][is_path] <= high)).all():
            raise DataError(f"{files[key]} has numbers that are not between {low:g} and {high:g}.")
    phase_deg = np.abs(tables["phase"][is_path])
    if len(phase_deg) >= 4 and 0 < phase_deg.max() <= 3.15:
        raise DataError(f"{files['phase']} has only phases from 0 to π, which are radians; convert them to degrees.")
    digits = _digits(tables["inter"][is_path])
    is_met = digits > 0
    is_whole = (np.diff(is_met.astype(int), axis=1) >= 0).all() and (tables["inter"][is_path] % 1 == 0).all()
    if not is_whole or (tables["inter"][is_path] < 0).any() or (digits > max(_CODES)).any():
        raise DataError(f"{files['inter']} has numbers other than digits 1 to {max(_CODES)}, or 0.")
    depth = scenario.point_m.shape[2]
    count = is_met.sum(axis=1)
    is_there = np.asarray((np.abs(scenario.point_m[is_path]) <= FAR_M).all(axis=-1))
    needed = np.arange(depth) < count[:, None]
    if (count > depth).any() or not is_there[needed].all():
        raise DataError(f"{files['inter_pos']} lacks points for interactions that inter names.")


def _require_geometry(scenario: Scenario, elevations: Elevations) -> None:
    """Raise `DataError` unless paths lead from the station over the points that they meet to users.

    Delays and powers have to agree with the lengths. Every direct path has to agree, and at least half of all paths,
    because converters round the points of some interactions.
    """
    user, place = np.nonzero(scenario.is_path)
    tables = {key: table[user, place] for key, table in scenario.of_paths.items()}
    num_met = (_digits(tables["inter"]) > 0).sum(axis=1)
    rows, in_sight, points_m = np.arange(len(user)), num_met == 0, scenario.point_m[user, place]
    ends_m = {"aod": np.broadcast_to(scenario.station_m, (len(user), 3)), "aoa": scenario.user_m[user]}

    def is_wrong(off: Bool[NDArray[np.bool_], "P"]) -> bool:
        return bool(off[in_sight].any() or off.sum() > len(off) / 2)

    def misses(end: str, counted_from: Elevations) -> Bool[NDArray[np.bool_], "P"]:
        other = ends_m["aoa" if end == "aod" else "aod"]
        met_m = points_m[rows, 0 if end == "aod" else num_met - 1] if points_m.shape[1] else other
        way_m = np.where(in_sight[:, None], other, met_m) - ends_m[end]
        length_m = np.linalg.norm(way_m, axis=1)
        elevation_deg = tables[f"{end}_el"] if counted_from == "horizon" else 90 - tables[f"{end}_el"]
        along = directions(np.radians(tables[f"{end}_az"]), np.radians(elevation_deg))
        # points are rounded: 5 cm, and 2 degrees of the way there
        return np.linalg.norm(along * length_m[:, None] - way_m, axis=1) > 0.05 + 0.035 * length_m

    def faults(counted_from: Elevations) -> dict[str, int]:
        missing = {end: misses(end, counted_from) for end in ends_m}
        return {end: int(off.sum()) for end, off in missing.items() if is_wrong(off)}

    station_m, user_m = (ends_m[end][:, None] for end in ("aod", "aoa"))
    is_met = np.arange(points_m.shape[1])[None, :, None] < num_met[:, None, None]
    way_m = np.concatenate([station_m, np.where(is_met, points_m, user_m), user_m], axis=1)
    length_m = np.linalg.norm(np.diff(way_m, axis=1), axis=2).sum(axis=1)
    is_late = np.abs(tables["delay"] * SPEED_OF_LIGHT_M_S - length_m) > 1.0 + 0.1 * length_m
    if is_wrong(is_late):
        raise DataError(
            f"{scenario.files['delay']} does not fit the lengths of {is_late.sum()} of {len(user)} paths; convert the "
            "scenario again, with delays in seconds from the transmission and positions in metres."
        )
    gain = 10 ** (tables["power"] / 20) * 4 * np.pi * length_m * scenario.carrier_hz / SPEED_OF_LIGHT_M_S
    is_strong = gain > 10  # 20 dB, of both antennas together
    if is_wrong(is_strong):
        raise DataError(
            f"{scenario.files['power']}: {is_strong.sum()} of {len(user)} paths are over 20 dB stronger "
            "than a wave in free space over the same length. Convert the scenario again, with powers in dB of received "
            "over transmitted power; in dBm of 1 W they are 30 dB more."
        )
    instead: Elevations = "horizon" if elevations == "zenith" else "zenith"
    for end, num_off in faults(elevations).items():
        advice = f"counted from the {instead} they hit it: give --elevations {instead}"
        if faults(instead):
            advice = "convert the scenario again, with angles in degrees in the frame of its positions, azimuths from x"
        raise DataError(
            f"{scenario.files[f'{end}_el']}, counted from the {elevations}, and {scenario.files[f'{end}_az'].name} "
            f"miss the next point of {num_off} of {len(user)} paths; {advice}."
        )


def _digits(numbers: Float[FloatArray, "P"]) -> IntArray:
    """The decimal digits of numbers, the last in the last of 16 columns, and zeros before the first.

    A float64 holds every number of 16 digits.
    """
    whole = np.clip(numbers, 0, 10.0**15).astype(np.int64)
    return whole[:, None] // 10 ** np.arange(15, -1, -1, dtype=np.int64) % 10


def _header(folder: Path, scenarios: Sequence[Scenario], users: IntArray, elevations: Elevations) -> DatasetHeader:
    name, first = require_text(folder.resolve().name, "a data set"), scenarios[0]
    told = {} if elevations == "zenith" else {"elevations": f"counted from the {elevations} in the scenario"}
    return DatasetHeader(
        scene_name=name,
        scene_json=json.dumps({"name": name}),
        scene_sha256=hashlib.sha256("".join(scenario.sha256 for scenario in scenarios).encode()).hexdigest(),
        receiver=ReceiverArray(position_m=tuple(first.station_m.tolist())),
        carrier_hz=np.array([scenario.carrier_hz for scenario in scenarios]),
        num_tx=len(users),
        pas_kind="power",
        maps=False,
        settings={
            "imported_from": "DeepMIMO v4",
            "raytracer": first.raytracer,
            "array": "4 × 4 elements half a wavelength apart at the base station, facing down; the paths are to its "
            "centre, and spherical waves at its elements",
            **told,
        },
        software={package: metadata.version(package) for package in ("xfreqbench", "numpy")},
        rejected={"without a path": len(first.user_m) - len(users)},
        paths=True,
    )


def _ragged(scenarios: Sequence[Scenario], users: IntArray) -> RaggedPaths:
    """The paths of some users at all carriers, the earliest first; each has a gain of 0 where it is not listed."""
    depth = max(scenario.point_m.shape[2] for scenario in scenarios)
    rows, gains, owners = [], [], []
    for number, scenario in enumerate(scenarios):
        is_path = scenario.is_path[users]
        user, tables = np.nonzero(is_path)[0], {k: v[users][is_path] for k, v in scenario.of_paths.items()}
        points_m = np.zeros((len(user), depth, 3))
        points_m[:, : scenario.point_m.shape[2]] = np.nan_to_num(scenario.point_m[users][is_path])
        shared = [tables[key] for key in ("delay", "aod_az", "aod_el", "aoa_az", "aoa_el", "inter")]
        rows.append(np.column_stack([user, *shared, points_m.reshape(len(user), -1)]))
        received = 10 ** (tables["power"] / 20) * np.exp(1j * np.radians(tables["phase"]))
        gains.append(received * np.exp(2j * np.pi * (scenario.carrier_hz * tables["delay"] % 1.0)))
        owners.append(np.full(len(user), number))
    distinct, place = np.unique(np.concatenate(rows), axis=0, return_inverse=True)
    gain = np.zeros((len(distinct), len(scenarios)), np.complex64)
    np.add.at(gain, (place.reshape(-1), np.concatenate(owners)), np.concatenate(gains))
    user, delay_s, *degrees, inter = distinct[:, :7].T
    digits = _digits(inter)[:, ::-1]  # from the user: the last digit first
    is_met = digits > 0
    steps = is_met.sum(axis=1)
    path, step = np.nonzero(is_met)
    code = np.zeros(max(_CODES) + 1, np.uint8)
    code[list(_CODES)] = list(_CODES.values())
    points_m = distinct[:, 7:].reshape(len(distinct), depth, 3)
    arrival_az, arrival_zenith, departure_az, departure_zenith = np.radians(degrees)
    return RaggedPaths(
        num_paths=np.bincount(user.astype(np.int64), minlength=len(users)),
        gain=gain,
        delay_s=delay_s.copy(),
        arrival_azimuth_rad=_turned(arrival_az),
        arrival_elevation_rad=(np.pi / 2 - arrival_zenith).astype(np.float32),
        departure_azimuth_rad=_turned(departure_az),
        departure_elevation_rad=(np.pi / 2 - departure_zenith).astype(np.float32),
        num_interactions=steps,
        interaction=code[digits[path, step]],
        surface=np.zeros(len(path), np.int32),
        vertex_m=points_m[path, steps[path] - 1 - step].astype(np.float32),
    )


def _turned(azimuth_rad: Float[FloatArray, "P"]) -> Float[NDArray[np.float32], "P"]:
    """Azimuths in (−π, π]."""
    return np.arctan2(np.sin(azimuth_rad), np.cos(azimuth_rad)).astype(np.float32)


def _channels(paths: RaggedPaths, header: DatasetHeader) -> tuple[NDArray[np.complex128], IntArray]:
    """Channels (T, F, M) of the paths' users, each of some path, as sums of spherical waves; their numbers (T, F)."""
    first = np.cumsum(paths.num_paths) - paths.num_paths
    arrival = directions(paths.arrival_azimuth_rad, paths.arrival_elevation_rad)
    cfr = np.zeros((len(first), len(header.carrier_hz), header.receiver.num_elements), np.complex128)
    for carrier, carrier_hz in enumerate(header.carrier_hz.tolist()):
        element_m = header.receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz)
        delay_s = element_delays_s(paths.delay_s, arrival, element_m - header.receiver.position_m)
        waves = paths.gain[:, carrier, None] * np.exp(-2j * np.pi * carrier_hz * delay_s)
        cfr[:, carrier] = np.add.reduceat(waves, first, axis=0)
    return cfr, np.add.reduceat(paths.gain != 0, first, axis=0, dtype=np.int64)
