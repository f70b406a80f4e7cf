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
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import Fit, fit_within
from xfreqbench.methods.template import write_method_package
from xfreqbench.runs.folder import read_records

TEMPLATE = ROOT / "examples" / "xfreqbench-method-template"
PROJECT = tomllib.loads((TEMPLATE / "pyproject.toml").read_text())["project"]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900), pytest.mark.usefixtures("one_thread")]


def test_whoever_follows_its_readme_gets_a_package_that_works(tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(TEMPLATE, folder, ignore=shutil.ignore_patterns("__pycache__", "build", "*.egg-info"))
    reader = follow(TEMPLATE / "README.md", folder)
    require_installed_and_tested(reader.said("pip install"))
    require_contract(reader.said("check-method"))
    require_known_by_name(reader.shell("xfreqbench methods"))
    require_rows(folder)


def require_installed_and_tested(printed: str) -> None:
    assert f"Successfully installed {PROJECT['name']}-{PROJECT['version']}" in printed
    assert re.search(r"\d+ passed", printed)
    assert "failed" not in printed


def require_contract(printed: str) -> None:
    lines = printed.splitlines()
    assert sum(line.startswith("ok ") for line in lines) > 10
    assert not [line for line in lines if line.startswith(("FAULT", "warn"))]


def require_known_by_name(printed: str) -> None:
    (name,) = PROJECT["entry-points"]["xfreqbench.methods"]
    assert re.search(rf"^{name} +plug-in, from {PROJECT['name']}$", printed, re.MULTILINE)


def require_rows(folder: Path) -> None:
    stored = read_records(folder / "results")
    assert [record.job.method for record in stored] == ["plane-waves", "mean-over-frequency", "plane-waves"]
    assert stored[-1].job.overrides == ("waves=8",)
    assert "| plane-waves |" in " ".join((folder / "BENCHMARK.md").read_text().split())


def test_a_copy_under_another_name_passes_its_tests_at_once(tmp_path: Path) -> None:
    write_method_package("my-method", tmp_path / "my-method")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "my-method"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout


def test_its_workflow_gives_commands_that_the_readme_gives() -> None:
    workflow = (TEMPLATE / ".github" / "workflows" / "tests.yml").read_text()
    commands = re.findall(r"- run: (xfreqbench .*|python .*)$", workflow, re.MULTILINE)
    assert len(commands) == 5
    readme = (TEMPLATE / "README.md").read_text().splitlines()
    assert not [command for command in commands if command not in readme]


@pytest.fixture
def dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PasDataset:
    monkeypatch.syspath_prepend(TEMPLATE / "src")
    return write_dataset(tmp_path / "data.h5", num_tx=12)


def test_it_learns(dataset: PasDataset) -> None:
    """What it is trained on it knows far better than at the start: measured, its loss falls to a twenty-fifth."""
    from plane_waves import PlaneWaves, PlaneWavesConfig

    method, losses = PlaneWaves(PlaneWavesConfig(ssim_weight=0.0, carrier_blur=0.0)), []
    fit_within(method, dataset, Budget(max_steps=150), 0, observe=lambda _, now: losses.append(now.loss))
    assert np.mean(losses[-10:]) < np.mean(losses[:3]) / 3


def test_a_fit_that_goes_on_ends_where_an_unbroken_one_does(dataset: PasDataset, tmp_path: Path) -> None:
    from plane_waves import PlaneWaves

    def save_at_six(_: Fit | None, now: Fit) -> None:
        if now.step == 6:
            whole.save(tmp_path)

    whole, budget = PlaneWaves(), Budget(max_steps=12)
    fit_within(whole, dataset, budget, seed=0, observe=save_at_six)
    resumed = PlaneWaves.load(tmp_path)
    asked = dataset.tx_position_m[:4], dataset.carrier_hz[:4]
    assert not np.array_equal(resumed.predict(*asked), whole.predict(*asked))
    fit_within(resumed, dataset, budget, seed=0)
    assert np.array_equal(resumed.predict(*asked), whole.predict(*asked))
