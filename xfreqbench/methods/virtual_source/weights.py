"""How much of a predicted map the learned field gives, and how much the traced room: chosen on validation rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Maps
from xfreqbench.methods.learning.loss import mean_ssim
from xfreqbench.types import FloatArray

_OF_LEARNED = (0.0, 0.25, 0.5, 0.75, 1.0)
_NEAR_M, _NEAR_OCTAVES = 0.6, 2.0  # standard deviations of the distance at which a validation row counts
_ANYWHERE = 0.01  # what a validation row counts for at least
_STRIDE, _WINDOW = 3, 3  # of the SSIM by which maps are compared
_AT_ONCE = 32
_TINY = 1e-12  # peak of a map where no path arrives

Predict = Callable[[Float[FloatArray, "B 3"], Float[FloatArray, "B"]], Maps]


@dataclass(frozen=True, eq=False)
class LocalWeights:
    """The SSIM of n validation rows for each of W weights of the learned maps, `_OF_LEARNED`."""

    position_m: Float[FloatArray, "n 3"]
    carrier_hz: Float[FloatArray, "n"]
    similar: Float[FloatArray, "W n"]

    @classmethod
    def of(cls, rows: PasDataset, learned: Predict, traced: Predict) -> LocalWeights:
        """Compare the maps that both give for validation rows, in all mixtures."""
        similar = []
        for start in range(0, len(rows), _AT_ONCE):
            some = rows.subset(slice(start, start + _AT_ONCE))
            asked = some.tx_position_m, some.carrier_hz
            given = learned(*asked), traced(*asked), some.pas()
            maps, others, truth = (each[:, ::_STRIDE, ::_STRIDE] for each in given)
            for each in zip(maps, others, truth, strict=True):
                similar.append([_similarity(weight, *each) for weight in _OF_LEARNED])
        return cls(rows.tx_position_m, rows.carrier_hz, np.array(similar).reshape(-1, len(_OF_LEARNED)).T)

    def at(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[FloatArray, "B"]:
        """The weight of each learned map that is best at the validation rows nearby, in place and carrier.

        Of weights that are equally good it is the largest.
        """
        away_m = np.linalg.norm(tx_position_m[:, None] - self.position_m, axis=2)
        octaves = np.log2(carrier_hz[:, None] / self.carrier_hz)
        near = np.exp(-0.5 * ((away_m / _NEAR_M) ** 2 + (octaves / _NEAR_OCTAVES) ** 2))
        mean = (near + _ANYWHERE) @ self.similar.T[:, ::-1]
        return np.array(_OF_LEARNED[::-1])[mean.argmax(axis=1)]

    def as_json(self) -> dict[str, Any]:
        """All numbers, for `from_json`."""
        return {name: values.tolist() for name, values in vars(self).items()}

    @classmethod
    def from_json(cls, stored: dict[str, Sequence[Any]]) -> LocalWeights:
        """Inverse of `as_json`."""
        return cls(**{name: np.array(values, np.float64) for name, values in stored.items()})


def mixed(
    weight: Float[NDArray[np.float32], "B"], learned: Float[Maps, "B E A"], traced: Float[Maps, "B E A"]
) -> Float[Maps, "B E A"]:
    """The weighted means of maps, scaled to peak 1."""
    sums = weight[:, None, None] * learned + (1 - weight[:, None, None]) * traced
    return np.asarray(sums / sums.max(axis=(1, 2), keepdims=True), dtype=np.float32)


def _similarity(
    weight: float,
    learned: Float[NDArray[np.float32], "e a"],
    traced: Float[NDArray[np.float32], "e a"],
    truth: Float[NDArray[np.float32], "e a"],
) -> float:
    sums = weight * learned + (1 - weight) * traced
    shown, true = (
        torch.as_tensor(np.ascontiguousarray(each))[None] for each in (sums / max(sums.max(), _TINY), truth)
    )
    return float(mean_ssim(shown, true, _WINDOW, _STRIDE))
