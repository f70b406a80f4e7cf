"""Samples as PyTorch takes them: `PasDataset.torch()` and `Collection.torch()` come here through entry points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.rows import chosen_rows


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


class RoomSample(NamedTuple):
    """A `TensorSample` of a collection, and the number of its room there, () int64."""

    map: Tensor
    tx_position_m: Tensor
    carrier_hz: Tensor
    cfr: Tensor
    room: Tensor


class RoomSamples(Dataset[RoomSample]):
    """The samples of all rooms of a collection in turn, for `torch.utils.data.DataLoader`.

    Files are opened when they are first asked for, by each worker process. Raises as the collection does.
    """

    def __init__(self, collection: Collection) -> None:
        self.collection = collection

    def __len__(self) -> int:
        return self.collection.num_samples

    def __getitem__(self, number: int) -> RoomSample:
        return self.__getitems__([number])[0]

    def __getitems__(self, numbers: Sequence[int]) -> list[RoomSample]:
        """Several samples, of each room at once; a `DataLoader` asks for its batches so."""
        first = self.collection.first_sample
        asked = np.asarray(chosen_rows(list(numbers), len(self))) % len(self)
        room_of = np.searchsorted(first, asked, side="right") - 1
        found: list[RoomSample | None] = [None] * len(asked)
        for room in np.unique(room_of).tolist():
            places = np.flatnonzero(room_of == room)
            samples = TensorSamples(self.collection[room]).__getitems__((asked[places] - first[room]).tolist())
            for place, sample in zip(places.tolist(), samples, strict=True):
                found[place] = RoomSample(*sample, torch.tensor(room))
        return [sample for sample in found if sample]
