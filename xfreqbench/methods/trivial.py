"""The names of the predictors that learn nothing, to which every other method is compared."""

from __future__ import annotations

from xfreqbench.methods.contract import TRIVIAL

EVERY_TRIVIAL = (*TRIVIAL, "k-nearest", "mean-spectrum")  # records may be without the last two
