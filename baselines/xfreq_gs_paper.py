"""XFreq-GS with the choices of its paper and of its released code: random points, all pairs, 32 maps a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field as Limits

from xfreqbench.methods.learning.training import Count, Fraction, Positive

from .xfreq_gs import XFreqGS, XFreqGSConfig


@dataclass(frozen=True)
class XFreqGSPaperConfig(XFreqGSConfig):
    """Options. Each says where it comes from: the paper, its released code, or this project where both are silent."""

    network: Literal["low-rank", "pairwise"] = "pairwise"  # paper, Eq. 7
    width: Count = 256  # paper; the released code has 384, with branches that scale each other
    layers: Count = 6  # paper
    tx_octaves: Annotated[int, Limits(ge=0)] = 10  # released code, 2^0 … 2^9; the paper states no number
    position_octaves: Annotated[int, Limits(ge=0)] = 10  # released code
    tx_levels: Annotated[int, Limits(ge=0, le=8)] = 0  # paper: no learned features of places
    bearing: bool = False  # paper
    latent: Annotated[int, Limits(ge=0)] = 8  # released code: the size of a point's code
    max_spread: Annotated[float, Limits(ge=1)] = 1.1  # released code: 0.9 … 1.1
    start: Literal["lattice", "random"] = "random"  # paper; here in the box of the training transmitters
    num_gaussians: Count = 1000  # this project, on validation rows: neither states a number
    max_gaussians: Annotated[int, Limits(ge=1)] = 1000  # this project
    angular_size_deg: Annotated[float, Limits(gt=0, le=90)] = 1.8  # this project: about 200 directions
    direct_wave: bool = False  # paper
    band: bool = False  # paper: accumulated on all directions
    batch_size: Count = 32  # this project, so that a step fills a GPU; the released code has 1
    learning_rate: Positive = 1e-3  # this project, on validation rows; the released code has 1.6e-4 for the network
    position_rate: Positive = 5.0  # released code: half the scene's size in metres times the network's rate
    move_from: Fraction = 0.0  # paper
    densify_every: Annotated[int, Limits(ge=0)] = 0  # this project; the released code divides every 100 steps
    ssim_weight: Fraction = 0.4  # released code; the paper states no number
    ssim_ramp: Fraction = 1 / 6  # released code: 5,000 of 30,000 steps
    stride: Count = 1  # paper: all directions
    ssim_window: Annotated[int, Limits(ge=2)] = 7  # the score's; the released code has a Gaussian window
    averaging: Annotated[float, Limits(ge=0, lt=1)] = 0.0  # paper
    blend: Literal["auto", "none"] = "none"  # paper


class XFreqGSPaper(XFreqGS):
    """XFreq-GS as its paper and its released code have it, on this renderer.

    Changed: carriers lie on a logarithmic axis without octaves (a fine encoding memorises nine carriers); the product
    along a direction is Π (1 − G(1 − δ)); positions move by their footprints' gradient alone; one rate for all of the
    geometry, which falls as half a cosine with the others; random points lie in the box of the training transmitters,
    not of the room; hidden layers compute in bfloat16 where the processor has it (`precision`); Gaussians are neither
    divided nor dropped (with `densify_every` they are divided by their pull, and dropped by their contribution);
    attenuation is complex, as in the paper, not in the released code.
    """

    Config = XFreqGSPaperConfig
