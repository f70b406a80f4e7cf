"""Split files and files of predictions as users write them, for the tests of both."""

from __future__ import annotations

import multiprocessing
import signal
from pathlib import Path

import h5py
import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import make_splits
from xfreqbench.exchange.split_file import write_splits

SPLITS = ["lofo-2.4GHz", "lofo-24.25GHz", "lofo-77GHz"]


def hand_out(dataset: PasDataset, path: Path, protocol: str = "lofo", targets=None, maps: bool = False) -> Path:
    write_splits(dataset, make_splits(dataset, protocol, targets), path, maps)
    return path


def noisy_maps(tx_position_m, carrier_hz):
    maps = np.random.default_rng(7).random((len(carrier_hz), 90, 360), np.float32)
    return maps / maps.max(axis=(1, 2), keepdims=True)


def write_predictions(path: Path, split_file: Path, predict=noisy_maps, **declared) -> Path:
    """What the docstring of `xfreqbench.exchange.score_file` tells a user to write."""
    with h5py.File(split_file) as splits, h5py.File(path, "w") as file:
        for name, split in splits.items():
            group = file.create_group(name)
            group["pas"] = predict(split["test_tx_position_m"][:], split["test_carrier_hz"][:])
            group.attrs.update(split.attrs, **({"method": "mine"} | declared))
    return path


def killed(action) -> None:
    process = multiprocessing.get_context("fork").Process(target=action)
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
