"""The code and the commands of baselines/README.md do what it says."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.support.forked import command_line
from tests.support.packages import install
from tests.support.places import ROOT
from tests.support.synthetic import paper_dataset
from xfreqbench.data.dataset import open_dataset
from xfreqbench.maps.metrics import psnr
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within

README = (ROOT / "baselines" / "README.md").read_text()
FILES = dict(re.findall(r"^`([\w./]+)`:\n\n```\w+\n(.*?)^```$", README, re.MULTILINE | re.DOTALL))
COMMANDS = [
    shlex.split(line)
    for block in re.findall(r"^```sh\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]
PACKAGE = "my_channel_methods"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The README's files and a data set, in a folder in which its commands can be given."""
    folder = tmp_path_factory.mktemp("tutorial")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    paper_dataset(folder / "office.h5")
    return folder


def given(command: list[str], folder: Path) -> str:
    """Output of a command of the README, which must succeed."""
    assert command[0] == "xfreqbench"
    done = subprocess.run(
        [command_line(), *command[1:]],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder / PACKAGE)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_readme_holds_the_files_and_commands_that_are_tested() -> None:
    assert list(FILES) == ["your_module.py", f"{PACKAGE}/pyproject.toml", f"{PACKAGE}/{PACKAGE}.py"]
    assert [command[:2] for command in COMMANDS] == [
        ["xfreqbench", "check-method"],
        ["xfreqbench", "run"],
        ["pip", "install"],
        ["xfreqbench", "check-method"],
        ["xfreqbench", "run"],
        ["xfreqbench", "report"],
    ]


def test_the_short_example_keeps_the_contract_and_gets_its_row(folder: Path) -> None:
    assert "FAULT" not in given(COMMANDS[0], folder)
    assert "your_module:GlobalMean" in given(COMMANDS[1], folder)


def test_the_package_is_found_by_name_keeps_the_contract_and_stands_in_the_leaderboard(folder: Path) -> None:
    project = tomllib.loads((folder / PACKAGE / "pyproject.toml").read_text())["project"]
    ((group, entries),) = project["entry-points"].items()
    install(folder / PACKAGE, project["name"], group, **entries)
    findings = given(COMMANDS[3], folder)
    assert "FAULT" not in findings
    assert "warn" not in findings
    rows = [line for line in given(COMMANDS[4], folder).splitlines() if line.startswith("|") and "my-method" in line]
    assert len(rows) == 1
    given(COMMANDS[5], folder)
    assert "my-method" in (folder / "BENCHMARK.md").read_text()


def test_the_package_learns(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder / PACKAGE)
    from my_channel_methods import FourierRidge

    dataset = open_dataset(folder / "office.h5")
    method = FourierRidge()
    fit_within(method, dataset, Budget(), seed=0)
    predicted = method.predict(dataset.tx_position_m, dataset.carrier_hz)
    blind = np.broadcast_to(dataset.pas().mean(axis=0), predicted.shape).astype(np.float32)
    assert np.median(psnr(predicted, dataset.pas(), dataset.grid)) > 3 + np.median(
        psnr(blind, dataset.pas(), dataset.grid)
    )
