from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from itertools import product
from pathlib import Path

import pytest

from tests.support.fuzzing.common import xfreqbench
from xfreqbench.cli import runs
from xfreqbench.data.generate import generate
from xfreqbench.errors import OutputExistsError, StorageError, UnknownNameError
from xfreqbench.methods.registry import build_method, method_names
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs import benchmark as benchmarks
from xfreqbench.runs.benchmark import Benchmark, cost
from xfreqbench.runs.folder import ResultsFolder, read_records
from xfreqbench.runs.presets import PRESETS, Block, Preset, Setting
from xfreqbench.system.workers import HERE, InThisProcess

SMALL = Preset(
    description="a dozen transmitters of an empty room",
    blocks=(
        Block(
            scene="empty",
            settings=(Setting("aperture-gs", ("num_gaussians=8",)),),
            budget="2steps",
            seeds=(0, 1),
            targets_ghz=(77.0,),
        ),
    ),
    left_out="nearly everything",
    num_tx={"empty": 12},
)
NUM_RUNS = 2  # each in a process of its own, which takes seconds to import


@pytest.fixture(autouse=True)
def _small_preset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmarks, "PRESETS", {**PRESETS, "small": SMALL})


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_says_what_it_leaves_out_and_builds_its_methods(name: str) -> None:
    preset = Benchmark(name, Path("data"), Path("results")).preset
    assert preset.left_out
    assert set(preset.benches) <= set(benchmarks.BENCHES)


@pytest.mark.parametrize("name", PRESETS)
def test_every_learned_method_meets_the_trivial_ones_on_the_same_splits(name: str) -> None:
    blocks = PRESETS[name].blocks
    enough = EVERY_TRIVIAL[:1] if PRESETS[name].num_rooms else EVERY_TRIVIAL  # few have anything to copy there
    trivial: dict[tuple[str, str], set[object]] = {}
    for block in blocks:
        known = trivial.setdefault((block.scene, block.protocol), set())
        if {*enough} <= {setting.method for setting in block.settings} <= {*EVERY_TRIVIAL}:
            known.add(block.targets_ghz)
        assert known & {"all", None, block.targets_ghz}


def test_the_standard_runs_every_method_with_three_seeds_on_every_board() -> None:
    """But the trivial predictors, which need no seed, and what learns elsewhere or takes an hour a fit."""
    compared = set(method_names()) - set(EVERY_TRIVIAL) - {"xfreq-gs-paper"}
    blocks = [block for block in PRESETS["standard"].blocks if block.budget]
    for block in blocks:
        assert {setting.method for setting in block.settings} == compared and len(block.seeds) == 3
    boards = {(block.scene, block.protocol) for block in blocks}
    offices = product(("office", "open_office"), ("lofo", "sparse", "held-out-tx", "held-out-block"))
    assert boards == {*offices, *product(("two_rooms", "corridor", "lounge", "office_cluttered"), ["lofo"])}


def test_ablations_change_the_setting_that_they_name() -> None:
    blocks = (*PRESETS["standard"].blocks, *PRESETS["ablations"].blocks)
    for setting in {setting for block in blocks for setting in block.settings}:
        changed = build_method(setting.method, setting.overrides).config
        assert bool(setting.overrides) == (changed != build_method(setting.method).config)


def test_what_two_blocks_ask_for_is_counted_once(tmp_path: Path) -> None:
    planned = Benchmark("paper", tmp_path / "data", tmp_path / "results")
    assert "\n152 runs, 68 of them" in cost(planned, 2)  # three of the ablations' fits are those of lofo


def test_an_unknown_preset_names_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="standard"):
        Benchmark("standart", tmp_path, tmp_path)


def test_the_cost_of_a_benchmark_is_told_without_tracing_or_importing_a_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*arguments: object) -> None:
        raise AssertionError

    monkeypatch.setattr("xfreqbench.data.trace.tracer_of", refused)
    monkeypatch.setattr(benchmarks, "build_method", refused)
    for name in ("quick", "rooms"):
        assert "traced in about" in cost(Benchmark(name, tmp_path, tmp_path), 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("benchmark")


def _run(folder: Path) -> None:
    runs.benchmark(preset="small", data=folder / "data", results=folder / "results", predictions="shown", quiet=True)


@pytest.mark.slow
def test_a_benchmark_is_one_command_that_goes_on_where_it_stopped(folder: Path) -> None:
    """Interrupted by a failing run, it keeps the others, and then runs nothing but what is missing."""
    planned = Benchmark("small", folder / "data", folder / "results")
    assert "12 transmitters" not in cost(planned, 2)
    assert f"{NUM_RUNS} runs, {NUM_RUNS} of them fits" in cost(planned, 2)
    _run(folder)
    stored = planned.results.stored
    assert len(stored.records) == NUM_RUNS
    assert {record.hardware["cores"] for record in stored.records} == {"1"}
    assert {record.job.seed for record in stored.records if record.removed_predictions_sha256} == {1}
    (contents,) = stored.benches
    assert "nearly everything" in contents.note
    assert sum(int(row[-1]) for row in contents.rows) == NUM_RUNS
    assert "What was run" in (folder / "results" / "BENCHMARK.md").read_text()

    lines = planned.results.records_path.read_text().splitlines(keepends=True)
    planned.results.records_path.write_text(lines[0])
    _run(folder)
    again = planned.results.stored
    assert again.records[0] == stored.records[0]
    assert {record.id for record in again.records} == {record.id for record in stored.records}


def test_a_second_benchmark_in_one_folder_is_refused_before_it_writes_anything(tmp_path: Path) -> None:
    results = tmp_path / "results"
    with (
        ResultsFolder(results).alone(),
        ThreadPoolExecutor(1) as other,
        pytest.raises(StorageError, match=r"results is being written by process \d+"),
    ):
        other.submit(_run, tmp_path).result()
    assert not (tmp_path / "data").exists()
    assert not results.exists() or not list(results.iterdir())


@pytest.mark.slow
def test_a_measurement_that_fails_is_named_and_made_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planned = Benchmark("small", folder / "data", folder / "measured")
    monkeypatch.setitem(benchmarks.BENCHES["stress"], "command", "bench stress --only 'two carriers 1 Hz'")

    class FailsAfterItsTables(InThisProcess):
        def submit(self, call, /, *arguments, **options):
            return super().submit(lambda: 1 - xfreqbench(*arguments[0], is_bounded=False).code)

    with monkeypatch.context() as patch:
        patch.setattr(benchmarks, "LocalProcesses", lambda *_, **__: FailsAfterItsTables())
        (failure,) = benchmarks.measure(planned, "stress")
    assert failure == "`xfreqbench bench stress --only two carriers 1 Hz` ended with 1; see above"
    assert not planned.results.stored.benches
    assert benchmarks.measure(planned, "stress") == []
    assert [record.bench for record in planned.results.stored.benches] == ["stress"]


def test_a_file_that_holds_other_data_is_not_used(folder: Path) -> None:
    planned = Benchmark("small", folder / "other", folder / "results")
    generate("empty", planned.data_path("empty"), tx=3)
    with pytest.raises(OutputExistsError):
        benchmarks.generate_data(planned)


def test_failed_runs_are_named_and_the_others_kept(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planned = Benchmark("small", folder / "data", folder / "results")
    benchmarks.generate_data(planned)
    broken = Preset(
        "",
        (Block(scene="empty", protocol="held-out-tx", settings=tuple(map(Setting, EVERY_TRIVIAL[:2])), budget=None),),
        "",
        {"empty": 12},
    )
    monkeypatch.setitem(benchmarks.PRESETS, "broken", broken)  # type: ignore[arg-type]
    results = folder / "other"
    (results / "predictions").mkdir(parents=True)
    task = Benchmark("broken", folder / "data", results).tasks()[0]
    blocked = ResultsFolder(results).predictions_path(task.id)
    blocked.mkdir()  # where the predictions would go, once everything else was checked
    monkeypatch.setattr(benchmarks, "run_workers", lambda *_: nullcontext(HERE))  # in this process
    (failure,) = benchmarks.run_benchmark(Benchmark("broken", folder / "data", results))
    assert task.job.method in failure
    assert len(read_records(results)) == 1
