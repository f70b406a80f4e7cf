"""What `bench planes` prints: how many walls of random rooms are found, and how often their intervals are right."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xfreqbench.bench.random_rooms import RandomRoom
from xfreqbench.bench.tables import Bench
from xfreqbench.methods.virtual_source.search.planes import Plane
from xfreqbench.methods.virtual_source.search.range_profile import find_planes
from xfreqbench.types import ProgressCallback

_FOUND_M, _FOUND_RAD = 0.02, 0.01  # a plane that is so near a wall is that wall
_DEVIATIONS = 1.96  # of a normal distribution, about the 95 % in its middle


@dataclass(frozen=True)
class FoundWall:
    """A wall of a random room: what it is made of, and the plane that was found of it, with its errors."""

    material: str
    plane: Plane | None
    error_m: float = np.nan
    tilt_rad: float = np.nan

    @property
    def is_covered(self) -> bool:
        """Whether the true distance is in the 95 % interval about the one found."""
        return self.plane is not None and abs(self.error_m) < _DEVIATIONS * self.plane.distance_std_m


def found_walls(room: RandomRoom, planes: Sequence[Plane]) -> Iterator[FoundWall]:
    """Each wall of a room with the nearest plane that is about there."""
    for wall, normal, distance_m in zip(room.walls, room.normal, room.distance_m.tolist(), strict=True):
        tilts = [float(np.linalg.norm(np.cross(each.normal, normal))) for each in planes]
        near = [
            FoundWall(str(wall.material), plane, plane.distance_m - distance_m, tilt)
            for plane, tilt in zip(planes, tilts, strict=True)
            if plane.normal @ normal > 0 and tilt < _FOUND_RAD
        ]
        near = [each for each in near if abs(each.error_m) < _FOUND_M]
        yield min(near, key=lambda each: abs(each.error_m), default=FoundWall(str(wall.material), None))


def bench_planes(bench: Bench, num_rooms: int, num_tx: int, progress: ProgressCallback) -> None:
    """Trace random rooms, find their planes, and print how near these are to the walls, by material."""
    walls: list[FoundWall] = []
    num_false = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(num_rooms):
            room = RandomRoom.of(seed, num_tx)
            planes = find_planes(room.traced(Path(folder) / f"{seed}.h5"), seed)
            own = list(found_walls(room, planes))
            num_false += len(planes) - len({id(each.plane) for each in own if each.plane is not None})
            walls += own
            progress(seed + 1, num_rooms)
    note = (
        f"{num_rooms} rooms of seven walls, {num_tx} transmitters each. *Covered*: the share of walls found whose "
        f"true distance is in the 95 % interval about the one found. {num_false} more planes were found, of no wall."
    )
    columns = (
        "material",
        "walls",
        "found",
        "error (mm), median",
        "error (mm), p95",
        "tilt (mrad), median",
        "covered",
    )
    with bench.table("Walls of random rooms, as planes that the search finds", note, columns) as table:
        for material in sorted({wall.material for wall in walls}):
            table.add(material, *_cells([wall for wall in walls if wall.material == material]))
        table.add("all", *_cells(walls))


def _cells(walls: Sequence[FoundWall]) -> tuple[str, ...]:
    found = [wall for wall in walls if wall.plane is not None]
    if not found:
        return (str(len(walls)), "0", *["—"] * 4)
    error_mm = np.abs([wall.error_m for wall in found]) * 1e3
    tilt_mrad = np.array([wall.tilt_rad for wall in found]) * 1e3
    return (
        str(len(walls)),
        str(len(found)),
        f"{np.median(error_mm):.3f}",
        f"{np.percentile(error_mm, 95):.3f}",
        f"{np.median(tilt_mrad):.3f}",
        f"{np.mean([wall.is_covered for wall in found]):.2f}",
    )
