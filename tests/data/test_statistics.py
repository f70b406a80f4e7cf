"""Statistics of channels: closed forms of two paths, the standards as others tabulate them, and whole data sets."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tr3gpp.tr38901
from numpy.typing import NDArray

from tests.support.plans import CARRIERS_HZ, small_plan
from xfreqbench.cli.data import info, plot
from xfreqbench.data.dataset import PasDataset, isolated, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.power import power_db
from xfreqbench.data.statistics import MECHANISMS, of_paths, of_standards, statistics
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.exchange.deepmimo import export_deepmimo
from xfreqbench.exchange.deepmimo_import import import_deepmimo
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import ConstantMaterial
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.absorption import slab_absorption
from xfreqbench.tracing.paths import DIFFRACTION, DIFFUSE, REFRACTION, SPECULAR, RaggedPaths
from xfreqbench.units import SPEED_OF_LIGHT_M_S


def ragged(num_paths: list[int], power: list[float], **changes: object) -> RaggedPaths:
    """Paths at one carrier, which are direct, arrive at once and from one direction, but for what is given."""
    angles = ("arrival_azimuth_rad", "arrival_elevation_rad", "departure_azimuth_rad", "departure_elevation_rad")
    values = {name: np.zeros(len(power), np.float32) for name in angles}
    interaction = np.asarray(changes.pop("interaction", []), np.uint8)
    return RaggedPaths(
        num_paths=np.array(num_paths),
        gain=np.sqrt(np.array(power))[:, None].astype(np.complex64),
        interaction=interaction,
        surface=np.zeros(len(interaction), np.int32),
        vertex_m=np.zeros((len(interaction), 3), np.float32),
        **{"delay_s": np.zeros(len(power)), "num_interactions": np.zeros(len(power), np.int64), **values, **changes},  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    plan = small_plan(maps=False, paths=True)
    return open_dataset(generate_planned(plan, tmp_path_factory.mktemp("statistics") / "rooms.h5"))


def test_two_paths_have_the_spreads_and_k_of_their_closed_forms() -> None:
    share = np.array([0.8, 0.2])
    paths = ragged(
        [2],
        [0.8e-6, 0.2e-6],
        delay_s=np.array([10e-9, 40e-9]),
        arrival_azimuth_rad=np.array([3.1, -3.1], np.float32),  # across the end of the range
        departure_elevation_rad=np.array([0.2, 1.2], np.float32),
        num_interactions=np.array([0, 1]),
        interaction=[SPECULAR],
    )
    found = of_paths(paths, 0)
    assert found["path_loss_db"][0] == pytest.approx(60)
    assert found["delay_spread_s"][0] == pytest.approx(30e-9 * np.sqrt(share.prod()), rel=1e-6)
    for name, apart_rad in (("arrival_azimuth", 2 * np.pi - 6.2), ("departure_zenith", 1.0)):
        length = np.sqrt(1 - 2 * share.prod() * (1 - np.cos(apart_rad)))
        assert found[f"{name}_spread_deg"][0] == pytest.approx(np.degrees(np.sqrt(-2 * np.log(length))), rel=1e-5)
    assert found["arrival_zenith_spread_deg"][0] == pytest.approx(0)
    assert found["k_factor_db"][0] == pytest.approx(10 * np.log10(4), abs=1e-5)
    np.testing.assert_allclose(found["power_share"][0], [0.8, 0.2, 0, 0, 0], rtol=1e-6)


def test_k_of_a_cluster_counts_what_a_sounder_takes_for_the_direct_path() -> None:
    """A reflection 2 ns later is in the first cluster, one 30 ns later is not; without a direct path there is none."""
    met = {"num_interactions": np.array([0, 1, 1, 1]), "interaction": [SPECULAR] * 3}
    paths = ragged([3, 1], [0.8, 0.15, 0.05, 1.0], delay_s=np.array([10, 12, 40, 10]) * 1e-9, **met)
    found = of_paths(paths, 0)
    assert found["k_factor_db"][0] == pytest.approx(10 * np.log10(0.8 / 0.2), abs=1e-5)
    assert found["k_factor_cluster_db"][0] == pytest.approx(10 * np.log10(0.95 / 0.05), abs=1e-4)
    assert np.isnan(found["k_factor_cluster_db"][1])


def test_mmmagic_says_nothing_below_six_gigahertz() -> None:
    low, high = (of_standards(np.array([3.0]), carrier, True) for carrier in (2.4e9, 24.25e9))
    of_mmmagic = [name for name in high if "mmmagic" in name and np.isfinite(high[name])]
    assert len(of_mmmagic) == 4 and all(np.isnan(low[name]) for name in of_mmmagic)
    # Table 4.2 of D2.2, as the configuration files of QuaDRiGa have it in log10(f)
    assert high["arrival_azimuth_spread_mmmagic_deg"] == pytest.approx(
        10 ** (1.888 - 0.1438 * np.log10(24.25)), rel=0.01
    )
    assert high["departure_azimuth_spread_mmmagic_deg"] == pytest.approx(
        10 ** (2.0711 - 0.2302 * np.log10(24.25)), rel=0.01
    )
    assert high["k_factor_cluster_mmmagic_db"] == pytest.approx(5.3218 + 4.7808 * np.log10(24.25), abs=0.1)


def test_the_scatter_is_printed_beside_the_median(rooms: PasDataset) -> None:
    found = statistics(rooms)
    (row,) = [row for row in found.rows if row["in_sight"]][:1]
    of_links = found.links.delay_spread_s[found.links.in_sight, 0] * 1e9
    assert row["delay_spread_sd_ns"] == pytest.approx(np.std(of_links[np.isfinite(of_links)]))
    assert f"{row['delay_spread_ns']:.1f} ± {row['delay_spread_sd_ns']:.1f}" in str(found)


def test_weak_paths_count_for_the_power_alone_and_silence_has_no_statistics() -> None:
    weak = 10**-2.6  # below the window of 25 dB
    paths = ragged([2, 0, 1], [1.0, weak, 1.0], delay_s=np.array([0, 1e-6, 0]))
    assert of_paths(paths, 0, window_db=27)["delay_spread_s"][0] == pytest.approx(1e-6 * np.sqrt(weak) / (1 + weak))
    found = of_paths(paths, 0)
    assert found["path_loss_db"][0] == pytest.approx(-10 * np.log10(1 + weak), rel=1e-6)
    assert found["delay_spread_s"][0] == 0
    assert found["num_paths"].tolist()[::2] == [1, 1]
    assert all(np.isnan(values[1]).all() for values in found.values())
    assert np.isnan(found["k_factor_db"]).all()  # no other path than the direct one


def test_diffuse_paths_count_together_however_many_they_are() -> None:
    """A tile of 18 dB below the direct path, and 100 of a hundredth of its power each."""

    def statistics(number: int) -> dict[str, NDArray[np.float64]]:
        delay_s = np.array([10e-9, *[30.2e-9] * number, 60e-9])
        power = [1.0, *[10**-1.8 / number] * number, 10**-2.7]
        num_interactions = np.array([0] + [1] * (number + 1))
        met = {"num_interactions": num_interactions, "interaction": [DIFFUSE] * (number + 1)}
        return of_paths(ragged([number + 2], power, delay_s=delay_s, **met), 0)

    one, many = statistics(1), statistics(100)
    assert one["delay_spread_s"][0] == pytest.approx(20.2e-9 * np.sqrt(10**-1.8) / (1 + 10**-1.8), rel=1e-3)
    for name in ("delay_spread_s", "k_factor_db", "arrival_azimuth_spread_deg"):
        assert many[name][0] == pytest.approx(one[name][0], rel=1e-5)


def test_a_path_has_one_mechanism_and_their_shares_sum_to_one() -> None:
    met = [[], [SPECULAR], [SPECULAR, REFRACTION], [REFRACTION, DIFFRACTION], [DIFFRACTION, DIFFUSE]]
    power, counts = [5.0, 4.0, 3.0, 2.0, 1.0], np.array([*map(len, met)])
    paths = ragged([5], power, num_interactions=counts, interaction=[code for codes in met for code in codes])
    share = of_paths(paths, 0)["power_share"][0]
    np.testing.assert_allclose(share, np.array(power) / 15, rtol=1e-6)
    assert len(share) == len(MECHANISMS)


@pytest.mark.parametrize("in_sight", [True, False])
def test_the_table_of_38901_is_that_of_tr3gpp(in_sight: bool) -> None:
    condition = "LOS" if in_sight else "NLOS"
    section = tr3gpp.tr38901.section("7.5")
    theirs = section.channel_model_parameters(scenario="Indoor-Office", condition=condition)
    zenith = section.zsd_zod_offset(scenario="Indoor-Office", condition=condition)
    distance_m = np.array([1.0, 7.0, 60.0])
    known, low, lower = (of_standards(distance_m, carrier, in_sight) for carrier in (24.25e9, 6e9, 1e9))
    for name, ours in {
        "lgDS": "delay_spread_38901_s",
        "lgASD": "arrival_azimuth_spread_38901_deg",  # their downlink leaves the array
        "lgASA": "departure_azimuth_spread_38901_deg",
        "lgZSD": "arrival_zenith_spread_38901_deg",
        "lgZSA": "departure_zenith_spread_38901_deg",
    }.items():
        text = str(getattr(zenith if name == "lgZSD" else theirs, f"mu_{name}"))
        slope = re.search(r"(-?[\d.]+) log10\(1\+ ?fc\)", text)
        constant = re.search(r"([-+]? ?[\d.]+)$", text)
        assert constant
        a, b = float(constant[1].replace(" ", "")), float(slope[1]) if slope else 0.0
        assert known[ours] == pytest.approx(10 ** (a + b * np.log10(25.25)))
        assert lower[ours] == low[ours]
    if in_sight:
        assert float(theirs.mu_K) == known["k_factor_cluster_38901_db"]
    modelled = _evaluated("LOS", distance_m, 24.25)
    if not in_sight:
        modelled = np.maximum(modelled, _evaluated("NLOS", distance_m, 24.25))
    np.testing.assert_allclose(known["path_loss_38901_db"], modelled)


def _evaluated(condition: str, d: NDArray[np.float64], f: float) -> NDArray[np.float64]:
    """The last formula of a row of Table 7.4.1-1, at distances in metres and a carrier in GHz."""
    formula = tr3gpp.tr38901.section("7.4").pathloss(scenario="InH-Office", condition=condition).formula
    python = re.sub(r"\\log_\{10\}\((\w)_[^)]*\)", r"*np.log10(\1)", formula.rpartition("=")[2])
    return np.asarray(eval(python, {"np": np, "d": d, "f": f}))


def test_free_space_has_the_path_loss_of_friis_and_nothing_but_the_direct_path(tmp_path: Path) -> None:
    plan = small_plan("empty", num_transmitters=6, maps=False, paths=True)
    found = statistics(open_dataset(generate_planned(plan, tmp_path / "empty.h5")))
    rows = found.rows
    assert [row["in_sight"] for row in rows] == [True] * len(plan.header.carrier_hz)
    for place, row in enumerate(rows):
        friis_db = 20 * np.log10(4 * np.pi * found.links.distance_m * row["carrier_ghz"] * 1e9 / SPEED_OF_LIGHT_M_S)
        np.testing.assert_allclose(found.links.path_loss_db[:, place], friis_db, atol=1e-4)
        assert (row["share_direct"], row["delay_spread_ns"], row["num_paths"]) == (1, 0, 1)
        assert np.isnan(row["k_factor_db"])


@pytest.mark.slow
@pytest.mark.parametrize("radius_wavelengths", [0.3, 1.0])
def test_the_local_mean_is_the_mean_power_of_transmitters_on_the_disc(
    tmp_path: Path, radius_wavelengths: float
) -> None:
    rooms = load_scene("two_rooms")
    one_element = replace(rooms, receiver=replace(rooms.receiver, rows=1, cols=1), transmitters=None)
    number = np.arange(600)  # a spiral that fills the disc evenly
    turn, radius = number * np.pi * (3 - np.sqrt(5)), np.sqrt((number + 0.5) / len(number))
    radius_m = radius_wavelengths * SPEED_OF_LIGHT_M_S / CARRIERS_HZ[1] * radius[:, None]
    spiral_m = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) * radius_m
    at_m = np.array([1.0, 2.0, 1.2]) + np.vstack([np.zeros(3), spiral_m])
    plan = small_plan(one_element, None, tx_positions=at_m, maps=False, paths=True)
    dataset = open_dataset(generate_planned(plan, tmp_path / "disc.h5"))
    dataset = dataset[dataset.carrier_hz == CARRIERS_HZ[1]]
    mean_db = 10 * np.log10(np.mean(10 ** (power_db(dataset)[1:] / 10)))
    assert power_db(dataset[:1], radius_wavelengths) == pytest.approx(mean_db, abs=0.05)
    assert abs(power_db(dataset)[0] - mean_db) > 0.3
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xfreqbench.tracing.paths._BLOCK_PATHS", 2)  # of several times as many
        np.testing.assert_allclose(power_db(dataset[:1], radius_wavelengths), mean_db, atol=0.05)
    assert power_db(dataset, math.inf) == pytest.approx(-statistics(dataset).links.path_loss_db[:, 0])


def test_traced_again_the_statistics_are_those_of_the_stored_paths(rooms: PasDataset, tmp_path: Path) -> None:
    plain = open_dataset(generate_planned(small_plan(maps=False), tmp_path / "plain.h5"))
    stored, again = map(statistics, (rooms, plain))
    assert "stored" in stored.source
    assert "traced again" in again.source
    for one, other in zip(stored.rows, again.rows, strict=True):
        assert one == pytest.approx(other, rel=1e-5, nan_ok=True)
    assert len(statistics(plain, num_tx=2).links.tx_index) == 2


def test_a_subset_has_statistics_of_its_own_samples(rooms: PasDataset) -> None:
    last = rooms.header.num_carriers - 1
    own = statistics(rooms[rooms.carrier_hz == rooms.header.carrier_hz[last]])
    assert {row["carrier_ghz"] for row in own.rows} == {rooms.header.carrier_hz[last] / 1e9}
    np.testing.assert_array_equal(own.links.path_loss_db[:, 0], statistics(rooms).links.path_loss_db[:, last])
    assert statistics(rooms[[0]]).links.tx_index.tolist() == [0]
    with pytest.raises(DataError, match="given to methods without its paths"):
        statistics(isolated(rooms))


def test_data_of_others_have_statistics_without_a_room(rooms: PasDataset, tmp_path: Path) -> None:
    export_deepmimo(rooms.path, tmp_path / "scenarios")
    import_deepmimo(tmp_path / "scenarios", tmp_path / "imported.h5")
    own, theirs = statistics(rooms), statistics(open_dataset(tmp_path / "imported.h5"))
    assert np.isnan(theirs.volume_m3)
    assert "about the surfaces" in str(own)
    assert "about the surfaces" not in str(theirs)
    np.testing.assert_allclose(theirs.links.path_loss_db, own.links.path_loss_db, atol=1e-3)
    np.testing.assert_allclose(theirs.links.delay_spread_s, own.links.delay_spread_s, rtol=1e-3, atol=1e-13)


def test_metal_takes_no_diffuse_power_and_air_all_of_it() -> None:
    assert slab_absorption(Slab("metal", 0.01), 10e9) == pytest.approx(0, abs=2e-3)
    assert slab_absorption(Slab(ConstantMaterial("air", 1, 0), 0.1), 10e9) == pytest.approx(1)
    thick = slab_absorption(Slab(ConstantMaterial("lossy", 4, 1), 1.0), 10e9)  # a half-space, by Fresnel alone
    cosine = (np.arange(4000) + 0.5) / 4000
    eta = 4 - 1j / (2 * np.pi * 10e9 * 8.8541878128e-12)
    inside = np.sqrt(eta - 1 + cosine**2)
    te = (cosine - inside) / (cosine + inside)
    tm = (eta * cosine - inside) / (eta * cosine + inside)
    assert thick == pytest.approx(1 - np.mean((abs(te) ** 2 + abs(tm) ** 2) * cosine), abs=1e-5)


def test_the_commands_print_and_draw_them(
    rooms: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    info(rooms.path, statistics=True)
    printed = capsys.readouterr().out
    assert "over 38.901" in printed
    assert printed.count("in sight ") >= 2
    plot(rooms.path, output=tmp_path / "statistics.svg", of="statistics")
    assert "power by mechanism" in (tmp_path / "statistics.svg").read_text()
    with pytest.raises(XFreqBenchError, match="--of statistics shows all carriers"):
        plot(rooms.path, output=tmp_path / "other.svg", of="statistics", carriers="2.4")
