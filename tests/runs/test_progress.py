from __future__ import annotations

from math import nan

from xfreqbench.methods.fitting import Fit
from xfreqbench.runs.progress import fit_state


def test_a_method_without_a_loss_shows_none() -> None:
    assert fit_state(Fit(1, nan, 0.2, 0.01)) == "step 1, 1% of the budget"
    assert fit_state(Fit(1200, 0.25, 3.0)) == "step 1,200, loss 0.25"
