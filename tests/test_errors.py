from __future__ import annotations

import pickle

import pytest

from xfreqbench.errors import DataError, DivergenceError, UnknownNameError, XFreqBenchError


@pytest.mark.parametrize(
    "error",
    [
        DataError("damaged"),
        UnknownNameError("method", "nearst", ["nearest", "xfreq-gs"]),
        DivergenceError(7, "loss", "Lower it."),
    ],
)
def test_an_error_says_the_same_in_another_process(error: XFreqBenchError) -> None:
    arrived = pickle.loads(pickle.dumps(error))
    assert type(arrived) is type(error)
    assert str(arrived) == str(error)
    assert getattr(arrived, "step", None) == getattr(error, "step", None)
