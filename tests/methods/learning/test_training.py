"""The learned methods train, stop and go on: tiny ones, on plane waves."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import torch
from xfreqbench.baselines.aperture_gs import ApertureGS
from xfreqbench.baselines.fixed_frequency_gs import FixedFrequencyGS
from xfreqbench.baselines.frequency_embedded_gs import FrequencyEmbeddedGS
from xfreqbench.baselines.gsrf import GSRF
from xfreqbench.baselines.swift_wrf import SwiftWRF
from xfreqbench.baselines.wideband_3dgs import Wideband3DGS
from xfreqbench.baselines.wrf_gs_plus import WRFGSPlus
from xfreqbench.baselines.xfreq_gs import XFreqGS
from xfreqbench.baselines.xfreq_gs_paper import XFreqGSPaper

from tests.support.stub_methods import curve, lofo_job, maps, run_job
from tests.support.synthetic import write_dataset
from tests.support.training import DIVIDING, TINY, predicted, reloaded, tiny, trained
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning import targets as view
from xfreqbench.methods.learning import training as learned
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.targets import GridView
from xfreqbench.methods.learning.training import LearnedMethod
from xfreqbench.methods.registry import build_method
from xfreqbench.methods.splatting.field import SplatField
from xfreqbench.methods.splatting.projection import project
from xfreqbench.runs import checkpoints

pytestmark = pytest.mark.usefixtures("one_thread")

BLIND = [FixedFrequencyGS, GSRF, WRFGSPlus]  # to the carrier
DIVIDED = [*BLIND, XFreqGS, XFreqGSPaper, FrequencyEmbeddedGS, Wideband3DGS]
METHODS = [*DIVIDED, ApertureGS, SwiftWRF]
every_method = pytest.mark.parametrize("method", METHODS)


def field_of(method: LearnedMethod) -> SplatField:
    return method._training.field


@every_method
def test_sixty_steps_lower_the_loss_and_maps_lie_between_zero_and_a_peak_of_one(
    method: type[LearnedMethod], dataset: PasDataset
) -> None:
    model = tiny(method, ssim_weight=0.0, learning_rate=0.01, batch_size=16)
    losses = [point.loss for point in trained(model, dataset, 60)]
    assert np.mean(losses[-10:]) < 0.85 * np.mean(losses[:10])
    maps = predicted(model, dataset)
    assert (maps.dtype, maps.shape) == (np.float32, (6, 90, 360))
    np.testing.assert_allclose(maps.max(axis=(1, 2)), 1, rtol=1e-6)
    assert maps.min() >= 0


def test_our_adam_makes_the_steps_of_torchs() -> None:
    ours, theirs = (torch.nn.Parameter(torch.linspace(-1, 1, 9)) for _ in range(2))
    for parameter, kind in ((ours, learned.Adam), (theirs, torch.optim.Adam)):
        optimizer = kind([{"params": [parameter], "lr": 0.1}], fused=True)
        for _ in range(3):
            parameter.grad = parameter.detach() ** 2 - 0.1
            optimizer.step()
    assert torch.equal(ours, theirs)


@pytest.mark.slow
def test_a_fit_neither_imports_torchs_compiler_nor_changes_its_number_of_threads(dataset: PasDataset) -> None:
    code = f"""
import sys, torch
torch.set_num_threads(1)
from xfreqbench.baselines.xfreq_gs import XFreqGS
from xfreqbench.data.dataset import open_dataset
from xfreqbench.methods.contract import Budget
next(XFreqGS(XFreqGS.Config(**{TINY})).fit(open_dataset({str(dataset.path)!r}), Budget(), 0))
assert "torch._dynamo" not in sys.modules
assert torch.get_num_threads() == 1
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@every_method
def test_a_fit_goes_on_from_its_files_as_if_it_had_never_stopped(
    method: type[LearnedMethod], dataset: PasDataset, tmp_path: Path
) -> None:
    options = DIVIDING if method in DIVIDED else {}
    unbroken, broken = tiny(method, **options), tiny(method, **options)
    points = trained(unbroken, dataset, 20)
    before = trained(broken, dataset, 11, end=20)
    resumed = reloaded(broken, tmp_path / "saved")
    assert (resumed.config, resumed.num_parameters) == (broken.config, broken.num_parameters)
    assert np.array_equal(predicted(resumed, dataset), predicted(broken, dataset))
    assert [*before, *trained(resumed, dataset, 20)] == points
    assert np.array_equal(predicted(resumed, dataset), predicted(unbroken, dataset))
    numbers = [point.counts["gaussians"] for point in (before[0], before[-1], points[-1])]
    assert (numbers[0] < numbers[1] < numbers[2]) == (method in DIVIDED)


def test_a_step_of_the_weights_is_forgotten_at_its_rate_and_all_where_sizes_change() -> None:
    kept, layer, mean = 0.5, torch.nn.Linear(2, 1, bias=False), None
    for step in range(-20, 4):  # past the start, when the mean keeps less
        torch.nn.init.constant_(layer.weight, float(step <= 0))
        mean = learned.averaged(mean, layer, kept)
        assert mean.module.weight[0, 0].item() == pytest.approx(kept ** max(step, 0))
    wider = torch.nn.Linear(3, 1, bias=False)
    assert torch.equal(learned.averaged(mean, wider, kept).module.weight, wider.weight)


def test_the_mean_of_weights_begins_anew_where_gaussians_are_replaced_by_as_many_others(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    def replaced(field: SplatField, optimizer: torch.optim.Adam, step: int, share: float) -> None:
        if step == 3:
            own = field.gaussians._parameters
            own.update({name: torch.nn.Parameter(own[name].detach().clone()) for name in own})

    monkeypatch.setattr(SplatField, "after_step", replaced)
    model = tiny(XFreqGS, averaging=0.9)
    num_averaged = []
    for progress in model.fit(dataset, Budget(max_steps=4), 0):
        num_averaged.append(int(model._training.mean.n_averaged))
        if progress.step == 4:
            break
    assert num_averaged == [1, 2, 1, 2]


def test_without_a_budget_a_fit_goes_on_at_its_share_of_its_own_steps(dataset: PasDataset, tmp_path: Path) -> None:
    unbroken, broken = (tiny(ApertureGS, steps=12) for _ in range(2))
    losses = [point.loss for point in unbroken.fit(dataset, Budget(), 0)]
    fit = broken.fit(dataset, Budget(), 0)
    before = [next(fit).loss for _ in range(7)]
    resumed = reloaded(broken, tmp_path / "saved")
    assert [*before, *(point.loss for point in resumed.fit(dataset, Budget(), 0))] == losses
    assert np.array_equal(predicted(resumed, dataset), predicted(unbroken, dataset))


@pytest.mark.parametrize("method", [XFreqGS, ApertureGS])
def test_predicting_and_saving_leave_the_fit_as_it_was(
    method: type[LearnedMethod], dataset: PasDataset, tmp_path: Path
) -> None:
    options = DIVIDING if method in DIVIDED else {}
    watched, alone = tiny(method, **options), tiny(method, **options)
    fits = watched.fit(dataset, Budget(8), 0), alone.fit(dataset, Budget(8), 0)
    for _ in range(8):
        assert next(fits[0]) == next(fits[1])
        predicted(watched, dataset)
        watched.save(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.json", "state.safetensors"]
    assert json.loads((tmp_path / "state.json").read_text())["step"] == 8


def test_another_seed_is_another_fit(dataset: PasDataset) -> None:
    losses = [[point.loss for point in trained(tiny(XFreqGS), dataset, 3, seed=seed)] for seed in (0, 1)]
    assert losses[0] != losses[1]


def test_xfreq_gs_learns_places_turns_and_sizes_and_shows_them(dataset: PasDataset) -> None:
    model = tiny(XFreqGS)
    start = model.started(dataset, 0).field
    trained(model, dataset, 20)
    shown, learned = predicted(model, dataset), model._training.predictor
    for name in ("position_m", "quaternion", "log_scale"):
        value = learned.get_parameter(f"gaussians.{name}")
        moved, first = value.detach().clone(), start.get_parameter(f"gaussians.{name}").detach()
        assert float((moved != first).any(1).float().mean()) > 0.9, name  # a Gaussian may be seen from no direction
        value.data.copy_(first)
        # round at the start, Gaussians turn for little yet
        assert float(np.abs(predicted(model, dataset) - shown).max()) > 1e-6, name
        value.data.copy_(moved)
    assert np.array_equal(predicted(model, dataset), shown)


@pytest.mark.parametrize(
    ("parameter", "tensor"),
    [
        (None, "loss"),  # the targets are nan
        ("network.head.bias", "loss"),  # every map is nan
        ("gaussians.position_m", "gradient of gaussians.position_m"),  # no direction sees that Gaussian
    ],
)
def test_what_is_not_finite_ends_the_fit_before_it_spoils_parameters(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch, parameter: str | None, tensor: str
) -> None:
    model = tiny(XFreqGS)
    fit = model.fit(dataset, Budget(10), 0)
    next(fit)
    field = field_of(model)
    if parameter:
        field.get_parameter(parameter).data.view(-1)[:3] = torch.nan
    else:
        monkeypatch.setattr(view.Targets, "maps", lambda self, nth, part: torch.full((8, 6, 24), torch.nan))
    before = {name: value.clone() for name, value in field.named_parameters()}
    with pytest.raises(DivergenceError, match=f"{tensor} is not finite at step 2") as raised:
        fit.send(0.1)
    assert (raised.value.step, raised.value.tensor) == (2, tensor)
    for name, value in field.named_parameters():
        torch.testing.assert_close(value, before[name], rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"device": "cuda"}, r"device=cuda is asked for, but torch .* sees no CUDA device"),
        ({"device": "gpu"}, "'gpu' is no device of torch; use cpu, cuda"),
        ({"max_gaussians": 20}, "num_gaussians=30 is more than max_gaussians=20"),
        ({"ssim_window": 7}, "ssim_window=7 is more than the 6 rows"),
    ],
    ids=str,
)
def test_options_that_cannot_be_are_refused_before_any_work(
    options: dict[str, object], words: str, dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(MethodError, match=words):
        next(tiny(XFreqGS, **options).fit(dataset, Budget(1), 0))


@pytest.mark.parametrize("options", [["blend=auto"], ["aided=true"]])
def test_what_has_no_predictors_to_blend_with_says_so(options: list[str]) -> None:
    with pytest.raises(MethodError, match="GSRF has no trivial predictors to blend with"):
        build_method("gsrf", options)


def test_without_a_row_that_has_a_path_there_is_nothing_to_learn(tmp_path: Path) -> None:
    silent = write_dataset(tmp_path / "silent.h5", 1, (1.0, 10.0), silent=((0, 0), (0, 1)))
    with pytest.raises(MethodError, match="No training row has a path"):
        next(tiny(XFreqGS).fit(silent, Budget(1), 0))


def test_a_method_that_was_not_fitted_says_so(tmp_path: Path) -> None:
    for use in (lambda: tiny(XFreqGS).save(tmp_path), lambda: tiny(XFreqGS).predict(np.zeros((1, 3)), np.ones(1))):
        with pytest.raises(MethodError, match="XFreqGS knows nothing yet; fit or load it first"):
            use()


@every_method
def test_maps_change_with_the_carrier_inside_the_band_alone_and_only_where_it_is_seen(
    method: type[LearnedMethod], dataset: PasDataset
) -> None:
    model = tiny(method)
    trained(model, dataset, 5)
    low_hz, high_hz = dataset.carrier_hz.min(), dataset.carrier_hz.max()
    carrier_hz = np.array([low_hz / 20, low_hz, 10e9, high_hz, high_hz * 20])
    maps = model.predict(dataset.tx_position_m[:1].repeat(5, axis=0), carrier_hz)
    # rows of one batch are rounded apart; what a carrier changes is far above that
    if method is not Wideband3DGS:  # which sees carriers as they are
        np.testing.assert_allclose(maps[0], maps[-1], atol=1e-5)  # both are taken for the middle of the band
    assert (np.ptp(maps, axis=0).max() < 1e-5) == (method in BLIND)


def test_carriers_of_a_narrow_band_are_told_apart() -> None:
    scaling = Scaling()
    carrier_hz = torch.tensor([24.25e9, 24.25e9 + 1e4], dtype=torch.float64)
    scaling.log_band.copy_(carrier_hz.log())
    told = scaling.unit_carrier(carrier_hz)[:, 0]
    # float64 keeps 4e-15 of a logarithm of 24, of a band of 4e-7
    torch.testing.assert_close(told, torch.tensor([-1.0, 1.0]), rtol=0, atol=1e-6)


def test_gaussians_out_of_view_never_reach_the_network(dataset: PasDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    pairwise = {"network": "pairwise", "band": False, "move_from": 0.0, "averaging": 0.0}
    model = tiny(XFreqGS, angular_size_deg=2.0, **pairwise)
    trained(model, dataset, 1)
    field, asked = field_of(model), []
    field.gaussians.position_m.data[:11, 2] = -5.0  # far below the horizon
    ask = field.network.forward
    monkeypatch.setattr(field.network, "forward", lambda *args: asked.append(args[2]) or ask(*args))
    part = GridView(30, 7, 11)
    grid = part.of_grid(dataset.grid)
    tx_position_m = torch.zeros(2, 3)
    with torch.no_grad():
        field.power(tx_position_m, torch.full((2,), 1e9, dtype=torch.float64), part, model._training.beams)
        seen = project(field.gaussians.position_m, field.gaussians.covariance)
    centre = torch.stack([seen.azimuth_rad, seen.elevation_rad], dim=-1)
    direction = torch.stack(
        torch.meshgrid(torch.as_tensor(grid.azimuth_rad), torch.as_tensor(grid.elevation_rad), indexing="ij"), -1
    ).reshape(-1, 2)
    offset = direction[None].float() - centre[:, None]
    offset[..., 0] = torch.atan2(offset[..., 0].sin(), offset[..., 0].cos())
    distance = torch.einsum("nki,nij,nkj->nk", offset, torch.linalg.inv(seen.covariance), offset)
    reached = (distance <= field._support).any(dim=1)
    assert 0 < int(reached.sum()) < 19
    assert torch.equal(asked[0], field.gaussians.position_m.detach()[reached])


def test_a_fit_broken_off_in_a_step_ends_in_the_predictions_of_an_unbroken_one(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the checkpoint of the step before; `test_checkpoints` kills the process of a fit."""
    options = {**TINY, **DIVIDING, "densify_every": 8}
    overrides = tuple(f"{name}={value}" for name, value in options.items())
    job = lofo_job(dataset, "xfreq-gs", "lofo-10GHz", overrides=overrides, budget=Budget(max_steps=40))
    unbroken = run_job(job, tmp_path / "unbroken")
    monkeypatch.setattr(checkpoints, "CHECKPOINT_SECONDS", 0.0)
    compute, steps = learned.map_loss, count(1)

    def broken_off(*given: object) -> torch.Tensor:
        if next(steps) > 20:
            raise KeyboardInterrupt
        return compute(*given)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(learned, "map_loss", broken_off)
        run_job(job, tmp_path)
    resumed = run_job(job, tmp_path)
    assert maps(tmp_path, resumed) == maps(tmp_path / "unbroken", unbroken)
    assert curve(resumed) == curve(unbroken)
    assert (resumed.step, resumed.counts) == (40, unbroken.counts)
    assert resumed.counts["gaussians"] != TINY["num_gaussians"]


def test_rates_fall_for_an_optimiser_that_a_step_begins_anew(dataset: PasDataset) -> None:
    method = tiny(XFreqGS)
    training = method.started(dataset, seed=0)
    loss_of = method.batch_loss

    def renewing(training: learned.Training, targets: view.Targets) -> torch.Tensor:
        training.optimizer = method.new_optimizer(training.field)
        return loss_of(training, targets)

    method.batch_loss = renewing  # type: ignore[method-assign]
    training.share = 0.5
    method._step(training, view.Targets(dataset, training.beams))
    rates = [group["lr"] / group["initial_lr"] for group in training.optimizer.param_groups]
    assert rates == pytest.approx([0.505] * len(rates))
