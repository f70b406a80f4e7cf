"""Paths in the layouts of others: what is written is what was traced, and the package `deepmimo` reads it so."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

from tests.support.fuzzing.common import xfreqbench
from tests.support.sionna_scenes import GRID, ONE_ELEMENT, simple_scenes
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.generate import generate
from xfreqbench.data.power import power_db, received_power_dbm
from xfreqbench.data.statistics import statistics
from xfreqbench.errors import DataError
from xfreqbench.exchange.deepmimo import export_deepmimo
from xfreqbench.exchange.path_arrays import export_sionna_npz
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIERS_GHZ = [2.4, 24.25]
TX_M = np.array([[3.1, 4.2, 1.1], [0.6, 3.9, 1.7], [3.0, 1.2, 1.0]])
SCENE = replace(simple_scenes(ONE_ELEMENT)["a wall and a pane between"], name="Wall & pane", transmitters=GRID)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    how: Any = {"interactions": ["specular", "refraction"], "rays": 50_000, "max_depth": 3, "paths": True}
    path = tmp_path_factory.mktemp("paths") / "data.h5"
    return generate(SCENE, path, CARRIERS_GHZ, tx_positions=TX_M, maps=False, **how)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """One transmitter, without paths."""
    path = tmp_path_factory.mktemp("plain") / "plain.h5"
    return generate(SCENE, path, [2.4], tx_positions=TX_M[:1], rays=1000, max_depth=1, maps=False)


@pytest.fixture(scope="module")
def scenarios(data: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenarios") / "all"
    export_deepmimo(data.path, folder)
    return folder


def matrices(scenario: Path) -> dict[str, Any]:
    found = {path.name.split("_t000")[0]: path for path in scenario.glob("*_t000_tx000_r001.npz")}
    return {key: np.load(path)[key] for key, path in found.items()}


def test_every_carrier_is_a_scenario_with_a_name_that_deepmimo_takes(scenarios: Path) -> None:
    assert sorted(path.name for path in scenarios.iterdir()) == ["wall___pane_2.4ghz", "wall___pane_24.25ghz"]


@pytest.mark.parametrize("carrier", [0, 1])
def test_the_matrices_of_deepmimo_sum_up_to_the_channel(data: PasDataset, scenarios: Path, carrier: int) -> None:
    found = matrices(scenarios / f"wall___pane_{CARRIERS_GHZ[carrier]:g}ghz")
    amplitude = 10 ** (found["power"] / 20) * np.exp(1j * np.radians(found["phase"]))
    for tx in range(len(TX_M)):
        channel = data.paths(2 * tx + carrier).impulse_response().cfr([0.0])[0, 0]
        assert np.nansum(amplitude[tx]) == pytest.approx(channel, rel=1e-5)
    assert (np.diff(np.nan_to_num(found["power"], nan=-999), axis=1) <= 0).all()  # the strongest first
    np.testing.assert_array_equal(found["rx_pos"], TX_M)
    np.testing.assert_array_equal(found["tx_pos"], [ONE_ELEMENT.position_m])


def test_the_array_is_the_base_station_and_interactions_are_told_from_it(data: PasDataset, scenarios: Path) -> None:
    found, paths = matrices(scenarios / "wall___pane_2.4ghz"), data.paths(0)
    assert paths.interactions.tolist() == [[4, 0], [4, 1]]  # from the transmitter: through the pane, then the wall
    assert found["inter"][0].tolist()[:2] == [4.0, 14.0]
    np.testing.assert_allclose(found["inter_pos"][0, 1], paths.vertices_m[1, ::-1])
    np.testing.assert_allclose(found["aod_az"][0, 1], np.degrees(paths.arrival_azimuth_rad[1]), rtol=1e-6)
    zenith_deg = 90 - np.degrees(paths.departure_elevation_rad[1])
    np.testing.assert_allclose(found["aoa_el"][0, 1], zenith_deg, rtol=1e-6)
    assert found["inter"][2, 0] == 0  # a transmitter in sight


def test_deepmimo_gets_the_scene_and_its_materials_at_the_carrier(scenarios: Path) -> None:
    scenario = scenarios / "wall___pane_24.25ghz"
    told = json.loads((scenario / "params.json").read_text("utf-8"))
    assert told["rt_params"]["frequency"] == 24.25e9
    assert told["rt_params"]["max_scattering"] == told["rt_params"]["diffuse_reflections"] == 0
    assert [each["name"] for each in told["materials"].values()] == ["concrete", "glass"]
    assert told["materials"]["material_0"]["permittivity"] == pytest.approx(5.24)  # P.2040, 24.25 GHz
    assert told["materials"]["material_0"]["conductivity"] == pytest.approx(0.0462 * 24.25**0.7822)
    vertices_m, faces = np.load(scenario / "vertices.npz")["vertices"], np.load(scenario / "faces.npz")
    for n, mesh in enumerate(surface_meshes(SCENE)):
        np.testing.assert_array_equal(vertices_m[faces[str(n)]], mesh.corners_m)


@pytest.fixture
def deepmimo(scenarios: Path) -> Iterator[Any]:
    package = pytest.importorskip("deepmimo", reason="deepmimo is not here: pip install 'xfreqbench[deepmimo]'")
    package.config.set("scenarios_folder", str(scenarios))
    yield package
    package.config.reset()


def test_the_package_deepmimo_computes_our_channel_over_a_band(data: PasDataset, deepmimo: Any) -> None:
    loaded = deepmimo.load("wall___pane_24.25ghz")
    given = deepmimo.ChannelParameters(num_paths=10)
    given.bs_antenna.shape = given.ue_antenna.shape = np.array([1, 1])
    given.ofdm.bandwidth, given.ofdm.subcarriers = 100e6, 64
    given.ofdm.selected_subcarriers = np.arange(64)
    channel = loaded.compute_channels(given)[:, 0, 0] * np.sqrt(64)  # it spreads the power over the subcarriers
    for tx in range(len(TX_M)):
        ours = data.paths(2 * tx + 1).impulse_response().cfr(np.arange(64) * 100e6 / 64)[:, 0]
        np.testing.assert_allclose(channel[tx], ours, rtol=0, atol=1e-5 * np.abs(ours).max())  # complex64
    assert loaded.los.tolist() == [0, 0, 1]
    assert loaded.inter_str[0, 1] == "RT"
    assert [each.name for each in loaded.scene.objects] == ["wall", "pane, between"]


ANGLES = ("theta_t", "phi_t", "theta_r", "phi_r")


def listed(arrays: Mapping[str, Any], tx: int) -> Iterator[tuple[list[int], np.ndarray]]:
    """Interactions and numbers of each of a transmitter's paths, the earliest first."""
    for p in np.argsort(arrays["tau"][0, tx]).tolist():
        if arrays["valid"][0, tx, p]:
            codes = [code for code in arrays["interactions"][:, 0, tx, p].tolist() if code]
            angles = [arrays[name][0, tx, p] for name in ANGLES]
            gain, points_m = arrays["a"][0, 0, tx, 0, p], arrays["vertices"][: len(codes), 0, tx, p]
            metres = SPEED_OF_LIGHT_M_S * arrays["tau"][0, tx, p]
            yield codes, np.array([1e2 * gain.real, 1e2 * gain.imag, metres, *angles, *points_m.ravel()])


@pytest.mark.sionna
def test_the_arrays_are_those_of_sionna_rt(data: PasDataset, tmp_path: Path) -> None:
    from xfreqbench.tracing.sionna.plain import loaded, rt

    export_sionna_npz(data.path, tmp_path / "npz")
    stored = np.load(tmp_path / "npz" / "wall___pane_2.4ghz.npz")
    scene = loaded(SCENE, 2.4e9)
    for number, position_m in enumerate(TX_M.tolist()):
        scene.add(rt.Transmitter(name=f"{number}", position=position_m))
    solved = rt.PathSolver()(scene, max_depth=3, samples_per_src=50_000, synthetic_array=True, seed=1)
    names = ("valid", "tau", *ANGLES, "interactions", "vertices")
    public = {name: getattr(solved, name).numpy() for name in names}
    public["a"] = solved.a[0].numpy() + 1j * solved.a[1].numpy()
    for tx in range(len(TX_M)):
        for ours, theirs in zip(listed(stored, tx), listed(public, tx), strict=True):
            assert ours[0] == theirs[0]
            np.testing.assert_allclose(ours[1], theirs[1], atol=3e-5)  # float32
    for name in (*names[:-2], "a"):
        assert stored[name].shape == public[name].shape
        padding = [each[name].reshape(each["tau"].shape)[each["tau"] < 0].tolist() for each in (stored, public)]
        assert padding[0] == padding[1]
    objects = np.array([*stored["object_names"], ""])[np.minimum(stored["objects"], 2)]
    assert objects[:, 0, 0, 1].tolist() == ["pane, between", "wall"]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    """Three transmitters of 23 dBm at two carriers, each polarization sent and heard."""
    scene, path = replace(SCENE, transmitters=replace(GRID, power_dbm=23.0)), tmp_path_factory.mktemp("both") / "d.h5"
    how: Any = {"tx_positions": TX_M, "interactions": ["specular", "refraction"], "max_depth": 2, "paths": True}
    return generate(scene, path, CARRIERS_GHZ, polarization=["V", "H"], maps=False, **how)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_table_has_powers_and_spreads_of_every_link(both: PasDataset, tmp_path: Path, suffix: str) -> None:
    words = () if suffix == "csv" else ("--power-dbm", "10")
    output = tmp_path / f"links.{suffix}"
    assert xfreqbench("export", both.path, "-o", output, "--to", "table", *words, "-q").code == 0
    table = pandas.read_csv(output) if suffix == "csv" else pandas.read_parquet(output)
    assert list(table.polarization) == [pair for pair in ("VV", "VH", "HV", "HH") for _ in range(6)]
    for pair, rows in table.groupby("polarization"):
        link = both.at(polarization=str(pair))
        np.testing.assert_array_equal(rows["sample"], np.arange(6))
        np.testing.assert_array_equal(np.stack([rows.tx, rows.carrier]), np.divmod(np.arange(6), 2))
        np.testing.assert_allclose(rows[["x_m", "y_m", "z_m"]], link.tx_position_m)
        np.testing.assert_allclose(np.stack([rows.carrier_hz, 1e9 * rows.carrier_ghz]), [link.carrier_hz] * 2)
        np.testing.assert_array_equal(rows.in_sight.astype(bool), link.tables["line_of_sight"][link.tx_index])
        sent_dbm = 23.0 if suffix == "csv" else 10.0
        np.testing.assert_allclose(rows.received_power_dbm, received_power_dbm(link, None if suffix == "csv" else 10.0))
        np.testing.assert_allclose(rows.received_power_dbm, rows.gain_db + sent_dbm)
        np.testing.assert_allclose(rows.local_mean_db, power_db(link, 1.0))
        known = statistics(link).links
        np.testing.assert_allclose(rows.distance_m, np.repeat(known.distance_m, 2))
        for name in ("num_paths", "k_factor_db", "departure_zenith_spread_deg", "arrival_azimuth_spread_deg"):
            np.testing.assert_allclose(rows[name], getattr(known, name).ravel(), err_msg=name)
        np.testing.assert_allclose(rows.delay_spread_ns, 1e9 * known.delay_spread_s.ravel())
    seen = table[(table.polarization == "VV") & (table.tx == 2)]
    friis_db = 20 * np.log10(SPEED_OF_LIGHT_M_S / (4 * np.pi * seen.carrier_hz * seen.distance_m))
    assert (abs(seen.local_mean_db - friis_db) < 1.5).all()  # in sight, beside a wall
    if suffix == "csv":
        by_numpy = np.genfromtxt(output, delimiter=",", names=True)
        np.testing.assert_array_equal(by_numpy["gain_db"], table.gain_db)


def test_a_table_without_paths_or_power_leaves_them_empty(data: PasDataset, plain: PasDataset, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"gives no transmit power\. Give it, as in received_power_dbm"):
        received_power_dbm(plain)
    told = xfreqbench("export", plain.path, "-o", tmp_path / "t.csv", "--to", "table")
    assert told.code == 0 and "has no paths, which local means" in told.stdout
    table = pandas.read_csv(tmp_path / "t.csv")
    spreads = [f"{end}_{angle}_spread_deg" for end in ("arrival", "departure") for angle in ("azimuth", "zenith")]
    known = ["receiver", "received_power_dbm", "local_mean_db", "num_paths", "k_factor_db", "delay_spread_ns"]
    assert table.columns[table.isna().all()].tolist() == [*known, *spreads]
    again = xfreqbench("export", data.path, "-o", tmp_path / "t.csv", "--to", "table")
    assert again.code == 2 and "t.csv exists and is not written over" in again.stderr


def test_the_command_says_what_it_needs(data: PasDataset, plain: PasDataset, tmp_path: Path) -> None:
    told = xfreqbench("export", data.path, "-o", tmp_path / "out", "--to", "deepmimo", "-q")
    assert told.code == 0
    for words, refusal in (
        (("--to", "sionna-npz", "--convention", "nerf2"), "leave out --convention"),
        (("--to", "sionna-npz", "--set", "plane=yz"), "--set changes a convention of maps"),
        (("--to", "deepmimo", "--power-dbm", "20"), "--power-dbm is for a table"),
        ((), "give --convention"),
    ):
        outcome = xfreqbench("export", data.path, "-o", tmp_path / "other", *words)
        assert (outcome.code, (tmp_path / "other").exists()) == (2, False)
        assert refusal in outcome.stderr
    outcome = xfreqbench("export", plain.path, "-o", tmp_path / "other", "--to", "deepmimo")
    assert "plain.h5 holds no paths. Generate it with --paths." in outcome.stderr
    outcome = xfreqbench("export", data.path, "-o", tmp_path / "out", "--to", "sionna-npz")
    assert "nothing is written over it" in outcome.stderr
