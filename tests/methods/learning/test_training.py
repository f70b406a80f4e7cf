"""The learned methods train, stop and go on: tiny ones, on plane waves."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from xfreqbench.baselines.aperture_gs import ApertureGS
from xfreqbench.baselines.fixed_frequency_gs import FixedFrequencyGS
from xfreqbench.baselines.frequency_embedded_gs import FrequencyEmbeddedGS
from xfreqbench.baselines.xfreq_gs import XFreqGS
from xfreqbench.baselines.xfreq_gs_paper import XFreqGSPaper

from tests.support.descent import curve, killed_after_three_checkpoints, maps
from tests.support.stub_methods import run_job
from tests.support.synthetic import write_dataset
from tests.support.training import DIVIDING, TINY, predicted, reloaded, trained
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning import targets as view
from xfreqbench.methods.learning import training as learned
from xfreqbench.methods.learning.encoding import Scaling
from xfreqbench.methods.learning.targets import GridView
from xfreqbench.methods.learning.training import LearnedMethod
from xfreqbench.methods.splatting.field import SplatField
from xfreqbench.methods.splatting.projection import project
from xfreqbench.runs import checkpoints
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.records import Job

pytestmark = pytest.mark.usefixtures("one_thread")

SPLATTING = [XFreqGS, XFreqGSPaper, FixedFrequencyGS, FrequencyEmbeddedGS]
METHODS = [*SPLATTING, ApertureGS]
NUM_KILLED_STEPS = 150
every_method = pytest.mark.parametrize("method", METHODS)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=6)


def tiny(method: type[LearnedMethod], **options: Any) -> LearnedMethod:
    of_method = {"ssim_window": 3, "angular_size_deg": 6.0} if method is XFreqGSPaper else {}
    return method(method.Config(**{**TINY, **of_method, **options}))


def field_of(method: LearnedMethod) -> SplatField:
    assert method._training is not None
    assert isinstance(method._training.field, SplatField)
    return method._training.field


@every_method
def test_sixty_steps_lower_the_loss(method: type[LearnedMethod], dataset: PasDataset) -> None:
    model = tiny(method, ssim_weight=0.0, learning_rate=0.01)
    losses = [point.loss for point in trained(model, dataset, 60)]
    assert np.mean(losses[-10:]) < 0.85 * np.mean(losses[:10])  # the worst of eight seeds came to 0.78


def test_a_fit_makes_the_steps_of_torchs_adam_without_importing_its_compiler(dataset: PasDataset) -> None:
    code = f"""
import sys, torch
from xfreqbench.baselines.xfreq_gs import XFreqGS
from xfreqbench.data.dataset import open_dataset
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.learning.training import Adam
fit_within(XFreqGS(XFreqGS.Config(**{TINY})), open_dataset({str(dataset.path)!r}), Budget(max_steps=2), 0)
assert "torch._dynamo" not in sys.modules
ours, theirs = (torch.nn.Parameter(torch.linspace(-1, 1, 9)) for _ in range(2))
for parameter, kind in ((ours, Adam), (theirs, torch.optim.Adam)):
    optimizer = kind([{{"params": [parameter], "lr": 0.1}}], fused=True)
    for _ in range(3):
        parameter.grad = parameter.detach() ** 2 - 0.1
        optimizer.step()
assert torch.equal(ours, theirs)
"""
    subprocess.run([sys.executable, "-c", code], check=True)


@every_method
def test_maps_lie_between_zero_and_a_peak_of_one(method: type[LearnedMethod], dataset: PasDataset) -> None:
    model = tiny(method)
    trained(model, dataset, 2)
    maps = predicted(model, dataset)
    assert (maps.dtype, maps.shape) == (np.float32, (6, 90, 360))
    np.testing.assert_allclose(maps.max(axis=(1, 2)), 1, rtol=1e-6)
    assert maps.min() >= 0


@every_method
def test_a_fit_goes_on_from_its_files_as_if_it_had_never_stopped(
    method: type[LearnedMethod], dataset: PasDataset, tmp_path: Path
) -> None:
    options = DIVIDING if method in SPLATTING else {}
    unbroken, broken = tiny(method, **options), tiny(method, **options)
    losses = trained(unbroken, dataset, 20)
    before = trained(broken, dataset, 11, end=20)
    resumed = reloaded(broken, tmp_path / "saved")
    assert resumed.config == broken.config
    assert resumed.num_parameters == broken.num_parameters
    assert np.array_equal(predicted(resumed, dataset), predicted(broken, dataset))
    assert [*before, *trained(resumed, dataset, 20)] == losses
    assert np.array_equal(predicted(resumed, dataset), predicted(unbroken, dataset))
    if method in SPLATTING:
        assert before[-1].counts["gaussians"] != TINY["num_gaussians"] != losses[-1].counts["gaussians"]


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
        assert model._training is not None and model._training.mean is not None
        num_averaged.append(int(model._training.mean.n_averaged))
        if progress.step == 4:
            break
    assert num_averaged == [1, 2, 1, 2]


@pytest.mark.parametrize("method", SPLATTING)
def test_a_fit_that_never_divides_its_gaussians_goes_on_too(
    method: type[LearnedMethod], dataset: PasDataset, tmp_path: Path
) -> None:
    model = tiny(method, densify_every=0)
    trained(model, dataset, 2)
    assert np.array_equal(predicted(reloaded(model, tmp_path / "saved"), dataset), predicted(model, dataset))


def test_without_a_budget_a_fit_goes_on_at_its_share_of_its_own_steps(dataset: PasDataset, tmp_path: Path) -> None:
    unbroken, broken = (tiny(ApertureGS, steps=12) for _ in range(2))
    losses = [point.loss for point in unbroken.fit(dataset, Budget(), 0)]
    fit = broken.fit(dataset, Budget(), 0)
    before = [next(fit).loss for _ in range(7)]
    resumed = reloaded(broken, tmp_path / "saved")
    assert [*before, *(point.loss for point in resumed.fit(dataset, Budget(), 0))] == losses
    assert np.array_equal(predicted(resumed, dataset), predicted(unbroken, dataset))


@every_method
def test_predicting_and_saving_leave_the_fit_as_it_was(
    method: type[LearnedMethod], dataset: PasDataset, tmp_path: Path
) -> None:
    options = DIVIDING if method in SPLATTING else {}
    watched, alone = tiny(method, **options), tiny(method, **options)
    budget, seen = Budget(8), []
    fit = watched.fit(dataset, budget, 0)
    for point in fit:
        seen.append(point)
        predicted(watched, dataset)
        watched.save(tmp_path)
        if point.step == 8:
            break
    unwatched = []
    for point in alone.fit(dataset, budget, 0):
        unwatched.append(point)
        if point.step == 8:
            break
    assert seen == unwatched


@every_method
def test_another_seed_is_another_fit_and_the_same_one_the_same(
    method: type[LearnedMethod], dataset: PasDataset
) -> None:
    losses = [[point.loss for point in trained(tiny(method), dataset, 3, seed=seed)] for seed in (0, 0, 1)]
    assert losses[0] == losses[1] != losses[2]


def test_files_hold_tensors_and_json_alone(dataset: PasDataset, tmp_path: Path) -> None:
    model = tiny(XFreqGS)
    trained(model, dataset, 2)
    model.save(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.json", "state.safetensors"]
    assert json.loads((tmp_path / "state.json").read_text())["step"] == 2


def test_xfreq_gs_learns_places_turns_and_sizes_and_shows_them(dataset: PasDataset) -> None:
    model = tiny(XFreqGS)
    start = model.started(dataset, 0).field
    trained(model, dataset, 20)
    assert model._training is not None
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


def test_a_target_that_is_not_finite_ends_the_fit_before_it_spoils_parameters(
    dataset: PasDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = tiny(XFreqGS)
    fit = model.fit(dataset, Budget(10), 0)
    next(fit)
    before = {name: value.clone() for name, value in field_of(model).named_parameters()}
    monkeypatch.setattr(view.Targets, "maps", lambda self, nth, part: torch.full((8, 6, 24), torch.nan))
    with pytest.raises(DivergenceError, match="loss is not finite at step 2") as raised:
        fit.send(0.1)
    assert (raised.value.step, raised.value.tensor) == (2, "loss")
    for name, value in field_of(model).named_parameters():
        assert torch.equal(value, before[name]), name


@pytest.mark.parametrize(
    ("parameter", "tensor"),
    [
        ("network.head.bias", "loss"),  # every map is nan
        ("gaussians.position_m", "gradient of gaussians.position_m"),  # no direction sees that Gaussian
    ],
)
def test_a_parameter_that_is_not_finite_ends_the_fit_before_it_spoils_the_others(
    dataset: PasDataset, parameter: str, tensor: str
) -> None:
    model = tiny(XFreqGS)
    fit = model.fit(dataset, Budget(10), 0)
    next(fit)
    field = field_of(model)
    field.get_parameter(parameter).data.view(-1)[:3] = torch.nan
    before = {name: value.clone() for name, value in field.named_parameters()}
    with pytest.raises(DivergenceError) as raised:
        fit.send(0.1)
    assert (raised.value.step, raised.value.tensor) == (2, tensor)
    for name, value in field.named_parameters():
        torch.testing.assert_close(value, before[name], rtol=0, atol=0, equal_nan=True)


@every_method
def test_a_missing_device_is_told_before_any_work(method: type[LearnedMethod], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(MethodError, match=r"device=cuda is asked for, but torch .* sees no CUDA device"):
        tiny(method, device="cuda")


def test_a_device_that_torch_does_not_know_is_refused() -> None:
    with pytest.raises(MethodError, match="'gpu' is no device of torch; use cpu, cuda"):
        tiny(XFreqGS, device="gpu")


def test_more_gaussians_than_there_may_be_are_refused(dataset: PasDataset) -> None:
    with pytest.raises(MethodError, match="num_gaussians=30 is more than max_gaussians=20"):
        next(tiny(XFreqGS, max_gaussians=20).fit(dataset, Budget(1), 0))


def test_a_window_larger_than_what_is_in_view_is_refused(dataset: PasDataset) -> None:
    with pytest.raises(MethodError, match="ssim_window=7 is more than the 6 rows"):
        next(tiny(XFreqGS, ssim_window=7).fit(dataset, Budget(1), 0))


def test_without_a_row_that_has_a_path_there_is_nothing_to_learn(tmp_path: Path) -> None:
    silent = write_dataset(tmp_path / "silent.h5", 1, (1.0, 10.0), silent=((0, 0), (0, 1)))
    with pytest.raises(MethodError, match="No training row has a path"):
        next(tiny(XFreqGS).fit(silent, Budget(1), 0))


def test_a_method_that_was_not_fitted_says_so(tmp_path: Path) -> None:
    for use in (lambda: tiny(XFreqGS).save(tmp_path), lambda: tiny(XFreqGS).predict(np.zeros((1, 3)), np.ones(1))):
        with pytest.raises(MethodError, match="XFreqGS knows nothing yet; fit or load it first"):
            use()


@every_method
def test_only_a_fixed_frequency_method_gives_all_carriers_one_map(
    method: type[LearnedMethod], dataset: PasDataset
) -> None:
    model = tiny(method)
    trained(model, dataset, 5)
    carrier_hz = np.array([1e9, 10e9, 37e9, 80e9])
    across = np.ptp(model.predict(dataset.tx_position_m[:1].repeat(4, axis=0), carrier_hz), axis=0)
    # rows of one batch are rounded apart; what a carrier changes is far above that
    assert (across.max() < 1e-5) == (method is FixedFrequencyGS)


@every_method
def test_beyond_the_band_maps_are_those_of_its_outermost_carriers(
    method: type[LearnedMethod], dataset: PasDataset
) -> None:
    model = tiny(method)
    trained(model, dataset, 5)
    low_hz, high_hz = dataset.carrier_hz.min(), dataset.carrier_hz.max()
    tx_m = dataset.tx_position_m[:1].repeat(2, axis=0)
    beyond = model.predict(tx_m, np.array([low_hz / 20, high_hz * 20]))
    np.testing.assert_allclose(beyond, model.predict(tx_m, np.array([low_hz, high_hz])), atol=1e-5)


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
    predicted(model, dataset)
    (position_m,) = asked
    assert 0 < len(position_m) <= 19
    assert bool((position_m[:, 2] > -5).all())

    asked.clear()
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
    assert 0 < int(reached.sum()) < len(position_m)
    assert torch.equal(asked[0], field.gaussians.position_m.detach()[reached])


def killed_job(path: Path) -> Job:
    options = {**TINY, **DIVIDING, "densify_every": 20}
    return Job(
        str(path),
        "xfreqbench.baselines.xfreq_gs:XFreqGS",
        "lofo",
        "lofo-10GHz",
        overrides=tuple(f"{name}={value}" for name, value in options.items()),
        budget=Budget(max_steps=NUM_KILLED_STEPS),
    )


def fit_half(path: str, results: str) -> None:
    """What the process that is killed runs: half of the steps, saved at each, and then it waits for its end."""
    torch.set_num_threads(1)
    checkpoints.CHECKPOINT_SECONDS = 0.0
    compute, steps = learned.map_loss, count(1)
    learned.map_loss = lambda *args: (time.sleep(3600) if next(steps) > NUM_KILLED_STEPS / 2 else None, compute(*args))[
        1
    ]
    run_job(killed_job(Path(path)), Path(results))


def test_a_fit_killed_in_the_middle_ends_in_the_predictions_of_an_unbroken_one(
    dataset: PasDataset, tmp_path: Path
) -> None:
    unbroken = run_job(killed_job(dataset.path), tmp_path / "unbroken")
    results = tmp_path / "killed"
    call = f"fit_half({str(dataset.path)!r}, {str(results)!r})"
    code = f"from tests.methods.learning import test_training; test_training.{call}"
    folder = CheckpointFolder(results / "checkpoints" / unbroken.id, unbroken.id)
    saved = killed_after_three_checkpoints(code, folder)
    assert 3 <= saved.step < NUM_KILLED_STEPS

    resumed = run_job(killed_job(dataset.path), results)
    assert maps(results, resumed) == maps(tmp_path / "unbroken", unbroken)
    assert curve(resumed) == curve(unbroken)
    assert (resumed.step, resumed.counts) == (NUM_KILLED_STEPS, unbroken.counts)
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
