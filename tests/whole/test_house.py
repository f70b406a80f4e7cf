"""The rules of the house: how much stands in a folder and in a file, and which file may import what is heavy."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from places import ROOT

PACKAGE = ROOT / "xfreqbench"
SOURCES = [path for folder in (PACKAGE, ROOT / "baselines", ROOT / "scenes") for path in folder.rglob("*.py")]
FOLDERS = [path for path in SOURCES if path.name == "__init__.py"]
OFFERS_NAMES = {
    "scenes/__init__.py",
    "xfreqbench/__init__.py",
    "xfreqbench/maps/__init__.py",
    "xfreqbench/methods/__init__.py",
}
KERNELS = PACKAGE / "tracing" / "image" / "kernels.py"
MAX_LINES = {KERNELS: 699}  # of other files 500: Numba compiles what is in one file together

# Each dependency that takes long to import, or that few need, and the files that may import it.
HOMES = {
    "PIL": {"exchange/png_images.py", "report/drawing/figures.py"},
    "cyclopts": {f"cli/{name}.py" for name in ("data", "exchange", "findings", "measure", "options", "runs")},
    "differt": {"bench/peers/differt.py"},
    "distributed": {"system/cluster.py"},
    "drjit": {"tracing/sionna/scene.py"},
    "filelock": {"system/files.py"},
    "h5py": {"data/hdf5.py"},
    "jax": {"bench/peers/differt.py"},
    "jinja2": {"report/drawing/templates.py"},
    "lazy_loader": {"__init__.py", "maps/__init__.py"},
    "markupsafe": {"report/drawing/document.py", "report/drawing/templates.py"},
    "matplotlib": {
        "maps/drawing.py",
        "report/drawing/figures.py",
        "report/findings/figures.py",
        "report/leaderboard/plots.py",
        "report/view/figures.py",
        "report/view/power.py",
    },
    "mitsuba": {"tracing/sionna/scene.py"},
    "numba": {
        "bench/savings.py",
        "methods/learning/loss_kernels.py",
        "methods/splatting/composite_kernels.py",
        "methods/splatting/footprint_kernels.py",
        "methods/virtual_source/obstacle_kernels.py",
        "scene/visibility_kernels.py",
        "tracing/image/box_tree_kernels.py",
        "tracing/image/diffraction_kernels.py",
        "tracing/image/furnished_kernels.py",
        "tracing/image/growing_kernels.py",
        "tracing/image/kernels.py",
        "tracing/image/wedge_kernels.py",
    },
    "pandas": {"report/leaderboard/text.py"},
    "rich": {"cli/options.py", "system/bars.py"},
    "safetensors": {"methods/learning/training.py"},
    "sionna": {"tracing/sionna/scene.py"},
    "skimage": {"maps/metrics.py"},
    "tensorboard": {"runs/training_log.py"},
    "threadpoolctl": {"system/machine.py"},
    "trimesh": {
        "report/drawing/glb.py",
        "scene/mesh_files.py",
        "scene/meshes.py",
        "scene/mitsuba_xml.py",
        "scene/rooms.py",
        "scene/visibility.py",
    },
    "yaml": {"exchange/png_folder.py"},
}


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def num_lines(path: Path) -> int:
    return len(path.read_text("utf-8").splitlines())


def imported(path: Path) -> Iterator[str]:
    """Top-level packages that a file imports anywhere in it, by a statement or by `import_module` of a text."""
    for node in ast.walk(parsed(path)):
        names = list[str]()
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in (
            "import_module",
            "__import__",
        ):
            names = [str(word.value) for word in node.args[:1] if isinstance(word, ast.Constant)]
        yield from (name.partition(".")[0] for name in names)


def test_the_package_has_sixteen_entries_at_most() -> None:
    assert len([path for path in PACKAGE.iterdir() if path.name != "__pycache__"]) <= 16


@pytest.mark.parametrize("path", FOLDERS, ids=named)
def test_the_init_of_a_folder_is_a_docstring(path: Path) -> None:
    """But where names are offered that are imported when they are asked for, and no more is said than that."""
    docstring, *rest = parsed(path).body
    assert ast.get_docstring(parsed(path)), docstring
    if named(path) not in OFFERS_NAMES:
        assert not rest
    else:
        assert not [node for node in rest if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        assert set(imported(path)) <= {"lazy_loader", "os", "sys", "xfreqbench"}


def test_every_folder_with_sources_is_a_package() -> None:
    assert {path.parent for path in SOURCES} == {path.parent for path in FOLDERS}


def test_no_file_is_long() -> None:
    long = {named(path): num_lines(path) for path in SOURCES if num_lines(path) > MAX_LINES.get(path, 500)}
    assert not long


def test_no_kernel_is_long() -> None:
    long = {
        node.name
        for node in ast.walk(parsed(KERNELS))
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno + 1 > 40
    }
    assert not long


@pytest.mark.parametrize(("name", "limit"), [(".importlinter", 60), ("README.md", 120)])
def test_what_is_read_first_is_short(name: str, limit: int) -> None:
    assert num_lines(ROOT / name) <= limit


def test_a_class_name_stands_for_one_class() -> None:
    names = Counter(
        node.name for path in SOURCES for node in ast.walk(parsed(path)) if isinstance(node, ast.ClassDef)
    )
    assert not {name for name, count in names.items() if count > 1}


@pytest.mark.parametrize("dependency", HOMES)
def test_a_heavy_dependency_is_imported_in_its_homes_alone(dependency: str) -> None:
    """A file that no longer imports it leaves the table too."""
    found = {named(path) for path in SOURCES if dependency in imported(path)}
    assert found == {f"xfreqbench/{home}" for home in HOMES[dependency]}
