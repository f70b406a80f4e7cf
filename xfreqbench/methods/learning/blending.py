"""Blends learned maps with those of a trivial predictor, by weights that are chosen on validation rows of the training.

In the first half of a training one carrier and some transmitters are held out, as unseen ones will be. With them
the weights are chosen, for each kind of query; then the training goes on with all rows. Transmitters that are far from
all trained ones are a kind of their own: without trained neighbours, other predictors are the good ones. For them, the
transmitters of a whole region are held out in the first quarter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.validation import LEAST_VALIDATION_TX, inner_carriers_hz, validation_tx
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.coarse import CoarseDataset
from xfreqbench.methods.learning.mixing import STRIDE, WEIGHTS, Predict, mixed, similarities, similarities_by_weight
from xfreqbench.methods.lookup import TrainingTransmitters
from xfreqbench.types import FloatArray, IntArray, Maps

CHOOSE_AT, CHOOSE_FAR_AT = 0.5, 0.25  # shares of the budget after which weights are chosen
_LEAST_ROWS, _MOST_ROWS = 4, 48  # of each kind on which a weight is chosen, and most held-out transmitters
_LEAST_TX, _LEAST_TX_SHARE = 8, 4  # held out: so many, but no more than one of four
_FEW_TX, _FOLDS = 16, 5  # with fewer held out the choice is a cautious one
_ROUNDING = 1e-6  # of a standard error: a gain at one transmitter alone is as large as its error
_FAR = (1.5, 3.0)  # spacings of the training transmitters, beyond which one is far from them, and very far
_LEAST_SECONDS_FOR_FAR = 8.0  # of a budget: choices for far transmitters take one or two
_REGION_SHARE = 0.15  # of the transmitters
_PLACES = ("transmitter", "far transmitter", "very far transmitter")
BoolArray = NDArray[np.bool_]
KINDS = ("unseen carrier", *(kind for place in _PLACES for kind in (f"unseen {place}", f"unseen carrier and {place}")))


class Choice(BaseModel):
    """For a kind of query: the trivial predictor's name, and the weight of the learned maps beside it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    predictor: str
    weight: float


@dataclass(frozen=True, eq=False)
class Holdout:
    """Rows of a training that are held out until a share of the budget, by kind of query, and those that are left."""

    until: float
    left: IntArray
    rows: Mapping[str, IntArray]

    @classmethod
    def draw(cls, train: PasDataset, seed: int, seconds: float | None = None) -> list[Holdout]:
        """One carrier inside the band and a tenth of the transmitters, and before it a region too, the earliest first.

        They are the same for the same seed. Of few transmitters they are more than a tenth. `make_splits` with
        `on="validation"` chooses among the same carriers, and draws transmitters in the same way. Where too few
        transmitters of the region would be far from those that are left, it is not held out.
        """
        generator = np.random.default_rng(seed)
        is_carrier, inner_hz = np.zeros(len(train), bool), inner_carriers_hz(train)
        if len(inner_hz):
            is_carrier = train.carrier_hz == inner_hz[generator.integers(len(inner_hz))]
        least = max(LEAST_VALIDATION_TX, min(_LEAST_TX, len(np.unique(train.place_index)) // _LEAST_TX_SHARE))
        is_tx = np.isin(train.place_index, validation_tx(train, generator, _MOST_ROWS, least))

        def drawn(until: float, left: BoolArray, of_kinds: Mapping[str, BoolArray]) -> Holdout:
            rows = {
                kind: np.sort(generator.permutation(np.flatnonzero(of & train.has_path))[:_MOST_ROWS])
                for kind, of in of_kinds.items()
            }
            return cls(until, np.flatnonzero(left), rows)

        among = (is_carrier & ~is_tx, ~is_carrier & is_tx, is_carrier & is_tx)
        last = drawn(CHOOSE_AT, ~is_carrier & ~is_tx, dict(zip(KINDS[:3], among, strict=True)))
        is_unseen = is_tx | _is_in_region(train, generator)
        left = ~is_carrier & ~is_unseen
        if not left.any() or (seconds is not None and seconds < _LEAST_SECONDS_FOR_FAR):
            return [last]
        known = TrainingTransmitters(train.subset(np.flatnonzero(left)))
        reach = _reach(known, train.tx_position_m) * is_unseen
        far: dict[str, BoolArray] = {}
        for nth, kinds in ((2, KINDS[5:]), (1, KINDS[3:5])):
            if len(np.unique(train.tx_index[reach == nth])) < _LEAST_TX:  # a few transmitters say little
                reach[reach == nth] -= 1
            else:
                far |= dict(zip(kinds, ((reach == nth) & ~is_carrier, (reach == nth) & is_carrier), strict=True))
        return [drawn(CHOOSE_FAR_AT, left, far), last] if far else [last]


def _is_in_region(train: PasDataset, generator: np.random.Generator) -> Bool[NDArray[np.bool_], "N"]:
    """Whether each row is of one of the transmitters nearest to an outermost one on the floor.

    At the rim of the floor they are farther from the others than in the middle.
    """
    place_index, first = np.unique(train.place_index, return_index=True)
    place_m = train.tx_position_m[first, :2]
    outwards = 2 * np.pi * generator.random()
    outermost_m = place_m[np.argmax(place_m @ np.array([np.cos(outwards), np.sin(outwards)]))]
    away_m = np.linalg.norm(place_m - outermost_m, axis=1)
    nearest = np.argsort(away_m, kind="stable")[: int(_REGION_SHARE * len(place_index))]
    return np.isin(train.place_index, place_index[nearest])


def _reach(known: TrainingTransmitters, tx_position_m: Float[FloatArray, "B 3"]) -> Int[IntArray, "B"]:
    """0 where a transmitter has known ones beside it, 1 where it is far from all of them, 2 where it is very far."""
    return np.digitize(known.away_m(tx_position_m), np.array(_FAR) * known.spacing_m)


class Blend:
    """Trivial predictors that know the training rows, and a choice among them for each kind of query."""

    def __init__(self, predictors: Sequence[type], train: PasDataset, choices: Mapping[str, Choice]) -> None:
        self.choices, self.transmitters = choices, TrainingTransmitters(train)
        needed = {choice.predictor for choice in choices.values() if choice.weight < 1}
        self._predictors = {
            predictor.__name__: _knowing(predictor, train) for predictor in predictors if predictor.__name__ in needed
        }

    @classmethod
    def chosen(
        cls,
        predictors: Sequence[type],
        train: PasDataset,
        holdout: Holdout,
        predict: Predict,
        before: Mapping[str, Choice] = {},
    ) -> Blend:
        """For each kind of query the choice that is best on the held-out rows; `predict` gives the learned maps.

        `before` are the choices for other kinds, made earlier.

        A few held-out transmitters say little. Then the predictor is the one that is best at all training
        transmitters, a fifth of them unseen in turn, and the weight the smallest that is not worse than the best by
        more than the standard error of their difference.
        """
        coarse = CoarseDataset.of(train, STRIDE)
        left = coarse.subset(holdout.left)
        knowing = {predictor.__name__: _knowing(predictor, left).predict for predictor in predictors}
        choices = dict(before)
        for kind, of_kind in holdout.rows.items():
            if len(of_kind) < _LEAST_ROWS:
                continue
            rows = coarse.subset(of_kind)
            are_few = len(np.unique(rows.tx_index)) < _FEW_TX
            known = knowing
            if are_few and kind in KINDS[1:3]:
                unseen_hz = rows.carrier_hz[0] if kind == KINDS[2] else None
                name = _best_at_unseen(predictors, coarse, unseen_hz)
                known = {name: knowing[name]}
            choices[kind] = _best(rows, predict, known, is_cautious=are_few)
        return cls(predictors, train, choices)

    def maps(self, learned: Maps, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Maps:
        """Learned maps of some queries, blended by the choice for the kind of each."""
        blended = learned.copy()
        for nth, chosen in enumerate(self._of_kinds(tx_position_m, carrier_hz)):
            choice = self._choice(nth)
            if choice is None or choice.weight == 1 or not chosen.any():
                continue
            trivial = self._predictors[choice.predictor].predict(tx_position_m[chosen], carrier_hz[chosen])
            blended[chosen] = mixed(choice.weight, learned[chosen], trivial)
        return blended

    def _choice(self, nth: int) -> Choice | None:
        """The choice for a kind; where far transmitters have none, that for nearer ones."""
        nearer = range(nth, 0, -2) if nth else [0]
        return next((self.choices[KINDS[kind]] for kind in nearer if KINDS[kind] in self.choices), None)

    def _of_kinds(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> tuple[Bool[NDArray[np.bool_], "B"], ...]:
        """Which queries are of each kind; those of seen transmitters and carriers are as those of unseen carriers."""
        is_known = self.transmitters.knows(tx_position_m)
        is_heard = np.isin(carrier_hz, self.transmitters.carrier_hz)
        reach = _reach(self.transmitters, tx_position_m)
        of_places = [~is_known & (reach == nth) for nth in range(len(_PLACES))]
        return is_known, *(rows for of in of_places for rows in (of & is_heard, of & ~is_heard))


def _knowing(predictor: type, train: PasDataset) -> Any:
    """A trivial predictor that knows the training rows that have a path."""
    made = predictor()
    for _ in made.fit(train.subset(train.has_path), Budget(), 0):
        pass
    return made


def _best_at_unseen(predictors: Sequence[type], train: PasDataset, unseen_hz: float | None) -> str:
    """The predictor with the highest SSIM at the transmitters of a training, a fifth of them unseen in turn.

    With `unseen_hz` it is that at this carrier, which is unseen too.
    """
    place_index = np.unique(train.place_index)
    is_carrier = np.ones(len(train), bool) if unseen_hz is None else train.carrier_hz == unseen_hz
    is_known = is_carrier if unseen_hz is None else ~is_carrier
    sums = dict.fromkeys((predictor.__name__ for predictor in predictors), 0.0)
    for fold in range(_FOLDS):
        is_unseen = np.isin(train.place_index, place_index[fold::_FOLDS])
        rows = train.subset(is_unseen & is_carrier & train.has_path)
        left = train.subset(~is_unseen & is_known)
        if not (len(rows) and left.has_path.any()):
            continue
        for predictor in predictors:
            maps = _knowing(predictor, left).predict(rows.tx_position_m, rows.carrier_hz)
            sums[predictor.__name__] += similarities(maps, rows.pas(), 1).sum()
    return max(sums, key=lambda name: sums[name])


def _best(rows: PasDataset, predict: Predict, trivial: Mapping[str, Predict], *, is_cautious: bool) -> Choice:
    """The predictor with the highest SSIM by itself, and the weight with the highest SSIM beside it.

    Of weights that are equally good it is the largest, and of those that may be as good, if it `is_cautious`, the
    smallest.
    """
    query, truth = (rows.tx_position_m, rows.carrier_hz), rows.pas()
    learned, maps = predict(*query)[:, ::STRIDE, ::STRIDE], {name: known(*query) for name, known in trivial.items()}
    name = max(maps, key=lambda name: similarities(maps[name], truth, 1).mean())
    similar = dict(zip(WEIGHTS, similarities_by_weight(learned, maps[name], truth, 1), strict=True))
    best = max(WEIGHTS, key=lambda weight: (similar[weight].mean(), weight))
    if is_cautious:
        best = next(weight for weight in WEIGHTS if _may_be_as_good(similar[weight], similar[best], rows.tx_index))
    return Choice(predictor=name, weight=best)


def _may_be_as_good(
    similar: Float[FloatArray, "n"], best: Float[FloatArray, "n"], tx_index: Int[IntArray, "n"]
) -> bool:
    """Whether the mean over transmitters is at most one standard error of the difference below the best mean."""
    number = np.unique(tx_index, return_inverse=True)[1]
    by_tx = np.bincount(number, best - similar) / np.bincount(number)
    error = by_tx.std() / np.sqrt(max(1, len(by_tx) - 1))
    return bool(by_tx.mean() <= error * (1 + _ROUNDING))
