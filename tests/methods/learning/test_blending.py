"""Learned maps blended with those of trivial predictors, by weights that are chosen on held-out training rows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from xfreqbench.baselines.trivial import TRIVIAL
from xfreqbench.baselines.xfreq_gs import XFreqGS, XFreqGSConfig

from tests.support.synthetic import write_dataset
from tests.support.training import TINY, predicted, reloaded, trained
from xfreqbench.data.dataset import PasDataset, Rows
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning import blending
from xfreqbench.methods.learning.blending import KINDS, LEARNED, Blend, Choice, Holdout
from xfreqbench.methods.lookup import TransmitterLookup
from xfreqbench.methods.splatting.field import SplatField

pytestmark = pytest.mark.usefixtures("one_thread")

CARRIERS_GHZ = (1.0, 5.0, 10.0, 37.0)
NOISE = np.random.default_rng(0).random((64, 90, 360), dtype=np.float32)
FAR = {LEARNED: 1 / 3, "LineOfSight": 1 / 2, "MeanOverFrequency": 1 / 6}
WEIGHTS = ((2e9, 0.25), (8e9, 1.0))


@pytest.fixture(scope="module")
def train(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("data") / "data.h5", 40, CARRIERS_GHZ, silent=((0, 1),))


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return write_dataset(tmp_path_factory.mktemp("many") / "data.h5", 200, (5.0, 10.0, 37.0))


@pytest.fixture(scope="module")
def holdout(train: PasDataset) -> Holdout:
    return Holdout.draw(train, 0)[-1]


def told(maps: np.ndarray) -> Callable[..., np.ndarray]:
    return lambda tx_position_m, carrier_hz: maps[: len(carrier_hz)]


def truth_of(train: PasDataset) -> Callable[..., np.ndarray]:
    """A learned method that knows everything."""

    def predict(tx_position_m: np.ndarray, carrier_hz: np.ndarray) -> np.ndarray:
        asked = np.column_stack([tx_position_m, carrier_hz])
        known = np.column_stack([train.tx_position_m, train.carrier_hz])
        return train.pas(np.array([np.flatnonzero((known == one).all(axis=1))[0] for one in asked]))

    return predict


def beside_line_of_sight(weight: float, carrier_hz: float | None = None) -> Choice:
    return Choice(weights={LEARNED: weight, "LineOfSight": 1 - weight}, carrier_hz=carrier_hz)


def at(kind: str, carrier_hz: float) -> str:
    """The name of a choice for a held-out carrier."""
    return f"{kind} at {carrier_hz / 1e9:g} GHz"


def test_one_carrier_inside_the_band_and_some_transmitters_are_held_out(train: PasDataset, holdout: Holdout) -> None:
    (held_out_hz,) = set(np.unique(train.carrier_hz)) - set(train.carrier_hz[holdout.left])
    assert held_out_hz in {5e9, 10e9}
    unheard, unseen, both = at(KINDS[0], held_out_hz), KINDS[1], at(KINDS[2], held_out_hz)
    assert set(holdout.rows) == {unheard, unseen, both}
    transmitters = {kind: set(train.tx_index[rows]) for kind, rows in holdout.rows.items()}
    assert set(train.carrier_hz[holdout.rows[unheard]]) == set(train.carrier_hz[holdout.rows[both]]) == {held_out_hz}
    assert held_out_hz not in train.carrier_hz[holdout.rows[unseen]]
    assert len(transmitters[unseen]) == 8  # a tenth would be too few
    assert transmitters[both] <= transmitters[unseen]
    assert not transmitters[unheard] & transmitters[unseen]
    assert not set(train.tx_index[holdout.left]) & transmitters[unseen]
    assert all(train.has_path[rows].all() for rows in holdout.rows.values())


def test_before_it_the_outermost_carriers_are_held_out(train: PasDataset, holdout: Holdout) -> None:
    early, _ = Holdout.draw(train, 0)
    assert early.until < holdout.until
    assert set(train.carrier_hz[early.left] / 1e9) == {5.0, 10.0}
    assert set(early.rows) == {at(kind, carrier_hz) for kind in KINDS[0:4:2] for carrier_hz in (1e9, 37e9)}
    for kind, rows in early.rows.items():
        assert set(train.carrier_hz[rows] / 1e9) == {float(kind.split()[-2])}


@pytest.mark.parametrize(
    ("carriers_ghz", "number"), [((1, 2), 0), ((1, 2, 3), 1), ((1, 2, 3, 5, 7), 2), (range(1, 11), 3)]
)
def test_of_more_carriers_more_are_held_out_the_lowest_and_the_highest_too(
    tmp_path: Path, carriers_ghz: Sequence[float], number: int
) -> None:
    data = write_dataset(tmp_path / "data.h5", 12, tuple(map(float, carriers_ghz)))
    last = Holdout.draw(data, 3)[-1]
    gone = sorted({*carriers_ghz} - set((data.carrier_hz[last.left] / 1e9).tolist()))
    assert len(gone) == number
    assert number < 2 or gone[0] == carriers_ghz[1]
    assert number < 3 or gone[-1] == carriers_ghz[-2]


def test_the_same_seed_holds_out_the_same_rows(train: PasDataset, holdout: Holdout) -> None:
    again, other = (Holdout.draw(train, seed)[-1].rows for seed in (0, 1))
    assert set(again) == set(holdout.rows)
    assert all(np.array_equal(again[kind], rows) for kind, rows in holdout.rows.items())
    assert any(not np.array_equal(other.get(kind, []), rows) for kind, rows in holdout.rows.items())


def test_where_nothing_can_be_held_out_other_carriers_have_mostly_and_other_places_only_the_line_of_sight(
    tmp_path: Path,
) -> None:
    few = write_dataset(tmp_path / "few.h5", 6, (10.0,))
    (drawn,) = Holdout.draw(few, 0)
    assert len(drawn.left) == len(few)
    choices = Blend.chosen(TRIVIAL, few, drawn, truth_of(few)).choices
    assert choices == {KINDS[0]: beside_line_of_sight(0.25), KINDS[1]: Choice(weights={"LineOfSight": 1.0})}
    assert_mixed(few, choices, (5e9, 94e9), {LEARNED: 0.25, "LineOfSight": 0.75})


def test_a_method_that_knows_the_truth_is_left_alone(train: PasDataset, holdout: Holdout) -> None:
    blend = Blend.chosen(TRIVIAL, train, holdout, truth_of(train))
    assert set(blend.choices) == set(holdout.rows)
    assert all(choice.weights == {LEARNED: 1} for choice in blend.choices.values())


def test_a_method_that_knows_nothing_gives_way_to_trivial_predictors(train: PasDataset, holdout: Holdout) -> None:
    blend = Blend.chosen(TRIVIAL, train, holdout, told(NOISE))
    assert set(blend.choices) == set(holdout.rows)
    assert not any(LEARNED in choice.weights for choice in blend.choices.values())
    query = train.tx_position_m[:1], np.array([20e9])
    weights = next(choice.weights for kind, choice in blend.choices.items() if kind.startswith(KINDS[0] + " at "))
    mean = np.zeros((1, *train.grid.shape), np.float32)
    for predictor in TRIVIAL:
        alone = predictor()
        next(iter(alone.fit(train[train.has_path], Budget(), 0)))
        mean += weights.get(predictor.__name__, 0) * alone.predict(*query)
    np.testing.assert_allclose(blend.maps(NOISE[:1], *query), mean / mean.max(), atol=1e-6)


def test_maps_that_are_right_in_one_half_each_are_mixed_half_and_half(train: PasDataset, holdout: Holdout) -> None:
    halves: list[type] = []
    for nth in range(2):

        class Half(TransmitterLookup):
            first = nth

            def predict(self, tx_position_m: np.ndarray, carrier_hz: np.ndarray) -> np.ndarray:
                maps = truth_of(train)(tx_position_m, carrier_hz)
                middle = maps.shape[1] // 2
                maps[:, slice(middle) if self.first else slice(middle, None)] = 0
                every = train.grid.shape[0] // self.transmitters.train.grid.shape[0]
                return maps[:, ::every, ::every]

        Half.__name__ = f"Half{nth}"
        halves.append(Half)
    choices = Blend.chosen(halves, train, holdout, told(NOISE)).choices
    assert all(choice.weights == {"Half0": 0.5, "Half1": 0.5} for choice in choices.values())


def test_transmitters_whose_sight_is_obscured_have_weights_of_their_own(train: PasDataset, holdout: Holdout) -> None:
    """The line of sight and the mean are right where the sight is clear, the learned maps where it is obscured.

    A predictor is asked for a map once, though it says where the sight is clear and has a share of the maps too.
    """
    asked: list[tuple[object, ...]] = []
    truth, is_clear = truth_of(train), dict(zip(train.tx_position_m[:, 0], train.tx_index % 2 == 0, strict=True))

    def right_where(sight: bool, flip: int) -> Callable[..., np.ndarray]:
        def predict(tx_position_m: np.ndarray, carrier_hz: np.ndarray) -> np.ndarray:
            is_right = np.array([is_clear[x] == sight for x in tx_position_m[:, 0]])[:, None, None]
            maps = truth(tx_position_m, carrier_hz)
            return np.where(is_right, maps, np.flip(maps, flip))

        return predict

    class LineOfSight(TransmitterLookup):
        right = staticmethod(right_where(True, flip=2))

        def predict(self, tx_position_m: np.ndarray, carrier_hz: np.ndarray) -> np.ndarray:
            asked.extend((type(self), *query) for query in zip(tx_position_m[:, 0], carrier_hz, strict=True))
            every = train.grid.shape[0] // self.transmitters.train.grid.shape[0]
            return self.right(tx_position_m, carrier_hz)[:, ::every, ::every]

    class MeanOverFrequency(LineOfSight):
        right = staticmethod(right_where(True, flip=1))

    blend = Blend.chosen((LineOfSight, MeanOverFrequency), train, holdout, right_where(False, flip=1))
    (choice,) = (choice for kind, choice in blend.choices.items() if kind.startswith(KINDS[0] + " at "))
    assert LEARNED not in choice.weights
    assert choice.obscured == {LEARNED: 1}
    at_held_out = train[(train.carrier_hz == choice.carrier_hz) & train.has_path]
    query = at_held_out.tx_position_m, at_held_out.carrier_hz
    asked.clear()
    np.testing.assert_allclose(blend.maps(right_where(False, 1)(*query), *query), at_held_out.pas(), atol=1e-6)
    assert len(asked) == len(set(asked)) == 2 * len(at_held_out)


def test_a_choice_reads_each_map_once(train: PasDataset, holdout: Holdout, monkeypatch: pytest.MonkeyPatch) -> None:
    read, stored = [], PasDataset.pas

    def noted(data: PasDataset, rows: Rows = slice(None)) -> np.ndarray:
        read.extend(data.rows[rows])
        return stored(data, rows)

    monkeypatch.setattr(PasDataset, "pas", noted)
    Blend.chosen(TRIVIAL, train, holdout, told(NOISE))
    assert 0 < len(read) == len(set(read)) <= len(train)


def assert_mixed(
    train: PasDataset,
    choices: dict[str, Choice],
    carriers_hz: Collection[float],
    weights: dict[str, float],
    tx_position_m: np.ndarray | None = None,
    flat: float = 1.0,
) -> None:
    """Maps of a transmitter, a seen one if None, are the mean with these weights; learned are flat ones, or in part.

    What is not flat of the learned maps is the line of sight's.
    """
    known = {predictor.__name__: predictor() for predictor in TRIVIAL}
    for predictor in known.values():
        next(iter(predictor.fit(train[train.has_path], Budget(), 0)))
    blend = Blend(TRIVIAL, train, choices)
    tx_position_m = train.tx_position_m[0] if tx_position_m is None else tx_position_m
    for carrier_hz in carriers_hz:
        query = tx_position_m[None], np.array([carrier_hz])
        maps = {name: predictor.predict(*query) for name, predictor in known.items()}
        maps[LEARNED] = learned = np.asarray(flat + (1 - flat) * maps["LineOfSight"], np.float32)
        mixed = sum(weight * maps[name] for name, weight in weights.items())
        np.testing.assert_allclose(blend.maps(learned, *query), mixed / mixed.max(), atol=1e-6)


def test_between_held_out_carriers_maps_are_means_of_their_choices_and_beyond_them_the_outermosts(
    train: PasDataset,
) -> None:
    chosen = {at(KINDS[0], carrier_hz): beside_line_of_sight(weight, carrier_hz) for carrier_hz, weight in WEIGHTS}
    for carrier_hz, weight in ((1e9, 0.25), (2e9, 0.25), (4e9, 0.625), (8e9, 1.0), (37e9, 1.0)):
        assert_mixed(train, chosen, (carrier_hz,), beside_line_of_sight(weight).weights)


def test_an_octave_above_the_band_no_carrier_chooses_any_more(train: PasDataset) -> None:
    chosen = {at(KINDS[0], 1e9): Choice(weights={"Nearest": 1.0}, carrier_hz=1e9)}
    half = {"Nearest": 1 / 2} | {name: weight / 2 for name, weight in FAR.items()}
    assert_mixed(train, chosen, (1e9, 10e9, 37e9), {"Nearest": 1.0})
    assert_mixed(train, chosen, (37e9 * 2**0.5,), half)
    assert_mixed(train, chosen, (74e9, 94e9), FAR)


@pytest.mark.parametrize(("clear_from", "weights"), [(-2.0, (1 / 8, 1 / 4, 5 / 8)), (2.0, (1 / 4, 5 / 8, 1 / 8))])
def test_an_octave_below_the_band_the_sight_of_a_transmitter_chooses(
    train: PasDataset, monkeypatch: pytest.MonkeyPatch, clear_from: float, weights: tuple[float, ...]
) -> None:
    monkeypatch.setattr(blending, "_CLEAR", (clear_from, clear_from + 0.1))
    chosen = {at(KINDS[0], 1e9): Choice(weights={"Nearest": 1.0}, carrier_hz=1e9)}
    below = dict(zip((LEARNED, "LineOfSight", "MeanOverFrequency"), weights, strict=True))
    half = {"Nearest": 1 / 2} | {name: weight / 2 for name, weight in below.items()}
    assert_mixed(train, chosen, (1e9 / 2**0.5,), half)
    assert_mixed(train, chosen, (0.1e9, 0.5e9), below)


def test_far_from_all_known_transmitters_nothing_that_is_held_out_chooses_any_more(train: PasDataset) -> None:
    receiver_m, known_m = np.array(train.header.receiver.position_m), np.unique(train.tx_position_m, axis=0)
    spacing_m = np.median(KDTree(known_m).query(known_m, k=2)[0][:, 1])
    outermost_m = known_m[np.linalg.norm(known_m - receiver_m, axis=1).argmax()]
    outwards = (outermost_m - receiver_m) / np.linalg.norm(outermost_m - receiver_m)
    chosen = {KINDS[1]: Choice(weights={"Nearest": 1.0})}
    half = {"Nearest": 1 / 2} | {name: weight / 2 for name, weight in FAR.items()}
    for spacings, weights in ((0.9, {"Nearest": 1.0}), (1.2, half), (1.5, FAR), (50.0, FAR)):
        asked_m = outermost_m + spacings * spacing_m * outwards
        assert_mixed(train, chosen, (10e9, 20e9), weights, asked_m, flat=0.01)
    behind_m = receiver_m - 50 * spacing_m * outwards
    nearest = known_m[KDTree(known_m).query(behind_m)[1]] - receiver_m
    assert nearest @ outwards > -np.cos(np.radians(10)) * np.linalg.norm(nearest)  # in another direction
    assert_mixed(train, chosen, (10e9, 94e9), {LEARNED: 1 / 4, "LineOfSight": 3 / 4}, behind_m, flat=0.01)
    assert_mixed(train, chosen, (10e9, 94e9), {"LineOfSight": 1.0}, behind_m)  # learned maps are unlike it


def test_while_the_outermost_carriers_are_held_out_they_are_beyond_the_band(train: PasDataset) -> None:
    model = XFreqGS(XFreqGSConfig(**{**TINY, "blend": "auto"}))
    fit = model.fit(train, Budget(max_steps=100), 0)
    for step, expected_ghz in ((lambda: next(fit), (5, 10)), (lambda: fit.send(0.3), (1, 37))):
        step()
        field = model._training.predictor
        assert isinstance(field, SplatField)
        heard_hz = field.scaling.log_band.exp()
        np.testing.assert_allclose(heard_hz / 1e9, expected_ghz)
        # a trend that is learned on a part of the axis would be far too large in the whole of it
        np.testing.assert_allclose(field.scaling.root_carrier(heard_hz)[:, 0], (-1, 1), atol=1e-6)


def test_every_kind_of_query_has_its_own_weight(train: PasDataset) -> None:
    weights = dict(zip(KINDS, (0.25, 0.5, 0.75), strict=True))
    choices = {kind: beside_line_of_sight(weight) for kind, weight in weights.items()}
    seen_m, unseen_m = train.tx_position_m[0], train.tx_position_m[0] + 0.1
    for tx_m, carriers_hz, kind in (
        (seen_m, (20e9, 10e9), KINDS[0]),  # 10 GHz is seen too, though perhaps not together
        (unseen_m, (10e9,), KINDS[1]),
        (unseen_m, (20e9,), KINDS[2]),
    ):
        assert_mixed(train, choices, carriers_hz, beside_line_of_sight(weights[kind]).weights, tx_m)


def test_a_blended_fit_goes_on_from_its_files_as_if_it_had_never_stopped(many: PasDataset, tmp_path: Path) -> None:
    """Stopped after carriers beyond the band have their choice, and again when all have."""
    unbroken, broken = (XFreqGS(XFreqGSConfig(**{**TINY, "blend": "auto"})) for _ in range(2))
    losses = trained(unbroken, many, 12)
    seen = trained(broken, many, 4, end=12)
    assert at(KINDS[0], 37e9) in broken.findings()["blend"]
    assert KINDS[1] not in broken.findings()["blend"]
    for number, end in ((9, 12), (12, None)):
        resumed = reloaded(broken, tmp_path / f"saved{number}")
        assert np.array_equal(predicted(resumed, many), predicted(broken, many))
        seen += trained(resumed, many, number, end)
        broken = resumed
        assert broken.findings() == unbroken.findings()
    assert seen == losses
    assert np.array_equal(predicted(broken, many), predicted(unbroken, many))
