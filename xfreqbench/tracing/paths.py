"""Propagation paths from a transmitter to the array centre: as tracers give them, and as data sets store them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int, UInt8

from xfreqbench.scene.model import NEAR_M, ReceiverArray
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

# All pairs of so many paths with the others are in memory at a time.
_BLOCK_PATHS = 512
NO_INTERACTION, SPECULAR, DIFFUSE, REFRACTION, DIFFRACTION = 0, 1, 2, 4, 8  # Sionna RT's codes


@dataclass(frozen=True)
class Paths:
    """P paths from one transmitter to the array centre at F carriers, the earliest first.

    `gain` holds the antenna patterns, interactions and spreading (λ/4πd included) but **no** travel phase: the
    channel at the centre is Σ gain·exp(−j2πf·delay_s) over the paths (Eq. 1). `delay_s` is the travel time to
    the array centre. `arrival` is a unit vector from the receiver towards the last interaction, in world axes.
    `interactions` are the codes of at most D interactions along the path from the transmitter, padded with
    `NO_INTERACTION`, `surfaces` the index of the scene's mesh that is met at each, padded with −1 (at an edge that of
    one of its two faces), and `vertices_m` the points where they happen, padded with NaN.
    """

    carrier_hz: Float[FloatArray, "F"]
    gain: Complex[NDArray[np.complex128], "F P"]
    delay_s: Float[FloatArray, "P"]
    arrival: Float[FloatArray, "P 3"]
    interactions: Int[NDArray[np.int64], "P D"]
    surfaces: Int[NDArray[np.int64], "P D"]
    vertices_m: Float[FloatArray, "P D 3"]

    @classmethod
    def joined(cls, links: Sequence[Paths]) -> Paths:
        """The paths between the same two places by L pairs of antennas, as the paths of one pair at L · F carriers.

        A path that a pair lacks has gain 0 there.
        """
        if len(links) == 1:
            return links[0]
        points_m = [np.nan_to_num(link.vertices_m, nan=np.inf).swapaxes(0, 1) for link in links]
        met = [np.hstack([link.interactions, link.surfaces, *at]) for link, at in zip(links, points_m, strict=True)]
        _, first, number = np.unique(np.concatenate(met), axis=0, return_index=True, return_inverse=True)
        delay_s = np.concatenate([link.delay_s for link in links])[first]
        order = np.lexsort((first, delay_s))
        place = np.split(np.argsort(order)[number.ravel()], np.cumsum([len(link.delay_s) for link in links])[:-1])
        gain = np.zeros((len(links), len(first), len(links[0].carrier_hz)), np.complex128)
        for of_link, link, at in zip(gain, links, place, strict=True):
            np.add.at(of_link, at, link.gain.T)
        of_a_path = "arrival", "interactions", "surfaces", "vertices_m"
        kept = {name: np.concatenate([getattr(link, name) for link in links])[first][order] for name in of_a_path}
        flat = gain.swapaxes(1, 2).reshape(len(links) * gain.shape[2], len(first))
        return cls(np.tile(links[0].carrier_hz, len(links)), flat, delay_s[order], **kept)

    def departure(
        self, tx_position_m: Float[FloatArray, "3"], receiver_m: Float[FloatArray, "3"]
    ) -> Float[FloatArray, "P 3"]:
        """Unit vectors from the transmitter towards the first interaction, or the receiver where there is none."""
        line_m = np.concatenate([self.vertices_m, np.full((len(self.delay_s), 1, 3), np.nan)], axis=1)
        towards = np.where(np.isnan(line_m[:, 0]), receiver_m, line_m[:, 0]) - tx_position_m
        return towards / np.linalg.norm(towards, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class RaggedPaths:
    """The paths of T transmitters, P in all with I interactions, one behind the other, as data sets store them.

    `num_paths` are those of each transmitter, and `num_interactions` those of each path. `gain` and `delay_s` are
    those of `Paths`. Azimuths and elevations are of unit vectors in world axes, which point from the receiver
    towards the last interaction (arrival), and from the transmitter towards the first (departure). `vertex_m` is in
    single precision where the receiver is within `NEAR_M` of the origin, and in double beyond.

    In a file of several pairs of polarizations gains have an axis for them before the carriers. In one of several
    receivers the paths to all of them follow one another for each transmitter, so that T counts both.
    """

    num_paths: Int[NDArray[np.int64], "T"]
    gain: Complex[NDArray[np.complex64], "P *L F"]
    delay_s: Float[FloatArray, "P"]
    arrival_azimuth_rad: Float[NDArray[np.float32], "P"]
    arrival_elevation_rad: Float[NDArray[np.float32], "P"]
    departure_azimuth_rad: Float[NDArray[np.float32], "P"]
    departure_elevation_rad: Float[NDArray[np.float32], "P"]
    num_interactions: Int[NDArray[np.int64], "P"]
    interaction: UInt8[NDArray[np.uint8], "I"]
    surface: Int[NDArray[np.int32], "I"]
    vertex_m: Float[NDArray[np.floating], "I 3"]

    @classmethod
    def of(
        cls, paths: Sequence[Paths], tx_position_m: Float[FloatArray, "T 3"], receiver_m: Float[FloatArray, "*R 3"]
    ) -> RaggedPaths:
        """The paths of T transmitters, one at least, and of a receiver at `receiver_m`, or of one for each."""
        is_met: list[Bool[NDArray[np.bool_], "P D"]] = [of_tx.interactions != NO_INTERACTION for of_tx in paths]
        ends = zip(paths, tx_position_m, np.broadcast_to(receiver_m, tx_position_m.shape), strict=True)
        arrival = angles_rad(np.concatenate([of_tx.arrival for of_tx in paths]))
        departure = angles_rad(np.concatenate([of_tx.departure(tx, rx) for of_tx, tx, rx in ends]))
        kept = list(zip(paths, is_met, strict=True))
        precision = np.float64 if (np.abs(receiver_m) > NEAR_M).any() else np.float32
        return cls(
            num_paths=np.array([len(of_tx.delay_s) for of_tx in paths], np.int64),
            gain=np.concatenate([of_tx.gain.T for of_tx in paths]).astype(np.complex64),
            delay_s=np.concatenate([of_tx.delay_s for of_tx in paths]),
            arrival_azimuth_rad=arrival[0].astype(np.float32),
            arrival_elevation_rad=arrival[1].astype(np.float32),
            departure_azimuth_rad=departure[0].astype(np.float32),
            departure_elevation_rad=departure[1].astype(np.float32),
            num_interactions=np.concatenate([met.sum(axis=1) for met in is_met]).astype(np.int64),
            interaction=np.concatenate([of_tx.interactions[met] for of_tx, met in kept]).astype(np.uint8),
            surface=np.concatenate([of_tx.surfaces[met] for of_tx, met in kept]).astype(np.int32),
            vertex_m=np.concatenate([of_tx.vertices_m[met] for of_tx, met in kept]).astype(precision),
        )

    def every(self, step: int, first: int) -> RaggedPaths:
        """The paths of every `step`-th transmitter, from the one of that number on."""
        is_of = np.arange(len(self.num_paths)) % step == first
        is_path = np.repeat(is_of, self.num_paths)
        is_point = np.repeat(is_path, self.num_interactions)
        masks = {"num_paths": is_of, "interaction": is_point, "surface": is_point, "vertex_m": is_point}
        return RaggedPaths(**{name: value[masks.get(name, is_path)] for name, value in vars(self).items()})

    def total_power(self, carrier: int) -> Float[FloatArray, "T"]:
        """Σ|gain|² over the paths of each of T transmitters, at the carrier of that number."""
        tx = np.repeat(np.arange(len(self.num_paths)), self.num_paths)
        power = np.abs(self.gain[:, carrier].astype(np.complex128)) ** 2
        return np.bincount(tx, power, len(self.num_paths)).astype(np.float64)

    def mean_power(
        self, carrier_hz: Float[FloatArray, "F"], tx: Int[IntArray, "n"], radius_wavelengths: float
    ) -> Float[FloatArray, "n F"]:
        """Mean of |Σ gain·exp(−j2πfτ)|² over a horizontal disc about each of n transmitters, its paths as plane waves.

        It is Σ g_l·g_m*·2J₁(x)/x over all pairs of paths, x = 2πR·|u_l − u_m|, where R is the radius in wavelengths and
        u the horizontal part of a direction of departure. An infinite disc is taken to leave Σ|gain|².
        """
        from scipy.spatial.distance import cdist
        from scipy.special import j1

        if np.isinf(radius_wavelengths):
            return np.stack([self.total_power(carrier)[tx] for carrier in range(len(carrier_hz))], axis=1)
        turned = self.gain * np.exp(-2j * np.pi * self.delay_s[:, None] * carrier_hz)
        across = directions(self.departure_azimuth_rad, self.departure_elevation_rad)[:, :2]
        last = np.cumsum(self.num_paths)
        mean = np.zeros((len(tx), len(carrier_hz)))
        for row, (start, stop) in enumerate(zip((last - self.num_paths)[tx], last[tx], strict=True)):
            for first in range(start, stop, _BLOCK_PATHS):  # all pairs of these with the others are in memory at a time
                part = slice(first, min(first + _BLOCK_PATHS, stop))
                x = 2 * np.pi * radius_wavelengths * cdist(across[part], across[start:stop])
                shared = np.divide(2 * j1(x), x, out=np.ones_like(x), where=x > 0)
                mean[row] += (turned[part].conj() * (shared @ turned[start:stop])).sum(axis=0).real
        return np.maximum(mean, 0)


def angles_rad(direction: Float[FloatArray, "P 3"]) -> tuple[Float[FloatArray, "P"], Float[FloatArray, "P"]]:
    """Azimuth from +x towards +y, in (−π, π], and elevation above the xy plane of unit vectors."""
    x, y, z = direction.T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def directions(
    azimuth_rad: Float[NDArray[np.floating], "P"], elevation_rad: Float[NDArray[np.floating], "P"]
) -> Float[FloatArray, "P 3"]:
    """Unit vectors of azimuths and elevations: the inverse of `angles_rad`."""
    azimuth, elevation = azimuth_rad.astype(np.float64), elevation_rad.astype(np.float64)
    horizontal = np.cos(elevation)
    return np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)], axis=-1)


def element_delays_s(
    delay_s: Float[FloatArray, "P"], arrival: Float[FloatArray, "P 3"], element_m: Float[FloatArray, "M 3"]
) -> Float[FloatArray, "P M"]:
    """Travel times of paths to elements at world offsets from the array centre, each path as one spherical wave.

    The wave comes from where the centre sees its source: at the distance c·delay in the direction of arrival. For
    paths of reflections and transmissions this is the exact image of the transmitter.
    """
    source_m = (delay_s * SPEED_OF_LIGHT_M_S)[:, None] * arrival
    return np.linalg.norm(source_m[:, None] - element_m, axis=-1) / SPEED_OF_LIGHT_M_S


def spherical_waves(paths: Paths, carrier: int, receiver: ReceiverArray) -> Complex[NDArray[np.complex128], "P M"]:
    """Channel of each path at the array's elements as one spherical wave, at the carrier of that number.

    The wave comes from the path's source as the array centre sees it; power and polarisation are those at the
    centre for all elements.
    """
    carrier_hz = float(paths.carrier_hz[carrier])
    element_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz) - np.asarray(receiver.position_m)
    turns = carrier_hz * element_delays_s(paths.delay_s, paths.arrival, element_m)
    return paths.gain[carrier][:, None] * np.exp(-2j * np.pi * turns)
