"""Rooms of seven walls that a seed makes: a floor, a ceiling and five upright walls, none of which is along an axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from xfreqbench.baselines.virtual_source.room.surfaces import fan_of
from xfreqbench.baselines.virtual_source.search.planes import Plane

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.plane_waves import stored_channels
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import ReceiverArray, Scene, TransmitterGrid
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray
from xfreqbench.units import ghz_to_hz

CARRIERS_HZ = tuple(map(ghz_to_hz, (1.0, 2.4, 5.0, 10.0, 17.0, 24.25, 37.0, 47.0, 60.0, 77.0)))
NUM_UPRIGHT = 5
_SLABS = (("concrete", 0.2), ("chipboard", 0.02), ("plasterboard", 0.0125), ("glass", 0.01), ("wood", 0.03))
_DISTANCES_M, _HEIGHTS_M = (1.8, 4.2), (2.4, 3.3)  # of walls from the middle, and of the ceiling
_LEAST_WIDTH_M = 0.8
_JITTER_RAD = 0.3  # of a fifth of a turn, 1.26
_ASIDE_M = 0.5  # of the array from the middle, at most
_MARGIN_M = 0.3
_SETTINGS = TraceSettings(interactions=("specular", "refraction"), solver="image", max_depth=4, rays=100_000)
_FOUND_M, _FOUND_RAD = 0.02, 0.01  # a plane that is so near a wall is that wall


@dataclass(frozen=True, eq=False)
class RandomRoom:
    """A room and the places in it. `normal` and `distance_m` are its walls', seen from the array centre."""

    receiver: ReceiverArray
    walls: tuple[SurfaceMesh, ...]
    normal: Float[FloatArray, "7 3"]
    distance_m: Float[FloatArray, "7"]
    tx_position_m: Float[FloatArray, "T 3"]

    @classmethod
    def of(cls, seed: int, num_tx: int) -> RandomRoom:
        """The room that a seed makes, with so many transmitters at random places."""
        generator = np.random.default_rng(seed)
        corners_m = _plan(generator)
        height_m = float(generator.uniform(*_HEIGHTS_M))
        level = [
            np.column_stack([outline_m, np.full(NUM_UPRIGHT, z)])
            for outline_m, z in ((corners_m, 0.0), (corners_m[::-1], height_m))
        ]
        upright = [
            np.array([[*a, 0.0], [*b, 0.0], [*b, height_m], [*a, height_m]])
            for a, b in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True)
        ]
        outlines_m = [*level, *upright]
        walls = tuple(_wall(number, outline_m, generator) for number, outline_m in enumerate(outlines_m))
        aside_m = generator.uniform(-_ASIDE_M, _ASIDE_M, 2).tolist()
        receiver = ReceiverArray(position_m=(*aside_m, height_m - float(generator.uniform(0.1, 0.4))))
        normal = np.array(
            [np.cross(outline_m[1] - outline_m[0], outline_m[2] - outline_m[0]) for outline_m in outlines_m]
        )
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        first_m = np.array([outline_m[0] for outline_m in outlines_m])
        distance_m = ((first_m - receiver.position_m) * normal).sum(axis=1)
        outward = np.sign(distance_m)
        normal, distance_m = normal * outward[:, None], distance_m * outward
        return cls(receiver, walls, normal, distance_m, _places(generator, corners_m, num_tx))

    def traced(self, path: Path) -> PasDataset:
        """The channels of all transmitters at `CARRIERS_HZ`, stored in a new file."""
        scene = Scene("random room", self.receiver, TransmitterGrid((0, 0, 1), (0, 0, 1), (1, 1, 1)))
        tracer = ImageTracer(scene, CARRIERS_HZ, _SETTINGS, geometry=Geometry(self.walls))
        cfr = tracer.channel(self.tx_position_m).cfr
        carriers_hz = np.array(CARRIERS_HZ)
        return stored_channels(path, self.receiver, carriers_hz, self.tx_position_m, cfr, maps=False)


def found_walls(room: RandomRoom, planes: Sequence[Plane]) -> Iterator[tuple[float, float] | None]:
    """For each wall of a room, error and standard deviation in metres of the nearest plane that is about there."""
    for normal, distance_m in zip(room.normal, room.distance_m.tolist(), strict=True):
        near = [
            (plane.distance_m - distance_m, plane.distance_std_m)
            for plane in planes
            if plane.normal @ normal > 0
            and np.linalg.norm(np.cross(plane.normal, normal)) < _FOUND_RAD
            and abs(plane.distance_m - distance_m) < _FOUND_M
        ]
        yield min(near, key=lambda found: abs(found[0]), default=None)


def _plan(generator: np.random.Generator) -> Float[FloatArray, "5 2"]:
    """Corners in turn of a convex pentagon about the origin, with no narrow side."""
    while True:
        angle = generator.uniform(0, 2 * np.pi) + np.arange(NUM_UPRIGHT) * 2 * np.pi / NUM_UPRIGHT
        angle = angle + generator.uniform(-_JITTER_RAD, _JITTER_RAD, NUM_UPRIGHT)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        distance_m = generator.uniform(*_DISTANCES_M, NUM_UPRIGHT)
        pairs = zip(np.roll(normal, 1, axis=0), normal, np.roll(distance_m, 1), distance_m, strict=True)
        corners_m = np.array([np.linalg.solve([one, other], [a, b]) for one, other, a, b in pairs])
        along_m = np.roll(corners_m, -1, axis=0) - corners_m
        width_m = normal[:, 0] * along_m[:, 1] - normal[:, 1] * along_m[:, 0]
        if width_m.min() > _LEAST_WIDTH_M:
            return corners_m


def _wall(number: int, outline_m: Float[FloatArray, "n 3"], generator: np.random.Generator) -> SurfaceMesh:
    material, thickness_m = _SLABS[generator.integers(len(_SLABS))]
    return SurfaceMesh(f"wall {number}", material, thickness_m, outline_m, fan_of(len(outline_m)))


def _places(
    generator: np.random.Generator, corners_m: Float[FloatArray, "5 2"], number: int
) -> Float[FloatArray, "T 3"]:
    """Random places inside the plan, away from its walls, at the heights of hands and heads."""
    along_m = np.roll(corners_m, -1, axis=0) - corners_m
    inward = np.column_stack([-along_m[:, 1], along_m[:, 0]]) / np.linalg.norm(along_m, axis=1)[:, None]
    tried_m = generator.uniform(corners_m.min(axis=0), corners_m.max(axis=0), (20 * number, 2))
    away_m = ((tried_m[:, None] - corners_m) * inward).sum(axis=2)
    inside_m = tried_m[away_m.min(axis=1) > _MARGIN_M][:number]
    return np.column_stack([inside_m, generator.uniform(0.7, 1.7, len(inside_m))])
