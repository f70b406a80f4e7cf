from __future__ import annotations

import math
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from xfreqbench.bench import savings as efficiency
from xfreqbench.bench import tables
from xfreqbench.bench.savings import Saving, Workload, channel_change
from xfreqbench.bench.tables import Bench
from xfreqbench.cli import main as cli
from xfreqbench.errors import DataError, StorageError
from xfreqbench.runs.records import BenchFigure, BenchPoint, read

ROUNDING = 1e-12  # the same paths in another order of the candidates, in double precision
INTERPOLATED_DB = 60  # of maps: the bar of the generator's defaults is 30 dB at the 5th percentile
SHARED_DB = 40  # rays launched for other apertures or from other ends find other faint paths


@pytest.fixture(autouse=True)
def timed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "REPEATS", 1)


@pytest.fixture(scope="module")
def work() -> Workload:
    office = efficiency.office_workload("image", num_tx=2).few(2, 2)
    return replace(office, settings=replace(office.settings, max_depth=3, rays=10_000))


def moved(saving: Saving) -> tuple[float, float]:
    """Relative error of the channels, and the worst PSNR of the maps in dB."""
    if saving.change == "none":
        return 0.0, math.inf
    found = re.fullmatch(r"channels: (\S+); maps: worst (\S+) dB, median \S+ dB", saving.change)
    assert found is not None
    return float(found[1]), float(found[2])


def test_each_saving_of_the_image_method_leaves_the_maps_where_they_were(work: Workload) -> None:
    savings = list(efficiency.image_savings(work))
    exact = {"candidates pruned", "visibility", "transmitters side", "plane sequences"}
    for saving in savings:
        error, worst_db = moved(saving)
        if any(name in saving.name for name in exact):
            assert error <= ROUNDING, saving.name
        assert worst_db >= (INTERPOLATED_DB if "field" in saving.name else SHARED_DB), saving.name
    assert {name for name in exact for saving in savings if name in saving.name} == exact


def test_diffuse_reflection_changes_the_channels_and_most_of_it_comes_without_a_mirror(work: Workload) -> None:
    (all_of_it, _), (over_mirrors, _) = map(moved, efficiency.diffuse_savings(work.few(1, 1)))
    assert all_of_it > over_mirrors > 1e-3


@pytest.mark.slow
@pytest.mark.sionna
def test_savings_of_sionna_leave_the_maps_where_they_were(work: Workload) -> None:
    sionna = replace(work.few(2, 2), settings=replace(work.settings, solver="sionna"))
    for saving in (
        efficiency.all_at_once(sionna, "side by side"),
        efficiency.one_shooting_for_all_transmitters(sionna, "once"),
    ):
        error, _ = moved(saving)
        assert error == 0, saving.name  # the same seed, whichever other transmitters are asked for
    _, worst_db = moved(efficiency.shooting_from_the_receiver(sionna.few(1, 1)))
    assert worst_db >= SHARED_DB  # other rays find all but faint paths


def test_a_change_of_channels_is_relative_to_the_samples_own_norm(work: Workload) -> None:
    cfr = work.channel()
    assert channel_change(work.scene, cfr, cfr) == "none"
    doubled = cfr.copy()
    doubled[0, 0] *= 2
    expected = "channels: 1e+00; maps: worst inf dB, median inf dB"  # a map's peak is 1 whatever the scale
    assert channel_change(work.scene, doubled, cfr) == expected


def test_a_table_is_recorded_as_it_was_printed_unless_it_broke_off(tmp_path: Path) -> None:
    said: list[str] = []
    bench = Bench("render", "xfreqbench bench render", said.append, tmp_path / "new" / "records.jsonl")
    bench.introduce()
    figure = BenchFigure(x_label="ms", y_label="dB", log_x=True, points=())
    with pytest.raises(KeyboardInterrupt), bench.table("Title", "", ("setting",)):
        raise KeyboardInterrupt
    with bench.table("Title", "A note.", ("setting", "ms"), {"sionna-rt": "2"}) as table:
        table.add("one", "1.00")
        assert said[-1] == "| one | 1.00 |"
        table.add("two", "2.00")
        table.figure = figure
    (record,) = read(tmp_path / "new" / "records.jsonl").benches
    assert (record.columns, record.rows) == (("setting", "ms"), (("one", "1.00"), ("two", "2.00")))
    assert (record.bench, record.title, record.note, record.figure) == ("render", "Title", "A note.", figure)
    assert record.software["sionna-rt"] == "2"
    assert record.hardware["processor"] in said[0]


def test_a_place_that_takes_no_records_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no record\n")
    with pytest.raises(DataError, match="is no file of records"):
        Bench("render", "", print, tmp_path / "text").introduce()
    with pytest.raises(StorageError, match="cannot be written"):
        Bench("render", "", print, tmp_path / "text" / "records.jsonl").introduce()


@pytest.mark.parametrize(
    "words",
    [
        ["generate", "my scene.toml", "--solvers", "image"],
        ["generate", "office", "--against-plain", "--tx", "10", "--plain-tx", "4"],
        ["render", "--gaussians", "20,60", "--batch", "1", "--no-step"],
        ["savings"],
    ],
)
def test_the_recorded_command_is_the_one_that_was_given(
    words: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    benches: list[Bench] = []
    for name in (
        "solvers.bench_generate",
        "solvers.bench_against_plain",
        "rendering.bench_render",
        "savings.bench_savings",
    ):
        monkeypatch.setattr(f"xfreqbench.bench.{name}", lambda bench, *arguments: benches.append(bench))
    output = tmp_path / "records.jsonl"
    cli.app(["bench", *words, "--output", str(output)], result_action="return_value")
    (bench,) = benches
    assert bench.command == shlex.join(["xfreqbench", "bench", *words])
    kind = "plain" if "--against-plain" in words else words[0]
    assert (bench.name, bench.output) == (kind, output)


def test_labels_of_points_close_together_do_not_lie_on_each_other() -> None:
    from matplotlib.figure import Figure

    from xfreqbench.report.leaderboard import plots

    near = [BenchPoint(series=f"series {n % 2}", label=f"{n} ms", x=1 + n / 100, y=40.0) for n in range(3)]
    canvas = Figure(figsize=(8, 5))
    axis = canvas.subplots()
    axis.set(xlim=(0, 2), ylim=(0, 80))
    plots._write_labels(canvas, axis, near, ["series 0", "series 1"])
    boxes = [super(type(text), text).get_window_extent() for text in axis.texts]
    assert len(boxes) == 3
    for index, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[index + 1 :])
        assert np.isfinite(box.bounds).all()
