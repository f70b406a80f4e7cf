"""Search for the directions of a room's planes in power maps alone, and the selection among its candidates.

All places of the receiver's mirror image are tried at the lowest carrier, and the best are followed from carrier to
carrier, then improved on all together. Candidates are planes if neither chance, nor a leak of a stronger plane, nor a
path over two other planes explains them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import permutations

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.ndimage import maximum_filter
from scipy.special import gammainccinv

from xfreqbench.system.machine import one_blas_thread
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from .coarse import MAX_TILT, bounds_m, coarse_maxima_m, is_within_reach
from .cross_terms import MIN_EXCESS_CYCLES, Aligned, CrossTerms, PhasorArray, aligned, phasor, steering
from .planes import Vector, mirrored

_NUM_CANDIDATES = (300, 200, 120, 60, 40)  # kept after each carrier; the last number holds for all that follow
_NUM_BRANCHES = 3  # maxima that are followed from one candidate, while carriers are few
_STEP_RAD, _REACH_RAD = 1.0, 1.4  # of a local grid: step at the new carrier, reach at the one before
_MAX_STEPS = 5  # of a local grid, in every direction
_SAME_PHASE_RAD = 1.5  # two candidates are the same where their phases differ less, root mean square
_CARRIER_CAP = 20.0  # most evidence of one carrier that counts in the ranking of candidates
_MAX_NEWTON_STEPS = 12
_SETTLED_GAIN = 1e-4  # evidence gained by a step; with less, the search ends
_LEAK_MARGIN = 2.0  # amplitudes of leaking planes are known only roughly
_LAYER_M = 0.02
_FALSE_ALARM = 1e-3  # number of planes found in a room without any


def refined_m(reference: CrossTerms, place_m: Float[FloatArray, "C 3"]) -> Float[FloatArray, "K 3"]:
    """Mirrored receivers followed from the lowest carrier to the highest; the best of them are kept."""
    num_carriers = len(reference.carrier_hz)
    with one_blas_thread():
        for joining in range(min(1, num_carriers - 1), num_carriers):
            branches = _NUM_BRANCHES if joining <= 2 else 1
            moved = [at for place in place_m for at in _local_maxima(reference, place, joining, branches)]
            place_m = _best(reference, np.array(moved).reshape(-1, 3), joining)
    return place_m


def _local_maxima(reference: CrossTerms, place_m: Vector, joining: int, branches: int) -> list[Vector]:
    """Best places near one, by the carrier that joins and the one before, on a grid in which phases are linear."""
    carriers = slice(max(joining - 1, 0), joining + 1)
    wavenumber = reference.wavenumber[carriers]
    there = aligned(reference, place_m, carriers, MIN_EXCESS_CYCLES / 2)
    variance, axes = np.linalg.eigh(there.spread)
    deviation = np.sqrt(variance.clip(1e-6))
    limit_m = MAX_TILT * np.linalg.norm(place_m) + np.pi / wavenumber[0]
    reach_m = np.minimum(_REACH_RAD / (wavenumber[0] * deviation), limit_m)
    step_m = np.minimum(_STEP_RAD / (wavenumber[-1] * deviation), reach_m)
    num_steps = np.minimum(np.ceil(reach_m / step_m), _MAX_STEPS).astype(int)
    evidence = _grid_evidence(there, wavenumber, axes * step_m, num_steps)
    is_peak = evidence == maximum_filter(evidence, size=3, mode="nearest")
    best = np.argsort(-evidence[is_peak])[:branches]
    return [place_m + axes @ (step_m * (index - num_steps)) for index in np.argwhere(is_peak)[best]]


def _grid_evidence(
    there: Aligned, wavenumber: Float[FloatArray, "K"], step_m: Float[FloatArray, "3 3"], num_steps: Int[IntArray, "3"]
) -> Float[FloatArray, "I J L"]:
    """Evidence summed over carriers on a grid around a place; its steps are the columns of `step_m`."""
    longer_m = there.gradient @ step_m
    total = np.zeros(2 * num_steps + 1)
    for term, power, radians_per_m in zip(there.term.T, there.power, wavenumber, strict=True):
        turned = phasor(longer_m * (radians_per_m / (2 * np.pi)))
        first, second, third = (_powers(turn, count) for turn, count in zip(turned.T, num_steps.tolist(), strict=True))
        pairs = (first * term)[:, None] * second
        sums = pairs.reshape(-1, len(term)) @ third.T
        total += (abs(sums) ** 2).reshape(total.shape) / power
    return total


def _powers(turn: Complex[PhasorArray, "T"], count: int) -> Complex[PhasorArray, "N T"]:
    """Powers with exponents from −count to +count of numbers of modulus 1."""
    ascending = np.cumprod(np.tile(turn, (count, 1)), axis=0) if count else np.empty((0, len(turn)), turn.dtype)
    return np.concatenate([ascending[::-1].conj(), np.ones((1, len(turn)), turn.dtype), ascending])


def _best(reference: CrossTerms, place_m: Float[FloatArray, "C 3"], joining: int) -> Float[FloatArray, "K 3"]:
    """The best candidates by all carriers so far, without duplicates."""
    carriers = slice(joining + 1)
    evidence = np.array(
        [
            aligned(reference, at, carriers, MIN_EXCESS_CYCLES / 2).evidence.clip(max=_CARRIER_CAP).sum()
            for at in place_m
        ]
    )
    limit = _NUM_CANDIDATES[min(joining, len(_NUM_CANDIDATES) - 1)]
    wavenumber = float(reference.wavenumber[joining])
    length_m = np.linalg.norm(place_m[:, None] - reference.offset_m, axis=2)
    kept: list[int] = []
    for index in np.argsort(-evidence).tolist():
        reference.require_time()
        if len(kept) == limit:
            break
        # the same as another one, as far as phases tell, if the lengths to both differ by a constant
        reach_m = MAX_TILT * np.linalg.norm(place_m[index]) + 2 / wavenumber * 2 * np.pi
        near = np.array(kept, int)[np.linalg.norm(place_m[kept] - place_m[index], axis=1) <= reach_m]
        if not (np.std(length_m[near] - length_m[index], axis=1) * wavenumber < _SAME_PHASE_RAD).any():
            kept.append(index)
    return place_m[kept]


def deviation_m(reference: CrossTerms, one_m: Vector, other_m: Vector) -> float:
    """Standard deviation over transmitters of the difference between their distances to two mirrored receivers."""
    one, other = (np.linalg.norm(reference.offset_m - place, axis=1) for place in (one_m, other_m))
    return float(np.std(one - other))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place of the mirrored receiver, and the cross terms aligned for it."""

    place_m: Vector
    aligned: Aligned

    @property
    def score(self) -> float:
        """The `score_of` its evidence."""
        return score_of(self.aligned.evidence)


def score_of(evidence: Float[FloatArray, "F"]) -> float:
    """Sum of the carriers' evidence, in which none counts for more than twice their median."""
    return float(np.minimum(evidence, 2 * np.median(evidence)).sum())


def settled(reference: CrossTerms, place_m: Vector) -> Candidate:
    """The local maximum of the evidence summed over carriers that Newton's method reaches from a place."""
    there = aligned(reference, place_m)
    for _ in range(_MAX_NEWTON_STEPS):
        slope, curvature = _derivatives(reference, there)
        variance, axes = np.linalg.eigh(curvature)
        step_m = axes @ (axes.T @ slope / abs(variance).clip(1e-6 * abs(variance).max() + 1e-30))
        gain = 0.0
        for share in (1.0, 0.3, 0.1, 0.03, 0.01):  # the largest part of the step that gains evidence
            moved = aligned(reference, place_m + share * step_m)
            gain = float(moved.evidence.sum() - there.evidence.sum())
            if gain > 0:
                place_m, there = place_m + share * step_m, moved
                break
        if gain < _SETTLED_GAIN:
            break
    return Candidate(place_m, there)


def _derivatives(reference: CrossTerms, there: Aligned) -> tuple[Vector, Float[FloatArray, "3 3"]]:
    """First and second derivatives of Σ_f |Σ_t x|² / Σ_t |x|² by the mirrored receiver's position, powers fixed."""
    gradient = there.gradient
    slope, curvature = np.zeros(3), np.zeros((3, 3))
    for term, power, radians_per_m in zip(there.term.T.astype(complex), there.power, reference.wavenumber, strict=True):
        total, bent = term.sum(), term / there.length_m
        first = 1j * radians_per_m * (term @ gradient)
        outer = (gradient * (radians_per_m * term + 1j * bent)[:, None]).T @ gradient
        second = radians_per_m * (1j * bent.sum() * np.eye(3) - outer)
        slope += 2 * (total.conj() * first).real / power
        curvature += 2 * (total.conj() * second + np.outer(first.conj(), first)).real / power
    return slope, curvature


def mirrored_receivers_m(
    reference: CrossTerms, generator: np.random.Generator | int, *, guesses: bool = False
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
            candidate
            for candidate in candidates
            if is_upright(candidate.place_m) and _is_wanted(reference, candidate.place_m)
        ]
        likely.sort(key=lambda candidate: candidate.score)
        chosen_m += [candidate.place_m * (1, 1, 0) for candidate in likely[-1:]]
    return np.array(chosen_m).reshape(-1, 3)


def accepted(reference: CrossTerms, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates whose evidence beats chance even without what stronger ones explain of it, strongest first."""
    enough = chance(reference)
    likely = [
        candidate
        for candidate in candidates
        if candidate.score > enough
        and _is_wanted(reference, candidate.place_m)
        and _needs_no_layer(reference, candidate)
    ]
    single = [candidate for candidate in likely if not _is_double(reference, candidate, likely)]
    planes: list[Candidate] = []
    scores: list[float] = []
    waves: list[_Wave] = []
    for candidate in sorted(single, key=lambda candidate: candidate.score, reverse=True):
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

    steering: Complex[PhasorArray, "T M"]
    aligned: Aligned


def _wave(reference: CrossTerms, planes_m: Sequence[Vector], place_m: Vector | None = None) -> _Wave:
    """The path over planes in order. Its lengths are those to `place_m` instead, if that is given."""
    source_m = reference.offset_m
    for plane_m in planes_m:
        source_m = mirrored(source_m, plane_m)
    if place_m is None:
        place_m = reduce(mirrored, reversed(planes_m), np.zeros(3))
    return _Wave(steering(reference, source_m), aligned(reference, place_m, source_m=source_m))


def _needs_no_layer(reference: CrossTerms, candidate: Candidate) -> bool:
    """Whether evidence remains if the transmitters of any one layer, all as far from the plane, are left out.

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


def chance(reference: CrossTerms) -> float:
    """The score that the best candidate exceeds with a small probability in a room without planes.

    The summed evidence of F carriers is then a gamma variable of shape F. The number of independent candidates is
    that of the places for the mirrored receiver, a wavelength of the highest carrier apart.
    """
    low_m, high_m = bounds_m(reference)
    num_places = float(np.prod((high_m - low_m) * reference.wavenumber[-1] / np.pi))
    return float(gammainccinv(len(reference.carrier_hz), _FALSE_ALARM / num_places))


def _leaked(reference: CrossTerms, mine: _Wave, other: _Wave) -> Float[FloatArray, "F"]:
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


def _is_double(reference: CrossTerms, candidate: Candidate, planes: Sequence[Candidate]) -> bool:
    """Whether a path over two other planes is as long and explains the directions of arrival better."""
    others = [plane for plane in planes if plane is not candidate]
    place_m = np.array([plane.place_m for plane in others]).reshape(-1, 3)
    double_m = np.array([mirrored(place_m, first_m) for first_m in place_m]).reshape(len(others), len(others), 3)
    apart_m = np.linalg.norm(double_m - candidate.place_m, axis=2)  # and a plane's double by itself is the receiver
    for pair in np.argwhere(apart_m <= MAX_TILT * np.linalg.norm(double_m, axis=2)).tolist():
        if not _is_near(reference, candidate.place_m, double_m[tuple(pair)]):
            continue
        first, second = (others[nth] for nth in pair)
        # of three planes parallel to it, an array cannot tell which is the double; the faintest is rejected
        is_faintest = candidate.score < min(first.score, second.score)
        wave = _wave(reference, [first.place_m, second.place_m], candidate.place_m)
        if score_of(wave.aligned.evidence) > (0.9 if is_faintest else 1.05) * candidate.score:
            return True
    return False


def _is_near(reference: CrossTerms, one_m: Vector, other_m: Vector) -> bool:
    """Whether the lengths to two mirrored receivers differ by a constant, within a turn at the median carrier."""
    if np.linalg.norm(one_m - other_m) > MAX_TILT * np.linalg.norm(other_m):
        return False
    return deviation_m(reference, one_m, other_m) * float(np.median(reference.wavenumber)) < 2 * np.pi


def missed(reference: CrossTerms, planes: Sequence[Candidate]) -> list[Candidate]:
    """Planes not found yet that would explain a found one as the path over themselves and another found plane."""
    enough = chance(reference) / 2
    found: list[Candidate] = []
    for double, plane in permutations(planes, 2):
        after_m = mirrored(double.place_m, plane.place_m)
        across_m = double.place_m - plane.place_m
        before_m = (double.place_m + plane.place_m) @ across_m / (across_m @ across_m) * across_m
        for place_m in (after_m, before_m):
            is_known = any(_is_near(reference, place_m, plane.place_m) for plane in [*planes, *found])
            if is_known or not _is_wanted(reference, place_m):
                continue
            if score_of(aligned(reference, place_m).evidence) > enough:
                found.append(settled(reference, place_m))
    return found


def is_upright(place_m: Vector) -> bool:
    """Whether the plane of a mirrored receiver is a wall, not a floor or a ceiling."""
    return abs(float(place_m[2])) < MAX_TILT * float(np.linalg.norm(place_m))


def _is_wanted(reference: CrossTerms, place_m: Vector) -> bool:
    """Whether a plane is upright or level and touches the box of transmitters and receiver."""
    height = abs(place_m[2]) / max(float(np.linalg.norm(place_m)), 1e-9)
    is_tilted = min(height, np.sqrt(1 - min(height, 1.0) ** 2)) > MAX_TILT
    return not is_tilted and bool(is_within_reach(reference, place_m[None], 0.0).all())
