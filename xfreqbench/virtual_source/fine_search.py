"""Candidates followed from the lowest carrier to the highest, then uphill by all carriers together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.ndimage import maximum_filter

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import IntArray
from xfreqbench.virtual_source.coarse_search import MAX_TILT
from xfreqbench.virtual_source.line_of_sight import (
    MIN_EXCESS_CYCLES,
    Aligned,
    LineOfSightReference,
    PhasorArray,
    aligned,
    phasor,
)

_NUM_CANDIDATES = (300, 200, 120, 60, 40)  # after each carrier; the last is for all that follow
_NUM_BRANCHES = 3  # of a candidate, while carriers are few
_STEP_RAD, _REACH_RAD, _MAX_STEPS = 1.0, 1.4, 5  # of a local grid, by the joining and the last carrier
_SAME_PHASE_RAD = 1.5  # two planes are one where their phases differ by no more, root mean square
_CARRIER_CAP = 20.0  # a carrier says no more while candidates are ranked
_MAX_NEWTON_STEPS = 12
_SETTLED_GAIN = 1e-4  # of evidence


def refined_m(reference: LineOfSightReference, place_m: Float[FloatArray, "C 3"]) -> Float[FloatArray, "K 3"]:
    """Mirrored receivers followed from the lowest carrier to the highest, the best of them kept."""
    num_carriers = len(reference.carrier_hz)
    for joining in range(min(1, num_carriers - 1), num_carriers):
        branches = _NUM_BRANCHES if joining <= 2 else 1
        moved = [at for place in place_m for at in _local_maxima(reference, place, joining, branches)]
        place_m = _best(reference, np.array(moved).reshape(-1, 3), joining)
    return place_m


def _local_maxima(
    reference: LineOfSightReference, place_m: Float[FloatArray, "3"], joining: int, branches: int
) -> list[Float[FloatArray, "3"]]:
    """Best places near one by the joining carrier and the one before, on a grid in which phases are linear."""
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
    """Evidence at whole steps, the columns of `step_m`, from a place, summed over carriers."""
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
    """From −count to +count, of numbers of modulus 1."""
    ascending = (
        np.cumprod(np.tile(turn, (count, 1)), axis=0) if count else np.empty((0, len(turn)), turn.dtype)
    )
    return np.concatenate([ascending[::-1].conj(), np.ones((1, len(turn)), turn.dtype), ascending])


def _best(
    reference: LineOfSightReference, place_m: Float[FloatArray, "C 3"], joining: int
) -> Float[FloatArray, "K 3"]:
    """The best different ones by all carriers so far."""
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
    """Of the difference between lengths to two mirrored receivers, over all transmitters."""
    one, other = (np.linalg.norm(reference.offset_m - place, axis=1) for place in (one_m, other_m))
    return float(np.std(one - other))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A mirrored receiver, and the evidence there."""

    place_m: Float[FloatArray, "3"]
    aligned: Aligned

    @property
    def score(self) -> float:
        """See `score_of`."""
        return score_of(self.aligned.evidence)


def score_of(evidence: Float[FloatArray, "F"]) -> float:
    """The sum, in which no carrier counts for more than twice their median."""
    return float(np.minimum(evidence, 2 * np.median(evidence)).sum())


def settled(reference: LineOfSightReference, place_m: Float[FloatArray, "3"]) -> Candidate:
    """Where Newton's method leads from a place, up the sum of the evidence over carriers."""
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
    """After the longest part of a step that gains evidence, and how much it gains."""
    for share in (1.0, 0.3, 0.1, 0.03, 0.01):
        moved = aligned(reference, place_m + share * step_m)
        gain = float(moved.evidence.sum() - there.evidence.sum())
        if gain > 0:
            return place_m + share * step_m, moved, gain
    return place_m, there, 0.0


def _derivatives(
    reference: LineOfSightReference, there: Aligned
) -> tuple[Float[FloatArray, "3"], Float[FloatArray, "3 3"]]:
    """First and second of Σ_f |Σ_t x|² / Σ_t |x|² by the mirrored receiver's position, the powers held."""
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
