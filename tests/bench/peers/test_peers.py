"""The bench of peers: its rooms, and solvers that find the same paths and channels in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from xfreqbench.bench.peers import run
from xfreqbench.bench.peers.differt import DiffeRTSolver
from xfreqbench.bench.peers.run import CARRIERS_HZ, Measured, PeerTask, differences_db, measured, missed
from xfreqbench.bench.peers.solvers import CONVERGED, SPECULAR_ALONE, OurSolver, PathSolver, panel_room, transmitters
from xfreqbench.bench.tables import Bench
from xfreqbench.errors import UnknownNameError, XFreqBenchError
from xfreqbench.runs.records import read
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.tracing.image.tracer import can_solve
from xfreqbench.tracing.tracer import TraceSettings

ORDER = 2


def test_a_room_has_as_many_triangles_as_asked_or_is_refused() -> None:
    for number in (12, 40):
        assert sum(len(mesh.triangles) for mesh in surface_meshes(panel_room(number))) == number
    for number in (10, 13):
        with pytest.raises(XFreqBenchError, match=f"but {number} are asked for"):
            panel_room(number)


def require_same_answers(theirs: type, **options) -> None:
    positions_m, room, single = transmitters(3), panel_room(16), panel_room(16, 1)
    ours = OurSolver(room, CARRIERS_HZ, ORDER)
    for position_m in positions_m:
        found_m = OurSolver(single, CARRIERS_HZ, ORDER).lengths_m(position_m)
        others_m = theirs(single, CARRIERS_HZ, ORDER, **options).lengths_m(position_m)
        assert len(found_m) == len(others_m) > 8
        assert missed(found_m, others_m, 1e-5) == (0, pytest.approx(0, abs=1e-5))
    channels = theirs(room, CARRIERS_HZ, ORDER, **options).channels(positions_m)
    assert differences_db(ours.channels(positions_m), channels).min() > 50  # of single precision and rays


@pytest.mark.slow
@pytest.mark.sionna
def test_path_solver_has_our_paths_and_channels() -> None:
    require_same_answers(PathSolver, batch=2, rays=50_000)


def test_differt_has_our_paths_and_channels() -> None:
    pytest.importorskip("differt", reason="the extra peers is not installed")
    require_same_answers(DiffeRTSolver, candidates="exhaustive")


def test_paths_are_paired_one_to_one() -> None:
    assert missed(np.array([1.0, 2.0, 2.0]), np.array([1.0, 2.0, 3.0]), 0.1) == (1, 0.0)
    assert missed(np.array([1.0]), np.array([1.05, 1.05]), 0.1) == (1, pytest.approx(0.05))
    assert missed(np.zeros(0), np.array([1.0]), 0.1) == (1, 0.0)


@pytest.mark.slow
def test_a_solver_is_timed_in_a_process_of_its_own() -> None:
    result = measured(PeerTask("image", 12, 1, num_tx=4, seconds=60.0))
    assert result is not None and result.channel.shape == (4, 16)
    assert [len(lengths) for lengths in result.lengths_m] == [7, 7, 7]  # the line of sight, and six walls
    assert result.tx_s > 0 and result.setup_s > 0


Asked = Callable[[Callable[[PeerTask], float | None]], list[PeerTask]]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench("peers", "xfreqbench bench peers", lambda line: None, tmp_path / "records.jsonl")


@pytest.fixture
def pretend(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """Makes every task take the seconds a transmitter that a function says, or stop; the list of what was asked."""

    def of(seconds: Callable[[PeerTask], float | None]) -> list[PeerTask]:
        asked: list[PeerTask] = []

        def measured(task: PeerTask) -> Measured | None:
            asked.append(task)
            tx_s = seconds(task)
            return None if tx_s is None else Measured(1.0, tx_s, 100.0, np.ones((1, 16), complex), [np.ones(3)])

        monkeypatch.setattr(run, "measured", measured)
        return asked

    return of


def test_a_solver_that_takes_too_long_is_stopped_and_not_asked_for_more(pretend: Asked, bench: Bench) -> None:
    assert measured(PeerTask("image", 12, 1, num_tx=4, seconds=60.0, limit_s=0.0)) is None
    asked = pretend(lambda task: None if task.solver == "sionna" and task.order == 2 else 1e-3)
    run.bench_peers(bench, ["sionna", "PathSolver"], [3, 1, 2], 1.0, 7.0)
    _, times, _ = read(bench.output).benches
    assert [row[:2] for row in times.rows if row[1] == "sionna"] == [("1", "sionna")]
    assert "Stopped after 7 s" in times.note and "`sionna` with 2" in times.note
    assert {task.order for task in asked if task.solver == "sionna" and task.num_triangles == 40} == {1, 2, 3}


def test_what_is_measured_stays_where_the_converged_solution_is_stopped(pretend: Asked, bench: Bench) -> None:
    pretend(lambda task: None if (task.solver == CONVERGED and task.order > 1) or task.num_tx > 1000 else 1e-3)
    run.bench_peers(bench, ["PathSolver"], [1, 2, 3], 1.0, 7.0)
    _, times, growth = read(bench.output).benches
    assert [row[:2] for row in times.rows] == [("1", "image"), ("1", "PathSolver")]
    assert "`image, converged` with 2" in times.note
    (stopped,) = [row for row in growth.rows if "over" in row[3]]
    assert stopped[:4] == ("transmitters", "image", "10,000", "over 7 in all")


def test_growth_is_told_with_its_exponent_for_numbers_that_the_solvers_take(pretend: Asked, bench: Bench) -> None:
    asked = pretend(lambda task: 1e-6 * task.num_triangles**2)
    run._tabulate_growth(bench, 1.0, 2.0)
    (record,) = read(bench.output).benches
    assert record.figure is not None
    series = {point.series for point in record.figure.points}
    assert {"triangles, image", "transmitters, image"} < series
    assert {row[:2] + row[6:7] for row in record.rows} >= {
        ("triangles", "image", "2.00"),
        ("transmitters", "image", "1.00"),
    }
    assert len(record.rows) == len(asked) == len(record.figure.points)
    most = max(task.num_triangles for task in asked if task.solver == "image")
    settings = TraceSettings(solver="image", interactions=SPECULAR_ALONE, max_depth=3)
    assert can_solve(Geometry(surface_meshes(panel_room(most))), settings)


def test_what_is_missing_or_unknown_is_told_before_anything_is_timed(
    monkeypatch: pytest.MonkeyPatch, bench: Bench
) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'PathSolver'"):
        run.bench_peers(bench, ["PathSolvr"], [1], 1.0, 1.0)
    for seconds, limit_s in ((0.0, 1.0), (1.0, -1.0), (float("nan"), 1.0)):
        with pytest.raises(XFreqBenchError, match="are seconds above 0"):
            run.bench_peers(bench, ["PathSolver"], [1], seconds, limit_s)
    monkeypatch.setattr("xfreqbench.bench.peers.differt.find_spec", lambda name: None)
    with pytest.raises(XFreqBenchError, match=r'needs the extra "peers".*pip install'):
        run.bench_peers(bench, ["DiffeRT-hybrid"], [1], 1.0, 1.0)
