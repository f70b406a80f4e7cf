"""Protocols: which samples of a data set a method is trained on, and which samples it is tested on.

A sample is one transmitter at one carrier. Every protocol makes one or several splits of the samples into a training
part and a test part. The meaning of a test depends on what the method has already seen of it in training:

    protocol         tested samples                                  seen in training
    lofo             all transmitters at one carrier f               the same transmitters, at all other carriers
    sparse           all transmitters at 24.25 GHz                   the same transmitters, at 2, 3 or 5 other carriers
    held-out-tx      a fifth of the transmitters at every carrier    the same carriers, from the other transmitters
    lofo-unseen-tx   that fifth of the transmitters at carrier f     neither these transmitters nor f
    held-out-block   a fifth of the transmitters at every carrier,   the same carriers, from the other transmitters
                     those of two of ten regions of the floor        that are half a metre or more away
    random-samples   a fifth of all samples, drawn one by one        the same transmitters at other carriers, and the
                                                                     same carriers from other transmitters

    held-out-receiver   all samples at one receiver of a file with   the same samples at the other receivers
                        several

`lofo` (leave one frequency out) and `sparse` test unseen carriers, but they leak the places: a method that copies the
map of the same transmitter from another carrier scores well, so these scores say nothing about unseen places.
`held-out-tx` tests unseen places, but it leaks the carriers: its scores say nothing about unseen carriers. It draws
the tested transmitters one by one, so that each has trained neighbours on all sides, and a method that copies the map
of the nearest one does well. In `held-out-block` those that are nearer than half a metre to a tested one are in neither
part; if all transmitters lie within less than 5 m, those nearer than a tenth of this length. `lofo-unseen-tx` leaks
nothing: it is trained on the other transmitters at the other carriers. `random-samples`, the default of the released
code of XFreq-GS, leaks places and carriers: its scores say nothing about either. In all of them except
`held-out-receiver` the room and the receiver are the same in training and in test. There, a method is given the
position and the array of the tested receiver, but no samples of it. It leaks transmitters and carriers.

Transmitters within a millimetre of each other are one place, and in one part, and so are samples of one place at one
carrier. A carrier that agrees with a tested one in nine digits is neither trained on nor tested with it.

A sample that no path reaches is in neither part, because a channel of zeros has no map.

Settings are chosen on validation rows, which are some of a split's training rows, so that the test rows remain unseen.
They are held out like the tested ones: at one carrier inside the band of the training carriers, the nearest to the
tested one, or of a tenth of the training transmitters, or both; of one of ten regions of the training transmitters; or
a tenth of the training samples. `make_splits` with `on="validation"` gives the splits that train on the other training
rows and test on those. Their protocol is called `lofo-validation`, and so on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import InstanceOf

from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.data.validation import (
    LEAST_TRAINING_CARRIERS,
    LEAST_TRAINING_TX,
    VALIDATION_SHARE,
    drawn_tx,
    inner_carriers_hz,
    place_index,
    validation_tx,
)
from xfreqbench.errors import DataError, ProtocolError, UnknownNameError
from xfreqbench.system.arguments import ScoredOn, TargetsGhz, checked
from xfreqbench.system.files import json_sha256
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import band_text, format_ghz, format_ghz_list, ghz_to_hz

PROTOCOL_VERSION = "1"
LOFO_TARGETS_GHZ = (2.4, 24.25, 77.0)  # the paper's
LOFO_TARGETS_HZ = tuple(map(ghz_to_hz, LOFO_TARGETS_GHZ))
SPARSE_TEST_HZ = ghz_to_hz(24.25)
SPARSE_TRAINING_GHZ = ((10.0, 37.0), (10.0, 37.0, 94.0), (1.0, 10.0, 37.0, 60.0, 94.0))  # the paper's
UNSEEN_SHARE = 0.2  # of the transmitters, or of the samples
NUM_BLOCKS = 10  # regions of the floor, each with as many transmitters
CELL_M = 1.0  # scores of transmitters so far apart are half as correlated as those of neighbours

Known = TypeVar("Known")
Mask = Bool[NDArray[np.bool_], "N"]


@dataclass(frozen=True, eq=False)
class Question:
    """What a fitted method is asked: the maps of the samples `asked`, given the samples `heard` of the same room.

    `heard` is None where the method was fitted to that room. `place` says in errors where it is.
    """

    asked: PasDataset
    heard: PasDataset | None
    place: str


@dataclass(frozen=True, eq=False, repr=False)
class Split:
    """The samples to train on and to test on, by their numbers in the data set.

    `num_without_path` counts the samples that would be tested, but are left out because no path arrives.
    `shares_transmitters` says whether a tested transmitter is trained on too, at other carriers.
    `nearest_trained_m` is the distance from a tested transmitter to the nearest trained one, in metres: the median
    over the tested samples, 0 if the tested transmitters are trained on.

    If other receivers than the tested one are trained on, `train` is empty and `receivers` names them, each with
    the id of its recipe: all samples of these receivers with a path are trained on.
    """

    name: str
    protocol: str
    version: str
    train: Int[IntArray, "n"]
    test: Int[IntArray, "m"]
    num_without_path: int
    shares_transmitters: bool
    nearest_trained_m: float
    receivers: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, dataset: PasDataset, name: str, protocol: str, trained: Mask, tested: Mask) -> Split:
        """The split that trains and tests on these of the N samples, without those that no path reaches.

        Raises `ProtocolError` if none is left to train or to test on, and `DataError` if all maps are constant.
        """
        from scipy.spatial import KDTree

        _require_directions(dataset)
        train, test = (np.flatnonzero(chosen & dataset.has_path) for chosen in (trained, tested))
        if not len(train) or not len(test):
            raise ProtocolError(
                f"Split {name!r} has {len(train)} samples to train on and {len(test)} to test on: too few "
                "transmitters receive a path. Generate more transmitters."
            )
        places = place_index(dataset)
        shared = bool(np.isin(places[test], places[train]).any())
        num_without_path = int((tested & ~dataset.has_path).sum())
        trained_positions = KDTree(np.unique(dataset.tx_position_m[train], axis=0))
        distance_m = float(np.median(trained_positions.query(dataset.tx_position_m[test])[0]))
        return cls(name, protocol, PROTOCOL_VERSION, train, test, num_without_path, shared, distance_m)

    def trained_band_hz(self, dataset: PasDataset) -> tuple[float, float]:
        """The lowest and the highest carrier that is trained on; other receivers train on all."""
        carrier_hz = dataset.carrier_hz[self.train] if len(self.train) else dataset.carrier_hz
        return float(carrier_hz.min()), float(carrier_hz.max())

    def extrapolation(self, dataset: PasDataset) -> str | None:
        """Words on the tested carriers outside the band of the training carriers; None without any."""
        low_hz, high_hz = self.trained_band_hz(dataset)
        tested_hz = np.unique(dataset.carrier_hz[self.test])
        outside_hz = tested_hz[(tested_hz < low_hz) | (tested_hz > high_hz)]
        if not len(outside_hz):
            return None
        return (
            f"{self.name} extrapolates to {format_ghz_list(outside_hz)}: it is trained on {band_text(low_hz, high_hz)}"
        )

    def __repr__(self) -> str:
        return f"<Split {self.name!r}: {len(self.train)} samples to train on, {len(self.test)} to test on>"

    @cached_property
    def sha256(self) -> str:
        """Hash of the name, the protocol, its version, and the numbers of all samples."""
        rows = [self.train.tolist(), self.test.tolist()]
        others = [self.receivers] if self.receivers else []
        return json_sha256([self.name, self.protocol, self.version, *rows, *others])

    def training_part(self, dataset: PasDataset) -> PasDataset:
        """The training data of a method, from the data set that the split was made of."""
        train = isolated(dataset[self.train])
        others = (dataset.at(name) for name, _ in self.receivers)
        return replace(train, other_receivers=tuple(isolated(other[other.has_path]) for other in others))

    def questions(self, dataset: PasDataset) -> Iterator[Question]:
        """What a method is asked for, of the data set that the split was made of: the maps of all tested samples."""
        yield Question(dataset[self.test], None, f"on split {self.name!r}")

    def notes(self, dataset: PasDataset) -> list[str]:
        """What a user may not expect: one link of many, absent splits, tested carriers outside of the training band."""
        known = dataset.file_header
        names = (() if self.receivers else known.receivers), known.polarizations
        links = [
            f"methods see {axis} {shown} of {', '.join(names)}; option {axis} chooses another"
            for axis, shown, names in zip(("receiver", "polarization"), dataset.link, names, strict=True)
            if names
        ]
        absent = left_out(dataset) if self.protocol.startswith("sparse") else None
        return [*links, *filter(None, (absent, self.extrapolation(dataset)))]


def _require_directions(dataset: PasDataset) -> None:
    if not dataset.header.receiver.resolves_directions:
        raise DataError(
            f"The maps of {dataset.path} are nearly constant, because its array has hardly any extent, and every "
            "method would predict them. Generate data of an array of several elements, half a wavelength apart."
        )


def _sparse_splits(dataset: PasDataset) -> list[Split]:
    """The splits whose carriers the data have; raises `ProtocolError` if there is none."""
    missing_hz = _sparse_missing_hz(dataset)
    if all(missing_hz.values()):
        raise _sparse_error(dataset, list(missing_hz))
    splits = []
    for training_hz in (training_hz for training_hz, missing in missing_hz.items() if not missing):
        trained = np.isin(dataset.carrier_hz, training_hz)
        tested = dataset.carrier_hz == SPARSE_TEST_HZ
        splits.append(Split.of(dataset, _sparse_name(training_hz), "sparse", trained, tested))
    return splits


def _sparse_missing_hz(dataset: PasDataset) -> dict[tuple[float, ...], list[float]]:
    """The carriers that the data lack, for each set of training carriers of `sparse`."""
    trainings = [tuple(map(ghz_to_hz, carriers_ghz)) for carriers_ghz in SPARSE_TRAINING_GHZ]
    present_hz = {*np.unique(dataset.carrier_hz).tolist()}
    return {training_hz: sorted({SPARSE_TEST_HZ, *training_hz} - present_hz) for training_hz in trainings}


def _sparse_name(training_hz: Sequence[float]) -> str:
    carriers = format_ghz_list(training_hz).replace(", ", "-")
    return f"sparse-{format_ghz(SPARSE_TEST_HZ)}-from-{carriers}".replace(" ", "")


def left_out(dataset: PasDataset) -> str | None:
    """Words on the splits of `sparse` that are not made because the data lack their carriers; None without any."""
    lacking = {_sparse_name(hz): missing for hz, missing in _sparse_missing_hz(dataset).items() if missing}
    each = ", ".join(f"{name} (no {format_ghz_list(missing)})" for name, missing in lacking.items())
    return f"sparse leaves out {len(lacking)} of {len(SPARSE_TRAINING_GHZ)} splits: {each}" if lacking else None


def _sparse_error(dataset: PasDataset, trainings: Sequence[Sequence[float]]) -> ProtocolError:
    """The error that says which carriers to generate for at least one of several sets of training carriers."""
    trained = "; or ".join(map(format_ghz_list, trainings))
    asked = ",".join(f"{carrier / 1e9:g}" for carrier in sorted([SPARSE_TEST_HZ, *trainings[0]]))
    return ProtocolError(
        f"Protocol 'sparse' tests {format_ghz(SPARSE_TEST_HZ)} and trains on {trained}, but the data set has "
        f"{format_ghz_list(np.unique(dataset.carrier_hz))}. Generate data with the carriers {asked} (in GHz) or more, "
        "or run protocol 'lofo' with targets that the data set has."
    )


def _held_out_receiver_splits(dataset: PasDataset) -> list[Split]:
    """One split, of the receiver that is shown; raises `ProtocolError` for a file of one, or without any path."""
    held_out = dataset.link[0]
    if held_out is None:
        raise ProtocolError(
            f"Protocol {HELD_OUT_RECEIVER!r} needs a file of several receivers, but {dataset.path} has one. Generate "
            "it with --receiver all, in a scene with several [[receiver]]."
        )
    _require_directions(dataset)
    others = {name: dataset.at(name) for name in dataset.file_header.receivers if name != held_out}
    test = np.flatnonzero(dataset.has_path)
    if not len(test) or not any(other.has_path.any() for other in others.values()):
        raise ProtocolError(f"No path arrives at receiver {held_out!r}, or none at any other: nothing can be tested.")
    trained = tuple((name, other.recipe.id) for name, other in others.items())
    name, num_without_path = f"{HELD_OUT_RECEIVER}-{held_out}", len(dataset) - len(test)
    nothing = np.zeros(0, np.int64)
    return [Split(name, HELD_OUT_RECEIVER, PROTOCOL_VERSION, nothing, test, num_without_path, True, 0.0, trained)]


PROTOCOLS = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx", "held-out-block", "random-samples")  # of any file
HELD_OUT_RECEIVER = "held-out-receiver"  # of a file with several
VALIDATIONS = {f"{protocol}-validation": protocol for protocol in PROTOCOLS}


def protocols() -> list[str]:
    """Names of the protocols for `make_splits` and `run`; the docstring of this module says what each tests."""
    return [*PROTOCOLS, HELD_OUT_RECEIVER]


@checked
def make_splits(
    dataset: InstanceOf[PasDataset], protocol: str, targets_ghz: TargetsGhz = None, on: ScoredOn = "test"
) -> list[Split]:
    """The splits of a protocol, which is one of `protocols()`; raises `UnknownNameError` and `ProtocolError`.

    `targets_ghz` are the tested carriers of `lofo` and `lofo-unseen-tx` in GHz: the paper's if None, and every
    carrier at which a path arrives if "all". The other protocols choose their own.

    With `on="validation"`, some of each split's training rows are tested, and the others are trained on; see the
    docstring of this module. Then `sparse` has no split for two training carriers, because none is between them, and
    `held-out-receiver` has no splits.
    """
    if protocol not in protocols():
        raise UnknownNameError("protocol", protocol, protocols())
    if protocol in ("lofo", "lofo-unseen-tx"):
        if targets_ghz == "all":
            targets_hz = np.unique(dataset.carrier_hz[dataset.has_path]).tolist()
        else:
            targets_hz = list(map(ghz_to_hz, targets_ghz or LOFO_TARGETS_GHZ))
        splits = _lofo_splits(dataset, protocol, list(dict.fromkeys(targets_hz)))
    elif targets_ghz is not None:
        raise ProtocolError(f"Protocol {protocol!r} has no targets to choose; leave them out.")
    elif protocol == "sparse":
        splits = _sparse_splits(dataset)
    elif protocol == HELD_OUT_RECEIVER:
        splits = _held_out_receiver_splits(dataset)
    else:
        of = {"held-out-tx": _tx_masks, "held-out-block": _block_masks, "random-samples": _sample_masks}
        masks = of[protocol](dataset, np.ones(len(dataset), bool), UNSEEN_SHARE)
        splits = [Split.of(dataset, protocol, protocol, *masks)]
    if on == "test":
        return splits
    if protocol == HELD_OUT_RECEIVER:
        raise ProtocolError(f"Protocol {protocol!r} has no validation rows: choose settings on another protocol.")
    if protocol == "sparse":
        inner = [split for split in splits if len(inner_carriers_hz(dataset[split.train]))]
        if not inner:
            raise _sparse_error(dataset, list(_sparse_missing_hz(dataset))[1:])
        splits = inner
    return [_validation_split(dataset, split) for split in splits]


def find_split(dataset: PasDataset, protocol: str, name: str) -> Split:
    """The split of a protocol or of its validation by its name; raises `UnknownNameError` and `ProtocolError`."""
    if protocol in VALIDATIONS:
        tested = VALIDATIONS[protocol]
        return _validation_split(dataset, find_split(dataset, tested, tested + name.removeprefix(protocol)))
    if protocol in ("lofo", "lofo-unseen-tx"):  # only this split is made: another carrier may be without any path
        targets = {_target_name(dataset, protocol, target): target for target in np.unique(dataset.carrier_hz).tolist()}
        return _lofo_splits(dataset, protocol, [_named(targets, protocol, name)])[0]
    return _named({split.name: split for split in make_splits(dataset, protocol)}, protocol, name)


def _named(known: Mapping[str, Known], protocol: str, name: str) -> Known:
    if name not in known:
        raise UnknownNameError(f"split of {protocol!r}", name, known)
    return known[name]


def _target_name(dataset: PasDataset, protocol: str, target_hz: float) -> str:
    """The name of a split: its carrier has nine digits, or all of them if the data set has others like it."""
    digits = 9 if _is_alike(dataset.header.carrier_hz, target_hz).sum() < 2 else 15
    return f"{protocol}-{target_hz / 1e9:.{digits}g}GHz"


def _is_alike(carrier_hz: Float[FloatArray, "n"], target_hz: float) -> Bool[NDArray[np.bool_], "n"]:
    """Whether carriers have the maps of the target, because they agree with it in about nine digits."""
    return np.isclose(carrier_hz, target_hz, rtol=1e-8, atol=0)


def _lofo_splits(dataset: PasDataset, protocol: str, targets_hz: Sequence[float]) -> list[Split]:
    """A split for each target: all samples, or those of the held-out transmitters, are tested there.

    Raises `ProtocolError` if the data lack a target, or have no other carrier.
    """
    every = np.ones(len(dataset), bool)
    trained, tested = (every, every) if protocol == "lofo" else _tx_masks(dataset, every, UNSEEN_SHARE)
    present_hz = np.unique(dataset.carrier_hz)
    if missing_hz := [carrier for carrier in targets_hz if carrier not in present_hz]:
        raise ProtocolError(
            f"Protocol {protocol!r} needs {format_ghz_list(missing_hz)}, but the data set has "
            f"{format_ghz_list(present_hz)}. Choose some of these, as in --targets {present_hz[0] / 1e9:.12g}, or "
            "generate data with the others too."
        )
    splits = []
    for target_hz in targets_hz:
        is_left = ~_is_alike(dataset.carrier_hz, target_hz)
        if not is_left.any():
            raise ProtocolError(
                f"{protocol!r} needs two carriers or more, but the data set has only {format_ghz(target_hz)}. "
                "Generate more."
            )
        is_tested, name = (dataset.carrier_hz == target_hz) & tested, _target_name(dataset, protocol, target_hz)
        splits.append(Split.of(dataset, name, protocol, is_left & trained, is_tested))
    return splits


def _tx_masks(dataset: PasDataset, is_offered: Mask, share: float) -> tuple[Mask, Mask]:
    """Which of the offered samples are trained on, and which are tested: those of a share of the transmitters."""
    places = place_index(dataset)
    number = max(1, round(share * len(np.unique(places))))
    unseen = np.isin(places, drawn_tx(dataset, np.random.default_rng(0), number))
    return is_offered & ~unseen, is_offered & unseen


def _sample_masks(dataset: PasDataset, is_offered: Mask, share: float) -> tuple[Mask, Mask]:
    """Which of the offered samples are trained on, and which are tested, a share of them.

    Samples of one place at carriers that agree in nine digits are one.
    """
    carrier_hz, carrier = np.unique(dataset.carrier_hz, return_inverse=True)
    is_new = ~np.isclose(carrier_hz[1:], carrier_hz[:-1], rtol=1e-8, atol=0)
    sample = place_index(dataset) * len(carrier_hz) + np.concatenate([[0], np.cumsum(is_new)])[carrier]
    offered = np.flatnonzero(is_offered)
    first = offered[np.sort(np.unique(sample[offered], return_index=True)[1])]
    number = max(1, round(share * len(first)))
    tested = np.random.default_rng(0).permutation(first)[:number]
    is_tested = is_offered & np.isin(sample, sample[tested])
    return is_offered & ~is_tested, is_tested


def _block_masks(dataset: PasDataset, is_offered: Mask, share: float) -> tuple[Mask, Mask]:
    """Which samples are trained on, and which are tested: a share of the offered transmitters, whole regions.

    The floor is halved repeatedly across its longer side into ten regions of equally many transmitters. With fewer
    than ten transmitters each is a region.
    """
    from scipy.spatial import KDTree

    places, first = np.unique(place_index(dataset)[is_offered], return_index=True)
    position_m = dataset.tx_position_m[is_offered][first]
    num_blocks = min(NUM_BLOCKS, len(places))
    num_tested = max(1, round(share * num_blocks))
    tested = np.random.default_rng(0).permutation(num_blocks)[:num_tested]
    is_tested = np.isin(blocks(position_m[:, :2], num_blocks), tested)
    is_near = KDTree(position_m[is_tested]).query(position_m)[0] < cell_m(dataset) / 2
    trained, tested = places[~is_tested & ~is_near], places[is_tested]
    return np.isin(place_index(dataset), trained), np.isin(place_index(dataset), tested)


def cell_m(dataset: PasDataset) -> float:
    """Side of the cells of the floor within which scores are alike: 1 m, or a fifth of a floor shorter than 5 m."""
    return min(CELL_M, float(np.ptp(dataset.tables["tx_position_m"][:, :2], axis=0).max()) / 5)


def blocks(position_m: Float[FloatArray, "T 2"], number: int) -> Int[IntArray, "T"]:
    """The number of the region of each position on the floor, of `number` regions with equally many positions.

    An area is divided across its longer side, and so are its parts, until each is one region.
    """
    if number < 2:
        return np.zeros(len(position_m), np.int64)
    along = position_m[:, np.ptp(position_m, axis=0).argmax()]
    low_number = number // 2
    order = np.argsort(along, kind="stable")
    low, high = np.split(order, [round(len(order) * low_number / number)])
    found = np.empty(len(position_m), np.int64)
    found[low] = blocks(position_m[low], low_number)
    found[high] = low_number + blocks(position_m[high], number - low_number)
    return found


def _validation_split(dataset: PasDataset, split: Split) -> Split:
    """The split that trains on a part of a split's training rows and tests on another part of them."""
    protocol = f"{split.protocol}-validation"
    name = protocol + split.name.removeprefix(split.protocol)
    is_offered = np.isin(np.arange(len(dataset)), split.train)
    if split.protocol == "random-samples":
        masks = _sample_masks(dataset, is_offered, VALIDATION_SHARE)
    elif split.protocol == "held-out-block":
        _require_training_tx(dataset[split.train], name)
        places = place_index(dataset)
        of_trained = np.isin(places, places[split.train])
        masks = _block_masks(dataset, of_trained, VALIDATION_SHARE)
    else:
        masks = _unseen_masks(dataset, split, name, is_offered)
    return Split.of(dataset, name, protocol, *masks)


def _unseen_masks(dataset: PasDataset, split: Split, name: str, is_offered: Mask) -> tuple[Mask, Mask]:
    """Which samples are trained on, and which are tested: at a held-out carrier, of held-out transmitters, or both."""
    train = dataset[split.train]
    at_held_out = np.isin(dataset.carrier_hz, train.carrier_hz)
    of_held_out = np.isin(place_index(dataset), place_index(train))
    is_left = is_offered
    if split.protocol in ("lofo", "sparse", "lofo-unseen-tx"):
        inner_hz, tested_hz = inner_carriers_hz(train), dataset.carrier_hz[split.test[0]]
        if not len(inner_hz):
            present = format_ghz_list(np.unique(train.carrier_hz))
            raise ProtocolError(
                f"Split {name!r} holds out a carrier inside the band of the training carriers, so it needs "
                f"{LEAST_TRAINING_CARRIERS} of them or more, but they are {present}. Generate more carriers."
            )
        held_out_hz = float(inner_hz[np.argmin(np.abs(np.log(inner_hz / tested_hz)))])  # the nearest by its ratio
        at_held_out = dataset.carrier_hz == held_out_hz
        is_left = is_left & ~_is_alike(dataset.carrier_hz, held_out_hz)
    if split.protocol in ("held-out-tx", "lofo-unseen-tx"):
        _require_training_tx(train, name)
        of_held_out = np.isin(place_index(dataset), validation_tx(train, np.random.default_rng(0)))
        is_left = is_left & ~of_held_out
    return is_left, at_held_out & of_held_out


def _require_training_tx(train: PasDataset, name: str) -> None:
    number = len(np.unique(place_index(train)))
    if number < LEAST_TRAINING_TX:
        raise ProtocolError(
            f"Split {name!r} holds out some of its training transmitters, so that there must be {LEAST_TRAINING_TX} or "
            f"more, but there are {number}. Generate more."
        )
