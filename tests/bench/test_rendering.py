from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from xfreqbench.bench import rendering
from xfreqbench.bench.rendering import Leaves, dense_field
from xfreqbench.bench.tables import Bench
from xfreqbench.data.plane_waves import plane_wave_data
from xfreqbench.runs.records import read

pytestmark = pytest.mark.usefixtures("one_thread")

ROUNDING = 1e-5  # float32 sums over the Gaussians that a direction sees


def test_the_splatting_table_has_a_row_for_each_size_and_small_errors_beside_its_times(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(rendering, "_MOST_DENSE_PAIRS", 0)
    output = tmp_path / "records.jsonl"
    rendering.bench_render(Bench("render", "", lambda text: None, output), [20, 60], [1, 33], False)
    (record,) = read(output).benches
    assert [row[:2] for row in record.rows] == [("20", "1"), ("20", "33"), ("60", "1"), ("60", "33")]
    assert all(float(error) < ROUNDING for row in record.rows for error in row[-2:])
    assert all(row[7].endswith("(1/25)") for row in record.rows)


def test_steps_of_methods_are_told_as_maps_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rendering, "METHODS", ["aperture-gs"])
    monkeypatch.setattr(rendering, "_step_s", lambda train, method: 0.5)
    said = list[str]()
    data = plane_wave_data(tmp_path / "d.h5", np.array([1e9, 10e9]), num_tx=2)
    rendering.tabulate_fits(Bench("render", "", said.append), data)
    assert "| aperture-gs | 64 | 500.0 | 128 |" in said


def test_footprints_hold_as_many_directions_as_the_table_says() -> None:
    (cells,) = rendering.splat_rows([100], [1])
    clipped = 0.8  # footprints at the first and the last row are cut
    assert (
        clipped <= int(cells[2].replace(",", "")) / 100 / rendering.DIRECTIONS_PER_GAUSSIAN <= 1.05
    )  # pixels of an ellipse


def test_dense_accumulation_lets_nothing_through_an_opaque_gaussian() -> None:
    near_and_far = torch.ones(2, 1), torch.tensor([[1.0], [5.0]]).to(torch.complex64)
    opaque = torch.zeros(2, 1, dtype=torch.complex64)
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, opaque)).item() == 1
    assert dense_field(Leaves(torch.zeros(1, 2), *near_and_far, 1 - opaque)).item() == 6
