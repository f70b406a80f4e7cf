"""Shapes and types of every annotated function are checked while tests run, where `CHECK_TYPES` is set: in CI."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import jaxtyping
import pytest
from hypothesis import HealthCheck, settings

from tests.support.typechecking import CHECKS_TYPES, calls, check_first_calls

if TYPE_CHECKING:
    from xfreqbench.data.dataset import PasDataset

UNCHECKED = {  # Numba compiles what it is given, and checks types itself
    "xfreqbench.scene.visibility_kernels",
    "xfreqbench.methods.learning.loss_kernels",
    "xfreqbench.baselines.room_planes.scan_kernels",
    "xfreqbench.baselines.virtual_source.field.coefficient_kernels",
    "xfreqbench.baselines.virtual_source.field.slab_kernels",
    "xfreqbench.baselines.virtual_source.room.obstacle_kernels",
    "xfreqbench.methods.splatting.composite_kernels",
    "xfreqbench.methods.splatting.footprint_kernels",
    "xfreqbench.methods.splatting.projection_kernels",
    "xfreqbench.methods.splatting.composite_triton",  # as Triton does
}
ROOT = Path(__file__).parents[1]
FOLDERS = {"xfreqbench": ROOT / "xfreqbench", "xfreqbench.baselines": ROOT / "baselines"}
MODULES = {
    ".".join([package, *path.relative_to(folder).with_suffix("").parts])
    for package, folder in FOLDERS.items()
    for path in folder.rglob("*.py")
    if path.stem != "__init__" and path.parent.name != "kernels"
} - UNCHECKED
# without files of bytecode every interpreter that a test starts compiles the package anew
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ["XFREQBENCH_ANNOUNCES"] = "0"  # whichever test compiles kernels first, stderr is the same
os.fsync = lambda descriptor: None  # processes are killed here, but no machine, so that nothing need be on the disk
if CHECKS_TYPES:
    jaxtyping.jaxtyped = check_first_calls
    jaxtyping.install_import_hook(sorted(MODULES), "tests.support.typechecking.typechecker")
# no case is decided by a clock: the machine may be busy, and first calls compile and import
settings.register_profile("unhurried", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("unhurried")
# a shell starts what runs in its background deaf to Ctrl-C, and with it every command that a test interrupts
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()  # the collector does not look through all that was imported again and again


def pytest_runtest_setup() -> None:
    calls.clear()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that at the end no worker waits for a long one of another."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say at the end what was left out, and what it needs."""
    skipped = terminalreporter.stats.get("skipped", ())
    reasons = Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in skipped)
    for reason, number in reasons.most_common():
        terminalreporter.line(f"left out: {number} tests, since {reason}")


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Six transmitters at three carriers, for tests that have no data set of their own."""
    from tests.support.synthetic import write_dataset

    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=6)


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Sums in the same order at every run, and no waiting for a second thread, which small tensors mostly do."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
