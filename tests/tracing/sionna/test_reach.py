"""Which chains may reach the array is decided without losing one that does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from xfreqbench.scene.meshes import triangle_corners_m
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.paths import SPECULAR
from xfreqbench.tracing.tracer import Channel, TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

pytestmark = pytest.mark.sionna

CARRIERS_HZ = [1e9, 5e9, 24.25e9, 94e9]
SETTINGS = TraceSettings(interactions=("specular", "refraction"), solver="sionna", rays=60_000)
PLACES = {
    "office": [[1.3, 4.1, 1.2], [6.2, 1.1, 0.9], [3.9, 5.2, 1.6]],
    "two_rooms": [[1.1, 1.2, 1.2], [7.9, 2.1, 1.0]],
    "lounge": [[6.57797075, 4.57926777, 1.0016431], [1.45, 2.2, 1.3], [4.44, 4.15, 1.33]],
}


def solved(scene_name: str, polarization: str, keep_all: bool) -> Channel:
    from xfreqbench.tracing.sionna.reach import Reach
    from xfreqbench.tracing.sionna.tracer import SionnaTracer

    scene = load_scene(scene_name)
    scene = replace(scene, receiver=replace(scene.receiver, polarization=polarization))
    tracer = SionnaTracer(scene, CARRIERS_HZ, SETTINGS)

    def every(self: Reach, tx_position_m: NDArray[np.float64], chain: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.ones(len(chain), dtype=bool)

    with pytest.MonkeyPatch.context() as patch:
        if keep_all:
            patch.setattr(Reach, "may_reach", every)
        return tracer.channel(np.array(PLACES[scene_name]))


@pytest.mark.parametrize(("scene_name", "polarization"), [("office", "V"), ("two_rooms", "H")])
def test_no_path_is_lost_to_any_element(scene_name: str, polarization: str) -> None:
    """In rooms of boxes the channel is that of all chains, solved at all elements."""
    found, whole = (solved(scene_name, polarization, keep_all) for keep_all in (False, True))
    np.testing.assert_array_equal(found.cfr, whole.cfr)
    np.testing.assert_array_equal(found.num_paths, whole.num_paths)


@pytest.mark.slow
def test_no_chain_is_dropped_whose_points_of_reflection_lie_on_their_triangles() -> None:
    """Among the triangles of cushions, leaves and rods, for each element by itself.

    Here all chains cannot be the reference: Sionna also lets a triangle reflect beside a neighbour that is a little
    tilted, which has a chain of its own.
    """
    from xfreqbench.tracing.sionna.tracer import SionnaTracer

    scene = load_scene("lounge")
    rays = SionnaTracer(scene, CARRIERS_HZ, SETTINGS)._rays
    num_reached = 0
    for place_m in np.array(PLACES["lounge"]):
        chain = rays._hits.chains_seen_from(rays.radio_scene, place_m)
        kept = rays._reach.may_reach(np.tile(place_m, (len(chain), 1)), chain)
        reaches = np.zeros(len(chain), dtype=bool)
        for element_m in scene.receiver.element_position_m(SPEED_OF_LIGHT_M_S / min(CARRIERS_HZ)):
            reaches |= reflects_on_its_triangles(rays, chain, place_m, element_m)
        assert kept[reaches].all()
        num_reached += reaches.sum()
        assert kept.sum() < 0.5 * len(chain)
    assert num_reached > 300


def reflects_on_its_triangles(
    rays: Any, chain: NDArray[np.int64], tx_m: NDArray[np.float64], element_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether the path of each chain from a transmitter to one element meets every mirror within its triangle."""
    corners_m = triangle_corners_m(rays.radio_scene.meshes)[rays.chains.triangle[chain]]
    is_mirror = rays.chains.interaction[chain] == SPECULAR
    images_m = [np.tile(element_m, (len(chain), 1))]
    for depth in range(corners_m.shape[1]):
        mirrored_m = mirrored(images_m[-1], corners_m[:, depth])
        images_m.append(np.where(is_mirror[:, depth, None], mirrored_m, images_m[-1]))
    point_m, reflects = np.tile(tx_m, (len(chain), 1)), np.ones(len(chain), dtype=bool)
    for depth in reversed(range(corners_m.shape[1])):
        a, b, c = np.moveaxis(corners_m[:, depth], 1, 0)
        towards = images_m[depth + 1] - point_m
        matrix = np.stack([b - a, c - a, -towards], axis=-1)
        is_regular = is_mirror[:, depth] & (np.abs(np.linalg.det(matrix)) > 1e-12)
        solution = np.zeros((len(chain), 3))
        solution[is_regular] = np.linalg.solve(matrix[is_regular], (point_m - a)[is_regular, :, None])[:, :, 0]
        u, v, t = solution.T
        inside = is_regular & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)
        reflects &= inside | ~is_mirror[:, depth]
        point_m = np.where(inside[:, None], point_m + t[:, None] * towards, point_m)
    return reflects


def mirrored(point_m: NDArray[np.float64], corners_m: NDArray[np.float64]) -> NDArray[np.float64]:
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    squared = np.einsum("cx,cx->c", normal, normal)
    height = np.einsum("cx,cx->c", normal, point_m - corners_m[:, 0]) / np.where(squared > 0, squared, 1)
    return point_m - 2 * height[:, None] * normal
