"""What TensorBoard reads is what was logged."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from xfreqbench.errors import StorageError, XFreqBenchError
from xfreqbench.runs.training_log import training_log


@pytest.mark.filterwarnings("ignore::DeprecationWarning:tensorboard.*")
def test_tensorboard_reads_what_was_logged(tmp_path: Path) -> None:
    with training_log(tmp_path / "logs") as log:
        for step in (1, 5, 9):
            log(step, {"loss": 1 / step, "validation SSIM": step / 10})
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.util.tensor_util import make_ndarray

    read = EventAccumulator(str(tmp_path / "logs"))
    read.Reload()
    for name, logged in (("loss", [1, 1 / 5, 1 / 9]), ("validation SSIM", [0.1, 0.5, 0.9])):
        events = read.Tensors(name)
        assert [event.step for event in events] == [1, 5, 9]
        assert [float(make_ndarray(event.tensor_proto)) for event in events] == pytest.approx(logged)


def test_without_tensorboard_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorboard.summary", None)
    with (
        pytest.raises(XFreqBenchError, match=r'pip install "xfreqbench\[tensorboard\]"'),
        training_log(tmp_path / "logs"),
    ):
        pass
    assert not (tmp_path / "logs").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file"), training_log(tmp_path / "file" / "logs"):
        pass
