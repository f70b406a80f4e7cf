"""Diffuse reflection of first order at rough facets, before or after at most one mirror, for the image solver.

Rough facets are divided into tiles, the finer the nearer they are to the array. How the array sees them is found once,
how a transmitter does for each. The tiles and their random phases depend on the scene, the array and the seed alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import binom

from xfreqbench.errors import SceneError
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import Scattering
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing.image.kernels.arrays import CentrePath, Media, SceneArrays, Sums
from xfreqbench.tracing.image.kernels.diffuse import (
    DiffuseContext,
    Roughness,
    Tiles,
    Views,
    Windows,
    add_diffuse,
    diffuse_paths,
    find_views,
    responses,
)
from xfreqbench.tracing.image.surfaces import MirrorPlanes
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray

LEAST_TILE_M = 0.02
MAX_TILES = 1_000_000  # which take some gigabytes


class DiffuseReflection:
    """The rough facets of one scene and how its array sees them, ready for any transmitter.

    `slabs` are the kinds of slabs, `surface` and `corners_m` the mesh and the corners of the kernels' facets. The lanes
    of `media` are its carriers. The sides of tiles are at most `tile_m`, and `tile_rad` seen from the array.
    """

    def __init__(
        self,
        scene: SceneArrays,
        media: Media,
        slabs: Sequence[Slab],
        mirrors: MirrorPlanes,
        surface: Int[IntArray, "Q"],
        corners_m: Float[FloatArray, "Q 4 3"],
        receiver: ReceiverArray,
        settings: TraceSettings,
        most_mirrors: int,
        tile_m: float,
        tile_rad: float,
    ) -> None:
        facets, self._scene, self._surface, self._depth = scene.facets, scene, surface, settings.max_depth
        self._receiver_m = np.array(receiver.position_m, dtype=np.float64)
        element = receiver.element_position_wavelengths
        diameter = 2 * float(np.linalg.norm(element - element.mean(axis=0), axis=1).max())
        # a tile's side, seen from the array, is 0.3 of its beamwidth: one over its diameter in wavelengths
        tile_rad = min(tile_rad, 0.3 / max(diameter, 1e-9))
        scattering = [slab.scattering for slab in slabs]
        is_rough = np.array([pattern is not None for pattern in scattering], bool)
        rough = np.flatnonzero(is_rough[facets.slab])
        windows = Windows(mirrors.axis, mirrors.low_m, mirrors.high_m)
        self._rooms = []
        for num_mirrors in range(1 + min(most_mirrors, settings.max_depth - 1)):
            coarser = 4.0 if num_mirrors else 1.0  # for there are many paths over a mirror for each tile
            whole, sides_m = rough, corners_m[rough, :3].copy()
            sides_m[:, 1:] -= sides_m[:, :1]
            whole, sides_m = _divided(
                whole, sides_m, facets.is_triangle, self._receiver_m, coarser * tile_m, coarser * tile_rad
            )
            turns = np.random.default_rng([settings.seed, num_mirrors]).uniform(size=len(whole))
            tiles = Tiles(_middles_m(sides_m, facets.is_triangle[whole]), sides_m, whole, turns)
            seen = find_views(facets, windows, tiles, self._receiver_m, self._depth, num_mirrors)
            tile, plane = np.nonzero(seen)
            at = responses(facets, media, windows, tiles, tile, plane - 1, self._receiver_m, self._depth)
            views = Views(np.searchsorted(tile, np.arange(len(whole) + 1)), plane - 1, *at)
            self._rooms.append(DiffuseContext(facets, media, roughness_of(scattering), windows, tiles, views))

    def in_scene(self, scene: SceneArrays, media: Media) -> DiffuseReflection:
        """The same tiles in a scene that differs in its antennas alone; the lanes of `media` are its carriers."""
        other = copy(self)
        other._scene, other._rooms = scene, []
        for room in self._rooms:
            views = room.views
            tile = np.repeat(np.arange(len(room.tiles.facet)), np.diff(views.first))
            at = responses(
                room.facets, media, room.windows, room.tiles, tile, views.plane, self._receiver_m, self._depth
            )
            other._rooms.append(room._replace(media=media, views=Views(views.first, views.plane, *at)))
        return other

    def add_channel(self, tx_m: Float[FloatArray, "3"], sums: Sums, num_paths: NDArray[np.int32]) -> None:
        """Add the channel (F, M) of a transmitter's diffuse paths, and their number."""
        for num_mirrors, room in enumerate(self._rooms):
            add_diffuse(self._scene, room, tx_m, self._depth, num_mirrors, sums, num_paths)

    def paths(self, tx_m: Float[FloatArray, "3"]) -> list[CentrePath]:
        """The paths to the array's centre that `add_channel` adds."""
        found = list[CentrePath]()
        for num_mirrors, room in enumerate(self._rooms):
            found += diffuse_paths(room, self._surface, tx_m, self._receiver_m, self._depth, num_mirrors)
        return found


def _divided(
    facet: Int[IntArray, "n"],
    sides_m: Float[FloatArray, "n 3 3"],
    is_triangle: Bool[NDArray[np.bool_], "Q"],
    receiver_m: Float[FloatArray, "3"],
    tile_m: float,
    tile_rad: float,
) -> tuple[Int[IntArray, "N"], Float[FloatArray, "N 3 3"]]:
    """Facet of each tile, and its sides: a corner, and the two sides from there.

    Facets are halved across their longest side until it is at most `tile_m`, and `tile_rad` times the distance of the
    array, but no shorter than `LEAST_TILE_M`.
    """
    done: list[tuple[IntArray, FloatArray]] = []
    while len(facet):
        triangle = is_triangle[facet]
        corner, u, v = sides_m.swapaxes(0, 1)
        length_m = np.linalg.norm([u, v, np.where(triangle[:, None], v - u, 0)], axis=2)
        longest = length_m.argmax(axis=0)
        # the longest side becomes u
        turned = [(corner, u, v), (corner, v, u), (corner + u, v - u, -u)]
        sides_m = np.choose(longest[:, None, None], [np.stack(parts, axis=1) for parts in turned])
        reach_m = np.linalg.norm(u, axis=1) + np.linalg.norm(v, axis=1)
        away_m = np.linalg.norm(_middles_m(sides_m, triangle) - receiver_m, axis=1) - reach_m / 2
        is_small = length_m.max(axis=0) <= np.clip(tile_rad * away_m, LEAST_TILE_M, tile_m)
        done.append((facet[is_small], sides_m[is_small]))
        facet, sides_m, triangle = facet[~is_small], sides_m[~is_small], triangle[~is_small]
        half = sides_m[:, 1] / 2
        near, far = sides_m.copy(), sides_m.copy()
        near[:, 1] = far[:, 1] = half
        far[:, 0] += half
        far[triangle, 2] -= half[triangle]
        facet, sides_m = np.concatenate([facet, facet]), np.concatenate([near, far])
        if len(facet) + sum(len(of) for of, _ in done) > MAX_TILES:
            raise SceneError(
                f"The scene's rough surfaces are divided into more than {MAX_TILES:,} tiles. Let fewer of them scatter."
            )
    facets, sides = zip((facet, sides_m), *done, strict=True)
    return np.concatenate(facets), np.concatenate(sides)


def _middles_m(sides_m: Float[FloatArray, "n 3 3"], is_triangle: Bool[NDArray[np.bool_], "n"]) -> FloatArray:
    """The centroid (n, 3) of each tile."""
    part = np.where(is_triangle, 3, 2)[:, None]
    return np.asarray(sides_m[:, 0] + (sides_m[:, 1] + sides_m[:, 2]) / part)


def roughness_of(scattering: Sequence[Scattering | None]) -> Roughness:
    """How kinds of slabs scatter, smooth ones not at all."""
    rough = [pattern or Scattering(0.0) for pattern in scattering]
    alpha = np.array([[pattern.alpha_r or 0, pattern.alpha_i or 0] for pattern in rough]).reshape(-1, 2)
    share = np.array([1.0 if pattern.lambda_ is None else pattern.lambda_ for pattern in rough])
    norm = np.zeros((len(rough), 2 + alpha.max(initial=0) // 2))
    for row, lobes, first in zip(norm, alpha.tolist(), share, strict=True):
        for part, integral in zip((first, 1 - first), map(_lobe_integral, lobes), strict=True):
            row[: len(integral)] += part * integral
    kept = np.array([[1 - pattern.xpd_coefficient, pattern.xpd_coefficient] for pattern in rough]).reshape(-1, 2)
    coefficient = np.array([pattern.coefficient for pattern in rough])
    return Roughness(coefficient[:, None] * np.sqrt(kept), alpha.astype(float), share, norm)


def _lobe_integral(alpha: int) -> FloatArray:
    """Coefficients of ∫ ((1 + cos ψ)/2)^α over the half-space, as `Roughness.norm` has them (Degli-Esposti, Eq. 21)."""
    order = np.arange(alpha + 1)
    term = binom(alpha, order) / 2.0**alpha * 2 * np.pi / (order + 1)
    odd = term[1::2]
    of_sine = [binom(2 * m, m) / 4.0**m * odd[m:].sum() for m in range(len(odd))]
    return np.array([term[::2].sum(), *of_sine])
