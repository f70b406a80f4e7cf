"""Compiled kernel: which paths boxes would hide."""

from __future__ import annotations

import numpy as np

from xfreqbench.system.kernels import entry
from xfreqbench.types import NDArray

Array = NDArray[np.float64]


@entry()
def hidden_by(box: Array, first: NDArray[np.int64], start: Array, way: Array) -> NDArray[np.bool_]:
    """Whether each of B boxes (B, 2, 3), lowest and highest corners, is met by each of P paths: (B, P).

    Path p runs along the segments first[p]:first[p + 1], from `start` (S, 3) by `way` (S, 3).
    """
    hidden = np.zeros((len(box), len(first) - 1), np.bool_)
    for b in range(len(box)):
        for p in range(len(first) - 1):
            for s in range(first[p], first[p + 1]):
                enters, leaves = 0.0, 1.0
                for a in range(3):
                    low, high = box[b, 0, a] - start[s, a], box[b, 1, a] - start[s, a]
                    if way[s, a] == 0.0:
                        leaves = leaves if low < 0.0 < high else -1.0
                    else:
                        one, other = low / way[s, a], high / way[s, a]
                        enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
                if enters < leaves:
                    hidden[b, p] = True
                    break
    return hidden
