from __future__ import annotations

import re

import pytest
import torch

from xfreqbench import rendering
from xfreqbench.dataset import PasDataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.splatting import benchmark
from xfreqbench.splatting.benchmark import Leaves, dense_field
from xfreqbench.splatting.loss import map_loss
from xfreqbench.splatting.training_step import Step
from xfreqbench.splatting.view import View, as_kind

pytestmark = pytest.mark.usefixtures("one_thread")

ROUNDING = 1e-5  # float32 sums over the Gaussians that a direction sees
NARROW = 1e-2  # mean over a map of peak 1: bfloat16 keeps 3 digits
STORED = 1e-3  # maps on disk are float16
TINY = ("width=16", "layers=2", "stride=1", "ssim_window=7", "num_gaussians=40", "batch_size=2")


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return rendering.plane_wave_data(tmp_path_factory.mktemp("data") / "waves.h5", num_tx=2)


@pytest.fixture
def said() -> list[str]:
    return []


def cells(said: list[str], columns: int) -> list[list[str]]:
    """Rows of the tables of so many columns, without headings."""
    lines = [line for text in said for line in text.splitlines() if line.startswith("| ")]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in rows if len(row) == columns][1:]


def test_the_splatting_table_has_a_row_for_each_size_and_small_errors_beside_its_times(
    said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark, "_MOST_DENSE_PAIRS", 0)
    rendering.bench_render([20, 60], [1, 33], False, said.append)
    rows = cells(said, columns=12)
    assert [row[:2] for row in rows] == [["20", "1"], ["20", "33"], ["60", "1"], ["60", "33"]]
    assert all(float(error) < ROUNDING for row in rows for error in row[-2:])
    assert all(row[7].endswith("(1/25)") for row in rows)


def test_every_table_names_its_machine(said: list[str]) -> None:
    rendering.bench_render([], [], False, said.append)
    assert re.search(r"\d+ cores, .*torch \d.*numba \d.* on 1 threads", said[0])


def test_footprints_hold_as_many_directions_as_the_table_says() -> None:
    (cost,) = benchmark.splat_costs([100], [1])
    clipped = 0.8  # footprints at the first and the last row are cut
    assert clipped <= cost.num_pairs / 100 / benchmark.DIRECTIONS_PER_GAUSSIAN <= 1.05  # pixels of an ellipse


def test_dense_accumulation_lets_nothing_through_an_opaque_gaussian() -> None:
    near_and_far = torch.ones(2, 1), torch.tensor([[1.0], [5.0]]).to(torch.complex64)
    opaque = torch.zeros(2, 1, dtype=torch.complex64)
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, opaque)).item() == 1
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, 1 - opaque)).item() == 6


def test_the_parts_of_a_step_render_and_learn_what_the_method_does(train: PasDataset) -> None:
    taken_apart, whole = Step(train, TINY), Step(train, TINY)
    before = [parameter.detach().clone() for parameter in whole.field.parameters()]
    taken_apart.parts_s()
    power = whole.field.power(whole.tx_position_m, whole.carrier_hz, View(), whole.beams)
    maps = as_kind(power, whole.kind)
    loss = map_loss(maps, whole.targets.maps(whole.nth, View()), whole.config.ssim_weight, 7)
    loss.backward()
    whole.update()
    for one, other, old in zip(taken_apart.field.parameters(), whole.field.parameters(), before, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=ROUNDING)
        assert not torch.equal(one, old)


def test_the_step_table_adds_its_parts_up(train: PasDataset, said: list[str]) -> None:
    rendering.say_step(train, TINY, said.append)
    *parts, total, whole = [row[:2] for row in cells(said, columns=3)]
    shown = 0.006 * len(parts)  # each is rounded to a hundredth
    assert sum(float(milliseconds) for _, milliseconds in parts) == pytest.approx(float(total[1]), abs=shown)
    assert {"network, forward", "composite, backward", "optimiser"} <= {name for name, _ in parts}
    assert whole[0].startswith("whole step")
    assert "samples/s allow 10.0 ms" in said[0]


def test_savings_leave_the_answer_where_it_was(train: PasDataset, said: list[str]) -> None:
    rendering.say_savings(train, TINY, said.append)
    rows = cells(said, columns=6)
    changes = {row[0]: [float(x) for x in re.findall(r"\de[-+]\d\d", row[-1])] for row in rows}
    bars = {
        "bfloat16": NARROW,
        "factorised": ROUNDING,
        "unseen": ROUNDING,
        "one binning": ROUNDING,
        "targets from channels, stride 1": STORED,
        "targets from channels, stride 3": STORED,
        "every fifth": ROUNDING,
    }
    for (name, moved), (expected, bar) in zip(changes.items(), bars.items(), strict=True):
        assert name.startswith(expected)
        assert moved[0] <= bar, name


def test_gaussians_below_the_horizon_are_not_seen(train: PasDataset, said: list[str]) -> None:
    rendering.say_savings(train, (*TINY, "angular_size_deg=1"), said.append)
    (name,) = [row[0] for row in cells(said, columns=6) if row[0].startswith("unseen")]
    seen, every = map(int, re.findall(r"\d+", name))
    assert 0 < seen < every


def test_counts_that_are_none_are_refused() -> None:
    from xfreqbench.cli import bench_render

    with pytest.raises(XFreqBenchError, match=r"--batch takes whole numbers .* got '8,0'"):
        bench_render(batch="8,0")
