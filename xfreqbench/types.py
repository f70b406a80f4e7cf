"""Types that every layer shares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

Scalar = TypeVar("Scalar", bound=np.generic)
NDArray = np.ndarray[
    tuple[Any, ...], np.dtype[Scalar]
]  # numpy.typing's is lazy from NumPy 2.5 on: jaxtyping cannot see it
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Maps = NDArray[np.float32]  # (n, E, A), linear power in [0, 1], peak 1
ProgressCallback = Callable[[int, int], None]  # is called with the number that are done, and of all


def ignore_progress(done: int, total: int) -> None:
    """A progress callback that does nothing."""
