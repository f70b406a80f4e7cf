"""Measures the training step of `xfreq-gs-paper`: its time, and that of each of its parts."""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float
from torch import Tensor, autograd, nn

from xfreqbench.bench.splatting import REPEATS, Leaves, accumulated, least_s
from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.methods.learning.network import Attributes, PairwiseMLP, WideFreqNetwork, is_narrow
from xfreqbench.methods.learning.targets import GridView, Targets, as_kind
from xfreqbench.methods.learning.training import MAX_GRADIENT_NORM, LearnedMethod
from xfreqbench.methods.registry import build_method
from xfreqbench.methods.splatting.composite import PixelLists
from xfreqbench.methods.splatting.field import SplatField, renumbered, seen_of
from xfreqbench.methods.splatting.footprints import squared_distance
from xfreqbench.methods.splatting.projection import Projection

METHOD = "xfreq-gs-paper"


class LapTimer:
    """Sums of seconds between laps, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the time since the last lap to a part."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now


class Step:
    """The training step of `xfreq-gs-paper` in parts: the calls that its field and the training loop make."""

    def __init__(self, train: PasDataset, settings: Sequence[str]) -> None:
        method = build_method(METHOD, settings)
        self.config = method.config
        assert isinstance(method, LearnedMethod)
        training = method.started(train, seed=0)
        assert isinstance(training.field, SplatField)
        assert isinstance(training.field.network, WideFreqNetwork)
        self.network = training.field.network
        self.field, self.optimizer, self.beams = training.field, training.optimizer, training.beams
        self.kind = training.kind
        self.targets = Targets(train, self.beams)
        self.nth = torch.arange(self.config.batch_size) % len(self.targets)
        rows = self.targets.rows[self.nth.numpy()]
        self.tx_position_m = torch.as_tensor(train.tx_position_m[rows], dtype=torch.float32)
        self.carrier_hz = torch.as_tensor(train.carrier_hz[rows])
        self.view = GridView(self.config.stride)

    @property
    def grid(self) -> AngularGrid:
        """The grid of directions in view."""
        return self.view.of_grid(self.beams.grid)

    def lists(self, projection: Projection) -> PixelLists:
        """Which directions in view see which Gaussians."""
        return self.field.lists(projection, self.grid)

    def attributes(self, seen: Tensor) -> Attributes:
        """The network's outputs for the Gaussians `seen`."""
        return self.field.attributes(self.tx_position_m, self.carrier_hz, seen)

    def maps(self, response: Complex[Tensor, "B K"]) -> Float[Tensor, "B E A"]:
        """Maps of the data's kind with peak 1, from the field in view."""
        power = torch.view_as_real(response).square().sum(-1).reshape(-1, *self.grid.shape)
        return as_kind(power, self.kind)

    def parts_s(self) -> dict[str, float]:
        """Time of each part of one step in seconds; gradients are cut between parts."""
        watch = LapTimer()
        projection = self.field.projection()
        lists = self.lists(projection)
        watch.lap("projection and binning")
        distance = squared_distance(projection, lists, self.grid)
        seen = seen_of(lists)
        watch.lap("distances")
        attributes = self.attributes(seen)
        watch.lap("network, forward")
        attached = distance, *outputs_of(attributes)
        free = Leaves(*(tensor.detach().requires_grad_() for tensor in attached))
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
        """Limit the gradients and make the optimiser's step, as the training loop does."""
        nn.utils.clip_grad_norm_(self.field.parameters(), MAX_GRADIENT_NORM)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)


def outputs_of(attributes: Attributes) -> tuple[Tensor, Tensor, Tensor]:
    """Inverse spread, signal and attenuation in the form that accumulation takes, (V, B) each."""
    signal = attributes.signal.reshape(attributes.attenuation.shape)
    return attributes.inverse_spread, signal, attributes.attenuation


@dataclass(frozen=True)
class StepCost:
    """Time of a training step of the method itself, and of its parts, which are measured apart."""

    settings: tuple[str, ...]
    num_gaussians: int
    batch_size: int
    num_pairs: int
    step_s: float
    parts_s: dict[str, float]
    products_s: float  # of the network's matrix products alone, at the rate measured on this machine

    @property
    def samples_per_s(self) -> float:
        """Samples per second of the whole step."""
        return self.batch_size / self.step_s

    def sample_ms(self, seconds: float) -> float:
        """Milliseconds per sample from seconds per step."""
        return seconds / self.batch_size * 1e3


def step_cost(train: PasDataset, settings: Sequence[str]) -> StepCost:
    """Measure the method's own loop, then the same step part by part."""
    step = Step(train, settings)
    with torch.no_grad():
        lists = step.lists(step.field.projection())
    step.parts_s()
    parts = min((step.parts_s() for _ in range(REPEATS)), key=lambda seconds: sum(seconds.values()))
    config = step.config
    sizes = config.num_gaussians, config.batch_size, len(lists.gaussian)
    products_s = _products_s(step.network.mlp, config.batch_size * int(seen_of(lists).sum()))
    return StepCost(tuple(settings), *sizes, loop_s(train, METHOD, settings), parts, products_s)


def loop_s(train: PasDataset, method: str, settings: Sequence[str]) -> float:
    """Time of a step of `fit` in seconds, at half of the budget, where the loss has its final weights."""
    fit = build_method(method, settings).fit(train, Budget(), 0)
    assert isinstance(fit, Generator)
    next(fit)
    return least_s(lambda: fit.send(0.5))


def _products_s(mlp: PairwiseMLP, num_pairs: int, num_rows: int = 1 << 14) -> float:
    """Time of the hidden layers' matrix products, forward and twice backward, each measured alone, in seconds."""
    kind = torch.bfloat16 if is_narrow(mlp.precision, torch.device("cpu")) else torch.float32
    seconds = 0.0
    for layer in mlp.hidden:
        assert isinstance(layer, nn.Linear)
        weight = layer.weight.detach().to(kind)
        rows = torch.ones(num_rows, weight.shape[1], dtype=kind)
        seconds += 3 * least_s(lambda rows=rows, weight=weight: rows @ weight.T)  # type: ignore[misc]
    return seconds * num_pairs / num_rows
