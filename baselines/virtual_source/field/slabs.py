"""What the planes are made of: slabs whose materials are learned, and the cells of each plane that they fill."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from xfreqbench.units import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M

from ..room.surfaces import METAL_THICKNESS_M
from .images import Touch
from .slab_kernels import slopes_of_rows, sum_rows

NUM_COSINES = 64  # angles of the table of coefficients, which are interpolated between them
_START_PERMITTIVITY, _START_CONDUCTIVITY_S_M, _START_POWER = 3.0, 0.02, 0.9
_START_THICKNESS_M = (0.1, 0.012)  # a wall and a pane
METAL_REFLECTION = (-1.0, 1.0)  # TE, TM: the limit of high conductivity
_METAL = {  # which learning does not change
    "permittivity": 1.0,
    "conductivity_s_m": 1e7,
    "conductivity_power": 0.0,
    "thickness_m": METAL_THICKNESS_M,
}
NOTHING, THICK, THIN, METAL = range(4)
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
        carrier = carrier_hz.float()
        ghz = carrier / 1e9
        slab = (..., None, None)
        conductivity = self.log_conductivity.exp()[slab] * ghz ** self.power[slab]
        permittivity = torch.complex(
            1 + self.log_susceptibility.exp()[slab].expand_as(conductivity),
            -conductivity / (2 * math.pi * VACUUM_PERMITTIVITY_F_M * carrier),
        )
        cosine = cosine[:, None]
        root = _root(permittivity - (1 - cosine * cosine))
        wavenumber = 2 * math.pi * carrier / SPEED_OF_LIGHT_M_S
        depth = wavenumber * self.log_thickness.exp()[slab]
        once = (depth * root.imag).exp() * phasor(-depth * root.real)
        te = (cosine - root) / (cosine + root)
        tm = (permittivity * cosine - root) / (permittivity * cosine + root)
        face = torch.stack([te, tm], dim=-2)
        once = once[..., None, :]
        inverse = 1 / (1 - (face * once) ** 2)
        reflected = face * (1 - once * once) * inverse
        transmitted = ((1 - face * face) * once * inverse).mean(dim=-2)
        return reflected, transmitted

    def tables(self, carrier_hz: Float[Tensor, "F"]) -> tuple[Float[Tensor, "R 4*F"], Float[Tensor, "R 2*F"]]:
        """Coefficients of every slab at `NUM_COSINES` angles as rows of real numbers, for `looked_up`."""
        cosine = torch.linspace(0, 1, NUM_COSINES, device=self.power.device)
        reflected, transmitted = self.coefficients(carrier_hz, cosine)
        return _as_rows(reflected), _as_rows(transmitted)

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


def _root(square: Complex[Tensor, "..."]) -> Complex[Tensor, "..."]:
    """The root of numbers with a positive real part, faster than `torch.sqrt`."""
    real = ((square.abs() + square.real) / 2).sqrt()
    return torch.complex(real, square.imag / (2 * real))


def _as_rows(values: Complex[Tensor, "2 Q N ..."]) -> Float[Tensor, "R C"]:
    """One row of real numbers for each slab, plane and angle."""
    return torch.view_as_real(values).flatten(0, 2).flatten(1)


def looked_up(
    table: Float[Tensor, "R C"],
    num_planes: int,
    plane: Int[Tensor, "n"],
    cosine: Float[Tensor, "n"],
    share: Float[Tensor, "n 2"],
) -> Float[Tensor, "n C"]:
    """Σ_m share_m · (row of `plane` and slab m), interpolated between angles of incidence."""
    place = cosine * (NUM_COSINES - 1)
    below = place.long().clamp_max(NUM_COSINES - 2)
    weight = place - below
    first = plane * NUM_COSINES + below
    second = first + num_planes * NUM_COSINES
    rows = torch.stack([first, first + 1, second, second + 1], dim=-1)
    blend = torch.stack([1 - weight, weight], dim=-1)
    return _sum_of_rows(table, rows, (share[:, :, None] * blend[:, None]).flatten(1))


def _sum_of_rows(table: Float[Tensor, "R C"], rows: Int[Tensor, "n K"], weight: Float[Tensor, "n K"]) -> Tensor:
    """Σ_k weight[n, k] · table[rows[n, k]]: (n, C)."""
    summed: Tensor = _SumOfRows.apply(table.contiguous(), rows, weight)  # type: ignore[no-untyped-call]
    return summed


class _SumOfRows(torch.autograd.Function):
    """As `embedding_bag`, whose slope is slower, for it sorts the rows."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, rows: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(table, rows, weight)
        return torch.from_numpy(sum_rows(*(values.detach().numpy() for values in (table, rows, weight))))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor, None, Tensor]:
        values = (*ctx.saved_tensors, slope.contiguous())
        of_table, of_weight = slopes_of_rows(*(each.detach().numpy() for each in values))
        return torch.from_numpy(of_table), None, torch.from_numpy(of_weight)


def _softmax(logits: Float[Tensor, "... 4"]) -> Float[Tensor, "... 4"]:
    """The softmax over the last axis, which is faster along the first one where it is so short."""
    return logits.movedim(-1, 0).contiguous().softmax(0).movedim(0, -1)


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
        """The shares in all cells."""
        return _softmax(self.logits)

    def held(self, touch: Touch) -> Float[Tensor, "*S"]:
        """Settled share of anything where paths meet planes; 0 where they meet none."""
        flat = touch.flattened()
        share = 1 - self._interpolated(self.settled, flat)[:, NOTHING]
        return torch.where(flat.plane >= 0, share, 0.0).reshape(touch.plane.shape)

    def shares(self, touch: Touch) -> Float[Tensor, "n 4"]:
        """Shares at points of planes, `touch` flattened; values where no plane is met are meaningless."""
        return self._interpolated(self.logits, touch)

    def _interpolated(self, logits: Float[Tensor, "Q I J 4"], touch: Touch) -> Float[Tensor, "n 4"]:
        """Softmax of logits interpolated between the four cells around each point."""
        _, rows, columns, _ = logits.shape
        plane = touch.plane.clamp_min(0)
        place = (touch.point_m - self.low_m[plane]) / self.cell_m
        limit = place.new_tensor([rows - 1, columns - 1])
        place = place.clamp_min(0).minimum(limit)
        below = place.long().minimum(limit.long() - 1)
        weight = place - below
        corner = (plane * rows + below[:, 0]) * columns + below[:, 1]
        cells = torch.stack([corner, corner + 1, corner + columns, corner + columns + 1], dim=-1)
        along, across = (torch.stack([1 - part, part], dim=-1) for part in weight.unbind(-1))
        blend = (along[:, :, None] * across[:, None]).flatten(1)
        return _softmax(_sum_of_rows(logits.flatten(0, 2), cells, blend))
