"""What each saving of rendering and training saves, and what it changes in the answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor, autograd
from torch.nn.functional import cosine_similarity, linear, relu

from xfreqbench.angles import AngularGrid
from xfreqbench.dataset import PasDataset
from xfreqbench.splatting.benchmark import least_s
from xfreqbench.splatting.composite import Backend, PixelLists, composite
from xfreqbench.splatting.footprints import squared_distance
from xfreqbench.splatting.loss import map_loss
from xfreqbench.splatting.network import PairwiseMLP, is_narrow
from xfreqbench.splatting.projection import Projection
from xfreqbench.splatting.splat import renumbered, seen_of
from xfreqbench.splatting.training_step import Step, loop_s, outputs_of
from xfreqbench.splatting.view import Targets, View

NETWORK = "network, forward and backward"


@dataclass(frozen=True)
class Saving:
    """Milliseconds a sample without and with a saving, and how far the answer moves.

    A saving may also buy accuracy with time; then `off_ms` is the less.
    """

    part: Literal["generator", "renderer", "training"]
    name: str
    timed: str
    off_ms: float
    on_ms: float
    change: str


def savings(train: PasDataset, settings: Sequence[str]) -> Iterator[Saving]:
    """Every saving of rendering and training on and off, at settings of `xfreq-gs`."""
    step = Step(train, settings)
    yield compiled_kernels(step)
    yield finite_footprints(step)
    yield one_binning(step)
    yield gaussians_in_view(train, settings)
    yield narrow_layers(step)
    yield factorised_layer(step)
    yield from (derived_targets(train, step, View(stride)) for stride in (1, 3))
    yield beams_by_lags(train, step)
    yield every_fifth_direction(train, settings)


def compiled_kernels(step: Step) -> Saving:
    """Accumulation by compiled kernels with the minibatch as lanes, against layers peeled in plain torch."""
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
    """Gaussians only where they are above their footprint's edge, against every one on every direction.

    Both on every fifth row and column: all Gaussians on all directions fill gigabytes.
    """
    grid = View(5).of_grid(step.beams.grid)
    values, projection = _attribute_leaves(step), step.field.projection()

    def field(lists: PixelLists) -> Complex[Tensor, "B K"]:
        return composite(lists, squared_distance(projection, lists, grid), *values)

    def few() -> Complex[Tensor, "B K"]:
        return field(step.field.lists(projection, grid))

    def every() -> Complex[Tensor, "B K"]:
        return field(_every_gaussian(projection, grid))

    with torch.no_grad():
        change = f"field: {_relative(few(), every()):.0e}"
    off_s, on_s = (_splatting_s(work) for work in (every, few))
    name = "footprints end at three deviations (both on 1/25 of the directions)"
    timed = "binning and splatting, forward and backward"
    return Saving("renderer", name, timed, *_a_sample(step, off_s, on_s), change)


def _splatting_s(field: Callable[[], Tensor]) -> float:
    return least_s(lambda: field().abs().sum().backward(retain_graph=True))


def _every_gaussian(projection: Projection, grid: AngularGrid) -> PixelLists:
    """Lists in which every direction sees all Gaussians above the horizon or below, nearest first."""
    order, num_directions = projection.range_m.argsort(stable=True), math.prod(grid.shape)
    start = torch.arange(num_directions + 1) * len(order)
    return PixelLists(start, order.repeat(num_directions), len(order))


def beams_by_lags(train: PasDataset, step: Step) -> Saving:
    """Power of beams from the covariance summed over the array's lags, against one product with every element.

    Of 16 channels a sample that do not interfere, as array-domain fields add them up.
    """
    element = torch.as_tensor(train.beam.conjugate_steering)
    generator = torch.Generator().manual_seed(0)
    shape = 16, step.config.batch_size, len(element)
    cfr = torch.randn(shape, generator=generator, dtype=torch.complex64).requires_grad_()

    def by_elements() -> Float[Tensor, "B E A"]:
        beam = torch.view_as_real(cfr @ element).square().sum(-1).sum(0)
        return beam.reshape(-1, *step.beams.grid.shape)

    def by_lags() -> Float[Tensor, "B E A"]:
        return step.beams.power(cfr, View())

    with torch.no_grad():
        change = f"power: {_relative(by_lags(), by_elements()):.0e}"
    off_s = least_s(lambda: by_elements().sum().backward())
    on_s = least_s(lambda: by_lags().sum().backward())
    timed = "beams of 16 channels, forward and backward"
    return Saving("training", "beams by lags of the array", timed, *_a_sample(step, off_s, on_s), change)


def _a_sample(step: Step, *seconds: float) -> tuple[float, float]:
    """Milliseconds a sample from seconds of a minibatch."""
    off_ms, on_ms = (second / step.config.batch_size * 1e3 for second in seconds)
    return off_ms, on_ms


def _attribute_leaves(step: Step) -> tuple[Tensor, Tensor, Tensor]:
    """The network's outputs for all Gaussians, as leaves to be differentiated by."""
    with torch.no_grad():
        attributes = step.attributes(torch.ones(len(step.field.gaussians), dtype=torch.bool))
    spread, signal, attenuation = (value.requires_grad_() for value in outputs_of(attributes))
    return spread, signal, attenuation


def _footprints(step: Step) -> tuple[PixelLists, Float[Tensor, "P"]]:
    """Lists of the directions in view, and distances as leaves."""
    projection = step.field.projection()
    lists = step.lists(projection)
    return lists, squared_distance(projection, lists, step.grid).detach().requires_grad_()


def narrow_layers(step: Step) -> Saving:
    """Hidden layers in bfloat16 where the processor multiplies it natively."""
    mlp = step.field.network.mlp
    mlp.precision = "float32"
    exact, off_s = _rendered(step), least_s(lambda: _network_step(step))
    mlp.precision = "auto"
    on_s = least_s(lambda: _network_step(step))
    native = is_narrow("auto", torch.device("cpu"))
    name = "bfloat16 hidden layers" if native else "bfloat16 hidden layers (not native here: off)"
    change = _map_change(_rendered(step), exact)
    return Saving("renderer", name, NETWORK, *_a_sample(step, off_s, on_s), change)


def factorised_layer(step: Step) -> Saving:
    """A query's part of the first layer once for all Gaussians, against all inputs of every pair in one."""
    mlp = step.field.network.mlp
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
    """The same network with its first layer applied to all inputs of every pair, a sample after the other."""
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
    """Gaussians that no direction sees kept out of the network, where half lie below the horizon."""
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
    """Projection, lists and distances once for the minibatch, against once for each sample."""
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


def derived_targets(train: PasDataset, step: Step, view: View) -> Saving:
    """Training maps computed from the channels, against float16 maps read from disk."""
    stored, derived = (Targets(train, step.beams, from_channels) for from_channels in (False, True))
    off_s = least_s(lambda: stored.maps(step.nth, view))
    on_s = least_s(lambda: derived.maps(step.nth, view))
    change = _map_change(derived.maps(step.nth, view), stored.maps(step.nth, view))
    name = f"targets from channels, stride {view.stride}"
    return Saving("training", name, "targets", *_a_sample(step, off_s, on_s), change)


def every_fifth_direction(train: PasDataset, settings: Sequence[str]) -> Saving:
    """Training on every fifth row and column: less is taught, what is rendered stays."""
    fewer = [*settings, "stride=5"]
    few, every = Step(train, fewer), Step(train, settings)
    with torch.no_grad():
        moved = _map_change(_rendered(few), _renormalised(few.view.of_maps(_rendered(every))))
    cosine = cosine_similarity(_l1_gradient(few), _l1_gradient(every), dim=0)
    change = f"before training: {moved} where both look; L1's gradient: cosine {float(cosine):.3f}"
    off_s, on_s = loop_s(train, settings), loop_s(train, fewer)
    return Saving(
        "training", "every fifth row and column", "whole step", *_a_sample(every, off_s, on_s), change
    )


def _network_step(step: Step, kept: Bool[Tensor, "N"] | None = None) -> None:
    every = torch.ones(len(step.field.gaussians), dtype=torch.bool)
    attributes = step.attributes(every if kept is None else kept)
    outputs = [attributes.inverse_spread, attributes.signal.abs(), attributes.attenuation.abs()]
    parameters = list(step.field.network.parameters())
    autograd.grad([output.sum() for output in outputs], parameters, allow_unused=True)


def _mlp_step(mlp: PairwiseMLP, outputs: Callable[[], Tensor]) -> None:
    autograd.grad(outputs().sum(), list(mlp.parameters()))


def _first_inputs(step: Step) -> tuple[Tensor, Tensor, Tensor]:
    """What the field's network hands to its MLP."""
    caught: list[tuple[Any, ...]] = []
    hook = step.field.network.mlp.register_forward_pre_hook(lambda _, inputs: caught.append(inputs))
    with torch.no_grad():
        step.attributes(torch.ones(len(step.field.gaussians), dtype=torch.bool))
    hook.remove()
    query, gaussian, pair = caught[0]
    return query, gaussian, pair


def _splatted(
    step: Step, inverse_spread: Tensor, signal: Tensor, attenuation: Tensor
) -> Complex[Tensor, "B K"]:
    projection = step.field.projection()
    lists = step.lists(projection)
    distance = squared_distance(projection, lists, step.grid)
    return composite(lists, distance, inverse_spread, signal, attenuation)


def _rendered(step: Step, kept: Bool[Tensor, "N"] | None = None) -> Float[Tensor, "B E A"]:
    """Maps in view, peak 1, from the attributes of the kept Gaussians."""
    projection = step.field.projection()
    lists = step.lists(projection)
    kept = seen_of(lists) if kept is None else kept
    attributes = step.attributes(kept)
    spread, signal, attenuation = outputs_of(attributes)
    distance = squared_distance(projection, lists, step.grid)
    return step.maps(composite(renumbered(lists, kept), distance, spread, signal, attenuation))


def _l1_gradient(step: Step) -> Float[Tensor, "G"]:
    """Gradient of L1 by every weight of the network."""
    loss = map_loss(_rendered(step), step.targets.maps(step.nth, step.view), 0.0, step.config.ssim_window)
    parameters = list(step.field.network.parameters())
    gradients = autograd.grad(loss, parameters, allow_unused=True, materialize_grads=True)
    return torch.cat([gradient.flatten() for gradient in gradients])


def _renormalised(maps: Float[Tensor, "B E A"]) -> Float[Tensor, "B E A"]:
    return maps / maps.amax(dim=(1, 2), keepdim=True)


def _map_change(maps: Tensor, others: Tensor) -> str:
    difference = (maps.detach() - others.detach()).abs()
    return f"maps: mean {float(difference.mean()):.0e}, at most {float(difference.max()):.0e}"


def _relative(value: Tensor, truth: Tensor) -> float:
    return float((value - truth).detach().abs().max() / truth.detach().abs().max())
