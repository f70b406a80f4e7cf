"""Free-standing rooms of plane waves: a line of sight, its mirror images, and a little that is neither."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.plane_waves import stored_channels
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.array import steering_vector
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

RECEIVER = ReceiverArray(position_m=(3.1, 2.4, 2.5))
SCATTERED = 0.1  # of the line of sight: what is no reflection in a plane


@dataclass(frozen=True)
class Wall:
    """A plane by the azimuth and elevation of its normal, seen from the array, and its distance."""

    azimuth_deg: float
    elevation_deg: float
    distance_m: float
    reflection: complex = 0.5
    lit_beyond_y_m: float = -math.inf  # transmitters from where it is seen, in the world's axes

    @property
    def normal(self) -> np.ndarray:
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        level = math.cos(elevation)
        return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])

    def mirrored(self, offset_m: np.ndarray) -> np.ndarray:
        return offset_m + 2 * (self.distance_m - offset_m @ self.normal)[:, None] * self.normal


@dataclass(frozen=True, eq=False)
class Room:
    """Walls, and transmitters at random between two corners."""

    walls: Sequence[Wall]
    carrier_hz: np.ndarray
    num_tx: int
    receiver: ReceiverArray = RECEIVER
    corners_m: tuple[tuple[float, ...], tuple[float, ...]] = ((0.3, 0.3, 0.7), (6.2, 4.9, 1.7))

    @property
    def tx_position_m(self) -> np.ndarray:
        return np.random.default_rng(7).uniform(*self.corners_m, size=(self.num_tx, 3))

    @property
    def offset_m(self) -> np.ndarray:
        return self.tx_position_m - np.array(self.receiver.position_m)

    def cfr(self, sign: int = 1) -> np.ndarray:
        """Channels (T, F, M); `sign` −1 lets time run the other way in delays alone."""
        scattered_m = np.random.default_rng(8).normal(size=self.offset_m.shape) * 2 + self.offset_m
        lit = [self.tx_position_m[:, 1] > wall.lit_beyond_y_m for wall in self.walls]
        images_m = [wall.mirrored(self.offset_m) for wall in self.walls]
        paths = [
            self.path(self.offset_m, 1.0, sign),
            self.path(scattered_m, SCATTERED, sign),
            *(
                self.path(image_m, wall.reflection, sign) * is_lit[:, None, None]
                for wall, image_m, is_lit in zip(self.walls, images_m, lit, strict=True)
            ),
        ]
        return np.sum(paths, axis=0)

    def path(self, image_m: np.ndarray, gain: complex, sign: int = 1) -> np.ndarray:
        """Channels (T, F, M) of plane waves from mirror images."""
        length_m = np.linalg.norm(image_m, axis=1, keepdims=True)
        travel = np.exp(-2j * np.pi * sign * length_m * self.carrier_hz / SPEED_OF_LIGHT_M_S)
        arrival = image_m @ self.receiver.rotation / length_m
        element = self.receiver.element_position_wavelengths
        steering = steering_vector(element, arrival, SPEED_OF_LIGHT_M_S)  # a wavelength is a metre
        return gain / length_m[:, :, None] * travel[:, :, None] * steering[:, None]

    def stored(self, path: Path, cfr: np.ndarray | None = None) -> PasDataset:
        """A data set of these channels, or of others."""
        told = self.cfr() if cfr is None else cfr
        file = path / "room.h5"
        return stored_channels(file, self.receiver, self.carrier_hz, self.tx_position_m, told, maps=False)

    def stored_maps(self, path: Path, kind: PasKind, levels: int) -> PasDataset:
        """The same as maps alone, of so many levels, on a grid of three degrees."""
        header = replace(self.stored(path).header, channels=False, maps=True, pas_kind=kind)
        grid = AngularGrid.hemisphere(30, 120)
        element = self.receiver.element_position_wavelengths
        maps, _ = BartlettBeam(element, grid).maps(self.cfr().reshape(-1, len(element)), kind)
        rounded = ((maps * levels).round() / np.float32(levels)).reshape(self.num_tx, -1, *grid.shape)
        with PasWriter(path / "maps.h5", header, grid) as writer:
            writer.append(self.tx_position_m, np.ones(self.num_tx, bool), SampleBlock.of_maps(rounded))
        return open_dataset(path / "maps.h5")


def tilt_rad(normal: np.ndarray, wall: Wall) -> float:
    """Between a plane's normal and a wall's."""
    return float(np.linalg.norm(np.cross(normal, wall.normal)))
