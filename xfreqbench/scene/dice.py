"""Random numbers of a seed that are the same on every machine: the raw bits of PCG64, which NumPy keeps the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")


class Dice:
    """Random numbers of one stream of a seed."""

    def __init__(self, seed: int, stream: int = 0) -> None:
        self._bits = np.random.PCG64([seed, stream])

    def share(self) -> float:
        """A number from 0 to below 1."""
        return float((int(self._bits.random_raw()) >> 11) * 2.0**-53)

    def between(self, span: tuple[float, float]) -> float:
        """A number of a span."""
        return span[0] + (span[1] - span[0]) * self.share()

    def whole(self, span: tuple[int, int]) -> int:
        """A whole number of a span, both ends included."""
        return span[0] + int(self.share() * (span[1] - span[0] + 1))

    def one_of(self, items: Sequence[Item]) -> Item:
        """One of some items."""
        return items[self.whole((0, len(items) - 1))]
