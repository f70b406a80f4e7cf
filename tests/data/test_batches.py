from __future__ import annotations

from pathlib import Path

import pytest
from plans import small_plan

from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.errors import OutputExistsError


def test_unfinished_batches_of_another_job_are_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "rooms.h5.parts"
    folder.mkdir()
    (folder / "job.sha256").write_text("another")
    with pytest.raises(OutputExistsError, match="other settings"):
        generate_planned(small_plan(), tmp_path / "rooms.h5")
    assert (folder / "job.sha256").read_text() == "another"


def test_a_damaged_batch_is_traced_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = generate_planned(small_plan(), tmp_path / "whole.h5")
    monkeypatch.setattr("xfreqbench.data.batches.BatchStore.remove", lambda self: None)
    generate_planned(small_plan(), tmp_path / "damaged.h5")
    monkeypatch.undo()
    first, *_ = sorted((tmp_path / "damaged.h5.parts").glob("000000-*.npz"))
    content = bytearray(first.read_bytes())
    content[len(content) // 2] ^= 1
    first.write_bytes(content)
    (tmp_path / "damaged.h5").unlink()
    again = generate_planned(small_plan(), tmp_path / "damaged.h5")
    assert open_dataset(again).sha256 == open_dataset(whole).sha256
