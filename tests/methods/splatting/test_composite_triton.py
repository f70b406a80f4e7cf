"""What a CUDA device computes: here by Triton's interpreter and without values, and on a device where there is one."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch
from xfreqbench.baselines.wrf_gs_plus import WRFGSPlus
from xfreqbench.baselines.xfreq_gs_paper import XFreqGSPaper

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.learning.targets import Targets
from xfreqbench.methods.splatting.projection import Projection

TRITON = "triton is not installed; on Linux it comes with xfreqbench[dev]"
on_a_device = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA device")
SAME = """
import sys
import numpy as np, torch
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.methods.splatting import composite_triton as on_device
from xfreqbench.methods.splatting.composite import composite
from xfreqbench.methods.splatting.footprints import bin_footprints, squared_distance
from xfreqbench.methods.splatting.projection import project

device, support, batch, sets = sys.argv[1], 9.0, 3, int(sys.argv[2])
on_device.MAX_LANES, on_device.STRETCH, on_device.LISTED_AT_ONCE = 2, 4, 8  # several of each
grid = AngularGrid(np.radians(np.arange(0, 90, 18.0)), np.radians(np.arange(-180, 180, 36.0)))
torch.manual_seed(0)
position_m = torch.randn(12, 3).abs() * torch.tensor([-1.0, 0.3, 1.0])  # across the azimuth's seam
position_m[0] = torch.tensor([1e-3, 0.0, 2.0])  # at the zenith
axes = 0.3 * torch.randn(12, 3, 3)
phase_rad, loss = torch.randn(12, batch), torch.rand(12, batch)
inputs = position_m, axes @ axes.mT + 1e-3 * torch.eye(3), 0.5 + torch.rand(12, batch), \\
    torch.randn(12, batch, dtype=torch.complex64), torch.polar(loss, phase_rad)
weight = torch.randn(sets * batch, grid.shape[0] * grid.shape[1], dtype=torch.complex64)

def answer(double):
    kinds = {False: (torch.float32, torch.complex64), True: (torch.float64, torch.complex128)}[double]
    given = [each.detach().to("cpu" if double else device, kinds[each.is_complex()]) for each in inputs]
    given = [each.requires_grad_() for each in given]
    if double:
        fields = []
        for position_m, covariance, *rest in zip(*(each.chunk(sets) for each in given), strict=True):
            projection = project(position_m, covariance)
            lists = bin_footprints(projection, grid, support)
            fields.append(composite(lists, squared_distance(projection, lists, grid), *rest))
        field = torch.cat(fields)
    else:
        angles = [torch.from_numpy(each).float().to(device) for each in (grid.azimuth_rad, grid.elevation_rad)]
        field = on_device.composite_on_cuda(project(given[0], given[1]), *angles, support, *given[2:], sets)
    (field * weight.to(field).conj()).real.sum().backward()
    return [field.detach(), *(each.grad for each in given)]

for got, right in zip(answer(False), answer(True), strict=True):
    assert right.abs().max() > 0
    print(float((got.cpu() - right).norm() / right.norm()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=[pytest.mark.gpu, on_a_device])])
@pytest.mark.parametrize("sets", [1, 3], ids=["one", "several"])
def test_tiles_of_directions_give_field_and_gradients_of_lists_in_double_precision(device: str, sets: int) -> None:
    """Of one set of Gaussians, and of several, each with its own samples."""
    pytest.importorskip("triton", reason=TRITON)
    interpreted = {"TRITON_INTERPRET": "1"} if device == "cpu" else {}
    command = [sys.executable, "-c", SAME, device, str(sets)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **interpreted})
    assert result.returncode == 0, result.stderr
    errors = [float(line) for line in result.stdout.split()]
    assert len(errors) == 6
    assert max(errors) < 2e-5  # float32, whose positions at the zenith turn by 1e-5 of an azimuth


def test_a_step_on_a_device_waits_for_no_value_and_mixes_no_devices(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tensors of the device `meta` have no values: whatever asks for one, or for a tensor of the host, fails."""
    triton = pytest.importorskip("xfreqbench.methods.splatting.composite_triton", reason=TRITON)

    def field_of(
        projection: Projection, azimuth: torch.Tensor, elevation: torch.Tensor, *rest: object, num_sets: int = 1
    ) -> torch.Tensor:
        _, spread, signal, attenuation = rest
        each = projection.azimuth_rad[:, None] + projection.covariance.sum() + spread * signal * attenuation
        of_samples = each.unflatten(0, (num_sets, -1)).sum(1).flatten()
        return of_samples[:, None].expand(-1, len(azimuth) * len(elevation))

    monkeypatch.setattr(triton, "composite_on_cuda", field_of)
    small: dict[str, Any] = {"num_gaussians": 9, "max_gaussians": 9, "width": 4, "batch_size": 3, "ssim_window": 3}
    small |= {"precision": "float32", "stride": 1, "band": False}
    changes = {}, {"footprint": "circular", "sees_carrier": False, "latent": 0}, {"direct_wave": True}
    methods = [*(XFreqGSPaper(XFreqGSPaper.Config(**small, **each)) for each in changes)]
    for method in (*methods, WRFGSPlus(WRFGSPlus.Config(**small))):
        method._device = torch.device("meta")
        training = method.started(dataset, seed=0)
        targets = Targets(dataset, training.beams)
        view, nth, *rows = method._random_rows(training, targets)
        weight = torch.tensor(0.3, device="meta")
        loss = method._loss_of_rows(training, targets, view, nth.to("meta"), *rows[:2], weight)
        loss.backward()
        assert loss.is_meta
        trained = [name for name, value in training.field.named_parameters() if value.grad is not None]
        assert {"gaussians.position_m", "network.mlp.head.weight"} <= set(trained)


@pytest.mark.gpu
@on_a_device
def test_a_replayed_step_is_a_step_done_one_by_one(dataset: PasDataset) -> None:
    losses = []
    for replays in (True, False):
        options = {"num_gaussians": 50, "max_gaussians": 50, "ssim_window": 3, "device": "cuda", "precision": "float32"}
        method = XFreqGSPaper(XFreqGSPaper.Config(**options))
        if not replays:
            method._is_capturable = lambda *_: False  # type: ignore[method-assign]
        training = method.started(dataset, seed=0)
        targets = Targets(dataset, training.beams)
        losses.append([method._step(training, targets) for _ in range(8)])
    assert np.allclose(losses[0], losses[1], atol=1e-4)
