"""A data set as a `torch.utils.data.Dataset`: the same numbers, in this process and in workers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import BatchSampler, DataLoader, Dataset, SequentialSampler

from tests.support.synthetic import make_header, transmitters, write_dataset
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.methods.learning.samples import to_torch


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Four transmitters at three carriers."""
    return write_dataset(tmp_path_factory.mktemp("samples") / "data.h5")


def require_equal(batch: object, dataset: PasDataset, numbers: list[int]) -> None:
    asked = dataset[numbers]
    arrays = asked.pas(), asked.tx_position_m, asked.carrier_hz, asked.cfr
    for tensor, array in zip(batch, arrays, strict=True):  # type: ignore[call-overload]
        np.testing.assert_array_equal(tensor.numpy(), array, strict=True)


def test_it_is_what_torch_calls_a_data_set_and_a_subset_has_its_own_numbers(dataset: PasDataset) -> None:
    samples = to_torch(dataset)
    assert isinstance(samples, Dataset)
    assert len(samples) == len(dataset) == 12
    sample = samples[7]
    assert [tensor.shape for tensor in sample] == [(90, 360), (3,), (), (4,)]
    require_equal([tensor[None] for tensor in sample], dataset, [7])
    require_equal([tensor[None] for tensor in to_torch(dataset[[9, 4]])[1]], dataset, [4])
    with pytest.raises(IndexError, match="0 to 11, but 12"):
        samples[12]


@pytest.mark.parametrize("maps", [True, False])
def test_a_loader_gives_batches(tmp_path: Path, maps: bool) -> None:
    dataset = write_dataset(tmp_path / "data.h5", maps=maps)
    samples = to_torch(dataset)
    whole = BatchSampler(SequentialSampler(samples), batch_size=5, drop_last=False)
    for loader in (DataLoader(samples, batch_size=None, sampler=whole), DataLoader(samples, batch_size=5)):
        batches = list(loader)
        for batch, start in zip(batches, (0, 5, 10), strict=True):
            require_equal(batch, dataset, list(range(12))[start : start + 5])
    assert batches[0].map.dtype == torch.float32
    assert batches[0].cfr.dtype == torch.complex64


@pytest.mark.parametrize("start", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_read_what_this_process_reads(dataset: PasDataset, start: str) -> None:
    """Whether they inherit the data set or get it pickled, while this process reads the same file."""
    loader = DataLoader(to_torch(dataset[::2]), batch_size=2, num_workers=2, multiprocessing_context=start)
    for number, batch in enumerate(loader):
        require_equal(batch, dataset, [4 * number, 4 * number + 2])
        dataset.pas([0])


def test_maps_alone_have_an_empty_channel(tmp_path: Path) -> None:
    header = replace(make_header(num_tx=1), channels=False)
    with PasWriter(tmp_path / "data.h5", header) as writer:
        maps = np.ones((1, 3, 90, 360), np.float32)
        writer.append(transmitters(1), np.array([True]), SampleBlock.of_maps(maps))
    (batch,) = DataLoader(to_torch(open_dataset(tmp_path / "data.h5")), batch_size=3)
    assert batch.cfr.shape == (3, 0)
    assert batch.map.shape == (3, 90, 360)
