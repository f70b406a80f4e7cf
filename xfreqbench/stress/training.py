"""Encodings, targets, losses, networks and short fits."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from xfreqbench.dataset import PasDataset
from xfreqbench.splatting import stress_training as torch_cases
from xfreqbench.stress.case import Case
from xfreqbench.stress.channels import data_of

_SINGLE = 5e-6  # as of maps: sums of 136 pairs of elements in float32, of a peak of 1
# some roundings of 6e-8
_ROUNDINGS = 1e-6


def _on_data(run: Callable[[PasDataset], float]) -> float:
    """With twelve random channels at two carriers, as they are stored."""
    rng = np.random.default_rng(0)
    tx_m = rng.uniform((0.5, 0.5, 0.5), (4.0, 4.0, 1.5), size=(6, 3))
    cfr = rng.normal(size=(6, 2, 16)) + 1j * rng.normal(size=(6, 2, 16))
    with tempfile.TemporaryDirectory() as folder:
        return run(data_of(Path(folder) / "train.h5", tx_m, [1e9, 10e9], (1e-4 * cfr).astype(np.complex128)))


def _equal_fits(train: PasDataset) -> float:
    return torch_cases.refit(train, (1, 1))


def _unequal_fits(train: PasDataset) -> float:
    """1 where another seed gives the same maps."""
    return float(torch_cases.refit(train, (1, 2)) == 0)


_ENCODING = (
    Case(
        "carriers within the training band",
        "encoding",
        _ROUNDINGS,
        "absolute",
        partial(torch_cases.unit_carriers, 1e9, 94e9, [1e9, 94e9, 24.25e9]),
    ),
    Case(
        "carriers outside the training band",
        "encoding",
        _ROUNDINGS,
        "absolute",
        partial(torch_cases.unit_carriers, 1e9, 94e9, [0.5e9, 300e9]),
    ),
    Case(
        "band of one carrier",
        "encoding",
        _ROUNDINGS,
        "absolute",
        partial(torch_cases.unit_carriers, 1e9, 1e9, [1e9, 2e9]),
    ),
    Case(
        "band of 100 kHz at 24.25 GHz",
        "encoding",
        _ROUNDINGS,
        "absolute",
        partial(torch_cases.unit_carriers, 24.25e9, 24.25e9 + 1e5, [24.25e9, 24.25e9 + 1e5]),
    ),
    # float64 keeps 4e-15 of a logarithm of 24, and 1 Hz is 4e-11 of it
    Case(
        "band of 1 Hz at 24.25 GHz",
        "encoding",
        3e-4,
        "absolute",
        partial(torch_cases.unit_carriers, 24.25e9, 24.25e9 + 1, [24.25e9, 24.25e9 + 1]),
    ),
    # 2⁹π rad in float32: 6e-8 of 1608
    Case("positions in ten octaves", "encoding", 2e-4, "absolute", torch_cases.finest_octave),
)
CASES = (
    *_ENCODING,
    Case(
        "targets from stored channels at all directions",
        "training",
        _SINGLE,
        "absolute",
        partial(_on_data, torch_cases.targets),
    ),
    Case(
        "beams by lags against their definition",
        "training",
        _SINGLE,
        "absolute",
        partial(torch_cases.beams, 1.0),
    ),
    Case("beams of channels of 1e-12", "training", _SINGLE, "absolute", partial(torch_cases.beams, 1e-12)),
    Case("beams of channels of 1e12", "training", _SINGLE, "absolute", partial(torch_cases.beams, 1e12)),
    Case("a view of a map against beams in view", "training", _SINGLE, "absolute", torch_cases.views),
    *(
        Case(
            f"loss of a zero {kind} map, SSIM {weight:.0%}",
            "training",
            0,
            "values",
            partial(torch_cases.zero_map, kind, weight),
        )
        for kind in ("power", "amplitude")
        for weight in (0.0, 0.8)
    ),
    # the gradient of SSIM adds 49 windows, each some roundings of 6e-8 off
    Case(
        "loss of power maps of 1e-25, gradient rescaled",
        "training",
        1e-4,
        "relative",
        partial(torch_cases.faint_map, "power"),
    ),
    Case(
        "loss of amplitude maps of 1e-25, gradient rescaled",
        "training",
        1e-4,
        "relative",
        partial(torch_cases.faint_map, "amplitude"),
    ),
    *(
        Case(
            f"gradients of fields without and with a faint response, {kind}",
            "training",
            0,
            "values",
            partial(_on_data, partial(torch_cases.faint_field, kind=kind)),
        )
        for kind in ("power", "amplitude")
    ),
    # variances are differences of means of squares: 6e-8 over C₂ = 9e-4; population covariances are 1e-3 off
    Case("SSIM loss equals SSIM score", "training", 1e-4, "absolute", torch_cases.ssim_loss),
    Case("gradient of the SSIM of flat maps", "training", 0, "values", torch_cases.flat_ssim_gradient),
    Case(
        "a fit stops before a nan is stepped on",
        "training",
        0,
        "values",
        partial(_on_data, torch_cases.divergence),
    ),
    # 8 bits, rounded in each of five layers: 5 · 2^−9 and as much for what is cancelled in the sums
    Case("network in bfloat16", "training", 2e-2, "relative", torch_cases.bfloat16),
    Case(
        "field whose Gaussians are all behind the horizon",
        "training",
        0,
        "absolute",
        partial(_on_data, torch_cases.behind_the_horizon),
    ),
    Case(
        "fields with a Gaussian at the receiver",
        "training",
        0,
        "values",
        partial(_on_data, torch_cases.gaussian_at_the_receiver),
    ),
    Case(
        "power at 1 MHz and 1 THz, trained on 1 to 10 GHz",
        "training",
        0,
        "values",
        partial(_on_data, torch_cases.unseen_carriers),
    ),
    Case("two fits with one seed", "seeds", 0, "absolute", partial(_on_data, _equal_fits)),
    Case("two fits with two seeds differ", "seeds", 0, "fits", partial(_on_data, _unequal_fits)),
)
