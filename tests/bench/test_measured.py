"""Measurements beside scenes: a scene explains what was traced in it, and more of a measured flat than fitted laws."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.places import MEASURED_FLAT
from tests.support.screened_room import SCENE as SCREENED
from xfreqbench.bench import measured
from xfreqbench.bench.measured import Measurement, _scores, bench_measured, read_measurement
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import DataError, PlacementError, SceneError
from xfreqbench.scene.model import ReceiverArray, load_scene, parse_scene
from xfreqbench.tracing.solvers import make_tracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import ignore_progress

SETTINGS = TraceSettings("image", rays=2000, max_depth=2)
RECEIVERS = (
    ReceiverArray(position_m=(1.0, 1.0, 2.5), name="north"),
    ReceiverArray(position_m=(5.0, 4.2, 2.0), name="2"),
)


def rows_of(said: list[str]) -> dict[str, list[str]]:
    """The cells of each row that was printed, by the model's name."""
    cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in said if line.startswith("| ")]
    return {model: rest for model, *rest in cells}


def rmse_db(cell: str) -> float:
    return float(cell.split()[0])


def test_what_was_traced_in_a_scene_is_explained_by_it_up_to_an_offset(tmp_path: Path) -> None:
    scene = replace(SCREENED, receiver=RECEIVERS[0], other_receivers=RECEIVERS[1:])
    position_m = np.random.default_rng(2).uniform([0.4, 0.4, 0.9], [7.6, 5.6, 1.7], (31, 3))
    columns = [*position_m.T]
    for receiver, offset_db in zip(RECEIVERS, (-30.0, 12.5), strict=True):
        power = np.zeros(len(position_m))
        for polarization in ("V", "H"):
            element = replace(receiver, rows=1, cols=1, polarization=polarization)
            tracer = make_tracer(replace(scene, receiver=element, other_receivers=()), [2.4, 5], SETTINGS)
            paths = [tracer.paths(place_m) for place_m in position_m]
            power += [(np.abs(found.gain) ** 2).mean(axis=0).sum() for found in paths]
        columns.append(10 * np.log10(power) + offset_db)
    lines = [",".join(f"{value:.9g}" for value in row) for row in np.stack(columns, axis=1)]
    lines[7] = lines[7].rpartition(",")[0] + ","  # not measured
    (tmp_path / "measured.csv").write_text("\n".join(["x,y,z_m,north,rssi_2", *lines]))
    measurement = read_measurement(tmp_path / "measured.csv", scene.receivers, None)
    assert np.isnan(measurement.power_db).sum() == 1
    said, output = list[str](), tmp_path / "records.jsonl"
    bench = Bench("measured", "x", said.append, output)
    bench_measured(bench, scene, measurement, [2.4e9, 5e9], SETTINGS, 1, ignore_progress)
    rows = rows_of(said)
    assert rmse_db(rows["traced, depth 2"][0]) < 0.01
    assert rows["traced, depth 2"][-1] == "1.00"
    assert rmse_db(rows["traced, depth 1"][0]) > 0.1
    assert rmse_db(rows["free space"][0]) > rmse_db(rows["traced, depth 2, without diffraction"][0]) > 0.01
    assert output.is_file()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no position"),
        ("x,y,z,2\n1,2,3,4\n", "0 columns for receiver north; its columns are x, y, z, 2. Name one north"),
        ("x,y,north,2\n1,2,3,4\n", "not one each for x and y and z"),
        ("x,y,z,north,2,rssi_2\n1,2,3,4,5,6\n", "2 columns for receiver 2"),
        ("x,y,z,north,2\n1,2,3,4,loud\n", "line 2, has 'loud' in column 2, which is not a finite number"),
        ("x,y,z,north,2\n1,2,,4,5\n", "line 2, has '' in column z"),
        ("x,y,z,north,2\n" + "1,2,3,-40,\n" * 40, "fewer than 30 powers of receiver 2"),
        ("x,y,z,north,north\n1,2,3,4,5\n", "2 columns for receiver north"),
        ("x,x,y,z,north,2\n1,2,3,4,5,6\n", "not one each for x"),
        ("x,y,z,north,2\n1,0,2,0,3,0,4,5,5,5\n", "line 2, is '1,0,2,0,3,0,4,5,5,5', 10 cells for 5 columns"),
        ("x;y;z;north;2\n1,0;2,0;3,0;-40,5;-50,5\n", "line 2, has '1,0' in column x"),
        ("x,y,z,north,2\n1,2,3,-40,-50,x\n", "6 cells for 5 columns"),
        ("x,y,z,north,2\n1_5,2,3,-40,-50\n", "line 2, has '1_5' in column x"),
    ],
)
def test_a_measurement_that_cannot_be_used_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "measured.csv").write_text(text)
    with pytest.raises(DataError, match=re.escape(message)):
        read_measurement(tmp_path / "measured.csv", RECEIVERS, None)


def test_a_lone_receiver_has_no_name_in_what_is_said(tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text(table_of(["-40"] * 5))
    with pytest.raises(DataError, match=r"holds fewer than 30 powers\.$"):
        read_measurement(tmp_path / "measured.csv", (ReceiverArray(position_m=(1.0, 1.0, 2.5)),), None)


def table_of(power_db: list[str]) -> str:
    return "\n".join(["x,y,z,power", *(f"{n},2,1.2,{power}" for n, power in enumerate(power_db))])


@pytest.mark.parametrize("missing", ["-999", "100", "0", "-120"])
def test_a_number_that_stands_for_not_received_is_asked_about(tmp_path: Path, missing: str) -> None:
    """As data sets of fingerprints have it; one beyond every measured power is asked about where it occurs once."""
    measured = [f"{-40 - 1.5 * (n % 20)}" for n in range(60)]
    lone = (ReceiverArray(position_m=(1.0, 1.0, 2.5)),)
    path = tmp_path / "measured.csv"
    for absent in ("", "nan", "NaN", "-inf"):
        path.write_text(table_of([*measured, *[absent] * 5]))
        known = read_measurement(path, lone, None).power_db
        assert np.isnan(known).sum() == 5
        np.testing.assert_array_equal(known[:60, 0], np.array(measured, float))
    for number in (1, 2, 5):
        path.write_text(table_of([*measured, *[missing] * number]))
        if number > 2 or missing in ("-999", "100"):
            with pytest.raises(DataError, match=rf"column power, holds {number} times {missing} dB, .* cells empty"):
                read_measurement(path, lone, None)
        else:
            assert read_measurement(path, lone, None).power_db[60, 0] == float(missing)


def test_equal_powers_correlate_with_nothing() -> None:
    power_db, in_sight = np.full((6, 1), -40.0), np.ones((6, 1), bool)
    error_db = np.arange(6.0)[:, None]
    _, less, *_, r = _scores(error_db, error_db, power_db, in_sight, np.arange(6), 0)
    assert (less, r) == ("+0.00 [+0.00, +0.00]", "–")


def test_a_difference_of_models_that_fail_at_the_same_places_is_known_better_than_either() -> None:
    shared = np.random.default_rng(0).normal(0, 5, (400, 1)).cumsum(axis=0) / 20
    cell = np.arange(400) // 8
    rmse, less, *_ = _scores(shared + 0.5, shared, -shared, np.ones((400, 1), bool), cell, 0)
    low, high, least, most = (float(text.strip("[,]")) for cells in (rmse, less) for text in cells.split()[1:])
    assert most - least < 0.8 * (high - low)


def test_no_position_is_scored_in_a_cell_that_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    position_m = np.random.default_rng(2).uniform([0.4, 0.4, 0.9], [7.6, 5.6, 1.7], (300, 3))
    scored: list[np.ndarray] = []

    def noted(error_db, beside_db, power_db, in_sight, cell, seed):
        scored.append(np.isfinite(error_db[:, 0]))
        assert not {*cell[scored[-1]].tolist()} & {*cell[~scored[-1]].tolist()}
        return _scores(error_db, beside_db, power_db, in_sight, cell, seed)

    monkeypatch.setattr(measured, "_scores", noted)
    power_db = np.random.default_rng(3).normal(-60, 5, (300, 1))
    settings = TraceSettings("image", rays=2000, max_depth=1)
    bench = Bench("measured", "x", lambda _: None)
    bench_measured(bench, SCREENED, Measurement(position_m, power_db), [2.4e9], settings, 1, ignore_progress)
    assert 30 <= np.count_nonzero(~scored[0]) < 40


def test_positions_in_centimetres_are_refused_before_anything_is_traced() -> None:
    position_m = np.random.default_rng(2).uniform([40, 40, 90], [760, 560, 170], (60, 3))
    measurement = Measurement(position_m, np.full((60, 1), -40.0))
    with pytest.raises(PlacementError, match=r"Every measured position .* outside of all surfaces, .*in metres"):
        bench_measured(Bench("measured", "x", print), SCREENED, measurement, [2.4e9], SETTINGS, 1, ignore_progress)


@pytest.mark.slow
def test_the_measured_flat_is_explained_better_by_its_walls_than_by_fitted_laws() -> None:
    """The RMSE of one fingerprint: 6.71, 5.97 and 5.8 dB for free space, walls, and paths of three interactions."""
    if not MEASURED_FLAT.is_dir():
        pytest.skip(f"the measured flat is not at {MEASURED_FLAT}")
    scene, said = load_scene("flat"), list[str]()
    measurement = read_measurement(MEASURED_FLAT / "calibration_df.csv", scene.receivers, 1.3, every=10)
    settings = TraceSettings("image", rays=20_000, max_depth=3)
    bench_measured(Bench("measured", "x", said.append), scene, measurement, [2.44e9], settings, 1, ignore_progress)
    rows = rows_of(said)
    walls = next(cells for name, cells in rows.items() if name.startswith("multi-wall"))
    assert rmse_db(rows["free space"][0]) == pytest.approx(6.71, abs=0.5)
    assert rmse_db(rows["traced, depth 3"][0]) == pytest.approx(5.8, abs=0.4)
    assert rmse_db(rows["traced, depth 3"][0]) < rmse_db(walls[0]) < rmse_db(rows["free space"][0])


def test_a_scene_may_have_several_receivers_of_which_a_data_set_has_one() -> None:
    scene = load_scene("flat")
    assert [receiver.name for receiver in scene.receivers] == list("123456")
    assert scene.with_receiver("4").receivers == (scene.receivers[3],)
    assert scene.with_receiver() == scene.with_receiver("1")
    text = "[[receiver]]\nposition_m = [0, 0, 1]\n{0}\n[[receiver]]\nposition_m = [1, 0, 1]\n{1}\n"
    text = 'name = "two"\n' + text + "[transmitters]\nmin_m = [2, 2, 1]\nmax_m = [2, 2, 1]\nstep_m = [1, 1, 1]\n"
    assert len(parse_scene(text.format('name = "a"', 'name = "b"')).receivers) == 2
    for names, message in (
        (('name = "a"', ""), "each of several receivers needs"),
        (('name = "a"',) * 2, "two receivers are named 'a'"),
    ):
        with pytest.raises(SceneError, match=message):
            parse_scene(text.format(*names))
