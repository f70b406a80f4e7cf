"""All protocols by name: those of `splits`, and `held-out-block`, which holds out whole regions of the room.

    protocol         tested samples                                  seen in training
    held-out-block   a fifth of the transmitters at every carrier,   the same carriers, from the other transmitters
                     those of two of ten regions of the floor        that are half a metre or more away

`held-out-tx` draws the tested transmitters one by one. Each has trained neighbours on all sides, and a method that
copies the map of the nearest one does well. In `held-out-block` no trained transmitter is nearer than half a metre to a
tested one: those that are nearer are in neither part. So its scores say more on whether a method knows the room. It
leaks the carriers as `held-out-tx` does, and the room and the receiver are the same in training and in test.

Its validation holds out one of ten regions of the training transmitters, in the same way.

The learned methods draw their own validation rows by `splits`. What is added here changes neither them nor the hash of
their code.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from pydantic import InstanceOf
from scipy.spatial import KDTree

from xfreqbench.data import splits
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import (
    LEAST_TRAINING_TX,
    UNSEEN_SHARE,
    VALIDATION_SHARE,
    ScoredOn,
    Split,
    Targets,
    _split,
)
from xfreqbench.errors import ProtocolError, UnknownNameError
from xfreqbench.system.arguments import checked
from xfreqbench.types import FloatArray, IntArray

_BLOCK = "held-out-block"
PROTOCOLS = (*splits.PROTOCOLS, _BLOCK)
VALIDATIONS = {f"{protocol}-validation": protocol for protocol in PROTOCOLS}
NUM_BLOCKS = 10  # regions of the floor, each with as many transmitters
BLOCK_MARGIN_M = 0.5
_BLOCK_SEED = 0


def held_out_block(dataset: PasDataset) -> list[Split]:
    """Test the transmitters of two of ten regions at every carrier, train on those half a metre or more away.

    Returns one split. The floor is halved again and again across its longer side into ten regions of equally many
    transmitters, of which two are drawn at random, the same at every call. Of fewer than ten transmitters each is a
    region. It leaks carriers: every tested carrier is trained on, from other transmitters. Raises `ProtocolError`
    where no transmitter is left to train on.
    """
    return [_block_split(dataset, _BLOCK, np.ones(len(dataset), bool), UNSEEN_SHARE)]


@checked
def make_splits(
    dataset: InstanceOf[PasDataset], protocol: str, targets_hz: Targets = None, on: ScoredOn = "test"
) -> list[Split]:
    """The splits of a protocol, which is one of `PROTOCOLS`; raises `UnknownNameError` and `ProtocolError`.

    `targets_hz` are the tested carriers of `lofo` and `lofo-unseen-tx` in hertz: the paper's if None, and every
    carrier at which a path arrives if "all". The other protocols choose their own.

    With `on="validation"`, the rows that are tested are some of each split's training rows, and the others are trained
    on; see the top of `xfreqbench.data.splits`. `sparse` then has no split for two training carriers, as none is
    between them.
    """
    if protocol not in PROTOCOLS:
        raise UnknownNameError("protocol", protocol, PROTOCOLS)
    if protocol != _BLOCK:
        return splits.make_splits(dataset, protocol, targets_hz, on)
    if targets_hz is not None:
        raise ProtocolError(f"Protocol {protocol!r} chooses what it tests; leave the targets out.")
    tested = held_out_block(dataset)
    return tested if on == "test" else [_validation_split(dataset, *tested)]


def find_split(dataset: PasDataset, protocol: str, name: str) -> Split:
    """The split with that name of a protocol or of its validation; raises `UnknownNameError` and `ProtocolError`."""
    tested = VALIDATIONS.get(protocol, protocol)
    if tested not in PROTOCOLS:
        raise UnknownNameError("protocol", protocol, PROTOCOLS)
    if tested != _BLOCK:
        return splits.find_split(dataset, protocol, name)
    if name != protocol:
        raise UnknownNameError(f"split of {protocol!r}", name, [protocol])
    return make_splits(dataset, _BLOCK, on="test" if protocol == _BLOCK else "validation")[0]


def _validation_split(dataset: PasDataset, split: Split) -> Split:
    """The split that holds out a region of a split's training transmitters."""
    trained = np.unique(dataset.tx_index[split.train])
    name = f"{split.name}-validation"
    if len(trained) < LEAST_TRAINING_TX:
        raise ProtocolError(
            f"Split {name!r} holds out a tenth of the training transmitters, of which there must be "
            f"{LEAST_TRAINING_TX} or more, but there are {len(trained)}. Generate more."
        )
    return _block_split(dataset, name, np.isin(dataset.tx_index, trained), VALIDATION_SHARE)


def _block_split(
    dataset: PasDataset, name: str, is_offered: Bool[NDArray[np.bool_], "N"], share: float
) -> Split:
    """The split that tests a share of the offered transmitters, whole regions, and trains on the others afar."""
    tx_index, first = np.unique(dataset.tx_index[is_offered], return_index=True)
    position_m = dataset.tx_position_m[is_offered][first]
    num_blocks = min(NUM_BLOCKS, len(tx_index))
    num_tested = max(1, round(share * num_blocks))
    tested = np.random.default_rng(_BLOCK_SEED).permutation(num_blocks)[:num_tested]
    is_tested = np.isin(blocks(position_m[:, :2], num_blocks), tested)
    is_near = KDTree(position_m[is_tested]).query(position_m)[0] < BLOCK_MARGIN_M
    of_tested, of_trained = (
        np.isin(dataset.tx_index, tx_index[chosen]) for chosen in (is_tested, ~is_tested & ~is_near)
    )
    return _split(dataset, name, name, of_trained, of_tested)


def blocks(position_m: Float[FloatArray, "T 2"], number: int) -> Int[IntArray, "T"]:
    """For each position on the floor the number of its region, of `number` regions with equally many positions.

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
