"""The sequences of mirrors that can matter in a scene, which rays that branch find, and the trie of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.tracing.image.kernels.arrays import NUM_CHUNKS, Aperture, Facets
from xfreqbench.tracing.image.kernels.compiled import on_threads
from xfreqbench.tracing.image.kernels.sequences import Shots, Trie, joined, shot
from xfreqbench.tracing.image.surfaces import MirrorPlanes
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray


def sequences_of(
    facets: Facets,
    num_planes: int,
    origins_m: Float[FloatArray, "O 3"],
    settings: TraceSettings,
    max_reflections: int | None,
) -> tuple[Int[IntArray, "N"], Int[IntArray, "N"]]:
    """Parent and last plane of the sequences that rays from the origins are reflected at, parents first.

    The empty one, the line of sight, is first, with −1 for both. Where `max_reflections` are few, they are all
    sequences of so many.
    """
    most = min(settings.max_depth, settings.max_depth if max_reflections is None else max_reflections)
    if not num_planes or not most or "specular" not in settings.named_interactions:
        return np.array([-1]), np.array([-1])
    if most < settings.max_depth and num_planes**most <= settings.rays:
        return _all_sequences(num_planes, most)
    rng = np.random.default_rng(settings.seed)
    turn_rad = rng.uniform(0, 2 * np.pi, len(origins_m))
    num_rays = max(1, settings.rays // len(origins_m))
    shots = Shots(origins_m, turn_rad, num_rays, settings.max_depth, num_planes)
    found = on_threads(lambda chunk: shot(facets, shots, chunk), NUM_CHUNKS * len(origins_m), "shooting rays")
    parent, plane = np.divmod(joined(np.concatenate(found), num_planes, most), num_planes)
    parent[0] = plane[0] = -1
    return parent, plane


def _all_sequences(num_planes: int, most: int) -> tuple[Int[IntArray, "N"], Int[IntArray, "N"]]:
    """Every sequence of at most so many planes, none of them twice in a row, by parent and last plane."""
    parents, planes, first = [np.array([-1])], [np.array([-1])], 0
    for _ in range(most):
        before = planes[-1]
        parent = np.repeat(np.arange(first, first + len(before)), num_planes)
        plane = np.tile(np.arange(num_planes), len(before))
        is_other = plane != np.repeat(before, num_planes)
        first += len(before)
        parents.append(parent[is_other])
        planes.append(plane[is_other])
    return np.concatenate(parents), np.concatenate(planes)


def trie_of(
    parent: Int[IntArray, "N"],
    plane: Int[IntArray, "N"],
    mirrors: MirrorPlanes,
    receiver_m: Float[FloatArray, "3"],
    aperture: Aperture,
) -> Trie:
    """The trie of sequences of mirrors that are given by parent and last plane, parents first."""
    num_planes, radius_m = len(mirrors.planes), aperture.radius_m
    length, image_m = np.zeros(len(parent), np.int64), np.tile(receiver_m, (len(parent), 1))
    corner_m = np.tile(aperture.corner_m[0], (len(parent), 1, 1))  # of the widest aperture, from the image
    place_m = np.zeros((len(parent), 8))
    rows = np.flatnonzero(parent == 0)
    while len(rows):
        length[rows] = length[parent[rows]] + 1
        normal, offset_m = mirrors.planes[plane[rows], :3], mirrors.planes[plane[rows], 3]
        apex_m = image_m[parent[rows]]
        height_m = np.einsum("nc,nc->n", apex_m, normal) - offset_m
        image_m[rows] = apex_m - 2 * height_m[:, None] * normal
        place_m[rows, :3] = np.einsum("nac,nc->na", mirrors.axis[plane[rows]], image_m[rows])
        place_m[rows, 2] -= offset_m
        along_normal = np.einsum("nkc,nc->nk", corner_m[parent[rows]], normal)
        corner_m[rows] = corner_m[parent[rows]] - 2 * along_normal[:, :, None] * normal[:, None]
        place_m[rows, 7] = np.abs(along_normal).max(axis=1) + 1e-9 if radius_m < 1e30 else 1e30
        before = parent[rows]
        place_m[rows, 3:7] = _shone_on(place_m[before], plane[before], plane[rows], apex_m, mirrors, radius_m)
        is_parent = np.zeros(len(parent), dtype=bool)
        is_parent[rows] = True
        rows = np.flatnonzero((parent > 0) & is_parent[parent])
    order = np.lexsort((np.arange(len(plane)), plane))
    renumbered = np.argsort(order)
    return Trie(
        parent=np.where(parent < 0, -1, renumbered[parent])[order],
        plane=plane[order],
        length=length[order],
        image_m=image_m[order],
        place_m=place_m[order],
        first=np.searchsorted(plane[order], np.arange(num_planes + 1)),
        axis=mirrors.axis,
        offset_m=mirrors.planes[:, 3].copy(),
        radius_m=radius_m,
    )


def _shone_on(
    parent_m: Float[FloatArray, "n 8"],
    parent_plane: Int[IntArray, "n"],
    plane: Int[IntArray, "n"],
    apex_m: Float[FloatArray, "n 3"],
    mirrors: MirrorPlanes,
    radius_m: float,
) -> Float[FloatArray, "n 4"]:
    """Lowest and highest u, lowest and highest v on each plane that its parent's image shines on through its window.

    The window is what the parent is shone on itself. Where it does not lie between image and plane as a whole, it is
    the whole rectangle of mirrors. Images of elements within `radius_m` of the array centre are allowed for.
    """
    whole = np.stack([mirrors.low_m[plane], mirrors.high_m[plane]], axis=2).reshape(-1, 4)
    if not len(plane) or parent_plane[0] < 0 or radius_m > 1e6:
        return whole
    window = parent_m[:, [[3, 5], [4, 5], [3, 6], [4, 6]]]
    axis = mirrors.axis[parent_plane]
    corner_m = np.einsum("nka,nac->nkc", window, axis[:, :2])
    corner_m += (mirrors.planes[parent_plane, 3, None] * axis[:, 2])[:, None]
    normal, offset_m = mirrors.planes[plane, :3], mirrors.planes[plane, 3]
    here = np.einsum("nc,nc->n", apex_m, normal) - offset_m
    there = np.einsum("nkc,nc->nk", corner_m, normal) - offset_m[:, None]
    is_between = (here[:, None] * there > 0) & (np.abs(there) < np.abs(here)[:, None])
    apart_m, below_m = np.abs(here)[:, None] - np.abs(there), np.abs(there)
    is_between &= apart_m > 2 * radius_m
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = here[:, None] / (here[:, None] - there)
        point_m = apex_m[:, None] + stretch[:, :, None] * (corner_m - apex_m[:, None])
        way_m = np.linalg.norm(corner_m - apex_m[:, None], axis=2)
        along_m = np.sqrt(np.clip(way_m**2 - apart_m**2, 0, None))
        # of stretch − 1, for an element whose image is lower by the radius
        most = below_m / (apart_m - radius_m)
        margin_m = ((most - below_m / apart_m) * along_m + most * radius_m).max(axis=1) + 1e-6
        spot_m = np.einsum("nkc,nac->nka", point_m, mirrors.axis[plane][:, :2])
        low_m = np.maximum(whole[:, [0, 2]], spot_m.min(axis=1) - margin_m[:, None])
        high_m = np.minimum(whole[:, [1, 3]], spot_m.max(axis=1) + margin_m[:, None])
    lit = np.stack([low_m, high_m], axis=2).reshape(-1, 4)
    return np.where(is_between.all(axis=1)[:, None], lit, whole)
