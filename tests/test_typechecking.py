"""Shapes and types are checked while tests run, at the first calls of a function in each test."""

from __future__ import annotations

import pytest
from jaxtyping import TypeCheckError

from tests.support.typechecking import CHECKS_TYPES, NUM_CHECKED
from xfreqbench.units import ghz_to_hz


@pytest.mark.skipif(not CHECKS_TYPES, reason="types are checked with CHECK_TYPES=1, as ./test.sh --all does")
@pytest.mark.parametrize("test", ["first", "second"])
def test_the_first_calls_of_a_test_are_checked(test: str) -> None:
    for _ in range(NUM_CHECKED):
        with pytest.raises(TypeCheckError, match="ghz_to_hz"):
            ghz_to_hz(complex(1))
    with pytest.raises(TypeError, match="complex"):
        ghz_to_hz(complex(1))
