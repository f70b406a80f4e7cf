"""What `bench scale-out` compares: executors that do the same work, to the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.plans import plan_generation
from xfreqbench.bench import executors as scale_out
from xfreqbench.bench.executors import WAYS, bench_scale_out
from xfreqbench.bench.tables import Bench
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.plan import BATCH
from xfreqbench.errors import XFreqBenchError
from xfreqbench.runs.records import read
from xfreqbench.scene.model import load_scene


@pytest.mark.slow
def test_executors_are_compared_on_the_same_bytes(tmp_path: Path) -> None:
    plan = plan_generation(load_scene("empty"), [1e9], tx=2 * BATCH)
    work = scale_out._Generation(plan, tmp_path)
    (*times_s, serial), (*_, processes) = (scale_out._measured(way, work) for way in list(WAYS)[:2])
    assert serial == processes == open_dataset(tmp_path / "2 processes.h5").sha256
    assert min(times_s) > 0


def test_fewer_than_a_batch_are_refused_before_anything_is_measured(tmp_path: Path) -> None:
    output = tmp_path / "records.jsonl"
    with pytest.raises(XFreqBenchError, match="at least 16"):
        bench_scale_out(Bench("scale-out", "command", print, output), 15)
    assert read(output).benches == ()
