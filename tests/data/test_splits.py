from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from tests.support.synthetic import paper_dataset, write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import (
    LOFO_TARGETS_HZ,
    PROTOCOLS,
    UNSEEN_SHARE,
    VALIDATIONS,
    Split,
    find_split,
    left_out,
    make_splits,
)
from xfreqbench.data.validation import place_index
from xfreqbench.errors import ArgumentError, DataError, ProtocolError, UnknownNameError
from xfreqbench.units import PAPER_CARRIERS_GHZ


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5")


def test_lofo_never_trains_on_the_carrier_it_tests(dataset: PasDataset) -> None:
    for split, target in zip(make_splits(dataset, "lofo"), LOFO_TARGETS_HZ, strict=True):
        assert set(dataset.carrier_hz[split.test]) == {target}
        assert target not in dataset.carrier_hz[split.train]
        assert len(split.train) + len(split.test) == len(dataset)
        assert split.shares_transmitters


def test_lofo_all_holds_out_every_carrier_once(dataset: PasDataset) -> None:
    splits = make_splits(dataset, "lofo", "all")
    tested = np.concatenate([split.test for split in splits])
    np.testing.assert_array_equal(np.sort(tested), np.arange(len(dataset)))
    assert len(splits) == len(make_splits(dataset, "lofo-unseen-tx", "all")) == 10
    (once,), (twice,) = (make_splits(dataset, "lofo", targets) for targets in ([2.4], [2.4, 2.4]))
    assert once.sha256 == twice.sha256


def test_every_split_has_a_name_and_a_hash_of_its_own(dataset: PasDataset) -> None:
    names = [split.name for protocol in ("lofo", "sparse") for split in make_splits(dataset, protocol)]
    assert names[:3] == ["lofo-2.4GHz", "lofo-24.25GHz", "lofo-77GHz"]
    assert names[4] == "sparse-24.25GHz-from-10-37-94GHz"
    every = [split for protocol in PROTOCOLS for split in make_splits(dataset, protocol)]
    for split in every:
        assert find_split(dataset, split.protocol, split.name).sha256 == split.sha256
        assert not set(split.train.tolist()) & set(split.test.tolist())
    assert len({split.sha256 for split in every}) == len(every)
    assert make_splits(dataset[np.arange(20)], "lofo")[2].sha256 != make_splits(dataset, "lofo")[2].sha256


def test_sparse_frequency_trains_on_the_carriers_of_the_paper(dataset: PasDataset) -> None:
    trained = [set(dataset.carrier_hz[split.train] / 1e9) for split in make_splits(dataset, "sparse")]
    assert trained == [{10, 37}, {10, 37, 94}, {1, 10, 37, 60, 94}]
    for split in make_splits(dataset, "sparse"):
        assert set(dataset.carrier_hz[split.test]) == {24.25e9}


def test_samples_without_a_path_are_in_neither_part_and_counted(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", silent=((0, 1), (2, 1), (3, 0)))
    split = make_splits(dataset, "lofo", [10])[0]
    assert split.num_without_path == 2
    np.testing.assert_array_equal(split.test, [4, 10])
    assert 9 not in split.train


def test_carriers_a_few_kilohertz_apart_are_different_targets(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", carriers_ghz=(24.25001, 24.25002, 30.0))
    splits = make_splits(dataset, "lofo", "all")
    assert len({split.name for split in splits}) == 3
    for split in splits:
        assert find_split(dataset, "lofo", split.name).sha256 == split.sha256


def test_carriers_that_agree_in_nine_digits_are_not_trained_on_for_each_other(tmp_path: Path) -> None:
    alike_hz = [94e9, 94e9 + 10]
    dataset = write_dataset(tmp_path / "data.h5", carriers_ghz=(10.0, 37.0, 94.0, 94.00000001))
    splits = make_splits(dataset, "lofo", [94.0, 94.00000001])
    assert [split.name for split in splits] == ["lofo-94GHz", "lofo-94.00000001GHz"]
    for split, target_hz in zip(splits, alike_hz, strict=True):
        assert set(dataset.carrier_hz[split.test]) == {target_hz}
        assert not np.isin(dataset.carrier_hz[split.train], alike_hz).any()
        assert find_split(dataset, "lofo", split.name).sha256 == split.sha256
    with pytest.raises(
        ProtocolError, match=r"needs 94\.00000002 GHz, but the data set has 10, 37, 94, 94\.00000001 GHz"
    ):
        make_splits(dataset, "lofo", [94.00000002])


def test_a_carrier_without_paths_does_not_block_the_others(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=1, silent=((0, 1),))
    assert [split.name for split in make_splits(dataset, "lofo", "all")] == ["lofo-1GHz", "lofo-37GHz"]
    assert find_split(dataset, "lofo", "lofo-37GHz").name == "lofo-37GHz"


def test_sparse_serves_the_splits_whose_carriers_there_are(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", carriers_ghz=(10.0, 24.25, 37.0))
    assert [split.name for split in make_splits(dataset, "sparse")] == ["sparse-24.25GHz-from-10-37GHz"]
    assert left_out(dataset) == (
        "sparse leaves out 2 of 3 splits: sparse-24.25GHz-from-10-37-94GHz (no 94 GHz), "
        "sparse-24.25GHz-from-1-10-37-60-94GHz (no 1, 60, 94 GHz)"
    )
    with pytest.raises(ProtocolError, match=r"trains on 10, 37, 94 GHz; or .*carriers 10,24.25,37,94 \(in GHz\)"):
        make_splits(dataset, "sparse", on="validation")


@pytest.mark.parametrize(
    ("held", "asked", "told"),
    [
        ({}, ("lofo",), r"needs 2.4, 24.25, 77 GHz, but the data set has 1, 10, 37 GHz"),
        ({}, ("sparse",), r"tests 24.25 GHz and trains on 10, 37 GHz; or .*carriers 10,24.25,37 \(in"),
        ({"carriers_ghz": (10.0,)}, ("lofo", "all"), "two carriers"),
        ({"num_tx": 1, "silent": ((0, 1),)}, ("lofo", [10]), "0 to test on"),
        ({"num_tx": 1}, ("held-out-tx",), "0 samples to train on"),
        ({}, ("held-out-tx", [10]), "'held-out-tx' has no targets to choose"),
        (
            {"num_tx": 12},
            ("lofo", [10], "validation"),
            r"'lofo-validation-10GHz' .* 3 of them or more, but they are 1, 37 GHz",
        ),
        ({"num_tx": 11}, ("held-out-tx", None, "validation"), r"transmitters, .* be 10 or more, but there are 9\. G"),
    ],
)
def test_what_cannot_be_split_is_refused_with_what_there_is(
    tmp_path: Path, held: dict[str, Any], asked: tuple[Any, ...], told: str
) -> None:
    dataset = write_dataset(tmp_path / "data.h5", **held)
    with pytest.raises(ProtocolError, match=told):
        make_splits(dataset, *asked)


def test_a_target_outside_of_the_trained_band_is_extrapolated(dataset: PasDataset) -> None:
    told = [split.extrapolation(dataset) for split in make_splits(dataset, "lofo", [1, 24.25, 94])]
    assert told[0] == "lofo-1GHz extrapolates to 1 GHz: it is trained on 2.4 to 94 GHz"
    assert told[1] is None
    assert "to 94 GHz: it is trained on 1 to 77 GHz" in str(told[2])


@pytest.mark.parametrize(("said", "name"), [("leave-one-out", "lofo"), ("Random", "random-samples"), ("loof", "lofo")])
def test_a_protocol_by_the_name_that_others_give_it_is_told(dataset: PasDataset, said: str, name: str) -> None:
    with pytest.raises(UnknownNameError, match=f"Did you mean '{name}'"):
        make_splits(dataset, said)


def test_an_unknown_split_or_part_names_the_known_ones(dataset: PasDataset) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'lofo-77GHz'"):
        find_split(dataset, "lofo", "lofo-78GHz")
    with pytest.raises(ArgumentError, match="'test' or 'validation'"):
        make_splits(dataset, "lofo", on="tests")  # type: ignore[arg-type]


def _transmitters(dataset: PasDataset, split: Split) -> tuple[set[int], set[int]]:
    trained, tested = (set(dataset.tx_index[rows].tolist()) for rows in (split.train, split.test))
    return trained, tested


@pytest.mark.parametrize("protocol", ["lofo", "sparse", "held-out-tx", "lofo-unseen-tx"])
def test_a_protocol_says_whether_tested_transmitters_are_trained_on_and_how_near_they_are(
    dataset: PasDataset, protocol: str
) -> None:
    for split in make_splits(dataset, protocol):
        trained, tested = _transmitters(dataset, split)
        assert split.shares_transmitters == (protocol in {"lofo", "sparse"})
        if split.shares_transmitters:
            assert tested <= trained
        else:
            assert not trained & tested and len(tested) == round(UNSEEN_SHARE * len(trained | tested))
        tested_m, trained_m = (dataset.tx_position_m[rows] for rows in (split.test, split.train))
        nearest_m = np.linalg.norm(tested_m[:, None] - trained_m[None], axis=2).min(axis=1)
        assert split.nearest_trained_m == pytest.approx(np.median(nearest_m), rel=1e-12)


@pytest.mark.parametrize("on", ["test", "validation"])
def test_a_sample_that_is_given_twice_is_in_one_part(dataset: PasDataset, on: Literal["test", "validation"]) -> None:
    position_m, carrier_hz = dataset.tables["tx_position_m"].copy(), dataset.header.carrier_hz.copy()
    position_m[1:], carrier_hz[1] = position_m[0], carrier_hz[0] + 1
    header = replace(dataset.header, carrier_hz=carrier_hz)
    twice = replace(dataset, header=header, tables={**dataset.tables, "tx_position_m": position_m})
    (split,) = make_splits(twice, "random-samples", on=on)
    sample = np.stack([place_index(twice), twice.carrier_hz.round(-2)], axis=1)
    assert not set.intersection(*({*map(tuple, sample[rows].tolist())} for rows in (split.train, split.test)))


@pytest.mark.parametrize("on", ["test", "validation"])
@pytest.mark.parametrize("protocol", ["held-out-tx", "lofo-unseen-tx", "held-out-block"])
def test_a_place_that_is_given_twice_is_in_one_part(of_many_transmitters: PasDataset, protocol: str, on) -> None:
    position_m = of_many_transmitters.tables["tx_position_m"]
    assert (place_index(of_many_transmitters) == of_many_transmitters.tx_index).all()  # every place is given once there
    twice_m = np.concatenate([position_m[:20], position_m[:20] + np.array([0.0, 6e-4, 6e-4])])
    twice = replace(of_many_transmitters, tables={**of_many_transmitters.tables, "tx_position_m": twice_m})
    for split in make_splits(twice, protocol, on=on):
        away_m = np.linalg.norm(twice.tx_position_m[split.test, None] - twice.tx_position_m[split.train], axis=2)
        assert away_m.min() > 1e-3 and split.nearest_trained_m > 1e-3
        assert not split.shares_transmitters
        assert len(np.unique(twice.tx_index[split.test])) == 2 * len(np.unique(place_index(twice)[split.test]))


@pytest.mark.parametrize("shape", [{"rows": 1, "cols": 1}, {"spacing_wavelengths": 0.04}])
def test_maps_that_are_all_constant_are_not_tested(dataset: PasDataset, shape: dict[str, float]) -> None:
    receiver = replace(dataset.header.receiver, **shape)
    constant = replace(dataset, header=replace(dataset.header, receiver=receiver))
    for protocol in PROTOCOLS:
        with pytest.raises(DataError, match="are nearly constant, because its array has hardly any extent"):
            make_splits(constant, protocol)


def test_held_out_transmitters_are_tested_at_every_carrier(dataset: PasDataset) -> None:
    (split,) = make_splits(dataset, "held-out-tx")
    assert len(split.train) + len(split.test) == len(dataset)
    for rows in (split.train, split.test):
        assert set(dataset.carrier_hz[rows]) == set(dataset.carrier_hz)


def test_unseen_transmitters_at_an_unseen_carrier_are_those_held_out(dataset: PasDataset) -> None:
    (held_out,) = make_splits(dataset, "held-out-tx")
    for split, target in zip(make_splits(dataset, "lofo-unseen-tx"), LOFO_TARGETS_HZ, strict=True):
        assert set(dataset.carrier_hz[split.test]) == {target}
        assert target not in dataset.carrier_hz[split.train]
        assert _transmitters(dataset, split)[1] == _transmitters(dataset, held_out)[1]


def test_random_samples_test_a_fifth_of_them_and_leak_places_and_carriers(dataset: PasDataset) -> None:
    (split,) = make_splits(dataset, "random-samples")
    assert len(split.test) == round(UNSEEN_SHARE * len(dataset))
    assert len(split.train) + len(split.test) == len(dataset)
    trained, tested = _transmitters(dataset, split)
    assert tested <= trained and split.shares_transmitters
    assert set(dataset.carrier_hz[split.test]) <= set(dataset.carrier_hz[split.train])


def test_a_validation_of_random_samples_is_a_tenth_of_the_training_samples(dataset: PasDataset) -> None:
    (split,), (validation,) = (make_splits(dataset, "random-samples", on=on) for on in ("test", "validation"))
    assert len(validation.test) == round(len(split.train) / 10)
    assert sorted([*validation.train, *validation.test]) == split.train.tolist()


@pytest.fixture(scope="module")
def of_many_transmitters(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Enough that a tenth of the training transmitters can be held out; two samples have no path."""
    path = tmp_path_factory.mktemp("data") / "data.h5"
    return write_dataset(path, 40, PAPER_CARRIERS_GHZ, silent=((0, 4), (7, 5)))


def _with_validation(dataset: PasDataset, protocol: str) -> list[tuple[Split, Split]]:
    """Each split that has a validation, with it."""
    tested = {split.name.removeprefix(protocol): split for split in make_splits(dataset, protocol)}
    validations = make_splits(dataset, protocol, on="validation")
    return [(tested[split.name.removeprefix(f"{protocol}-validation")], split) for split in validations]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_validation_rows_are_training_rows_as_unseen_as_the_tested_ones_which_are_not_seen_in_them(
    of_many_transmitters: PasDataset, protocol: str
) -> None:
    dataset = of_many_transmitters
    pairs = _with_validation(dataset, protocol)
    assert pairs
    for split, validation in pairs:
        assert validation.shares_transmitters == split.shares_transmitters
        for values in (dataset.carrier_hz, dataset.tx_index):
            seen_in = [np.isin(values[part.test], values[part.train]).any() for part in (split, validation)]
            assert seen_in[0] == seen_in[1]
        trained, validated = set(validation.train.tolist()), set(validation.test.tolist())
        assert trained and validated and not trained & validated
        assert trained | validated <= set(split.train.tolist())
        seen = np.array(sorted(trained | validated))
        if protocol in {"lofo", "sparse", "lofo-unseen-tx"}:
            assert not np.isin(dataset.carrier_hz[seen], dataset.carrier_hz[split.test]).any()
        if protocol in {"held-out-tx", "held-out-block", "lofo-unseen-tx"}:
            assert not np.isin(dataset.tx_index[seen], dataset.tx_index[split.test]).any()


def test_the_validated_carrier_is_the_nearest_to_the_target_that_has_trained_ones_on_both_sides(
    dataset: PasDataset,
) -> None:
    targets_ghz = (1.0, 2.4, 24.25, 77.0, 94.0)
    validations = make_splits(dataset, "lofo", targets_ghz, on="validation")
    validated = [set(dataset.carrier_hz[split.test] / 1e9) for split in validations]
    assert [split.name for split in validations][:2] == ["lofo-validation-1GHz", "lofo-validation-2.4GHz"]
    for (carrier_ghz,), target_ghz, split in zip(validated, targets_ghz, validations, strict=True):
        trained_ghz = dataset.carrier_hz[split.train] / 1e9
        assert trained_ghz.min() < carrier_ghz < trained_ghz.max()
        others = set(PAPER_CARRIERS_GHZ) - {target_ghz}
        inner = sorted(others)[1:-1]
        assert carrier_ghz == min(inner, key=lambda inner_ghz: abs(np.log(inner_ghz / target_ghz)))


def test_a_tenth_of_the_training_transmitters_validates_those_that_are_unseen(of_many_transmitters: PasDataset) -> None:
    dataset = of_many_transmitters  # 40, of which 32 are trained on: a tenth are three, and four the least
    for protocol in ("held-out-tx", "lofo-unseen-tx"):
        for _, validation in _with_validation(dataset, protocol):
            assert len(_transmitters(dataset, validation)[1]) == 4


def test_validation_rows_without_a_path_are_counted(of_many_transmitters: PasDataset) -> None:
    (split,) = make_splits(of_many_transmitters, "lofo", [24.25], on="validation")
    assert set(of_many_transmitters.carrier_hz[split.test]) == {37e9}
    assert (split.num_without_path, len(split.test)) == (1, 39)


def test_sparse_training_on_two_carriers_has_no_validation(dataset: PasDataset) -> None:
    splits = make_splits(dataset, "sparse", on="validation")
    assert [split.name for split in splits] == [
        "sparse-validation-24.25GHz-from-10-37-94GHz",
        "sparse-validation-24.25GHz-from-1-10-37-60-94GHz",
    ]
    assert [set(dataset.carrier_hz[split.test]) for split in splits] == [{37e9}, {37e9}]


def test_every_validation_split_is_found_by_its_name_and_is_no_split_of_a_test(
    of_many_transmitters: PasDataset,
) -> None:
    hashes = set()
    for protocol in PROTOCOLS:
        for split, validation in _with_validation(of_many_transmitters, protocol):
            assert VALIDATIONS[validation.protocol] == split.protocol
            found = find_split(of_many_transmitters, validation.protocol, validation.name)
            assert found.sha256 == validation.sha256
            hashes |= {split.sha256, validation.sha256}
            with pytest.raises(UnknownNameError):
                find_split(of_many_transmitters, validation.protocol, split.name)
    assert len(hashes) == 2 * (3 + 2 + 1 + 3 + 1 + 1)
