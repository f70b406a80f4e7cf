"""Numbers of a training, step by step, for TensorBoard; for those who write the loop around `fit` themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from xfreqbench.errors import XFreqBenchError
from xfreqbench.system.files import storage_errors

LogStep = Callable[[int, Mapping[str, float]], None]


@contextmanager
def training_log(folder: Path | str) -> Iterator[LogStep]:
    """A block with a function that logs numbers of one step, by name; `tensorboard --logdir FOLDER` draws them.

    Use it as `log(progress.step, {"loss": progress.loss, "validation SSIM": ssim})`. Each block adds one file to the
    folder, which is made if it is absent. Raises `XFreqBenchError` where TensorBoard is not installed, and
    `StorageError` where the folder cannot be written.
    """
    try:
        from tensorboard.summary import Writer
    except ImportError as error:
        raise XFreqBenchError(
            'A log of a training needs the extra "tensorboard". Run: pip install "xfreqbench[tensorboard]"'
        ) from error
    with storage_errors(Path(folder)):
        writer = Writer(str(folder))

    def log(step: int, numbers: Mapping[str, float]) -> None:
        for name, number in numbers.items():
            writer.add_scalar(name, number, step)

    try:
        yield log
    finally:
        writer.close()
