"""Trivial predictor: one map for each carrier, the mean over all training transmitters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.lookup import TransmitterLookup
from xfreqbench.types import FloatArray, NDArray

_BATCH = 256  # maps in memory


class MeanSpectrum(TransmitterLookup):
    """Averages the maps of all training transmitters at the training carrier nearest on a logarithmic axis.

    Where a transmitter stands does not matter: it is what a method scores that knows the room alone.
    """

    def __init__(self, config: Any = None) -> None:
        super().__init__(config)
        self._means: dict[int, Float[NDArray[np.float32], "E A"]] = {}

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Remember which rows were trained on."""
        self._means.clear()
        yield from super().fit(train, budget, seed)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """For each query, the mean map of a training carrier, scaled to peak 1."""
        octaves = np.abs(np.log2(self.transmitters.carrier_hz / carrier_hz[:, None]))
        return np.stack([self._mean(nearest) for nearest in octaves.argmin(axis=1).tolist()])

    def _mean(self, carrier: int) -> Float[NDArray[np.float32], "E A"]:
        """The mean map of a training carrier, by its number; computed when it is first asked for."""
        if carrier not in self._means:
            train = self.transmitters.train
            at_carrier = train[train.carrier_hz == self.transmitters.carrier_hz[carrier]]
            parts = (at_carrier[start : start + _BATCH] for start in range(0, len(at_carrier), _BATCH))
            total = sum(part.pas().sum(axis=0, dtype=np.float64) for part in parts)
            self._means[carrier] = self.transmitters.turned(np.asarray(total))
        return self._means[carrier]
