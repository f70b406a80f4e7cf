"""Density control: Gaussians that contribute little are dropped, those with large position gradients divided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Inexact, Int
from pydantic import Field as Limits
from torch import Tensor, nn
from typing_extensions import Doc

from xfreqbench.methods.splatting.gaussians import RFGaussians, Seen


@dataclass(frozen=True)
class DensityConfig:
    """Options: when Gaussians are divided and dropped, and how many there may be."""

    max_gaussians: Annotated[int, Limits(ge=1), Doc("most Gaussians that there may be")] = 384
    densify_every: Annotated[int, Limits(ge=0), Doc("steps between divisions of Gaussians; 0: never")] = 200
    densify_until: Annotated[float, Limits(ge=0, le=1), Doc("share of budget until which they divide")] = 0.5
    growth: Annotated[float, Limits(ge=0), Doc("share of the Gaussians that is added each time")] = 0.1
    prune_below: Annotated[float, Limits(ge=0), Doc("contribution of those dropped, of the mean")] = 0.01


class DensityControl(nn.Module):
    """Sums over steps of each Gaussian's contribution |S · ∂L/∂S| and of the pull |∂L/∂μ| on its position."""

    contribution: Tensor
    pull: Tensor

    def __init__(self, config: DensityConfig) -> None:
        super().__init__()
        self.config = config
        self._watched: tuple[Seen, Tensor] | None = None
        self.register_buffer("contribution", torch.zeros(0))
        self.register_buffer("pull", torch.zeros(0))

    def resize(self, num_gaussians: int) -> None:
        """Reset the sums, for another number of Gaussians."""
        self.contribution = self.contribution.new_zeros(num_gaussians)
        self.pull = self.pull.new_zeros(num_gaussians)

    def watch(self, seen: Seen, signal: Inexact[Tensor, "Q V B"]) -> None:
        """Remember the signals of the Gaussians `seen`, whose gradients are read after the step."""
        if signal.requires_grad and self.config.densify_every:
            signal.retain_grad()
            self._watched = (seen, signal)

    @torch.no_grad()
    def after_step(self, gaussians: RFGaussians, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        """Add to the sums; every `densify_every` steps, divide and drop Gaussians by them."""
        if not self.config.densify_every or self._watched is None or share >= self.config.densify_until:
            self._watched = None
            return
        if len(self.contribution) != len(gaussians):
            self.resize(len(gaussians))
        seen, signal = self._watched
        self._watched = None
        if signal.grad is not None and gaussians.position_m.grad is not None:
            self.contribution[seen] += (signal * signal.grad.conj()).abs().sum(dim=(0, 2))
            self.pull += gaussians.position_m.grad.norm(dim=-1)
        if step % self.config.densify_every == 0:
            self._renew(gaussians, optimizer)

    def _renew(self, gaussians: RFGaussians, optimizer: torch.optim.Adam) -> None:
        """Drop Gaussians with small contributions and divide those that are pulled most; reset the sums."""
        kept = self.contribution >= self.config.prune_below * self.contribution.mean()
        room = self.config.max_gaussians - int(kept.sum())
        number = max(0, min(room, int(self.config.growth * len(gaussians)) + int((~kept).sum())))
        pull = torch.where(kept, self.pull, -torch.inf)
        divided = pull.topk(min(number, int(kept.sum()))).indices
        _replace(gaussians, optimizer, torch.nonzero(kept)[:, 0], divided)
        self.resize(len(gaussians))


def _replace(
    gaussians: RFGaussians, optimizer: torch.optim.Adam, kept: Int[Tensor, "K"], divided: Int[Tensor, "D"]
) -> None:
    """Keep some Gaussians; divide others into two smaller ones, one deviation apart along the longest axis."""
    values, vectors = torch.linalg.eigh(gaussians.covariance)
    shift_m = (vectors[:, :, -1] * values[:, -1:].clamp_min(0).sqrt())[divided]
    # the log of 1.65, by which a divided Gaussian shrinks in 3-D Gaussian splatting
    gaussians.log_scale[divided] -= 0.5
    gaussians.position_m[divided] += shift_m / 2
    chosen = torch.cat([kept, divided])
    for name, parameter in list(gaussians.named_parameters()):
        renewed = nn.Parameter(parameter.detach()[chosen].clone())
        if name == "position_m":
            renewed.data[len(kept) :] -= shift_m
        _move_moments(optimizer, parameter, renewed, kept, len(divided))
        setattr(gaussians, name, renewed)


def _move_moments(
    optimizer: torch.optim.Adam, old: nn.Parameter, new: nn.Parameter, kept: Int[Tensor, "K"], num_new: int
) -> None:
    """Replace a parameter in the optimiser; the moments of the added Gaussians start at zero."""
    for group in optimizer.param_groups:
        group["params"] = [new if parameter is old else parameter for parameter in group["params"]]
    state = optimizer.state.pop(old, {})
    for key in ("exp_avg", "exp_avg_sq"):
        if key in state:
            moments = state[key]
            state[key] = torch.cat([moments[kept], moments.new_zeros(num_new, *moments.shape[1:])])
    if state:
        optimizer.state[new] = state
