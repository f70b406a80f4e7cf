from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from xfreqbench.bench import rendering
from xfreqbench.bench import splatting as benchmark
from xfreqbench.bench.learning_savings import Saving, finite_footprints, gaussians_in_view, savings
from xfreqbench.bench.splatting import Leaves, dense_field
from xfreqbench.bench.tables import Bench
from xfreqbench.bench.training_step import Step
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.plane_waves import plane_wave_data
from xfreqbench.errors import XFreqBenchError
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.methods.learning.targets import GridView, as_kind
from xfreqbench.runs.records import read

pytestmark = pytest.mark.usefixtures("one_thread")

ROUNDING = 1e-5  # float32 sums over the Gaussians that a direction sees
CUT_OFF = 4e-2  # a Gaussian's value at three deviations is 0.011, and a direction has a few of them
NARROW = 1e-2  # mean over a map of peak 1: bfloat16 keeps 3 digits
STORED = 1e-3  # maps on disk are float16
TINY = ("width=16", "layers=2", "stride=1", "ssim_window=7", "num_gaussians=40", "batch_size=2")


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    path = tmp_path_factory.mktemp("data") / "waves.h5"
    return plane_wave_data(path, rendering.CARRIERS_HZ, num_tx=2)


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def bench(said: list[str]) -> Bench:
    return Bench("render", "xfreqbench bench render", said.append)


def cells(said: list[str], columns: int) -> list[list[str]]:
    """Rows of the tables of so many columns, without headings."""
    lines = [line for text in said for line in text.splitlines() if line.startswith("| ")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in rows if len(row) == columns][1:]


def test_the_splatting_table_has_a_row_for_each_size_and_small_errors_beside_its_times(
    said: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(benchmark, "_MOST_DENSE_PAIRS", 0)
    output = tmp_path / "records.jsonl"
    rendering.bench_render(Bench("render", "", said.append, output), [20, 60], [1, 33], False)
    rows = cells(said, columns=12)
    (record,) = read(output).benches
    assert [list(row) for row in record.rows] == rows
    assert len(record.columns) == 12
    assert [row[:2] for row in rows] == [["20", "1"], ["20", "33"], ["60", "1"], ["60", "33"]]
    assert all(float(error) < ROUNDING for row in rows for error in row[-2:])
    assert all(row[7].endswith("(1/25)") for row in rows)


def test_dense_accumulation_lets_nothing_through_an_opaque_gaussian() -> None:
    near_and_far = torch.ones(2, 1), torch.tensor([[1.0], [5.0]]).to(torch.complex64)
    opaque = torch.zeros(2, 1, dtype=torch.complex64)
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, opaque)).item() == 1
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, 1 - opaque)).item() == 6


def test_the_parts_of_a_step_render_and_learn_what_the_method_does(train: PasDataset) -> None:
    taken_apart, whole = Step(train, TINY), Step(train, TINY)
    before = [parameter.detach().clone() for parameter in whole.field.parameters()]
    taken_apart.parts_s()
    power = whole.field.power(whole.tx_position_m, whole.carrier_hz, GridView(), whole.beams)
    maps = as_kind(power, whole.kind)
    loss = map_loss(maps, whole.targets.maps(whole.nth, GridView()), whole.config.ssim_weight, 7)
    loss.backward()
    whole.update()
    for one, other, old in zip(taken_apart.field.parameters(), whole.field.parameters(), before, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=ROUNDING)
        assert not torch.equal(one, old)


def numbers(saving: Saving) -> list[float]:
    return [float(text) for text in re.findall(r"\de[-+]\d\d", saving.change)]


def test_savings_leave_the_answer_where_it_was(train: PasDataset) -> None:
    found = list(savings(train, TINY))
    bars = {
        "compiled kernels": ROUNDING,
        "footprints end": CUT_OFF,
        "one binning": ROUNDING,
        "unseen": ROUNDING,
        "bfloat16": NARROW,
        "factorised": ROUNDING,
        "targets from channels, stride 1": STORED,
        "targets from channels, stride 3": STORED,
        "beams by lags": ROUNDING,
        "every fifth": ROUNDING,
    }
    for saving, (expected, bar) in zip(found, bars.items(), strict=True):
        assert saving.name.startswith(expected)
        assert numbers(saving)[0] <= bar, saving.name
    assert {saving.part for saving in found} == {"renderer", "training"}


def test_footprints_that_end_do_change_the_field(train: PasDataset) -> None:
    settings = (
        *TINY,
        "angular_size_deg=10",
    )  # wide ones, which few directions lie outside of, but all beside
    assert numbers(finite_footprints(Step(train, settings)))[0] > ROUNDING


def test_gaussians_below_the_horizon_are_not_seen(train: PasDataset) -> None:
    saving = gaussians_in_view(train, (*TINY, "angular_size_deg=1"))
    seen, every = map(int, re.findall(r"\d+", saving.name))
    assert 0 < seen < every


def test_counts_that_are_none_are_refused() -> None:
    from xfreqbench.cli.measure import bench_render

    with pytest.raises(XFreqBenchError, match=r"--batch takes whole numbers .* got '8,0'"):
        bench_render(batch="8,0")
