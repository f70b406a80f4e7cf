"""Which candidates are planes: more than chance, leaks of stronger ones, and paths by two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import permutations

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.special import gammainccinv

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import IntArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S
from xfreqbench.virtual_source.coarse_search import MAX_TILT, bounds_m, is_within_reach
from xfreqbench.virtual_source.fine_search import Candidate, deviation_m, score_of, settled
from xfreqbench.virtual_source.line_of_sight import (
    Aligned,
    ComplexArray,
    LineOfSightReference,
    aligned,
    phasor,
    steering,
)
from xfreqbench.virtual_source.planes import mirrored

_LEAK_MARGIN = 2.0  # amplitudes of leaking planes are known roughly
_LAYER_M = 0.02
_FALSE_ALARM = 1e-3  # planes in a room without any


def accepted(reference: LineOfSightReference, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that beat chance by what stronger ones don't explain; those with most of it first."""
    enough = chance(reference)
    likely = [each for each in candidates if each.score > enough and _is_sound(reference, each)]
    single = [each for each in likely if not _is_double(reference, each, likely)]
    planes: list[Candidate] = []
    scores: list[float] = []
    waves: list[_Wave] = []
    for candidate in sorted(single, key=lambda each: each.score, reverse=True):
        mine = _wave(reference, [candidate.place_m])
        leaked = sum(_leaked(reference, mine, other) for other in waves)
        own = (candidate.aligned.evidence - _LEAK_MARGIN**2 * leaked).clip(0)
        if (score := score_of(own)) > enough:
            places_m = [plane.place_m for plane in planes]
            waves += [mine, *_doubles(reference, candidate.place_m, places_m)]
            planes.append(candidate)
            scores.append(score)
    return [planes[index] for index in np.argsort(scores)[::-1]]


@dataclass(frozen=True, eq=False)
class _Wave:
    """A path by one or more planes: whence it comes, and what is seen of it."""

    steering: Complex[ComplexArray, "T M"]
    aligned: Aligned


def _wave(
    reference: LineOfSightReference,
    planes_m: Sequence[Float[FloatArray, "3"]],
    place_m: Float[FloatArray, "3"] | None = None,
) -> _Wave:
    """The path that meets planes in order; as long as to another mirrored receiver, if one is given."""
    source_m = reference.offset_m
    for plane_m in planes_m:
        source_m = mirrored(source_m, plane_m)
    if place_m is None:
        place_m = reduce(mirrored, reversed(planes_m), np.zeros(3))
    return _Wave(steering(reference, source_m), aligned(reference, place_m, source_m=source_m))


def _doubles(
    reference: LineOfSightReference,
    plane_m: Float[FloatArray, "3"],
    others_m: Sequence[Float[FloatArray, "3"]],
) -> list[_Wave]:
    """Paths by a plane and another one, in either order."""
    orders = [order for other_m in others_m for order in ([plane_m, other_m], [other_m, plane_m])]
    return [_wave(reference, order) for order in orders]


def _is_sound(reference: LineOfSightReference, candidate: Candidate) -> bool:
    """Whether it may be a plane of a room at all."""
    return _is_wanted(reference, candidate.place_m) and _needs_no_layer(reference, candidate)


def _needs_no_layer(reference: LineOfSightReference, candidate: Candidate) -> bool:
    """Whether evidence remains without the transmitters at any one distance from the plane.

    For those, the images in another plane may be as far away, where the array can't tell from which side.
    """
    term = candidate.aligned.term
    needed = float(gammainccinv(term.shape[1], _FALSE_ALARM))
    for layer in _layers(reference.offset_m @ candidate.place_m / np.linalg.norm(candidate.place_m)):
        rest = np.delete(term, layer, axis=0)
        power = (abs(rest) ** 2).sum(axis=0).clip(1e-30)
        if score_of((abs(rest.sum(axis=0)) ** 2 / power).astype(float)) < needed:
            return False
    return True


def _layers(height_m: Float[FloatArray, "T"]) -> list[Int[IntArray, "_"]]:
    """Transmitters that stand at about the same height, apart from all others."""
    order = np.argsort(height_m)
    groups = np.split(order, np.flatnonzero(np.diff(height_m[order]) > _LAYER_M) + 1)
    return [group for group in groups if np.ptp(height_m[group]) < 2 * _LAYER_M]


def chance(reference: LineOfSightReference) -> float:
    """A score that the best of all planes reaches with a small probability where there is none.

    The evidence of F carriers is then a gamma variable of shape F, and as many planes differ as there are
    places for the mirrored receiver, a wavelength apart at the highest carrier.
    """
    low_m, high_m = bounds_m(reference)
    num_places = float(np.prod((high_m - low_m) * reference.wavenumber[-1] / np.pi))
    return float(gammainccinv(len(reference.carrier_hz), _FALSE_ALARM / num_places))


def _leaked(reference: LineOfSightReference, mine: _Wave, other: _Wave) -> Float[FloatArray, "F"]:
    """Evidence that a wave makes when it is turned back by another's lengths."""
    overlap = np.einsum("tm,tm->t", mine.steering.conj(), other.steering) / mine.steering.shape[1]
    fainter = (reference.distance_m / other.aligned.length_m)[:, None] * reference.amplitude
    is_there = other.aligned.term != 0
    gain = abs(other.aligned.sum) / (fainter * is_there).sum(axis=0).clip(1e-30)
    longer_m = mine.aligned.length_m - other.aligned.length_m
    turned = phasor(longer_m[:, None] * reference.carrier_hz / SPEED_OF_LIGHT_M_S)
    counts = (mine.aligned.term != 0) & is_there
    leaked = gain * abs((overlap[:, None] * fainter * turned * counts).sum(axis=0))
    return leaked**2 / mine.aligned.power


def _is_double(reference: LineOfSightReference, candidate: Candidate, planes: Sequence[Candidate]) -> bool:
    """Whether two planes, one after the other, make paths as long, and tell better whence they come.

    An array can't tell where three planes are parallel to it: then the faintest of them is none.
    """
    others = [plane for plane in planes if plane is not candidate]
    for first, second in permutations(others, 2):
        if not _is_near(reference, candidate.place_m, mirrored(second.place_m, first.place_m)):
            continue
        is_faintest = candidate.score < min(first.score, second.score)
        wave = _wave(reference, [first.place_m, second.place_m], candidate.place_m)
        if score_of(wave.aligned.evidence) > (0.9 if is_faintest else 1.05) * candidate.score:
            return True
    return False


def _is_near(
    reference: LineOfSightReference, one_m: Float[FloatArray, "3"], other_m: Float[FloatArray, "3"]
) -> bool:
    if np.linalg.norm(one_m - other_m) > MAX_TILT * np.linalg.norm(other_m):
        return False
    return deviation_m(reference, one_m, other_m) * float(np.median(reference.wavenumber)) < 2 * np.pi


def missed(reference: LineOfSightReference, planes: Sequence[Candidate]) -> list[Candidate]:
    """Planes that would make one of those found a path by two: with another one, before or after it."""
    enough = chance(reference) / 2
    found: list[Candidate] = []
    for double, plane in permutations(planes, 2):
        after_m = mirrored(double.place_m, plane.place_m)
        across_m = double.place_m - plane.place_m
        before_m = (double.place_m + plane.place_m) @ across_m / (across_m @ across_m) * across_m
        for place_m in (after_m, before_m):
            is_known = any(_is_near(reference, place_m, each.place_m) for each in [*planes, *found])
            if is_known or not _is_wanted(reference, place_m):
                continue
            if score_of(aligned(reference, place_m).evidence) > enough:
                found.append(settled(reference, place_m))
    return found


def _is_wanted(reference: LineOfSightReference, place_m: Float[FloatArray, "3"]) -> bool:
    """Upright or level, and not out of reach."""
    height = abs(place_m[2]) / max(float(np.linalg.norm(place_m)), 1e-9)
    is_tilted = min(height, np.sqrt(1 - min(height, 1.0) ** 2)) > MAX_TILT
    return not is_tilted and bool(is_within_reach(reference, place_m[None], 0.0).all())
