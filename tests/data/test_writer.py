from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.synthetic import append_all, make_header, transmitters, write_dataset
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError


def test_equal_content_gives_equal_bytes(tmp_path: Path) -> None:
    first = write_dataset(tmp_path / "first.h5").path.read_bytes()
    time.sleep(1.1)  # a time stamp of one second's resolution would show
    assert write_dataset(tmp_path / "second.h5").path.read_bytes() == first


def test_batch_size_does_not_change_the_hash(tmp_path: Path) -> None:
    hashes = []
    for batch in (1, 4):
        header = make_header(maps=False)
        with PasWriter(tmp_path / "data.h5", header) as writer:
            append_all(writer, header, batch=batch)
        hashes.append(open_dataset(tmp_path / "data.h5").sha256)
    assert hashes[0] == hashes[1]


def test_too_few_or_too_many_transmitters_leave_no_file(tmp_path: Path) -> None:
    for num_tx, told in ((4, "3 of its 4 rows"), (2, "do not fit")):
        with pytest.raises(DataError, match=told), PasWriter(tmp_path / "data.h5", make_header(num_tx)) as writer:
            append_all(writer, make_header(num_tx=3))
        assert list(tmp_path.iterdir()) == []


def test_maps_that_are_not_from_0_to_1_are_refused(tmp_path: Path) -> None:
    header, path = replace(make_header(1, (1.0,)), channels=False), tmp_path / "data.h5"
    maps = np.full((1, 1, 90, 360), 0.5, np.float32)
    for maps[0, 0, 3, 4] in (-0.1, 1.2, np.nan, np.inf):
        with pytest.raises(DataError, match="numbers from 0 to 1"), PasWriter(path, header) as writer:
            writer.append(transmitters(1), np.array([True]), SampleBlock.of_maps(maps))
        assert list(tmp_path.iterdir()) == []


def test_what_the_header_leaves_out_is_not_taken(tmp_path: Path) -> None:
    path, maps = tmp_path / "data.h5", SampleBlock.of_maps(np.zeros((1, 1, 90, 360), np.float32))
    without_channels, without_maps = replace(make_header(), channels=False), make_header(1, (1.0,), maps=False)
    with pytest.raises(DataError, match=r"By its header .* has no 'cfr'"), PasWriter(path, without_channels) as writer:
        append_all(writer, make_header())
    with pytest.raises(DataError, match=r"By its header .* has no 'pas'"), PasWriter(path, without_maps) as writer:
        writer.append(transmitters(1), np.array([True]), maps)
    assert list(tmp_path.iterdir()) == []


def test_an_exception_leaves_the_former_file_and_no_other(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5").path
    before = path.read_bytes()
    header = make_header()
    with pytest.raises(KeyboardInterrupt), PasWriter(path, header):
        raise KeyboardInterrupt
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_of_the_caller_is_not_taken_for_one_of_the_disk(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), PasWriter(tmp_path / "data.h5", make_header()):
        raise FileNotFoundError("the caller's")
