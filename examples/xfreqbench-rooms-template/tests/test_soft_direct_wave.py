"""Tests of the method: the contract that all methods that learn across rooms keep, and what this one should do."""

from __future__ import annotations

from soft_direct_wave import SoftDirectWave, SoftDirectWaveConfig

from xfreqbench import check_method


def test_it_keeps_the_contract() -> None:
    findings = check_method("soft_direct_wave:SoftDirectWave")
    assert not [str(finding) for finding in findings if finding.fault]


def test_before_it_learns_it_is_the_direct_wave() -> None:
    assert SoftDirectWave(SoftDirectWaveConfig(powers=(0.5,))).power == 1.0
