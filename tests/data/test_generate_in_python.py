"""`xb.generate` is the command `generate`: the same options, the same file, the same refusals."""

from __future__ import annotations

import inspect
from dataclasses import fields, replace
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from typing_extensions import Doc

import xfreqbench as xb
from tests.support.fuzzing.common import xfreqbench
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.options import GenerateOptions
from xfreqbench.errors import ArgumentError, OutputExistsError, PlacementError, XFreqBenchError
from xfreqbench.scene.toml_files import shipped_folder
from xfreqbench.tracing.versions import software_versions

SMALL = {"freqs_ghz": [2.4, 24.25], "tx": 3, "rays": 20_000, "max_depth": 2}


def small(path: Path, **changes: object) -> PasDataset:
    return xb.generate("empty", output=path, **{**SMALL, **changes})  # type: ignore[arg-type]


def test_the_options_of_the_command_are_those_of_python_and_each_says_what_it_is() -> None:
    known = {each.name: each.default for each in fields(GenerateOptions)}
    for function, own in ((xb.generate, {"tx_positions", "receiver"}), (xb.generate_rooms, {"rooms"})):
        taken = [*inspect.signature(function).parameters.values()][2:]
        others = {"rooms", "tx_positions", "receiver"} - own
        assert {each.name: each.default for each in taken if each.name != "rooms"} == {
            name: default for name, default in known.items() if name not in others | {"rooms"}
        }
    command = xfreqbench("generate", "--help").stdout
    for name, hint in get_type_hints(GenerateOptions, include_extras=True).items():
        if name not in ("_", "progress", "tell"):
            assert f"--{name.replace('_', '-')}" in command
            assert [part for part in hint.__metadata__ if isinstance(part, Doc)]
    with pytest.raises(ArgumentError, match="generate_rooms needs rooms"):
        xb.generate_rooms("rooms", "x")


def test_what_the_rays_are_asked_by_default_are_the_defaults_of_the_settings() -> None:
    assert GenerateOptions().settings == xb.TraceSettings()


def test_a_scene_is_a_name_a_path_or_a_scene(tmp_path: Path) -> None:
    toml = shipped_folder() / "empty.toml"
    for scene in ("empty", str(toml), toml, xb.load_scene(toml)):  # data of another scene would be refused there
        dataset = xb.generate(scene, output=tmp_path / "data.h5", **SMALL)  # type: ignore[arg-type]
        assert (dataset.header.scene_name, dataset.path) == ("empty", tmp_path / "data.h5")


def test_transmitters_stand_where_they_are_put(tmp_path: Path) -> None:
    positions = np.array([[2.0, 1.0, 1.0], [3.0, 2.0, 1.5]])
    dataset = small(tmp_path / "data.h5", tx=None, tx_positions=positions)
    np.testing.assert_array_equal(dataset.tx_position_m[::2], positions)
    without_grid = replace(xb.load_scene("empty"), transmitters=None)
    again = xb.generate(without_grid, tmp_path / "again.h5", **{**SMALL, "tx": None, "tx_positions": positions})  # type: ignore[arg-type]
    assert again.scene.transmitters is None
    assert again.recipe == dataset.recipe
    with pytest.raises(PlacementError, match=r"'empty' has no grid.*--tx-positions.*\[transmitters\]"):
        xb.generate(without_grid, tmp_path / "none.h5", **SMALL)  # type: ignore[arg-type]


def test_refusals_are_those_of_the_command(tmp_path: Path) -> None:
    small(tmp_path / "data.h5")
    empty = xb.load_scene("empty")
    assert empty.transmitters
    crossed = replace(empty, transmitters=replace(empty.transmitters, polarization="H"))
    with pytest.raises(OutputExistsError, match="transmitter_polarization none there, H here"):
        xb.generate(crossed, tmp_path / "data.h5", **SMALL)  # type: ignore[arg-type]
    with pytest.raises(XFreqBenchError, match="give one of them"):
        small(tmp_path / "x.h5", tx_positions=np.ones((1, 3)))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data.h5"]


def test_data_of_other_software_are_used_where_the_same_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = software_versions("image")
    with monkeypatch.context() as patch:
        patch.setattr("xfreqbench.data.plan.software_versions", lambda solver: known | {"numpy": "0.1"})
        small(tmp_path / "data.h5")
    before = (tmp_path / "data.h5").stat().st_mtime_ns
    said: list[str] = []
    described = replace(xb.load_scene("empty"), description="said in other words")
    xb.generate(described, tmp_path / "data.h5", **SMALL, tell=said.append)  # type: ignore[arg-type]
    assert (tmp_path / "data.h5").stat().st_mtime_ns == before
    assert f"by other software, numpy 0.1 (here {known['numpy']})" in said[-1]
    with pytest.raises(
        OutputExistsError, match=r"another data set: seed 1 there, 2 here; other transmitters \(\d+\)\. Choose"
    ):
        small(tmp_path / "data.h5", seed=2)


def test_bars_are_drawn_where_a_person_looks_and_none_before_a_refusal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    small(tmp_path / "data.h5")  # into a file, and not asked for
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes this for a terminal
    monkeypatch.setenv("TTY_INTERACTIVE", "1")
    with pytest.raises(OutputExistsError):
        small(tmp_path / "data.h5", seed=2)
    small(tmp_path / "silent.h5", progress=False)
    assert not capsys.readouterr().err
    small(tmp_path / "shown.h5")
    shown = capsys.readouterr().err
    assert "tracing" in shown and "3 of 3 transmitters" in shown
