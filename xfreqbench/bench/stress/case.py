"""A case of numerical stability: a named error with the limit it has to keep, and the verdict on it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial, wraps
from typing import Any, TypeVar

from xfreqbench.methods.splatting.composite_kernels import use_threads

ErrorFunction = TypeVar("ErrorFunction", bound=Callable[..., float])


class NothingToCompareError(Exception):
    """This machine lacks what a case compares."""


@dataclass(frozen=True)
class StressCase:
    """`run` returns the error of the code against an independent reference, in `unit`; it may be `limit` at most."""

    name: str
    area: str
    limit: float
    unit: str
    run: Callable[[], float]

    def judge(self) -> Verdict:
        """The verdict after one run.

        An exception or a warning during the run fails the case and does not stop the others.
        `NothingToCompareError` skips it.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                return Verdict(self, float(self.run()))
        except NothingToCompareError as reason:
            return Verdict(self, math.nan, str(reason), is_skipped=True)
        except Exception as error:
            return Verdict(self, math.nan, f"{type(error).__name__}: {error}")


@dataclass(frozen=True)
class Verdict:
    """The error of a case. It is nan where the run was skipped or raised; `fault` is then the exception's text."""

    case: StressCase
    error: float
    fault: str = ""
    is_skipped: bool = False

    @property
    def is_within(self) -> bool:
        """Whether the error keeps the limit; nan does not."""
        return self.error <= self.case.limit

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table: area, case, error, limit, unit, and `ok` or what failed."""
        word = "skipped:" if self.is_skipped else "FAILED"
        outcome = "ok" if self.is_within else " ".join(f"{word} {self.fault}".split())
        error, limit = f"{self.error:.1e}", f"{self.case.limit:.1e}"
        return self.case.area, self.case.name, error, limit, self.case.unit, outcome


@dataclass
class Area:
    """The cases of one subject, in the order in which their functions stand in the code."""

    name: str
    cases: list[StressCase] = field(default_factory=list)

    def case(self, name: str, *arguments: Any, limit: float, unit: str) -> Callable[[ErrorFunction], ErrorFunction]:
        """Decorator: the decorated function, called with `arguments`, returns the error of a case."""
        return self.each({name: arguments}, limit=limit, unit=unit)

    def each(
        self, arguments_by_name: Mapping[str, tuple[Any, ...]], *, limit: float, unit: str
    ) -> Callable[[ErrorFunction], ErrorFunction]:
        """Decorator: one case for each name, whose error is the decorated function of the arguments beside it."""

        def add(error_function: ErrorFunction) -> ErrorFunction:
            for name, arguments in arguments_by_name.items():
                run = partial(error_function, *arguments)
                self.cases.append(StressCase(name, self.name, limit, unit, run))
            return error_function

        return add


def needing_two_threads(error_function: Callable[[], float]) -> Callable[[], float]:
    """Decorator: raise `NothingToCompareError` where Numba has only one thread."""

    @wraps(error_function)
    def run_on_two() -> float:
        before = use_threads(2)
        if use_threads(before) < 2:
            raise NothingToCompareError("Numba has one thread here, nothing to compare it with")
        return error_function()

    return run_on_two
