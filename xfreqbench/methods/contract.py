"""What a method has to offer: the `Method` protocol, with the budget that it is given and the progress it yields."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

from jaxtyping import Float
from pydantic import Field

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import ArgumentError, MethodError, did_you_mean
from xfreqbench.types import FloatArray, Maps


@dataclass(frozen=True)
class Budget:
    """The limits of training in steps, in seconds, or in maps; without one, the method decides when training ends.

    A map counts each time a step shows it: a step on 128 of them spends 128.
    """

    max_steps: Annotated[int, Field(gt=0, lt=2**63)] | None = None
    max_seconds: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    max_maps: Annotated[int, Field(gt=0, lt=2**63)] | None = None

    def __post_init__(self) -> None:
        """Raises `ArgumentError` for a limit that is no number above 0."""
        for name, limit in vars(self).items():
            if limit is not None and not (isinstance(limit, int | float) and 0 < limit < inf):
                raise ArgumentError(
                    f"A budget's {name} is a number above 0 or None, but got {limit!r}. `xfreqbench.run` takes texts "
                    "such as '5m' in place of a budget."
                )

    def share(self, step: int, seconds: float, maps: float = 0.0) -> float:
        """The part of the limit that is spent, 1 at its end; of two limits the one that is nearer, 0 without any."""
        limits = (step, self.max_steps), (seconds, self.max_seconds), (maps, self.max_maps)
        return max((spent / limit for spent, limit in limits if limit is not None), default=0.0)

    def timer(self, share: float) -> Callable[[], bool]:
        """A function that tells whether a share of the limit in seconds has passed since now; never without a limit.

        It is for work that a method does between two yields, such as a search before the first step.
        """
        if self.max_seconds is None:
            return lambda: False
        end_s = time.perf_counter() + share * self.max_seconds
        return lambda: time.perf_counter() >= end_s


BUDGETS = {  # budgets with names: a benchmark ranks fits of one of them
    "quick": Budget(max_maps=64_000),
    "minutes": Budget(max_seconds=300.0),
    "converged": Budget(max_maps=200_000),  # the paper's number of iterations, of one map each
}


def parse_budget(given: str | Budget | None) -> Budget:
    """The budget that a text such as `300s`, `5m`, `2h`, `2000steps` or `64000maps` stands for; unlimited for None.

    It may be the name of one of the `BUDGETS`, or a budget. Raises `MethodError` for anything else.
    """
    if given is None or isinstance(given, Budget):
        return given or Budget()
    text = str(given).strip()
    if text in BUDGETS:
        return BUDGETS[text]
    matched = re.fullmatch(r"(\d{1,15})\s*(steps|maps)|(\d{1,15}(?:\.\d{1,15})?)\s*([smh])", text)
    number, unit = (group for group in matched.groups() if group) if matched else ("0", "")
    if float(number) == 0:
        raise MethodError(
            f"A budget is written as in 300s, 5m, 2h, 2000steps or 64000maps, or is one of {', '.join(BUDGETS)}, but "
            f"{given!r} was given.{did_you_mean(text, BUDGETS)}"
        )
    if unit in ("steps", "maps"):
        return Budget(**{f"max_{unit}": int(number)})
    return Budget(max_seconds=float(number) * {"s": 1, "m": 60, "h": 3600}[unit])


@dataclass(frozen=True)
class Progress:
    """What a method yields while it trains: the steps done, its loss (nan if it has none), and `counts`.

    `counts` are sizes that change during training, as in `{"gaussians": 1024}`. Of these, `maps` is the number of
    training maps that all steps so far have shown; a budget in maps needs it.
    """

    step: int
    loss: float
    counts: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class Method(Protocol):
    """A predictor of maps, constructed as `Class(config)`, or as `Class()` with the defaults of its configuration.

    `config` is a frozen dataclass. If it has a field `device`, its default is "cpu", and `run --device cuda` sets it to
    "cuda"; a method without that field computes where it likes. A method may also have `findings`, see
    `ExplainedMethod`.
    """

    config: Any

    @property
    def num_parameters(self) -> int:
        """How many numbers training sets; 0 if nothing is learned."""
        ...

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Train, and yield often: at every yield, `predict` and `save` may be called and the generator be closed.

        The caller ends the fit by closing the generator at a yield, and then predicts. What follows that yield never
        runs, but for a `finally`, which may not yield. So at every yield `predict` uses what shall be scored: a method
        that stops early, and keeps its best weights, restores them before it yields. Then it returns, for every yield
        has a higher step than the one before.

        `train` holds the training rows only; the geometry of the receiver in it may be used. The caller measures
        the time and ends the fit. `budget` is given so that a method can plan schedules, and each yield returns
        how much of it is spent, from 0 to below 1 (0 without a limit): `share = yield Progress(…)`, typed
        `Generator[Progress, float, None]`. A method that does not need the share just yields.

        For a method that was loaded, `fit` goes on from where it was saved, with a higher step, or starts again;
        the first step that it yields shows which. The share of a yield arrives after the method was saved, so a
        fit that goes on begins with `max(saved share, budget.share(saved step, 0.0, saved maps))`, which is
        exact for a budget of steps or maps. Raise `DivergenceError` if something is no longer finite.

        Before the clock of a fit starts, a run lets another instance make one step on a few rows of `train`, so that
        compilation is charged to no method.
        """
        ...

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[Maps, "B E A"]:
        """Maps (B, E, A), float32 in [0, 1] with peak 1, on the grid of the training data.

        `tx_position_m` is (B, 3), `carrier_hz` is (B,): one map for each pair.
        """
        ...

    def save(self, directory: Path) -> None:
        """Store in an existing folder all that `predict` needs, and what `fit` needs to go on.

        It is also called between steps. Neither `save` nor `predict` may change how training goes on.
        """
        ...

    @classmethod
    def load(cls, directory: Path) -> Method:
        """The method as `save` stored it in that folder."""
        ...


@runtime_checkable
class ReceiverMethod(Protocol):
    """A method that can predict maps of a receiver that it has heard nothing of: it sets `takes_other_receivers`.

    In protocol `held-out-receiver`, `fit` is given a `train` without samples, whose header and grid are those of the
    receiver that is asked for; `train.other_receivers` holds the training rows of the others, one data set each.
    """

    takes_other_receivers: bool


@runtime_checkable
class ExplainedMethod(Protocol):
    """A `Method` that can also say what it has learned, in terms of physics; `run` stores it in the record."""

    def findings(self) -> Mapping[str, Any]:
        """What the method has learned, as values that JSON can hold; called once after the fit, for the record."""
        ...


@runtime_checkable
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
