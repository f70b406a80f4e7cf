"""Running means of weights."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from xfreqbench.methods.learning.training import averaged


def weights(value: float, size: int = 2) -> nn.Module:
    module = nn.Linear(size, 1, bias=False)
    nn.init.constant_(module.weight, value)
    return module


def test_a_step_of_the_weights_is_forgotten_at_the_rate_that_is_asked_for() -> None:
    kept, mean = 0.5, averaged(None, weights(1.0), 0.5)
    for _ in range(20):  # past the start, when the mean keeps less
        mean = averaged(mean, weights(1.0), kept)
    before = mean.module.weight[0, 0].item()
    for step in range(1, 4):
        mean = averaged(mean, weights(0.0), kept)
        assert mean.module.weight[0, 0].item() == pytest.approx(before * kept**step)


def test_the_mean_begins_anew_where_sizes_change() -> None:
    mean = averaged(averaged(None, weights(1.0), 0.9), weights(5.0, size=3), 0.9)
    torch.testing.assert_close(mean.module.weight, torch.full((1, 3), 5.0))
