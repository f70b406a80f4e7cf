"""What `bench patches` prints: how much channels change with the least size of a mesh's patch that mirrors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench.bench.tables import Bench
from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.data.trace import traced
from xfreqbench.errors import SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import PatchSize, Scene
from xfreqbench.types import FloatArray, ProgressCallback
from xfreqbench.units import format_ghz

FINEST = PatchSize(0.005, 0.02)  # what the others are compared with
SIZES = (
    PatchSize(0.005, 0.1),
    PatchSize(0.02, 0.1),
    PatchSize(),
    PatchSize(0.1, 0.1),
    PatchSize(0.2, 0.2),
    PatchSize(1.0, 0.5),
)


@dataclass(frozen=True, eq=False)
class PatchErrors:
    """Of T transmitters ‖h − h′‖ / ‖h′‖ at F carriers, for one least size, of which `num_patches` patches are.

    h′ is the channel where patches of `FINEST` mirror.
    """

    size: PatchSize
    num_patches: int
    error: Float[FloatArray, "T F"]

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table: at each carrier the median and the 5th percentile of −20·log10 of the error, in dB."""
        median, worst = (np.percentile(self.error, share, axis=0, method="higher") for share in (50, 95))
        with np.errstate(divide="ignore"):
            decibels = -20 * np.log10(np.stack([median, worst], axis=1))
        return (
            _name(self.size),
            str(self.num_patches),
            *(f"{middle:.1f} / {low:.1f}" for middle, low in decibels),
        )


def plan_patches(scene: Scene, carriers_hz: Sequence[float], num_transmitters: int) -> Plan:
    """The plan of the channels that others are compared with; raises `SceneError`, and as `plan_generation` does.

    The transmitters are those that `generate` chooses.
    """
    if scene.scene is None:
        raise SceneError(
            f"Scene {scene.name!r} has no meshes, so every surface mirrors. Name a scene with meshes, such as lounge."
        )
    return plan_generation(_with(scene, FINEST), carriers_hz, num_transmitters=num_transmitters, maps=False)


def patch_errors(plan: Plan, progress: ProgressCallback) -> Iterator[PatchErrors]:
    """The errors of each of `SIZES`, with the positions of the plan's transmitters; raises `SceneError` in silence."""
    scene, tx_position_m = plan.scene, plan.tx_position_m
    expected = _channels(plan)
    length = np.linalg.norm(expected, axis=2)
    if not (heard := length.min(axis=1) > 0).any():
        raise SceneError(
            f"No path of {len(length)} transmitters of scene {scene.name!r} arrives. Choose more."
        )
    for done, size in enumerate(SIZES, start=1):
        progress(done, len(SIZES) + 1)
        coarser = plan_generation(
            _with(scene, size),
            plan.tracing.carrier_hz,
            plan.tracing.settings,
            tx_position_m=tx_position_m,
            maps=False,
        )
        off = np.linalg.norm(_channels(coarser) - expected, axis=2)
        yield PatchErrors(size, num_patches(coarser.tracing.geometry()), off[heard] / length[heard])
    progress(len(SIZES) + 1, len(SIZES) + 1)


def bench_patches(bench: Bench, plan: Plan, progress: ProgressCallback) -> None:
    """Print the table of a plan, a row for each of `SIZES`."""
    num_finest = num_patches(plan.tracing.geometry())
    note = (
        f"Errors of {len(plan.tx_position_m)} transmitters' channels against those where {num_finest} patches mirror "
        f"({_name(FINEST)}), in dB: −20·log10(‖h − h′‖ / ‖h′‖), median / 5th percentile. Surfaces of the TOML always "
        "mirror, and are not counted."
    )
    columns = ("at least", "patches", *map(format_ghz, plan.tracing.carrier_hz))
    with bench.table(f"Patches that mirror, scene {plan.scene.name}", note, columns) as table:
        for row in patch_errors(plan, progress):
            table.add(*row.cells)


def num_patches(geometry: Geometry) -> int:
    """How many patches of imported meshes mirror."""
    free = [mesh for mesh in geometry.meshes if mesh.least_patch is None]
    return geometry.num_mirrors - sum(len(mesh.triangles) for mesh in free)


def _channels(plan: Plan) -> Complex[NDArray[np.complexfloating], "T F M"]:
    return traced(plan.tracing, (0, plan.tx_position_m)).cfr


def _with(scene: Scene, size: PatchSize) -> Scene:
    """The scene with another least size of a patch that mirrors."""
    return replace(
        scene, mirrors="patches", least_patch_area_m2=size.area_m2, least_patch_width_m=size.width_m
    )


def _name(size: PatchSize) -> str:
    return f"{size.area_m2:g} m², {size.width_m:g} m"
