"""How a method of one room becomes one of those that are tried in many rooms: it is fitted anew in each."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from math import nan
from pathlib import Path

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget, Method, Progress, RoomMethod
from xfreqbench.methods.fitting import fit_within
from xfreqbench.methods.registry import build_method

_METHOD_FILE = "method.json"


class PerRoom:
    """A method of one room, `built`, as a room method: it learns nothing across rooms, and is fitted to what is heard.

    Where nothing is heard, there is nothing to fit, and it predicts as `line-of-sight` does.
    """

    num_parameters = 0
    _seed = 0

    def __init__(self, method: str, overrides: Sequence[str] = ()) -> None:
        """Takes the method's name, and texts `key=value` for its options; raises as `build_method` does."""
        self._name, self._overrides = method, tuple(overrides)
        self.built: Method = build_method(method, overrides)
        self.config = self.built.config

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Iterator[Progress]:
        """Nothing is learned, but with which seed it is fitted in each room; one step says so."""
        self._seed = seed
        yield Progress(step=1, loss=nan)

    def adapt(self, heard: PasDataset, budget: Budget) -> Method:
        """The method, fitted to what is heard within the budget."""
        method: Method = build_method(self._name, self._overrides) if len(heard) else build_method("line-of-sight")
        fit_within(method, heard, budget, self._seed)
        return method

    def save(self, directory: Path) -> None:
        """Store the name of the method, its options and the seed: nothing else is known."""
        content = [self._name, self._overrides, self._seed]
        (directory / _METHOD_FILE).write_text(json.dumps(content), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> PerRoom:
        """Inverse of `save`."""
        name, overrides, *seed = json.loads((directory / _METHOD_FILE).read_text(encoding="utf-8"))
        method = cls(name, overrides)
        method._seed = seed[0] if seed else 0  # stored before it was
        return method


def build_room_method(name: str, overrides: Sequence[str] = ()) -> RoomMethod:
    """An untrained room method by name: one that learns across rooms, or `PerRoom` of another; raises as PerRoom."""
    method = build_method(name, overrides)
    return method if isinstance(method, RoomMethod) else PerRoom(name, overrides)
