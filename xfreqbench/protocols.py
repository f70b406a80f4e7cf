"""Which samples are trained on and which are tested: carriers held out, transmitters held out, or both.

Samples without any path are in neither part: a channel of zeros has no map.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Bool, Int
from numpy.typing import NDArray
from scipy.spatial import KDTree

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import IntArray, PasDataset
from xfreqbench.errors import ProtocolError, UnknownNameError
from xfreqbench.units import format_ghz, format_ghz_list, ghz_to_hz

PROTOCOL_VERSION = "1"
LOFO_TARGETS_HZ = tuple(map(ghz_to_hz, (2.4, 24.25, 77.0)))  # the paper's
SPARSE_TEST_HZ = ghz_to_hz(24.25)
UNSEEN_SHARE = 0.2  # of the transmitters
_UNSEEN_SEED = 0
SPARSE_TRAINING_GHZ = ((10.0, 37.0), (10.0, 37.0, 94.0), (1.0, 10.0, 37.0, 60.0, 94.0))  # the paper's


@dataclass(frozen=True, eq=False)
class Split:
    """Rows of a data set to train on and to test on.

    `num_without_path` counts the samples at test carriers that were left out because no path arrives.
    `shares_transmitters` says whether a tested transmitter is also trained on, at other carriers;
    `nearest_trained_m` is the median distance from a tested transmitter to the nearest trained one.
    """

    name: str
    protocol: str
    version: str
    train: Int[IntArray, "n"]
    test: Int[IntArray, "m"]
    num_without_path: int
    shares_transmitters: bool
    nearest_trained_m: float

    @property
    def sha256(self) -> str:
        """Hash of the name, the protocol's version and every row."""
        rows = [self.train.tolist(), self.test.tolist()]
        content = json.dumps([self.name, self.protocol, self.version, *rows])
        return hashlib.sha256(content.encode()).hexdigest()


def lofo(dataset: PasDataset, targets_hz: Sequence[float] = LOFO_TARGETS_HZ) -> list[Split]:
    """Leave one frequency out: train on every other carrier, test on all of one. One split a target.

    Raises `ProtocolError` where the data lack a target, or have no other carrier.
    """
    _require_lofo(dataset, "lofo", targets_hz)
    return [_lofo_split(dataset, "lofo", target) for target in targets_hz]


def sparse_frequency(dataset: PasDataset, test_hz: float = SPARSE_TEST_HZ) -> list[Split]:
    """Train on two, three and five carriers (the paper's), test on one that is not among them.

    Raises `ProtocolError` where the data lack one of the carriers.
    """
    trainings = [[ghz_to_hz(carrier) for carrier in training] for training in SPARSE_TRAINING_GHZ]
    _require_carriers(dataset, "sparse", sorted({test_hz, *trainings[-1], *trainings[1]}))
    return [_sparse_split(dataset, training, test_hz) for training in trainings]


def held_out_tx(dataset: PasDataset) -> list[Split]:
    """Hold out a fifth of the transmitters at every carrier, train on the others at every carrier: one split.

    Which ones is drawn once, from their number alone. Raises `ProtocolError` for fewer than two.
    """
    unseen = _is_unseen(dataset)
    return [_split(dataset, "held-out-tx", "held-out-tx", ~unseen, unseen)]


def lofo_unseen_tx(dataset: PasDataset, targets_hz: Sequence[float] = LOFO_TARGETS_HZ) -> list[Split]:
    """Leave one frequency out, tested on transmitters that are trained on at no carrier: without any leak.

    The transmitters of `held_out_tx` are tested. Raises `ProtocolError` as `lofo` and `held_out_tx` do.
    """
    _require_lofo(dataset, "lofo-unseen-tx", targets_hz)
    unseen = _is_unseen(dataset)
    return [_lofo_split(dataset, "lofo-unseen-tx", target, unseen) for target in targets_hz]


PROTOCOLS = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx")
_BY_TARGET = {"lofo": lofo, "lofo-unseen-tx": lofo_unseen_tx}
_WHOLE = {"sparse": sparse_frequency, "held-out-tx": held_out_tx}
Known = TypeVar("Known")
Targets = Sequence[float] | Literal["all"] | None


def make_splits(dataset: PasDataset, protocol: str, targets_hz: Targets = None) -> list[Split]:
    """Splits of a protocol by name; raises `UnknownNameError` and `ProtocolError`.

    `targets_hz` are the held-out carriers of `lofo` and `lofo-unseen-tx`: the paper's where None, every
    carrier at which a path arrives where "all". The other protocols take none.
    """
    if protocol in _BY_TARGET:
        heard = np.unique(dataset.carrier_hz[dataset.has_path]).tolist()
        chosen = heard if targets_hz == "all" else targets_hz or LOFO_TARGETS_HZ
        return _BY_TARGET[protocol](dataset, list(dict.fromkeys(chosen)))
    if protocol not in _WHOLE:
        raise UnknownNameError("protocol", protocol, PROTOCOLS)
    if targets_hz is not None:
        raise ProtocolError(f"Protocol {protocol!r} chooses what it tests; leave the targets out.")
    return _WHOLE[protocol](dataset)


def find_split(dataset: PasDataset, protocol: str, name: str) -> Split:
    """One split of a protocol by name; raises `UnknownNameError` and `ProtocolError`."""
    if protocol in _BY_TARGET:  # only the one: another carrier may be without any path
        targets = {
            _target_name(protocol, target): target for target in np.unique(dataset.carrier_hz).tolist()
        }
        return _BY_TARGET[protocol](dataset, [_named(targets, protocol, name)])[0]
    return _named({split.name: split for split in make_splits(dataset, protocol)}, protocol, name)


def _named(known: Mapping[str, Known], protocol: str, name: str) -> Known:
    if name not in known:
        raise UnknownNameError(f"split of {protocol!r}", name, known)
    return known[name]


def _target_name(protocol: str, target_hz: float) -> str:
    return f"{protocol}-{_dense(format_ghz(target_hz))}"


def _lofo_split(
    dataset: PasDataset, protocol: str, target_hz: float, unseen: Bool[NDArray[np.bool_], "N"] | None = None
) -> Split:
    held_out, name = dataset.carrier_hz == target_hz, _target_name(protocol, target_hz)
    if unseen is None:
        return _split(dataset, name, protocol, ~held_out, held_out)
    return _split(dataset, name, protocol, ~held_out & ~unseen, held_out & unseen)


def _is_unseen(dataset: PasDataset) -> Bool[NDArray[np.bool_], "N"]:
    """Which samples are of the transmitters held out."""
    transmitters = np.unique(dataset.tx_index)
    number = max(1, round(UNSEEN_SHARE * len(transmitters)))
    chosen = np.random.default_rng(_UNSEEN_SEED).permutation(len(transmitters))[:number]
    return np.isin(dataset.tx_index, transmitters[chosen])


def _sparse_split(dataset: PasDataset, training_hz: Sequence[float], test_hz: float) -> Split:
    name = f"sparse-{_dense(format_ghz(test_hz))}-from-{_dense(format_ghz_list(training_hz))}"
    trained = np.isin(dataset.carrier_hz, training_hz)
    return _split(dataset, name, "sparse", trained, dataset.carrier_hz == test_hz)


def _split(
    dataset: PasDataset,
    name: str,
    protocol: str,
    trained: Bool[NDArray[np.bool_], "N"],
    tested: Bool[NDArray[np.bool_], "N"],
) -> Split:
    train = np.flatnonzero(trained & dataset.has_path)
    test = np.flatnonzero(tested & dataset.has_path)
    if not len(train) or not len(test):
        raise ProtocolError(
            f"Split {name!r} has {len(train)} samples to train on and {len(test)} to test on: too few "
            "transmitters receive a path. Generate more transmitters."
        )
    shared = bool(np.isin(dataset.tx_index[test], dataset.tx_index[train]).any())
    num_without_path = int((tested & ~dataset.has_path).sum())
    distance_m = _nearest_trained_m(dataset, train, test)
    return Split(name, protocol, PROTOCOL_VERSION, train, test, num_without_path, shared, distance_m)


def _nearest_trained_m(dataset: PasDataset, train: Int[IntArray, "n"], test: Int[IntArray, "m"]) -> float:
    """Median over the tested samples; 0 where their transmitters are trained on."""
    trained, tested = dataset.tx_position_m[train], dataset.tx_position_m[test]
    return float(np.median(KDTree(np.unique(trained, axis=0)).query(tested)[0]))


def _require_lofo(dataset: PasDataset, protocol: str, targets_hz: Sequence[float]) -> None:
    _require_carriers(dataset, protocol, targets_hz)
    if dataset.num_carriers < 2:
        raise ProtocolError(
            f"{protocol!r} needs two carriers or more, but the data set has one. Generate more."
        )


def _require_carriers(dataset: PasDataset, protocol: str, needed_hz: Sequence[float]) -> None:
    present: FloatArray = np.unique(dataset.carrier_hz)
    missing = [carrier for carrier in needed_hz if carrier not in present]
    if missing:
        raise ProtocolError(
            f"Protocol {protocol!r} needs {format_ghz_list(missing)}, but the data set has "
            f"{format_ghz_list(present)}. Generate those carriers too, or choose other targets."
        )


def _dense(carriers: str) -> str:
    return carriers.replace(", ", "-").replace(" ", "")
