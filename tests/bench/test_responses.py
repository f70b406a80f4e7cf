"""Measured impulse responses: those of a scene's own paths are found again, and a measured flat has longer ones."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from xfreqbench.examples.make_uwb_flat import main, read_log, write_table

from tests.support.fuzzing.common import xfreqbench
from tests.support.places import MEASURED_RESPONSES
from tests.support.screened_room import SCENE as SCREENED
from xfreqbench.bench.responses import Responses, _compared, _statistics, bench_responses, read_responses
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import DataError, PlacementError
from xfreqbench.scene.model import Scene, Surface, load_scene
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.solvers import make_tracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import ignore_progress

SETTINGS = TraceSettings("image", rays=2000, max_depth=2)
RECEIVER_M = np.array([[1.0, 1.0, 2.5], [5.0, 4.2, 2.0]])


def responses(**changes: Any) -> Responses:
    """Two links in the screened room, of 4 responses with two taps, 1 ns apart, by a pulse of 500 MHz."""
    cir = np.zeros((2, 4, 60), np.complex128)
    cir[..., 10], cir[..., 30] = 1.0, 0.5j
    found = Responses(
        np.array([[6.0, 5.0, 1.2], [2.0, 2.0, 1.5]]),
        RECEIVER_M,
        cir,
        np.full(2, 10.0),
        np.array(["near", "far"]),
        np.array(["a", "b"]),
        1e-9,
        500e6,
        0.5,
    )
    return replace(found, **changes)


def raised_cosine(time: np.ndarray, roll_off: float) -> np.ndarray:
    """The pulse by its spectrum: flat, and a half cosine that falls from 1 to 0 about half the bandwidth."""
    f, known = np.linspace(-1, 1, 1001), np.linspace(0, 90, 3601)
    fall = np.clip((np.abs(f) - (1 - roll_off) / 2) / roll_off, 0, 1)
    spectrum = (1 + np.cos(np.pi * fall)) / 2
    values = np.cos(2 * np.pi * known[:, None] * f) @ spectrum * (f[1] - f[0])
    return np.asarray(np.interp(np.abs(time), known, values))


def test_two_taps_have_the_spread_and_the_ratios_of_their_powers() -> None:
    found = responses()
    spread_ns, k_db, first_db = _statistics(found, 0, found.cir[0], 1e-3)
    assert spread_ns == pytest.approx(20 * np.sqrt(0.8 * 0.2))  # of powers 1 and 1/4
    assert k_db == pytest.approx(10 * np.log10(4))
    assert first_db == 0
    late = replace(found, first_tap=np.full(2, 20.0))
    assert _statistics(late, 0, found.cir[0], 1e-3)[0] == 0  # what precedes the first path by more than a pulse is cut
    assert _statistics(found, 0, found.cir[0], 0.3)[0] == 0  # so is what is weaker than the level
    assert np.isnan(_statistics(found, 0, np.zeros((4, 60), complex), 1e-3)).all()


def test_responses_that_were_made_of_a_scenes_paths_are_those_of_its_paths(tmp_path: Path) -> None:
    """Up to the draw of phases; a shorter depth has shorter spreads."""
    rng = np.random.default_rng(5)
    tx_m = rng.uniform([0.4, 0.4, 0.9], [7.6, 5.6, 1.7], (12, 3))
    receiver_m, taps = RECEIVER_M[np.arange(12) % 2], np.arange(150)
    cir = []
    for ends in zip(tx_m, receiver_m, strict=True):
        both = []
        for polarization in ("V", "H"):
            element = replace(SCREENED.receiver, position_m=tuple(ends[1]), rows=1, cols=1, polarization=polarization)
            both.append(make_tracer(replace(SCREENED, receiver=element), [4], SETTINGS).paths(ends[0]))
        paths = Paths.joined(both)
        late_s = paths.delay_s - paths.delay_s[0]
        pulses = raised_cosine(((taps - 20.3) * 1e-9 - late_s[:, None]) * 500e6, 0.5)
        turned = paths.gain * np.exp(2j * np.pi * rng.random((16, *paths.gain.shape)))
        cir.append(3e-7 * turned.reshape(32, -1) @ pulses)
    made = {"tx_m": tx_m, "receiver_m": receiver_m, "cir": np.array(cir, np.complex64), "first_tap": np.full(12, 20.3)}
    made |= {"label": np.array(["LOS", "NLOS"] * 6), "name": np.arange(12).astype(str)}
    np.savez(tmp_path / "made.npz", tap_s=1e-9, bandwidth_hz=500e6, roll_off=0.5, **made)
    found, said = read_responses(tmp_path / "made.npz"), list[str]()
    bench_responses(
        Bench("measured", "x", said.append, tmp_path / "records"), SCREENED, found, [4e9], SETTINGS, 3, ignore_progress
    )
    rows = {line.split("|")[2].strip(): line for line in said if line.startswith("| all (12)")}
    spread_ns = {model: float(line.split("|")[3].split()[0]) for model, line in rows.items()}
    less_ns = {model: float(line.split("|")[4].split()[0]) for model, line in rows.items()}
    assert spread_ns["measured"] > 1
    assert abs(less_ns["traced, depth 2"]) < 0.2  # of medians of 32 draws
    assert less_ns["traced, depth 1"] < -0.3
    assert float(rows["traced, depth 2"].split("|")[5]) > 0.9
    assert {line.split("|")[1].strip() for line in said if line.startswith("| ")} >= {"LOS (6)", "NLOS (6)", "0", "11"}


def test_a_link_that_no_path_reaches_has_no_number(tmp_path: Path) -> None:
    wall = Surface("wall", "metal", 0.1, (4.0, -50.0, -50.0), (4.0, 50.0, 50.0))
    scene, said = Scene("wall", SCREENED.receiver, surface=(wall,)), list[str]()
    blocked = responses(tx_m=np.array([[6.0, 5.0, 1.2], [2.0, 2.0, 1.5]]), receiver_m=np.full((2, 3), 1.0))
    only = TraceSettings("image", ("specular",), rays=2000, max_depth=1)
    bench_responses(Bench("measured", "x", said.append), scene, blocked, [4e9], only, 3, ignore_progress)
    rows = [line.split("|")[1:4] for line in said if ("traced, depth 1 " in line and "[" in line) or "– | –" in line]
    assert [row[0].strip() for row in rows] == ["all (1)", "far (1)", "near (0)"]
    assert rows[2][2].strip() == "–"


def test_an_interval_is_of_cells_and_no_path_is_no_number() -> None:
    known = np.arange(40.0)
    model = known + np.repeat(np.random.default_rng(0).normal(1, 1, 4), 10)
    (*_, r), less = _compared(model, known, np.arange(40), 0), []
    for cell in (np.arange(40), np.arange(40) // 10):
        low, high = map(float, re.findall(r"[+-][\d.]+", _compared(model, known, cell, 0)[1])[1:])
        less.append(high - low)
    assert less[1] > 1.5 * less[0]
    assert float(r) > 0.98
    assert _compared(np.full(40, np.nan), known, np.arange(40), 0) == ("–", "–", "–")
    assert _compared(np.full(40, 2.0), known, np.arange(40), 0)[2] == "–"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cir": np.zeros((2, 4, 60), np.complex64)}, "a response of zeros"),
        ({"cir": np.ones((2, 4, 60))}, "holds 'cir' as <f8, where <c8 is needed"),
        ({"tx_m": np.zeros((2, 2))}, "holds 'tx_m' in shape .2, 2., where 2 × 3 is needed"),
        ({"receiver_m": np.zeros((3, 3))}, "where 2 × 3 is needed"),
        ({"first_tap": np.array([0.0, 60.0])}, "impossible"),
        ({"tap_s": -1e-9}, "impossible"),
        ({"roll_off": np.nan}, "not finite"),
        ({"label": None}, "is damaged or lacks an array.*data-format"),
    ],
)
def test_a_table_of_responses_that_cannot_be_used_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    arrays = vars(responses()) | {"cir": responses().cir.astype(np.complex64)} | changes
    np.savez(tmp_path / "made.npz", **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(DataError, match=message):
        read_responses(tmp_path / "made.npz")


def test_responses_of_another_place_and_a_height_for_them_are_refused(tmp_path: Path) -> None:
    far = responses(tx_m=np.full((2, 3), 500.0), receiver_m=np.full((2, 3), 490.0))
    with pytest.raises(PlacementError, match="outside of all surfaces"):
        bench_responses(Bench("measured", "x", print), SCREENED, far, [4e9], SETTINGS, 3, ignore_progress)
    np.savez(tmp_path / "made.npz", **vars(responses(cir=responses().cir.astype(np.complex64))))
    told = xfreqbench("bench", "measured", "flat", tmp_path / "made.npz", "--freqs", "4", "--height", "1.2")
    assert told.code != 0
    assert "--height has no meaning" in told.stderr


def test_logs_are_read_in_the_form_in_which_they_were_published(tmp_path: Path) -> None:
    head = (
        "File:x.log, created by DecaRanging\nRX OK WInd(0735), HLP(0047.3281), PSC(0296), FSL(-082.3)\nAccum Len 300\n"
    )
    taps = [f"{n}, {-n}" for n in range(300)]
    (tmp_path / "7.log").write_text(head + "\n".join(taps) + "\n\nTX Frame TimeStamp\n" + head + "\n".join(taps) + "\n")
    cir, first_tap = read_log(tmp_path / "7.log")
    assert cir.shape == (2, 230)
    np.testing.assert_array_equal(cir[0], np.arange(17, 247) * (1 - 1j))
    np.testing.assert_allclose(first_tap, 30.3281)
    for name, text in (
        ("anchors", "location,x,y\n2,1.5,2.5\n"),
        ("tags", "location,x,y\n3,4,5\n"),
        ("pairs", "file_number,anchor_location,tag_location\n7,2,3\n"),
        ("labels", "file_id,label\n7,LOS\n"),
    ):
        (tmp_path / f"{name}.csv").write_text(text)
    main([str(tmp_path), str(tmp_path / "made"), "--z", "1.1"])
    found = read_responses(tmp_path / "made" / "uwb_flat.npz")
    np.testing.assert_array_equal(found.tx_m, [[4, 5, 1.1]])
    np.testing.assert_array_equal(found.receiver_m, [[1.5, 2.5, 1.1]])
    assert (found.label.tolist(), found.name.tolist()) == (["LOS"], ["log 7"])


@pytest.mark.slow
def test_the_measured_flat_spreads_longer_than_its_walls_and_furniture_explain(tmp_path: Path) -> None:
    """Traced delay spreads are shorter by 3 to 4 ns, and go with the measured ones."""
    if not MEASURED_RESPONSES.is_dir():
        pytest.skip(f"the measured responses are not at {MEASURED_RESPONSES}")
    main([str(MEASURED_RESPONSES), str(tmp_path)])
    stored, path = np.load(MEASURED_RESPONSES / "cirs.npz"), tmp_path / "uwb_flat.npz"
    write_table(MEASURED_RESPONSES, path, stored["log"].tolist(), stored["cir"], stored["first_path_tap"], 1.2)
    scene, found, said = load_scene(str(tmp_path / "uwb_flat.toml")), read_responses(path), list[str]()
    settings = replace(SETTINGS, interactions=("specular", "refraction"), max_depth=3)
    bench_responses(Bench("measured", "x", said.append), scene, found, [3.9936e9], settings, 1, ignore_progress)
    cells = {line.split("|")[2].strip(): line.split("|") for line in said if line.startswith("| all (3")}
    assert float(cells["measured"][3].split()[0]) == pytest.approx(7.8, abs=0.1)
    assert float(cells["traced, depth 3"][4].split()[0]) == pytest.approx(-4.4, abs=0.6)
    assert float(cells["traced, depth 3"][5]) > 0.2
