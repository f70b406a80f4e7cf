from __future__ import annotations

import numpy as np
import pytest
from xfreqbench.baselines.line_of_sight import LineOfSight
from xfreqbench.baselines.log_frequency import LogFrequency
from xfreqbench.baselines.mean_over_frequency import MeanOverFrequency, MeanOverFrequencyConfig
from xfreqbench.baselines.mean_spectrum import MeanSpectrum
from xfreqbench.baselines.nearest import Nearest

from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within, predict_checked

GRID_SHAPE = (90, 360)
ROUNDING = 1e-5  # float32 sums of a few maps


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", 8, (1.0, 10.0, 100.0))


def fitted(method, train):
    fit_within(method, train, Budget(), seed=0)
    return method


def at(dataset, tx, carrier):
    """Rows of transmitters at carriers."""
    return dataset[[tx * 3 + carrier]]


def ask(method, position_m, carrier_hz):
    return predict_checked(method, np.atleast_2d(position_m), np.array([carrier_hz]), GRID_SHAPE)[0]


def test_line_of_sight_peaks_at_the_transmitter(dataset: PasDataset) -> None:
    method = fitted(LineOfSight(), dataset)
    receiver = dataset.header.receiver
    for tx in range(4):
        position_m = dataset.tx_position_m[tx * 3]
        towards = (position_m - receiver.position_m) @ receiver.rotation
        peak = dataset.grid.directions.reshape(-1, 3)[ask(method, position_m, 1e9).argmax()]
        assert peak @ towards / np.linalg.norm(towards) > np.cos(np.radians(1.0))  # the grid's step


def test_nearest_copies_the_map_at_the_carrier_nearest_on_a_log_axis(dataset: PasDataset) -> None:
    method = fitted(Nearest(), dataset)
    position_m = at(dataset, 3, 0).tx_position_m[0]
    np.testing.assert_array_equal(ask(method, position_m, 3e9), at(dataset, 3, 0).pas()[0])
    np.testing.assert_array_equal(ask(method, position_m + 0.01, 3.3e9), at(dataset, 3, 1).pas()[0])


def test_mean_over_frequency_averages_the_same_transmitter(dataset: PasDataset) -> None:
    train = dataset[np.flatnonzero(dataset.carrier_hz != 10e9)]
    expected = (at(dataset, 2, 0).pas()[0] + at(dataset, 2, 2).pas()[0]) / 2
    answer = ask(fitted(MeanOverFrequency(), train), at(dataset, 2, 0).tx_position_m[0], 10e9)
    np.testing.assert_allclose(answer, expected / expected.max(), atol=ROUNDING)


def test_mean_over_frequency_averages_the_nearest_of_an_unseen_transmitter(dataset: PasDataset) -> None:
    train = dataset[np.flatnonzero(dataset.tx_index != 0)]
    position_m = dataset.tx_position_m[0]
    distance_m = np.linalg.norm(dataset.tx_position_m[3::3] - position_m, axis=1)
    nearest = 1 + np.argsort(distance_m)[:2]
    expected = dataset.pas(np.flatnonzero(np.isin(dataset.tx_index, nearest))).mean(axis=0)
    answer = ask(fitted(MeanOverFrequency(MeanOverFrequencyConfig(num_nearest=2)), train), position_m, 10e9)
    np.testing.assert_allclose(answer, expected / expected.max(), atol=ROUNDING)


def test_mean_over_frequency_takes_what_there_is_where_transmitters_are_few(dataset: PasDataset) -> None:
    train = dataset[np.arange(6)]
    expected = dataset.pas(np.arange(6)).mean(axis=0)
    answer = ask(fitted(MeanOverFrequency(), train), dataset.tx_position_m[23], 10e9)
    np.testing.assert_allclose(answer, expected / expected.max(), atol=ROUNDING)


def test_log_frequency_interpolates_between_the_neighbouring_carriers(dataset: PasDataset) -> None:
    method = fitted(LogFrequency(), dataset)
    low, high = at(dataset, 4, 0).pas()[0], at(dataset, 4, 1).pas()[0]
    answer = ask(method, at(dataset, 4, 0).tx_position_m[0], 10**9.25)
    expected = 0.75 * low + 0.25 * high
    np.testing.assert_allclose(answer, expected / expected.max(), atol=ROUNDING)


def test_log_frequency_keeps_the_edge_outside_the_band(dataset: PasDataset) -> None:
    method = fitted(LogFrequency(), dataset)
    position_m = at(dataset, 4, 0).tx_position_m[0]
    np.testing.assert_array_equal(ask(method, position_m, 0.5e9), at(dataset, 4, 0).pas()[0])
    np.testing.assert_array_equal(ask(method, position_m, 200e9), at(dataset, 4, 2).pas()[0])
    np.testing.assert_array_equal(ask(method, position_m, 10e9), at(dataset, 4, 1).pas()[0])


def test_a_transmitter_that_lacks_a_carrier_uses_those_it_has(dataset: PasDataset) -> None:
    train = dataset[np.flatnonzero(dataset.rows != 4 * 3 + 1)]
    position_m = at(dataset, 4, 0).tx_position_m[0]
    np.testing.assert_array_equal(ask(fitted(Nearest(), train), position_m, 11e9), at(dataset, 4, 2).pas()[0])


def test_mean_spectrum_is_the_mean_of_all_transmitters_at_the_nearest_carrier(dataset: PasDataset) -> None:
    train = dataset[np.flatnonzero((dataset.tx_index != 0) & (dataset.rows != 4 * 3 + 1))]
    method = fitted(MeanSpectrum(), train)
    for asked_hz, carrier in ((0.5e9, 0), (3e9, 0), (3.3e9, 1), (10e9, 1), (200e9, 2)):
        maps = [at(dataset, tx, carrier).pas()[0] for tx in range(1, 8) if (tx, carrier) != (4, 1)]
        expected = np.mean(maps, axis=0)
        for position_m in dataset.tx_position_m[[0, 9]]:
            answer = ask(method, position_m, asked_hz)
            np.testing.assert_allclose(answer, expected / expected.max(), atol=ROUNDING)


def test_mean_spectrum_that_is_fitted_again_forgets_the_first_maps(dataset: PasDataset) -> None:
    method = fitted(MeanSpectrum(), dataset)
    ask(method, (1.0, 1.0, 1.0), 10e9)
    only = at(dataset, 6, 1)
    np.testing.assert_array_equal(ask(fitted(method, only), (1.0, 1.0, 1.0), 10e9), only.pas()[0])
