"""Protocols: which samples of a data set a method is trained on, and which samples it is tested on.

A sample is one transmitter at one carrier. Every protocol makes one or several splits of the samples into a training
part and a test part. What a test says depends on what the method has already seen of it in training:

    protocol         tested samples                                  seen in training
    lofo             all transmitters at one carrier f               the same transmitters, at all other carriers
    sparse           all transmitters at 24.25 GHz                   the same transmitters, at 2, 3 or 5 other carriers
    held-out-tx      a fifth of the transmitters at every carrier    the same carriers, from the other transmitters
    lofo-unseen-tx   that fifth of the transmitters at carrier f     neither these transmitters nor f

`lofo` (leave one frequency out) and `sparse` test unseen carriers, but they leak the places: a method that copies the
map of the same transmitter from another carrier scores well, so these scores say nothing about unseen places.
`held-out-tx` tests unseen places, but it leaks the carriers: its scores say nothing about unseen carriers.
`lofo-unseen-tx` leaks nothing: it is trained on the other transmitters at the other carriers. In all of them the room
and the receiver are the same in training and in test.

A sample that no path reaches is in neither part, because a channel of zeros has no map.

Settings are chosen on validation rows, which are some of a split's training rows, so that the test says something new.
They are held out as the tested ones are: at one carrier inside the band of the training carriers, the nearest to the
tested one, or of a tenth of the training transmitters, or both. `make_splits` with `on="validation"` gives the splits
that train on the other training rows and test on those. Their protocol is called `lofo-validation`, and so on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from pydantic import InstanceOf
from scipy.spatial import KDTree

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ProtocolError, UnknownNameError
from xfreqbench.system.arguments import Numbers, checked
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import format_ghz, format_ghz_list, ghz_to_hz

PROTOCOL_VERSION = "1"
LOFO_TARGETS_HZ = tuple(map(ghz_to_hz, (2.4, 24.25, 77.0)))  # the paper's
SPARSE_TEST_HZ = ghz_to_hz(24.25)
UNSEEN_SHARE = 0.2  # of the transmitters
_UNSEEN_SEED = 0
VALIDATION_SHARE, LEAST_VALIDATION_TX = 0.1, 4  # of the training transmitters
LEAST_TRAINING_TX, LEAST_TRAINING_CARRIERS = 10, 3  # with fewer, nothing is held out for validation
SPARSE_TRAINING_GHZ = ((10.0, 37.0), (10.0, 37.0, 94.0), (1.0, 10.0, 37.0, 60.0, 94.0))  # the paper's


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

    @property
    def sha256(self) -> str:
        """Hash of the name, the protocol, its version, and the numbers of all samples."""
        rows = [self.train.tolist(), self.test.tolist()]
        content = json.dumps([self.name, self.protocol, self.version, *rows])
        return hashlib.sha256(content.encode()).hexdigest()


def lofo(dataset: PasDataset, targets_hz: Sequence[float] = LOFO_TARGETS_HZ) -> list[Split]:
    """Leave one frequency out: test all samples at one carrier, train on all at the others.

    Returns one split for each carrier in `targets_hz`. It leaks places: every tested transmitter is trained on at
    the other carriers. Raises `ProtocolError` where the data lack a target, or have no other carrier.
    """
    _require_lofo(dataset, "lofo", targets_hz)
    return [_lofo_split(dataset, "lofo", target) for target in targets_hz]


def sparse_frequency(dataset: PasDataset, test_hz: float = SPARSE_TEST_HZ) -> list[Split]:
    """Train on all samples at two, three or five carriers (the paper's), test all at another carrier.

    Returns three splits. It leaks places: every tested transmitter is trained on at the training carriers. Raises
    `ProtocolError` where the data lack one of the carriers.
    """
    trainings = [[ghz_to_hz(carrier) for carrier in training] for training in SPARSE_TRAINING_GHZ]
    _require_carriers(dataset, "sparse", sorted({test_hz, *trainings[-1], *trainings[1]}))
    splits = []
    for training_hz in trainings:
        name = f"sparse-{_dense(format_ghz(test_hz))}-from-{_dense(format_ghz_list(training_hz))}"
        trained = np.isin(dataset.carrier_hz, training_hz)
        splits.append(_split(dataset, name, "sparse", trained, dataset.carrier_hz == test_hz))
    return splits


def held_out_tx(dataset: PasDataset) -> list[Split]:
    """Test a fifth of the transmitters at every carrier, train on the other transmitters at every carrier.

    Returns one split. It leaks carriers: every tested carrier is trained on, from other transmitters. The fifth is
    drawn at random, the same at every call for the same number of transmitters. Raises `ProtocolError` for fewer
    than two transmitters.
    """
    unseen = _is_unseen(dataset)
    return [_split(dataset, "held-out-tx", "held-out-tx", ~unseen, unseen)]


def lofo_unseen_tx(dataset: PasDataset, targets_hz: Sequence[float] = LOFO_TARGETS_HZ) -> list[Split]:
    """Test the transmitters of `held_out_tx` at one carrier, train on the other transmitters at the other carriers.

    Returns one split for each carrier in `targets_hz`. Nothing leaks: neither the tested carrier nor a tested
    transmitter is trained on. Raises `ProtocolError` as `lofo` and `held_out_tx` do.
    """
    _require_lofo(dataset, "lofo-unseen-tx", targets_hz)
    unseen = _is_unseen(dataset)
    return [_lofo_split(dataset, "lofo-unseen-tx", target, unseen) for target in targets_hz]


PROTOCOLS = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx")
VALIDATIONS = {f"{protocol}-validation": protocol for protocol in PROTOCOLS}
_AT_UNSEEN_CARRIERS, _OF_UNSEEN_TX = ("lofo", "sparse", "lofo-unseen-tx"), ("held-out-tx", "lofo-unseen-tx")
_BY_TARGET = {"lofo": lofo, "lofo-unseen-tx": lofo_unseen_tx}
_WHOLE = {"sparse": sparse_frequency, "held-out-tx": held_out_tx}
Known = TypeVar("Known")
Targets = Literal["all"] | Numbers | None
ScoredOn = Literal["test", "validation"]


@checked
def make_splits(
    dataset: InstanceOf[PasDataset], protocol: str, targets_hz: Targets = None, on: ScoredOn = "test"
) -> list[Split]:
    """The splits of a protocol, which is one of `PROTOCOLS`; raises `UnknownNameError` and `ProtocolError`.

    `targets_hz` are the tested carriers of `lofo` and `lofo-unseen-tx` in hertz: the paper's if None, and every
    carrier at which a path arrives if "all". The other protocols choose their own.

    With `on="validation"`, the rows that are tested are some of each split's training rows, and the others are trained
    on; see the top of this module. `sparse` then has no split for two training carriers, as none is between them.
    """
    splits = _tested_splits(dataset, protocol, targets_hz)
    if on == "test":
        return splits
    if protocol == "sparse":
        splits = [split for split in splits if len(inner_carriers_hz(dataset.subset(split.train)))]
    return [_validation_split(dataset, split) for split in splits]


def _tested_splits(dataset: PasDataset, protocol: str, targets_hz: Targets) -> list[Split]:
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
    """The split with that name of a protocol or of its validation; raises `UnknownNameError` and `ProtocolError`."""
    if protocol in VALIDATIONS:
        tested = VALIDATIONS[protocol]
        return _validation_split(dataset, find_split(dataset, tested, tested + name.removeprefix(protocol)))
    if protocol in _BY_TARGET:  # only this split is made, because another carrier may be without any path
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
    """Whether each sample is of a held-out transmitter."""
    number = max(1, round(UNSEEN_SHARE * len(np.unique(dataset.tx_index))))
    return np.isin(dataset.tx_index, _drawn_tx(dataset, np.random.default_rng(_UNSEEN_SEED), number))


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
    return _drawn_tx(train, generator, max(least, tenth if most is None else min(most, tenth)))


def _drawn_tx(dataset: PasDataset, generator: np.random.Generator, number: int) -> Int[IntArray, "t"]:
    transmitters = np.unique(dataset.tx_index)
    return transmitters[generator.permutation(len(transmitters))[:number]]


def _validation_split(dataset: PasDataset, split: Split) -> Split:
    """The split that trains on a part of a split's training rows and tests on another part of them."""
    protocol = f"{split.protocol}-validation"
    name = protocol + split.name.removeprefix(split.protocol)
    train = dataset.subset(split.train)
    at_held_out = np.isin(dataset.carrier_hz, train.carrier_hz)
    of_held_out = np.isin(dataset.tx_index, train.tx_index)
    is_left = np.isin(np.arange(len(dataset)), split.train)
    if split.protocol in _AT_UNSEEN_CARRIERS:
        at_held_out = dataset.carrier_hz == _validation_carrier_hz(
            train, name, dataset.carrier_hz[split.test[0]]
        )
        is_left &= ~at_held_out
    if split.protocol in _OF_UNSEEN_TX:
        held_out = validation_tx(train, np.random.default_rng(_UNSEEN_SEED))
        if not len(held_out):
            raise ProtocolError(
                f"Split {name!r} holds out a tenth of the training transmitters, of which there must be "
                f"{LEAST_TRAINING_TX} or more, but there are {len(np.unique(train.tx_index))}. Generate more."
            )
        of_held_out = np.isin(dataset.tx_index, held_out)
        is_left &= ~of_held_out
    return _split(dataset, name, protocol, is_left, at_held_out & of_held_out)


def _validation_carrier_hz(train: PasDataset, name: str, tested_hz: float) -> float:
    """Of the inner carriers of a training the nearest to the tested one, by their ratio."""
    inner_hz = inner_carriers_hz(train)
    if not len(inner_hz):
        raise ProtocolError(
            f"Split {name!r} holds out a carrier inside the band of the training carriers, of which there must be "
            f"{LEAST_TRAINING_CARRIERS} or more, but they are {format_ghz_list(np.unique(train.carrier_hz))}. "
            "Generate more carriers."
        )
    return float(inner_hz[np.argmin(np.abs(np.log(inner_hz / tested_hz)))])


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
    trained_positions = KDTree(np.unique(dataset.tx_position_m[train], axis=0))
    distance_m = float(np.median(trained_positions.query(dataset.tx_position_m[test])[0]))
    return Split(name, protocol, PROTOCOL_VERSION, train, test, num_without_path, shared, distance_m)


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
