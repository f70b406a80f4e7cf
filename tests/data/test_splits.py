from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from synthetic import paper_dataset, write_dataset

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import (
    LOFO_TARGETS_HZ,
    PROTOCOLS,
    UNSEEN_SHARE,
    Split,
    find_split,
    held_out_tx,
    lofo,
    lofo_unseen_tx,
    make_splits,
    sparse_frequency,
)
from xfreqbench.errors import ProtocolError, UnknownNameError


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5")


def test_lofo_never_trains_on_the_carrier_it_tests(dataset: PasDataset) -> None:
    for split, target in zip(lofo(dataset), LOFO_TARGETS_HZ, strict=True):
        assert set(dataset.carrier_hz[split.test]) == {target}
        assert target not in dataset.carrier_hz[split.train]
        assert len(split.train) + len(split.test) == len(dataset)
        assert split.shares_transmitters


def test_lofo_all_holds_out_every_carrier_once(dataset: PasDataset) -> None:
    splits = make_splits(dataset, "lofo", "all")
    tested = np.concatenate([split.test for split in splits])
    np.testing.assert_array_equal(np.sort(tested), np.arange(len(dataset)))
    assert len(splits) == 10


def test_sparse_frequency_trains_on_the_carriers_of_the_paper(dataset: PasDataset) -> None:
    trained = [set(dataset.carrier_hz[split.train] / 1e9) for split in sparse_frequency(dataset)]
    assert trained == [{10, 37}, {10, 37, 94}, {1, 10, 37, 60, 94}]
    for split in sparse_frequency(dataset):
        assert set(dataset.carrier_hz[split.test]) == {24.25e9}


def test_split_names_say_target_and_training_carriers(dataset: PasDataset) -> None:
    assert [split.name for split in lofo(dataset)] == ["lofo-2.4GHz", "lofo-24.25GHz", "lofo-77GHz"]
    assert sparse_frequency(dataset)[1].name == "sparse-24.25GHz-from-10-37-94GHz"


def test_samples_without_a_path_are_in_neither_part_and_counted(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", silent=((0, 1), (2, 1), (3, 0)))
    split = lofo(dataset, [10e9])[0]
    assert split.num_without_path == 2
    np.testing.assert_array_equal(split.test, [4, 10])
    assert 9 not in split.train


def test_carriers_a_few_kilohertz_apart_are_different_targets(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", carriers_ghz=(24.25001, 24.25002, 30.0))
    splits = make_splits(dataset, "lofo", "all")
    assert len({split.name for split in splits}) == 3
    for split in splits:
        assert find_split(dataset, "lofo", split.name).sha256 == split.sha256


def test_a_carrier_without_paths_does_not_block_the_others(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=1, silent=((0, 1),))
    assert [split.name for split in make_splits(dataset, "lofo", "all")] == ["lofo-1GHz", "lofo-37GHz"]
    assert find_split(dataset, "lofo", "lofo-37GHz").name == "lofo-37GHz"


def test_missing_carriers_are_named(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    with pytest.raises(ProtocolError, match=r"needs 2.4, 24.25, 77 GHz, but the data set has 1, 10, 37 GHz"):
        make_splits(dataset, "lofo")
    with pytest.raises(ProtocolError, match=r"needs 24.25, 60, 94 GHz"):
        make_splits(dataset, "sparse")


def test_one_carrier_alone_cannot_be_left_out(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", carriers_ghz=(10.0,))
    with pytest.raises(ProtocolError, match="two carriers"):
        make_splits(dataset, "lofo", "all")


def test_a_target_that_no_path_reaches_is_refused(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=1, silent=((0, 1),))
    with pytest.raises(ProtocolError, match="0 to test on"):
        lofo(dataset, [10e9])


def test_unknown_names_suggest_the_nearest(dataset: PasDataset) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'lofo'"):
        make_splits(dataset, "loof")
    with pytest.raises(UnknownNameError, match="Did you mean 'lofo-77GHz'"):
        find_split(dataset, "lofo", "lofo-78GHz")


def test_the_hash_of_a_split_follows_its_rows(dataset: PasDataset) -> None:
    assert find_split(dataset, "lofo", "lofo-77GHz").sha256 == lofo(dataset)[2].sha256
    assert (
        len({split.sha256 for split in [*make_splits(dataset, "lofo", "all"), *sparse_frequency(dataset)]})
        == 13
    )
    fewer = dataset.subset(np.arange(20))
    assert lofo(fewer)[2].sha256 != lofo(dataset)[2].sha256


def _transmitters(dataset: PasDataset, split: Split) -> tuple[set[int], set[int]]:
    trained, tested = (set(dataset.tx_index[rows].tolist()) for rows in (split.train, split.test))
    return trained, tested


@pytest.mark.parametrize("protocol", ["held-out-tx", "lofo-unseen-tx"])
def test_leak_free_protocols_share_no_transmitter_between_training_and_test(
    dataset: PasDataset, protocol: str
) -> None:
    for split in make_splits(dataset, protocol):
        trained, tested = _transmitters(dataset, split)
        assert not trained & tested
        assert len(tested) == round(UNSEEN_SHARE * len(trained | tested))
        assert not split.shares_transmitters
        assert split.nearest_trained_m > 0


@pytest.mark.parametrize("protocol", ["lofo", "sparse"])
def test_protocols_that_share_transmitters_say_so(dataset: PasDataset, protocol: str) -> None:
    for split in make_splits(dataset, protocol):
        trained, tested = _transmitters(dataset, split)
        assert tested <= trained
        assert split.shares_transmitters
        assert split.nearest_trained_m == 0


def test_no_protocol_trains_on_a_row_that_it_tests(dataset: PasDataset) -> None:
    for protocol in PROTOCOLS:
        for split in make_splits(dataset, protocol):
            assert not set(split.train.tolist()) & set(split.test.tolist())


def test_held_out_transmitters_are_tested_at_every_carrier(dataset: PasDataset) -> None:
    (split,) = held_out_tx(dataset)
    assert len(split.train) + len(split.test) == len(dataset)
    for rows in (split.train, split.test):
        assert set(dataset.carrier_hz[rows]) == set(dataset.carrier_hz)


def test_unseen_transmitters_at_an_unseen_carrier_are_those_held_out(dataset: PasDataset) -> None:
    (held_out,) = held_out_tx(dataset)
    for split, target in zip(lofo_unseen_tx(dataset), LOFO_TARGETS_HZ, strict=True):
        assert set(dataset.carrier_hz[split.test]) == {target}
        assert target not in dataset.carrier_hz[split.train]
        assert _transmitters(dataset, split)[1] == _transmitters(dataset, held_out)[1]


def test_the_nearest_trained_transmitter_is_as_far_as_it_is(dataset: PasDataset) -> None:
    (split,) = held_out_tx(dataset)
    tested, trained = (dataset.tx_position_m[rows] for rows in (split.test, split.train))
    distance_m = np.linalg.norm(tested[:, None] - trained[None], axis=2).min(axis=1)
    assert split.nearest_trained_m == pytest.approx(np.median(distance_m), rel=1e-12)


def test_every_split_is_found_by_its_name(dataset: PasDataset) -> None:
    for protocol in PROTOCOLS:
        for split in make_splits(dataset, protocol):
            assert find_split(dataset, protocol, split.name).sha256 == split.sha256


def test_one_transmitter_alone_cannot_be_held_out(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=1)
    with pytest.raises(ProtocolError, match="0 samples to train on"):
        make_splits(dataset, "held-out-tx")


def test_a_target_named_twice_is_one(dataset: PasDataset) -> None:
    (once,) = make_splits(dataset, "lofo", [2.4e9])
    (twice,) = make_splits(dataset, "lofo", [2.4e9, 2.4e9])
    assert once.sha256 == twice.sha256


def test_only_protocols_with_targets_take_them(dataset: PasDataset) -> None:
    with pytest.raises(ProtocolError, match="'held-out-tx' chooses what it tests"):
        make_splits(dataset, "held-out-tx", [10e9])
    assert len(make_splits(dataset, "lofo-unseen-tx", "all")) == 10
