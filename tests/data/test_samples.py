"""A data set as a Python sequence of samples, and as it is shown in a shell and in a notebook."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from tests.support.synthetic import append_all, make_header, transmitters, write_dataset
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.writer import PasWriter


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Four transmitters at three carriers."""
    return write_dataset(tmp_path_factory.mktemp("samples") / "data.h5")


def test_a_sample_is_a_map_with_its_transmitter_and_its_carrier(dataset: PasDataset) -> None:
    sample = dataset[7]
    assert sample.map.shape == (90, 360)
    np.testing.assert_array_equal(sample.map, dataset.pas([7])[0])
    np.testing.assert_array_equal(sample.tx_position_m, transmitters(4)[2])
    assert sample.carrier_hz == dataset[4:][3].carrier_hz == 10e9
    for last in (-1, np.int64(-1)):
        np.testing.assert_array_equal(dataset[last].map, dataset[11].map)


@pytest.mark.parametrize(
    "rows", [slice(1, 9, 4), [1, 5], range(1, 9, 4), np.array([1, 5]), np.array([-11, -7]), np.isin(range(12), [1, 5])]
)
def test_slices_numbers_and_masks_give_subsets(dataset: PasDataset, rows: slice | np.ndarray) -> None:
    np.testing.assert_array_equal(dataset[rows].rows, [1, 5])
    np.testing.assert_array_equal(dataset.pas(rows), dataset.pas([1, 5]))


def test_a_subset_may_be_empty(dataset: PasDataset) -> None:
    assert (len(dataset[[]]), [*dataset[[]]], dataset[[]].pas().shape) == (0, [], (0, 90, 360))


@pytest.mark.parametrize("maps", [True, False])
def test_iteration_yields_every_sample_once(tmp_path: Path, maps: bool) -> None:
    many = write_dataset(tmp_path / "many.h5", num_tx=25, maps=maps)[:70]  # more than are read at once
    samples = list(many)
    np.testing.assert_array_equal([sample.map for sample in samples], many.pas())
    np.testing.assert_array_equal([sample.tx_position_m for sample in samples], many.tx_position_m)
    assert [sample.carrier_hz for sample in samples] == many.carrier_hz.tolist()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (12, "There are samples 0 to 11, but 12 is asked for"),
        (-13, "samples 0 to 11, but -13"),
        ([0, 99], "samples 0 to 11, but 99"),
        (np.array([0.5]), r"shape \(n,\), or by a mask of shape \(12,\), but got float64 of shape \(1,\)"),
        (np.ones(5, bool), r"but got bool of shape \(5,\)"),
        (np.zeros((2, 2), np.int64), r"but got int64 of shape \(2, 2\)"),
    ],
)
def test_what_is_not_there_is_an_index_error_that_says_what_is(dataset: PasDataset, rows: object, message: str) -> None:
    with pytest.raises(IndexError, match=message):
        dataset[rows]  # type: ignore[call-overload]


def test_a_read_of_more_than_a_gigabyte_is_warned_of(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PasDataset, "_file", Mock(side_effect=KeyboardInterrupt))  # before a byte is read
    few, many = (replace(dataset, rows=np.zeros(number, np.int64)) for number in (7716, 7717))
    with pytest.raises(KeyboardInterrupt):
        few.pas()
    told = r"reads 7717 maps of .*, 1\.0 GB\. pas\(rows\) reads some of them"
    with pytest.warns(UserWarning, match=told), pytest.raises(KeyboardInterrupt):
        many.pas()


def test_a_notebook_shows_names_as_they_are(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>\n"
    header = replace(make_header(), scene_name=hostile)
    with PasWriter(tmp_path / "<b>.h5", header) as writer:
        append_all(writer, header)
    hostile_data = open_dataset(tmp_path / "<b>.h5")
    shown = hostile_data._repr_html_()
    assert "<script" not in shown and "<b>" not in shown
    assert html.escape(repr(hostile)) in shown
    assert shown.startswith("<table>") and shown.count("<tr>") == 5
    assert len(repr(hostile_data).splitlines()) == 5
