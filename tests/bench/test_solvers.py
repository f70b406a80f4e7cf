from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import pytest

from tests.support.fuzzing.common import xfreqbench
from xfreqbench.bench import solvers as convergence
from xfreqbench.bench.reference import read_reference
from xfreqbench.bench.solvers import MapError, MeasuredSetting, PipelineCost, Rung, ladder
from xfreqbench.bench.tables import Bench
from xfreqbench.runs.records import read
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.tracer import Interaction, TraceSettings


def row(label: str, sample_ms: float, *median_db: float) -> MeasuredSetting:
    return MeasuredSetting(
        label, 0.1, sample_ms, [MapError(median, median - 10, 0.99) for median in median_db]
    )


def test_the_ladder_varies_rays_depth_and_interactions_of_both_solvers() -> None:
    rungs = list(ladder(["image", "sionna"]))
    counts = Counter((rung.solver, varied) for rung in rungs for varied in rung.varied)
    for solver in ("image", "sionna"):
        assert all(counts[solver, varied] >= 3 for varied in ("depth", "rays", "interactions"))
    assert len({rung.settings for rung in rungs}) == len(rungs)
    assert any("diffraction" in rung.settings.interactions for rung in rungs)
    assert {rung.solver for rung in ladder(["image"])} == {"image"}


def test_a_rung_changes_what_it_says_and_nothing_else() -> None:
    for rung in ladder(["image", "sionna"]):
        defaults = TraceSettings(rung.solver)
        changed = {
            "depth": rung.settings.max_depth != defaults.max_depth,
            "rays": rung.settings.rays != defaults.rays,
            "interactions": rung.settings.interactions != defaults.interactions,
        }
        if rung.label == "defaults":
            assert not any(changed.values())
        else:
            assert {name for name, has_changed in changed.items() if has_changed} >= set(rung.varied)
            others = {name for name, has_changed in changed.items() if has_changed} - set(rung.varied)
            assert all(f"{rung.settings.rays:,} rays" in rung.label for name in others)


def test_a_point_stands_at_the_carrier_where_the_error_is_worst() -> None:
    point = row("image, defaults", 3.5, 60, 45, 50).point("image, depth", "defaults")
    assert (point.x, point.y, point.series, point.label) == (3.5, 45, "image, depth", "defaults")


def test_the_bar_is_met_at_every_carrier_or_not_at_all() -> None:
    assert row("", 1, 45, 41).cells[-1] == "met"
    assert row("", 1, 45, 39).cells[-1] == "missed"
    assert row("", 1, 45, 41).cells[:3] == ("", "0.10", "1.00")


def test_the_table_of_settings_is_recorded_with_its_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rungs = [
        Rung("image", "depth 1", ("depth",), TraceSettings("image", max_depth=1, rays=1000)),
        Rung("image", "depth 2", ("depth", "rays"), TraceSettings("image", max_depth=2, rays=1000)),
    ]
    monkeypatch.setattr(convergence, "ladder", lambda solvers: iter(rungs))
    said: list[str] = []
    output = tmp_path / "records.jsonl"
    convergence.bench_generate(Bench("generate", "command", said.append, output), "office", ["image"])
    (record,) = read(output).benches
    assert record.columns == ("setting", "rays once, s", "ms a sample", "1 GHz", "10 GHz", "94 GHz", "bar")
    assert [cells[0] for cells in record.rows] == ["image, depth 1", "image, depth 2"]
    assert all(f"| {' | '.join(cells)} |" in said for cells in record.rows)
    assert record.figure is not None
    series = [(point.series, point.label) for point in record.figure.points]
    assert series == [("image, depth", "depth 1"), ("image, depth", "depth 2"), ("image, rays", "depth 2")]
    for cells, point in zip(record.rows, record.figure.points, strict=False):
        assert float(cells[2]) == pytest.approx(point.x, abs=0.006)  # shown to a hundredth
        medians = [float(cell.partition(" / ")[0]) for cell in cells[3:6]]
        assert min(medians) == pytest.approx(point.y, abs=0.51)  # shown without decimals
    assert record.figure.points[0].y < record.figure.points[1].y  # the office needs depth
    assert "llvmlite" in record.software


@pytest.mark.parametrize(
    ("interactions", "channel_s", "num_left"), [(("specular",), 4.0, 0), (("diffraction",), 5.0, 1)]
)
def test_a_rungs_times_are_the_least_of_warm_runs_but_where_they_are_dear(
    interactions: tuple[Interaction, ...], channel_s: float, num_left: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    office = load_scene("office")
    reference = read_reference(office)
    times = iter([(9.0, 9.0), (2.0, 5.0), (3.0, 4.0)])  # the first run compiles
    monkeypatch.setattr(convergence, "resolve_solver", lambda meshes, settings: settings)
    monkeypatch.setattr(convergence, "map_errors", lambda scene, cfr, truth: [])
    monkeypatch.setattr(convergence, "_traced", lambda *asked: (*next(times), reference.cfr))
    settings = TraceSettings("sionna", interactions)
    found = convergence.measure(office, settings, reference, "a rung")
    num_samples = reference.cfr.shape[0] * reference.cfr.shape[1]
    assert (found.shoot_s, found.sample_ms) == (2.0, channel_s / num_samples * 1e3)
    assert len(list(times)) == num_left


def test_pipelines_are_compared_with_the_plain_way_and_the_cheapest_that_meets_the_bar() -> None:
    plain = [row(f"plain {index}", 100.0, 30) for index in range(len(convergence.PLAIN_LADDER))]
    plain[-1] = row("good", 400.0, 50)
    said: list[str] = []
    costs = {"image": PipelineCost(10, 10, seconds=0.2, peak_memory_mib=math.pi, plan_s=0.05)}
    convergence._tabulate_pipelines(Bench("generate", "", said.append), "office", costs, plain)
    assert "| image | 10 | 10 | 0.2 | 0.05 | 2.00 | 500 | 3 | 50 | 200 |" in said
    convergence._tabulate_pipelines(Bench("generate", "", said.append), "office", costs, plain[:-1])
    assert "| image | 10 | 10 | 0.2 | 0.05 | 2.00 | 500 | 3 | 50 | – |" in said


def test_a_number_of_plain_transmitters_is_checked_before_anything_is_traced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(convergence, "_pipelines", lambda *_: 1 / 0)
    for number in ("1", "25"):
        outcome = xfreqbench("bench", "generate", "office", "--against-plain", "--plain-tx", number)
        assert outcome.code == 2
        assert f"--plain-tx is {number}; give 2 to" in outcome.stderr
