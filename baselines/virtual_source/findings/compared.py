"""Compares the findings of a record with the scene of its data set: which surfaces each found plane shows.

A found plane shows surfaces directly, or as an image in another found plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float
from pydantic import ValidationError

from xfreqbench import RunRecord, read_records
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.scene.facets import PlanarFacet, group_by_plane, planar_facets
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import SlabMaterial
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes
from xfreqbench.scene.placement import median_transmitter
from xfreqbench.scene.visibility import sees
from xfreqbench.tracing.absorption import slab_response
from xfreqbench.types import FloatArray, NDArray

from ..room.surfaces import polygon_area_m2, slab_reflection
from ..search.planes import Vector
from ..stored import FoundPlane, FoundSlab, StoredFindings

MATCH_DISTANCE_M = 0.05  # a found plane further from every surface shows none of them
MATCH_TILT_RAD = float(np.radians(2))
_ON_PLANE_M = 1e-6

TrueSlab = tuple[SlabMaterial, float]  # a material, and the thickness in metres


@dataclass(frozen=True, eq=False)
class ScenePlane:
    """All facets of a scene that lie in one plane; `normal`, of length 1, points from the array centre to the plane."""

    normal: Vector
    distance_m: float
    facets: tuple[PlanarFacet, ...]

    @property
    def areas_m2(self) -> Float[FloatArray, "q"]:
        """Area of each facet."""
        return np.array([polygon_area_m2(facet.corners_m) for facet in self.facets])

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
        named = [surface for surface, share in shares.items() if share >= 0.01]
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


def share_in_sight(plane: ScenePlane, meshes: Sequence[SurfaceMesh], array_m: Vector) -> float:
    """The share of a plane's facets that the array sees, judged by their centres and points near their corners."""
    corners_m = [facet.corners_m for facet in plane.facets]
    points_m = np.concatenate([np.vstack([c.mean(0), c.mean(0) + 0.8 * (c - c.mean(0))]) for c in corners_m])
    # a millionth of the way to the array, so that a surface does not hide its own points
    return float(sees(meshes, points_m + 1e-6 * (array_m - points_m), array_m).mean())


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
    for corners_m, surface, front in facets:
        beyond_m = (corners_m - array_m) @ mirror.normal - mirror.distance_m
        if (beyond_m < _ON_PLANE_M).all() and (beyond_m < -_ON_PLANE_M).any():
            mirrored = front - 2 * (front @ mirror.normal) * mirror.normal
            images.append(PlanarFacet(corners_m - 2 * beyond_m[:, None] * mirror.normal, surface, mirrored))
    return images


def reflection_difference(
    slabs: Sequence[FoundSlab], truth: Mapping[TrueSlab, float], carrier_hz: Float[FloatArray, "F"]
) -> Float[FloatArray, "F"]:
    """How far |R| of learned slabs is from that of true ones at normal incidence, at each of F carriers.

    Both are mixed by shares; what the shares leave open reflects nothing.
    """
    carriers, normal = carrier_hz.tolist(), np.ones(1)
    learned, true = np.zeros((2, len(carriers)), dtype=np.complex128)
    for slab in slabs:
        permittivity = [slab.permittivity_at(carrier) for carrier in carriers]
        learned += slab.share * slab_reflection(permittivity, slab.thickness_m, carriers, normal)[:, 0, 0]
    for kind, share in truth.items():
        true += share * np.array([true_reflection(kind, carrier, normal)[0, 0] for carrier in carriers])
    return np.abs(np.abs(learned) - np.abs(true))


def true_reflection(
    slab: TrueSlab, carrier_hz: float, cosine: Float[FloatArray, "C"]
) -> Complex[NDArray[np.complex128], "C 2"]:
    """Reflection TE and TM by P.2040, whose power laws are extrapolated beyond a material's band."""
    return slab_response(Slab(*slab), carrier_hz, cosine, "extrapolate")[:, :2]


def virtual_sources(findings: StoredFindings, tx_position_m: Vector) -> dict[tuple[int, ...], Vector]:
    """Where a transmitter seems to be after one or two bounces, by the planes in their order, the strongest first.

    Images below −40 dB relative to the line of sight are left out.
    """
    sources = {}
    for image in findings.images:
        position_m = tx_position_m
        for plane in (findings.planes[index] for index in image.planes):
            beyond_m = plane.unit_normal @ (position_m - findings.array_m) - plane.distance_m
            position_m = position_m - 2 * beyond_m * plane.unit_normal
        if 0 < len(image.planes) <= 2 and image.power >= 1e-4:
            sources[image.planes] = position_m
    return sources


def choose_record(
    results: Path, id_prefix: str | None = None, split: str | None = None, seed: int | None = None
) -> RunRecord:
    """The newest record with findings that fits what is asked for; `results` is a folder of runs or a file of records.

    Raises `DataError` where no record has findings, `UnknownNameError` where none of those fits.
    """
    records = read_records(results)
    if not records:
        raise DataError(f"{results} holds no records of runs. Run `xfreqbench run` first, or correct the path.")
    found = [record for record in records if "planes" in record.findings]
    if not found:
        methods = ", ".join(sorted({record.job.method for record in records}))
        raise DataError(
            f"No record in {results} has findings; its methods are {methods}. Run a method that tells what it "
            "has learned, such as virtual-source."
        )
    for what, asked, name_of, fits in (
        ("run with findings on split", split, lambda record: record.job.split, str.__eq__),
        ("run with findings of seed", seed, lambda record: str(record.job.seed), str.__eq__),
        ("record with findings whose id begins with", id_prefix, lambda record: record.id, str.startswith),
    ):
        if asked is not None:
            names = {name_of(record) for record in found}
            found = [record for record in found if fits(name_of(record), str(asked))]
            if not found:
                raise UnknownNameError(what, str(asked), names)
    return max(found, key=lambda record: record.time_utc)


@dataclass(frozen=True, eq=False)
class ComparedFindings:
    """The findings of a record, and the surfaces of its data set's scene; all comparisons follow from them."""

    record: RunRecord
    dataset: PasDataset
    findings: StoredFindings
    meshes: list[SurfaceMesh]

    @classmethod
    def of(cls, record: RunRecord, dataset: PasDataset) -> ComparedFindings:
        """Compare a record with its data set.

        Raises `DataError` for another data set, one without a scene, or findings that are not planes and images.
        """
        if record.dataset_sha256 != dataset.sha256:
            raise DataError(
                f"Record {record.id} was run on {record.job.dataset} (sha256 {record.dataset_sha256[:16]}…), but "
                f"{dataset.path} has sha256 {dataset.sha256[:16]}…. Give --data the file of the run."
            )
        try:
            findings = StoredFindings.model_validate(record.findings)
        except ValidationError as error:
            fault = error.errors()[0]
            raise DataError(
                f"The findings of record {record.id} ({record.job.method}) are not planes and images: "
                f"{'.'.join(map(str, fault['loc'])) or 'all'}: {fault['msg']}. Choose another record with --id."
            ) from error
        if dataset.scene.scene is not None:
            raise DataError(
                f"{dataset.path} was traced among the meshes of {dataset.scene.scene}, which data sets do not hold. "
                "Use a data set whose scene is made of surfaces alone."
            )
        return cls(record, dataset, findings, surface_meshes(dataset.scene))

    @property
    def title(self) -> str:
        """The run in words: its method, scene, split, seed and record."""
        job = self.record.job
        return f"{job.method} on {self.record.scene}, {job.split}, seed {job.seed} (record {self.record.id})"

    @cached_property
    def planes(self) -> list[ScenePlane]:
        """All planes of the scene."""
        return scene_planes(planar_facets(self.meshes), self.findings.array_m)

    @cached_property
    def matches(self) -> list[Match | None]:
        """What each found plane shows, as `match.compare` says."""
        return compare(self.findings, self.planes)

    @cached_property
    def missing(self) -> list[ScenePlane]:
        """Planes of the scene that were not found, the largest first."""
        shown = [match.plane for match in self.matches if match]
        missing = [plane for plane in self.planes if not any(plane is other for other in shown)]
        return sorted(missing, key=lambda plane: -plane.area_m2)

    @cached_property
    def tx(self) -> int:
        """Index of the transmitter whose virtual sources are shown."""
        return median_transmitter(self.dataset.tables["tx_position_m"])

    @property
    def tx_m(self) -> Vector:
        """Position of that transmitter in metres."""
        return np.asarray(self.dataset.tables["tx_position_m"][self.tx], dtype=np.float64)

    def surface(self, index: int) -> str:
        """What the found plane with this index shows, in words."""
        match = self.matches[index]
        if match is None:
            return "no such surface"
        names = self.names(match.surfaces)
        if match.mirror is None:
            return names
        mirror = self.matches[match.mirror]
        assert mirror is not None, "images are told of planes that are the scene's"
        return f"image of {names} in {self.names(mirror.surfaces[:1])}"

    def names(self, surfaces: Sequence[int]) -> str:
        """The names of surfaces, given by index."""
        return "; ".join(self.meshes[surface].name for surface in surfaces)
