"""Blends learned maps with those of trivial predictors, by weights that are chosen on validation rows of the training.

In the first half of a training some carriers and transmitters are held out, as unseen ones will be. With them the
weights are chosen, for each kind of query; then the training goes on with all rows. For carriers beyond the training
band other predictors are the good ones: to choose for them, the outermost carriers are held out in the first quarter.
An octave beyond the band even these say little, for whether a wall lets the wave through changes as fast; nor does one
region of a room say what is good in another. There, weights are the same for all rooms.

Of a seen transmitter the mean of its maps is known. Where it looks like the line of sight, other weights are good than
where it does not, behind a wall or a cupboard: each has its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from pydantic import BaseModel, ConfigDict

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.validation import LEAST_VALIDATION_TX, inner_carriers_hz, place_index, validation_tx
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.coarse import CoarseDataset
from xfreqbench.methods.learning.mixing import STRIDE, Predict, scaled, similarities
from xfreqbench.methods.lookup import SAME_TRANSMITTER_M, TrainingTransmitters
from xfreqbench.types import FloatArray, IntArray, Maps, NDArray
from xfreqbench.units import format_ghz

CHOOSE_AT, CHOOSE_BEYOND_AT = 0.5, 0.25  # shares of the budget after which weights are chosen
LEARNED = "learned"  # the name of the learned maps among those of predictors
LINE_OF_SIGHT, MEAN_OVER_FREQUENCY = "LineOfSight", "MeanOverFrequency"
# parts that a blend begins with, where transmitters are seen, and where they are not: there, means over others mislead
_START, _START_UNSEEN = (LINE_OF_SIGHT, MEAN_OVER_FREQUENCY), (LINE_OF_SIGHT, LINE_OF_SIGHT)
# weights far from all that is known, where the nearest training transmitter is in the same direction, and where not
_FAR = {LEARNED: 1 / 3, LINE_OF_SIGHT: 1 / 2, MEAN_OVER_FREQUENCY: 1 / 6}
# and of seen ones far below the band, in clear sight and not: walls let more through there, and mirror otherwise
_FAR_SPACINGS = (1.0, 1.4)  # of the training transmitters, between which one gets far from all of them
_ALIKE = (0.6, 0.8)  # SSIM of line of sight and learned map, of a transmitter that is far: the latter is wrong below
_CLEAR = (0.7, 0.9)  # SSIM of line of sight and mean over frequency: the sight is obscured below, clear above
_PARTS = 8  # so many more are given one by one to whichever brings most
_LEAST_ROWS, _MOST_ROWS = 4, 48  # of each kind on which weights are chosen, and most held-out transmitters
_LEAST_TX, _LEAST_TX_SHARE = 8, 4  # held out: so many, but no more than one of four
_UNKNOWN_WEIGHT = 0.25  # of the learned maps, where no carrier can be held out
BoolArray = NDArray[np.bool_]
KINDS = ("unseen carrier", "unseen transmitter", "unseen carrier and transmitter")


class Choice(BaseModel):
    """For a kind of query: the weights of the learned maps and of trivial predictors, by name, 1 together.

    It is a choice for one carrier, held out to make it, where the kind is of unseen carriers. `obscured` are the
    weights for seen transmitters whose maps are unlike the line of sight; None where all have the same.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    weights: dict[str, float]
    obscured: dict[str, float] | None = None
    carrier_hz: float | None = None


@dataclass(frozen=True, eq=False)
class Holdout:
    """Rows of a training that are held out until a share of the budget, by kind of query, and those that are left."""

    until: float
    left: IntArray
    rows: Mapping[str, IntArray]

    @classmethod
    def draw(cls, train: PasDataset, seed: int) -> list[Holdout]:
        """Carriers inside the band and a tenth of the transmitters, and before it the outermost carriers.

        The earliest comes first, and they are the same for the same seed. Of few transmitters they are more than a
        tenth. `make_splits` with `on="validation"` chooses among the same inner carriers, and draws transmitters in the
        same way.
        """
        generator = np.random.default_rng(seed)
        heard_hz, inner_hz = np.unique(train.carrier_hz), inner_carriers_hz(train)
        is_inner = np.isin(train.carrier_hz, _drawn_carriers(inner_hz, generator))
        is_outermost = np.isin(train.carrier_hz, heard_hz[[0, -1]] if len(heard_hz) > 2 else heard_hz[1:])
        least = max(LEAST_VALIDATION_TX, min(_LEAST_TX, len(np.unique(place_index(train))) // _LEAST_TX_SHARE))
        is_tx = np.isin(place_index(train), validation_tx(train, generator, _MOST_ROWS, least))

        def drawn(until: float, is_unheard: BoolArray, of_kinds: dict[str, BoolArray]) -> Holdout:
            """What is neither of held-out transmitters nor of unheard carriers is left."""
            for kind, of in ((KINDS[0], ~is_tx), (KINDS[2], is_tx)):
                for carrier_hz in np.unique(train.carrier_hz[is_unheard]).tolist():
                    of_kinds[f"{kind} at {format_ghz(carrier_hz)}"] = of & (train.carrier_hz == carrier_hz)
            drawn = {kind: generator.permutation(np.flatnonzero(of & train.has_path)) for kind, of in of_kinds.items()}
            rows = {kind: np.sort(of[:_MOST_ROWS]) for kind, of in drawn.items() if len(of) >= _LEAST_ROWS}
            return cls(until, np.flatnonzero(~is_tx & ~is_unheard), rows)

        last = drawn(CHOOSE_AT, is_inner, {KINDS[1]: is_tx & ~is_inner})
        early = drawn(CHOOSE_BEYOND_AT, is_outermost, {})
        return [early, last] if early.rows and len(early.left) else [last]


def _drawn_carriers(inner_hz: Float[FloatArray, "F"], generator: np.random.Generator) -> Float[FloatArray, "n"]:
    """Of carriers inside the band half, three at most: one at random, and beside it the lowest, and the highest.

    What is learned often fails at one end of the band alone.
    """
    number = min(3, (len(inner_hz) + 1) // 2)
    ends = {0: [], 1: [], 2: [0], 3: [0, len(inner_hz) - 1]}[number]
    others = np.setdiff1d(np.arange(len(inner_hz)), ends)
    return inner_hz[[*ends, *([generator.choice(others)] if number else [])]]


class _Predicted:
    """Maps that trivial predictors have of B queries, each predicted once: when it is first asked for."""

    def __init__(
        self, predictors: Mapping[str, Any], tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> None:
        self._predictors, self.tx_position_m, self.carrier_hz = predictors, tx_position_m, carrier_hz
        self._maps: dict[str, Maps] = {}
        self._is_there = {name: np.zeros(len(carrier_hz), bool) for name in predictors}

    def maps(self, name: str, at: Int[IntArray, "n"]) -> Float[Maps, "n E A"]:
        """A predictor's maps of some of the queries, by their numbers."""
        if len(new := at[~self._is_there[name][at]]):
            maps = self._predictors[name].predict(self.tx_position_m[new], self.carrier_hz[new])
            self._maps.setdefault(name, np.empty((len(self.carrier_hz), *maps.shape[1:]), maps.dtype))[new] = maps
            self._is_there[name][new] = True
        return self._maps[name][at]

    def clear_sight(self, at: Int[IntArray, "n"]) -> Float[FloatArray, "n"]:
        """How clear the sight of seen transmitters is, from 0 to 1, at some of the queries."""
        return _clear({name: self.maps(name, at)[:, ::STRIDE, ::STRIDE] for name in _START})


class Blend:
    """Trivial predictors that know the training rows, and their weights for each kind of query."""

    def __init__(self, predictors: Sequence[type], train: PasDataset, choices: Mapping[str, Choice]) -> None:
        self.choices, self.transmitters = choices, TrainingTransmitters(train)
        needed = {*_START}.union(*(choice.weights | (choice.obscured or {}) for choice in choices.values()))
        self._predictors = _knowing([predictor for predictor in predictors if predictor.__name__ in needed], train)

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

        `before` are the choices for other kinds, made earlier. Where no carrier can be held out, maps at others are
        means of the learned ones and those of the first predictor; where no transmitter can, those of the latter.
        """
        coarse = CoarseDataset.of(train, STRIDE)
        left = coarse[holdout.left]
        knowing = _knowing(predictors, left)
        choices = dict(before)
        for kind, of_kind in holdout.rows.items():
            rows = coarse[of_kind]
            query = rows.tx_position_m, rows.carrier_hz
            maps = {LEARNED: predict(*query)[:, ::STRIDE, ::STRIDE]}
            maps |= {name: predictor.predict(*query) for name, predictor in knowing.items()}
            carrier_hz = float(rows.carrier_hz[0]) if " at " in kind else None
            start = _START if _of(kind) == KINDS[0] else _START_UNSEEN
            shares = [np.ones(len(rows))]
            if _of(kind) == KINDS[0] and holdout.until == CHOOSE_AT and maps.keys() >= {*_START}:
                clear = _clear(maps)
                # where either are fewer, all choose together
                if min(clear.sum(), (1 - clear).sum()) >= 8.0:
                    shares = [clear, 1 - clear]
            weights, *obscured = (_best_weights(maps, rows.pas(), start, share) for share in shares)
            choices[kind] = Choice(weights=weights, obscured=next(iter(obscured), None), carrier_hz=carrier_hz)
        if holdout.until == CHOOSE_AT:
            first, known = predictors[0].__name__, {*map(_of, choices)}
            if KINDS[0] not in known:
                choices[KINDS[0]] = Choice(weights={LEARNED: _UNKNOWN_WEIGHT, first: 1 - _UNKNOWN_WEIGHT})
            if KINDS[1] not in known:
                choices[KINDS[1]] = Choice(weights={first: 1.0})
        return cls(predictors, train, choices)

    def maps(self, learned: Maps, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Maps:
        """Learned maps of some queries, blended by the choice for the kind of each."""
        predicted = _Predicted(self._predictors, tx_position_m, carrier_hz)
        weights = {name: np.zeros(len(carrier_hz), np.float32) for name in (LEARNED, *self._predictors)}
        weights[LEARNED][:] = 1
        far = self._far(learned, predicted)
        # rounded, so that nothing is asked of predictors whose share is rounding alone
        near = (1 - sum((share for _, share in far), np.zeros(len(carrier_hz)))).round(9)
        for kind, is_beyond, asked in self._kinds(tx_position_m, carrier_hz):
            weights[LEARNED][asked] = 0
            shares = [*self._shares(kind, is_beyond, carrier_hz[asked])]
            clear = np.ones(len(asked))
            if any(choice.obscured for choice, _ in shares):
                clear = predicted.clear_sight(asked)
            parts = [(of_part, share[asked]) for of_part, share in far]
            for choice, share in shares:
                parts.append((choice.weights, near[asked] * share * clear))
                parts.append((choice.obscured or choice.weights, near[asked] * share * (1 - clear)))
            for of_part, part in parts:
                for name in of_part if part.any() else ():
                    weights[name][asked] += of_part[name] * part
        blended = weights[LEARNED][:, None, None] * learned
        for name in self._predictors:
            if len(at := np.flatnonzero(weights[name])):
                blended[at] += weights[name][at, None, None] * predicted.maps(name, at)
        return scaled(blended)

    def _shares(
        self, kind: str, is_beyond: bool, carrier_hz: Float[FloatArray, "B"]
    ) -> Iterator[tuple[Choice, Float[FloatArray, "B"]]]:
        """The choices for a kind, and the share of each at some carriers, all inside the band or all beyond it.

        A carrier between two that were held out has a share of both, by its distance from them in log f; one beyond
        them has all of the nearest. Inside the band the outermost carriers do not count, and beyond it they alone.
        """
        of_kind = [choice for name, choice in self.choices.items() if _of(name) == kind]
        outermost_hz = self.transmitters.carrier_hz[[0, -1]]
        alike = [choice for choice in of_kind if (_carrier_of(choice) in outermost_hz) == is_beyond] or of_kind
        choices = sorted(alike, key=_carrier_of)
        place = np.interp(np.log(carrier_hz), np.log([*map(_carrier_of, choices)]), np.arange(len(choices)))
        for nth, choice in enumerate(choices):
            yield choice, np.clip(1 - np.abs(place - nth), 0, 1)

    def _far(self, learned: Maps, predicted: _Predicted) -> list[tuple[dict[str, float], Float[FloatArray, "B"]]]:
        """Weights far from all that is known, and the share of each in queries; what is left of 1 is the choices'.

        Far are carriers an octave beyond the band, unless it is of a single carrier, and transmitters that are
        `_FAR_SPACINGS` from all trained ones. Of unseen transmitters the line of sight stands alone where the learned
        maps are unlike it; of seen ones below the band weights depend on how clear the sight is. Nothing is far where
        the predictors are not there that the weights are of.
        """
        known, tx_position_m, carrier_hz = self.transmitters, predicted.tx_position_m, predicted.carrier_hz
        if not self._predictors.keys() >= {*_START}:
            return []
        lowest_hz, highest_hz = known.carrier_hz[[0, -1]]
        octaves = np.log2(np.maximum(lowest_hz / carrier_hz, carrier_hz / highest_hz)) * (lowest_hz < highest_hz)
        spacings = known.away_m(tx_position_m) / max(known.spacing_m, SAME_TRANSMITTER_M)
        far = 1 - (1 - octaves.clip(0, 1)) * (1 - np.interp(spacings, _FAR_SPACINGS, (0, 1)))
        # between directions at the receiver, of which ten degrees are elsewhere
        elsewhere = (known.turned_deg(tx_position_m) / 10.0).clip(0, 1)
        alike, clear, is_known = np.ones(len(carrier_hz)), np.zeros(len(carrier_hz)), known.knows(tx_position_m)
        if len(at := np.flatnonzero((far > 0) & ~is_known)):
            alike[at] = np.interp(similarities(learned[at], predicted.maps(LINE_OF_SIGHT, at)), _ALIKE, (0, 1))
        is_below = is_known & (carrier_hz < lowest_hz)
        if len(at := np.flatnonzero((far > 0) & is_below)):
            clear[at] = predicted.clear_sight(at)
        below, far = far * is_below, far * ~is_below
        return [
            (_FAR, far * alike * (1 - elsewhere)),
            ({LEARNED: 1 / 4, LINE_OF_SIGHT: 3 / 4}, far * alike * elsewhere),
            ({LINE_OF_SIGHT: 1.0}, far * (1 - alike)),
            ({LEARNED: 1 / 8, LINE_OF_SIGHT: 1 / 4, MEAN_OVER_FREQUENCY: 5 / 8}, below * clear),
            ({LEARNED: 1 / 4, LINE_OF_SIGHT: 5 / 8, MEAN_OVER_FREQUENCY: 1 / 8}, below * (1 - clear)),
        ]

    def _kinds(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Iterator[tuple[str, bool, Int[IntArray, "n"]]]:
        """The numbers of the queries of each kind, inside the band and beyond it.

        Those of unseen transmitters at unseen carriers are as those at seen carriers, where there is no choice for
        them. Those of seen transmitters and carriers are as those of unseen carriers.
        """
        heard_hz, known = self.transmitters.carrier_hz, {*map(_of, self.choices)}
        is_heard, is_beyond = np.isin(carrier_hz, heard_hz), (carrier_hz < heard_hz[0]) | (carrier_hz > heard_hz[-1])
        unseen = np.where(is_heard | (KINDS[2] not in known), 1, 2)
        of_query = np.where(self.transmitters.knows(tx_position_m), 0, unseen)
        for nth, kind in enumerate(KINDS):
            for beyond in (False, True):
                asked = np.flatnonzero((of_query == nth) & (is_beyond == beyond))
                if kind in known and len(asked):
                    yield kind, beyond, asked


def _of(name: str) -> str:
    """The kind of query that a choice is for, without the carrier."""
    return name.partition(" at ")[0]


def _carrier_of(choice: Choice) -> float:
    return choice.carrier_hz or 1.0


def _knowing(predictors: Sequence[type], train: PasDataset) -> dict[str, Any]:
    """Trivial predictors by name that know the training rows that have a path, and read what they share once."""
    known = train[train.has_path]
    made = {predictor.__name__: predictor() for predictor in predictors}
    for predictor in made.values():
        next(predictor.fit(known, Budget(), 0))
        predictor.transmitters = next(iter(made.values())).transmitters
    return made


def _clear(maps: Mapping[str, Float[Maps, "n E A"]]) -> Float[FloatArray, "n"]:
    """How clear the sight of seen transmitters is, from 0 to 1, by the likeness of their line of sight and mean."""
    line_of_sight, mean = (np.ascontiguousarray(maps[name]) for name in _START)
    return np.interp(similarities(line_of_sight, mean, 1), _CLEAR, (0, 1))


def _best_weights(
    maps: Mapping[str, Float[Maps, "n E A"]],
    truth: Float[Maps, "n E A"],
    start: Sequence[str],
    share: Float[FloatArray, "n"],
) -> dict[str, float]:
    """The weights of maps by name whose mean has the highest SSIM, found greedily: one part after another is added.

    `share` says how much each row counts. The first parts are those of `start`, which no few rows lead astray. Learned
    maps that are better alone stay alone.
    """
    at = np.flatnonzero(share)
    maps, truth, share = {name: of_name[at] for name, of_name in maps.items()}, truth[at], share[at]

    def similar_to_truth(blended: Float[Maps, "m E A"]) -> float:
        return float(np.average(similarities(blended, truth, 1), weights=share))

    parts = Counter(name for name in start if name in maps)
    total, best = sum((maps[name] for name in parts.elements()), np.zeros_like(truth)), -np.inf
    for _ in range(_PARTS):
        similar = {name: similar_to_truth(scaled(total + of_name)) for name, of_name in maps.items()}
        name = max(similar, key=lambda name: similar[name])
        if similar[name] <= best:
            break
        parts[name] += 1
        total, best = total + maps[name], similar[name]
    if similar_to_truth(maps[LEARNED]) >= best:
        return {LEARNED: 1.0}
    return {name: number / parts.total() for name, number in parts.items()}
