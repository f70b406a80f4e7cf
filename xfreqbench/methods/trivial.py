"""The names of the predictors that learn nothing, to which every other method is compared."""

from __future__ import annotations

# without these nothing is ranked
NEEDED_TRIVIAL = ("line-of-sight", "nearest", "mean-over-frequency", "log-frequency")
EVERY_TRIVIAL = (*NEEDED_TRIVIAL, "k-nearest", "mean-spectrum")  # records may be without the last two
