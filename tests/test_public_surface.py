from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from types import ModuleType

import pytest

import xfreqbench as xb

PACKAGES = {"metrics", "errors", "methods", "scenes"}
HEAVY = ("numpy", "torch", "h5py", "pydantic", "xfreqbench.data")


@pytest.mark.parametrize("name", sorted(set(xb.__all__) - {"__version__"}))  # the table in `docs/api.md` has the same
def test_a_public_name_is_imported_when_it_is_used(name: str) -> None:
    assert name in dir(xb)
    found = getattr(xb, name)
    assert isinstance(found, ModuleType) == (name in PACKAGES)
    assert found.__doc__


def test_what_can_be_named_is_listed() -> None:
    assert {"office", "two_rooms", "corridor", "empty"} <= set(xb.scenes())
    assert {"xfreq-gs", "nearest", "virtual-source"} <= set(xb.methods())
    assert {"lofo", "held-out-tx"} <= set(xb.protocols())
    assert xb.__version__ == version("xfreqbench")


def test_packages_that_are_functions_too_stay_packages() -> None:
    program = (
        "import xfreqbench as xb; xb.methods(); xb.scenes()\n"
        "import xfreqbench.methods.contract as contract, xfreqbench.scenes\n"
        "assert contract.Budget is xb.Budget and 'office' in xfreqbench.scenes()"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_functions_are_not_mistaken_for_the_modules_of_their_names() -> None:
    for module in ("data.generate", "runs.run", "report.leaderboard", "maps.metrics"):
        import_module(f"xfreqbench.{module}")
    assert all(callable(function) for function in (xb.generate, xb.run, xb.leaderboard))


def test_a_name_that_there_is_not_is_an_attribute_error() -> None:
    for name, hint in {"no_such_name": "docs/api.md", "load_dataset": "Did you mean 'open_dataset'"}.items():
        with pytest.raises(AttributeError, match=rf"{name}.*{hint}"):
            getattr(xb, name)


def test_the_import_brings_nothing_heavy_and_of_ours_the_places_of_caches_alone() -> None:
    program = "import sys, xfreqbench; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert not set(HEAVY) & set(loaded)
    ours = {name for name in loaded if name.startswith("xfreqbench")}
    assert ours == {"xfreqbench", "xfreqbench.system", "xfreqbench.system.caches", "xfreqbench.system.callable_package"}
