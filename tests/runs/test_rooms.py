"""Runs on unseen rooms: one fit for all numbers heard, stored predictions, what is kept, and the tables of it."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from xfreqbench.baselines.line_of_sight import LineOfSight

from tests.support.rooms import tiny_rooms
from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.unseen_rooms import room_splits
from xfreqbench.errors import DataError, MethodError, ProtocolError, XFreqBenchError
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.check import check_method
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.rooms import PerRoom
from xfreqbench.methods.template import write_method_package
from xfreqbench.report.leaderboard.boards import short_commit
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.report.leaderboard.tables import leaderboard
from xfreqbench.report.leaderboard.unseen_rooms import room_tables, rooms_overview
from xfreqbench.runs import rooms as answers
from xfreqbench.runs import run as runner
from xfreqbench.runs.estimate import estimate_runs
from xfreqbench.runs.folder import ResultsFolder, read_records
from xfreqbench.runs.jobs import tasks_of
from xfreqbench.runs.options import RunOptions
from xfreqbench.runs.run import run

SMALL = ["queries=8", "headings=16", "distances=12"]


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    return tiny_rooms(tmp_path_factory.mktemp("rooms"), train=4, validation=1, test=1)


@pytest.fixture(scope="module")
def results(rooms: Collection, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    methods = {"line-of-sight": {}, "nearest": {}, "room-lags": SMALL}
    run(rooms, methods, "unseen-rooms", folder, budget="80steps")
    run(rooms, {"room-lags": [*SMALL, "trained_on=2"]}, "unseen-rooms", folder, budget="80steps")
    return folder


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_room_lags_finds_in_seconds_that_walls_mirror(results: Path) -> None:
    found = {
        (record.job.method, record.job.split): record
        for record in ResultsFolder(results).records
        if "trained_on=2" not in record.job.overrides
    }
    for number in (0, 4, 16, 64):
        learned, start = (
            found[name, f"heard-{number}"].scores["ssim"].median for name in ("room-lags", "line-of-sight")
        )
        assert learned > start + 0.02
    assert found["room-lags", "heard-64"].scores["ssim"].median > found["room-lags", "heard-0"].scores["ssim"].median
    assert found["nearest", "heard-0"].scores == found["line-of-sight", "heard-0"].scores  # nothing to copy


@pytest.mark.slow
def test_stored_sums_over_lags_are_scored_as_the_maps_that_were_predicted(results: Path, rooms: Collection) -> None:
    record = next(stored for stored in ResultsFolder(results).records if stored.job.method == "line-of-sight")
    question = next(room_splits(rooms, "unseen-rooms")[0].questions(rooms))
    asked, method = question.asked, LineOfSight()
    fit_within(method, question.heard, Budget(), 0)
    maps = method.predict(asked.tx_position_m, asked.carrier_hz)
    scores = np.ravel(record.ssim_by_tx[0])
    np.testing.assert_allclose(scores, ssim(maps, asked.pas(), asked.grid), atol=2e-4)  # records have four decimals
    assert ResultsFolder(results).predictions_path(record.id).stat().st_size < 250_000


def test_one_fit_serves_all_numbers_heard_and_finished_rooms_are_kept_but_damaged_ones(
    rooms: Collection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    adapted, adapt = [], PerRoom.adapt
    monkeypatch.setattr(PerRoom, "adapt", lambda *given: adapted.append(1) or adapt(*given))
    whole = run(rooms, "nearest", "unseen-rooms", tmp_path / "whole")
    for results, is_damaged in ((tmp_path / "kept", False), (tmp_path / "damaged", True)):
        adapted.clear()
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(runner, "write_answers", Mock(side_effect=KeyboardInterrupt))
            run(rooms, "nearest", "unseen-rooms", results)
        assert len(adapted) == 1
        (piece,) = results.glob("checkpoints/*/*.npz")
        if is_damaged:
            piece.write_bytes(piece.read_bytes()[:-100])
        records = run(rooms, "nearest", "unseen-rooms", results)
        assert len(adapted) == 4 + is_damaged  # of one room, of which four numbers are heard
        assert [record.scores for record in records] == [record.scores for record in whole]
        assert all(record.counts[answers.ROOM_SECONDS] > 0 for record in records)
        assert len([*(results / "methods").iterdir()]) == 1
        assert not [*(results / "checkpoints").iterdir()]


@pytest.mark.slow
def test_the_report_has_tables_by_number_heard_carrier_type_and_sight(results: Path) -> None:
    by_number, by_carrier, by_type, by_sight = read_results(results).benches
    learned = f"room-lags {' '.join(SMALL)}"
    of_method = {row[0]: row[2:] for row in by_number.rows}  # the best first
    assert [*of_method][2:] == ["line-of-sight", "nearest"] and {*of_method} >= {learned, f"{learned} trained_on=2"}
    skills = [float(row[by_number.columns.index("skill")]) for row in by_number.rows]
    assert skills == sorted(skills, reverse=True)
    assert all("[+0.0" in cell for cell in of_method[learned][:4])  # intervals above zero
    assert len(by_carrier.rows) == 12
    assert {row[2] for row in by_type.rows} == {"box"}
    assert {row[2] for row in by_sight.rows} == {"in sight"}  # nothing hides a transmitter in these rooms
    assert by_number.figure and {point.x for point in by_number.figure.points} == {0, 4, 16, 64}
    assert {row[-1] for row in by_number.rows} == {"–", "2", "4"}  # rooms learned from
    alone = room_tables([record for record in read_records(results) if record.job.method == "room-lags"])
    assert alone and not any(table.figure for table in alone)  # without a trivial predictor no skill is known
    (shown,) = rooms_overview(read_results(results).benches, "results/more.md")
    methods = [line.split("|")[1].strip() for line in shown.splitlines() if line.startswith("|")][2:]
    assert methods[0].startswith(learned) and methods[-1] == "line-of-sight" and len(methods) == 3  # one baseline
    assert "](results/figures/bench-" in shown


@pytest.mark.slow
def test_seeds_are_pooled_and_other_collections_and_commits_have_tables_and_names_of_their_own(results: Path) -> None:
    stored = read_records(results)
    again = [record.model_copy(update={"job": replace(record.job, seed=1)}) for record in stored]
    alone, pooled = (room_tables(records)[0] for records in (stored, [*stored, *again]))
    column = pooled.columns.index("seeds")
    assert {row[column] for row in alone.rows} == {"1"} and {row[column] for row in pooled.rows} == {"2"}
    assert [row[:column] for row in alone.rows] == [row[:column] for row in pooled.rows]  # the same twice
    job = {"protocol": "unseen-rooms-plan", "method": "plan-tracer", "overrides": ()}
    told = [record.model_copy(update={"job": replace(record.job, **job)}) for record in stored[-4:]]
    assert "| plan-tracer (told the plan)" in rooms_overview(room_tables([*told, *stored]), "results/more.md")[0]
    settings = stored[0].settings | {"rooms_trained_on": 1000}
    more = {"recipe": "data-0123456789", "settings": settings, "counts": stored[0].counts | {answers.NUM_ROOMS: 1000}}
    larger = [record.model_copy(update=more | {"git_commit": "0123456789"}) for record in stored[:-4]]
    first, *_, last = [table for table in room_tables([*stored, *larger]) if " · by " not in table.title]
    assert first.title.endswith(" · unseen-rooms · data-01234567") and first.title != last.title
    assert first.rows != last.rows and "1,000" in rooms_overview([first], "more.md")[0]
    (mixed, *_) = room_tables([*stored[:-1], stored[-1].model_copy(update={"git_commit": "0123456789"})])
    assert all(
        f" {commit} (" in mixed.note for commit in (short_commit(stored[0].git_commit), "0123456")
    )  # in the order of their hashes
    with pytest.raises(DataError, match="unseen rooms, which have no leaderboard"):
        leaderboard(stored)


def test_a_method_of_one_room_is_fitted_with_the_seed_asked_for(
    rooms: Collection, dataset: PasDataset, tmp_path: Path
) -> None:
    method = PerRoom("aperture-gs", ["num_gaussians=8"])
    list(method.fit(rooms, Budget(), 7))
    method.save(tmp_path)
    loaded = PerRoom.load(tmp_path)
    seeds = list[int]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xfreqbench.methods.rooms.fit_within", lambda *given: seeds.append(given[3]))
        loaded.adapt(dataset, Budget())
    assert (seeds, loaded.config) == ([7], method.config)


def test_what_rooms_have_no_choice_of_is_refused(rooms: Collection, tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match=r"has no target carrier to choose, but got \[2.4\]"):
        run(rooms, "nearest", "unseen-rooms", tmp_path, targets_ghz=[2.4])


def test_budgets_are_spent_in_each_room_or_once(rooms: Collection, tmp_path: Path) -> None:
    methods = [("xfreq-gs", ()), ("room-lags", ())]
    tasks = tasks_of(str(rooms.path), rooms, methods, RunOptions("unseen-rooms", budget="1m"))
    assert 5 * 60 < estimate_runs(tasks, tmp_path).seconds < 5.5 * 60  # one room is tested, with four numbers of places


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_methods_of_one_room_learn_from_what_is_heard_of_a_new_one(rooms: Collection, tmp_path: Path) -> None:
    methods = {"aperture-gs": ["num_gaussians=64"], "xfreq-gs": ["num_gaussians=64"], "virtual-source": []}
    records = run(rooms, methods, "unseen-rooms", tmp_path, budget="256maps")
    assert len(records) == 3 * 4  # at twelve samples too, of four transmitters at three carriers
    scores = {(record.job.method, record.job.split): record.scores["ssim"].median for record in records}
    assert all(scores[method, "heard-64"] != scores[method, "heard-0"] for method in methods)
    assert all(record.counts[answers.ROOM_SECONDS] > 0 for record in records)


@pytest.mark.slow
def test_a_method_that_learns_across_rooms_is_checked_and_asks_for_rooms(
    rooms: Collection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = ["rooms=1", "queries=4", "headings=8", "distances=4"]
    results = [*check_method("room-lags", small), *check_method("room-planes", [*small, "max_planes=1"])]
    assert not [str(result) for result in results if result.fault]
    written = write_method_package("my-rooms", tmp_path / "mine", rooms=True)
    assert not [path for path in written if re.search(r"soft|Soft|to copy and", path.read_text())]
    project = tomllib.loads((tmp_path / "mine" / "pyproject.toml").read_text())["project"]
    assert project["entry-points"] == {"xfreqbench.room_methods": {"my-rooms": "my_rooms:MyRooms"}}
    monkeypatch.syspath_prepend(tmp_path / "mine" / "src")
    assert not [str(result) for result in check_method("my_rooms:MyRooms") if result.fault]
    with pytest.raises(MethodError, match="learns across rooms"):
        run(rooms[0], "room-lags", "held-out-tx", tmp_path)
    with pytest.raises(XFreqBenchError, match="takes unseen-rooms"):
        run(rooms, "nearest", "lofo", tmp_path)
    with pytest.raises(XFreqBenchError, match="The plan is not told"):
        run(rooms, "plan-tracer", "unseen-rooms", tmp_path)
