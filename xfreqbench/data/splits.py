"""What a split is, and which training rows are held out to choose settings by: what methods need of splits.

The protocols, which say what is tested, are in `xfreqbench.data.protocols`. No method needs them.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from scipy.spatial import KDTree

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ProtocolError
from xfreqbench.types import FloatArray, IntArray

PROTOCOL_VERSION = "1"
VALIDATION_SHARE, LEAST_VALIDATION_TX = 0.1, 4  # of the training transmitters
LEAST_TRAINING_TX, LEAST_TRAINING_CARRIERS = 10, 3  # with fewer, nothing is held out for validation


@dataclass(frozen=True, eq=False)
class Split:
    """The samples to train on and to test on, by their numbers in the data set.

    `num_without_path` counts the samples that would be tested, but are left out because no path arrives.
    `shares_transmitters` says whether a tested transmitter is trained on too, at other carriers.
    `nearest_trained_m` is the distance from a tested transmitter to the nearest trained one, in metres: the median
    over the tested samples, 0 where the tested transmitters are trained on.
    """

    name: str
    protocol: str
    version: str
    train: Int[IntArray, "n"]
    test: Int[IntArray, "m"]
    num_without_path: int
    shares_transmitters: bool
    nearest_trained_m: float

    @classmethod
    def of(
        cls,
        dataset: PasDataset,
        name: str,
        protocol: str,
        trained: Bool[NDArray[np.bool_], "N"],
        tested: Bool[NDArray[np.bool_], "N"],
    ) -> Split:
        """The split that trains and tests on these of the N samples, as far as a path reaches them.

        Raises `ProtocolError` where none is left to train or to test on.
        """
        train, test = (np.flatnonzero(chosen & dataset.has_path) for chosen in (trained, tested))
        if not len(train) or not len(test):
            raise ProtocolError(
                f"Split {name!r} has {len(train)} samples to train on and {len(test)} to test on: too few "
                "transmitters receive a path. Generate more transmitters."
            )
        shared = bool(np.isin(dataset.tx_index[test], dataset.tx_index[train]).any())
        num_without_path = int((tested & ~dataset.has_path).sum())
        trained_positions = KDTree(np.unique(dataset.tx_position_m[train], axis=0))
        distance_m = float(np.median(trained_positions.query(dataset.tx_position_m[test])[0]))
        return cls(name, protocol, PROTOCOL_VERSION, train, test, num_without_path, shared, distance_m)

    @property
    def sha256(self) -> str:
        """Hash of the name, the protocol, its version, and the numbers of all samples."""
        rows = [self.train.tolist(), self.test.tolist()]
        content = json.dumps([self.name, self.protocol, self.version, *rows])
        return hashlib.sha256(content.encode()).hexdigest()


def inner_carriers_hz(train: PasDataset) -> Float[FloatArray, "F"]:
    """The carriers of a training that may be held out: all but the lowest and the highest, ascending; maybe none."""
    return np.unique(train.carrier_hz)[1:-1]


def validation_tx(
    train: PasDataset,
    generator: np.random.Generator,
    most: int | None = None,
    least: int = LEAST_VALIDATION_TX,
) -> Int[IntArray, "t"]:
    """The transmitters of a training that are held out, by their indices: a tenth, drawn by `generator`.

    They are `least` at least, and `most` at most if it is given; none of fewer than `LEAST_TRAINING_TX`.
    """
    number = len(np.unique(train.tx_index))
    if number < LEAST_TRAINING_TX:
        return np.empty(0, np.int64)
    tenth = int(VALIDATION_SHARE * number)
    return drawn_tx(train, generator, max(least, tenth if most is None else min(most, tenth)))


def drawn_tx(dataset: PasDataset, generator: np.random.Generator, number: int) -> Int[IntArray, "t"]:
    """So many transmitters of a data set, drawn by `generator`, by their indices."""
    transmitters = np.unique(dataset.tx_index)
    return transmitters[generator.permutation(len(transmitters))[:number]]
