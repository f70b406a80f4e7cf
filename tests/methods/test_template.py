"""A package with a method of one's own: the template under other names."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from tests.support.places import ROOT
from xfreqbench.cli.runs import new_method
from xfreqbench.errors import MethodError, OutputExistsError
from xfreqbench.methods.template import TEMPLATE_FILES, write_method_package

LEFT_BY_TOOLS = re.compile(r"__pycache__|\.egg-info|/build/|\.pytest_cache")


@pytest.mark.parametrize("template", TEMPLATE_FILES)
def test_every_file_of_the_template_is_copied_and_ships(template: str) -> None:
    folder = ROOT / "examples" / template
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert {name for name in found if not LEFT_BY_TOOLS.search(f"/{name}")} == set(TEMPLATE_FILES[template])
    shipped = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    of_template = [name for name in shipped["xfreqbench.examples"] if name.startswith(template)]
    assert sorted(of_template) == [f"{template}/{name}" for name in sorted(TEMPLATE_FILES[template])]


def test_the_module_the_classes_the_entry_point_tests_and_workflow_have_the_new_name(tmp_path: Path) -> None:
    written = write_method_package("my-new-waves", tmp_path / "mine")
    names = [path.relative_to(tmp_path / "mine").as_posix() for path in written]
    assert "src/my_new_waves/__init__.py" in names
    assert "tests/test_my_new_waves.py" in names
    project = tomllib.loads((tmp_path / "mine" / "pyproject.toml").read_text())["project"]
    assert project["name"] == "my-new-waves"
    assert project["entry-points"]["xfreqbench.methods"] == {"my-new-waves": "my_new_waves:MyNewWaves"}
    for path in written:
        assert not re.search(r"plane[-_]waves|PlaneWave|method-template", path.read_text())
        if path.suffix == ".py":
            compile(path.read_text(), path, "exec")
    assert "check-method my-new-waves" in (tmp_path / "mine/.github/workflows/tests.yml").read_text()
    classes = re.findall(r"^class (\w+)", (tmp_path / "mine/src/my_new_waves/__init__.py").read_text(), re.M)
    assert classes == ["MyNewWavesConfig", "MyNewWavesField", "MyNewWaves"]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("My-Method", "small letters"),
        ("my_method", "small letters"),
        ("7waves", "small letters"),
        ("", "small letters"),
        ("a" * 41, "40 characters"),
        ("../elsewhere", "small letters"),
        ("nearest", "an installed method"),
        ("torch", "a module 'torch' already"),
        ("json", "a module 'json' already"),
        ("class", "a module 'class' already"),
        ("tests", "a module 'tests' already"),
        ("tensor", "the template has a Tensor of its own"),
    ],
)
def test_a_name_that_cannot_be_all_of_these_is_refused(name: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match=why):
        write_method_package(name, tmp_path / "mine")
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("mine")
    with pytest.raises(OutputExistsError, match="nothing is written over it"):
        write_method_package("my-method", tmp_path / "mine")
    assert [path.name for path in tmp_path.rglob("*")] == ["mine", "notes"]


def test_the_command_writes_a_folder_of_that_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    new_method("my-method")
    said = capsys.readouterr().out
    assert "wrote my-method/pyproject.toml" in said
    assert said.splitlines()[-1].endswith("xfreqbench check-method my-method")
