from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from ast import literal_eval
from functools import partial
from importlib.metadata import distribution
from pathlib import Path
from subprocess import DEVNULL

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.places import ROOT
from tests.support.prediction_files import hand_out, write_predictions
from tests.support.synthetic import paper_dataset
from xfreqbench.data.dataset import PasDataset

PURELIB = "import sysconfig; print(sysconfig.get_path('purelib'))"
FIRST_STEPS = """
import sys, xfreqbench as xb
from xfreqbench.report.leaderboard.results import results_at
assert xb.__file__.startswith(sys.prefix), xb.__file__
data = xb.load("office")
assert data.pas(3).max() == 1 and "nearest" in xb.methods() and "lounge" in xb.scenes()
xb.run(data, "nearest", targets_ghz=[10], results="results", budget="3steps")
assert results_at("v2").is_relative_to(sys.prefix)
"""

SPLIT_SCORE_REPORT = """
import sys
from xfreqbench.cli.main import main
for line in sys.stdin:
    sys.argv[1:] = line.split()
    try:
        main()
    except SystemExit as end:
        assert not end.code, line
assert not {"torch", "mitsuba", "numba", "sionna"} & set(sys.modules)
"""


def environment(folder: Path, *paths: str | Path) -> Path:
    """The Python of an environment that has nothing but what lies in these folders."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    python = folder / "bin/python"
    site = Path(subprocess.run([python, "-c", PURELIB], check=True, capture_output=True, text=True).stdout.strip())
    (site / "paths.pth").write_text("\n".join(map(str, paths)))
    return python


def link_distributions(names: list[str], folder: Path) -> None:
    """Link what these distributions, and all that they require, have installed here into a folder."""
    seen: set[str] = set()
    while names:
        if (name := canonicalize_name(names.pop())) in seen:
            continue
        seen.add(name)
        found = distribution(name)
        needed = map(Requirement, found.requires or [])
        names += [each.name for each in needed if not each.marker or each.marker.evaluate({"extra": ""})]
        tops = {path.parts[0] for path in found.files or [] if path.parts[0] != ".."}
        for top in tops - {entry.name for entry in folder.iterdir()} - {"__pycache__"}:
            (folder / top).symlink_to(found.locate_file(top))


def test_every_package_and_the_mark_of_its_types_is_in_the_wheel() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {path.parent for name in ("xfreqbench", "baselines") for path in (ROOT / name).rglob("__init__.py")}
    packages = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    packages = {name if name.startswith("xfreqbench") else f"xfreqbench.{name}" for name in packages}
    assert set(settings["packages"]) == packages | {"xfreqbench.examples", "xfreqbench.scenes"}
    assert "py.typed" in settings["package-data"]["xfreqbench"]
    assert (ROOT / "xfreqbench" / "py.typed").is_file()


def test_what_the_tests_run_with_is_what_the_package_allows() -> None:
    """`constraints.txt` pins versions of dependencies; `pyproject.toml` says which ones may be installed."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pinned = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines())
    pinned = {canonicalize_name(name): version for name, version in pinned.items()}
    extras = [needed for name, needed in project["optional-dependencies"].items() if name not in {"deepmimo", "peers"}]
    for needed in map(Requirement, sum(extras, project["dependencies"])):
        assert needed.specifier.contains(pinned[canonicalize_name(needed.name)]), needed
        assert "==" not in str(needed.specifier), f"{needed}: versions are pinned in constraints.txt alone"


def test_the_version_is_the_same_wherever_it_is_said() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert version == cited["version"] == released[0]
    assert f"version = {{{version}}}" in (ROOT / "docs" / "questions.md").read_text("utf-8")


def test_the_workflow_tests_every_python_that_is_promised() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text())
    tested = [entry["python"] for entry in workflow["jobs"]["tests"]["strategy"]["matrix"]["include"]]
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["classifiers"]
    assert tested == [words[-1] for words in map(str.split, classifiers) if words[-1].startswith("3.")]


def test_windows_is_told_what_runs_it() -> None:
    program = "import sys; sys.platform = 'win32'; import xfreqbench"
    refused = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert refused.stderr.splitlines()[-1].startswith("ImportError: xfreqbench runs on Linux. On Windows, install")


def test_a_system_that_lacks_what_linux_alone_has_imports_and_helps() -> None:
    """As macOS, which cannot bind a process to cores, and as a Python without modules of Unix."""
    program = """
import os, sys
sys.modules |= dict.fromkeys(["fcntl", "resource"])
del os.sched_getaffinity, os.sched_setaffinity, os.fork
import xfreqbench.system.processes
from xfreqbench.cli.main import app
from xfreqbench.system.machine import hardware
assert int(hardware()["cores"])
app(["--help"])
"""
    helped = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert helped.returncode == 0 and "generate" in helped.stdout, helped.stderr


@pytest.mark.slow
def test_the_wheel_of_the_source_archive_works_outside_the_clone(tmp_path: Path) -> None:
    """In an environment that has our dependencies on its path, but no clone."""
    run = partial(subprocess.run, check=True, cwd=tmp_path)
    for name in ("xfreqbench", "baselines", "scenes", "examples"):
        shutil.copytree(ROOT / name, tmp_path / "source" / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path / "source")
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", "dist", "source"], stdout=DEVNULL, stderr=DEVNULL)
    made = sorted((tmp_path / "dist").iterdir())
    assert [path.suffix for path in made] == [".whl", ".gz"]
    run([sys.executable, "-m", "twine", "check", "--strict", *made])
    clean = environment(tmp_path / "clean", *(path for path in sys.path if path.endswith("site-packages")))
    run([sys.executable, "-m", "pip", "--python", clean, "install", "--quiet", "--no-deps", "--no-index", made[0]])
    run([clean, "-W", "error", "-c", FIRST_STEPS])
    run([clean.with_name("xfreqbench"), "report", "results", "-o", "board.md", "-q"])


@pytest.mark.slow
def test_predictions_are_scored_without_pytorch_and_without_a_ray_tracer(tmp_path: Path) -> None:
    """In an environment that has only what docs/submit.md says."""
    installed = re.search(
        r"pip install --constraint constraints.txt (cyclopts.*?)\n    pip",
        (ROOT / "docs/submit.md").read_text(),
        re.DOTALL,
    )
    assert installed
    (tmp_path / "site").mkdir()
    link_distributions(installed[1].replace("\\", " ").split(), tmp_path / "site")
    data = paper_dataset(tmp_path / "data.h5", num_tx=5)
    write_predictions(tmp_path / "maps.h5", hand_out(data, tmp_path / "same.h5"))
    python = environment(tmp_path / "small", tmp_path / "site", ROOT)
    commands = [
        "split --data data.h5 -o split.h5",
        "score maps.h5 --data data.h5 --results results",
        "report results -o board.md --html page.html",
        "score maps.h5 --data data.h5 --results others --method theirs",
        "compare results others",
    ]
    subprocess.run([python, "-c", SPLIT_SCORE_REPORT], input="\n".join(commands), text=True, check=True, cwd=tmp_path)
    assert "mine (external)" in (tmp_path / "board.md").read_text("utf-8")


@pytest.mark.slow
def test_a_clone_is_imported_from_the_folder_that_holds_it(tmp_path: Path) -> None:
    """There Python finds a folder of the package's name before it asks the hooks of other editable installations."""
    clone = tmp_path / "xfreqbench"
    clone.mkdir()
    for name in ("xfreqbench", "baselines", "scenes", "examples", "pyproject.toml", "README.md", "LICENSE"):
        (clone / name).symlink_to(ROOT / name)
    python = environment(tmp_path / "clean", *(path for path in sys.path if path.endswith("site-packages")))
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*install, "--no-build-isolation", "--editable", clone], check=True)
    program = (
        "import xfreqbench as xb; from xfreqbench import baselines; print(xb.generate.__name__, baselines.__file__)"
    )
    run = subprocess.run([python, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert run.stdout.split() == ["generate", str(clone / "baselines/__init__.py")]


DATA_ALONE = """
import sys
from importlib.metadata import packages_distributions, requires
import xfreqbench as xb

dataset = xb.open_dataset(sys.argv[1])
dataset.pas([0]), dataset.cfr, xb.make_splits(dataset, "lofo", 10.0)
known = packages_distributions()
loaded = {name.lower() for module in {name.partition(".")[0] for name in sys.modules} for name in known.get(module, ())}
required = [line for line in requires("xfreqbench") if "extra ==" not in line]
print([name for line in required if (name := line.split(";")[0].rstrip("0123456789.<>=,").lower()) in loaded])
"""


def test_who_uses_data_alone_imports_at_most_ten_of_the_required_libraries(dataset: PasDataset) -> None:
    command = [sys.executable, "-c", DATA_ALONE, str(dataset.path)]
    loaded = literal_eval(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)
    assert {"numpy", "h5py", "pydantic"} <= {*loaded} and len(loaded) <= 10
    assert not {"torch", "sionna-rt", "numba", "matplotlib", "trimesh"} & {*loaded}
