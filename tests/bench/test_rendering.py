from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

from xfreqbench.bench import rendering
from xfreqbench.bench.rendering import Leaves, dense_field
from xfreqbench.bench.tables import Bench
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.plane_waves import plane_wave_data
from xfreqbench.errors import XFreqBenchError
from xfreqbench.runs.records import read

pytestmark = pytest.mark.usefixtures("one_thread")

ROUNDING = 1e-5  # float32 sums over the Gaussians that a direction sees


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
    monkeypatch.setattr(rendering, "_MOST_DENSE_PAIRS", 0)
    output = tmp_path / "records.jsonl"
    rendering.bench_render(Bench("render", "", said.append, output), [20, 60], [1, 33], False)
    rows = cells(said, columns=12)
    (record,) = read(output).benches
    assert [list(row) for row in record.rows] == rows
    assert len(record.columns) == 12
    assert [row[:2] for row in rows] == [["20", "1"], ["20", "33"], ["60", "1"], ["60", "33"]]
    assert all(float(error) < ROUNDING for row in rows for error in row[-2:])
    assert all(row[7].endswith("(1/25)") for row in rows)


def test_steps_of_methods_are_told_as_maps_a_second(
    train: PasDataset, bench: Bench, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rendering, "METHODS", ["aperture-gs"])
    monkeypatch.setattr(rendering, "step_s", lambda train, method: 0.5)
    rendering.tabulate_fits(bench, train)
    assert cells(said, columns=4) == [["aperture-gs", "32", "500.0", "64"]]


def test_every_bench_names_its_machine_and_threads(bench: Bench, said: list[str]) -> None:
    rendering.bench_render(bench, [], [], False)
    assert re.search(r"\d+ cores, ", said[0])
    assert "numba and torch on 1 threads" in said[1]


def test_footprints_hold_as_many_directions_as_the_table_says() -> None:
    (cost,) = rendering.splat_costs([100], [1])
    clipped = 0.8  # footprints at the first and the last row are cut
    assert clipped <= cost.num_pairs / 100 / rendering.DIRECTIONS_PER_GAUSSIAN <= 1.05  # pixels of an ellipse


def test_dense_accumulation_lets_nothing_through_an_opaque_gaussian() -> None:
    near_and_far = torch.ones(2, 1), torch.tensor([[1.0], [5.0]]).to(torch.complex64)
    opaque = torch.zeros(2, 1, dtype=torch.complex64)
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, opaque)).item() == 1
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, 1 - opaque)).item() == 6


def test_counts_that_are_none_are_refused() -> None:
    from xfreqbench.cli.measure import bench_render

    with pytest.raises(XFreqBenchError, match=r"--batch takes whole numbers .* got '8,0'"):
        bench_render(batch="8,0")
