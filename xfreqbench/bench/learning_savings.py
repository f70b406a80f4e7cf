"""Measures each saving of rendering and training: the time it saves, and how it changes the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor, autograd
from torch.nn.functional import cosine_similarity, linear, relu

from xfreqbench.bench.splatting import least_s
from xfreqbench.bench.training_step import METHOD, Step, loop_s, outputs_of
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.methods.learning.network import PairwiseMLP, is_narrow
from xfreqbench.methods.learning.targets import GridView, Targets
from xfreqbench.methods.splatting.composite import Backend, PixelLists, composite
from xfreqbench.methods.splatting.field import renumbered, seen_of
from xfreqbench.methods.splatting.footprints import squared_distance

NETWORK = "network, forward and backward"


@dataclass(frozen=True)
class Saving:
    """Milliseconds per sample without and with a saving (`off_ms`, `on_ms`), and how it changes the result.

    A saving may also spend time for accuracy; then `off_ms` is smaller.
    """

    part: Literal["generator", "renderer", "training"]
    name: str
    timed: str
    off_ms: float
    on_ms: float
    change: str


def savings(train: PasDataset, settings: Sequence[str]) -> Iterator[Saving]:
    """All savings of rendering and training, measured on and off, for settings of `xfreq-gs-paper`."""
    step = Step(train, settings)
    yield compiled_kernels(step)
    yield finite_footprints(step)
    yield one_binning(step)
    yield gaussians_in_view(train, settings)
    yield narrow_layers(step)
    yield factorised_layer(step)
    yield from (derived_targets(train, step, GridView(stride)) for stride in (1, 3))
    yield beams_by_lags(train, step)
    yield every_fifth_direction(train, settings)


def compiled_kernels(step: Step) -> Saving:
    """Accumulation by compiled kernels with the minibatch in SIMD lanes, against layer by layer in plain torch."""
    values, lists, distance = _attribute_leaves(step), *_footprints(step)

    def accumulated(backend: Backend) -> Complex[Tensor, "B K"]:
        return composite(lists, distance, *values, backend)

    with torch.no_grad():
        change = f"field: {_relative(accumulated('numba'), accumulated('torch')):.0e}"
    off_s = least_s(lambda: accumulated("torch").abs().sum().backward())
    on_s = least_s(lambda: accumulated("numba").abs().sum().backward())
    timed = "accumulation, forward and backward"
    return Saving(
        "renderer", "compiled kernels (off: plain torch)", timed, *_a_sample(step, off_s, on_s), change
    )


def finite_footprints(step: Step) -> Saving:
    """Gaussians only within their footprints, against all Gaussians on all directions.

    Both use every fifth row and column, because all Gaussians on all directions fill gigabytes.
    """
    grid = GridView(5).of_grid(step.beams.grid)
    values, projection = _attribute_leaves(step), step.field.projection()

    def field(lists: PixelLists) -> Complex[Tensor, "B K"]:
        return composite(lists, squared_distance(projection, lists, grid), *values)

    def few() -> Complex[Tensor, "B K"]:
        return field(step.field.lists(projection, grid))

    def every() -> Complex[Tensor, "B K"]:
        order, num_directions = projection.range_m.argsort(stable=True), math.prod(grid.shape)
        start = torch.arange(num_directions + 1) * len(order)
        return field(PixelLists(start, order.repeat(num_directions), len(order)))  # all, nearest first

    with torch.no_grad():
        change = f"field: {_relative(few(), every()):.0e}"
    off_s = least_s(lambda: every().abs().sum().backward(retain_graph=True))
    on_s = least_s(lambda: few().abs().sum().backward(retain_graph=True))
    name = "footprints end at three deviations (both on 1/25 of the directions)"
    timed = "binning and splatting, forward and backward"
    return Saving("renderer", name, timed, *_a_sample(step, off_s, on_s), change)


def beams_by_lags(train: PasDataset, step: Step) -> Saving:
    """Power of beams from the covariance summed over the array's lags, against products with all elements.

    Each sample has 16 channels that do not interfere, as in array-domain fields.
    """
    element = torch.as_tensor(train.beam.conjugate_steering)
    generator = torch.Generator().manual_seed(0)
    shape = 16, step.config.batch_size, len(element)
    cfr = torch.randn(shape, generator=generator, dtype=torch.complex64).requires_grad_()

    def by_elements() -> Float[Tensor, "B E A"]:
        beam = torch.view_as_real(cfr @ element).square().sum(-1).sum(0)
        return beam.reshape(-1, *step.beams.grid.shape)

    def by_lags() -> Float[Tensor, "B E A"]:
        return step.beams.power(cfr, GridView())

    with torch.no_grad():
        change = f"power: {_relative(by_lags(), by_elements()):.0e}"
    off_s = least_s(lambda: by_elements().sum().backward())
    on_s = least_s(lambda: by_lags().sum().backward())
    timed = "beams of 16 channels, forward and backward"
    return Saving("training", "beams by lags of the array", timed, *_a_sample(step, off_s, on_s), change)


def _a_sample(step: Step, *seconds: float) -> tuple[float, float]:
    """Milliseconds per sample from seconds per minibatch, for off and on."""
    off_ms, on_ms = (second / step.config.batch_size * 1e3 for second in seconds)
    return off_ms, on_ms


def _attribute_leaves(step: Step) -> tuple[Tensor, Tensor, Tensor]:
    """The network's outputs for all Gaussians, as leaves for differentiation."""
    with torch.no_grad():
        attributes = step.attributes(torch.ones(len(step.field.gaussians), dtype=torch.bool))
    spread, signal, attenuation = (value.requires_grad_() for value in outputs_of(attributes))
    return spread, signal, attenuation


def _footprints(step: Step) -> tuple[PixelLists, Float[Tensor, "P"]]:
    """Lists for the directions in view, and their distances as leaves for differentiation."""
    projection = step.field.projection()
    lists = step.lists(projection)
    return lists, squared_distance(projection, lists, step.grid).detach().requires_grad_()


def narrow_layers(step: Step) -> Saving:
    """Hidden layers in bfloat16 where the processor multiplies it natively, against float32."""
    mlp = step.network.mlp
    mlp.precision = "float32"
    exact, off_s = _rendered(step), least_s(lambda: _network_step(step))
    mlp.precision = "auto"
    on_s = least_s(lambda: _network_step(step))
    native = is_narrow("auto", torch.device("cpu"))
    name = "bfloat16 hidden layers" if native else "bfloat16 hidden layers (not native here: off)"
    change = _map_change(_rendered(step), exact)
    return Saving("renderer", name, NETWORK, *_a_sample(step, off_s, on_s), change)


def factorised_layer(step: Step) -> Saving:
    """The part of the query in the first layer computed once for all Gaussians, against all inputs of every pair."""
    mlp = step.network.mlp
    query, gaussian, pair = _first_inputs(step)
    off_s = least_s(lambda: _mlp_step(mlp, lambda: concatenated(mlp, query, gaussian, pair)))
    on_s = least_s(lambda: _mlp_step(mlp, lambda: mlp(query, gaussian, pair)))
    mlp.precision = "float32"
    with torch.no_grad():
        naive, ours = concatenated(mlp, query, gaussian, pair), mlp(query, gaussian, pair)
    mlp.precision = "auto"
    change = f"outputs in float32: {_relative(ours, naive):.0e}"
    name = "factorised first layer (off: concatenated, a sample at a time)"
    return Saving("renderer", name, NETWORK, *_a_sample(step, off_s, on_s), change)


def concatenated(
    mlp: PairwiseMLP,
    query: Float[Tensor, "B Q"],
    gaussian: Float[Tensor, "V G"],
    pair: Float[Tensor, "B V P"],
) -> Float[Tensor, "B V O"]:
    """Outputs of the same network, its first layer applied to all inputs of every pair, sample by sample."""
    weight = torch.cat([mlp.of_query.weight, mlp.of_pair.weight], dim=1)
    narrow = is_narrow(mlp.precision, query.device)
    outputs = []
    for nth in range(len(query)):
        inputs = torch.cat([query[nth].expand(len(gaussian), -1), gaussian, pair[nth]], dim=1)
        with torch.autocast(query.device.type, torch.bfloat16, enabled=narrow):
            features = relu(linear(inputs, weight, mlp.of_query.bias), inplace=True)
            for layer in mlp.hidden:
                features = relu(layer(features), inplace=True)
            outputs.append(mlp.head(features).float())
    return torch.stack(outputs)


def gaussians_in_view(train: PasDataset, settings: Sequence[str]) -> Saving:
    """Unseen Gaussians left out of the network, in a field with half of its Gaussians below the horizon."""
    step = Step(train, settings)
    with torch.no_grad():
        step.field.gaussians.position_m[::2, 2] *= -1
        seen = seen_of(step.lists(step.field.projection()))
        all_of_them = torch.ones_like(seen)
        change = _map_change(_rendered(step, seen), _rendered(step, all_of_them))
    off_s = least_s(lambda: _network_step(step, all_of_them))
    on_s = least_s(lambda: _network_step(step, seen))
    name = f"unseen Gaussians skipped (half put below the horizon: {int(seen.sum())} of {len(seen)} seen)"
    return Saving("renderer", name, NETWORK, *_a_sample(step, off_s, on_s), change)


def one_binning(step: Step) -> Saving:
    """Projection, lists and distances computed once for the minibatch, against once for each sample."""
    values = _attribute_leaves(step)

    def together() -> Complex[Tensor, "B K"]:
        return _splatted(step, *values)

    def one_by_one() -> Complex[Tensor, "B K"]:
        samples = ([value[:, b : b + 1] for value in values] for b in range(step.config.batch_size))
        return torch.cat([_splatted(step, *sample) for sample in samples])

    with torch.no_grad():
        change = f"field: {_relative(together(), one_by_one()):.0e}"
    off_s = least_s(lambda: one_by_one().abs().sum().backward())
    on_s = least_s(lambda: together().abs().sum().backward())
    timed = "splatting, forward and backward"
    return Saving("renderer", "one binning a minibatch", timed, *_a_sample(step, off_s, on_s), change)


def derived_targets(train: PasDataset, step: Step, view: GridView) -> Saving:
    """Training maps derived from the channels, against float16 maps read from disk."""
    stored, derived = (Targets(train, step.beams, from_channels) for from_channels in (False, True))
    off_s = least_s(lambda: stored.maps(step.nth, view))
    on_s = least_s(lambda: derived.maps(step.nth, view))
    change = _map_change(derived.maps(step.nth, view), stored.maps(step.nth, view))
    name = f"targets from channels, stride {view.stride}"
    return Saving("training", name, "targets", *_a_sample(step, off_s, on_s), change)


def every_fifth_direction(train: PasDataset, settings: Sequence[str]) -> Saving:
    """Training on every fifth row and column against all of them; predictions use all of them in both cases."""
    fewer = [*settings, "stride=5"]
    few, every = Step(train, fewer), Step(train, settings)
    with torch.no_grad():
        in_view = few.view.of_maps(_rendered(every))
        moved = _map_change(_rendered(few), in_view / in_view.amax(dim=(1, 2), keepdim=True))
    cosine = cosine_similarity(_l1_gradient(few), _l1_gradient(every), dim=0)
    change = f"before training: {moved} where both look; L1's gradient: cosine {float(cosine):.3f}"
    off_s, on_s = (loop_s(train, METHOD, each) for each in (settings, fewer))
    return Saving(
        "training", "every fifth row and column", "whole step", *_a_sample(every, off_s, on_s), change
    )


def _network_step(step: Step, kept: Bool[Tensor, "N"] | None = None) -> None:
    """The network forward and backward for the kept Gaussians, or for all of them."""
    every = torch.ones(len(step.field.gaussians), dtype=torch.bool)
    attributes = step.attributes(every if kept is None else kept)
    outputs = [attributes.inverse_spread, attributes.signal.abs(), attributes.attenuation.abs()]
    parameters = list(step.field.network.parameters())
    autograd.grad([output.sum() for output in outputs], parameters, allow_unused=True)


def _mlp_step(mlp: PairwiseMLP, outputs: Callable[[], Tensor]) -> None:
    """Compute outputs of the network and the gradients by its parameters."""
    autograd.grad(outputs().sum(), list(mlp.parameters()))


def _first_inputs(step: Step) -> tuple[Tensor, Tensor, Tensor]:
    """Query, Gaussian and pair inputs that the field's network passes to its MLP."""
    caught: list[tuple[Any, ...]] = []
    hook = step.network.mlp.register_forward_pre_hook(lambda _, inputs: caught.append(inputs))
    with torch.no_grad():
        step.attributes(torch.ones(len(step.field.gaussians), dtype=torch.bool))
    hook.remove()
    query, gaussian, pair = caught[0]
    return query, gaussian, pair


def _splatted(
    step: Step, inverse_spread: Tensor, signal: Tensor, attenuation: Tensor
) -> Complex[Tensor, "B K"]:
    """The field in view from attributes of all Gaussians, projection included."""
    projection = step.field.projection()
    lists = step.lists(projection)
    distance = squared_distance(projection, lists, step.grid)
    return composite(lists, distance, inverse_spread, signal, attenuation)


def _rendered(step: Step, kept: Bool[Tensor, "N"] | None = None) -> Float[Tensor, "B E A"]:
    """Maps in view with peak 1 from the kept Gaussians, or from those that are seen."""
    projection = step.field.projection()
    lists = step.lists(projection)
    kept = seen_of(lists) if kept is None else kept
    attributes = step.attributes(kept)
    spread, signal, attenuation = outputs_of(attributes)
    distance = squared_distance(projection, lists, step.grid)
    return step.maps(composite(renumbered(lists, kept), distance, spread, signal, attenuation))


def _l1_gradient(step: Step) -> Float[Tensor, "G"]:
    """Gradient of the L1 loss by all weights of the network, as one vector."""
    loss = map_loss(_rendered(step), step.targets.maps(step.nth, step.view), 0.0, step.config.ssim_window)
    parameters = list(step.field.network.parameters())
    gradients = autograd.grad(loss, parameters, allow_unused=True, materialize_grads=True)
    return torch.cat([gradient.flatten() for gradient in gradients])


def _map_change(maps: Tensor, others: Tensor) -> str:
    """Mean and largest difference between maps, in words."""
    difference = (maps.detach() - others.detach()).abs()
    return f"maps: mean {float(difference.mean()):.0e}, at most {float(difference.max()):.0e}"


def _relative(value: Tensor, truth: Tensor) -> float:
    """Largest difference, relative to the largest value of the truth."""
    return float((value - truth).detach().abs().max() / truth.detach().abs().max())
