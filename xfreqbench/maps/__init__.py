"""Channels to power angular spectra: the grid of directions, Bartlett beams, and the scores of predicted maps.

In come channels (..., M) at the elements of an array, or two sets of maps (N, E, A) to compare; out go maps with
peak 1, or one score a map. `metrics` is offered here so that `xfreqbench.metrics` can be imported when it is used.
"""

import lazy_loader as lazy

__getattr__, *_ = lazy.attach(__name__, submodules=["metrics"])
