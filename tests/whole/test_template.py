"""The template is a package that pip installs, that the toolkit finds by name, and that learns."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.support.documents import ROOT, follow
from tests.support.synthetic import write_dataset
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.template import write_method_package
from xfreqbench.runs.folder import read_records

TEMPLATE = ROOT / "examples" / "xfreqbench-method-template"
PROJECT = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())["project"]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.usefixtures("one_thread")]


def test_whoever_follows_its_readme_gets_a_package_that_works(tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(TEMPLATE, folder, ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"))
    reader = follow(TEMPLATE / "README.md", folder)
    installed = reader.said("pip install")
    assert f"Successfully installed {PROJECT['name']}-{PROJECT['version']}" in installed
    assert re.search(r"\d+ passed", installed) and "failed" not in installed
    lines = reader.said("check-method").splitlines()
    assert sum(line.startswith("ok ") for line in lines) > 10
    assert not [line for line in lines if line.startswith(("FAULT", "warn"))]
    (name,) = PROJECT["entry-points"]["xfreqbench.methods"]
    known = reader.shell("xfreqbench methods")
    assert re.search(rf"^{name} +plug-in, from {PROJECT['name']}$", known, re.MULTILINE)
    stored = read_records(folder / "results")
    assert [record.job.method for record in stored] == ["plane-waves", "mean-over-frequency", "plane-waves"]
    assert stored[-1].job.overrides == ("waves=8",)
    assert "| plane-waves |" in " ".join((folder / "BENCHMARK.md").read_text().split())


def test_a_copy_under_another_name_passes_its_own_test_at_once(tmp_path: Path) -> None:
    """That of the contract it has passed under its first name, and `check-method` of a copy is in the tutorial."""
    write_method_package("my-method", tmp_path / "my-method")
    command = [sys.executable, "-m", "pytest", "-q", "my-method", "-k", "not contract"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


def test_its_workflow_gives_commands_that_the_readme_gives() -> None:
    workflow = (TEMPLATE / ".github" / "workflows" / "tests.yml").read_text()
    commands = re.findall(r"- run: (xfreqbench .*|python .*)$", workflow, re.MULTILINE)
    assert len(commands) == 5
    readme = (TEMPLATE / "README.md").read_text().splitlines()
    assert not [command for command in commands if command not in readme]


def test_it_learns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it is trained on it knows far better than at the start: measured, its loss falls to a twenty-fifth."""
    monkeypatch.syspath_prepend(TEMPLATE / "src")
    from plane_waves import PlaneWaves, PlaneWavesConfig

    method, losses = PlaneWaves(PlaneWavesConfig(ssim_weight=0.0, carrier_blur=0.0)), []
    dataset = write_dataset(tmp_path / "data.h5", num_tx=12)
    fit_within(method, dataset, Budget(max_steps=150), 0, observe=lambda _, now: losses.append(now.loss))
    assert np.mean(losses[-10:]) < np.mean(losses[:3]) / 3
