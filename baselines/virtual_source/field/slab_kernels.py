"""Compiled kernels: weighted sums of rows of a table, and their slopes, in one pass over float32."""

from __future__ import annotations

import numpy as np

from xfreqbench.system.kernels import entry
from xfreqbench.types import NDArray

F32 = NDArray[np.float32]


@entry(fastmath={"contract", "reassoc"})
def sum_rows(table: F32, rows: NDArray[np.int64], weight: F32) -> F32:
    """Σ_k weight[n, k] · table[rows[n, k]] for all n: (n, C), of a table (R, C) and rows and weights (n, K)."""
    total = np.zeros((len(rows), table.shape[1]), np.float32)
    for n in range(len(rows)):
        for k in range(rows.shape[1]):
            for c in range(table.shape[1]):
                total[n, c] += weight[n, k] * table[rows[n, k], c]
    return total


@entry(fastmath={"contract", "reassoc"})
def slopes_of_rows(table: F32, rows: NDArray[np.int64], weight: F32, slope: F32) -> tuple[F32, F32]:
    """The slopes by the table and by the weights, from those by the sums of `sum_rows` (n, C)."""
    of_table, of_weight = np.zeros_like(table), np.zeros_like(weight)
    for n in range(len(rows)):
        for k in range(rows.shape[1]):
            row, summed = rows[n, k], np.float32(0)
            for c in range(table.shape[1]):
                of_table[row, c] += weight[n, k] * slope[n, c]
                summed += table[row, c] * slope[n, c]
            of_weight[n, k] = summed
    return of_table, of_weight
