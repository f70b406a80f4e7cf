"""A clock that a test sets, so that no test depends on how fast a machine is."""

from __future__ import annotations

from types import ModuleType

import pytest


class Clock:
    """Stands in for the module `time`: wall-clock and processor time, in seconds, pass only in `sleep` and by hand."""

    def __init__(self) -> None:
        self.now_s = self.processor_s = 0.0

    def perf_counter(self) -> float:
        return self.now_s

    def process_time(self) -> float:
        return self.processor_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def set_clock(monkeypatch: pytest.MonkeyPatch, *modules: ModuleType) -> Clock:
    """One clock in place of `time` in the modules, until the test ends."""
    clock = Clock()
    for module in modules:
        monkeypatch.setattr(module, "time", clock)
    return clock
