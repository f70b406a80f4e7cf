"""What each saving of the training step saves, and what it changes in the answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor, autograd
from torch.nn.functional import cosine_similarity, linear, relu

from xfreqbench.dataset import PasDataset
from xfreqbench.splatting.benchmark import least_s
from xfreqbench.splatting.composite import composite
from xfreqbench.splatting.footprints import squared_distance
from xfreqbench.splatting.loss import map_loss
from xfreqbench.splatting.network import PairwiseMLP, is_narrow
from xfreqbench.splatting.splat import renumbered, seen_of
from xfreqbench.splatting.training_step import Step, loop_s, outputs_of
from xfreqbench.splatting.view import Targets, View


@dataclass(frozen=True)
class Saving:
    """Seconds of a minibatch without and with a saving, and how far the answer moves."""

    name: str
    timed: str
    off_s: float
    on_s: float
    change: str


def savings(train: PasDataset, settings: Sequence[str]) -> Iterator[Saving]:
    """Every saving on and off, at settings of `xfreq-gs`."""
    step = Step(train, settings)
    yield narrow_layers(step)
    yield factorised_layer(step)
    yield gaussians_in_view(train, settings)
    yield one_binning(step)
    yield from (derived_targets(train, step, View(stride)) for stride in (1, 3))
    yield every_fifth_direction(train, settings)


def narrow_layers(step: Step) -> Saving:
    """Hidden layers in bfloat16 where the processor multiplies it natively."""
    mlp = step.field.network.mlp
    mlp.precision = "float32"
    exact, off_s = _rendered(step), least_s(lambda: _network_step(step))
    mlp.precision = "auto"
    on_s = least_s(lambda: _network_step(step))
    native = is_narrow("auto", torch.device("cpu"))
    name = "bfloat16 hidden layers" if native else "bfloat16 hidden layers (not native here: off)"
    return Saving(name, "network, forward and backward", off_s, on_s, _map_change(_rendered(step), exact))


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
    return Saving(
        "factorised first layer (off: concatenated, a sample at a time)",
        "network, forward and backward",
        off_s,
        on_s,
        change,
    )


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
    name = f"unseen Gaussians skipped ({int(seen.sum())} of {len(seen)} seen)"
    return Saving(name, "network, forward and backward", off_s, on_s, change)


def one_binning(step: Step) -> Saving:
    """Projection, lists and distances once for the minibatch, against once for each sample."""
    with torch.no_grad():
        attributes = step.attributes(torch.ones(len(step.field.gaussians), dtype=torch.bool))
    batch_size = attributes.attenuation.shape[1]
    values = [value.requires_grad_() for value in outputs_of(attributes)]

    def together() -> Complex[Tensor, "B K"]:
        return _splatted(step, *values)

    def one_by_one() -> Complex[Tensor, "B K"]:
        samples = ([value[:, b : b + 1] for value in values] for b in range(batch_size))
        return torch.cat([_splatted(step, *sample) for sample in samples])

    with torch.no_grad():
        change = f"field: {_relative(together(), one_by_one()):.0e}"
    off_s = least_s(lambda: one_by_one().abs().sum().backward())
    on_s = least_s(lambda: together().abs().sum().backward())
    return Saving("one binning a minibatch", "splatting, forward and backward", off_s, on_s, change)


def derived_targets(train: PasDataset, step: Step, view: View) -> Saving:
    """Training maps computed from the channels, against float16 maps read from disk."""
    stored, derived = (Targets(train, step.beams, from_channels) for from_channels in (False, True))
    off_s = least_s(lambda: stored.maps(step.nth, view))
    on_s = least_s(lambda: derived.maps(step.nth, view))
    change = _map_change(derived.maps(step.nth, view), stored.maps(step.nth, view))
    return Saving(f"targets from channels, stride {view.stride}", "targets", off_s, on_s, change)


def every_fifth_direction(train: PasDataset, settings: Sequence[str]) -> Saving:
    """Training on every fifth row and column: less is taught, what is rendered stays."""
    fewer = [*settings, "stride=5"]
    few, every = Step(train, fewer), Step(train, settings)
    with torch.no_grad():
        moved = _map_change(_rendered(few), _renormalised(few.view.of_maps(_rendered(every))))
    cosine = cosine_similarity(_l1_gradient(few), _l1_gradient(every), dim=0)
    change = f"{moved} where both look; L1's gradient: cosine {float(cosine):.3f}"
    return Saving(
        "every fifth row and column", "whole step", loop_s(train, settings), loop_s(train, fewer), change
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
