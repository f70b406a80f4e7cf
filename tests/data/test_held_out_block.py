from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import NUM_BLOCKS, Split, blocks, cell_m, make_splits
from xfreqbench.errors import ProtocolError

NUM_TX = 60


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    path = tmp_path_factory.mktemp("data") / "data.h5"
    return write_dataset(path, NUM_TX, (1.0, 10.0), silent=((0, 1),))


def _apart_m(dataset: PasDataset, split: Split) -> np.ndarray:
    """The distance of each tested row from the nearest trained one."""
    tested, trained = (dataset.tx_position_m[rows] for rows in (split.test, split.train))
    return np.linalg.norm(tested[:, None] - trained, axis=2).min(axis=1)


@pytest.mark.parametrize("on", ["test", "validation"])
def test_no_trained_transmitter_is_near_a_tested_one_and_no_other_is_left_out(dataset: PasDataset, on) -> None:
    (split,) = make_splits(dataset, "held-out-block", on=on)
    assert _apart_m(dataset, split).min() >= cell_m(dataset) / 2
    assert not split.shares_transmitters
    assert split.nearest_trained_m == pytest.approx(np.median(_apart_m(dataset, split)))
    (whole,) = make_splits(dataset, "held-out-block")
    offered = np.arange(len(dataset)) if on == "test" else whole.train
    left_out = np.setdiff1d(offered, [*split.train, *split.test])
    tested_m = dataset.tx_position_m[split.test]
    for row in left_out[dataset.has_path[left_out]]:
        assert np.linalg.norm(tested_m - dataset.tx_position_m[row], axis=1).min() < cell_m(dataset) / 2


def test_a_fifth_is_tested_at_every_carrier_and_the_carriers_are_trained_on(dataset: PasDataset) -> None:
    (split,) = make_splits(dataset, "held-out-block")
    assert len(np.unique(dataset.tx_index[split.test])) == NUM_TX / 5
    for rows in (split.train, split.test):
        assert set(dataset.carrier_hz[rows]) == {1e9, 10e9}
    assert split.num_without_path + len(split.test) == 2 * NUM_TX / 5


def test_a_validation_holds_out_a_region_of_the_training_transmitters(dataset: PasDataset) -> None:
    (split,) = make_splits(dataset, "held-out-block")
    (validation,) = make_splits(dataset, "held-out-block", on="validation")
    trained = len(np.unique(dataset.tx_index[split.train]))
    assert len(np.unique(dataset.tx_index[validation.test])) == pytest.approx(trained / NUM_BLOCKS, abs=1)
    assert set(validation.test) <= set(split.train)


def test_regions_are_rectangles_of_equally_many_positions() -> None:
    position_m = np.random.default_rng(0).uniform((0, 0), (10, 4), size=(403, 2))
    found = blocks(position_m, NUM_BLOCKS)
    counts = np.bincount(found)
    assert len(counts) == NUM_BLOCKS and counts.max() - counts.min() <= 2  # a rounding at each of two halvings
    for region in range(NUM_BLOCKS):
        low, high = (edge(position_m[found == region], axis=0) for edge in (np.min, np.max))
        inside = ((position_m >= low) & (position_m <= high)).all(axis=1)
        assert set(found[inside]) == {region}
        assert np.prod(high - low) < 10 * 4 / NUM_BLOCKS * 1.5  # no region is spread over the room


def test_of_few_transmitters_each_is_a_region(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", 4, (1.0,))
    (split,) = make_splits(dataset, "held-out-block")
    assert (len(split.train), len(split.test)) == (3, 1)
    with pytest.raises(ProtocolError, match=r"training transmitters, .* must be 10 or more, but there are 3\."):
        make_splits(dataset, "held-out-block", on="validation")
    alone = write_dataset(tmp_path / "alone.h5", 1, (1.0,))
    with pytest.raises(ProtocolError, match="0 samples to train on"):
        make_splits(alone, "held-out-block")
