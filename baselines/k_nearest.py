"""Trivial predictor: a weighted mean of the nearest training maps; how many, in space and frequency, is validated."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.validation import inner_carriers_hz, place_index
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.learning.coarse import CoarseDataset
from xfreqbench.methods.learning.loss_kernels import similarities
from xfreqbench.methods.lookup import SAME_TRANSMITTER_M, TrainingTransmitters, TransmitterLookup, WeightedRows
from xfreqbench.types import FloatArray, IntArray, NDArray

KINDS = ("unseen carrier", "unseen transmitter", "unseen carrier and transmitter")
_NUM_TX, _ALL = (1, 2, 3, 4, 6, 8), 2**31
_COUNTS = tuple(product(_NUM_TX, (1, 2, 3, 4, 6, _ALL)))  # of transmitters, and of carriers of each
_NUM_QUERIES, _STRIDE = 256, 3  # of validation, and of the SSIM by which counts are compared
_COUNTS_FILE = "counts.json"


class KNearest(TransmitterLookup):
    """The mean of the nearest transmitters' maps, weighted by distance, at the carriers nearest to the query's.

    A transmitter at a distance d weighs 1 / (d + h), where h is half the median distance between neighbours in
    training, so that a transmitter that was trained on does not silence its neighbours. Of each transmitter the maps
    of the nearest carriers on a logarithmic axis count equally.

    How many transmitters and carriers is chosen for each kind of query, by the median SSIM of training rows that are
    predicted from the others: without those of the same carrier, those of the same transmitter, or both. So it
    may become `nearest` (one and one) or a mean over all carriers. Where nothing can be left out, of a single carrier
    or transmitter, it is one and one.
    """

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Remember which rows were trained on, and choose the counts; neither depends on the seed."""
        self._know(TrainingTransmitters.of(train))
        self.counts = self._best_counts()
        yield Progress(step=1, loss=math.nan)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """For each query, the weighted mean map, scaled to peak 1."""
        is_known = self.transmitters.knows(tx_position_m)
        is_heard = np.isin(carrier_hz, self.transmitters.carrier_hz)
        kinds = np.where(is_known, KINDS[0], np.where(is_heard, KINDS[1], KINDS[2]))
        return self.transmitters.sums(map(self._weighted, tx_position_m, carrier_hz, kinds))

    def findings(self) -> Mapping[str, Mapping[str, int | str]]:
        """For each kind of query how many transmitters are averaged, and how many carriers of each."""
        return {
            kind: {"transmitters": num_tx, "carriers": "all" if num_carriers == _ALL else num_carriers}
            for kind, (num_tx, num_carriers) in self.counts.items()
        }

    def save(self, directory: Path) -> None:
        """Store which rows were trained on, and the counts."""
        super().save(directory)
        (directory / _COUNTS_FILE).write_text(json.dumps(self.counts), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> KNearest:
        """Inverse of `save`; raises `DataError` if the data set has gone or is another."""
        method = cls()
        method._know(TrainingTransmitters.load(directory))
        stored = json.loads((directory / _COUNTS_FILE).read_text(encoding="utf-8"))
        method.counts = {kind: tuple(counts) for kind, counts in stored.items()}
        return method

    def _know(self, transmitters: TrainingTransmitters) -> None:
        self.transmitters = transmitters
        self._softening_m = max(transmitters.spacing_m / 2, SAME_TRANSMITTER_M)

    def _weighted(self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float, kind: str) -> WeightedRows:
        counts = self.counts[kind]
        rows, tx, distance_m = self._neighbours(tx_position_m, carrier_hz, counts[0])
        (weights,) = self._weights(tx, distance_m, np.array([counts]))
        return rows[weights > 0], weights[weights > 0]

    def _neighbours(
        self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float, count: int
    ) -> tuple[Int[IntArray, "n"], Int[IntArray, "n"], Float[FloatArray, "n"]]:
        """The rows of the nearest `count` transmitters, the place of each row's transmitter, and its distance.

        Transmitters stand in the order of their distance, and rows of each in that of their carriers' octaves.
        """
        known_hz, found = self.transmitters.train.carrier_hz, []
        distance_m, nearest = self.transmitters.neighbours(tx_position_m, count)
        for tx in nearest:
            rows = self.transmitters.rows(np.array([tx]))
            octaves = np.abs(np.log2(known_hz[rows] / carrier_hz))
            found.append(rows[np.argsort(octaves, kind="stable")])
        place = np.repeat(np.arange(len(found)), [len(rows) for rows in found])
        return np.concatenate(found), place, distance_m[place]

    def _weights(
        self, tx: Int[IntArray, "n"], distance_m: Float[FloatArray, "n"], counts: Int[IntArray, "C 2"]
    ) -> Float[FloatArray, "C n"]:
        """The weight of each row, ordered as `_neighbours` does, by each of C counts of transmitters and carriers.

        It is 0 beyond the counts.
        """
        num_tx, num_carriers = counts[:, :1], counts[:, 1:]
        place_tx = np.unique(tx, return_inverse=True)[1]
        place_carrier = np.arange(len(tx)) - np.searchsorted(place_tx, place_tx)
        is_taken = (place_tx < num_tx) & (place_carrier < num_carriers)
        num_kept = np.minimum(np.bincount(place_tx)[place_tx], num_carriers)
        return is_taken / num_kept / (distance_m + self._softening_m)

    def _best_counts(self) -> dict[str, tuple[int, int]]:
        """For each kind of query the counts of the highest median SSIM.

        Of equally good ones it is that of the fewest transmitters, and then of the most carriers.
        """
        train, inner_hz = self.transmitters.train, inner_carriers_hz(self.transmitters.train)
        queries = np.random.default_rng(0).permutation(len(train))[:_NUM_QUERIES].tolist()
        near = [self._neighbours(train.tx_position_m[q], train.carrier_hz[q], max(_NUM_TX) + 1) for q in queries]
        needed = np.unique(np.concatenate([queries, *(rows for rows, _, _ in near)]))
        known = CoarseDataset.of(train, _STRIDE).pas(needed)
        scores: dict[str, list[FloatArray]] = {kind: [] for kind in KINDS}
        places = place_index(train)
        for query, (rows, tx, distance_m) in zip(queries, near, strict=True):
            query_hz = train.carrier_hz[query]
            maps, truth = (
                known[np.searchsorted(needed, rows)],
                known[[np.searchsorted(needed, query)]].repeat(len(_COUNTS), 0),
            )
            same_carrier = train.carrier_hz[rows] == query_hz
            same_tx = places[rows] == places[query]
            is_inner = query_hz in inner_hz or not len(inner_hz)
            for kind, left_out in zip(KINDS, (same_carrier, same_tx, same_carrier | same_tx), strict=True):
                left = ~left_out
                if not left.any() or not (is_inner or kind == KINDS[1]):
                    continue
                weights = self._weights(tx[left], distance_m[left], np.array(_COUNTS))
                blended = np.tensordot(weights.astype(np.float32), maps[left], axes=1)
                blended /= blended.max(axis=(1, 2), keepdims=True)
                scores[kind].append(similarities(blended, truth))
        return {kind: _best(of_kind) for kind, of_kind in scores.items()}


def _best(scores: list[FloatArray]) -> tuple[int, int]:
    """The counts of the highest median score; each query has a score for each of `_COUNTS`. 1 and 1 without queries."""
    if not scores:
        return 1, 1
    medians = np.median(scores, axis=0).round(9)  # weights of equal sums differ by their rounding
    return max(zip(medians, _COUNTS, strict=True), key=lambda pair: (pair[0], -pair[1][0], pair[1][1]))[1]
