"""What a method is, how it is found by name, and the one place where its training is timed."""

from __future__ import annotations

import hashlib
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, fields, is_dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points
from math import isfinite, isinf
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.config import override
from xfreqbench.dataset import PasDataset
from xfreqbench.errors import DivergenceError, MethodError, UnknownNameError, XFreqBenchError

ENTRY_POINT_GROUP = "xfreqbench.methods"
TRIVIAL = ("line-of-sight", "nearest", "mean-over-frequency", "log-frequency")
_CONTRACT = ("fit", "predict", "save", "load")
_SHARED_CODE = ("splatting", "virtual_source")  # packages that methods build on without inheriting from them
_MEASUREMENTS = (
    "benchmark",
    "savings",
    "stress",
    "stress_training",
    "training_step",
)  # no fit depends on them
_ENDED = object()
_RANGE_TOLERANCE = 1e-4  # float32 rounding of a map that was divided by its own maximum

Maps = NDArray[np.float32]


@dataclass(frozen=True)
class Budget:
    """When training ends at the latest; without either limit, when the method itself ends it."""

    max_steps: int | None = None
    max_seconds: float | None = None

    def share(self, step: int, seconds: float) -> float:
        """Spent part of the limit, of the one that is nearer where both are set; 0 without any."""
        limits = (step, self.max_steps), (seconds, self.max_seconds)
        return max((spent / limit for spent, limit in limits if limit is not None), default=0.0)


def parse_budget(text: str | None) -> Budget:
    """Budget from `300s`, `5m`, `2h` or `2000steps`; unlimited where None. Raises `MethodError`."""
    if text is None:
        return Budget()
    matched = re.fullmatch(r"(\d{1,15})\s*(steps)|(\d{1,15}(?:\.\d{1,15})?)\s*([smh])", text.strip())
    number, unit = (group for group in matched.groups() if group) if matched else ("0", "")
    if float(number) == 0:
        raise MethodError(f"A budget is written as in 300s, 5m, 2h or 2000steps, but {text!r} was given.")
    if unit == "steps":
        return Budget(max_steps=int(number))
    return Budget(max_seconds=float(number) * {"s": 1, "m": 60, "h": 3600}[unit])


@dataclass(frozen=True)
class Progress:
    """What a method yields: steps done, its loss (nan where it has none), and what it counts.

    `counts` are sizes that change while it trains, as in `{"gaussians": 1024}`.
    """

    step: int
    loss: float
    counts: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class Method(Protocol):
    """A predictor of maps. It is constructed as `Class(config)`; without a config it has its defaults.

    `config` is a frozen dataclass; `num_parameters` counts what training sets.
    """

    config: Any

    @property
    def num_parameters(self) -> int:
        """Numbers that training sets; 0 where nothing is learned."""
        ...

    def fit(self, train: PasDataset, budget: Budget, seed: int) -> Iterator[Progress]:
        """Train, yielding often: at every yield `predict` and `save` are valid, and the generator may be closed.

        `train` holds the training rows alone, and the receiver's geometry is allowed knowledge. The
        harness owns the clock. `budget` is told so that schedules can be planned, and every yield gives
        back the spent share of it, from 0 to below 1 (0 without a limit): `share = yield Progress(…)`,
        typed `Generator[Progress, float, None]`. A method that needs no share just yields.

        `fit` of a loaded method goes on where it was saved, with a higher step, or starts anew; which of
        them is seen from the first step that it yields. A yield's share comes after it was saved, so a fit
        that goes on begins with `max(saved share, budget.share(saved step, 0.0))`: exact for a budget of
        steps. Raise `DivergenceError` where something is no longer finite.
        """
        ...

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[Maps, "B E A"]:
        """Maps in [0, 1], peak 1, float32, on the grid of the training data."""
        ...

    def save(self, directory: Path) -> None:
        """Store in an existing folder everything that `predict` needs, and what `fit` needs to go on.

        Called between steps too: neither this nor `predict` may change how training goes on.
        """
        ...

    @classmethod
    def load(cls, directory: Path) -> Method:
        """The method as it was saved."""
        ...


@runtime_checkable
class ExplainedMethod(Protocol):
    """A method that can tell what it has learned, in the terms of physics."""

    def findings(self) -> Mapping[str, Any]:
        """What goes to the record beside the scores, as JSON; called once, after the fit."""
        ...


@dataclass(frozen=True)
class Fit:
    """How a fit stands at a yield, or stood at its end.

    `seconds` are those that the method itself took, `share` is the spent part of the budget.
    """

    step: int
    loss: float
    seconds: float
    share: float = 0.0
    counts: Mapping[str, float] = field(default_factory=dict)


Observer = Callable[[Fit | None, Fit], None]


class Stopwatch:
    """Seconds spent inside `with` blocks, and `seconds` before them."""

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        self._started_s = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._started_s


def method_names() -> list[str]:
    """Names of the installed methods."""
    return sorted(entry.name for entry in entry_points(group=ENTRY_POINT_GROUP))


def method_summaries() -> dict[str, str]:
    """First docstring line of every installed method by name, or why it cannot be used."""
    return {name: _summary_line(name) for name in method_names()}


def _summary_line(name: str) -> str:
    try:
        return (resolve_method(name).__doc__ or "").strip().partition("\n")[0]
    except MethodError as error:
        return f"cannot be imported: {error.__cause__}" if error.__cause__ else str(error)


def resolve_method(name: str) -> Callable[..., Method]:
    """Class of a method by its entry point's name or as `package.module:Class`.

    Raises `UnknownNameError` for a name that is not installed and `MethodError` for one that cannot be
    imported or lacks part of the contract.
    """
    module, colon, attribute = name.partition(":")
    if not colon:
        entries = {entry.name: entry.value for entry in entry_points(group=ENTRY_POINT_GROUP)}
        if name not in entries:
            raise UnknownNameError("method", name, [*entries, "package.module:Class"])
        module, _, attribute = entries[name].partition(":")
    elif str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # a module in the working folder is found, and shadows nothing
    try:
        method_class = getattr(import_module(module), attribute)
    except Exception as error:  # a module runs its own code while it is imported
        raise MethodError(
            f"Method {name!r} cannot be imported: {type(error).__name__}: {error}. Install it, or mend it or "
            "its name."
        ) from error
    _check_contract(name, method_class)
    return cast("Callable[..., Method]", method_class)


def _check_contract(name: str, method_class: Any) -> None:
    if not isinstance(method_class, type):
        raise MethodError(f"Method {name!r} is {method_class!r}; it must be a class.")
    declared = {
        key for base in method_class.__mro__ for key in (*vars(base), *vars(base).get("__annotations__", ()))
    }
    missing = [part for part in _CONTRACT if part not in declared]
    if missing:
        raise MethodError(
            f"Method {name!r} lacks {', '.join(missing)}. A method has {', '.join(_CONTRACT)}; "
            "baselines/README.md shows one."
        )


def build_method(name: str, overrides: Iterable[str] = ()) -> Method:
    """A method by name, its configuration overridden by `key=value` texts.

    Raises what `resolve_method` and `override` do, and `MethodError` where it cannot be constructed, keeps
    no `config` or does not count its parameters.
    """
    method_class = resolve_method(name)
    overrides = tuple(overrides)
    defaults = _constructed(name, method_class)
    for attribute in ("config", "num_parameters"):
        if not hasattr(defaults, attribute):
            raise MethodError(f"Method {name!r} has no {attribute}; baselines/README.md shows where it goes.")
    if isinstance(defaults.config, type) or not is_dataclass(defaults.config):
        raise MethodError(
            f"Method {name!r} has config {defaults.config!r}; it must be an instance of a frozen dataclass."
        )
    if not overrides:
        return defaults
    return _constructed(name, method_class, override(defaults.config, overrides))


def _constructed(name: str, method_class: Callable[..., Method], *config: Any) -> Any:
    try:
        return method_class(*config)
    except XFreqBenchError:
        raise
    except Exception as error:
        given = f"with {config[0]!r}" if config else "without arguments"
        raise MethodError(
            f"Method {name!r} cannot be constructed {given}: {type(error).__name__}: {error}. Its constructor "
            "takes one config, with a default."
        ) from error


def device_option(name: str, device: str) -> tuple[str, ...]:
    """The override that sends a method to a device: none for the processor, or where it has no such field."""
    if device == "cpu":
        return ()
    names = [each.name for each in fields(build_method(name).config)]
    return (f"device={device}",) if "device" in names else ()


def code_sha256(method: Method) -> str:
    """Hash of the files that define a method's class and its bases; a class typed into a shell has none.

    All of `xfreqbench.splatting` and `xfreqbench.virtual_source` that a fit depends on is hashed too, where
    one of those files names them.
    """
    modules = dict.fromkeys(base.__module__ for base in type(method).__mro__)
    paths = [Path(getattr(sys.modules.get(module), "__file__", None) or "") for module in modules]
    sources = [path.read_bytes() for path in paths if path.is_file()]
    for package in _SHARED_CODE:
        if any(f"xfreqbench.{package}".encode() in source for source in sources):
            sources += _shared_sources(package)
    return hashlib.sha256(b"".join(hashlib.sha256(source).digest() for source in sources)).hexdigest()


def _shared_sources(package: str) -> list[bytes]:
    folder = Path(__file__).with_name(package)
    paths = sorted(path for path in folder.rglob("*.py") if path.stem not in _MEASUREMENTS)
    return [path.read_bytes() for path in paths]


def fit_within(
    method: Method,
    train: PasDataset,
    budget: Budget,
    seed: int,
    *,
    spent: Fit | None = None,
    observe: Observer | None = None,
) -> Fit:
    """Train until the method ends or the budget is spent, the step that crosses it included.

    Only the method's own time counts. Its generator is sent the spent share of the budget, and is closed
    in every case. `observe(before, now)` is told how the fit stood before each yield and stands at it.

    `spent` is how the fit of a loaded method stood when it was saved: the budget counts on from there,
    and a spent one ends it at once. Where the first step is not beyond it the method has started anew;
    `spent` is then forgotten, and `before` is None as at every start.

    Raises `MethodError` where the method yields something else than `Progress`, or nothing, and
    `DivergenceError` for a loss that is infinite, or is nan and was finite before.
    """
    if spent and budget.share(spent.step, spent.seconds) >= 1:
        return spent
    running = _RunningFit(method, train, budget, seed, spent)
    with closing(running):
        for before, now in running.changes():
            if observe:
                observe(before, now)
    return running.end()


class _RunningFit:
    """A method's `fit` under a clock that runs only while the method itself does."""

    def __init__(
        self, method: Method, train: PasDataset, budget: Budget, seed: int, spent: Fit | None
    ) -> None:
        self._method, self._budget, self._spent = method, budget, spent
        self._last = spent
        self._clock = Stopwatch(spent.seconds if spent else 0.0)
        with self._clock:
            self._yields: Any = iter(method.fit(train, budget, seed))

    def changes(self) -> Iterator[tuple[Fit | None, Fit]]:
        """How the fit stood before and stands at each yield, until it ends or the budget is spent."""
        yielded = self._next(None)
        while yielded is not _ENDED:
            before, now = self._advance(_checked_progress(self._method, yielded))
            yield before, now
            yielded = self._next(now.share) if now.share < 1 else _ENDED

    def close(self) -> None:
        """Run the method's cleanup, on its own time."""
        with self._clock:
            getattr(self._yields, "close", lambda: None)()

    def end(self) -> Fit:
        """The fit after its cleanup."""
        if self._last is None:
            raise MethodError(
                f"{_name(self._method)}.fit yielded nothing; it must yield Progress at least once."
            )
        return replace(self._last, seconds=self._clock.seconds)

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
        before, self._last = self._last, self._stands(progress)
        _require_finite(before, self._last)
        return before, self._last

    def _stands(self, progress: Progress) -> Fit:
        seconds = self._clock.seconds
        counts = {name: float(count) for name, count in progress.counts.items()}
        share = self._budget.share(progress.step, seconds)
        return Fit(int(progress.step), float(progress.loss), seconds, share, counts)


def _takes_share(steps: Any) -> bool:
    """Whether a value can be sent; `yield from` a plain iterator, however deep, takes none."""
    while (inner := getattr(steps, "gi_yieldfrom", None)) is not None:
        steps = inner
    return hasattr(steps, "send")


def _require_finite(before: Fit | None, now: Fit) -> None:
    """Raise `DivergenceError`; a loss that was nan from the start is one that the method does not have."""
    was_finite = before is not None and isfinite(before.loss)
    if isinf(now.loss) or (was_finite and not isfinite(now.loss)):
        raise DivergenceError(now.step, "loss")


def _checked_progress(method: Method, progress: object) -> Progress:
    if not isinstance(progress, Progress):
        raise MethodError(f"{_name(method)}.fit yielded {progress!r}; it must yield Progress(step, loss).")
    return progress


def predict_checked(
    method: Method,
    tx_position_m: Float[FloatArray, "B 3"],
    carrier_hz: Float[FloatArray, "B"],
    grid_shape: tuple[int, int],
) -> Float[Maps, "B E A"]:
    """Predictions, once they keep the contract; raises `MethodError` in words where they do not."""
    return checked_maps(method, method.predict(tx_position_m, carrier_hz), (len(carrier_hz), *grid_shape))


def checked_maps(method: Method, maps: Any, shape: tuple[int, int, int]) -> Float[Maps, "B E A"]:
    """What `predict` returned, once it is known to be maps; raises `MethodError` in words where it is not."""
    fault = _fault_of(maps, shape)
    if fault:
        raise MethodError(f"{_name(method)}.predict returned {fault}.")
    return maps


def _fault_of(maps: Any, shape: tuple[int, ...]) -> str | None:
    if not isinstance(maps, np.ndarray):
        return f"{type(maps).__name__}; it must be a NumPy array"
    if maps.shape != shape:
        return f"shape {maps.shape}; for {shape[0]} transmitters it must be {shape}"
    if maps.dtype != np.float32:
        return f"dtype {maps.dtype}; it must be float32"
    if not np.isfinite(maps).all():
        return f"{int((~np.isfinite(maps)).sum())} values that are not finite; all must be"
    low, high = float(maps.min()), float(maps.max())
    if low < -_RANGE_TOLERANCE or high > 1 + _RANGE_TOLERANCE:
        return f"values from {low:g} to {high:g}; maps lie in [0, 1]"
    return None


def _name(method: Method) -> str:
    return type(method).__name__
