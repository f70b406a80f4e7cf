"""The import of measured spectra of RFID tags, and what copying the nearest tag is worth on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import xfreqbench as xb
from tests.support.places import MEASURED_SPECTRA
from xfreqbench.cli.exchange import import_
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ProtocolError


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    if not MEASURED_SPECTRA.is_dir():
        pytest.skip(f"the measured spectra are not at {MEASURED_SPECTRA}")
    path = tmp_path_factory.mktemp("measured") / "rfid.h5"
    import_(MEASURED_SPECTRA, output=path, convention="wrf-gs", freq=0.92, quiet=True)
    return xb.open_dataset(path)


def test_one_command_imports_the_measured_spectra(measured: PasDataset) -> None:
    assert len(measured) == 200 and measured.grid.shape == (90, 360)
    assert np.unique(measured.carrier_hz).tolist() == [0.92e9]
    assert measured.pas(slice(None)).max(axis=(1, 2)) == pytest.approx(1)


def test_regions_of_a_small_volume_leave_enough_to_train_on(measured: PasDataset) -> None:
    """With the margin of rooms, half a metre, 16 of 160 would be left."""
    (split,) = xb.make_splits(measured, "held-out-block")
    apart_m = np.linalg.norm(
        measured.tx_position_m[split.test][:, None] - measured.tx_position_m[split.train], axis=2
    ).min()
    assert len(split.test) == 40 and len(split.train) > 70 and apart_m > 0.09


def test_copying_the_nearest_tag_is_good_among_neighbours_and_bad_in_a_region_without_any(
    measured: PasDataset, tmp_path: Path
) -> None:
    ssim = {
        protocol: xb.run(measured, "nearest", protocol=protocol, results=tmp_path)[0].scores["ssim"].median
        for protocol in ("held-out-tx", "held-out-block")
    }
    assert ssim["held-out-tx"] == pytest.approx(0.971, abs=0.001)  # others found that too
    assert ssim["held-out-block"] < 0.6


def test_protocols_of_several_carriers_say_that_there_is_one(measured: PasDataset) -> None:
    for protocol in ("lofo", "sparse", "lofo-unseen-tx"):
        with pytest.raises(ProtocolError, match=r"the data set has 0\.92 GHz"):
            xb.make_splits(measured, protocol)
