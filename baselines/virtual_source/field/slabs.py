"""Materials of the planes: slabs whose permittivity, conductivity and thickness are learned."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor, nn
from torch.nn.functional import embedding_bag

from xfreqbench.units import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M

from ..room.materials import METAL_THICKNESS_M

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
        self.log_thickness = nn.Parameter(
            torch.tensor(_START_THICKNESS_M).log()[:, None].repeat(1, num_planes)
        )

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
        root = torch.sqrt(permittivity - (1 - cosine * cosine))
        wavenumber = 2 * math.pi * carrier / SPEED_OF_LIGHT_M_S
        once = torch.exp(-1j * wavenumber * self.log_thickness.exp()[slab] * root)
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
    return embedding_bag(
        rows, table, per_sample_weights=(share[:, :, None] * blend[:, None]).flatten(1), mode="sum"
    )
