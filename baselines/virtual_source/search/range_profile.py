"""Distances of planes whose directions are known, to fractions of a millimetre, from all carriers together.

The phase of a path that bounces off a single plane follows from its length at every carrier, apart from a
constant. Cross terms whose phase is turned back by the right length therefore add up over carriers too, as in a
radar with the bandwidth of the whole data set: 93 GHz resolve 2 mm. Only a few transmitters light a facet, so
terms add up coherently over neighbouring transmitters, and neighbourhoods add up in power.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.ndimage import maximum_filter1d
from scipy.optimize import minimize
from scipy.sparse import csr_array

from xfreqbench.data.dataset import PasDataset
from xfreqbench.types import FloatArray, NDArray

from .coarse import BEHIND_BOX_M
from .cross_terms import Aligned, CrossTerms, Explained, IsOver, SearchOverError, aligned, never, phasor, until_over
from .planes import Plane, Vector, plane_of
from .selection import is_upright, mirrored_receivers_m

_NEIGHBOURHOOD_M = 1.0  # side at least
_MIN_NEIGHBOURS = 6
_NUM_NEIGHBOURS = (20, 60)  # for whose sake neighbourhoods are larger where transmitters are few
_BLOCK_M, _STEP_M = 0.04, 8e-4  # steering vectors change from block to block; a step is λ/4 at 94 GHz
_NEAREST_M = 0.05
_CHANCE = 9.0  # only evidence of a neighbourhood above this counts; chance is exponential with mean 1
_PEAK_M = 0.02
_LOBE_M, _LOBE_SHARE = 0.35, 0.1  # the latter of the distance
_ECHO_M, _ECHO_SHARE = 1.0, 0.1
_SAME_COSINE, _SAME_DIRECTION = 0.999, 0.9998
_MIN_DEPTH_M = 0.05  # transmitters at one distance cannot tell a plane from one on the other side
_LAYER_STD_M = 8e-5  # by which what lies behind a surface moves it, as measured in random rooms of slabs
_TILT_STD_RAD = 5e-4  # standard deviation of the normals that are given
_SIMPLEX_M, _SETTLED_M, _CURVATURE_STEP_M = 3e-4, 2e-6, 5e-5
_SMALLEST_INFORMATION = 1e-6  # 1/m²


@dataclass(frozen=True)
class _Demand:
    """What a plane needs: evidence of its best neighbourhood (`best`) and of all above `_CHANCE` (`total`).

    At most `most` planes have the same normal.
    """

    best: float
    total: float
    most: int


_SURE = _Demand(best=18.0, total=14.0, most=6)  # chance reaches 16 in 1e7 tries
_TRIAL = _Demand(best=12.0, total=3.0, most=3)  # enough to try a plane in training


@dataclass(frozen=True, eq=False)
class Profile:
    """Evidence for planes with one normal at S distances: `best` of any neighbourhood, `total` above chance.

    Neighbourhoods have sides of `side_m`.
    """

    side_m: float
    normal: Vector
    distance_m: Float[FloatArray, "S"]
    best: Float[FloatArray, "S"]
    total: Float[FloatArray, "S"]


def range_profile(reference: CrossTerms, normal: Vector, side_m: float = _NEIGHBOURHOOD_M) -> Profile:
    """Evidence for planes with a unit normal, from close to the receiver to behind the farthest transmitter.

    The evidence of a neighbourhood is |Σ x|² / Σ|x|² over its transmitters and all carriers.
    """
    belongs = _neighbourhoods(reference, normal, side_m)
    farthest_m = float((reference.offset_m @ normal).max(initial=0)) + BEHIND_BOX_M
    starts_m = np.arange(_NEAREST_M, farthest_m, _BLOCK_M)
    evidence = np.concatenate([_block(reference, normal, start_m, belongs) for start_m in starts_m])
    return Profile(
        side_m,
        normal,
        (starts_m[:, None] + _steps_m()).ravel(),
        evidence.max(axis=1, initial=0),
        (evidence - _CHANCE).clip(0).sum(axis=1),
    )


def _steps_m() -> Float[FloatArray, "m"]:
    """Distances within a block, from its start."""
    return np.arange(round(_BLOCK_M / _STEP_M), dtype=np.float64) * _STEP_M


def _sides_m(reference: CrossTerms, normal: Vector) -> list[float]:
    """Sides of neighbourhoods across a normal: one where transmitters are dense, larger ones too where they are few."""
    floor_m2, across_m2 = (
        float(np.ptp(place_m, axis=0).clip(_NEIGHBOURHOOD_M).prod())
        for place_m in (reference.offset_m[:, :2], _across_m(reference, normal))
    )
    dense, num_tx = _NUM_NEIGHBOURS[0] * floor_m2 / _NEIGHBOURHOOD_M**2, len(reference.offset_m)
    if num_tx >= dense:
        return [_NEIGHBOURHOOD_M]
    return sorted({max(_NEIGHBOURHOOD_M, math.sqrt(number * across_m2 / num_tx)) for number in _NUM_NEIGHBOURS})


def _across_m(reference: CrossTerms, normal: Vector) -> Float[FloatArray, "T 2"]:
    """Places of transmitters across a normal."""
    return reference.offset_m @ np.linalg.svd(normal[None])[2][1:].T


def _neighbourhoods(reference: CrossTerms, normal: Vector, side_m: float) -> csr_array:
    """Membership, 0 or 1, of T transmitters in N neighbourhoods: squares across the normal, of any depth along it.

    Shape (N, T).
    """
    place = np.floor(_across_m(reference, normal) / side_m).astype(np.int64)
    _, of_tx = np.unique(place, axis=0, return_inverse=True)
    return csr_array((np.ones(of_tx.size, np.float32), (of_tx.ravel(), np.arange(of_tx.size))))


def _block(
    reference: CrossTerms, normal: Vector, start_m: float, belongs: csr_array
) -> Float[NDArray[np.float32], "m N"]:
    """Evidence of each neighbourhood at the distances of the block that starts at `start_m`."""
    there = aligned(reference, 2 * start_m * normal, less_mean=False)
    longer = 2 * there.gradient @ normal
    turn = phasor(_STEP_M / (2 * np.pi) * reference.wavenumber[:, None] * longer)
    term = there.term.T.copy()
    sums = np.empty((len(_steps_m()), len(longer)), np.complex64)
    for step in range(len(sums)):
        term.sum(axis=0, out=sums[step])
        term *= turn
    power = belongs @ (abs(there.term) ** 2).sum(axis=1)
    together = (belongs @ sums.T).T
    is_usable = _is_usable(belongs, there.term, reference.offset_m @ normal)
    return (abs(together) ** 2 / power.clip(1e-20) * is_usable).astype(np.float32)


def _is_usable(
    belongs: csr_array, term: Complex[NDArray[np.complexfloating], "T F"], depth_m: Float[FloatArray, "T"]
) -> Bool[NDArray[np.bool_], "N"]:
    """Whether a neighbourhood has enough transmitters in front of the plane, at different distances from it."""
    is_lit = (term != 0).any(axis=1)
    number = belongs @ is_lit.astype(float)
    mean, square = (belongs @ (is_lit * values) / number.clip(1) for values in (depth_m, depth_m**2))
    variance = square - mean**2
    return (number >= _MIN_NEIGHBOURS) & (variance > _MIN_DEPTH_M**2)


def find_planes(train: PasDataset, seed: int, is_over: IsOver = never) -> list[Plane]:
    """Planes found in the training maps without any prior knowledge, strongest first; there may be none.

    Once `is_over` returns True, the search ends with the planes that it has found.
    """
    try:
        reference = CrossTerms.of(train, is_over=is_over)
        images_m = mirrored_receivers_m(reference, seed, guesses=True)
    except SearchOverError:
        return []
    normals = images_m / np.linalg.norm(images_m, axis=1, keepdims=True)
    return profiled_planes(reference, _directions(normals)) if len(normals) else []


def find_more_planes(
    train: PasDataset, known: Sequence[Plane], explained: Explained, is_over: IsOver = never
) -> list[Plane]:
    """More planes along the normals of `known` ones, strongest first, found in what `explained` leaves of the maps.

    Once `is_over` returns True, the search ends with the planes that it has found.
    """
    try:
        reference = CrossTerms.of(train, explained, is_over)
    except SearchOverError:
        return []
    return profiled_planes(reference, _directions([plane.normal for plane in known]), known, _TRIAL)


def _directions(normals: Iterable[Vector]) -> list[Vector]:
    """The normals, their opposites, up and down, without near duplicates."""
    normals, vertical = list(normals), np.array([0.0, 0.0, 1.0])
    across = [np.cross(vertical, normal) for normal in normals if is_upright(normal)]
    across = [vector / np.linalg.norm(vector) for vector in across]
    if across and min(abs(across[0] @ vector) for vector in across) > _SAME_COSINE:  # most rooms have corners
        normals.append(across[0])
    kept: list[Vector] = []
    for normal in [*normals, vertical]:
        for direction in (normal, -normal):
            if all(direction @ other < _SAME_DIRECTION for other in kept):
                kept.append(direction)
    return kept


def random_planes(train: PasDataset, seed: int, number: int) -> list[Plane]:
    """Planes with random directions and distances within the scene, an ablation that shows what the search is worth."""
    generator = np.random.default_rng(seed)
    normal = generator.normal(size=(number, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    reach_m = np.linalg.norm(train.tx_position_m - train.header.receiver.position_m, axis=1).max()
    distance_m = generator.uniform(_NEAREST_M, reach_m, number).tolist()
    deviations = float(reach_m) / math.sqrt(12), math.pi / math.sqrt(12)
    return [Plane(unit, far_m, *deviations, score=0.0) for unit, far_m in zip(normal, distance_m, strict=True)]


def profiled_planes(
    reference: CrossTerms, normals: Sequence[Vector], known: Sequence[Plane] = (), demand: _Demand = _SURE
) -> list[Plane]:
    """Planes with about these normals that meet the demand, strongest first, without those that are known already.

    Their score is the evidence above chance, less what their tilt costs. Once the time of the search is over, the
    planes are those found until then.
    """
    profiles = until_over(
        [range_profile(reference, normal, side_m) for side_m in _sides_m(reference, normal)] for normal in normals
    )
    found = [plane for of_normal in profiles for plane in _along(reference, of_normal, known, demand)]
    return sorted(found, key=lambda plane: plane.score, reverse=True)


def _along(reference: CrossTerms, profiles: Sequence[Profile], known: Sequence[Plane], demand: _Demand) -> list[Plane]:
    """The planes of the profiles of one normal, strongest first."""
    planes: list[Plane] = []
    for profile in profiles:
        is_peak = profile.total == maximum_filter1d(profile.total, round(_PEAK_M / _STEP_M))
        speaks = np.flatnonzero(is_peak & (profile.best > demand.best) & (profile.total > demand.total))
        highest_first = speaks[np.argsort(-profile.total[speaks])].tolist()
        peaks = [index for index in highest_first if not _is_known(reference, profile, index, known)]
        planes += until_over(_sharpened(reference, profile, index) for index in peaks[: 2 * demand.most])
    kept: list[Plane] = []
    for plane in sorted(planes, key=lambda plane: plane.score, reverse=True):
        if not any(_is_side_lobe(plane, other) for other in kept):
            kept.append(plane)
    return kept[: demand.most]


def _is_known(reference: CrossTerms, profile: Profile, index: int, known: Sequence[Plane]) -> bool:
    """Whether a peak belongs to a known plane."""
    for plane in known:
        is_wall = (reference.offset_m @ plane.normal < plane.distance_m).all()
        apart_m = abs(profile.distance_m[index] - plane.distance_m)
        reach_m = _LOBE_M if is_wall else _PEAK_M  # a wall that is not known exactly leaves peaks around it
        if plane.normal @ profile.normal > _SAME_COSINE and apart_m < reach_m:
            return True
    return False


def _is_side_lobe(plane: Plane, stronger: Plane) -> bool:
    """Whether a plane is a fainter peak near a stronger one, made by the gaps between carriers or a slab's far face."""
    apart_m = abs(plane.distance_m - stronger.distance_m)
    if apart_m < max(_LOBE_M, _LOBE_SHARE * plane.distance_m):
        return True
    return apart_m < _ECHO_M and plane.score < _ECHO_SHARE * stronger.score


def _sharpened(reference: CrossTerms, profile: Profile, index: int) -> Plane:
    """The plane of a peak, its distance and tilts moved to where the evidence is greatest."""
    peak = _Peak.of(reference, 2 * profile.distance_m[index] * profile.normal, profile.side_m)
    simplex = np.vstack([np.zeros(3), _SIMPLEX_M * np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": _SETTLED_M, "fatol": 1e-3, "maxfev": 300}
    best = minimize(lambda step_m: -peak.value(step_m), np.zeros(3), method="Nelder-Mead", options=options)
    plane = plane_of(peak.place_m + best.x, peak.covariance_m2(best.x), -float(best.fun))
    return replace(plane, distance_std_m=math.hypot(plane.distance_std_m, _LAYER_STD_M))


@dataclass(frozen=True, eq=False)
class _Peak:
    """Evidence of N neighbourhoods close to one place of the mirrored receiver; directions of arrival stay fixed."""

    place_m: Vector
    there: Aligned
    wavenumber: Float[FloatArray, "F"]
    belongs: csr_array

    @classmethod
    def of(cls, reference: CrossTerms, place_m: Vector, side_m: float) -> _Peak:
        """The peak at a place, with the neighbourhoods that are usable there."""
        normal = place_m / np.linalg.norm(place_m)
        there = aligned(reference, place_m, less_mean=False)
        belongs = _neighbourhoods(reference, normal, side_m)
        usable = _is_usable(belongs, there.term, reference.offset_m @ normal)
        return cls(place_m, there, reference.wavenumber, belongs[usable])

    @cached_property
    def power(self) -> Float[FloatArray, "N"]:
        """Summed power of all terms of each neighbourhood."""
        return (self.belongs @ (abs(self.there.term) ** 2).sum(axis=1)).clip(1e-20)

    def above_chance(self, step_m: Vector) -> Float[FloatArray, "N"]:
        """Evidence of each neighbourhood a step away, less `_CHANCE`, and 0 where it is below."""
        turn = phasor((self.there.gradient @ step_m)[:, None] * (self.wavenumber / (2 * np.pi)))
        together = self.belongs @ (self.there.term * turn).sum(axis=1, dtype=complex)
        return (abs(together) ** 2 / self.power - _CHANCE).clip(0)

    def value(self, step_m: Vector) -> float:
        """Sum of the evidence above chance a step away, less the cost of the tilt."""
        normal = self.place_m / np.linalg.norm(self.place_m)
        across_m = step_m - (step_m @ normal) * normal
        tilt = np.linalg.norm(across_m) / np.linalg.norm(self.place_m) / _TILT_STD_RAD
        return float(self.above_chance(step_m).sum() - tilt**2)

    def covariance_m2(self, step_m: Vector) -> Float[FloatArray, "3 3"]:
        """Covariance of the mirrored receiver at a maximum: H⁻¹ (Σ g gᵀ) H⁻¹, and in no direction less than H⁻¹.

        H is the curvature of `value`, g the slope of a neighbourhood's evidence. The covariance covers the
        disagreement among neighbourhoods. It does not cover their common errors, such as a layer behind the
        surface (`_LAYER_STD_M`), the centre of the array, or the given tilt. It is very large where there is no
        maximum.
        """
        information, axes = np.linalg.eigh(-_curvature(self.value, step_m))
        root = axes / np.sqrt(information.clip(_SMALLEST_INFORMATION))
        scatter, turned = np.linalg.eigh(root.T @ self._slopes(step_m).T @ self._slopes(step_m) @ root)
        return root @ (turned * scatter.clip(1)) @ turned.T @ root.T

    def _slopes(self, place_m: Vector) -> Float[FloatArray, "N 3"]:
        """Slope of each neighbourhood's evidence, by central differences."""
        steps = _CURVATURE_STEP_M * np.eye(3)
        rises = [self.above_chance(place_m + step) - self.above_chance(place_m - step) for step in steps]
        return np.stack(rises, axis=1) / (2 * _CURVATURE_STEP_M)


def _curvature(value: Callable[[Vector], float], place_m: Vector) -> Float[FloatArray, "3 3"]:
    """Matrix of second derivatives, by central differences."""
    step = _CURVATURE_STEP_M * np.eye(3)
    curvature = np.zeros((3, 3))
    for i, j in combinations_with_replacement(range(3), 2):
        signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
        corners = [a * b * value(place_m + a * step[i] + b * step[j]) for a, b in signs]
        curvature[i, j] = curvature[j, i] = sum(corners) / (4 * _CURVATURE_STEP_M**2)
    return curvature
