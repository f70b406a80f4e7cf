"""Fits methods within a budget, and checks their predictions. A method's training is timed nowhere else."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from math import isfinite, isinf
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.maps.bartlett import RANGE_TOLERANCE
from xfreqbench.methods.contract import Budget, ExplainedMethod, Method, Progress, RoomMethod
from xfreqbench.methods.guard import plain_json, readable
from xfreqbench.types import FloatArray, Maps

_ENDED = object()


@dataclass(frozen=True)
class Fit:
    """How a fit stands at a yield, or stood at its end.

    `seconds` is the time that the method itself took, `processor_seconds` that of all cores in it, and `share` the part
    of the budget that is spent.
    """

    step: int
    loss: float
    seconds: float
    share: float = 0.0
    counts: Mapping[str, float] = field(default_factory=dict)
    processor_seconds: float = 0.0

    @property
    def maps(self) -> float:
        """How many training maps the steps have shown; 0 where the method does not tell."""
        return self.counts.get("maps", 0.0)


Observer = Callable[[Fit | None, Fit], None]


class Stopwatch:
    """Adds up the time spent within its `with` blocks in `seconds`, and in `processor_seconds` that of this process.

    Both start from given numbers.
    """

    def __init__(self, seconds: float = 0.0, processor_seconds: float = 0.0) -> None:
        self.seconds, self.processor_seconds = seconds, processor_seconds

    def __enter__(self) -> None:
        self._started_s = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        wall_s, processor_s = self._started_s
        self.seconds += time.perf_counter() - wall_s
        self.processor_seconds += time.process_time() - processor_s


def fit_within(
    method: Method | RoomMethod,
    train: PasDataset | Collection,
    budget: Budget,
    seed: int,
    *,
    spent: Fit | None = None,
    observe: Observer | None = None,
) -> Fit:
    """Train a method until it ends or the budget is spent; returns how the fit stood at its end.

    A `RoomMethod` is trained on a collection, and any other on a data set.

    The step that exceeds the budget is the last. Only the method's own time counts. Its generator is sent the
    spent share of the budget, and is closed in every case. `observe(before, now)` is called at each yield with
    how the fit stood at the yield before, None at the first, and how it stands now.

    `spent` is how the fit of a loaded method stood when it was saved. The budget goes on from there, and if it is
    spent, the fit ends at once. If the first step that the method yields is not higher, the method has started
    again: `spent` then does not count, and `before` is None.

    Raises `MethodError` if the method yields nothing, something other than `Progress`, or a step that is not higher
    than the one before, and `DivergenceError` for a loss that is infinite, or nan after it was finite. A budget in maps
    needs a method that counts them.
    """
    if spent and budget.share(spent.step, spent.seconds, spent.maps) >= 1:
        return spent
    running = _RunningFit(method, train, budget, seed, spent)
    with closing(running):
        for before, now in running.changes():
            if observe:
                observe(before, now)
    return running.end()


class _RunningFit:
    """The `fit` of a method, and a clock that runs only while the method's own code runs."""

    def __init__(self, method: Method | RoomMethod, train: Any, budget: Budget, seed: int, spent: Fit | None) -> None:
        self._method, self._budget, self._spent = method, budget, spent
        self._last = spent
        self._clock = Stopwatch(*((spent.seconds, spent.processor_seconds) if spent else ()))
        with self._clock:
            self._yields: Any = iter(method.fit(train, budget, seed))

    def changes(self) -> Iterator[tuple[Fit | None, Fit]]:
        """Yield how the fit stood before and how it stands, at each step until it ends or the budget is spent."""
        yielded = self._next(None)
        while yielded is not _ENDED:
            before, now = self._advance(_checked_progress(self._method, yielded))
            yield before, now
            yielded = self._next(now.share) if now.share < 1 else _ENDED

    def close(self) -> None:
        """Close the method's generator; the time of its cleanup counts."""
        with self._clock:
            getattr(self._yields, "close", lambda: None)()

    def end(self) -> Fit:
        """How the fit stood at its end, with the time of the cleanup."""
        if self._last is None:
            raise MethodError(f"{_name(self._method)}.fit yielded nothing; it must yield Progress at least once.")
        clock = self._clock
        return replace(self._last, seconds=clock.seconds, processor_seconds=clock.processor_seconds)

    def _next(self, share: float | None) -> object:
        with self._clock:
            try:
                return self._yields.send(share) if _takes_share(self._yields) else next(self._yields)
            except StopIteration:
                return _ENDED

    def _advance(self, progress: Progress) -> tuple[Fit | None, Fit]:
        if self._spent and self._last is self._spent and progress.step <= self._spent.step:
            self._last = None  # it started anew
            self._clock.seconds -= self._spent.seconds
            self._clock.processor_seconds -= self._spent.processor_seconds
        before, self._last = self._last, self._stands(progress)
        if self._last.step <= (before.step if before else -1):
            raise MethodError(
                f"{_name(self._method)}.fit yielded step {self._last.step} after {before.step if before else 'none'}. "
                "Count every step once, from 0 up; a fit that stops early returns and yields no more."
            )
        _require_finite(before, self._last)
        self._require_maps(before, self._last)
        return before, self._last

    def _stands(self, progress: Progress) -> Fit:
        seconds = self._clock.seconds
        counts = {name: float(count) for name, count in progress.counts.items()}
        share = self._budget.share(progress.step, seconds, counts.get("maps", 0.0))
        return Fit(int(progress.step), float(progress.loss), seconds, share, counts, self._clock.processor_seconds)

    def _require_maps(self, before: Fit | None, now: Fit) -> None:
        """Raise `MethodError` where the budget is in maps, and a method that goes on does not count them."""
        if self._budget.max_maps is not None and before is not None and now.maps <= before.maps:
            raise MethodError(
                f"The budget is {self._budget.max_maps} maps, but {_name(self._method)}.fit does not tell how many "
                f"its steps have shown: {before.maps:g} after step {before.step} and {now.maps:g} after step "
                f'{now.step}. Yield Progress(step, loss, {{"maps": …}}), or give a budget in steps or seconds.'
            )


def _takes_share(steps: Any) -> bool:
    """Whether a value can be sent to a generator; not while it is in `yield from` of a plain iterator."""
    while (inner := getattr(steps, "gi_yieldfrom", None)) is not None:
        steps = inner
    return hasattr(steps, "send")


def _require_finite(before: Fit | None, now: Fit) -> None:
    """Raise `DivergenceError` for a loss that is not finite; one that was nan from the start means there is none."""
    was_finite = before is not None and isfinite(before.loss)
    if isinf(now.loss) or (was_finite and not isfinite(now.loss)):
        raise DivergenceError(now.step, "loss")


def _checked_progress(method: object, progress: object) -> Progress:
    if not isinstance(progress, Progress):
        raise MethodError(f"{_name(method)}.fit yielded {progress!r}; it must yield Progress(step, loss).")
    for name in progress.counts:
        if not isinstance(name, str) or readable(name) != name:
            raise MethodError(f"{_name(method)}.fit yielded the count {name!r}; its name must be Unicode text.")
    return progress


def checked_num_parameters(method: Method | RoomMethod) -> int:
    """How many numbers the training of a fitted method has set; raises `MethodError` for what is no such number."""
    count = method.num_parameters
    if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count < 2**63:
        raise MethodError(
            f"{_name(method)}.num_parameters is {count!r}, a {type(count).__name__}. Return the number of values that "
            "training sets, or 0; num_parameters is an attribute or a property."
        )
    return count


def checked_findings(method: Method | RoomMethod) -> dict[str, Any]:
    """What the method says it has learned, as JSON has it; empty for a method that does not say.

    Raises whatever `findings` raises, and `plain_json` for values that no record can hold.
    """
    return plain_json(dict(method.findings())) if isinstance(method, ExplainedMethod) else {}


def predict_checked(
    method: Method,
    tx_position_m: Float[FloatArray, "B 3"],
    carrier_hz: Float[FloatArray, "B"],
    grid_shape: tuple[int, int],
) -> Float[Maps, "B E A"]:
    """What the method predicts, after checking that it keeps the contract; raises `MethodError` if it does not."""
    return checked_maps(method, method.predict(tx_position_m, carrier_hz), (len(carrier_hz), *grid_shape))


def checked_maps(method: object, maps: Any, shape: tuple[int, int, int]) -> Float[Maps, "B E A"]:
    """What `predict` returned, after checking that it is maps; raises `MethodError` that says what it is if not."""
    fault = _fault_of(maps, shape)
    if fault:
        raise MethodError(f"{_name(method)}.predict returned {fault}.")
    return maps


def _fault_of(maps: Any, shape: tuple[int, ...]) -> str | None:
    if type(maps) is not np.ndarray:  # a masked array, among others, computes in its own way
        return f"{type(maps).__name__}; it must be a NumPy array and of no other class"
    if maps.shape != shape:
        return f"shape {maps.shape}; for {shape[0]} transmitters it must be {shape}"
    if maps.dtype != np.float32:
        return f"dtype {maps.dtype}; it must be float32"
    if not np.isfinite(maps).all():
        return f"{int((~np.isfinite(maps)).sum())} values that are not finite; all must be"
    low, high = float(maps.min()), float(maps.max())
    if low < -RANGE_TOLERANCE or high > 1 + RANGE_TOLERANCE:
        return f"values from {low:g} to {high:g}; maps lie in [0, 1]"
    return None


def _name(method: object) -> str:
    return type(method).__name__
