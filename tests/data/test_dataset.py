from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray

from tests.support.synthetic import channel, make_header, transmitters, write_dataset
from xfreqbench.data.dataset import PasDataset, isolated, open_dataset, verify
from xfreqbench.data.power import power_db
from xfreqbench.data.views import plot
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.runs.predictions import write_predictions

PACKED_STEP = 0.51 / 65280  # half a step of packed maps


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Four transmitters at three carriers."""
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5")


def test_stored_channels_and_maps_are_those_of_the_plane_waves(dataset: PasDataset) -> None:
    expected = channel(transmitters(4)[2], 10e9)
    row = 2 * 3 + 1
    np.testing.assert_allclose(dataset.cfr[row], expected, rtol=1e-6)  # complex64
    beam = BartlettBeam(dataset.header.receiver.element_position_wavelengths, AngularGrid.hemisphere())
    maps, peak_power = beam.maps(expected[None])
    np.testing.assert_allclose(dataset.pas([row]), maps, atol=PACKED_STEP)
    assert dataset.tables["peak_power"].flat[dataset.rows][row] == pytest.approx(peak_power[0], rel=1e-5)
    np.testing.assert_allclose(dataset.grid.directions, beam.grid.directions, atol=1e-12)


def test_rows_run_over_carriers_first(dataset: PasDataset) -> None:
    assert len(dataset) == 12
    np.testing.assert_array_equal(dataset.tx_index, np.repeat(np.arange(4), 3))
    np.testing.assert_array_equal(dataset.carrier_hz, np.tile([1e9, 10e9, 37e9], 4))
    np.testing.assert_array_equal(dataset.tx_position_m, np.repeat(transmitters(4), 3, axis=0))
    np.testing.assert_array_equal(
        dataset.tables["line_of_sight"][dataset.tx_index], np.repeat([True, False, True, False], 3)
    )
    np.testing.assert_array_equal(dataset.tables["num_paths"].flat[dataset.rows], np.full(12, 3))


def test_a_file_without_maps_derives_the_maps_that_another_stores(dataset: PasDataset, tmp_path: Path) -> None:
    derived = write_dataset(tmp_path / "derived.h5", maps=False)
    np.testing.assert_allclose(derived.pas(), dataset.pas(), atol=PACKED_STEP)
    scores = [ssim(data.pas()[1:], data.pas()[:-1], data.grid) for data in (derived, dataset)]
    np.testing.assert_allclose(*scores, rtol=0, atol=4e-6)  # float16 moves it by up to 1.6e-5
    assert derived.path.stat().st_size < dataset.path.stat().st_size / 10


def test_maps_read_in_any_order_are_those_read_alone(dataset: PasDataset) -> None:
    rows = [1, 2, 3, 4, 9, 11, 10, 10, 0]  # over the ends of transmitters, not ascending, twice
    np.testing.assert_array_equal(dataset.pas(rows), np.concatenate([dataset.pas([row]) for row in rows]))
    assert dataset.pas([]).shape == (0, *dataset.grid.shape)


def test_a_subset_of_a_subset_keeps_its_maps(dataset: PasDataset) -> None:
    subset = dataset[[1, 5, 9]][[2, 0]]
    np.testing.assert_array_equal(subset.rows, [9, 1])
    np.testing.assert_array_equal(subset.pas(), dataset.pas([9, 1]))
    np.testing.assert_array_equal(subset.carrier_hz, dataset.carrier_hz[[9, 1]])


def test_an_isolated_view_holds_no_channel_of_another_row(dataset: PasDataset) -> None:
    view = isolated(dataset[[1, 5]])
    np.testing.assert_array_equal(view.cfr, dataset.cfr[[1, 5]])
    np.testing.assert_array_equal(
        view.tables["peak_power"].flat[view.rows], dataset.tables["peak_power"].flat[dataset.rows][[1, 5]]
    )
    whole = replace(view, rows=np.arange(len(dataset)))
    assert np.flatnonzero(np.abs(whole.cfr).sum(axis=1)).tolist() == [1, 5]
    assert np.flatnonzero(whole.tables["peak_power"].flat[whole.rows]).tolist() == [1, 5]
    pickled = pickle.loads(pickle.dumps(view))
    np.testing.assert_array_equal(pickled.tables["cfr"], view.tables["cfr"])
    assert pickled.tables.keys() == view.tables.keys()


def write_maps_alone(path: Path) -> tuple[PasDataset, np.ndarray]:
    """Two transmitters × three carriers of random maps on a coarse grid, the one at (1, 2) of zeros."""
    header = replace(make_header(num_tx=2), channels=False)
    grid = AngularGrid.hemisphere(9, 36)
    maps = np.random.default_rng(4).random((2, 3, *grid.shape), dtype=np.float32)
    maps /= maps.max(axis=(2, 3), keepdims=True)
    maps[1, 2] = 0
    with PasWriter(path, header, grid) as writer:
        for tx in range(2):
            writer.append(transmitters(2)[[tx]], np.array([True]), SampleBlock.of_maps(maps[[tx]]))
    return open_dataset(path), maps.reshape(-1, *grid.shape)


def test_maps_that_came_without_channels_are_kept_on_their_grid(tmp_path: Path) -> None:
    dataset, maps = write_maps_alone(tmp_path / "data.h5")
    verify(dataset.path)
    np.testing.assert_allclose(dataset.pas(), maps, atol=PACKED_STEP)
    assert dataset.grid.shape == (9, 36)
    np.testing.assert_array_equal(np.flatnonzero(~dataset.has_path), [5])
    np.testing.assert_array_equal(dataset.tables["num_paths"].flat[dataset.rows], [-1, -1, -1, -1, -1, 0])
    assert not dataset.header.channels
    with pytest.raises(DataError, match="maps, but no channels"):
        _ = dataset[[1]].cfr
    view = isolated(dataset[[1, 3]])
    np.testing.assert_allclose(view.pas(), maps[[1, 3]], atol=PACKED_STEP)
    assert np.flatnonzero(view.tables["peak_power"]).tolist() == [1, 3]
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(view)).pas(), view.pas())


def test_a_data_set_pickles_as_path_and_rows(dataset: PasDataset) -> None:
    subset = dataset[[3, 4]]
    pickled = pickle.dumps(subset)
    assert len(pickled) < 1000
    np.testing.assert_array_equal(pickle.loads(pickled).pas(), subset.pas())


def test_a_file_that_lies_there_instead_is_refused(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5")
    pickled = pickle.dumps(dataset)
    write_dataset(tmp_path / "data.h5", num_tx=2)
    with pytest.raises(DataError, match="another data set"):
        pickle.loads(pickled)
    with pytest.raises(DataError, match="another file than when it was opened"):
        dataset.pas(0)


def test_a_sample_without_any_path_is_flagged(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data.h5", silent=((1, 2),))
    np.testing.assert_array_equal(np.flatnonzero(~dataset.has_path), [5])
    assert not dataset.pas([5]).any()
    assert np.flatnonzero(power_db(dataset) == -np.inf).tolist() == [5]
    np.testing.assert_allclose(10 ** (power_db(dataset) / 10), np.mean(np.abs(dataset.cfr) ** 2, axis=1), rtol=1e-5)


def test_xarray_knows_names_coordinates_units_flags_and_numbers(dataset: PasDataset) -> None:
    with xarray.open_dataset(dataset.path, engine="h5netcdf") as shown:
        assert (shown.attrs["Conventions"], shown.attrs["num_tx"]) == ("CF-1.11", 4)
        assert shown.pas.dims == ("tx", "carrier_hz", "elevation_deg", "azimuth_deg")
        assert (shown.cfr.dims, shown.cfr.values.dtype) == (("tx", "carrier_hz", "element"), np.complex64)
        assert shown.frame_rotation.dims == ("axis", "receiver_axis")
        assert {"tx_position_m", "line_of_sight"} <= set(shown.coords)
        np.testing.assert_array_equal(shown.carrier_hz, [1e9, 10e9, 37e9])
        assert shown.carrier_hz.attrs["units"] == "Hz"
        assert shown.line_of_sight.attrs["flag_meanings"] == "blocked visible"
        assert shown.line_of_sight.attrs["flag_values"].tolist() == [0, 1]
        assert shown.axis.attrs["flag_meanings"] == "x y z"
        np.testing.assert_array_equal(shown.tx_position_m.sel(axis=2), transmitters(4)[:, 2])
        in_sight = shown.peak_power.where(shown.peak_power.line_of_sight == 1, drop=True)
        assert in_sight.tx.values.tolist() == [0, 2]
        assert float(shown.pas.isel(tx=0, carrier_hz=0).sel(elevation_deg=slice(0, 89)).max()) == 1


_READ_BY_NETCDF4 = """
import sys
import netCDF4
import numpy as np
import xarray

data, predictions, found = sys.argv[1:]
with xarray.open_dataset(data) as shown, xarray.open_dataset(predictions) as told:  # netCDF4 is the default where it is
    assert shown.pas.dims == ("tx", "carrier_hz", "elevation_deg", "azimuth_deg"), shown
    assert "line_of_sight" in shown.coords and shown.cfr.dtype.names == ("r", "i"), shown
    by_xarray, predicted = shown.pas.values, told.pas.values
with netCDF4.Dataset(data, auto_complex=True) as file:
    assert not np.ma.getmaskarray(file["pas"][:]).any()
    np.savez(found, pas=file["pas"][:], cfr=file["cfr"][:], by_xarray=by_xarray, predicted=predicted)
"""


def test_netcdf4_reads_what_is_stored(tmp_path: Path) -> None:
    """In a process of its own: float16, which no netCDF has, ends it."""
    dataset = write_dataset(tmp_path / "data.h5", silent=((1, 2),))
    files = [str(tmp_path / name) for name in ("data.h5", "predictions.h5", "found.npz")]
    write_predictions(Path(files[1]), [(np.arange(2), dataset.pas([3, 5]))], 2, dataset.grid.shape, "d", "s")
    subprocess.run([sys.executable, "-c", _READ_BY_NETCDF4, *files], check=True)
    with np.load(files[2]) as found:
        for name in ("pas", "by_xarray"):
            np.testing.assert_array_equal(found[name].reshape(-1, *dataset.grid.shape), dataset.pas())
        np.testing.assert_array_equal(found["cfr"].reshape(dataset.cfr.shape), dataset.cfr)
        np.testing.assert_array_equal(found["predicted"], dataset.pas([3, 5]))
        assert found["pas"].max(axis=(2, 3)).ravel().tolist() == [1.0] * 5 + [0.0] + [1.0] * 6


@pytest.mark.parametrize("kind", ["power", "amplitude"])
def test_a_map_is_drawn_in_db_below_its_peak(dataset: PasDataset, tmp_path: Path, kind: str) -> None:
    dataset = replace(dataset, header=replace(dataset.header, pas_kind=kind))
    figure = plot(dataset, 4)
    disc, bar = figure.axes
    assert disc.get_title() == f"10 GHz, transmitter at ({', '.join(f'{m:.2f}' for m in dataset[4].tx_position_m)}) m"
    assert bar.get_ylabel() == "dB below the peak"
    drawn_db = disc.collections[0].get_array().reshape(dataset.grid.shape)
    power = dataset[4].map.astype(float) ** (2 if kind == "amplitude" else 1)
    np.testing.assert_allclose(drawn_db, 10 * np.log10(np.maximum(power, 1e-3)), atol=1e-3)
    figure.savefig(tmp_path / "map.png")
    with pytest.raises(IndexError):
        plot(dataset, len(dataset))
