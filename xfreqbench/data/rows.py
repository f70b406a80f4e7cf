"""Which samples of a data set are meant: numbers, a slice or a mask."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from xfreqbench.types import NDArray

Rows = slice | Sequence[int] | NDArray[Any]  # of numbers, or a mask


def chosen_rows(rows: Any, num_samples: int) -> slice | NDArray[Any]:
    """The numbers (n,) of samples among `num_samples`, or a slice or a mask of all, as NumPy indexes by them.

    `rows` is one number, several, a slice or a mask; negative numbers count from the end. Raises `IndexError` that
    says what there is.
    """
    if isinstance(rows, slice):
        return rows
    numbers = np.asarray(rows)
    if not numbers.size:
        return np.zeros(0, np.int64)
    if numbers.dtype == bool and numbers.shape == (num_samples,):
        return numbers
    if numbers.ndim > 1 or not np.issubdtype(numbers.dtype, np.integer):
        given = f"{numbers.dtype} of shape {numbers.shape}" if numbers.ndim else reprlib.repr(rows)
        raise IndexError(
            f"Samples are chosen by whole numbers of shape (n,), or by a mask of shape ({num_samples},), but got "
            f"{given}."
        )
    numbers = np.atleast_1d(numbers)
    beyond = numbers[(numbers < -num_samples) | (numbers >= num_samples)]
    if beyond.size:
        there = f"samples 0 to {num_samples - 1}" if num_samples else "no samples"
        raise IndexError(f"There are {there}, but {beyond[0]} is asked for.")
    return numbers
