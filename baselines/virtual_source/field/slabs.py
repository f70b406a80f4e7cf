"""What the planes are made of: slabs whose materials are learned, and the cells of each plane that they fill."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from xfreqbench.types import NDArray

from ..room.surfaces import METAL_THICKNESS_M
from . import coefficient_kernels, slab_kernels
from .images import Touch, Traces
from .slab_kernels import NOTHING

NUM_COSINES = 64  # angles of the table of coefficients, which are interpolated between them
_START_PERMITTIVITY, _START_CONDUCTIVITY_S_M, _START_POWER = 3.0, 0.02, 0.9
_START_THICKNESS_M = (0.1, 0.012)  # a wall and a pane
_METAL = {  # which learning does not change
    "permittivity": 1.0,
    "conductivity_s_m": 1e7,
    "conductivity_power": 0.0,
    "thickness_m": METAL_THICKNESS_M,
}
# Logits at the start: walls are present, facets hardly.
_WALL, _FACET = (-1.0, 2.0, 0.0, -1.0), (3.0, -0.7, -1.2, -1.2)


class LearnedSlabs(nn.Module):
    """Two slabs for each of Q planes, one thick and one thin at first, with constant ε' and σ = c f^d (P.2040).

    Coefficients are those of ITU-R P.2040, Eqs. 37, 43 and 44. The two faces of a slab interfere, so its thickness
    determines its reflection also at carriers between those of the training.
    """

    def __init__(self, num_planes: int) -> None:
        super().__init__()
        shape = (len(_START_THICKNESS_M), num_planes)
        self.log_susceptibility = nn.Parameter(torch.full(shape, math.log(_START_PERMITTIVITY - 1)))
        self.log_conductivity = nn.Parameter(torch.full(shape, math.log(_START_CONDUCTIVITY_S_M)))
        self.power = nn.Parameter(torch.full(shape, _START_POWER))
        self.log_thickness = nn.Parameter(torch.tensor(_START_THICKNESS_M).log()[:, None].repeat(1, num_planes))

    def coefficients(
        self, carrier_hz: Float[Tensor, "F"], cosine: Float[Tensor, "N"]
    ) -> tuple[Complex[Tensor, "2 Q N 2 F"], Complex[Tensor, "2 Q N F"]]:
        """Coefficients of every slab at N angles of incidence: reflection (TE, TM) and transmission (mean of both).

        The first axis is the slab, thick or thin; `cosine` is that of the angle to the normal.
        """
        slabs = torch.stack([self.log_susceptibility, self.log_conductivity, self.power, self.log_thickness])
        ghz = (carrier_hz / 1e9).float()
        tables = _Coefficients.apply(slabs.flatten(1), ghz, cosine)  # type: ignore[no-untyped-call]
        reflected, transmitted = (torch.view_as_complex(table).unflatten(0, self.power.shape) for table in tables)
        return reflected, transmitted

    def take(self, other: LearnedSlabs, kept: Sequence[int]) -> None:
        """Copy the parameters of some planes of `other` to the first planes."""
        with torch.no_grad():
            for own, known in zip(self.parameters(), other.parameters(), strict=True):
                own[:, : len(kept)] = known[:, list(kept)]

    def described(self, plane: int, shares: Sequence[float]) -> list[dict[str, float]]:
        """Each slab of a plane in SI units, and then metal, with their shares of the cells; σ = c f^d has f in GHz."""
        parameters = {
            "permittivity": 1 + self.log_susceptibility.exp(),
            "conductivity_s_m": self.log_conductivity.exp(),
            "conductivity_power": self.power,
            "thickness_m": self.log_thickness.exp(),
        }
        *of_slabs, of_metal = shares
        slabs = [
            {"share": share, **{name: float(values[slab, plane]) for name, values in parameters.items()}}
            for slab, share in enumerate(of_slabs)
        ]
        return [*slabs, {"share": of_metal, **_METAL}]


def phasor(angle_rad: Float[Tensor, "..."]) -> Complex[Tensor, "..."]:
    """exp(j · angle), faster than `torch.polar`."""
    return torch.complex(angle_rad.cos(), angle_rad.sin())


class _Coefficients(torch.autograd.Function):
    """Coefficients (S, N, 2, F, 2) and (S, N, F, 2) by compiled kernels, with slopes by the slabs (4, S)."""

    @staticmethod
    def forward(ctx: Any, slabs: Tensor, carrier_ghz: Tensor, cosine: Tensor) -> tuple[Tensor, Tensor]:
        arguments = arrays_of(slabs, carrier_ghz, cosine)
        reflected, transmitted, rows = coefficient_kernels.coefficients(*arguments)
        ctx.arguments = *arguments, rows
        return torch.from_numpy(reflected), torch.from_numpy(transmitted)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor, None, None]:
        of_slabs = coefficient_kernels.slopes_of_coefficients(*ctx.arguments, *arrays_of(*slopes))
        return torch.from_numpy(of_slabs), None, None


def path_gains(
    slabs: LearnedSlabs,
    presence: Presence,
    traces: Traces,
    spread: Float[Tensor, "B K"],
    carrier_hz: Float[Tensor, "F"],
) -> Complex[Tensor, "B K F"]:
    """`spread` times Σ_c polarised_c Π_o R_{o, c_o}, times the transmission of all crossings.

    A factor is a mean over what the cells hold; slabs' coefficients are interpolated between `NUM_COSINES` angles.
    """
    reflecting, transmitting = slabs.coefficients(carrier_hz, torch.linspace(0, 1, NUM_COSINES))
    parts = traces.polarised.flatten(0, 1), spread.flatten(), *traces.bounce.by_path, *traces.crossing.by_path
    tables = *(torch.view_as_real(table).flatten(3) for table in (reflecting, transmitting)), presence.logits
    gain: Tensor = _PathGains.apply(*tables, presence.low_m, presence.cell_m, *parts)  # type: ignore[no-untyped-call]
    return gain.unflatten(0, spread.shape)


class _PathGains(torch.autograd.Function):
    """Gains (N, F) of N paths by compiled kernels, with slopes by both tables and the cells' logits."""

    @staticmethod
    def forward(
        ctx: Any, reflecting: Tensor, transmitting: Tensor, logits: Tensor, low_m: Tensor, cell_m: float, *parts: Tensor
    ) -> Tensor:
        tables, (polarised, spread, *touches) = arrays_of(reflecting, transmitting), arrays_of(*parts)
        cells = *arrays_of(logits, low_m), np.float32(cell_m)
        arguments: Any = polarised, spread, tuple(touches[:3]), tuple(touches[3:]), *tables, cells
        gain, *of_paths = slab_kernels.gains(*arguments)
        ctx.arguments = *arguments, *of_paths
        return torch.from_numpy(gain)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        slopes = slab_kernels.slopes_of_gains(*ctx.arguments, *arrays_of(slope.resolve_conj()))
        return *map(torch.from_numpy, slopes), *(None,) * 10


def arrays_of(*tensors: Tensor) -> list[NDArray[Any]]:
    """What kernels take of tensors."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


class Presence(nn.Module):
    """Shares of nothing, a thick slab, a thin slab and metal in the cells of each plane: a softmax of learned logits.

    Cells are squares with sides of `cell_m`. Values are interpolated bilinearly, and constant beyond the border.
    """

    low_m: Tensor
    settled: Tensor  # the logits at the last search; they decide which crossings of paths count

    def __init__(self, num_planes: int, size: tuple[int, int] = (2, 2), cell_m: float = 0.3) -> None:
        super().__init__()
        self.cell_m = cell_m
        self.register_buffer("low_m", torch.zeros(num_planes, 2))
        self.logits = nn.Parameter(torch.zeros(num_planes, *size, len(_WALL)))
        self.register_buffer("settled", torch.zeros_like(self.logits))

    @classmethod
    def covering(
        cls, axes: Float[Tensor, "Q 2 3"], corners_m: Float[Tensor, "c 3"], is_wall: Bool[Tensor, "Q"], cell_m: float
    ) -> Presence:
        """Cells that cover the projection of a box on every plane: walls are full at the start, other planes hardly."""
        place_m = torch.einsum("qac,nc->qna", axes, corners_m)
        low_m, high_m = place_m.amin(1), place_m.amax(1)
        extent_m = (high_m - low_m).flatten(0, -2).amax(0) if len(axes) else low_m.new_ones(2)
        size = ((extent_m / cell_m).ceil().long() + 1).clamp_min(2)
        presence = cls(len(axes), (int(size[0]), int(size[1])), cell_m)
        presence.low_m.copy_(low_m)
        start = torch.where(is_wall[:, None], torch.tensor(_WALL), torch.tensor(_FACET))
        with torch.no_grad():
            presence.logits.copy_(start[:, None, None])
        return presence

    def settle(self) -> None:
        """Use what has been learned for the crossings of paths that are traced from now on."""
        self.settled.copy_(self.logits.detach())

    def take(self, other: Presence, kept: Sequence[int]) -> None:
        """Copy the cells of some planes of `other` to the first planes; all cover the same box."""
        with torch.no_grad():
            rows, columns = map(min, self.logits.shape[1:3], other.logits.shape[1:3])
            self.logits[: len(kept), :rows, :columns] = other.logits[list(kept), :rows, :columns]

    def most_held(self) -> Float[Tensor, "Q"]:
        """Share of anything in the fullest cell of each plane."""
        return (1 - self.share.detach()[..., NOTHING]).flatten(1).amax(1)

    @property
    def share(self) -> Float[Tensor, "Q I J 4"]:
        """The shares in all cells; over the first axis where it is so short a softmax is faster than over the last."""
        return self.logits.movedim(-1, 0).contiguous().softmax(0).movedim(0, -1)

    def held(self, touch: Touch) -> Float[Tensor, "*S"]:
        """Settled share of anything where paths meet planes; 0 where they meet none."""
        flat = touch.flattened()
        return (1 - self._shares(self.settled, flat)[:, NOTHING]).reshape(touch.plane.shape)

    def shares(self, touch: Touch) -> Float[Tensor, "n 4"]:
        """Shares at points of planes, `touch` flattened, without slopes; nothing where no plane is met."""
        return self._shares(self.logits, touch)

    def _shares(self, logits: Float[Tensor, "Q I J 4"], touch: Touch) -> Float[Tensor, "n 4"]:
        """Softmax of logits interpolated between the four cells around each point."""
        of_cells, low_m, plane, point_m = arrays_of(logits, self.low_m, touch.plane, touch.point_m)
        return torch.from_numpy(slab_kernels.shares((of_cells, low_m, np.float32(self.cell_m)), plane, point_m))
