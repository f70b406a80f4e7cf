"""Scenarios of DeepMIMO as data sets: what was exported comes back, and one by hand has the channel of its waves."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from tests.support.fuzzing.common import xfreqbench
from tests.support.plans import small_plan
from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.errors import DataError, OutputExistsError, UnknownNameError
from xfreqbench.exchange.deepmimo import export_deepmimo
from xfreqbench.exchange.deepmimo_import import import_deepmimo
from xfreqbench.units import SPEED_OF_LIGHT_M_S

STATION_M, USERS_M = np.array([0.0, 0.0, 3.0]), np.array([[4.0, 0.0, 1.0], [0.0, 9.0, 1.0], [1.0, -5.0, 1.0]])
CARRIER_HZ, FLOOR_GAIN = 3.5e9, 0.3 - 0.2j


def scenario_by_hand(folder: Path, suffix: str = ".npz") -> Path:
    """Users 0 and 2 hear the station, and user 0 its image in the floor z = 0 too; user 1 hears nothing."""
    keys = ("power", "phase", "delay", "aoa_az", "aoa_el", "aod_az", "aod_el", "inter")
    tables: dict[str, Any] = {key: np.full((3, 2), np.nan) for key in keys}
    tables["inter_pos"] = np.full((3, 2, 1, 3), np.nan)
    for user, place, image_m in ((0, 0, 1.0), (2, 0, 1.0), (0, 1, -1.0)):
        seen_m = USERS_M[user] * (1, 1, image_m)
        offset_m = seen_m - STATION_M
        length_m = float(np.linalg.norm(offset_m))
        gain = SPEED_OF_LIGHT_M_S / CARRIER_HZ / (4 * np.pi * length_m) * (FLOOR_GAIN if place else 1)
        gain *= np.exp(-2j * np.pi * CARRIER_HZ * length_m / SPEED_OF_LIGHT_M_S)
        x, y, z = offset_m / length_m
        azimuth_deg, zenith_deg = np.degrees(np.arctan2(y, x)), np.degrees(np.arccos(z))
        told = {"power": 20 * np.log10(abs(gain)), "phase": np.degrees(np.angle(gain)), "inter": place}
        told |= {"delay": length_m / SPEED_OF_LIGHT_M_S, "aod_az": azimuth_deg, "aod_el": zenith_deg}
        told |= {"aoa_az": azimuth_deg + 180, "aoa_el": zenith_deg if place else 180 - zenith_deg}
        for key, value in told.items():
            tables[key][user, place] = value
        if place:
            tables["inter_pos"][user, place, 0] = STATION_M + offset_m * 3 / 4  # from 3 m down to the floor
    tables |= {"tx_pos": STATION_M[None], "rx_pos": USERS_M}
    folder.mkdir(parents=True)
    for key, table in tables.items():
        path = folder / f"{key}_t001_tx000_r000{suffix}"
        np.savez(path, **{key: table}) if suffix == ".npz" else scipy.io.savemat(path, {key: table})
    sets = {"txrx_set_0": {"id": 0, "is_tx": False}, "txrx_set_1": {"id": 1, "is_tx": True}}
    told = {"rt_params": {"frequency": CARRIER_HZ, "raytracer_name": "by hand"}, "txrx_sets": sets}
    (folder / "params.json").write_text(json.dumps(told), encoding="utf-8")
    return folder


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_channels_are_those_of_the_waves_at_every_element(tmp_path: Path, suffix: str) -> None:
    import_deepmimo(scenario_by_hand(tmp_path / "city", suffix), tmp_path / "city.h5")
    data = open_dataset(tmp_path / "city.h5")
    verify(data.path)
    np.testing.assert_array_equal(data.tx_position_m, USERS_M[[0, 2]])
    assert data.header.rejected == {"without a path": 1}
    assert data.tables["line_of_sight"].all()
    wavelength_m = SPEED_OF_LIGHT_M_S / CARRIER_HZ
    element_m = data.header.receiver.element_position_m(wavelength_m)
    for row, user_m in enumerate(USERS_M[[0, 2]]):
        expected = np.zeros(16, complex)
        for image_m, gain in ((1, 1), (-1, FLOOR_GAIN))[: 2 - row]:
            source_m = user_m * (1, 1, image_m)
            at_centre_m = np.linalg.norm(source_m - STATION_M)
            length_m = np.linalg.norm(element_m - source_m, axis=1)
            wave = gain * wavelength_m / (4 * np.pi * at_centre_m)
            expected += wave * np.exp(-2j * np.pi * length_m / wavelength_m)
        np.testing.assert_allclose(data.cfr[row], expected, rtol=1e-5)
    paths = data.paths(0)
    assert paths.interactions.tolist() == [[0], [1]]
    np.testing.assert_allclose(paths.vertices_m[1, 0], [3.0, 0.0, 0.0], atol=1e-12)
    ahead_m = paths.vertices_m[1, 0] - USERS_M[0]
    np.testing.assert_allclose(paths.departure[1], ahead_m / np.linalg.norm(ahead_m), atol=1e-6)


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    plan = small_plan(num_transmitters=6, paths=True, maps=False)
    return open_dataset(generate_planned(plan, tmp_path_factory.mktemp("traced") / "rooms.h5"))


@pytest.fixture(scope="module")
def exported(traced: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported") / "scenarios"
    export_deepmimo(traced.path, folder)
    return folder


def rows_of(data: PasDataset, sample: int) -> np.ndarray:
    """Paths of a sample as rows of numbers, in an order that ties of delays do not change."""
    paths = data.paths(sample)
    points_m = np.nan_to_num(paths.vertices_m).reshape(len(paths), -1)
    shown = [paths.delay_s * SPEED_OF_LIGHT_M_S, paths.arrival, paths.departure, paths.interactions, points_m]
    rows = np.column_stack([*shown, 1e3 * paths.gain.real, 1e3 * paths.gain.imag])
    return rows[np.lexsort(rows.round(4).T)]


def test_what_was_exported_at_several_carriers_comes_back(traced: PasDataset, exported: Path, tmp_path: Path) -> None:
    assert import_deepmimo(exported, tmp_path / "back.h5")
    back = open_dataset(tmp_path / "back.h5")
    np.testing.assert_array_equal(back.carrier_hz, traced.carrier_hz)
    np.testing.assert_array_equal(back.tx_position_m, traced.tx_position_m)
    for sample in range(len(traced)):
        np.testing.assert_allclose(rows_of(back, sample), rows_of(traced, sample), atol=2e-6)  # float32
        by_paths = traced.paths(sample).impulse_response().cfr([0.0])[0]
        np.testing.assert_allclose(back.cfr[sample], by_paths, atol=1e-5 * np.abs(by_paths).max())
    assert not import_deepmimo(exported, tmp_path / "back.h5")  # it is there already
    with pytest.raises(OutputExistsError, match="holds another data set"):
        import_deepmimo(next(exported.iterdir()), tmp_path / "back.h5")


def change(key: str, spoil: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / f"{key}_t001_tx000_r000.npz"
        with np.load(path) as stored:
            table = stored[key]
        np.savez(path, **{key: spoil(table)})

    return apply


def retold(old: str, new: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        text = (folder / "params.json").read_text("utf-8")
        assert old in text
        (folder / "params.json").write_text(text.replace(old, new), "utf-8")

    return apply


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda folder: (folder / "params.json").unlink(), r"params\.json is missing"),
        (lambda folder: (folder / "params.json").write_text("{"), "is not that of a DeepMIMO v4 scenario"),
        (retold("3500000000.0", "1" * 400), r"rt_params\.frequency: Input should be less than"),
        (lambda folder: (folder / "delay_t001_tx000_r000.npz").unlink(), "has no delay_t001_tx000_r000.npz"),
        (lambda folder: (folder / "delay_t001_tx000_r000.npz").write_text("0"), r"r000\.npz is damaged"),
        (change("delay", lambda table: table[:2]), r"delay_t001_\w+\.npz .* in shape \(2, 2\), where 3 × 2 is needed"),
        (change("inter_pos", lambda table: table[..., 0]), r"inter_pos_t001_tx000_r000\.npz .* in shape"),
        (change("delay", lambda table: -table), "are not between 1e-12 and 1"),
        (change("phase", lambda table: table * np.nan), r"phase_t001_\w+\.npz has numbers that are not finite"),
        (change("rx_pos", lambda table: table + 1e9), r"rx_pos_t001_tx000_r000\.npz has positions beyond"),
        (change("inter", lambda table: table * 7), r"inter_t001_\w+\.npz has numbers other than digits 1 to 4"),
        (change("inter", lambda table: table * 11), r"inter_pos_t001_tx000_r000\.npz lacks points"),
        (change("inter_pos", lambda table: table * 1e9), r"inter_pos_t001_tx000_r000\.npz lacks points"),
        (change("aod_el", lambda table: table * 10), r"aod_el_t001_tx000_r000\.npz .* between -360 and 360"),
        (retold("3500000000.0", "3.5"), r"rt_params\.frequency: Input should be greater than or equal to 1000000"),
        (change("delay", lambda table: table * 1e6), "delay_t.* does not fit the lengths of 3 of 3 paths"),
        (change("delay", lambda table: table + 5e-8), "does not fit the lengths of 3 of 3 paths"),
        (change("power", lambda table: 10 ** (table / 10)), "are not between -600 and 0"),  # no dB
        (change("power", lambda table: table * np.nan), "has no path"),
        (change("power", lambda table: table + 30), r"power_t.*: 3 of 3 paths are over 20 dB stronger than a wave"),
        (change("inter", lambda table: (table * 21111111).astype("f4")), "from 16,777,216 on in float32, which rounds"),
        (change("inter", lambda table: (table * 2111).astype("f2")), "from 2,048 on in float16, which rounds"),
    ],
)
def test_nonsense_is_refused_by_name(tmp_path: Path, damage: Callable[[Path], None], told: str) -> None:
    damage(folder := scenario_by_hand(tmp_path / "city"))
    with pytest.raises(DataError, match=told):
        import_deepmimo(folder, tmp_path / "city.h5")
    assert not (tmp_path / "city.h5").exists()


def test_gains_of_antennas_and_codes_in_single_precision_are_read(tmp_path: Path) -> None:
    folder = scenario_by_hand(tmp_path / "city")
    change("power", lambda table: table + 15)(folder)
    change("inter", lambda table: table.astype("f4"))(folder)
    assert import_deepmimo(folder, tmp_path / "city.h5")


def from_horizon(*keys: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        for key in keys:
            change(key, lambda table: 90 - table)(folder)

    return apply


def test_elevations_from_the_horizon_are_converted_where_the_option_says_so(tmp_path: Path) -> None:
    folder, turned = scenario_by_hand(tmp_path / "city"), scenario_by_hand(tmp_path / "turned")
    from_horizon("aod_el", "aoa_el")(turned)
    words = ["import", turned, "--from", "deepmimo", "-o", tmp_path / "turned.h5", "-q"]
    refused = xfreqbench(*words)
    assert refused.code == 2
    assert "aod_el_t001_tx000_r000.npz, counted from the zenith, and aod_az" in refused.message
    assert "miss the next point of 3 of 3 paths; counted from the horizon they hit it" in refused.message
    assert xfreqbench(*words, "--elevations", "horizon").code == 0
    import_deepmimo(folder, tmp_path / "city.h5")
    as_told, right = (open_dataset(tmp_path / f"{name}.h5") for name in ("turned", "city"))
    np.testing.assert_allclose(as_told.cfr, right.cfr, rtol=1e-6)
    with pytest.raises(DataError, match="give --elevations zenith"):
        import_deepmimo(folder, tmp_path / "x.h5", elevations="horizon")


def without_the_line_of_sight(folder: Path) -> None:
    for key in ("power", "inter"):
        change(key, lambda table: np.where(np.arange(2) == 0, np.nan, table))(folder)


@pytest.mark.parametrize(
    "spoils",
    [
        [from_horizon("aoa_el")],
        [change("aod_az", lambda table: -table - 30)],  # clockwise, or from another axis
        [change("aoa_az", lambda table: table + 180)],  # the way that the wave goes
        [change("aod_el", np.radians), change("aod_az", np.radians)],
        [change("rx_pos", lambda table: table[:, [1, 0, 2]])],
        [without_the_line_of_sight, from_horizon("aoa_el")],
    ],
)
def test_angles_that_do_not_lead_along_the_paths_are_refused(
    tmp_path: Path, spoils: list[Callable[[Path], None]]
) -> None:
    folder = scenario_by_hand(tmp_path / "city")
    for spoil in spoils:
        spoil(folder)
    with pytest.raises(DataError, match=r"miss the next point of \d of \d paths; convert the scenario again"):
        import_deepmimo(folder, tmp_path / "city.h5")


def test_phases_in_radians_are_refused(tmp_path: Path) -> None:
    folder = scenario_by_hand(tmp_path / "city")
    for path in set(folder.glob("*.npz")) - set(folder.glob("?x_pos*")):  # every path twice: six phases
        change(path.name.partition("_t0")[0], lambda table: np.concatenate([table, table], axis=1))(folder)
    change("phase", np.radians)(folder)
    with pytest.raises(DataError, match="are radians; convert them to degrees"):
        import_deepmimo(folder, tmp_path / "city.h5")


def test_of_several_pairs_one_is_chosen_by_name(tmp_path: Path) -> None:
    folder = scenario_by_hand(tmp_path / "city")
    for path in list(folder.glob("*.npz")):
        shutil.copy(path, path.with_name(path.name.replace("tx000", "tx001")))
    with pytest.raises(DataError, match="pairs t001_tx000_r000, t001_tx001_r000; choose one with --pair"):
        import_deepmimo(folder, tmp_path / "city.h5")
    with pytest.raises(UnknownNameError, match="t001_tx001_r000"):
        import_deepmimo(folder, tmp_path / "city.h5", pair="t001_tx007_r000")
    told = xfreqbench("import", folder, "--from", "deepmimo", "-o", tmp_path / "city.h5", "--pair", "t001_tx001_r000")
    assert told.code == 0, told


def test_scenarios_of_other_users_are_not_joined(tmp_path: Path) -> None:
    scenario_by_hand(tmp_path / "both" / "first")
    second = scenario_by_hand(tmp_path / "both" / "second")
    with pytest.raises(DataError, match="two scenarios at the same carrier"):
        import_deepmimo(tmp_path / "both", tmp_path / "both.h5")
    retold("3500000000.0", "28e9")(second)
    assert import_deepmimo(tmp_path / "both", tmp_path / "both.h5")
    assert open_dataset(tmp_path / "both.h5").header.num_carriers == 2
    change("rx_pos", lambda table: table + 0.01)(second)
    with pytest.raises(DataError, match=r"are not those at 3\.5 GHz"):
        import_deepmimo(tmp_path / "both", tmp_path / "moved.h5")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--from", "deepmimo", "--freq", "3.5"], "--convention, --set and --freq are for PNG maps"),
        (["--from", "deepmimo", "--convention", "nerf2"], "--convention, --set and --freq are for PNG maps"),
        (["--pair", "t001_tx000_r000"], "give --from deepmimo too"),
        (["--elevations", "horizon"], "give --from deepmimo too"),
    ],
)
def test_options_of_the_other_layout_are_refused(tmp_path: Path, words: list[str], told: str) -> None:
    outcome = xfreqbench("import", tmp_path, "-o", tmp_path / "x.h5", *words)
    assert outcome.code == 2
    assert told in outcome.stderr
