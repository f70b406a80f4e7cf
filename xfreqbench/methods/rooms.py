"""What a method that learns across rooms has to offer, and how a method of one room becomes one of them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from math import nan
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget, Method, Progress
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.registry import ROOM_CONTRACT, build_method, resolve_method
from xfreqbench.types import FloatArray, Maps

_METHOD_FILE = "method.json"
_SEED = 0


class RoomPredictor(Protocol):
    """Predicts maps of one room; a fitted `Method` is one."""

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[Maps, "B E A"]:
        """Maps (B, E, A), as `Method.predict` gives them."""
        ...


@runtime_checkable
class RoomMethod(Protocol):
    """A method that learns from many rooms, and then predicts maps of a room of which it has heard little or nothing.

    It is constructed as a `Method` is, and its `config` and `num_parameters` are the same.
    """

    config: Any

    @property
    def num_parameters(self) -> int:
        """How many numbers training across rooms sets; 0 if nothing is learned there."""
        ...

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Iterator[Progress]:
        """Learn from rooms, of which all samples are given; the rules are those of `Method.fit`.

        At every yield, `adapt` and `save` may be called and the generator be closed.
        """
        ...

    def adapt(self, heard: PasDataset, budget: Budget) -> RoomPredictor:
        """What predicts the maps of a new room, of which `heard` has the samples that are told.

        They may be none: then `heard` has the array alone, as its header and its grid. Where the plan is told,
        `heard.scene` is the room, its materials replaced; else it raises `DataError`. `budget` limits the fit of a
        method that trains in each room. Adapting to one room changes nothing for the next.
        """
        ...

    def save(self, directory: Path) -> None:
        """Store in an existing folder all that `adapt` needs, and what `fit` needs to go on."""
        ...

    @classmethod
    def load(cls, directory: Path) -> RoomMethod:
        """The method as `save` stored it in that folder."""
        ...


class PerRoom:
    """A method of one room, `built`, as a room method: it learns nothing across rooms, and is fitted to what is heard.

    Where nothing is heard, there is nothing to fit, and it predicts as `line-of-sight` does.
    """

    num_parameters = 0

    def __init__(self, method: str, overrides: Sequence[str] = ()) -> None:
        """Takes the method's name, and texts `key=value` for its options; raises as `build_method` does."""
        self._name, self._overrides = method, tuple(overrides)
        self.built = build_method(method, overrides)
        self.config = self.built.config

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Iterator[Progress]:
        """Nothing is learned; one step says so."""
        yield Progress(step=1, loss=nan)

    def adapt(self, heard: PasDataset, budget: Budget) -> Method:
        """The method, fitted to what is heard within the budget."""
        method = build_method(self._name, self._overrides) if len(heard) else build_method("line-of-sight")
        fit_within(method, heard, budget, _SEED)
        return method

    def save(self, directory: Path) -> None:
        """Store the name of the method and its options: nothing else is known."""
        (directory / _METHOD_FILE).write_text(json.dumps([self._name, self._overrides]), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> PerRoom:
        """Inverse of `save`."""
        return cls(*json.loads((directory / _METHOD_FILE).read_text(encoding="utf-8")))


def build_room_method(name: str, overrides: Sequence[str] = ()) -> RoomMethod:
    """An untrained room method by name: one that learns across rooms, or `PerRoom` of another; raises as PerRoom."""
    learns_across = all(hasattr(resolve_method(name), part) for part in ROOM_CONTRACT)
    return build_method(name, overrides) if learns_across else PerRoom(name, overrides)  # type: ignore[return-value]
