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
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import inner_carriers_hz, validation_tx
from xfreqbench.methods.contract import Budget, Maps
from xfreqbench.methods.learning.loss import mean_ssim
from xfreqbench.methods.lookup import TrainingTransmitters
from xfreqbench.types import FloatArray, IntArray

CHOOSE_AT = 0.5  # share of the budget
_LEAST_ROWS, _MOST_ROWS = 4, 48  # of each kind on which a weight is chosen, and most held-out transmitters
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

        `make_splits` with `on="validation"` chooses among the same carriers, and draws transmitters in the same way.
        """
        generator = np.random.default_rng(seed)
        is_carrier, inner_hz = np.zeros(len(train), bool), inner_carriers_hz(train)
        if len(inner_hz):
            is_carrier = train.carrier_hz == inner_hz[generator.integers(len(inner_hz))]
        is_tx = np.isin(train.tx_index, validation_tx(train, generator, _MOST_ROWS))
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
        """For each kind of query the choice that is best on the held-out rows; `predict` gives the learned maps."""
        left = train.subset(holdout.left)
        knowing = {each.__name__: _knowing(each, left).predict for each in predictors}
        choices = {
            kind: _best(train.subset(rows), predict, knowing)
            for kind, rows in holdout.rows.items()
            if len(rows) >= _LEAST_ROWS
        }
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


def _best(rows: PasDataset, predict: Predict, trivial: Mapping[str, Predict]) -> Choice:
    """The predictor with the highest SSIM by itself, and the weight with the highest SSIM beside it.

    Of weights that are equally good it is the largest.
    """
    query, truth = (rows.tx_position_m, rows.carrier_hz), rows.pas()
    learned, maps = predict(*query), {name: known(*query) for name, known in trivial.items()}
    name = max(maps, key=lambda each: _similarity(maps[each], truth))
    weight = max(_WEIGHTS, key=lambda w: (_similarity(_mixed(learned, maps[name], w), truth), w))
    return Choice(predictor=name, weight=weight)


def _mixed(learned: Maps, trivial: Maps, weight: float) -> Maps:
    """The weighted mean of maps, scaled to peak 1."""
    mixed = weight * learned + (1 - weight) * trivial
    return np.asarray(mixed / mixed.max(axis=(1, 2), keepdims=True), dtype=np.float32)


def _similarity(maps: Maps, truth: Maps) -> float:
    shown, true = (torch.as_tensor(each[:, ::_STRIDE, ::_STRIDE].copy()) for each in (maps, truth))
    return float(mean_ssim(shown, true, _WINDOW, _STRIDE))
