"""Blends learned maps with those of a trivial predictor, by weights that are chosen on validation rows of the training.

In the first half of a training one carrier and some transmitters are held out, as unseen ones will be. With them
the weights are chosen, for each kind of query; then the training goes on with all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import LEAST_VALIDATION_TX, inner_carriers_hz, validation_tx
from xfreqbench.methods.contract import Budget, Maps
from xfreqbench.methods.learning.loss import mean_ssim
from xfreqbench.methods.lookup import TrainingTransmitters
from xfreqbench.types import FloatArray, IntArray

CHOOSE_AT = 0.5  # share of the budget
_LEAST_ROWS, _MOST_ROWS = 4, 48  # of each kind on which a weight is chosen, and most held-out transmitters
_LEAST_TX, _LEAST_TX_SHARE = 8, 4  # held out: so many, but no more than one of four
_FEW_TX, _FOLDS = 16, 5  # with fewer held out the choice is a cautious one
_WEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the learned maps
_STRIDE, _WINDOW = 3, 3  # of the SSIM by which they are compared
KINDS = ("unseen carrier", "unseen transmitter", "unseen carrier and transmitter")

Predict = Callable[[Float[FloatArray, "B 3"], Float[FloatArray, "B"]], Maps]


class Choice(BaseModel):
    """For a kind of query: the trivial predictor's name, and the weight of the learned maps beside it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    predictor: str
    weight: float


@dataclass(frozen=True, eq=False)
class Holdout:
    """Rows of the training that are held out, by kind of query, and those that are left to train on."""

    left: IntArray
    rows: Mapping[str, IntArray]

    @classmethod
    def draw(cls, train: PasDataset, seed: int) -> Holdout:
        """One carrier inside the band and a tenth of the transmitters, the same ones for the same seed.

        Of few transmitters they are more than a tenth. `make_splits` with `on="validation"` chooses among the same
        carriers, and draws transmitters in the same way.
        """
        generator = np.random.default_rng(seed)
        is_carrier, inner_hz = np.zeros(len(train), bool), inner_carriers_hz(train)
        if len(inner_hz):
            is_carrier = train.carrier_hz == inner_hz[generator.integers(len(inner_hz))]
        least = max(LEAST_VALIDATION_TX, min(_LEAST_TX, len(np.unique(train.tx_index)) // _LEAST_TX_SHARE))
        is_tx = np.isin(train.tx_index, validation_tx(train, generator, _MOST_ROWS, least))
        kinds = zip(KINDS, (is_carrier & ~is_tx, ~is_carrier & is_tx, is_carrier & is_tx), strict=True)
        rows = {
            kind: generator.permutation(np.flatnonzero(of & train.has_path))[:_MOST_ROWS]
            for kind, of in kinds
        }
        return cls(np.flatnonzero(~is_carrier & ~is_tx), {kind: np.sort(each) for kind, each in rows.items()})


class Blend:
    """Trivial predictors that know the training rows, and a choice among them for each kind of query."""

    def __init__(self, predictors: Sequence[type], train: PasDataset, choices: Mapping[str, Choice]) -> None:
        self.choices, self.transmitters = choices, TrainingTransmitters(train)
        needed = {choice.predictor for choice in choices.values() if choice.weight < 1}
        self._predictors = {
            each.__name__: _knowing(each, train) for each in predictors if each.__name__ in needed
        }

    @classmethod
    def chosen(
        cls, predictors: Sequence[type], train: PasDataset, holdout: Holdout, predict: Predict
    ) -> Blend:
        """For each kind of query the choice that is best on the held-out rows; `predict` gives the learned maps.

        A few held-out transmitters say little. Then the predictor is the one that is best at all training
        transmitters, a fifth of them unseen in turn, and the weight the smallest that is not worse than the best by
        more than the standard error of their difference.
        """
        left = train.subset(holdout.left)
        knowing = {each.__name__: _knowing(each, left).predict for each in predictors}
        choices = {}
        for kind, of_kind in holdout.rows.items():
            if len(of_kind) < _LEAST_ROWS:
                continue
            rows = train.subset(of_kind)
            are_few = len(np.unique(rows.tx_index)) < _FEW_TX
            known = knowing
            if are_few and kind != KINDS[0]:
                unseen_hz = rows.carrier_hz[0] if kind == KINDS[2] else None
                name = _best_at_unseen(predictors, train, unseen_hz)
                known = {name: knowing[name]}
            choices[kind] = _best(rows, predict, known, is_cautious=are_few)
        return cls(predictors, train, choices)

    def maps(
        self, learned: Maps, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Maps:
        """Learned maps of some queries, blended by the choice for the kind of each."""
        blended = learned.copy()
        for kind, chosen in zip(KINDS, self._of_kinds(tx_position_m, carrier_hz), strict=True):
            choice = self.choices.get(kind)
            if choice is None or choice.weight == 1 or not chosen.any():
                continue
            trivial = self._predictors[choice.predictor].predict(tx_position_m[chosen], carrier_hz[chosen])
            blended[chosen] = _mixed(learned[chosen], trivial, choice.weight)
        return blended

    def _of_kinds(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> tuple[Bool[NDArray[np.bool_], "B"], ...]:
        """Which queries are of each kind; those of seen transmitters and carriers are as those of unseen carriers."""
        unseen_tx = ~self.transmitters.knows(tx_position_m)
        unseen_carrier = ~np.isin(carrier_hz, self.transmitters.carrier_hz)
        return ~unseen_tx, unseen_tx & ~unseen_carrier, unseen_tx & unseen_carrier


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
    tx_index = np.unique(train.tx_index)
    is_carrier = np.ones(len(train), bool) if unseen_hz is None else train.carrier_hz == unseen_hz
    is_known = is_carrier if unseen_hz is None else ~is_carrier
    sums = dict.fromkeys((each.__name__ for each in predictors), 0.0)
    for fold in range(_FOLDS):
        is_unseen = np.isin(train.tx_index, tx_index[fold::_FOLDS])
        rows = train.subset(is_unseen & is_carrier & train.has_path)
        left = train.subset(~is_unseen & is_known)
        if not (len(rows) and left.has_path.any()):
            continue
        for each in predictors:
            maps = _knowing(each, left).predict(rows.tx_position_m, rows.carrier_hz)
            sums[each.__name__] += _similarities(maps, rows.pas()).sum()
    return max(sums, key=lambda name: sums[name])


def _best(rows: PasDataset, predict: Predict, trivial: Mapping[str, Predict], *, is_cautious: bool) -> Choice:
    """The predictor with the highest SSIM by itself, and the weight with the highest SSIM beside it.

    Of weights that are equally good it is the largest, and of those that may be as good, if it `is_cautious`, the
    smallest.
    """
    query, truth = (rows.tx_position_m, rows.carrier_hz), rows.pas()
    learned, maps = predict(*query), {name: known(*query) for name, known in trivial.items()}
    name = max(maps, key=lambda each: _similarities(maps[each], truth).mean())
    similar = {weight: _similarities(_mixed(learned, maps[name], weight), truth) for weight in _WEIGHTS}
    best = max(_WEIGHTS, key=lambda weight: (similar[weight].mean(), weight))
    if is_cautious:
        best = next(each for each in _WEIGHTS if _may_be_as_good(similar[each], similar[best], rows.tx_index))
    return Choice(predictor=name, weight=best)


def _may_be_as_good(
    similar: Float[FloatArray, "n"], best: Float[FloatArray, "n"], tx_index: Int[IntArray, "n"]
) -> bool:
    """Whether the mean lies no more than the standard error of the difference below the best; of transmitters."""
    number = np.unique(tx_index, return_inverse=True)[1]
    by_tx = np.bincount(number, best - similar) / np.bincount(number)
    return bool(by_tx.mean() <= by_tx.std() / np.sqrt(max(1, len(by_tx) - 1)))


def _mixed(learned: Maps, trivial: Maps, weight: float) -> Maps:
    """The weighted mean of maps, scaled to peak 1."""
    mixed = weight * learned + (1 - weight) * trivial
    return np.asarray(mixed / mixed.max(axis=(1, 2), keepdims=True), dtype=np.float32)


def _similarities(maps: Maps, truth: Maps) -> Float[FloatArray, "n"]:
    """SSIM of each of n maps, coarsely."""
    pairs = (
        (torch.as_tensor(each[None, ::_STRIDE, ::_STRIDE].copy()) for each in pair)
        for pair in zip(maps, truth, strict=True)
    )
    return np.array([float(mean_ssim(shown, true, _WINDOW, _STRIDE)) for shown, true in pairs])
