"""The training step of `xfreq-gs`: its time, and that of every part of it."""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor, autograd, nn

from xfreqbench.angles import AngularGrid
from xfreqbench.dataset import PasDataset
from xfreqbench.method import Budget, build_method
from xfreqbench.splatting.benchmark import REPEATS, Leaves, accumulated, least_s
from xfreqbench.splatting.composite import PixelLists
from xfreqbench.splatting.footprints import squared_distance
from xfreqbench.splatting.learned import MAX_GRADIENT_NORM, LearnedMethod
from xfreqbench.splatting.loss import map_loss
from xfreqbench.splatting.network import Attributes, PairwiseMLP, is_narrow
from xfreqbench.splatting.projection import Projection
from xfreqbench.splatting.splat import SplatField, renumbered, seen_of
from xfreqbench.splatting.view import Targets, View, as_kind

# the paper's width and depth, every direction, footprints of about 200 directions
PAPER_NETWORK = (
    "width=256",
    "layers=6",
    "stride=1",
    "ssim_window=7",
    "angular_size_deg=1.8",
    "max_gaussians=16000",
)


class Stopwatch:
    """Seconds between laps, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a part."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now


class Step:
    """The training step of `xfreq-gs` taken apart: the calls of `SplatField.power` and the training loop."""

    def __init__(self, train: PasDataset, settings: Sequence[str]) -> None:
        method = build_method("xfreq-gs", settings)
        self.config = method.config
        assert isinstance(method, LearnedMethod)
        training = method.started(train, seed=0)
        assert isinstance(training.field, SplatField)
        self.field, self.optimizer, self.beams = training.field, training.optimizer, training.beams
        self.kind = training.kind
        self.targets = Targets(train, self.beams)
        self.nth = torch.arange(self.config.batch_size) % len(self.targets)
        rows = self.targets.rows[self.nth.numpy()]
        self.tx_position_m = torch.as_tensor(train.tx_position_m[rows], dtype=torch.float32)
        self.carrier_hz = torch.as_tensor(train.carrier_hz[rows])
        self.view = View(self.config.stride)

    @property
    def grid(self) -> AngularGrid:
        """The directions in view."""
        return self.view.of_grid(self.beams.grid)

    def lists(self, projection: Projection) -> PixelLists:
        """Footprints of the directions in view."""
        return self.field.lists(projection, self.grid)

    def attributes(self, seen: Tensor) -> Attributes:
        """The network's answer for some of the Gaussians."""
        return self.field.attributes(self.tx_position_m, self.carrier_hz, seen)

    def maps(self, response: Complex[Tensor, "B K"]) -> Float[Tensor, "B E A"]:
        """Maps of the data's kind, peak 1."""
        power = torch.view_as_real(response).square().sum(-1).reshape(-1, *self.grid.shape)
        return as_kind(power, self.kind)

    def parts_s(self) -> dict[str, float]:
        """Seconds of every part of one step; gradients are cut where parts meet."""
        watch = Stopwatch()
        projection = self.field.projection()
        lists = self.lists(projection)
        watch.lap("projection and binning")
        distance = squared_distance(projection, lists, self.grid)
        seen = seen_of(lists)
        watch.lap("distances")
        attributes = self.attributes(seen)
        watch.lap("network, forward")
        free = _leaves(distance, attributes)
        response = accumulated(renumbered(lists, seen), free, "auto")
        watch.lap("composite, forward")
        truth = self.targets.maps(self.nth, self.view)
        watch.lap("targets")
        cut = response.detach().requires_grad_()
        loss = map_loss(self.maps(cut), truth, self.config.ssim_weight, self.config.ssim_window)
        watch.lap("loss, forward")
        (of_response,) = autograd.grad(loss, cut)
        watch.lap("loss, backward")
        inputs = [free.distance, free.inverse_spread, free.signal, free.attenuation]
        of_distance, *of_attributes = autograd.grad(response, inputs, of_response)
        watch.lap("composite, backward")
        autograd.backward(outputs_of(attributes), of_attributes)
        watch.lap("network, backward")
        distance.backward(of_distance)
        watch.lap("distances and projection, backward")
        self.update()
        watch.lap("optimiser")
        return watch.seconds

    def update(self) -> None:
        """Clip the gradients and take them, as the training loop does."""
        nn.utils.clip_grad_norm_(self.field.parameters(), MAX_GRADIENT_NORM)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)


def outputs_of(attributes: Attributes) -> tuple[Tensor, Tensor, Tensor]:
    """Inverse spread, signal and attenuation as accumulation takes them, (V, B) each."""
    signal = attributes.signal.reshape(attributes.attenuation.shape)
    return attributes.inverse_spread, signal, attributes.attenuation


def _leaves(distance: Tensor, attributes: Attributes) -> Leaves:
    return Leaves(*(tensor.detach().requires_grad_() for tensor in (distance, *outputs_of(attributes))))


@dataclass(frozen=True)
class StepCost:
    """One training step of the method itself, and its parts measured apart."""

    settings: tuple[str, ...]
    num_gaussians: int
    batch_size: int
    num_pairs: int
    step_s: float
    parts_s: dict[str, float]
    products_s: float  # what the network's matrix products alone take at this machine's measured rate

    @property
    def samples_per_s(self) -> float:
        """Rate of the whole step."""
        return self.batch_size / self.step_s

    def sample_ms(self, seconds: float) -> float:
        """Milliseconds a sample from seconds of a step."""
        return seconds / self.batch_size * 1e3


def step_cost(train: PasDataset, settings: Sequence[str]) -> StepCost:
    """Time the method's own loop, then the same step part by part."""
    step = Step(train, settings)
    with torch.no_grad():
        lists = step.lists(step.field.projection())
    step.parts_s()
    parts = min((step.parts_s() for _ in range(REPEATS)), key=lambda seconds: sum(seconds.values()))
    config = step.config
    sizes = config.num_gaussians, config.batch_size, len(lists.gaussian)
    products_s = _products_s(step.field.network.mlp, config.batch_size * int(seen_of(lists).sum()))
    return StepCost(tuple(settings), *sizes, loop_s(train, settings), parts, products_s)


def loop_s(train: PasDataset, settings: Sequence[str]) -> float:
    """Seconds of a step as `fit` does it, the loss as it is when its ramp has ended."""
    fit = build_method("xfreq-gs", settings).fit(train, Budget(), 0)
    assert isinstance(fit, Generator)
    next(fit)
    return least_s(lambda: fit.send(0.5))


def _products_s(mlp: PairwiseMLP, num_pairs: int, num_rows: int = 1 << 14) -> float:
    """Matrix products of hidden layers, forward and twice backward, each timed alone on warm memory."""
    kind = torch.bfloat16 if is_narrow(mlp.precision, torch.device("cpu")) else torch.float32
    seconds = 0.0
    for layer in mlp.hidden:
        assert isinstance(layer, nn.Linear)
        weight = layer.weight.detach().to(kind)
        rows = torch.ones(num_rows, weight.shape[1], dtype=kind)
        seconds += 3 * least_s(lambda rows=rows, weight=weight: rows @ weight.T)  # type: ignore[misc]
    return seconds * num_pairs / num_rows
