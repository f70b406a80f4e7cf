from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import pytest

from xfreqbench.config import override
from xfreqbench.errors import MethodError, UnknownNameError


@dataclass(frozen=True)
class Config:
    hidden: int = 256
    rate: float = 1e-3
    spread: bool = True
    scale: Literal["log", "linear"] = "log"
    carriers: tuple[float, ...] = (1.0,)
    limit: int | None = None


def test_values_are_typed_from_the_fields() -> None:
    changed = override(
        Config(), ["hidden=128", "rate=2e-4", "spread=false", "scale=linear", "carriers=[1, 2.5]", "limit=7"]
    )
    assert changed == Config(128, 2e-4, False, "linear", (1.0, 2.5), 7)


def test_the_later_assignment_wins_and_the_original_stays() -> None:
    original = Config()
    assert override(original, ["hidden=1", "hidden=2"]).hidden == 2
    assert original == Config()


def test_an_unknown_key_names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'hidden'"):
        override(Config(), ["hiden=128"])


@pytest.mark.parametrize(
    "assignment", ["hidden=many", "hidden=1.5", "scale=cubic", "carriers=[1", "spread=2"]
)
def test_a_value_of_another_type_says_what_the_option_takes(assignment: str) -> None:
    with pytest.raises(MethodError, match=f"Option '{assignment.partition('=')[0]}' of Config takes"):
        override(Config(), [assignment])


def test_an_assignment_needs_a_value() -> None:
    with pytest.raises(MethodError, match="key=value"):
        override(Config(), ["hidden"])
