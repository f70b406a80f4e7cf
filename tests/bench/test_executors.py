"""What `bench scale-out` says of large data sets is arithmetic: here it is done by hand, and by real files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.synthetic import make_header
from xfreqbench.bench import executors as scale_out
from xfreqbench.bench.executors import WAYS, Took, bench_scale_out
from xfreqbench.bench.planning import DriverCost, Expected, TracingCost, TransmitterCost, _drive, _Driving
from xfreqbench.bench.tables import Bench
from xfreqbench.data.batches import BatchStore
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import BATCH, plan_generation
from xfreqbench.errors import XFreqBenchError
from xfreqbench.runs.records import read
from xfreqbench.scene.model import load_scene
from xfreqbench.system.workers import HERE, open_workers
from xfreqbench.tracing.tracer import Channel

FREE = DriverCost(plan_s=0.0, keep_s=0.0, write_s=0.0, peak_memory_mib=100.0)
TRACING = TracingCost(rays_s=0.0, per_tx_s=0.5, peak_memory_mib=200.0)


def cost(driver: DriverCost = FREE, tracing: TracingCost = TRACING) -> TransmitterCost:
    return TransmitterCost(make_header(), tracing, with_maps=driver, without_maps=FREE)


def test_tracing_alone_is_divided_by_the_cores() -> None:
    expected = Expected(cost(), num_tx=1000)
    assert expected.cpu_s == 500
    assert expected.wall_s(1, maps=True) == 500
    assert expected.wall_s(16, maps=True) == 500 / 16
    assert expected.speed_up(256, maps=True) == 256


def test_what_the_driver_does_alone_no_core_shortens() -> None:
    """Amdahl's law: a writer of 0.1 s a transmitter bounds the speed-up of 0.5 s of tracing at 6."""
    expected = Expected(cost(replace(FREE, write_s=0.1)), num_tx=1000)
    assert expected.wall_s(1, maps=True) == pytest.approx(600)
    assert expected.speed_up(10**9, maps=True) == pytest.approx(6)
    assert expected.speed_up(10**3, maps=False) == pytest.approx(1000)


def test_batches_are_kept_while_others_are_traced() -> None:
    expected = Expected(cost(replace(FREE, keep_s=0.01)), num_tx=1000)
    assert expected.wall_s(1, maps=True) == pytest.approx(500)
    assert expected.wall_s(256, maps=True) == pytest.approx(10)  # now keeping is the slower of the two


def test_every_process_shoots_its_rays_once() -> None:
    expected = Expected(cost(tracing=replace(TRACING, rays_s=7.0)), num_tx=1000)
    assert expected.wall_s(10, maps=True) == pytest.approx(57)


@pytest.mark.parametrize("maps", [True, False])
def test_sizes_are_those_of_files(tmp_path: Path, maps: bool) -> None:
    plan = plan_generation(load_scene("empty"), [1e9, 5e9], num_transmitters=BATCH, maps=maps)
    expected = Expected(TransmitterCost(plan.header, TRACING, FREE, FREE), num_tx=BATCH)
    path = generate_planned(plan, tmp_path / "empty.h5")
    assert expected.file_bytes(maps=maps) <= path.stat().st_size <= expected.file_bytes(maps=maps) + 2**20
    store = BatchStore(tmp_path / "parts", plan)
    shape = BATCH, 2, plan.header.receiver.num_elements
    store.write(0, Channel(np.ones(shape, np.complex128), np.ones(shape[:2], np.int32)))
    (kept,) = (tmp_path / "parts").glob("*.npz")
    overhead = 1000  # names and headers of two arrays in a zip file
    assert BATCH * expected.batch_bytes <= kept.stat().st_size <= BATCH * expected.batch_bytes + overhead


def test_the_drivers_memory_grows_with_cores_and_hardly_with_transmitters() -> None:
    few, many = (Expected(cost(), number).driver_bytes(16) for number in (10**3, 10**6))
    assert many - few == pytest.approx(49 * (10**6 - 10**3))  # two positions and a flag each
    one = Expected(cost(), 10**3)
    assert one.driver_bytes(32) - one.driver_bytes(16) == 32 * BATCH * one.batch_bytes


def test_a_driver_is_measured_on_channels_at_hand(tmp_path: Path) -> None:
    """What is written proves its origin, as every data set does, and is gone afterwards."""
    took = _drive(_Driving(num_carriers=2, num_tx=BATCH + 1, has_maps=True, folder=tmp_path))
    assert min(took.plan_s, took.keep_s, took.write_s) > 0
    assert took.peak_memory_mib > 100
    assert not list(tmp_path.iterdir())


def test_executors_are_compared_on_the_same_bytes(tmp_path: Path) -> None:
    plan = plan_generation(load_scene("empty"), [1e9], num_transmitters=2 * BATCH)
    work = scale_out._Generation(plan, tmp_path)
    serial, processes = (scale_out._measured(way, work) for way in WAYS[:2])
    assert serial.sha256 == processes.sha256 == open_dataset(tmp_path / "2 processes.h5").sha256
    assert serial.amount == processes.amount == 2 * BATCH


def test_the_ways_are_the_executors_that_they_name() -> None:
    assert [way.name for way in WAYS] == ["serial", "2 processes", "Dask, 2 workers"]
    with WAYS[0].open(True) as serial, WAYS[1].open(True) as processes:
        assert serial is HERE
        assert processes.num_places == 2
    with open_workers("3") as workers:
        assert workers.num_places == 3


def test_rates_are_work_over_wall_time() -> None:
    took = Took(start_up_s=2.0, wall_s=4.0, amount=10, empty_call_s=0.0015, sha256="")
    assert took.cells("runs") == ("2.0", "4.0", "2.5 runs/s", "1.50")


def test_fewer_than_a_batch_are_refused_before_anything_is_measured(tmp_path: Path) -> None:
    output = tmp_path / "records.jsonl"
    with pytest.raises(XFreqBenchError, match="at least 16"):
        bench_scale_out(Bench("scale-out", "command", print, output), 15)
    assert read(output).benches == ()
