"""What a checkpoint holds of Adam is taken only where it is what Adam makes."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from xfreqbench.errors import MethodError
from xfreqbench.methods.learning.stored import ADAM, moments_of, require_moments


@pytest.fixture
def stored() -> dict[str, Tensor]:
    """Adam's own state after a step of a layer of 3 × 2."""
    layer = nn.Linear(2, 3, bias=False)
    optimizer = torch.optim.Adam(layer.parameters(), fused=True)
    layer(torch.ones(2)).sum().backward()
    optimizer.step()
    moments = moments_of(layer, optimizer)
    return {key: moments[f"adam.{key}.weight"] for key in ADAM}


def test_what_adam_makes_is_taken(stored: dict[str, Tensor]) -> None:
    require_moments("weight", nn.Parameter(torch.zeros(3, 2)), stored)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("step", torch.tensor(1.0, dtype=torch.float64)),
        ("step", torch.ones(1)),
        ("exp_avg", torch.zeros(3, 2, dtype=torch.float64)),
        ("exp_avg_sq", torch.zeros(2, 3)),
        ("exp_avg", None),
        ("max_exp_avg_sq", torch.zeros(3, 2)),
    ],
)
def test_other_moments_are_refused_by_the_parameters_name(
    stored: dict[str, Tensor], key: str, value: Tensor | None
) -> None:
    changed = {**stored, key: value}
    kept = {name: tensor for name, tensor in changed.items() if tensor is not None}
    with pytest.raises(MethodError, match=r"The moments of weight are not .* \(3, 2\)"):
        require_moments("weight", nn.Parameter(torch.zeros(3, 2)), kept)
