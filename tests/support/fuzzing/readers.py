"""Files whose bytes carry sums, and what their readers make of them in a folder with the sound files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support.fuzzing.hdf5 import tables
from tests.support.fuzzing.sound_files import FINGERPRINT, sound_files
from xfreqbench.data.fingerprint import read_fingerprint
from xfreqbench.data.hdf5 import verify_sealed
from xfreqbench.exchange.deepmimo_import import import_deepmimo
from xfreqbench.exchange.split_file import SCHEMA
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.predictions import read_predictions

# By kind: what the files' paths contain, and what reads them.
READERS: dict[str, tuple[str, Callable[[], Any]]] = {
    "DeepMIMO scenario": ("^scenarios/small_10ghz/.*_t000_", lambda: _imported("scenarios")),
    "DeepMIMO scenario of MATLAB": ("^mats/small_10ghz/.*mat$", lambda: _imported("mats")),
    "fingerprint": (FINGERPRINT, lambda: vars(read_fingerprint(Path(FINGERPRINT)))),
    "checkpoint": ("^results/checkpoints/", lambda: _checkpoint("results/checkpoints")),
    "split file": ("split.h5", lambda: _sealed(Path("split.h5"))),
    "stored predictions": ("^results/predictions/f", lambda: _predictions("results/predictions")),
}


def files_of(kind: str) -> list[str]:
    """The paths of the sound files of a kind."""
    return [path for path in sound_files() if re.search(READERS[kind][0], path)]


def _imported(folder: str) -> dict[str, Any]:
    Path("new.h5").unlink(missing_ok=True)
    import_deepmimo(Path(folder), Path("new.h5"))
    return tables.__wrapped__(Path("new.h5").read_bytes())


def _checkpoint(folder: str) -> Any:
    (path,) = Path(folder).iterdir()
    return CheckpointFolder(path, path.name).read()


def _sealed(path: Path) -> dict[str, Any]:
    verify_sealed(path, SCHEMA)
    return tables.__wrapped__(path.read_bytes())


def _predictions(folder: str) -> Any:
    path = Path(folder) / f"{'f' * 16}.h5"
    return vars(read_predictions(path)), tables.__wrapped__(path.read_bytes())
