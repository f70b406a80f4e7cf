"""Which training rows are held out to choose settings. Methods need nothing else of splits."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.scene.patches import components
from xfreqbench.types import FloatArray, IntArray

VALIDATION_SHARE, LEAST_VALIDATION_TX = 0.1, 4  # of the training transmitters
LEAST_TRAINING_TX, LEAST_TRAINING_CARRIERS = 10, 3  # with fewer, nothing is held out for validation


def place_index(dataset: PasDataset) -> Int[IntArray, "N"]:
    """Index of the first transmitter at each sample's place: those within a millimetre of each other are one place."""
    return _first_at_place(dataset.tables["tx_position_m"].tobytes())[dataset.tx_index]


@lru_cache(maxsize=8)
def _first_at_place(tx_position_m: bytes) -> Int[IntArray, "T"]:
    from scipy.spatial import KDTree

    position_m, of_tx = np.unique(np.frombuffer(tx_position_m).reshape(-1, 3), axis=0, return_inverse=True)
    near = KDTree(position_m).query_pairs(1e-3, output_type="ndarray")
    place_of_tx = components(near[:, 0], near[:, 1], len(position_m))[of_tx.ravel()]
    _, first, place = np.unique(place_of_tx, return_index=True, return_inverse=True)
    return first[place]


def inner_carriers_hz(train: PasDataset) -> Float[FloatArray, "F"]:
    """The carriers of a training that may be held out: all except the lowest and the highest, ascending."""
    return np.unique(train.carrier_hz)[1:-1]


def validation_tx(
    train: PasDataset, generator: np.random.Generator, most: int | None = None, least: int = LEAST_VALIDATION_TX
) -> Int[IntArray, "t"]:
    """The places of a training's transmitters that are held out, by `place_index`: a tenth, drawn by `generator`.

    They are at least `least`, and at most `most` if it is given; none if there are fewer than `LEAST_TRAINING_TX`.
    """
    number = len(np.unique(place_index(train)))
    if number < LEAST_TRAINING_TX:
        return np.empty(0, np.int64)
    tenth = int(VALIDATION_SHARE * number)
    return drawn_tx(train, generator, max(least, tenth if most is None else min(most, tenth)))


def drawn_tx(dataset: PasDataset, generator: np.random.Generator, number: int) -> Int[IntArray, "t"]:
    """`number` places of a data set's transmitters, drawn by `generator`, by `place_index`."""
    places = np.unique(place_index(dataset))
    return places[generator.permutation(len(places))[:number]]
