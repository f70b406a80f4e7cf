"""Which surfaces of a scene found planes show: directly, or as an image in another found plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from xfreqbench.angles import FloatArray
from xfreqbench.facets import PlanarFacet, group_by_plane
from xfreqbench.findings import Findings, FoundPlane, TrueSlab
from xfreqbench.mesh import SurfaceMesh, sees

MATCH_DISTANCE_M = 0.05  # a found plane further from every surface shows none of them
MATCH_TILT_RAD = float(np.radians(2))
_MIN_SHARE = 0.01  # of a found plane: a surface with less of it is not named
_TOWARDS_ARRAY = 1e-6  # of the way: a point on a surface is not hidden by that surface
_ON_PLANE_M = 1e-6


@dataclass(frozen=True, eq=False)
class ScenePlane:
    """All facets of a scene that lie in one plane: its unit normal points away from the array centre."""

    normal: Float[FloatArray, "3"]
    distance_m: float
    facets: tuple[PlanarFacet, ...]

    @property
    def areas_m2(self) -> Float[FloatArray, "q"]:
        """Of the facets."""
        return np.array([_area_m2(facet.corners_m) for facet in self.facets])

    @property
    def area_m2(self) -> float:
        """Of all facets."""
        return float(self.areas_m2.sum())

    @property
    def surfaces(self) -> tuple[int, ...]:
        """Indices of the surfaces that the facets belong to."""
        return tuple(dict.fromkeys(facet.surface for facet in self.facets))


@dataclass(frozen=True, eq=False)
class Match:
    """The facets that a found plane shows, and how far it is from them.

    `share` sums to 1 over the plane's facets. `distance_error_m` is taken along the true normal, positive
    beyond the surface, where a shown facet is nearest to the foot of the perpendicular from the array.
    `mirror` is the found plane that shows the facets' image, None where it is them themselves.
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
        """What the surfaces shown are made of, with shares that sum to 1."""
        shares: dict[TrueSlab, float] = {}
        for facet, share in zip(self.plane.facets, self.share.tolist(), strict=True):
            mesh = meshes[facet.surface]
            slab = mesh.material, mesh.thickness_m
            shares[slab] = shares.get(slab, 0.0) + share
        return shares


def scene_planes(facets: Sequence[PlanarFacet], array_m: Float[FloatArray, "3"]) -> list[ScenePlane]:
    """The distinct planes of facets, as seen from the array centre."""
    planes, plane = group_by_plane(facets)
    found = []
    for index, (*normal, offset_m) in enumerate(planes.tolist()):
        distance_m = offset_m - float(np.dot(normal, array_m))
        sign = -1.0 if distance_m < 0 else 1.0
        own = tuple(facets[i] for i in np.flatnonzero(plane == index).tolist())
        found.append(ScenePlane(sign * np.array(normal), sign * distance_m, own))
    return found


def compare(findings: Findings, planes: Sequence[ScenePlane]) -> list[Match | None]:
    """What each found plane shows: a plane of the scene, else the image of one in a plane that is one, or None.

    A match is within `MATCH_DISTANCE_M` and `MATCH_TILT_RAD` and meets the found plane's rectangle; of
    several the nearest is taken.
    """
    array_m = findings.array_m
    facets = [facet for plane in planes for facet in plane.facets]
    direct = [_nearest(found, array_m, planes) for found in findings.planes]
    images = [
        (index, scene_planes(_mirrored(facets, match.plane, array_m), array_m))
        for index, match in enumerate(direct)
        if match
    ]
    return [
        match or _nearest_image(found, array_m, images)
        for found, match in zip(findings.planes, direct, strict=True)
    ]


def not_found(matches: Sequence[Match | None], planes: Sequence[ScenePlane]) -> list[ScenePlane]:
    """Planes of the scene, as `compare` got them, that no found plane shows; the largest first."""
    shown = [match.plane for match in matches if match]
    missing = [plane for plane in planes if not any(plane is each for each in shown)]
    return sorted(missing, key=lambda plane: -plane.area_m2)


def share_in_sight(
    plane: ScenePlane, meshes: Sequence[SurfaceMesh], array_m: Float[FloatArray, "3"]
) -> float:
    """Share of points on a plane's facets, their centres and places near their corners, that the array sees."""
    corners_m = [facet.corners_m for facet in plane.facets]
    points_m = np.concatenate([np.vstack([c.mean(0), c.mean(0) + 0.8 * (c - c.mean(0))]) for c in corners_m])
    return float(sees(meshes, points_m + _TOWARDS_ARRAY * (array_m - points_m), array_m).mean())


def _area_m2(corners_m: Float[FloatArray, "n 3"]) -> float:
    doubled = np.linalg.norm(np.cross(corners_m[1] - corners_m[0], corners_m[-1] - corners_m[0]))
    return float(doubled if len(corners_m) == 4 else doubled / 2)


def _nearest(
    found: FoundPlane,
    array_m: Float[FloatArray, "3"],
    planes: Sequence[ScenePlane],
    mirror: int | None = None,
) -> Match | None:
    matches = [match for plane in planes if (match := _match(found, array_m, plane, mirror))]
    return min(matches, key=lambda match: abs(match.distance_error_m), default=None)


def _nearest_image(
    found: FoundPlane, array_m: Float[FloatArray, "3"], images: Sequence[tuple[int, list[ScenePlane]]]
) -> Match | None:
    matches = [_nearest(found, array_m, planes, mirror) for mirror, planes in images]
    return min(filter(None, matches), key=lambda match: abs(match.distance_error_m), default=None)


def _match(
    found: FoundPlane, array_m: Float[FloatArray, "3"], plane: ScenePlane, mirror: int | None
) -> Match | None:
    cosine = float(found.unit_normal @ plane.normal)
    tilt_rad = float(np.arctan2(np.linalg.norm(np.cross(found.unit_normal, plane.normal)), cosine))
    share = _shares(found, plane) if tilt_rad <= MATCH_TILT_RAD else np.zeros(0)
    if not share.any():
        return None
    foot_m = array_m + plane.distance_m * plane.normal
    shown = [facet for facet, weight in zip(plane.facets, share, strict=True) if weight]
    points_m = np.array([_nearest_point(facet.corners_m, plane.normal, foot_m) for facet in shown])
    point_m = points_m[np.linalg.norm(points_m - foot_m, axis=1).argmin()]
    error_m = (found.distance_m - float(found.unit_normal @ (point_m - array_m))) / cosine
    return Match(plane, share, error_m, tilt_rad, mirror) if abs(error_m) <= MATCH_DISTANCE_M else None


def _shares(found: FoundPlane, plane: ScenePlane) -> Float[FloatArray, "q"]:
    """Share of each facet in what the found plane's rectangle shows of them; all zero where it shows none.

    Without a rectangle, or where it has no area, facets within reach count by their own areas.
    """
    areas_m2 = plane.areas_m2
    if found.corners_m is not None:
        axes = _axes_in(found.unit_normal)
        held_m = np.array(found.corners_m) @ axes.T
        facets_m = [facet.corners_m @ axes.T for facet in plane.facets]
        common_m = np.array([_common_extent_m(held_m, facet_m) for facet_m in facets_m])
        full_m = np.array([np.ptp(facet_m, axis=0) for facet_m in facets_m])
        shown = (common_m.clip(0) / full_m).prod(axis=1)
        is_near = (common_m > -MATCH_DISTANCE_M).all(axis=1)
        areas_m2 = areas_m2 * (shown if shown.any() else is_near)
    return areas_m2 / (areas_m2.sum() or 1.0)


def _axes_in(normal: Float[FloatArray, "3"]) -> Float[FloatArray, "2 3"]:
    """Axes within a plane, the first level, or along the world's x where the plane is: those of `corners_m`."""
    level = np.cross((0.0, 0.0, 1.0), normal)
    first = level if np.linalg.norm(level) > 0.1 else np.array([1.0, 0, 0]) - normal[0] * normal
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _common_extent_m(
    first_m: Float[FloatArray, "m 2"], second_m: Float[FloatArray, "n 2"]
) -> Float[FloatArray, "2"]:
    """Overlap of two bounding boxes along each axis; negative where a gap is between them."""
    high_m, low_m = np.minimum(first_m.max(0), second_m.max(0)), np.maximum(first_m.min(0), second_m.min(0))
    return high_m - low_m


def _nearest_point(
    corners_m: Float[FloatArray, "n 3"], normal: Float[FloatArray, "3"], point_m: Float[FloatArray, "3"]
) -> Float[FloatArray, "3"]:
    """Point of a convex facet that is nearest to a point of its plane."""
    edges_m = np.roll(corners_m, -1, axis=0) - corners_m
    side = np.cross(edges_m, point_m - corners_m) @ normal
    if (side >= 0).all() or (side <= 0).all():
        return point_m
    along = np.einsum("ni,ni->n", point_m - corners_m, edges_m) / np.einsum("ni,ni->n", edges_m, edges_m)
    on_edges_m = corners_m + along.clip(0, 1)[:, None] * edges_m
    return on_edges_m[np.linalg.norm(on_edges_m - point_m, axis=1).argmin()]


def _mirrored(
    facets: Sequence[PlanarFacet], mirror: ScenePlane, array_m: Float[FloatArray, "3"]
) -> list[PlanarFacet]:
    """Images of the facets on the array's side of a plane, where the array sees them: behind it."""
    images = []
    for corners_m, surface in facets:
        beyond_m = (corners_m - array_m) @ mirror.normal - mirror.distance_m
        if (beyond_m < _ON_PLANE_M).all() and (beyond_m < -_ON_PLANE_M).any():
            images.append(PlanarFacet(corners_m - 2 * beyond_m[:, None] * mirror.normal, surface))
    return images
