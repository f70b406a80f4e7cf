"""The network that is applied to all pairs of a query and a Gaussian."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import linear, relu

from xfreqbench.methods.learning.network import PairwiseMLP


@pytest.mark.parametrize(("kind", "tolerance"), [(torch.float64, 1e-12), (torch.bfloat16, 0.05)])
def test_layers_on_pairs_have_the_values_and_gradients_of_plain_layers(kind: torch.dtype, tolerance: float) -> None:
    torch.manual_seed(0)
    network = PairwiseMLP(1, 1, 0, [8, 16, 16], 3, "float32").double()
    given = torch.randn(5, 7, 8, dtype=torch.float64).to(kind).requires_grad_()  # a copy, since layers overwrite it
    answers = []
    for fast in (True, False):
        network.zero_grad()
        if fast:
            outputs = network.after_first(given.clone()).double()
        else:
            features = relu(given.double())
            for layer in network.hidden:
                features = relu(linear(features, layer.weight, layer.bias))
            outputs = linear(features, network.head.weight, network.head.bias)
        slopes = torch.autograd.grad(
            outputs.sin().sum(), [given, *network.hidden.parameters(), *network.head.parameters()]
        )
        answers.append([outputs.detach(), *slopes])
    for found, expected in zip(*answers, strict=True):
        error = (found.double() - expected.double()).norm() / expected.double().norm()
        assert float(error) < tolerance  # bfloat16 has eight bits
