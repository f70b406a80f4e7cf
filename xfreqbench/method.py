"""What a method is, how it is found by name, and the one place where its training is timed."""

from __future__ import annotations

import hashlib
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, is_dataclass
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.config import override
from xfreqbench.dataset import PasDataset
from xfreqbench.errors import MethodError, UnknownNameError

ENTRY_POINT_GROUP = "xfreqbench.methods"
TRIVIAL = ("line-of-sight", "nearest", "mean-over-frequency", "log-frequency")
_CONTRACT = ("fit", "predict", "save", "load")
_RANGE_TOLERANCE = 1e-4  # float32 rounding of a map that was divided by its own maximum

Maps = NDArray[np.float32]


@dataclass(frozen=True)
class Budget:
    """When training ends at the latest; without either limit, when the method itself ends it."""

    max_steps: int | None = None
    max_seconds: float | None = None


def parse_budget(text: str | None) -> Budget:
    """Budget from `300s`, `5m`, `2h` or `2000steps`; unlimited where None. Raises `MethodError`."""
    if text is None:
        return Budget()
    matched = re.fullmatch(r"(\d+)\s*(steps)|(\d+(?:\.\d+)?)\s*([smh])", text.strip())
    number, unit = (group for group in matched.groups() if group) if matched else ("0", "")
    if float(number) == 0:
        raise MethodError(f"A budget is written as in 300s, 5m, 2h or 2000steps, but {text!r} was given.")
    if unit == "steps":
        return Budget(max_steps=int(number))
    return Budget(max_seconds=float(number) * {"s": 1, "m": 60, "h": 3600}[unit])


@dataclass(frozen=True)
class Progress:
    """What a method yields: steps done, and its loss (nan where it has none)."""

    step: int
    loss: float


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
        """Train, yielding often: at every yield `predict` is valid, and the generator may be closed.

        `train` holds the training rows alone, and the receiver's geometry is allowed knowledge. The
        harness owns the clock; `budget` is told so that schedules can be planned.
        """
        ...

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[Maps, "B E A"]:
        """Maps in [0, 1], peak 1, float32, on the grid of the training data."""
        ...

    def save(self, directory: Path) -> None:
        """Store everything that `predict` needs in an existing folder."""
        ...

    @classmethod
    def load(cls, directory: Path) -> Method:
        """The method as it was saved."""
        ...


@dataclass(frozen=True)
class Fit:
    """How training went: the last progress and the seconds that the method itself took."""

    step: int
    loss: float
    seconds: float


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
    except Exception as error:
        given = f"with {config[0]!r}" if config else "without arguments"
        raise MethodError(
            f"Method {name!r} cannot be constructed {given}: {type(error).__name__}: {error}. Its constructor "
            "takes one config, with a default."
        ) from error


def code_sha256(method: Method) -> str:
    """Hash of the files that define a method's class and its bases; a class typed into a shell has none."""
    modules = dict.fromkeys(base.__module__ for base in type(method).__mro__)
    paths = [getattr(sys.modules.get(module), "__file__", None) for module in modules]
    digest = hashlib.sha256()
    for path in paths:
        if path and Path(path).is_file():
            digest.update(hashlib.sha256(Path(path).read_bytes()).digest())
    return digest.hexdigest()


def fit_within(method: Method, train: PasDataset, budget: Budget, seed: int) -> Fit:
    """Train until the method ends or the budget is spent, the step that crosses it included.

    Only the method's own time counts. Its generator is closed in every case. Raises `MethodError` where
    it yields something else than `Progress`, or nothing.
    """
    last: Progress | None = None
    started_s = time.perf_counter()
    with closing(cast("Any", method.fit(train, budget, seed))) as progress_of:
        for progress in progress_of:
            last = _checked_progress(method, progress)
            if _is_spent(budget, last.step, time.perf_counter() - started_s):
                break
    if last is None:
        raise MethodError(f"{_name(method)}.fit yielded nothing; it must yield Progress at least once.")
    return Fit(last.step, last.loss, time.perf_counter() - started_s)


def _is_spent(budget: Budget, step: int, seconds: float) -> bool:
    out_of_steps = budget.max_steps is not None and step >= budget.max_steps
    out_of_time = budget.max_seconds is not None and seconds >= budget.max_seconds
    return out_of_steps or out_of_time


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
