"""Paths in a data set: the variables of its group `paths`, and the paths of one sample."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from xfreqbench.data.hdf5 import Variable, read_array, text_attributes
from xfreqbench.data.schema import CARRIER, POLARIZATION, DatasetHeader
from xfreqbench.errors import DataError
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing import paths as traced
from xfreqbench.tracing.paths import NO_INTERACTION, RaggedPaths, directions, element_delays_s
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz

GROUP = "paths"
RAGGED = tuple(field.name for field in fields(RaggedPaths) if not field.name.startswith("num_"))
OFFSET, INTERACTION_OFFSET = f"{GROUP}/offset", f"{GROUP}/interaction_offset"
INTERACTION_CODES = {
    "specular": traced.SPECULAR,
    "diffuse": traced.DIFFUSE,
    "refraction": traced.REFRACTION,
    "diffraction": traced.DIFFRACTION,
}
_PATH, _POINT = f"{GROUP}/path", f"{GROUP}/point"  # axes, and the variables that are their coordinates


class PathTotals(NamedTuple):
    """How many paths and interactions a data set stores, names of the surfaces met, and the precision of vertices."""

    num_paths: int
    num_points: int
    surface_names: tuple[str, ...]
    has_double_vertices: bool = False

    @classmethod
    def of(cls, parts: Iterable[RaggedPaths], surface_names: tuple[str, ...]) -> PathTotals:
        """The totals of paths that are stored one part after another."""
        sizes = [(len(part.delay_s), len(part.interaction), part.vertex_m.dtype == np.float64) for part in parts]
        num_paths, num_points, num_double = np.array(sizes).reshape(-1, 3).sum(axis=0).tolist()
        return cls(num_paths, num_points, surface_names, num_double > 0)

    @property
    def attributes(self) -> dict[str, str]:
        """Texts of the group: the names of the surfaces in the order of their indices, and the interactions' codes."""
        codes = json.dumps(INTERACTION_CODES, sort_keys=True)
        return {"surfaces_json": json.dumps(self.surface_names), "interaction_codes_json": codes}


@dataclass(frozen=True, eq=False)
class ImpulseResponse:
    """The channel of a sample as P paths to each of M array elements, in complex baseband about its carrier.

    h_m(t) = Σ_p gain[p, m]·δ(t − delay_s[p, m]). `gain` includes exp(−j2πf·delay), f the carrier, so that the sum over
    paths is the channel at the carrier (Eq. 1). Delays are travel times to each element, in seconds.
    """

    carrier_hz: float
    delay_s: Float[FloatArray, "P M"]
    gain: Complex[NDArray[np.complex128], "P M"]

    def cfr(self, offset_hz: Sequence[float] | Float[FloatArray, "K"]) -> Complex[NDArray[np.complex128], "K M"]:
        """Channel at K frequencies, given as offsets from the carrier: Σ_p gain·exp(−j2π·offset·delay).

        Gains are those at the carrier. Raises `DataError` for offsets that are not numbers, or not smaller than the
        carrier.
        """
        offset_hz = np.asarray(offset_hz, dtype=np.float64)
        if not (np.abs(offset_hz) < self.carrier_hz).all():
            raise DataError(
                f"Frequencies are given as offsets from the carrier, {format_ghz(self.carrier_hz)}, whose offset is 0, "
                f"but got {offset_hz.tolist()} Hz. Give offsets within the band of the channel."
            )
        response = [
            np.exp(-2j * np.pi * np.outer(offset_hz, delay)) @ gain
            for delay, gain in zip(self.delay_s.T, self.gain.T, strict=True)
        ]
        return np.stack(response, axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class SamplePaths:
    """The P paths from one transmitter to the array centre at one carrier, the earliest first.

    `gain` is the complex amplitude at the array centre, received over transmitted. It includes antennas, interactions
    and spreading (λ/4πd), but **not** the travel phase: the channel at the centre is Σ gain·exp(−j2πf·delay_s), time
    running as exp(+j2πft). Delays are travel times to the centre, in seconds.

    Azimuths (from +x towards +y, in (−π, π]) and elevations (above the xy plane) are in radians and in **world** axes:
    of the direction from the receiver towards the last interaction (arrival), and of the direction from the
    transmitter towards the first (departure). `arrival` and `departure` are the same as unit vectors.

    The interactions of a path, at most D, are in order from the transmitter: `interactions` are their codes, padded
    with 0 (1 specular, 2 diffuse, 4 refraction, 8 diffraction, as in Sionna RT), `surfaces` are the indices of the
    surfaces in `surface_names`, padded with −1, and `vertices_m` the points in the world, padded with NaN.
    """

    carrier_hz: float
    receiver: ReceiverArray
    gain: Complex[NDArray[np.complex128], "P"]
    delay_s: Float[FloatArray, "P"]
    arrival_azimuth_rad: Float[NDArray[np.float32], "P"]
    arrival_elevation_rad: Float[NDArray[np.float32], "P"]
    departure_azimuth_rad: Float[NDArray[np.float32], "P"]
    departure_elevation_rad: Float[NDArray[np.float32], "P"]
    interactions: Int[NDArray[np.int32], "P D"]
    surfaces: Int[NDArray[np.int32], "P D"]
    vertices_m: Float[FloatArray, "P D 3"]
    surface_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.delay_s)

    def __repr__(self) -> str:
        return f"SamplePaths({len(self)} paths at {format_ghz(self.carrier_hz)})"

    @property
    def arrival(self) -> Float[FloatArray, "P 3"]:
        """Unit vectors in world axes from the receiver towards each path's last interaction, or the transmitter."""
        return directions(self.arrival_azimuth_rad, self.arrival_elevation_rad)

    @property
    def departure(self) -> Float[FloatArray, "P 3"]:
        """Unit vectors in world axes from the transmitter towards each path's first interaction, or the receiver."""
        return directions(self.departure_azimuth_rad, self.departure_elevation_rad)

    def impulse_response(self) -> ImpulseResponse:
        """The channel of every path at the elements of the array, each path as one spherical wave (`element_delays_s`).

        All elements have the power and polarisation of the centre.
        """
        receiver, wavelength_m = self.receiver, SPEED_OF_LIGHT_M_S / self.carrier_hz
        element_m = receiver.element_position_m(wavelength_m) - receiver.position_m
        delay_s = element_delays_s(self.delay_s, self.arrival, element_m)
        turned = self.gain[:, None] * np.exp(-2j * np.pi * self.carrier_hz * delay_s)
        return ImpulseResponse(self.carrier_hz, delay_s, turned)

    @classmethod
    def of(
        cls, paths: RaggedPaths, carrier: int, header: DatasetHeader, surface_names: tuple[str, ...] = ()
    ) -> SamplePaths:
        """The paths of one transmitter, at the carrier of that number in the header."""
        count = paths.num_interactions
        is_met = np.arange(count.max(initial=0)) < count[:, None]
        interactions = np.full(is_met.shape, NO_INTERACTION, np.int32)
        surfaces, vertices_m = np.full(is_met.shape, -1, np.int32), np.full((*is_met.shape, 3), np.nan)
        interactions[is_met], surfaces[is_met] = paths.interaction, paths.surface
        vertices_m[is_met] = paths.vertex_m
        return cls(
            carrier_hz=float(header.carrier_hz[carrier]),
            receiver=header.receiver,
            gain=paths.gain[:, carrier].astype(np.complex128),
            interactions=interactions,
            surfaces=surfaces,
            vertices_m=vertices_m,
            surface_names=surface_names,
            **{name: getattr(paths, name) for name in RAGGED if name.endswith(("delay_s", "_rad"))},
        )


def path_variables(header: DatasetHeader, totals: PathTotals) -> list[Variable]:
    """The variables of the group, in the order of the file; all except the offsets of transmitters are compressed."""
    P, N, R = totals.num_paths, totals.num_points, max(1, len(header.receivers))
    pairs = [POLARIZATION] if header.polarizations else []
    away = "from the receiver to where the path comes from, world axes"
    ahead = "in which the path leaves the transmitter, world axes"
    size = {_PATH: P, _POINT: N, CARRIER: len(header.carrier_hz), "axis": 3, **header.link_axes}
    size |= {INTERACTION_OFFSET: P + 1}
    at_each = " at each receiver" if header.receivers else ""
    first_path = f"first path of each transmitter{at_each}, then the number of all paths"
    first_point = "first interaction of each path, then the number of all interactions"
    codes = tuple((code, name) for name, code in INTERACTION_CODES.items())

    def rows(name: str, dtype: str, axes: tuple[str, ...], units: str, long_name: str, flags: Any = ()) -> Variable:
        shape = tuple(size[axis] for axis in axes)
        chunk = (min(4096, shape[0]), *shape[1:]) if shape[0] else None
        return Variable(name, dtype, shape, axes, units, long_name, chunk, chunk is not None, flags)

    vertex_type = "<f8" if totals.has_double_vertices else "<f4"
    code = "code of an interaction, in order from the transmitter"
    return [
        Variable(OFFSET, "<i8", (header.num_tx * R + 1,), (OFFSET,), "1", first_path),
        rows(INTERACTION_OFFSET, "<i8", (INTERACTION_OFFSET,), "1", first_point),
        rows(_PATH, "<i8", (_PATH,), "1", "path index"),
        rows(_POINT, "<i8", (_POINT,), "1", "interaction index"),
        rows(f"{GROUP}/gain", "<c8", (_PATH, *pairs, CARRIER), "1", "gain at the array centre, without travel phase"),
        rows(f"{GROUP}/delay_s", "<f8", (_PATH,), "s", "travel time to the array centre"),
        rows(f"{GROUP}/arrival_azimuth_rad", "<f4", (_PATH,), "rad", f"azimuth of the direction {away}"),
        rows(f"{GROUP}/arrival_elevation_rad", "<f4", (_PATH,), "rad", f"elevation of the direction {away}"),
        rows(f"{GROUP}/departure_azimuth_rad", "<f4", (_PATH,), "rad", f"azimuth of the direction {ahead}"),
        rows(f"{GROUP}/departure_elevation_rad", "<f4", (_PATH,), "rad", f"elevation of the direction {ahead}"),
        rows(f"{GROUP}/interaction", "u1", (_POINT,), "1", code, codes),
        rows(f"{GROUP}/surface", "<i4", (_POINT,), "1", "surface that is met, by its place in surfaces_json"),
        rows(f"{GROUP}/vertex_m", vertex_type, (_POINT, "axis"), "m", "where it is met in the world"),
    ]


def stored_totals(file: Any) -> PathTotals:
    """The totals that an open data set stores; raises `ValueError` or another error of reading if it is damaged."""
    names = json.loads(text_attributes(file[GROUP])["surfaces_json"])
    is_double = file[f"{GROUP}/vertex_m"].dtype == np.float64
    return PathTotals(file[_PATH].shape[0], file[_POINT].shape[0], tuple(map(str, names)), bool(is_double))


def stored_offsets(file: Any, num_paths: int) -> Int[IntArray, "T1"]:
    """First path of each transmitter, then the number of all paths; raises `ValueError` if they do not ascend."""
    offset = read_array(file, OFFSET)
    _require_ascending(OFFSET, offset, 0, num_paths)
    return offset


def read_paths(file: Any, totals: PathTotals, tx_offset: Int[IntArray, "T1"]) -> RaggedPaths:
    """Paths of some transmitters of an open data set, concatenated; raises `ValueError` for invalid values.

    `tx_offset` is a part of `stored_offsets`: that of T transmitters, each at every receiver, and the next.
    """
    start, stop = int(tx_offset[0]), int(tx_offset[-1])
    offset = file[INTERACTION_OFFSET][start : stop + 1]
    first, last = int(offset[0]), int(offset[-1])
    _require_ascending(INTERACTION_OFFSET, offset, max(0, first), min(last, totals.num_points))
    values = {}
    for name in RAGGED:
        is_of_points = name in ("interaction", "surface", "vertex_m")
        values[name] = file[f"{GROUP}/{name}"][slice(first, last) if is_of_points else slice(start, stop)]
        if not np.isfinite(values[name]).all():
            raise ValueError(f"dataset '{GROUP}/{name}' holds numbers that are not finite")
    surface = values["surface"]
    if ((surface < 0) | (surface >= len(totals.surface_names))).any():
        raise ValueError(f"dataset '{GROUP}/surface' names surfaces that do not exist")
    if not np.isin(values["interaction"], list(INTERACTION_CODES.values())).all():
        raise ValueError(f"dataset '{GROUP}/interaction' holds codes of unknown interactions")
    return RaggedPaths(np.diff(tx_offset), num_interactions=np.diff(offset), **values)


def _require_ascending(name: str, offset: IntArray, first: int, last: int) -> None:
    if offset[0] != first or offset[-1] != last or (np.diff(offset) < 0).any():
        raise ValueError(f"dataset {name!r} holds offsets that do not ascend from {first} to {last}")
