"""Cases that compare one thread with two."""

from __future__ import annotations

from collections.abc import Callable

from xfreqbench.splatting.composite_kernels import use_threads
from xfreqbench.stress.case import NothingToCompareError


def needing_two_threads(run: Callable[[], float]) -> Callable[[], float]:
    """`run`, which raises `NothingToCompareError` where Numba has one thread."""

    def run_on_two() -> float:
        before = use_threads(2)
        if use_threads(before) < 2:
            raise NothingToCompareError("Numba has one thread here, nothing to compare it with")
        return run()

    return run_on_two
