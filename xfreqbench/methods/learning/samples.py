"""Samples of data sets and collections as PyTorch takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from pydantic import InstanceOf
from torch import Tensor
from torch.utils.data import Dataset

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset, chosen_rows
from xfreqbench.system.arguments import checked


class TensorSample(NamedTuple):
    """One sample as tensors, or B of them, stacked along a new first axis.

    `map` (E, A) is float32 with peak 1, `tx_position_m` (3,) and `carrier_hz` () are float64, and `cfr` (M,) is
    complex64: (0,) where the data set holds maps alone.
    """

    map: Tensor
    tx_position_m: Tensor
    carrier_hz: Tensor
    cfr: Tensor


class TensorSamples(Dataset[TensorSample]):
    """The N samples of a data set, or of a subset, for `torch.utils.data.DataLoader`.

    `samples[7]` is one sample, and `samples[[7, 2]]` are two, stacked as they are read: a `DataLoader` with a
    `BatchSampler` as its `sampler`, and `batch_size=None`, asks for whole batches so. The file is opened anew whenever
    samples are asked for, and closed again, so that worker processes, forked or spawned, share no handle. Raises
    `IndexError` and `DataError` as the data set does.
    """

    def __init__(self, dataset: PasDataset) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, numbers: int | Sequence[int]) -> TensorSample:
        if isinstance(numbers, int | np.integer):
            return self.__getitems__([numbers])[0]
        asked = self.dataset[list(numbers)]
        cfr = asked.cfr if asked.header.channels else np.zeros((len(asked), 0), np.complex64)
        arrays = asked.pas(), asked.tx_position_m, asked.carrier_hz, cfr
        return TensorSample(*map(torch.from_numpy, arrays))

    def __getitems__(self, numbers: Sequence[int]) -> list[TensorSample]:
        """Several samples, one by one; a `DataLoader` with a `batch_size` asks so, and stacks them by a copy."""
        return list(map(TensorSample, *self[numbers]))


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
        asked = np.asarray(chosen_rows(list(numbers), len(self))) % len(self)
        found: list[RoomSample | None] = [None] * len(asked)
        for room, places, rows in self.collection.by_room(asked):
            samples = TensorSamples(self.collection[room]).__getitems__(rows.tolist())
            for place, sample in zip(places.tolist(), samples, strict=True):
                found[place] = RoomSample(*sample, torch.tensor(room))
        return [sample for sample in found if sample]


@checked
def to_torch(data: InstanceOf[PasDataset] | InstanceOf[Collection]) -> TensorSamples | RoomSamples:
    """The samples as a `torch.utils.data.Dataset` on the CPU, of a collection those of all its rooms in turn.

    A `DataLoader` takes it, best with a `BatchSampler` for whole batches, and without workers, though forked and
    spawned ones may read too.
    """
    return RoomSamples(data) if isinstance(data, Collection) else TensorSamples(data)
