"""Fine search: candidates are followed from the lowest carrier to the highest, then improved on all together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.ndimage import maximum_filter

from xfreqbench.system.machine import one_blas_thread
from xfreqbench.types import FloatArray, IntArray

from .coarse import MAX_TILT
from .cross_terms import (
    MIN_EXCESS_CYCLES,
    Aligned,
    LineOfSightReference,
    PhasorArray,
    aligned,
    phasor,
)

_NUM_CANDIDATES = (
    300,
    200,
    120,
    60,
    40,
)  # kept after each carrier; the last number holds for all that follow
_NUM_BRANCHES = 3  # maxima that are followed from one candidate, while carriers are few
_STEP_RAD, _REACH_RAD, _MAX_STEPS = (
    1.0,
    1.4,
    5,
)  # of a local grid: step at the new carrier, reach at the one before
_SAME_PHASE_RAD = 1.5  # two candidates are the same where their phases differ less, root mean square
_CARRIER_CAP = 20.0  # most evidence of one carrier that counts in the ranking of candidates
_MAX_NEWTON_STEPS = 12
_SETTLED_GAIN = 1e-4  # evidence gained by a step; with less, the search ends


def refined_m(reference: LineOfSightReference, place_m: Float[FloatArray, "C 3"]) -> Float[FloatArray, "K 3"]:
    """Mirrored receivers followed from the lowest carrier to the highest; the best of them are kept."""
    num_carriers = len(reference.carrier_hz)
    with one_blas_thread():
        for joining in range(min(1, num_carriers - 1), num_carriers):
            branches = _NUM_BRANCHES if joining <= 2 else 1
            moved = [at for place in place_m for at in _local_maxima(reference, place, joining, branches)]
            place_m = _best(reference, np.array(moved).reshape(-1, 3), joining)
    return place_m


def _local_maxima(
    reference: LineOfSightReference, place_m: Float[FloatArray, "3"], joining: int, branches: int
) -> list[Float[FloatArray, "3"]]:
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
    there: Aligned,
    wavenumber: Float[FloatArray, "K"],
    step_m: Float[FloatArray, "3 3"],
    num_steps: Int[IntArray, "3"],
) -> Float[FloatArray, "I J L"]:
    """Evidence summed over carriers on a grid around a place; its steps are the columns of `step_m`."""
    longer_m = there.gradient @ step_m
    total = np.zeros(2 * num_steps + 1)
    for term, power, radians_per_m in zip(there.term.T, there.power, wavenumber, strict=True):
        turned = phasor(longer_m * (radians_per_m / (2 * np.pi)))
        first, second, third = (
            _powers(turn, count) for turn, count in zip(turned.T, num_steps.tolist(), strict=True)
        )
        pairs = (first * term)[:, None] * second
        sums = pairs.reshape(-1, len(term)) @ third.T
        total += (abs(sums) ** 2).reshape(total.shape) / power
    return total


def _powers(turn: Complex[PhasorArray, "T"], count: int) -> Complex[PhasorArray, "N T"]:
    """Powers with exponents from −count to +count of numbers of modulus 1."""
    ascending = (
        np.cumprod(np.tile(turn, (count, 1)), axis=0) if count else np.empty((0, len(turn)), turn.dtype)
    )
    return np.concatenate([ascending[::-1].conj(), np.ones((1, len(turn)), turn.dtype), ascending])


def _best(
    reference: LineOfSightReference, place_m: Float[FloatArray, "C 3"], joining: int
) -> Float[FloatArray, "K 3"]:
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
    kept: list[Float[FloatArray, "3"]] = []
    for index in np.argsort(-evidence):
        reference.require_time()
        if len(kept) == limit:
            break
        if not any(_is_same(reference, place_m[index], other, wavenumber) for other in kept):
            kept.append(place_m[index])
    return np.array(kept).reshape(-1, 3)


def _is_same(
    reference: LineOfSightReference,
    one_m: Float[FloatArray, "3"],
    other_m: Float[FloatArray, "3"],
    wavenumber: float,
) -> bool:
    """Whether the lengths to two mirrored receivers differ by a constant, as far as phases tell."""
    if np.linalg.norm(one_m - other_m) > MAX_TILT * np.linalg.norm(one_m) + 2 / wavenumber * 2 * np.pi:
        return False
    return deviation_m(reference, one_m, other_m) * wavenumber < _SAME_PHASE_RAD


def deviation_m(
    reference: LineOfSightReference, one_m: Float[FloatArray, "3"], other_m: Float[FloatArray, "3"]
) -> float:
    """Standard deviation over transmitters of the difference between their distances to two mirrored receivers."""
    one, other = (np.linalg.norm(reference.offset_m - place, axis=1) for place in (one_m, other_m))
    return float(np.std(one - other))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place of the mirrored receiver, and the cross terms aligned for it."""

    place_m: Float[FloatArray, "3"]
    aligned: Aligned

    @property
    def score(self) -> float:
        """The `score_of` its evidence."""
        return score_of(self.aligned.evidence)


def score_of(evidence: Float[FloatArray, "F"]) -> float:
    """Sum of the carriers' evidence, in which none counts for more than twice their median."""
    return float(np.minimum(evidence, 2 * np.median(evidence)).sum())


def settled(reference: LineOfSightReference, place_m: Float[FloatArray, "3"]) -> Candidate:
    """The local maximum of the evidence summed over carriers that Newton's method reaches from a place."""
    there = aligned(reference, place_m)
    for _ in range(_MAX_NEWTON_STEPS):
        slope, curvature = _derivatives(reference, there)
        variance, axes = np.linalg.eigh(curvature)
        step_m = axes @ (axes.T @ slope / abs(variance).clip(1e-6 * abs(variance).max() + 1e-30))
        place_m, there, gain = _climbed(reference, place_m, there, step_m)
        if gain < _SETTLED_GAIN:
            break
    return Candidate(place_m, there)


def _climbed(
    reference: LineOfSightReference,
    place_m: Float[FloatArray, "3"],
    there: Aligned,
    step_m: Float[FloatArray, "3"],
) -> tuple[Float[FloatArray, "3"], Aligned, float]:
    """Place and cross terms after the largest tried part of a step that gains evidence, and the gain; 0 for none."""
    for share in (1.0, 0.3, 0.1, 0.03, 0.01):
        moved = aligned(reference, place_m + share * step_m)
        gain = float(moved.evidence.sum() - there.evidence.sum())
        if gain > 0:
            return place_m + share * step_m, moved, gain
    return place_m, there, 0.0


def _derivatives(
    reference: LineOfSightReference, there: Aligned
) -> tuple[Float[FloatArray, "3"], Float[FloatArray, "3 3"]]:
    """First and second derivatives of Σ_f |Σ_t x|² / Σ_t |x|² by the mirrored receiver's position, powers fixed."""
    gradient = there.gradient
    slope, curvature = np.zeros(3), np.zeros((3, 3))
    for term, power, radians_per_m in zip(
        there.term.T.astype(complex), there.power, reference.wavenumber, strict=True
    ):
        total, bent = term.sum(), term / there.length_m
        first = 1j * radians_per_m * (term @ gradient)
        outer = (gradient * (radians_per_m * term + 1j * bent)[:, None]).T @ gradient
        second = radians_per_m * (1j * bent.sum() * np.eye(3) - outer)
        slope += 2 * (total.conj() * first).real / power
        curvature += 2 * (total.conj() * second + np.outer(first.conj(), first)).real / power
    return slope, curvature
