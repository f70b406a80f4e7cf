"""What all learned methods share: the training loop, and checkpoints with all of its state."""

from __future__ import annotations

import math
import operator
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from inspect import unwrap
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field as Limits
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.learning.blending import Blend, Holdout
from xfreqbench.methods.learning.cuda_graph import StepGraph
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.methods.learning.stored import ADAM, SavedState, moments_of, named, require_moments, stored_state
from xfreqbench.methods.learning.targets import Beams, GridView, Targets, in_kind, of_peak
from xfreqbench.methods.lookup import TrainingTransmitters
from xfreqbench.types import FloatArray, NDArray

TENSORS_FILE, STATE_FILE = "state.safetensors", "state.json"
_PREDICT_BATCH = 32  # as many maps as a run asks for at once
_MIN_RATE = 0.01  # of the learning rate, reached at the end of the budget

Fraction = Annotated[float, Limits(ge=0, le=1)]
Positive = Annotated[float, Limits(gt=0)]
Count = Annotated[int, Limits(ge=1)]


@dataclass(frozen=True)
class TrainingConfig:
    """Options of training. A fit ends after `steps`, or before when the budget is spent.

    Carriers are moved at random, with a standard deviation of `carrier_blur` on a logarithmic axis where the
    training band is 2 wide, so that a network also holds between them. A fading channel changes between two of so
    few carriers in ways that their maps do not show, and a network that follows them closely errs between them.

    Where `averaging` is above 0, maps are predicted with a running mean of the weights.
    """

    steps: Annotated[Count, Doc("most steps of a fit; the default is the paper's")] = 200_000
    batch_size: Annotated[Count, Doc("maps of a step")] = 32
    learning_rate: Annotated[Positive, Doc("of Adam, for the weights")] = 2e-3
    ssim_weight: Annotated[Fraction, Doc("w of Eq. 12 at the end; the paper has 0.4")] = 0.8
    ssim_ramp: Annotated[Fraction, Doc("share of the budget after which w is reached")] = 0.25
    carrier_blur: Annotated[float, Limits(ge=0), Doc("random shift of log carriers, of a band 2 wide")] = 0.5
    stride: Annotated[Count, Doc("a step uses every so many rows and columns of a map")] = 5
    ssim_window: Annotated[int, Limits(ge=2), Doc("rows and columns in view of the loss's SSIM")] = 3
    derive_targets: Annotated[bool, Doc("maps come from stored channels, not from disk")] = True
    averaging: Annotated[float, Limits(ge=0, lt=1), Doc("what a running mean of weights keeps")] = 0.0
    blend: Annotated[
        Literal["auto", "none"], Doc("with trivial predictors, by weights from held-out training rows")
    ] = "none"
    device: Annotated[str, Doc("where it computes: cpu, cuda or cuda:0")] = "cpu"


class Adam(torch.optim.Adam):
    """Adam as it is, without torch's compiler around it, whose import takes seconds and which nothing uses here."""

    add_param_group = unwrap(torch.optim.Optimizer.add_param_group)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))


class ChannelField(nn.Module):
    """A radiance field: it gives the received power from directions in view for any transmitter and carrier.

    `is_capturable` says that on a CUDA device its steps have fixed shapes and never wait for the host, so that they
    may be replayed as a CUDA graph.
    """

    is_capturable: bool = False

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Prepare for training: take scales from the training rows, and random values from the generator."""
        raise NotImplementedError

    def power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power `|R_k|²` from the directions in view, in any scale.

        Positions are world positions in metres.
        """
        raise NotImplementedError

    def unit_power(
        self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], view: GridView, beams: Beams
    ) -> Float[Tensor, "B E A"]:
        """Power from the directions in view, divided by its peak there, or by a better estimate of the map's peak."""
        return of_peak(self.power(tx_position_m, carrier_hz, view, beams))

    def parameter_groups(self, learning_rate: float) -> list[dict[str, Any]]:
        """Parameters with their learning rates, in the form that an optimiser of torch takes."""
        return [{"params": list(self.parameters()), "lr": learning_rate}]

    def after_step(self, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        """Change the field after a step, while it still has its gradients; `share` is that of the budget spent."""

    def counts(self) -> dict[str, float]:
        """Sizes that tables show, by name, such as the number of Gaussians."""
        return {}

    def match(self, tensors: Mapping[str, Tensor]) -> None:
        """Take the sizes of stored tensors, so that they can be loaded."""


@dataclass
class Training:
    """All state of a training, which a checkpoint holds."""

    field: ChannelField
    optimizer: torch.optim.Adam
    generator: torch.Generator
    beams: Beams
    kind: PasKind
    parameters: list[nn.Parameter]  # of the field after the last step
    mean: AveragedModel | None = None  # of the field's weights over steps
    step: int = 0
    share: float = 0.0  # of the budget spent, as last told
    graph: StepGraph | None = None  # of a step on a CUDA device, where the field is capturable

    @property
    def predictor(self) -> ChannelField:
        """The field that predicts: with the mean weights, where they are averaged."""
        if self.mean is None:
            return self.field
        assert isinstance(self.mean.module, ChannelField)
        return self.mean.module


class LearnedMethod:
    """A method that trains a radiance field on maps; subclasses say which `field` and which `Config`.

    `trivial` are the predictors with which its maps may be blended.
    """

    Config: ClassVar[type]
    trivial: ClassVar[tuple[type, ...]] = ()
    position_kind: ClassVar[torch.dtype] = torch.float32  # of positions that `predict` hands to the field

    def __init__(self, config: Any = None) -> None:
        self.config = self.Config() if config is None else config
        if self.config.blend == "auto" and not self.trivial:
            raise MethodError(f"{type(self).__name__} has no trivial predictors to blend with: leave blend=none.")
        self._device = _device(self.config.device)
        self._training: Training | None = None
        self._blend: Blend | None = None

    def field(self) -> ChannelField:
        """The field for the options in `config`, before training."""
        raise NotImplementedError

    @property
    def num_parameters(self) -> int:
        """Number of values that training sets."""
        field = self._training.field if self._training else self.field()
        return sum(parameter.numel() for parameter in field.parameters())

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Generator[Progress, float, None]:
        """Minimise Eq. 12 by Adam; the learning rate falls as half a cosine over the share of the budget spent.

        Raises `DivergenceError` where the loss or a gradient is no longer finite.
        """
        if self._training is None:
            self._training = self.started(train, seed)
        training = self._training
        chosen = self._blend.choices if self._blend else {}
        holdouts = Holdout.draw(train, seed) if self.config.blend == "auto" else []
        holdouts = [holdout for holdout in holdouts if not holdout.rows.keys() & chosen.keys()]
        targets = self._targets(train, training, holdouts)
        if not len(targets):
            raise MethodError("No training row has a path; there is nothing to learn from.")
        own_share = training.step / self.config.steps
        maps = self.maps_a_step(train)
        training.share = max(training.share, own_share, budget.share(training.step, 0.0, maps * training.step))
        while training.step < self.config.steps:
            while holdouts and training.share >= holdouts[0].until:
                before = self._blend.choices if self._blend else {}
                self._blend = Blend.chosen(self.trivial, train, holdouts.pop(0), self._learned, before)
                targets = self._targets(train, training, holdouts)
            loss = self._step(training, targets)
            counts = training.field.counts() | {"maps": maps * training.step}
            spent = yield Progress(training.step, loss, counts)
            training.share = max(spent or 0.0, training.step / self.config.steps)

    def _targets(self, train: PasDataset, training: Training, holdouts: Sequence[Holdout]) -> Targets:
        """The rows that are trained on, while those of the first of `holdouts` are held out."""
        shown = train[holdouts[0].left] if holdouts else train
        for module in training.field.modules():
            if isinstance(module, Scaling):
                module.hear(shown)
        return Targets(shown, training.beams, self.config.derive_targets)

    def maps_a_step(self, train: PasDataset) -> int:
        """How many training maps one step shows."""
        return int(self.config.batch_size)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Maps with peak 1, on the grid of the training data and of their kind, blended where the options say so."""
        learned = self._learned(tx_position_m, carrier_hz)
        return self._blend.maps(learned, tx_position_m, carrier_hz) if self._blend else learned

    def findings(self) -> dict[str, Any]:
        """For each kind of query, the weights of the learned maps and of the trivial predictors' in the blend."""
        if self._blend is None:
            return {}
        return {"blend": {kind: choice.model_dump(exclude_none=True) for kind, choice in self._blend.choices.items()}}

    def _learned(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Maps of the field alone."""
        training = self._trained()
        position_m = torch.as_tensor(tx_position_m, dtype=self.position_kind).to(self._device)
        carrier = torch.as_tensor(carrier_hz).to(self._device)
        with torch.no_grad():
            maps = [
                in_kind(training.predictor.unit_power(*query, GridView(), training.beams), training.kind)
                for query in zip(position_m.split(_PREDICT_BATCH), carrier.split(_PREDICT_BATCH), strict=True)
            ]
        return torch.cat(maps).cpu().numpy()

    def save(self, directory: Path) -> None:
        """Store field, optimiser and random state as safetensors and the rest as JSON; loading runs no stored code."""
        training = self._trained()
        tensors = {f"field.{name}": tensor.clone() for name, tensor in training.field.state_dict().items()}
        if training.mean is not None:
            tensors |= {f"mean.{name}": tensor.clone() for name, tensor in training.mean.state_dict().items()}
        tensors |= moments_of(training.field, training.optimizer)
        tensors["generator"] = training.generator.get_state()
        tensors |= {
            "beam.element_position_wavelengths": torch.as_tensor(training.beams.element_position_wavelengths),
            "beam.elevation_rad": torch.as_tensor(training.beams.grid.elevation_rad),
            "beam.azimuth_rad": torch.as_tensor(training.beams.grid.azimuth_rad),
        }
        save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, directory / TENSORS_FILE)
        state = SavedState(
            config=as_json(self.config),
            step=training.step,
            share=training.share,
            kind=training.kind,
            blend=dict(self._blend.choices) if self._blend else None,
        )
        if self._blend:
            self._blend.transmitters.save(directory)
        (directory / STATE_FILE).write_text(state.model_dump_json(), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> LearnedMethod:
        """The method as it was saved; its `fit` continues from there."""
        state = stored_state(directory / STATE_FILE)
        method = cls(cls.Config(**state.config))
        tensors = load_file(directory / TENSORS_FILE, device=str(method._device))
        faults = [name for name, tensor in tensors.items() if not bool(torch.isfinite(tensor).all())]
        if faults:
            raise MethodError(f"{directory / TENSORS_FILE} holds numbers in {faults[0]} that are not finite.")
        grid = AngularGrid(tensors["beam.elevation_rad"].cpu().numpy(), tensors["beam.azimuth_rad"].cpu().numpy())
        beam = BartlettBeam(tensors["beam.element_position_wavelengths"].cpu().numpy(), grid)
        training = method._new_training(beam, state.kind, tensors)
        training.step, training.share = state.step, state.share
        training.generator.set_state(tensors["generator"].cpu())
        method._training = training
        if state.blend is not None:
            method._blend = Blend(cls.trivial, TrainingTransmitters.load(directory).train, state.blend)
        return method

    def _trained(self) -> Training:
        """The training so far; raises `MethodError` before `fit` or `load`."""
        if self._training is None:
            raise MethodError(f"{type(self).__name__} knows nothing yet; fit or load it first.")
        return self._training

    def started(self, train: PasDataset, seed: int) -> Training:
        """Field, optimiser and beams as `fit` has them before its first step."""
        smallest = min(train.grid.shape) // self.config.stride
        if self.config.ssim_window > smallest:
            raise MethodError(
                f"ssim_window={self.config.ssim_window} is more than the {smallest} rows or columns in view at "
                f"stride={self.config.stride}; lower one of them."
            )
        generator = torch.Generator().manual_seed(seed)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            field = self.field()
            field.adapt(train, generator)
        return self._assembled(field, generator, train.beam, train.header.pas_kind)

    def _assembled(
        self, field: ChannelField, generator: torch.Generator, beam: BartlettBeam, kind: PasKind
    ) -> Training:
        """A training that has made no step, on the device."""
        field.to(self._device)
        beams, parameters = Beams(beam, self._device), list(field.parameters())
        return Training(field, self.new_optimizer(field), generator, beams, kind, parameters)

    def new_optimizer(self, field: ChannelField) -> torch.optim.Adam:
        """Adam for the field's parameters, without any moments yet."""
        on_cuda = self._device.type == "cuda"
        optimizer = Adam(field.parameter_groups(self.config.learning_rate), fused=True, capturable=on_cuda)
        for group in optimizer.param_groups:
            group["initial_lr"] = group["lr"]
            if on_cuda:
                group["lr"] = torch.tensor(group["lr"], device=self._device)
        return optimizer

    def _new_training(self, beam: BartlettBeam, kind: PasKind, tensors: Mapping[str, Tensor]) -> Training:
        """The training that stored tensors hold."""
        field = self.field()
        of_field = named(tensors, "field.")
        field.match(of_field)
        field.load_state_dict(of_field)
        training = self._assembled(field, torch.Generator(), beam, kind)
        if of_mean := named(tensors, "mean."):
            training.mean = _mean_weights(field, self.config.averaging)
            training.mean.load_state_dict(of_mean)
        for name, parameter in field.named_parameters():
            stored = {key: tensors[f"adam.{key}.{name}"] for key in ADAM if f"adam.{key}.{name}" in tensors}
            if stored:
                require_moments(name, parameter, stored)
                training.optimizer.state[parameter] = stored
        return training

    def batch_loss(self, training: Training, targets: Targets) -> Tensor:
        """Eq. 12 for random rows in a random view."""
        return self._loss_of_rows(training, targets, *self._random_rows(training, targets))

    def _random_rows(self, training: Training, targets: Targets) -> tuple[GridView, Tensor, Tensor, Tensor, float]:
        """A view, rows, their transmitters and carriers, and the weight of SSIM."""
        config, generator = self.config, training.generator
        nth = torch.randint(len(targets), (config.batch_size,), generator=generator)
        view = GridView.draw(config.stride, generator)
        return view, nth, *targets.queries(nth, config.carrier_blur, generator), self._ssim_weight(training)

    def _loss_of_rows(
        self,
        training: Training,
        targets: Targets,
        view: GridView,
        nth: Tensor,
        position_m: Tensor,
        carrier_hz: Tensor,
        ssim_weight: float | Tensor,
    ) -> Tensor:
        power = training.field.unit_power(position_m, carrier_hz, view, training.beams)
        return self.loss_of(power, targets.maps(nth, view), training, ssim_weight)

    def loss_of(
        self,
        unit_power: Float[Tensor, "B E A"],
        truth: Float[Tensor, "B E A"],
        training: Training,
        ssim_weight: float | Tensor | None = None,
    ) -> Tensor:
        """Eq. 12 for predicted power of peak 1; the weight of SSIM follows from the share of the budget spent."""
        weight = self._ssim_weight(training) if ssim_weight is None else ssim_weight
        maps = in_kind(unit_power, training.kind)
        return map_loss(maps, truth, weight, self.config.ssim_window, self.config.stride)

    def _ssim_weight(self, training: Training) -> float:
        config, share = self.config, training.share
        return float(config.ssim_weight * min(1.0, share / config.ssim_ramp if config.ssim_ramp else 1.0))

    def _step(self, training: Training, targets: Targets) -> float:
        """Make one step; return the loss before it."""
        share, before = training.share, training.parameters
        if self._is_capturable(training, targets):
            _set_rates(training)
            loss = self._replayed(training, targets)
        else:
            loss = self.batch_loss(training, targets)
            _set_rates(training)  # of what may be another optimiser by now
            training.step += 1
            parameters, norm = _gradients(training.optimizer, loss)
            _require_finite(training, loss, norm)
            _update(training, parameters, norm)
        training.field.after_step(training.optimizer, training.step, share)
        training.parameters = now = list(training.field.parameters())
        is_same = len(before) == len(now) and all(map(operator.is_, before, now))
        if not is_same:
            training.graph = None
        if self.config.averaging:
            training.mean = averaged(training.mean if is_same else None, training.field, self.config.averaging)
        return float(loss.detach())

    def _is_capturable(self, training: Training, targets: Targets) -> bool:
        """Whether a step may be replayed: on a CUDA device, in one view, with targets that are made there."""
        on_cuda = self._device.type == "cuda"
        return on_cuda and training.field.is_capturable and self.config.stride == 1 and targets.derived

    def _replayed(self, training: Training, targets: Targets) -> Tensor:
        """Loss, gradients and new weights of a step as a CUDA graph does them."""
        view, nth, position_m, carrier_hz, ssim_weight = self._random_rows(training, targets)
        if training.graph is None or training.graph.key is not targets:

            def step(*inputs: Tensor) -> tuple[Tensor, Tensor]:
                loss = self._loss_of_rows(training, targets, view, *inputs)
                parameters, norm = _gradients(training.optimizer, loss)
                _update(training, parameters, norm)
                return loss.detach(), norm

            training.graph = StepGraph(step, targets)
        weight = torch.tensor(ssim_weight, dtype=torch.float32)
        loss, norm = training.graph(nth, position_m, carrier_hz, weight, device=self._device)
        training.step += 1
        _require_finite(training, loss, norm)
        return loss


def _mean_weights(model: nn.Module, kept: float) -> AveragedModel:
    """A running mean of a model's weights, which keeps the share `kept` of itself at a step, and less at the start."""

    def update(means: Any, weights: Any, number: Any) -> None:
        torch._foreach_lerp_(means, weights, 1 - min(kept, (1 + int(number)) / (10 + int(number))))

    return AveragedModel(model, multi_avg_fn=update)


def averaged(mean: AveragedModel | None, model: nn.Module, kept: float) -> AveragedModel:
    """The mean after another step; it begins anew where there is none, or where the model has other sizes."""
    if mean is None or _sizes(model) != _sizes(mean.module):
        mean = _mean_weights(model, kept)
    mean.update_parameters(model)
    return mean


def _sizes(model: nn.Module) -> list[torch.Size]:
    return [value.shape for value in (*model.parameters(), *model.buffers())]


def _set_rates(training: Training) -> None:
    """Let the rates fall as half a cosine over the budget; that of a CUDA graph is a tensor, whose value changes."""
    rate = _MIN_RATE + (1 - _MIN_RATE) * (0.5 + 0.5 * math.cos(math.pi * min(training.share, 1.0)))
    for group in training.optimizer.param_groups:
        if isinstance(group["lr"], Tensor):
            group["lr"].fill_(group["initial_lr"] * rate)
        else:
            group["lr"] = group["initial_lr"] * rate


def _gradients(optimizer: torch.optim.Adam, loss: Tensor) -> tuple[list[nn.Parameter], Tensor]:
    """The optimised parameters that the loss has a gradient by, and the norm of all gradients together."""
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for parameter in parameters:
        parameter.grad = None
    loss.backward()
    parameters = [parameter for parameter in parameters if parameter.grad is not None]
    return parameters, nn.utils.get_total_norm(
        [parameter.grad for parameter in parameters if parameter.grad is not None]
    )


def _update(training: Training, parameters: list[nn.Parameter], norm: Tensor) -> None:
    """Limit the norm of the gradients, and make a step of the optimiser."""
    nn.utils.clip_grads_with_norm_(parameters, 1.0, norm)
    training.optimizer.step()


def _require_finite(training: Training, loss: Tensor, norm: Tensor) -> None:
    """Raise `DivergenceError` where the loss or a gradient, whose `norm` is that of all, is not finite."""
    if bool(torch.isfinite(loss) & torch.isfinite(norm)):
        return
    faults = [
        name
        for name, parameter in training.field.named_parameters()
        if parameter.grad is not None and not bool(torch.isfinite(parameter.grad).all())
    ]
    gradient = f"gradient of {faults[0]}" if faults else "norm of all gradients"
    raise DivergenceError(training.step, gradient if torch.isfinite(loss) else "loss")


def _device(name: str) -> torch.device:
    """The device of a name; raises `MethodError` where torch does not know it or sees none."""
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise MethodError(f"{name!r} is no device of torch; use cpu, cuda or cuda:0.") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise MethodError(
            f"device={name} is asked for, but torch {torch.__version__} sees no CUDA device. Give device=cpu."
        )
    return device
