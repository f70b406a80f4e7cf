"""Specular chains: the sequences of reflections and transmissions that rays from the receiver run through.

The planes that a path is reflected at fix its geometry; what it is transmitted through does not bend it. So a
chain is a sequence of planes, with transmissions in between, and is found once for every transmitter,
carrier and array element. Sionna's own generator keeps its chains in a hash table for each target: it loses
some to collisions, and which ones depends on the order of threads and on the other targets. The tree of
chains here loses none, and depends on neither.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt
from scipy.spatial import cKDTree

from xfreqbench.scene.materials import MaterialPolicy, complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh, triangle_corners_m
from xfreqbench.scene.patches import PLANE_TOLERANCE, components
from xfreqbench.scene.visibility import fibonacci_sphere
from xfreqbench.system.bars import report
from xfreqbench.tracing.paths import NO_INTERACTION, REFRACTION, SPECULAR
from xfreqbench.tracing.sionna.scene import RadioScene, dr, mi, point3f
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

OPAQUE_DB = 100.0  # a slab that absorbs more than this at every carrier only reflects; the image solver waits for
# 120 dB, because its rays branch, and none is lost to a slab that passes nothing


@dataclass(frozen=True)
class Planes:
    """The plane of each of a scene's K triangles, meshes in order: unit normal n, offset n·p, and an index.

    Coplanar triangles have the same index.
    """

    normal: Float[FloatArray, "K 3"]
    offset_m: Float[FloatArray, "K"]
    index: Int[IntArray, "K"]

    def mirrored(self, triangle: Int[IntArray, "C"], point_m: Float[FloatArray, "C 3"]) -> Float[FloatArray, "C 3"]:
        """Mirror image of each point in the plane of its triangle."""
        normal = self.normal[triangle]
        height_m = np.einsum("ca,ca->c", normal, point_m) - self.offset_m[triangle]
        return point_m - 2 * height_m[:, None] * normal


def planes_of(meshes: Sequence[SurfaceMesh]) -> Planes:
    """Planes of the triangles of all meshes, in double precision."""
    corners_m = triangle_corners_m(meshes)
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offset_m = np.einsum("kc,kc->k", normal, corners_m[:, 0])
    return Planes(normal, offset_m, _coplanar(normal, offset_m))


def _coplanar(normal: Float[FloatArray, "K 3"], offset_m: Float[FloatArray, "K"]) -> Int[IntArray, "K"]:
    """Index of each plane. Planes are compared by n nᵀ and their foot point, which do not depend on n's sign."""
    if len(normal) == 0:
        return np.zeros(0, dtype=np.int64)
    projector = np.einsum("ka,kb->kab", normal, normal).reshape(-1, 9)
    signless = np.hstack([projector, offset_m[:, None] * normal])
    distinct, of_distinct = np.unique(np.round(signless, 9) + 0.0, axis=0, return_inverse=True)
    near = cKDTree(distinct).query_pairs(PLANE_TOLERANCE, output_type="ndarray")
    return components(near[:, 0], near[:, 1], len(distinct))[of_distinct]


@dataclass(frozen=True)
class Chains:
    """N chains of at most D interactions, from the receiver on, and H points at which rays ended them.

    Chain 0 is the empty one, the line of sight. `interaction` is padded with `NO_INTERACTION`. `triangle` and
    `vertex_m` are those of the first ray that ran the chain. `hit_m` is the last point of a ray on chain
    `hit_chain`, and `hit_side` the surface's normal on the side to which the ray went on. At most
    256 points are kept of each chain.
    """

    interaction: UInt[NDArray[np.uint32], "N D"]
    triangle: Int[IntArray, "N D"]
    vertex_m: Float[NDArray[np.float32], "N D 3"]
    hit_m: Float[NDArray[np.float32], "H 3"]
    hit_side: Float[NDArray[np.float32], "H 3"]
    hit_chain: UInt[NDArray[np.uint32], "H"]

    def receiver_images(
        self, chain: Int[IntArray, "C"], planes: Planes
    ) -> tuple[Float[FloatArray, "C 3 3"], Float[FloatArray, "C 3"]]:
        """Rotation R and shift t in metres of each given chain: a receiver at r has its image at R r + t."""
        rotation = np.broadcast_to(np.eye(3), (len(chain), 3, 3)).copy()
        shift_m = np.zeros((len(chain), 3))
        for depth in range(self.interaction.shape[1]):
            rows = np.flatnonzero(self.interaction[chain, depth] == SPECULAR)
            triangle = self.triangle[chain[rows], depth]
            normal = planes.normal[triangle]
            along = np.einsum("ca,cab->cb", normal, rotation[rows])
            rotation[rows] -= 2 * normal[:, :, None] * along[:, None, :]
            shift_m[rows] = planes.mirrored(triangle, shift_m[rows])
        return rotation, shift_m


def opaque_meshes(
    meshes: Sequence[SurfaceMesh], carrier_hz: Sequence[float], policy: MaterialPolicy
) -> Bool[NDArray[np.bool_], "S"]:
    """Whether each mesh absorbs more than `OPAQUE_DB` at every carrier, as metal does."""

    def absorption_db(mesh: SurfaceMesh, carrier: float) -> float:
        """Loss of one straight passage through the slab, without its two faces."""
        index = np.sqrt(complex_permittivity(mesh.slab.homogeneous, carrier, policy))
        neper = -index.imag * 2 * np.pi * carrier / SPEED_OF_LIGHT_M_S * mesh.thickness_m
        return float(20 * np.log10(math.e) * neper)

    return np.array([min(absorption_db(mesh, f) for f in carrier_hz) > OPAQUE_DB for mesh in meshes], dtype=bool)


def shoot(
    radio_scene: RadioScene,
    planes: Planes,
    origins_m: Float[FloatArray, "O 3"],
    opaque: Bool[NDArray[np.bool_], "S"],
    mirrors: Bool[NDArray[np.bool_], "K"],
    settings: TraceSettings,
) -> Chains:
    """Chains of `settings.rays` rays, divided among the origins; the same seed gives the same chains.

    Rays are reflected by triangles that mirror alone; what does not mirror and is opaque ends them.
    """
    first_triangle = np.cumsum([0, *(len(mesh.triangles) for mesh in radio_scene.meshes)])[:-1]
    tree = _ChainTree(planes, settings.rays, settings.max_depth, first_triangle)
    if {"specular", "refraction"} & set(settings.named_interactions) and radio_scene.meshes:
        _run_rays(radio_scene, origins_m, opaque, mirrors, settings, tree)
    return tree.chains()


def _run_rays(
    radio_scene: RadioScene,
    origins_m: FloatArray,
    opaque: NDArray[np.bool_],
    mirrors: NDArray[np.bool_],
    settings: TraceSettings,
    tree: _ChainTree,
) -> None:
    """Let the tree grow by the interactions of rays, all at once, one depth after another."""
    rng = np.random.default_rng(settings.seed)
    pointer = radio_scene.shape_pointer
    mesh_of_pointer = np.zeros(int(pointer.max()) + 1, dtype=np.int64)  # mesh 0 stands for what dead rays hit
    mesh_of_pointer[pointer] = np.arange(len(pointer))
    start_m = origins_m[np.arange(settings.rays) % len(origins_m)]
    ray = mi.Ray3f(point3f(start_m), mi.Vector3f(point3f(fibonacci_sphere(settings.rays))))
    active = dr.full(mi.Bool, True, settings.rays)
    for depth in range(settings.max_depth):
        report("shooting rays", depth, settings.max_depth)
        hit = radio_scene.mitsuba.ray_intersect(ray, ray_flags=mi.RayFlags.Minimal, coherent=False, active=active)
        active &= hit.is_valid()
        mesh = mesh_of_pointer[dr.reinterpret_array(mi.UInt, hit.shape).numpy() * active.numpy()]
        triangle = tree.first_triangle[mesh] + hit.prim_index.numpy() * active.numpy()
        is_mirror = mirrors[triangle]
        reflected = _choose_reflection(rng, opaque[mesh], settings) & is_mirror
        passes = ~opaque[mesh] & ("refraction" in settings.named_interactions)
        active &= mi.Bool(is_mirror | passes)
        direction = dr.select(mi.Bool(reflected), ray.d - 2 * dr.dot(ray.d, hit.n) * hit.n, ray.d)
        side = dr.select(dr.dot(direction, hit.n) > 0, hit.n, -hit.n)
        tree.grow(active.numpy(), reflected, triangle, hit.p.numpy().T, side.numpy().T)
        ray = hit.spawn_ray(direction)
        dr.eval(ray, active)


def _choose_reflection(
    rng: np.random.Generator, opaque: NDArray[np.bool_], settings: TraceSettings
) -> NDArray[np.bool_]:
    """Whether each ray is reflected, by chance, or transmitted."""
    if "refraction" not in settings.named_interactions:
        return np.ones(len(opaque), dtype=bool)
    if "specular" not in settings.named_interactions:
        return np.zeros(len(opaque), dtype=bool)
    # of a ray at a slab, whatever the carrier, because chains serve all carriers
    return (rng.random(len(opaque)) < 0.5) | opaque


class _ChainTree:
    """The chains found so far, as a tree that grows by one interaction at a time."""

    def __init__(self, planes: Planes, num_rays: int, max_depth: int, first_triangle: IntArray) -> None:
        self.planes = planes
        self.first_triangle = first_triangle
        self.depth = 0
        self.interaction = np.full((1, max(1, max_depth)), NO_INTERACTION, dtype=np.uint32)
        self.triangle = np.zeros_like(self.interaction, dtype=np.int64)
        self.vertex_m = np.zeros((*self.interaction.shape, 3), dtype=np.float32)
        self.chain_of_ray = np.zeros(num_rays, dtype=np.int64)
        self.hits: list[tuple[NDArray[Any], ...]] = []

    def grow(
        self,
        active: NDArray[np.bool_],
        reflected: NDArray[np.bool_],
        hit_triangle: IntArray,
        hit_m: NDArray[np.float32],
        side: NDArray[np.float32],
    ) -> None:
        """Add the next interaction of every active ray: which triangle it hit, where, on which side."""
        ray = np.flatnonzero(active)
        parent, triangle = self.chain_of_ray[ray], hit_triangle[ray]
        event = np.where(reflected[ray], 1 + self.planes.index[triangle], 0)
        key = parent * (2 + self.planes.index.max()) + event
        _, first, branch = np.unique(key, return_index=True, return_inverse=True)
        self.chain_of_ray[ray] = len(self.interaction) + branch
        self._add(parent[first], reflected[ray[first]], triangle[first], hit_m[ray[first]])
        self.hits.append((hit_m[ray], side[ray], self.chain_of_ray[ray].astype(np.uint32)))

    def _add(
        self, parent: IntArray, reflected: NDArray[np.bool_], triangle: IntArray, vertex_m: NDArray[np.float32]
    ) -> None:
        """Add a chain to the tree for each given parent, with one interaction more."""
        interaction, triangles = self.interaction[parent], self.triangle[parent]
        vertices = self.vertex_m[parent]
        interaction[:, self.depth] = np.where(reflected, SPECULAR, REFRACTION)
        triangles[:, self.depth] = triangle
        vertices[:, self.depth] = vertex_m
        self.interaction = np.concatenate([self.interaction, interaction])
        self.triangle = np.concatenate([self.triangle, triangles])
        self.vertex_m = np.concatenate([self.vertex_m, vertices])
        self.depth += 1

    def chains(self) -> Chains:
        """All chains of the tree, and the points that are kept of each."""
        nothing = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.uint32)
        hit_m, side, chain = (np.concatenate(column) for column in zip(nothing, *self.hits, strict=True))
        # in a furnished office 256 points of a chain are as good as all of them, at a quarter of the cost
        kept = _evenly_thinned(chain, 256)
        return Chains(self.interaction, self.triangle, self.vertex_m, hit_m[kept], side[kept], chain[kept])


def _evenly_thinned(chain: UInt[NDArray[np.uint32], "H"], most: int) -> IntArray:
    """Indices that keep at most `most` points of each chain, spread evenly over its rays."""
    order = np.argsort(chain, kind="stable")
    number = np.bincount(chain)
    rank = np.arange(len(chain)) - (np.cumsum(number) - number)[chain[order]]
    among = np.maximum(number[chain[order]], most)
    is_kept = rank * most // among != (rank - 1) * most // among
    return np.sort(order[is_kept | (among == most)])
