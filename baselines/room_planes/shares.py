"""How much of each plane's reflection there is at a place, as the transmitters heard around it tell.

A plane may end, things may stand before it, and it may be none. So the sums over lags of what is heard are compared
with those that are predicted without planes, and least squares say what share of each plane's effect is in the
difference, where transmitters nearby count most. Few of them say little: then the shares are near zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from xfreqbench.types import FloatArray

_REACH_M = 1.5  # one standard deviation of the weights of transmitters
_DOUBT = 3.0  # transmitters that would have to say otherwise for a share not to be zero
_MOST = 1.2


@dataclass(frozen=True, eq=False)
class HeardShares:
    """Of T transmitters at `tx_m` the normal equations of the shares of P planes, summed over carriers."""

    tx_m: Float[FloatArray, "T 3"]
    gram: Float[FloatArray, "T P P"]
    product: Float[FloatArray, "T P"]

    @classmethod
    def of(
        cls,
        tx_m: Float[FloatArray, "T 3"],
        heard: Float[FloatArray, "T F L"],
        known: Float[FloatArray, "T F L"],
        effect: Float[FloatArray, "P T F L"],
        weight: Float[FloatArray, "L"],
    ) -> HeardShares:
        """From sums over lags: those heard, of unknown scale, those without planes, and what each plane adds to them.

        `weight` is what a lag counts.
        """
        root = np.sqrt(weight) / np.sqrt(heard**2 @ weight)[..., None]
        heard, known, effect = heard * root, known * root, effect * root
        power = (known**2).sum(axis=-1, keepdims=True)
        scale = (heard * known).sum(axis=-1, keepdims=True) / power
        effect = scale * (effect - (effect * known).sum(axis=-1, keepdims=True) / power * known)
        gram = np.einsum("ptfl,qtfl->tpq", effect, effect)
        return cls(tx_m, gram, np.einsum("ptfl,tfl->tp", effect, heard - scale * known))

    def at(self, place_m: Float[FloatArray, "B 3"]) -> Float[FloatArray, "B P"]:
        """The shares at some places, 0 to `_MOST`."""
        near = np.exp(-cdist(place_m, self.tx_m, "sqeuclidean") / (2 * _REACH_M**2))
        doubt = np.diag(_DOUBT * np.einsum("tpp->p", self.gram) / len(self.tx_m) + 1e-9)
        gram = np.tensordot(near, self.gram, 1) + doubt
        return np.linalg.solve(gram, (near @ self.product)[..., None])[..., 0].clip(0, _MOST)
