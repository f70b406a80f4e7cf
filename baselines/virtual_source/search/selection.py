"""Search for the directions of a room's planes in power maps alone, and the selection among its candidates.

All places of the receiver's mirror image are tried at the lowest carrier, and the best are followed from carrier
to carrier. Candidates are planes if neither chance, nor a leak of a stronger plane, nor a path over two other
planes explains them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import permutations

import numpy as np
from jaxtyping import Complex, Float
from scipy.special import gammainccinv

from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from .coarse import (
    MAX_TILT,
    bounds_m,
    coarse_maxima_m,
    is_within_reach,
)
from .cross_terms import (
    Aligned,
    ComplexArray,
    LineOfSightReference,
    aligned,
    phasor,
    steering,
)
from .fine import Candidate, deviation_m, refined_m, score_of, settled
from .planes import mirrored

_LEAK_MARGIN = 2.0  # amplitudes of leaking planes are known only roughly
_LAYER_M = 0.02
_FALSE_ALARM = 1e-3  # number of planes found in a room without any


def mirrored_receivers_m(
    reference: LineOfSightReference, generator: np.random.Generator | int, *, guesses: bool = False
) -> Float[FloatArray, "P 3"]:
    """Mirror images of the receiver in the planes that the maps show, strongest first; there may be none.

    Where no upright plane is among them, `guesses` adds the one that comes nearest to what is asked for, made
    plumb: its direction is worth a closer look.

    Planes are upright ones of any azimuth, floors and ceilings, which may lean by a few degrees. `generator`
    chooses the transmitters of the coarse search where there are too many. Line-of-sight flags are not used.

    A path over two planes that are found is not taken for a third plane. Where all transmitters have the same
    height, a floor cannot be told from a ceiling, and neither is returned. Raises `SearchOverError`.
    """
    if not len(reference.offset_m):
        return np.zeros((0, 3))
    places_m = refined_m(reference, coarse_maxima_m(reference, np.random.default_rng(generator)))
    candidates = [settled(reference, place) for place in places_m]
    found = accepted(reference, candidates)
    if more := missed(reference, found):
        found = accepted(reference, [*candidates, *more])
    chosen_m = [candidate.place_m for candidate in found]
    if guesses and not any(map(is_upright, chosen_m)):
        likely = [
            each for each in candidates if is_upright(each.place_m) and _is_wanted(reference, each.place_m)
        ]
        likely.sort(key=lambda each: each.score)
        chosen_m += [each.place_m * (1, 1, 0) for each in likely[-1:]]
    return np.array(chosen_m).reshape(-1, 3)


def accepted(reference: LineOfSightReference, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates whose evidence beats chance even without what stronger ones explain of it, strongest first."""
    enough = chance(reference)
    likely = [
        each
        for each in candidates
        if each.score > enough and _is_wanted(reference, each.place_m) and _needs_no_layer(reference, each)
    ]
    single = [each for each in likely if not _is_double(reference, each, likely)]
    planes: list[Candidate] = []
    scores: list[float] = []
    waves: list[_Wave] = []
    for candidate in sorted(single, key=lambda each: each.score, reverse=True):
        mine = _wave(reference, [candidate.place_m])
        leaked = sum(_leaked(reference, mine, other) for other in waves)
        own = (candidate.aligned.evidence - _LEAK_MARGIN**2 * leaked).clip(0)
        if (score := score_of(own)) > enough:
            doubles = (
                order
                for plane in planes
                for order in ([candidate.place_m, plane.place_m], [plane.place_m, candidate.place_m])
            )
            waves += [mine, *(_wave(reference, order) for order in doubles)]
            planes.append(candidate)
            scores.append(score)
    return [planes[index] for index in np.argsort(scores)[::-1]]


@dataclass(frozen=True, eq=False)
class _Wave:
    """A path over one or more planes: steering vectors of its arrivals, and the cross terms at its lengths."""

    steering: Complex[ComplexArray, "T M"]
    aligned: Aligned


def _wave(
    reference: LineOfSightReference,
    planes_m: Sequence[Float[FloatArray, "3"]],
    place_m: Float[FloatArray, "3"] | None = None,
) -> _Wave:
    """The path over planes in order. Its lengths are those to `place_m` instead, if that is given."""
    source_m = reference.offset_m
    for plane_m in planes_m:
        source_m = mirrored(source_m, plane_m)
    if place_m is None:
        place_m = reduce(mirrored, reversed(planes_m), np.zeros(3))
    return _Wave(steering(reference, source_m), aligned(reference, place_m, source_m=source_m))


def _needs_no_layer(reference: LineOfSightReference, candidate: Candidate) -> bool:
    """Whether evidence remains without the transmitters of any one layer, all as far from the plane.

    The images of a layer in another plane may be as far away, and the array cannot tell from which side they come.
    """
    term = candidate.aligned.term
    needed = float(gammainccinv(term.shape[1], _FALSE_ALARM))
    height_m = reference.offset_m @ candidate.place_m / np.linalg.norm(candidate.place_m)
    order = np.argsort(height_m)
    for layer in np.split(order, np.flatnonzero(np.diff(height_m[order]) > _LAYER_M) + 1):
        if np.ptp(height_m[layer]) >= 2 * _LAYER_M:
            continue
        rest = np.delete(term, layer, axis=0)
        power = (abs(rest) ** 2).sum(axis=0).clip(1e-30)
        if score_of((abs(rest.sum(axis=0)) ** 2 / power).astype(float)) < needed:
            return False
    return True


def chance(reference: LineOfSightReference) -> float:
    """The score that the best candidate exceeds with a small probability in a room without planes.

    The summed evidence of F carriers is then a gamma variable of shape F. The number of independent candidates is
    that of the places for the mirrored receiver, a wavelength of the highest carrier apart.
    """
    low_m, high_m = bounds_m(reference)
    num_places = float(np.prod((high_m - low_m) * reference.wavenumber[-1] / np.pi))
    return float(gammainccinv(len(reference.carrier_hz), _FALSE_ALARM / num_places))


def _leaked(reference: LineOfSightReference, mine: _Wave, other: _Wave) -> Float[FloatArray, "F"]:
    """Evidence at each carrier that `other` leaves where cross terms are turned back by the lengths of `mine`."""
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
    """Whether a path over two other planes is as long and explains the directions of arrival better.

    An array cannot tell this where three planes are parallel to it; the faintest of them is then rejected.
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
    """Whether the lengths to two mirrored receivers differ by a constant, within a turn at the median carrier."""
    if np.linalg.norm(one_m - other_m) > MAX_TILT * np.linalg.norm(other_m):
        return False
    return deviation_m(reference, one_m, other_m) * float(np.median(reference.wavenumber)) < 2 * np.pi


def missed(reference: LineOfSightReference, planes: Sequence[Candidate]) -> list[Candidate]:
    """Planes not found so far that would explain a found one: as the path over themselves and another found plane."""
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


def is_upright(place_m: Float[FloatArray, "3"]) -> bool:
    """Whether the plane of a mirrored receiver is a wall, not a floor or a ceiling."""
    return abs(float(place_m[2])) < MAX_TILT * float(np.linalg.norm(place_m))


def _is_wanted(reference: LineOfSightReference, place_m: Float[FloatArray, "3"]) -> bool:
    """Whether a plane is upright or level and touches the box of transmitters and receiver."""
    height = abs(place_m[2]) / max(float(np.linalg.norm(place_m)), 1e-9)
    is_tilted = min(height, np.sqrt(1 - min(height, 1.0) ** 2)) > MAX_TILT
    return not is_tilted and bool(is_within_reach(reference, place_m[None], 0.0).all())
