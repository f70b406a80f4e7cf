"""Running means of weights over the steps of a training."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel


def mean_weights(model: nn.Module, kept: float) -> AveragedModel:
    """A running mean of a model's weights, which keeps the share `kept` of itself at a step, and less at the start."""

    def update(means: Any, weights: Any, number: Any) -> None:
        torch._foreach_lerp_(means, weights, 1 - min(kept, (1 + int(number)) / (10 + int(number))))

    return AveragedModel(model, multi_avg_fn=update)


def averaged(mean: AveragedModel | None, model: nn.Module, kept: float) -> AveragedModel:
    """The mean after another step; it begins anew where there is none, or where the model has other sizes."""
    if mean is None or _sizes(mean.module) != _sizes(model):
        mean = mean_weights(model, kept)
    mean.update_parameters(model)
    return mean


def _sizes(model: nn.Module) -> dict[str, torch.Size]:
    return {name: value.shape for name, value in model.state_dict().items()}
