"""What the checkpoint of a training holds beside the tensors of its field, and how it is read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic import Field as Limits
from torch import Tensor, nn

from xfreqbench.errors import MethodError
from xfreqbench.maps.bartlett import PasKind
from xfreqbench.methods.learning.blending import Choice


class SavedState(BaseModel):
    """What a checkpoint holds beside tensors: the configuration, and how far the training is."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    config: dict[str, Any]
    step: Annotated[int, Limits(ge=0, lt=2**63)]
    share: Annotated[float, Limits(ge=0, allow_inf_nan=False)]
    kind: PasKind
    blend: dict[str, Choice] | None = None


ADAM = ("step", "exp_avg", "exp_avg_sq")


def named(tensors: Mapping[str, Tensor], beginning: str) -> dict[str, Tensor]:
    """The tensors whose names begin so, by the rest of their names."""
    return {name.removeprefix(beginning): value for name, value in tensors.items() if name.startswith(beginning)}


def stored_state(path: Path) -> SavedState:
    """The state in a file; raises `MethodError` where a field of it is missing, or is no such value."""
    try:
        return SavedState.model_validate_json(path.read_bytes())
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"])) or "all"
        raise MethodError(f"{path} is no state of a training: {place}: {fault['msg']}.") from error


def require_moments(name: str, parameter: nn.Parameter, stored: Mapping[str, Tensor]) -> None:
    """Raise `MethodError` unless all of Adam's state is there, its moments of a parameter's type and shape."""
    moments = [stored[key] for key in ("exp_avg", "exp_avg_sq") if key in stored]
    fit = [moment.shape == parameter.shape and moment.dtype == parameter.dtype for moment in moments]
    step = stored.get("step")
    counts = step is not None and step.shape == () and step.dtype == torch.float32  # as Adam makes it
    if stored.keys() != set(ADAM) or not all(fit) or not counts:
        raise MethodError(f"The moments of {name} are not those of a parameter of shape {tuple(parameter.shape)}.")


def moments_of(field: nn.Module, optimizer: torch.optim.Adam) -> dict[str, Tensor]:
    """State of Adam by names of tensors in a checkpoint."""
    state = optimizer.state
    return {
        f"adam.{key}.{name}": state[parameter][key]
        for name, parameter in field.named_parameters()
        if parameter in state
        for key in ADAM
    }
