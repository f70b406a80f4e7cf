"""Tests of the method: the contract that all methods keep, and what this one should do."""

from __future__ import annotations

import numpy as np
import torch
from plane_waves import PlaneWaveField, PlaneWavesConfig

from xfreqbench import AngularGrid, BartlettBeam, Beams, GridView, ReceiverArray, check_method


def test_it_keeps_the_contract() -> None:
    findings = check_method("plane_waves:PlaneWaves", ["waves=4", "width=16"])
    assert not [str(finding) for finding in findings if finding.fault]


def test_the_direct_wave_alone_peaks_at_the_transmitter() -> None:
    grid = AngularGrid.hemisphere()
    field = PlaneWaveField(PlaneWavesConfig(waves=1, modes=1))
    field.scaling.half_size_m.fill_(1.0)
    field.scaling.rotation.copy_(torch.eye(3))
    last = field.network[-1]
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.tensor([1.0, 0.0, 0.0, 0.0]))  # the direct wave is 1, the learned one 0
        towards = torch.as_tensor(grid.directions[40, 250], dtype=torch.float32)
        element = ReceiverArray(position_m=(0.0, 0.0, 0.0)).element_position_wavelengths
        beams = Beams(BartlettBeam(element, grid), torch.device("cpu"))
        power = field.power(2.5 * towards[None], torch.tensor([5e9]), GridView(), beams)
    assert np.unravel_index(int(power[0].argmax()), grid.shape) == (40, 250)
