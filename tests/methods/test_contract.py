from __future__ import annotations

import pytest

from xfreqbench.errors import MethodError
from xfreqbench.methods.contract import Budget, parse_budget


@pytest.mark.parametrize(
    ("text", "budget"),
    [
        (None, Budget()),
        ("300s", Budget(max_seconds=300)),
        ("0.5 m", Budget(max_seconds=30)),
        ("2h", Budget(max_seconds=7200)),
        ("2000steps", Budget(max_steps=2000)),
        ("500 maps", Budget(max_maps=500)),
        ("quick", Budget(max_maps=64_000)),
        ("minutes", Budget(max_seconds=300)),
    ],
)
def test_a_budget_is_read_with_its_unit(text: str | None, budget: Budget) -> None:
    assert parse_budget(text) == budget


@pytest.mark.parametrize("text", ["", "300", "0s", "0steps", "0.2steps", "2.5steps", "2.5maps", "-1s", "1d", "slow"])
def test_a_budget_without_a_unit_or_of_part_of_a_step_is_refused(text: str) -> None:
    with pytest.raises(MethodError, match="A budget is written as in 300s"):
        parse_budget(text)


@pytest.mark.parametrize(
    ("budget", "share"),
    [
        (Budget(), 0.0),
        (Budget(max_steps=8), 0.25),
        (Budget(max_seconds=4), 0.75),
        (Budget(max_steps=8, max_seconds=4), 0.75),
        (Budget(max_maps=100), 0.4),
    ],
)
def test_the_nearer_limit_says_how_much_of_a_budget_is_spent(budget: Budget, share: float) -> None:
    assert budget.share(step=2, seconds=3.0, maps=40) == share
