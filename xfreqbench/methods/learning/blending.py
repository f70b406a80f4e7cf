"""Blends learned maps with those of trivial predictors, by weights that are chosen on validation rows of the training.

In the first half of a training some carriers and transmitters are held out, as unseen ones will be. With them the
weights are chosen, for each kind of query; then the training goes on with all rows. For transmitters that are far from
all trained ones, and for carriers beyond the training band, other predictors are the good ones. For them, a region of
transmitters and the outermost carriers are held out in the first quarter. An octave beyond the band even these say
little: whether a wall lets the wave through changes as fast. There, weights are the same for all rooms.

Of a seen transmitter the mean of its maps is known. Where it looks like the line of sight, other weights are good than
where it does not, behind a wall or a cupboard: each has its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import BaseModel, ConfigDict

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.validation import LEAST_VALIDATION_TX, inner_carriers_hz, validation_tx
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.learning.coarse import CoarseDataset
from xfreqbench.methods.learning.mixing import STRIDE, Predict, scaled, similarities
from xfreqbench.methods.lookup import TrainingTransmitters
from xfreqbench.types import FloatArray, IntArray, Maps, NDArray
from xfreqbench.units import format_ghz

CHOOSE_AT, CHOOSE_FAR_AT = 0.5, 0.25  # shares of the budget after which weights are chosen
LEARNED = "learned"  # the name of the learned maps among those of predictors
LINE_OF_SIGHT, MEAN_OVER_FREQUENCY = "LineOfSight", "MeanOverFrequency"
# parts that a blend begins with, where transmitters are seen, and where they are not: there, means over others mislead
_START, _START_UNSEEN = (LINE_OF_SIGHT, MEAN_OVER_FREQUENCY), (LINE_OF_SIGHT, LINE_OF_SIGHT)
# weights an octave beyond the band, of seen transmitters and of others
_FAR_BEYOND = {LEARNED: 1 / 3, LINE_OF_SIGHT: 1 / 2, MEAN_OVER_FREQUENCY: 1 / 6}
_FAR_BEYOND_UNSEEN = {LEARNED: 1 / 3, LINE_OF_SIGHT: 2 / 3}
_CLEAR = (0.7, 0.9)  # SSIM of line of sight and mean over frequency: the sight is obscured below, clear above
_PARTS = 8  # so many more are given one by one to whichever brings most
_LEAST_ROWS, _MOST_ROWS = 4, 48  # of each kind on which weights are chosen, and most held-out transmitters
_LEAST_TX, _LEAST_TX_SHARE = 8, 4  # held out: so many, but no more than one of four
_LEAST_ALIKE = 8.0  # clear and obscured rows; where either are fewer, all choose together
_FAR = (1.5, 3.0)  # spacings of the training transmitters, beyond which one is far from them, and very far
_LEAST_SECONDS_FOR_FAR = 8.0  # of a budget: choices for far transmitters take one or two
_REGION_SHARE = 0.15  # of the transmitters
_MANY_CARRIERS = 7  # so many that those inside the band may be held out beside the outermost ones
_MOST_CARRIERS = 3  # that are held out inside the band
_UNKNOWN_WEIGHT = 0.25  # of the learned maps, where no carrier can be held out
_PLACES = ("transmitter", "far transmitter", "very far transmitter")
BoolArray = NDArray[np.bool_]
KINDS = ("unseen carrier", *(kind for place in _PLACES for kind in (f"unseen {place}", f"unseen carrier and {place}")))


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
    def draw(cls, train: PasDataset, seed: int, seconds: float | None = None) -> list[Holdout]:
        """Carriers inside the band and a tenth of the transmitters, and before it a region and the outermost carriers.

        The earliest comes first, and they are the same for the same seed. Of few transmitters they are more than a
        tenth. `make_splits` with `on="validation"` chooses among the same inner carriers, and draws transmitters in the
        same way. Where too few transmitters of the region would be far from those that are left, it is not held out.
        """
        generator = np.random.default_rng(seed)
        heard_hz, inner_hz = np.unique(train.carrier_hz), inner_carriers_hz(train)
        is_carrier = np.isin(train.carrier_hz, _drawn_carriers(inner_hz, generator))
        least = max(LEAST_VALIDATION_TX, min(_LEAST_TX, len(np.unique(train.place_index)) // _LEAST_TX_SHARE))
        is_tx = np.isin(train.place_index, validation_tx(train, generator, _MOST_ROWS, least))

        def drawn(until: float, is_unseen: BoolArray, is_unheard: BoolArray, places: Sequence[BoolArray]) -> Holdout:
            """What is neither of unseen transmitters nor of unheard carriers is left; places are those of `KINDS`."""
            of_kinds = {KINDS[2 * nth - 1]: of & ~is_unheard for nth, of in enumerate(places) if nth}
            for nth, of in enumerate(places):
                for carrier_hz in np.unique(train.carrier_hz[is_unheard]).tolist():
                    kind = f"{KINDS[2 * nth]} at {format_ghz(carrier_hz)}"
                    of_kinds[kind] = of & is_unheard & (train.carrier_hz == carrier_hz)
            drawn = {kind: generator.permutation(np.flatnonzero(of & train.has_path)) for kind, of in of_kinds.items()}
            rows = {kind: np.sort(of[:_MOST_ROWS]) for kind, of in drawn.items() if len(of) >= _LEAST_ROWS}
            return cls(until, np.flatnonzero(~is_unseen & ~is_unheard), rows)

        last = drawn(CHOOSE_AT, is_tx, is_carrier, (~is_tx, is_tx))
        is_unseen = is_tx | _is_in_region(train, generator)
        is_outermost = np.isin(train.carrier_hz, heard_hz[[0, -1]] if len(heard_hz) > 2 else heard_hz[1:])
        is_unheard = is_outermost | (is_carrier & (len(heard_hz) >= _MANY_CARRIERS))
        is_left = ~is_unseen & ~is_unheard
        if not is_left.any() or (seconds is not None and seconds < _LEAST_SECONDS_FOR_FAR):
            return [last]
        known = TrainingTransmitters(train.subset(np.flatnonzero(is_left)))
        reach = _reach(known, train.tx_position_m) * is_unseen
        for nth in (2, 1):
            if len(np.unique(train.tx_index[reach == nth])) < _LEAST_TX:  # a few transmitters say little
                reach[reach == nth] -= 1
        is_near = reach == 0  # with inner carriers, they wait for the last holdout
        places = (is_near & ~is_unseen & is_outermost, is_tx & is_near & is_outermost, reach == 1, reach == 2)
        early = drawn(CHOOSE_FAR_AT, is_unseen, is_unheard, places)
        return [early, last] if early.rows else [last]


def _drawn_carriers(inner_hz: Float[FloatArray, "F"], generator: np.random.Generator) -> Float[FloatArray, "n"]:
    """Of carriers inside the band half, three at most: one at random, and beside it the lowest, and the highest.

    What is learned often fails at one end of the band alone.
    """
    number = min(_MOST_CARRIERS, (len(inner_hz) + 1) // 2)
    ends = {0: [], 1: [], 2: [0], 3: [0, len(inner_hz) - 1]}[number]
    others = np.setdiff1d(np.arange(len(inner_hz)), ends)
    return inner_hz[[*ends, *([generator.choice(others)] if number else [])]]


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
    """Trivial predictors that know the training rows, and their weights for each kind of query."""

    def __init__(self, predictors: Sequence[type], train: PasDataset, choices: Mapping[str, Choice]) -> None:
        self.choices, self.transmitters = choices, TrainingTransmitters(train)
        needed = {name for choice in choices.values() for name in choice.weights | (choice.obscured or {})}
        if any(choice.obscured or choice.carrier_hz for choice in choices.values()):
            needed |= {*_START}
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
        left = coarse.subset(holdout.left)
        knowing = _knowing(predictors, left)
        choices = dict(before)
        for kind, of_kind in holdout.rows.items():
            rows = coarse.subset(of_kind)
            query = rows.tx_position_m, rows.carrier_hz
            maps = {LEARNED: predict(*query)[:, ::STRIDE, ::STRIDE]}
            maps |= {name: predictor.predict(*query) for name, predictor in knowing.items()}
            carrier_hz = float(rows.carrier_hz[0]) if " at " in kind else None
            start = _START if _of(kind) == KINDS[0] else _START_UNSEEN
            shares = [np.ones(len(rows))]
            if _of(kind) == KINDS[0] and holdout.until == CHOOSE_AT and maps.keys() >= {*_START}:
                clear = _clear(maps)
                if min(clear.sum(), (1 - clear).sum()) >= _LEAST_ALIKE:
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
        weights = {name: np.zeros(len(carrier_hz), np.float32) for name in (LEARNED, *self._predictors)}
        weights[LEARNED][:] = 1
        for (kind, is_beyond), asked in self._kinds(tx_position_m, carrier_hz).items():
            weights[LEARNED][asked] = 0
            shares = [*self._shares(kind, is_beyond, carrier_hz[asked])]
            clear, far = np.ones(len(asked)), self._far_beyond(carrier_hz[asked])
            if any(choice.obscured for choice, _ in shares):
                query = tx_position_m[asked], carrier_hz[asked]
                clear = _clear({name: self._predictors[name].predict(*query)[:, ::STRIDE, ::STRIDE] for name in _START})
            if far.any():
                for name, weight in (_FAR_BEYOND if kind == KINDS[0] else _FAR_BEYOND_UNSEEN).items():
                    weights[name][asked] += weight * far
            for choice, share in shares:
                for of_part, part in ((choice.weights, clear), (choice.obscured or choice.weights, 1 - clear)):
                    for name, weight in of_part.items():
                        weights[name][asked] += weight * share * part * (1 - far)
        blended = weights[LEARNED][:, None, None] * learned
        for name, predictor in self._predictors.items():
            if len(at := np.flatnonzero(weights[name])):
                maps = predictor.predict(tx_position_m[at], carrier_hz[at])
                blended[at] += weights[name][at, None, None] * maps
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

    def _far_beyond(self, carrier_hz: Float[FloatArray, "B"]) -> Float[FloatArray, "B"]:
        """How far carriers are beyond the band, in octaves and at most 1.

        0 of a single training carrier, and where the predictors are not there that weights far beyond the band are of.
        """
        if len(self.transmitters.carrier_hz) < 2 or not self._predictors.keys() >= {*_START}:
            return np.zeros(len(carrier_hz))
        lowest_hz, highest_hz = self.transmitters.carrier_hz[[0, -1]]
        return np.log2(np.maximum(lowest_hz / carrier_hz, carrier_hz / highest_hz)).clip(0, 1)

    def _kinds(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> dict[tuple[str, bool], Int[IntArray, "n"]]:
        """The numbers of the queries of each kind, inside the band and beyond it.

        Where there is no choice for their kind, a nearer one's is taken. Those of seen transmitters and carriers are as
        those of unseen carriers.
        """
        place = np.where(self.transmitters.knows(tx_position_m), 0, 1 + _reach(self.transmitters, tx_position_m))
        heard_hz, known = self.transmitters.carrier_hz, {*map(_of, self.choices)}
        is_heard, is_beyond = np.isin(carrier_hz, heard_hz), (carrier_hz < heard_hz[0]) | (carrier_hz > heard_hz[-1])
        of_kind: dict[tuple[str, bool], list[int]] = {}
        for nth, (where, heard) in enumerate(zip(place.tolist(), is_heard.tolist(), strict=True)):
            nearer = range(where, min(where, 1) - 1, -1)
            kinds = [KINDS[max(0, 2 * n - is_too)] for is_too in ((1,) if heard else (0, 1)) for n in nearer]
            if found := next((kind for kind in kinds if kind in known), None):
                of_kind.setdefault((found, bool(is_beyond[nth])), []).append(nth)
        return {kind: np.array(numbers) for kind, numbers in of_kind.items()}


def _of(name: str) -> str:
    """The kind of query that a choice is for, without the carrier."""
    return name.partition(" at ")[0]


def _carrier_of(choice: Choice) -> float:
    return choice.carrier_hz or 1.0


def _knowing(predictors: Sequence[type], train: PasDataset) -> dict[str, Any]:
    """Trivial predictors by name that know the training rows that have a path, and read what they share once."""
    known = train.subset(train.has_path)
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
