"""GSRF, reduced: static complex Gaussians that radiate a Fourier–Legendre series of directions each; no network."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Complex, Float
from numpy.polynomial import Legendre, Polynomial
from pydantic import Field as Limits
from torch import Tensor, nn
from torch.nn.functional import normalize
from typing_extensions import Doc

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.network import Attributes
from xfreqbench.methods.learning.training import ChannelField, Count, Fraction, LearnedMethod
from xfreqbench.methods.splatting.field import GaussianConfig, GaussianField, SplatTrainingConfig
from xfreqbench.methods.splatting.gaussians import RFGaussians, Seen

_ATTENUATION = 0.1  # of each Gaussian at the start
_COEFFICIENT = 0.1  # standard deviation of real and imaginary parts at the start


@dataclass(frozen=True)
class GSRFConfig(GaussianConfig, SplatTrainingConfig):
    """Options. The paper has at most 10,000 Gaussians at the start, and degree 3."""

    num_gaussians: Annotated[Count, Doc("most Gaussians at the start, on a grid in the box")] = 512
    max_gaussians: Count = 768
    batch_size: Count = 64
    degree: Annotated[int, Limits(ge=0, le=8), Doc("of the Fourier–Legendre series")] = 3
    degree_until: Annotated[Fraction, Doc("share of the budget in which degrees are added")] = 0.5


class FourierLegendre(nn.Module):
    """Σ c_lm B_lm(d) with B_lm(d) = N_lm P_l^|m|(cos θ) e^{jmα}, in the order l² + l + m, up to a degree.

    These are the spherical harmonics, with the signs of `scipy.special.sph_harm_y`. (sin θ)^|m| e^{jmα} is computed
    as (x ± jy)^|m|, which holds at the poles too, and the sum as one of real polynomials z^k Re (x + jy)^m and
    z^k Im (x + jy)^m. `degree` is the highest degree that the series has at present.
    """

    degree: Tensor
    of_polynomials: Tensor  # (C, C), complex: each function in the polynomials
    degrees: Tensor  # (C,): of each function

    def __init__(self, max_degree: int) -> None:
        super().__init__()
        self.max_degree = max_degree
        self.terms = [(degree, order) for degree in range(max_degree + 1) for order in range(-degree, degree + 1)]
        rows = [_in_polynomials(*term, max_degree) for term in self.terms]
        self.register_buffer("of_polynomials", torch.tensor(rows, dtype=torch.complex64), persistent=False)
        self.register_buffer("degrees", torch.tensor([degree for degree, _ in self.terms]), persistent=False)
        self.register_buffer("degree", torch.tensor(0))

    def forward(self, direction: Float[Tensor, "V 3 B"], coefficient: Complex[Tensor, "V C"]) -> Complex[Tensor, "V B"]:
        """The series of V rows of coefficients at unit vectors; functions beyond the present degree are left out."""
        x, y, z = direction.unbind(1)
        real, imaginary, powers = torch.ones_like(z), torch.zeros_like(z), [torch.ones_like(z)]
        for _ in range(self.max_degree):
            powers.append(powers[-1] * z)
        height = torch.stack(powers, dim=1)
        polynomials = [height]
        for order in range(1, self.max_degree + 1):
            real, imaginary = real * x - imaginary * y, real * y + imaginary * x
            polynomials += [part[:, None] * height[:, :-order] for part in (real, imaginary)]
        weight = (coefficient * (self.degrees <= self.degree)) @ self.of_polynomials.to(coefficient)
        parts = torch.view_as_real(weight).mT @ torch.cat(polynomials, dim=1)
        return torch.complex(parts[:, 0], parts[:, 1])


def _in_polynomials(degree: int, order: int, max_degree: int) -> list[complex]:
    """Coefficients of B_lm in z^k, then for m = 1, 2, … in z^k Re (x + jy)^m and in z^k Im (x + jy)^m, k ≤ L − m.

    With the sign of Condon and Shortley, they are those of N_lm d^|m| P_l / dz^|m| in powers of z.
    """
    turns = abs(order)
    ratio = math.factorial(degree - turns) / math.factorial(degree + turns)
    norm = math.sqrt((2 * degree + 1) / (4 * math.pi) * ratio) * (-1) ** max(order, 0)
    in_powers = Legendre.basis(degree).deriv(turns).convert(kind=Polynomial).coef * norm
    row = []
    for m in range(max_degree + 1):
        column = np.zeros(max_degree + 1 - m)
        if m == turns:
            column[: len(in_powers)] = in_powers
        row += [*column] if not m else [*column, *math.copysign(1, order) * 1j * column]
    return row


class RadiatingGaussians(RFGaussians):
    """Gaussians with the coefficients of a series and an attenuation each."""

    def __init__(self, num_gaussians: int, num_functions: int) -> None:
        super().__init__(num_gaussians)
        self.coefficient = nn.Parameter(torch.zeros(num_gaussians, num_functions, 2))
        self.attenuation_logit = nn.Parameter(torch.full((num_gaussians,), math.log(_ATTENUATION / (1 - _ATTENUATION))))

    @torch.no_grad()
    def settle(self, position_m: Float[Tensor, "N 3"], spacing_m: float, generator: torch.Generator) -> None:
        """Move the Gaussians to these points, as large as the spacing, with random coefficients."""
        self.position_m.copy_(position_m)
        self.quaternion[:, 0] = 1.0
        self.log_scale.fill_(math.log(spacing_m))
        self.coefficient.copy_(_COEFFICIENT * torch.randn(self.coefficient.shape, generator=generator))


def regular_grid(scaling: Scaling, most: int) -> tuple[Float[Tensor, "N 3"], float]:
    """Points of a regular grid in the box of the data, at most `most`, and their smallest distance in metres."""
    size_m = 2 * scaling.half_size_m
    spacing_m = (size_m.prod() / most) ** (1 / 3)
    while (counts := (size_m / spacing_m).floor().clamp_min(1)).prod() > most:
        spacing_m = spacing_m * 1.02
    axes = [(2 * torch.arange(int(count)) + 1) / int(count) - 1 for count in counts]
    position_m = torch.cartesian_prod(*axes) * scaling.half_size_m + scaling.center_m
    return position_m, float((size_m / counts).min())


class GSRFField(GaussianField):
    """R_k = Σ_i a_i G_i S_i Π_{m<i} (1 − a_m G_m), with S_i the series at the direction from the transmitter."""

    config: GSRFConfig
    network: FourierLegendre
    gaussians: RadiatingGaussians

    def __init__(self, config: GSRFConfig) -> None:
        super().__init__(config, Scaling(), FourierLegendre(config.degree))

    def new_gaussians(self, number: int) -> RadiatingGaussians:
        """New Gaussians with as many coefficients as the series has functions."""
        return RadiatingGaussians(number, (self.config.degree + 1) ** 2)

    def adapt(self, train: PasDataset, generator: torch.Generator) -> None:
        """Place the Gaussians on a regular grid in the box of the training data."""
        self.scaling.adapt(train)
        position_m, spacing_m = regular_grid(self.scaling, self.config.num_gaussians)
        self.gaussians = self.new_gaussians(len(position_m))
        self.gaussians.settle(position_m, spacing_m, generator)

    def attributes(self, tx_position_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "B"], seen: Seen) -> Attributes:
        """Signal and attenuation of the Gaussians `seen`, the same at every carrier."""
        tx_m = self.scaling.in_frame(tx_position_m)
        direction = normalize(self.position_m[seen][..., None] - tx_m.T, dim=1)
        signal = self.network(direction, torch.view_as_complex(self.gaussians.coefficient[seen]))
        attenuation = torch.sigmoid(self.gaussians.attenuation_logit[seen])[:, None].expand(signal.shape)
        transmitted = torch.complex(1 - attenuation, torch.zeros_like(attenuation))
        return Attributes((attenuation * signal)[None], transmitted, torch.ones_like(attenuation))

    def after_step(self, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        """Divide and drop Gaussians; raise the degree of the series when it is time."""
        super().after_step(optimizer, step, share)
        reached = share / self.config.degree_until if self.config.degree_until else 1.0
        self.network.degree.fill_(int(min(reached, 1.0) * self.config.degree))


class GSRF(LearnedMethod):
    """GSRF (NeurIPS 2025), from its paper's idea, on this renderer: blind to the carrier and to the distance.

    Kept: complex Gaussians without a network, real attenuation from 0.1, a complex series of degree 3 in the
    direction from transmitter to Gaussian, its degree raised one by one, a start on a regular grid.
    Left out: 10,000 Gaussians (here hundreds); the loss of Fourier coefficients, and hours of training.
    Changed: the sphere is at the receiver, where the map is measured (paper: at the transmitter); footprints are
    projected with their Jacobian; the grid's spacing follows from the number of points (paper: from the
    wavelength); Gaussians are divided by their pull, dropped by their contribution; the loss is Eq. 12.
    """

    Config = GSRFConfig

    def field(self) -> ChannelField:
        """The field for the options, before training."""
        return GSRFField(self.config)
