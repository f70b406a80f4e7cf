"""How much of a predicted map the learned field gives, and how much the traced room: chosen on validation rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.mixing import WEIGHTS, Predict, similarities_by_weight
from xfreqbench.types import FloatArray

_NEAR_M, _NEAR_OCTAVES = 0.6, 2.0  # standard deviations of the distance at which a validation row counts
_ANYWHERE = 0.01  # what a validation row counts for at least
_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class LocalWeights:
    """The SSIM of n validation rows for each of W weights of the learned maps, `WEIGHTS`."""

    position_m: Float[FloatArray, "n 3"]
    carrier_hz: Float[FloatArray, "n"]
    similar: Float[FloatArray, "W n"]

    @classmethod
    def of_each(cls, rows: PasDataset, learned: Predict, traced: Sequence[Predict]) -> list[LocalWeights]:
        """For each of several traced rooms, the comparison with the learned maps of validation rows."""
        similar = [[np.zeros((len(WEIGHTS), 0))] for _ in traced]
        for start in range(0, len(rows), _AT_ONCE):
            some = rows.subset(slice(start, start + _AT_ONCE))
            asked = some.tx_position_m, some.carrier_hz
            maps, truth = learned(*asked), some.pas()
            for parts, own in zip(similar, traced, strict=True):
                parts.append(similarities_by_weight(maps, own(*asked), truth))
        return [cls(rows.tx_position_m, rows.carrier_hz, np.concatenate(parts, axis=1)) for parts in similar]

    @property
    def of_traced(self) -> float:
        """Mean SSIM of the traced maps alone."""
        return float(self.similar[0].mean())

    @property
    def of_mixed(self) -> float:
        """Mean SSIM of maps that are mixed by these weights, at the rows by which they are chosen."""
        chosen = np.searchsorted(WEIGHTS, self.at(self.position_m, self.carrier_hz))
        return float(self.similar[chosen, np.arange(len(chosen))].mean())

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
        return np.array(WEIGHTS[::-1])[mean.argmax(axis=1)]

    def as_json(self) -> dict[str, Any]:
        """All numbers, for `from_json`."""
        return {name: values.tolist() for name, values in vars(self).items()}

    @classmethod
    def from_json(cls, stored: dict[str, Sequence[Any]]) -> LocalWeights:
        """Inverse of `as_json`."""
        return cls(**{name: np.array(values, np.float64) for name, values in stored.items()})
