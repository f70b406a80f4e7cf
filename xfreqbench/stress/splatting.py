"""Splatting: long products, footprints and projections at their edges."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from xfreqbench.splatting import stress as torch_cases
from xfreqbench.splatting.composite import Backend
from xfreqbench.stress.case import Case
from xfreqbench.stress.threads import needing_two_threads

_N = torch_cases.NUM_FACTORS
_BACKENDS: tuple[Backend, ...] = ("torch", "numba")
# every factor may add a rounding: 10,000 · 6e-8 in float32, numba's precision, 10,000 · 1.1e-16 in float64
_LONG = {"numba": _N * 6e-8, "torch": _N * 1.1e-16}
# some roundings of 6e-8
_SINGLE = 1e-6
_NAMES = {
    "clear": "of exactly 1",
    "opaque": "of 0",
    "denormal": "of 1e-42 and 1e-310",
    "turning": "of modulus 1, any phase",
    "reversing": "of −1",
    "any": "of any modulus and phase",
}
_SEAM_DEG = [(0.0, 10.0), (359.9999, 20.0), (-1e-7, 30.0), (180.0, 5.0), (360.0, 0.0)]


def _long_product(which: int, backend: Backend) -> Case:
    kind, is_full = torch_cases.LISTS[which]
    name = f"{_N:,} attenuations {_NAMES[kind]}, {'G = 1' if is_full else 'G < 1'}, {backend}"
    run = partial(torch_cases.long_product, which, backend)
    return Case(name, "composite", _LONG[backend], "relative", run)


def _both(name: str, limit: float, unit: str, run: Callable[[Backend], float]) -> tuple[Case, ...]:
    return tuple(
        Case(f"{name}, {backend}", "composite", limit, unit, partial(run, backend)) for backend in _BACKENDS
    )


_COMPOSITE = (
    *(_long_product(which, backend) for which in range(len(torch_cases.LISTS)) for backend in _BACKENDS),
    *_both(f"{_N:,} attenuations of a half: underflow", _SINGLE, "relative", torch_cases.underflow),
    # kernels keep G at 2^−124, and gradients of 1/λ are a distance of 1e12 times that
    *_both("footprints 1e12 deviations² away", 1e-25, "absolute", torch_cases.far_outside),
    *_both("directions without a Gaussian", 0, "absolute", torch_cases.no_gaussians),
    Case("one thread and two", "composite", _SINGLE, "relative", needing_two_threads(torch_cases.threads)),
)
_FOOTPRINTS = (
    Case(
        "at the zenith",
        "footprints",
        0,
        "pairs",
        partial(
            torch_cases.footprints,
            [(10.0, 90.0), (200.0, 89.5), (0.0, 88.0)],
            [(30.0, 1.0), (5.0, 5.0), (100.0, 0.5)],
        ),
    ),
    Case(
        "at the azimuth's seam",
        "footprints",
        0,
        "pairs",
        partial(torch_cases.footprints, _SEAM_DEG, [(3.0, 2.0), (0.5, 0.5)]),
    ),
    Case(
        "a turn wide, a little less and more",
        "footprints",
        0,
        "pairs",
        partial(torch_cases.footprints, _SEAM_DEG, [(59.9, 3.0), (60.1, 3.0)]),
    ),
    Case(
        "smaller than the grid",
        "footprints",
        0,
        "pairs",
        partial(
            torch_cases.footprints,
            [(0.0, 10.0), (17.2, 33.3), (17.5, 33.5)],
            [(0.1, 0.1), (1e-3, 1e-3), (0.1, 2.0)],
        ),
    ),
    Case(
        "behind the horizon",
        "footprints",
        0,
        "pairs",
        partial(
            torch_cases.footprints,
            [(0.0, -90.0), (40.0, -3.0), (80.0, -3.1), (300.0, -30.0)],
            [(1.0, 1.0), (9.0, 1.0), (1.0, 9.99)],
        ),
    ),
    Case("larger than the sphere", "footprints", 0, "directions", torch_cases.directions_of_everything),
    # up to 360 per rad² times 2 · 3e-7 rad, the rounding of π, of roots of distances of 1e-3 and more
    Case("distances across the seam", "footprints", 1e-4, "relative", torch_cases.seam),
)
_PROJECTION = (
    Case(
        "Gaussians of all places, sizes, and zero quaternions",
        "projection",
        0,
        "values",
        torch_cases.strange_gaussians,
    ),
    # moved 2 µm to have an azimuth, seen from 3 m
    Case("Gaussian exactly at the zenith", "projection", 1e-6, "rad", partial(torch_cases.pole, 3.0)),
    Case("Gaussian exactly at the nadir", "projection", 1e-6, "rad", partial(torch_cases.pole, -3.0)),
    Case("Jacobian up to 1.1° from the pole", "projection", _SINGLE, "relative", torch_cases.jacobian),
    Case(
        "Jacobian within 1° of the pole", "projection", _SINGLE, "relative", torch_cases.jacobian_at_the_pole
    ),
    Case("covariances of 1e-8 to 1e4 m", "projection", 5 * _SINGLE, "relative", torch_cases.extreme_scales),
    Case("quaternions of length 0, 1e-6, 1e6", "projection", _SINGLE, "absolute", torch_cases.quaternions),
    Case("Gaussian without extent", "projection", _SINGLE, "relative", torch_cases.smallest_footprint),
)
CASES = _COMPOSITE + _FOOTPRINTS + _PROJECTION
