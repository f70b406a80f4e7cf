from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.fuzzing.common import xfreqbench
from xfreqbench.bench import solvers as convergence
from xfreqbench.bench.solvers import Rung, ladder
from xfreqbench.bench.tables import Bench
from xfreqbench.runs.records import read
from xfreqbench.tracing.tracer import TraceSettings


def test_a_rung_changes_what_it_says_and_nothing_else() -> None:
    for rung in ladder(["image", "sionna"]):
        defaults = TraceSettings(rung.solver, ("specular", "refraction"))
        fields = {"depth": "max_depth", "rays": "rays", "interactions": "interactions"}
        changed = {name for name, key in fields.items() if getattr(rung.settings, key) != getattr(defaults, key)}
        if rung.label == "defaults":
            assert not changed
        else:
            assert changed >= set(rung.varied)
            assert changed == set(rung.varied) or f"{rung.settings.rays:,} rays" in rung.label


def test_the_table_of_settings_is_recorded_with_its_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rungs = [
        Rung("image", f"depth {depth}", varied, TraceSettings("image", ("specular", "refraction"), depth, rays=1000))
        for depth, varied in ((1, ("depth",)), (2, ("depth", "rays")))
    ]
    monkeypatch.setattr(convergence, "ladder", lambda solvers: iter(rungs))
    output = tmp_path / "records.jsonl"
    convergence.bench_generate(Bench("generate", "command", lambda text: None, output), "office", ["image"])
    (record,) = read(output).benches
    assert record.columns == ("setting", "rays once, s", "ms a sample", "1 GHz", "10 GHz", "94 GHz", "bar")
    assert [cells[0] for cells in record.rows] == ["image, depth 1", "image, depth 2"]
    assert record.figure is not None
    series = [(point.series, point.label) for point in record.figure.points]
    assert series == [("image, depth", "depth 1"), ("image, depth", "depth 2"), ("image, rays", "depth 2")]
    for cells, point in zip(record.rows, record.figure.points, strict=False):
        assert float(cells[2]) == pytest.approx(point.x, abs=0.006)  # shown to a hundredth
        medians = [float(cell.partition(" / ")[0]) for cell in cells[3:6]]
        assert min(medians) == pytest.approx(point.y, abs=0.51)  # shown without decimals
    assert record.figure.points[0].y < record.figure.points[1].y  # the office needs depth
    assert "llvmlite" in record.software


def test_a_number_of_plain_transmitters_is_checked_before_anything_is_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convergence, "_measure_pipeline", lambda *_: 1 / 0)
    for number in ("1", "25"):
        outcome = xfreqbench("bench", "generate", "office", "--against-plain", "--plain-tx", number)
        assert outcome.code == 2
        assert f"--plain-tx is {number}; give 2 to" in outcome.stderr
    outcome = xfreqbench("bench", "generate", "office", "--plain-tx", "4")
    assert "--plain-tx has no meaning without --against-plain" in outcome.stderr
