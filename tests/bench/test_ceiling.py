from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.found_box import SCENE, SETTINGS
from tests.support.fuzzing.common import xfreqbench
from tests.support.synthetic import write_dataset
from xfreqbench.bench import ceiling
from xfreqbench.bench.ceiling import (
    PHASE_BLIND,
    CeilingScores,
    compute_ceiling,
    has_order,
    order_limited_maps,
    plan_ceiling,
)
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import plan_generation
from xfreqbench.errors import XFreqBenchError
from xfreqbench.maps.metrics import ssim
from xfreqbench.scene.model import Scene
from xfreqbench.tracing.paths import DIFFRACTION, DIFFUSE, REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.waves import spherical_waves
from xfreqbench.types import ignore_progress

pytestmark = pytest.mark.usefixtures("one_thread")

STORED = 1e-3  # maps on disk are float16
CARRIERS_HZ = [2.4e9, 10e9, 24.25e9]


@pytest.fixture(scope="module", autouse=True)
def few_draws() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ceiling, "NUM_DRAWS", 8)
        yield


def generated(folder: Path, scene: Scene, num_tx: int = 4) -> PasDataset:
    plan = plan_generation(scene, CARRIERS_HZ, SETTINGS, num_transmitters=num_tx)
    return open_dataset(generate_planned(plan, folder / "box.h5"))


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return generated(tmp_path_factory.mktemp("box"), SCENE)


@pytest.fixture(scope="module")
def scores(box: PasDataset) -> CeilingScores:
    return scored(box)


def scored(dataset: PasDataset, num_transmitters: int = 3, seed: int = 0) -> CeilingScores:
    return compute_ceiling(plan_ceiling(dataset, None, num_transmitters, seed), ignore_progress)


def test_of_a_single_path_no_phase_is_missing_and_every_row_is_perfect(tmp_path: Path) -> None:
    empty = scored(generated(tmp_path, replace(SCENE, surface=())))
    np.testing.assert_allclose(empty.ssim, 1, atol=STORED)


def test_more_reflections_never_cost_and_all_of_them_are_the_stored_map(scores: CeilingScores) -> None:
    medians = np.median(scores.ssim, axis=0)
    limited = medians[:, len(PHASE_BLIND) :]
    assert (np.diff(limited, axis=1) > 0).all()
    assert (limited[:, -1] > 1 - STORED).all()  # the box was traced to depth 3
    assert (medians[:, 0] > medians[:, 2]).all()  # the best map is more like the truth than a random one


def test_paths_that_are_left_out_are_those_of_the_missing_walls(tmp_path: Path) -> None:
    """A floor adds one reflection; without it, and with the same transmitters, the line of sight remains."""
    floor = tuple(surface for surface in SCENE.surface if surface.name == "floor")
    with_floor = generated(tmp_path, replace(SCENE, surface=floor))
    plan = plan_ceiling(with_floor, None, 4, 0)
    for tx in plan.tx.tolist():
        samples = with_floor.subset(tx * with_floor.num_carriers + plan.carrier)
        paths = plan.tracer.paths(samples.tx_position_m[0].astype(np.float64))
        assert len(paths.delay_s) == 2
        for f, stored in enumerate(samples.cfr):
            waves = spherical_waves(paths, f, plan.receiver)
            alone = with_floor.beam.maps(waves[:1])[0]
            limited, whole = order_limited_maps(
                stored, waves, [has_order(paths, n) for n in (0, 1)], with_floor
            )
            assert (
                ssim(limited[None], alone, with_floor.grid)[0] > 0.999
            )  # the floor's power varies over the array
            np.testing.assert_allclose(whole, samples.pas([f])[0], atol=STORED)


def test_waves_of_all_paths_with_their_phases_make_the_stored_maps(
    box: PasDataset, scores: CeilingScores
) -> None:
    plan = plan_ceiling(box, None, 3, 0)
    row = int(plan.tx[0] * box.num_carriers + plan.carrier[-1])
    paths = plan.tracer.paths(box.tx_position_m[row].astype(np.float64))
    whole = spherical_waves(paths, len(plan.carrier) - 1, plan.receiver).sum(axis=0)
    assert ssim(box.beam.maps(whole[None])[0], box.pas([row]), box.grid)[0] > 0.99
    assert scores.wave_error[0, -1] == pytest.approx(
        np.linalg.norm(box.cfr[row] - whole) / np.linalg.norm(box.cfr[row]), rel=1e-3
    )


def test_only_mirror_paths_have_an_order() -> None:
    codes = [
        [0, 0, 0],
        [SPECULAR, 0, 0],
        [REFRACTION, SPECULAR, SPECULAR],
        [DIFFRACTION, 0, 0],
        [SPECULAR, DIFFUSE, 0],
    ]
    paths = Paths(
        carrier_hz=np.array([1e9]),
        gain=np.ones((1, 5), complex),
        delay_s=np.arange(1.0, 6.0),
        arrival=np.tile([0.0, 0.0, 1.0], (5, 1)),
        interactions=np.array(codes),
        surfaces=np.zeros((5, 3), int),
        vertices_m=np.zeros((5, 3, 3)),
    )
    assert has_order(paths, 1).tolist() == [True, True, False, False, False]
    assert has_order(paths, 2).tolist() == [True, True, True, False, False]


def test_scores_follow_from_the_seed_and_those_of_a_transmitter_from_nothing_else(
    box: PasDataset, scores: CeilingScores
) -> None:
    drawn, fewer = (plan_ceiling(box, None, number, 0).tx for number in (3, 2))
    np.testing.assert_array_equal(scored(box, 2).ssim, scores.ssim[np.isin(drawn, fewer)])
    other = scored(box, 4, seed=1).ssim[drawn]
    assert (other[..., : len(PHASE_BLIND)] != scores.ssim[..., : len(PHASE_BLIND)]).all()
    np.testing.assert_array_equal(other[..., len(PHASE_BLIND) :], scores.ssim[..., len(PHASE_BLIND) :])


def test_a_transmitter_without_a_path_is_not_drawn(box: PasDataset) -> None:
    box.tables["peak_power"][1, 0], kept = 0, box.tables["peak_power"][1, 0]
    try:
        silent = replace(box)
        assert plan_ceiling(silent, None, 99, 0).tx.tolist() == [0, 2, 3]
        assert plan_ceiling(silent, [24.25e9], 99, 0).tx.tolist() == [0, 1, 2, 3]
    finally:
        box.tables["peak_power"][1, 0] = kept


def test_what_cannot_be_scored_is_refused(box: PasDataset, tmp_path: Path) -> None:
    assert plan_ceiling(box, None, 1, 0).carrier.tolist() == [0, 2]
    for number, seed in ((0, 0), (1, -1)):
        with pytest.raises(XFreqBenchError, match=f"but got {number} and {seed}"):
            plan_ceiling(box, None, number, seed)
    with pytest.raises(XFreqBenchError, match=r"3 GHz is asked for, but .* has 2\.4, 10, 24\.25 GHz"):
        plan_ceiling(box, [10e9, 3e9], 1, 0)
    with pytest.raises(XFreqBenchError, match=r"2\.4, 24\.25, 77 GHz is asked for, but .* has 1, 10, 37 GHz"):
        plan_ceiling(write_dataset(tmp_path / "waves.h5"), None, 1, 0)
    outcome = xfreqbench("bench", "ceiling", tmp_path / "waves.h5", "--freqs", "10")
    assert outcome.code == 2
    assert "does not say which scene it was traced in" in outcome.stderr
    assert outcome.stderr.count("\n") <= 3
