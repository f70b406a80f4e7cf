from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.k_nearest import KINDS, KNearest

from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within

ROUNDING = 1e-5  # float32 sums of a few maps
CARRIERS_GHZ = (1.0, 10.0, 30.0, 100.0)
NUM_TX, NUM_CARRIERS = 6, len(CARRIERS_GHZ)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", NUM_TX, CARRIERS_GHZ)


def fitted(train: PasDataset, method=None):
    method = method or KNearest()
    fit_within(method, train, Budget(), seed=0)
    return method


def ask(method, position_m, carrier_hz):
    return method.predict(np.atleast_2d(position_m), np.array([carrier_hz]))[0]


def softening_m(position_m: np.ndarray) -> float:
    """Half the median distance of each position from its nearest neighbour."""
    distance_m = np.linalg.norm(position_m[:, None] - position_m, axis=2)
    np.fill_diagonal(distance_m, np.inf)
    return np.median(distance_m.min(axis=1)) / 2


def by_hand(train, maps, position_m, carrier_hz, num_tx, num_carriers, softening):
    """The definition in loops, over the rows that are left; `maps` are those of all rows of the file."""
    distance_m = np.linalg.norm(train.tx_position_m - position_m, axis=1)
    transmitters = sorted(set(train.tx_index.tolist()), key=lambda tx: distance_m[train.tx_index == tx][0])
    total = np.zeros(maps.shape[1:])
    for tx in transmitters[:num_tx]:
        rows = np.flatnonzero(train.tx_index == tx)
        octaves = np.abs(np.log2(train.carrier_hz[rows] / carrier_hz))
        nearest = train.rows[rows[np.argsort(octaves, kind="stable")[:num_carriers]]]
        total += maps[nearest].mean(axis=0) / (distance_m[rows[0]] + softening)
    return (total / total.max()).astype(np.float32)


@pytest.mark.parametrize("counts", [(1, 1), (1, 2), (2, 1), (3, 2), (6, 100)])
def test_maps_are_weighted_by_the_distance_of_their_transmitters(dataset: PasDataset, counts) -> None:
    known = (dataset.tx_index != 0) & (dataset.carrier_hz != 30e9)
    for kept in (known, known & (dataset.rows % 5 != 0)):  # transmitters that lack a carrier too
        train = dataset[np.flatnonzero(kept)]
        method = fitted(train)
        method.counts = dict.fromkeys(KINDS, counts)
        softening = softening_m(np.unique(train.tx_position_m, axis=0))
        for position_m in (dataset.tx_position_m[0], train.tx_position_m[0]):
            for carrier_hz in (10e9, 30e9):
                expected = by_hand(train, dataset.pas(), position_m, carrier_hz, *counts, softening)
                np.testing.assert_allclose(ask(method, position_m, carrier_hz), expected, atol=ROUNDING)


@pytest.mark.parametrize("kind", KINDS)
def test_the_counts_are_those_that_predict_training_rows_best_from_the_others(dataset: PasDataset, kind: str) -> None:
    softening = softening_m(dataset.tx_position_m[::NUM_CARRIERS])
    coarse = AngularGrid(dataset.grid.elevation_rad[::3], dataset.grid.azimuth_rad[::3])
    scores: dict[tuple[int, int], list[float]] = {}
    maps = dataset.pas()
    for query in range(len(dataset)):
        position_m, carrier_hz = dataset.tx_position_m[query], dataset.carrier_hz[query]
        if "carrier" in kind and carrier_hz in {1e9, 100e9}:
            continue  # at the edge of the band
        unseen_carrier = "carrier" in kind and dataset.carrier_hz == carrier_hz
        unseen_tx = "transmitter" in kind and dataset.tx_index == dataset.tx_index[query]
        left = dataset[np.flatnonzero(~(np.zeros(len(dataset), bool) | unseen_carrier | unseen_tx))]
        truth = maps[[query], ::3, ::3]
        for counts in ((tx, carriers) for tx in (1, 2, 3, 4, 6) for carriers in (1, 2, 3, 4)):
            shown = by_hand(left, maps, position_m, carrier_hz, *counts, softening)
            scores.setdefault(counts, []).append(ssim(shown[None, ::3, ::3], truth, coarse)[0])
    best = max(np.median(of_counts) for of_counts in scores.values())
    num_tx, num_carriers = fitted(dataset).counts[kind]
    chosen = scores[min(num_tx, NUM_TX), min(num_carriers, NUM_CARRIERS)]
    assert np.median(chosen) == pytest.approx(best, abs=1e-5)  # float32 sums in another order


def test_where_nothing_can_be_left_out_it_is_one_map(dataset: PasDataset) -> None:
    alone = dataset[[5]]
    method = fitted(alone)
    assert set(method.counts.values()) == {(1, 1)}
    np.testing.assert_allclose(ask(method, (1.0, 1.0, 1.0), 5e9), alone.pas()[0], atol=ROUNDING)


def test_a_record_tells_the_counts_and_a_saved_method_keeps_them(dataset: PasDataset, tmp_path: Path) -> None:
    method = fitted(dataset)
    method.save(tmp_path)
    assert KNearest.load(tmp_path).counts == method.counts
    method.counts = dict(zip(KINDS, ((1, 1), (2, 4), (8, 2**31)), strict=True))
    assert method.findings() == {
        "unseen carrier": {"transmitters": 1, "carriers": 1},
        "unseen transmitter": {"transmitters": 2, "carriers": 4},
        "unseen carrier and transmitter": {"transmitters": 8, "carriers": "all"},
    }
