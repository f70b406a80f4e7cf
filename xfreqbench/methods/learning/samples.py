"""Samples of a data set as PyTorch takes them: `PasDataset.torch()` comes here through an entry point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from xfreqbench.data.dataset import PasDataset


class TensorSample(NamedTuple):
    """One sample as tensors; a `DataLoader` gives B of them, stacked along a new first axis.

    `map` (E, A) is float32 with peak 1, `tx_position_m` (3,) and `carrier_hz` () are float64, and `cfr` (M,) is
    complex64: (0,) where the data set holds maps alone.
    """

    map: Tensor
    tx_position_m: Tensor
    carrier_hz: Tensor
    cfr: Tensor


class TensorSamples(Dataset[TensorSample]):
    """The N samples of a data set, or of a subset, for `torch.utils.data.DataLoader`.

    The file is opened anew for every sample, or by a `DataLoader` for every batch, and closed again, so that worker
    processes, forked or spawned, share no handle. Raises `IndexError` and `DataError` as the data set does.
    """

    def __init__(self, dataset: PasDataset) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, number: int) -> TensorSample:
        return self.__getitems__([number])[0]

    def __getitems__(self, numbers: Sequence[int]) -> list[TensorSample]:
        """Several samples, which the file is opened for once; a `DataLoader` asks for its batches so."""
        asked = self.dataset[list(numbers)]
        cfr = asked.cfr if asked.header.channels else np.zeros((len(asked), 0), np.complex64)
        arrays = asked.pas(), asked.tx_position_m, asked.carrier_hz, cfr
        return list(map(TensorSample, *map(torch.from_numpy, arrays)))
