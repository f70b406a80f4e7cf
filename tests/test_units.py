"""Numbers are what a reader sees; carriers are given in GHz, and whoever gives another unit is asked."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import xfreqbench as xb
from xfreqbench.cli.options import parse_carriers_hz
from xfreqbench.errors import ArgumentError, XFreqBenchError
from xfreqbench.units import MAX_CARRIER_GHZ, ghz_to_hz, parse_number

QUESTION = r"at most 1,000, and not 2\.425e\+10\. Was that hertz\? Then it is 24\.25 GHz"


def test_a_number_is_the_one_that_its_text_shows() -> None:
    texts = {"2.4": 2.4, "010": 10, " -1.5e3 ": -1500, "+.5": 0.5, "5.": 5, "1E1": 10}
    assert {text: parse_number(text) for text in texts} == texts
    assert [parse_number(text, int) for text in ("007", "-3", "9" * 400)] == [7, -3, 10**400 - 1]


@pytest.mark.parametrize("text", ["1_0", "2_4.5", "nan", "inf", "1e999", "0x10", "1:30", "1,5", "٣", "", "1 0", "−1"])
def test_what_a_parser_may_take_for_another_number_is_refused(text: str) -> None:
    for kind in (float, int):
        with pytest.raises(ValueError, match=r"."):
            parse_number(text, kind)


def test_gigahertz_become_whole_hertz() -> None:
    assert ghz_to_hz(24.25) == 24_250_000_000
    assert ghz_to_hz(MAX_CARRIER_GHZ) == 1e12


@pytest.mark.parametrize("carrier_ghz", [0.0, -1.0, float("nan"), float("inf"), 1e-12])
def test_what_is_no_carrier_is_refused(carrier_ghz: float) -> None:
    with pytest.raises(ValueError, match="a number above 0"):
        ghz_to_hz(carrier_ghz)


@pytest.mark.parametrize(
    ("given", "question"),
    [
        (2400, "Was that MHz? Then it is 2.4 GHz"),
        (94e3, "Was that MHz? Then it is 94 GHz"),
        (2.4e6, "Was that kHz? Then it is 2.4 GHz"),
        (868e6, "Was that hertz? Then it is 0.868 GHz"),
        (94e9, "Was that hertz? Then it is 94 GHz"),
        (1e15, "Was that hertz? Then it is 1e+06 GHz"),
    ],
)
def test_the_unit_that_is_asked_for_is_one_that_makes_a_carrier(given: float, question: str) -> None:
    with pytest.raises(ValueError, match=re.escape(question)):
        ghz_to_hz(given)


def test_whoever_gives_hertz_is_asked_in_python_and_on_the_command_line(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=f"freqs_ghz: .*{QUESTION}"):
        xb.generate("empty", tmp_path / "data.h5", freqs_ghz=[24.25e9])
    with pytest.raises(ArgumentError, match=f"targets_ghz=.*{QUESTION}"):
        xb.run("data.h5", "nearest", targets_ghz=24.25e9, results=tmp_path)
    with pytest.raises(XFreqBenchError, match=f"--freqs-ghz takes .* cannot use '24.25e9': .*{QUESTION}"):
        parse_carriers_hz("24.25e9")
    assert not list(tmp_path.iterdir())
