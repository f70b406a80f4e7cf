from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest

from xfreqbench.errors import StorageError
from xfreqbench.storage import exclusive


def _count_up(folder: Path) -> None:
    counter = folder / "counter"
    for _ in range(50):
        with exclusive(folder / "lock"):
            counter.write_text(str(int(counter.read_text()) + 1))


def test_processes_take_turns(tmp_path: Path) -> None:
    (tmp_path / "counter").write_text("0")
    context = multiprocessing.get_context("fork")
    processes = [context.Process(target=_count_up, args=(tmp_path,)) for _ in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert (tmp_path / "counter").read_text() == "150"
    assert not (tmp_path / "lock").exists()


def test_a_lock_is_let_go_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="within"), exclusive(tmp_path / "lock"):
        raise ValueError("within")
    with exclusive(tmp_path / "lock"):
        pass


def test_a_lock_that_cannot_be_made_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"), exclusive(tmp_path / "file" / "lock"):
        pass
