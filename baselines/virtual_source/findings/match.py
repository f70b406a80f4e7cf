"""Matches found planes with a scene: the surfaces that each shows, directly or as an image in another found plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from xfreqbench.scene.facets import PlanarFacet, group_by_plane
from xfreqbench.scene.materials import Material
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.visibility import sees
from xfreqbench.types import FloatArray

from ..search.planes import Vector
from ..stored import FoundPlane, StoredFindings

MATCH_DISTANCE_M = 0.05  # a found plane further from every surface shows none of them
MATCH_TILT_RAD = float(np.radians(2))
_MIN_SHARE = 0.01  # a surface with a smaller share of a found plane is not named
_TOWARDS_ARRAY = (
    1e-6  # points on a surface move by this share of the way, so that it does not hide them itself
)
_ON_PLANE_M = 1e-6

TrueSlab = tuple[Material, float]  # a material, and the thickness in metres


@dataclass(frozen=True, eq=False)
class ScenePlane:
    """All facets of a scene that lie in one plane; `normal`, of length 1, points from the array centre to the plane."""

    normal: Vector
    distance_m: float
    facets: tuple[PlanarFacet, ...]

    @property
    def areas_m2(self) -> Float[FloatArray, "q"]:
        """Area of each facet."""
        areas_m2 = []
        for corners_m, _ in self.facets:
            doubled = np.linalg.norm(np.cross(corners_m[1] - corners_m[0], corners_m[-1] - corners_m[0]))
            areas_m2.append(doubled if len(corners_m) == 4 else doubled / 2)
        return np.array(areas_m2)

    @property
    def area_m2(self) -> float:
        """Area of all facets together."""
        return float(self.areas_m2.sum())

    @property
    def surfaces(self) -> tuple[int, ...]:
        """Indices of the surfaces that the facets belong to."""
        return tuple(dict.fromkeys(facet.surface for facet in self.facets))


@dataclass(frozen=True, eq=False)
class Match:
    """The facets that a found plane shows, and how far it is from them.

    `share` says how much of what is shown each of the plane's facets is; it sums to 1. `distance_error_m` is measured
    along the true normal, positive beyond the surface, at the shown facets' point that is nearest to the foot of the
    perpendicular from the array. `mirror` is the index of the found plane in which the facets are seen mirrored,
    None where they are seen directly.
    """

    plane: ScenePlane
    share: Float[FloatArray, "q"]
    distance_error_m: float
    tilt_error_rad: float
    mirror: int | None = None

    @property
    def surfaces(self) -> tuple[int, ...]:
        """Indices of the surfaces shown, the one with the largest share first."""
        shares: dict[int, float] = {}
        for facet, share in zip(self.plane.facets, self.share.tolist(), strict=True):
            shares[facet.surface] = shares.get(facet.surface, 0.0) + share
        named = [surface for surface, share in shares.items() if share >= _MIN_SHARE]
        return tuple(sorted(named, key=lambda surface: -shares[surface]))

    def slabs(self, meshes: Sequence[SurfaceMesh]) -> dict[TrueSlab, float]:
        """Material and thickness of the surfaces shown, with shares that sum to 1."""
        shares: dict[TrueSlab, float] = {}
        for facet, share in zip(self.plane.facets, self.share.tolist(), strict=True):
            mesh = meshes[facet.surface]
            slab = mesh.material, mesh.thickness_m
            shares[slab] = shares.get(slab, 0.0) + share
        return shares


def scene_planes(facets: Sequence[PlanarFacet], array_m: Vector) -> list[ScenePlane]:
    """The distinct planes in which facets lie, as seen from the array centre."""
    planes, plane = group_by_plane(facets)
    found = []
    for index, (*normal, offset_m) in enumerate(planes.tolist()):
        distance_m = offset_m - float(np.dot(normal, array_m))
        sign = -1.0 if distance_m < 0 else 1.0
        own = tuple(facets[i] for i in np.flatnonzero(plane == index).tolist())
        found.append(ScenePlane(sign * np.array(normal), sign * distance_m, own))
    return found


def compare(findings: StoredFindings, planes: Sequence[ScenePlane]) -> list[Match | None]:
    """What each found plane shows: a plane of the scene, or the mirror image of one, or nothing (None).

    An image counts only in a found plane that itself shows a plane of the scene. A match is within
    `MATCH_DISTANCE_M` and `MATCH_TILT_RAD` and meets the found plane's rectangle; of several, the nearest is taken.
    """
    array_m = findings.array_m
    facets = [facet for plane in planes for facet in plane.facets]
    direct = [_nearest(found, array_m, planes) for found in findings.planes]
    images = [
        (index, scene_planes(_mirrored(facets, match.plane, array_m), array_m))
        for index, match in enumerate(direct)
        if match
    ]
    matches = []
    for found, match in zip(findings.planes, direct, strict=True):
        mirrored = [_nearest(found, array_m, behind, mirror) for mirror, behind in images if not match]
        matches.append(match or min(filter(None, mirrored), key=_distance_of, default=None))
    return matches


def not_found(matches: Sequence[Match | None], planes: Sequence[ScenePlane]) -> list[ScenePlane]:
    """Those of the planes given to `compare` that no found plane shows, the largest first."""
    shown = [match.plane for match in matches if match]
    missing = [plane for plane in planes if not any(plane is each for each in shown)]
    return sorted(missing, key=lambda plane: -plane.area_m2)


def share_in_sight(plane: ScenePlane, meshes: Sequence[SurfaceMesh], array_m: Vector) -> float:
    """The share of a plane's facets that the array sees, judged by their centres and points near their corners."""
    corners_m = [facet.corners_m for facet in plane.facets]
    points_m = np.concatenate([np.vstack([c.mean(0), c.mean(0) + 0.8 * (c - c.mean(0))]) for c in corners_m])
    return float(sees(meshes, points_m + _TOWARDS_ARRAY * (array_m - points_m), array_m).mean())


def _nearest(
    found: FoundPlane, array_m: Vector, planes: Sequence[ScenePlane], mirror: int | None = None
) -> Match | None:
    matches = [match for plane in planes if (match := _match(found, array_m, plane, mirror))]
    return min(matches, key=_distance_of, default=None)


def _distance_of(match: Match) -> float:
    return abs(match.distance_error_m)


def _match(found: FoundPlane, array_m: Vector, plane: ScenePlane, mirror: int | None) -> Match | None:
    cosine = float(found.unit_normal @ plane.normal)
    tilt_rad = float(np.arctan2(np.linalg.norm(np.cross(found.unit_normal, plane.normal)), cosine))
    share = _shares(found, plane) if tilt_rad <= MATCH_TILT_RAD else np.zeros(0)
    if not share.any():
        return None
    foot_m = array_m + plane.distance_m * plane.normal
    shown = [facet for facet, weight in zip(plane.facets, share, strict=True) if weight]
    points_m = np.array([nearest_point(facet.corners_m, plane.normal, foot_m) for facet in shown])
    point_m = points_m[np.linalg.norm(points_m - foot_m, axis=1).argmin()]
    error_m = (found.distance_m - float(found.unit_normal @ (point_m - array_m))) / cosine
    return Match(plane, share, error_m, tilt_rad, mirror) if abs(error_m) <= MATCH_DISTANCE_M else None


def _shares(found: FoundPlane, plane: ScenePlane) -> Float[FloatArray, "q"]:
    """The share that each facet has in what the found plane's rectangle shows of all; zeros where it shows none.

    A found plane without a rectangle shows every facet by its area; where the rectangle has no area in common
    with any facet, the facets within `MATCH_DISTANCE_M` of it count by theirs.
    """
    areas_m2 = plane.areas_m2
    if found.corners_m is not None:
        axes = axes_within(found.unit_normal)
        held_m = np.array(found.corners_m) @ axes.T
        low_m, high_m = held_m.min(0), held_m.max(0)
        facets_m = [facet.corners_m @ axes.T for facet in plane.facets]
        common_m = np.array([np.minimum(high_m, f.max(0)) - np.maximum(low_m, f.min(0)) for f in facets_m])
        full_m = np.array([np.ptp(facet_m, axis=0) for facet_m in facets_m])
        shown = (common_m.clip(0) / full_m).prod(axis=1)
        is_near = (common_m > -MATCH_DISTANCE_M).all(axis=1)
        areas_m2 = areas_m2 * (shown if shown.any() else is_near)
    return areas_m2 / (areas_m2.sum() or 1.0)


def axes_within(normal: Vector) -> Float[FloatArray, "2 3"]:
    """Two unit vectors within a plane: the first is level, or points along the world's x where the plane is level.

    The rectangles of findings lie along these axes. The virtual-source method, which writes them, computes the axes
    in torch (`Mirrors.of_tensors`), and torch rounds cross products otherwise than NumPy; a test compares the two.
    """
    level = np.cross((0.0, 0.0, 1.0), normal)
    first = level if np.linalg.norm(level) > 0.1 else np.array([1.0, 0, 0]) - normal[0] * normal
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def nearest_point(corners_m: Float[FloatArray, "n 3"], normal: Vector, point_m: Vector) -> Vector:
    """The point of a convex facet that is nearest to a point of the facet's plane."""
    edges_m = np.roll(corners_m, -1, axis=0) - corners_m
    side = np.cross(edges_m, point_m - corners_m) @ normal
    if (side >= 0).all() or (side <= 0).all():
        return point_m
    along = np.einsum("ni,ni->n", point_m - corners_m, edges_m) / np.einsum("ni,ni->n", edges_m, edges_m)
    on_edges_m = corners_m + along.clip(0, 1)[:, None] * edges_m
    return on_edges_m[np.linalg.norm(on_edges_m - point_m, axis=1).argmin()]


def _mirrored(facets: Sequence[PlanarFacet], mirror: ScenePlane, array_m: Vector) -> list[PlanarFacet]:
    """The facets on the array's side of a plane, moved to where the array sees their mirror images: behind it."""
    images = []
    for corners_m, surface in facets:
        beyond_m = (corners_m - array_m) @ mirror.normal - mirror.distance_m
        if (beyond_m < _ON_PLANE_M).all() and (beyond_m < -_ON_PLANE_M).any():
            images.append(PlanarFacet(corners_m - 2 * beyond_m[:, None] * mirror.normal, surface))
    return images
