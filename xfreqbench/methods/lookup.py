"""What predictors that learn nothing are built from: they look up training samples by transmitter and carrier."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field, TypeAdapter, ValidationError

from xfreqbench.data.dataset import PasDataset, reopen
from xfreqbench.errors import DataError
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.system.files import read_bytes
from xfreqbench.types import FloatArray, IntArray, NDArray

SAME_TRANSMITTER_M = 1e-6
_MOST_MAPS = 512  # in memory at once: 66 MB
_CONFIG_FILE, _ROWS_FILE = "config.json", "training_rows.json"
_Rows = list[Annotated[int, Field(ge=0, lt=2**63)]]
_STORED_ROWS: TypeAdapter[Any] = TypeAdapter(tuple[str, str, _Rows] | tuple[str, str, _Rows, str])
WeightedRows = tuple[Int[IntArray, "n"], Float[FloatArray, "n"]]


class TrainingTransmitters:
    """The distinct transmitters of a training set, and the row of each at each carrier.

    `asked` is the data set whose receiver is asked for. Where nothing was heard at that receiver, the training set is
    that of the nearest other one, whose maps are turned into the frame of the one that is asked for.
    """

    def __init__(self, train: PasDataset, asked: PasDataset | None = None) -> None:
        from scipy.spatial import KDTree

        self.train, self.asked = train, train if asked is None else asked  # which has no samples, and so is false
        tx_index, first, column = np.unique(train.tx_index, return_index=True, return_inverse=True)
        self.carrier_hz, carrier = np.unique(train.carrier_hz, return_inverse=True)
        self._position_m = train.tx_position_m[first]
        self._tree = KDTree(self._position_m)
        self._row = np.full((len(tx_index), len(self.carrier_hz)), -1, dtype=np.int64)
        self._row[column, carrier] = np.arange(len(train))
        self._maps: dict[int, Float[NDArray[np.float32], "E A"]] = {}  # by row, those that were read last

    @classmethod
    def of(cls, train: PasDataset) -> TrainingTransmitters:
        """What a method is given to train on, or of its `other_receivers` those of the nearest one."""
        at_m = np.asarray(train.header.receiver.position_m)

        def away_m(other: PasDataset) -> float:
            return float(np.linalg.norm(at_m - other.header.receiver.position_m))

        return cls(min(train.other_receivers, key=away_m, default=train), train)

    @cached_property
    def _turn(self) -> tuple[Int[IntArray, "EA"], Bool[NDArray[np.bool_], "EA"]] | None:
        """Of each direction asked for, the nearest one of the training maps and whether it is in front of their array.

        None where both receivers face the same way.
        """
        from scipy.spatial import KDTree

        asked, trained = (data.header.receiver.rotation for data in (self.asked, self.train))
        if np.allclose(asked, trained):
            return None
        direction = self.asked.grid.directions.reshape(-1, 3) @ asked.T @ trained
        return KDTree(self.train.grid.directions.reshape(-1, 3)).query(direction)[1], direction[:, 2] >= 0

    def turned(self, map_: Float[NDArray[np.floating], "E A"]) -> Float[NDArray[np.float32], "E A"]:
        """A training map in the frame of the receiver that is asked for, scaled to peak 1; 1 where all is behind it."""
        if self._turn is not None:
            nearest, is_heard = self._turn
            map_ = np.where(is_heard, map_.ravel()[nearest], 0).reshape(self.asked.grid.shape)
        return (map_ / map_.max() if map_.any() else np.ones_like(map_)).astype(np.float32)

    def neighbours(
        self, tx_position_m: Float[FloatArray, "3"], count: int
    ) -> tuple[Float[FloatArray, "k"], Int[IntArray, "k"]]:
        """Distances in metres and indices (k,) of the `count` nearest training transmitters, or of all if fewer."""
        distance_m, index = self._tree.query(tx_position_m, k=np.arange(1, min(count, len(self._row)) + 1))
        return distance_m, index

    def nearest(self, tx_position_m: Float[FloatArray, "3"], count: int = 1) -> Int[IntArray, "k"]:
        """Indices (k,) of the `count` nearest training transmitters; a single one if it stands at this position."""
        distance_m, index = self.neighbours(tx_position_m, count)
        return index[:1] if distance_m[0] <= SAME_TRANSMITTER_M else index

    @cached_property
    def spacing_m(self) -> float:
        """The median distance between a transmitter and the nearest other one; 0 where there is no other."""
        return float(np.median(self._tree.query(self._position_m, k=[min(2, len(self._row))])[0]))

    def away_m(self, tx_position_m: Float[FloatArray, "B 3"]) -> Float[FloatArray, "B"]:
        """The distance of each position from the nearest training transmitter."""
        return np.asarray(self._tree.query(tx_position_m)[0])

    def turned_deg(self, tx_position_m: Float[FloatArray, "B 3"]) -> Float[FloatArray, "B"]:
        """The angle at the receiver between each position and the nearest training transmitter."""
        at_m = np.asarray(self.asked.header.receiver.position_m)
        asked, known = tx_position_m - at_m, self._position_m[self._tree.query(tx_position_m)[1]] - at_m
        across = np.linalg.norm(np.cross(asked, known), axis=1)
        return np.degrees(np.arctan2(across, (asked * known).sum(1)))

    def knows(self, tx_position_m: Float[FloatArray, "B 3"]) -> Bool[NDArray[np.bool_], "B"]:
        """Whether a training transmitter stands at each position."""
        return self.away_m(tx_position_m) <= SAME_TRANSMITTER_M

    def rows(self, transmitters: Int[IntArray, "k"]) -> Int[IntArray, "n"]:
        """The rows (n,) of some transmitters (k,), at all of their carriers."""
        rows = self._row[transmitters]
        return rows[rows >= 0]

    def sums(self, asked: Iterable[WeightedRows]) -> Float[NDArray[np.float32], "B E A"]:
        """Weighted sums of training maps, each scaled to peak 1, for the rows and weights of B queries.

        What queries share is read once, and what neighbouring ones share is summed once.
        """
        asked = list(asked)
        summed = np.empty((len(asked), *self.asked.grid.shape), np.float32)
        total = np.empty(self.train.grid.shape, np.float32)
        part = np.empty_like(total)
        for nth, (rows, weights) in enumerate(asked):
            if nth and all(map(np.array_equal, asked[nth - 1], (rows, weights))):
                summed[nth] = summed[nth - 1]
                continue
            if not self._maps.keys() >= {*rows.tolist()}:
                self._read([rows for rows, _ in asked[nth:]])
            total[:] = 0
            for row, weight in zip(rows.tolist(), weights.astype(np.float32), strict=True):
                total += np.multiply(weight, self._maps[row], out=part)
            summed[nth] = self.turned(total)
        return summed

    def _read(self, asked: Sequence[IntArray]) -> None:
        """Read the maps of a query's rows, and of those of the next queries for which there is room."""
        needed: set[int] = set()
        for rows in asked:
            more = needed | {*rows.tolist()}
            if needed and len(more) > _MOST_MAPS:
                break
            needed = more
        self._maps = {}  # before others are read, which need its room
        self._maps = dict(zip(sorted(needed), self.train.pas(sorted(needed)), strict=True))

    def save(self, directory: Path) -> None:
        """Store which rows of which data set these are, without the maps."""
        reference = [str(self.train.path), self.train.sha256, self.train.rows.tolist()]
        if self.asked is not self.train:
            reference.append(self.asked.sha256)
        (directory / _ROWS_FILE).write_text(json.dumps(reference), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> TrainingTransmitters:
        """Inverse of `save`; raises `DataError` if the rows are not stored, or the data set has gone or is another."""
        try:
            path, sha256, rows, *asked = _STORED_ROWS.validate_json(read_bytes(directory / _ROWS_FILE))
        except (OSError, ValidationError) as error:
            fault = error.strerror if isinstance(error, OSError) else error.errors()[0]["msg"]
            raise DataError(f"{directory / _ROWS_FILE} names no data set and rows to look up: {fault}.") from error
        train = reopen(path, sha256, np.array(rows, dtype=np.int64))
        return cls(train, reopen(path, asked[0], []) if asked else None)


@dataclass(frozen=True)
class NoOptions:
    """The configuration of a method that has nothing to set."""


class TransmitterLookup:
    """A predictor that learns nothing: subclasses say which training samples a query's map is the sum of.

    They look them up in `transmitters`. One whose maps are no such sums has a `predict` of its own.
    """

    Config: ClassVar[type] = NoOptions
    num_parameters = 0
    takes_other_receivers = True

    def __init__(self, config: Any = None) -> None:
        self.config = self.Config() if config is None else config

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Remember which rows were trained on."""
        self.transmitters = TrainingTransmitters.of(train)
        yield Progress(step=1, loss=math.nan)

    def weighted(self, tx_position_m: Float[FloatArray, "3"], carrier_hz: float) -> WeightedRows:
        """The training rows whose maps are summed for a query, and the weight of each."""
        raise NotImplementedError

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """For each query, the weighted sum of training maps, scaled to peak 1."""
        return self.transmitters.sums(map(self.weighted, tx_position_m, carrier_hz))

    def save(self, directory: Path) -> None:
        """Store the configuration and which rows were trained on."""
        (directory / _CONFIG_FILE).write_text(json.dumps(as_json(self.config)), encoding="utf-8")
        self.transmitters.save(directory)

    @classmethod
    def load(cls, directory: Path) -> TransmitterLookup:
        """Inverse of `save`; raises `DataError` if the data set has gone or is another."""
        method = cls(cls.Config(**json.loads((directory / _CONFIG_FILE).read_text(encoding="utf-8"))))
        method.transmitters = TrainingTransmitters.load(directory)
        return method
