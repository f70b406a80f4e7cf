"""Ctrl-C waits for a block that must not be cut in two."""

from __future__ import annotations

import signal
import threading

import pytest

from xfreqbench.system.signals import interrupted_afterwards


def test_an_interruption_within_the_block_is_raised_at_its_end() -> None:
    before, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), interrupted_afterwards():
        signal.raise_signal(signal.SIGINT)
        done.append("the rest")
    assert done == ["the rest"]
    assert signal.getsignal(signal.SIGINT) is before


def test_an_error_of_the_block_is_raised_as_it_is() -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="ours"), interrupted_afterwards():
        raise ValueError("ours")
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_runs_the_block_too() -> None:
    done: list[str] = []

    def work() -> None:
        with interrupted_afterwards():
            done.append("the work")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == ["the work"]
