"""A case of numerical stability: a named error with the limit it has to keep, and the verdict on it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar

Found = float | tuple[float, str]
ErrorFunction = TypeVar("ErrorFunction", bound=Callable[..., Found])


@dataclass(frozen=True)
class StressCase:
    """`run` returns the error of the code against an independent reference, in `unit`; it may be `limit` at most.

    It may return a remark too: where the error is largest.
    """

    name: str
    area: str
    limit: float
    unit: str
    run: Callable[[], Found]

    def judge(self) -> Verdict:
        """The verdict after one run; an exception or a warning fails the case and does not stop the others."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                found = self.run()
                error, remark = found if isinstance(found, tuple) else (found, "")
                return Verdict(self, float(error), remark=remark)
        except Exception as error:
            return Verdict(self, math.nan, f"{type(error).__name__}: {error}")


@dataclass(frozen=True)
class Verdict:
    """The error of a case. It is nan where the run raised; `fault` is then the exception's text."""

    case: StressCase
    error: float
    fault: str = ""
    remark: str = ""

    @property
    def is_within(self) -> bool:
        """Whether the error keeps the limit; nan does not."""
        return self.error <= self.case.limit

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table: area, case, error, limit, unit, and `ok` or what failed, with the remark."""
        outcome = " ".join(f"{'ok' if self.is_within else 'FAILED'} {self.fault} {self.remark}".split())
        error, limit = f"{self.error:.1e}", f"{self.case.limit:.1e}"
        return self.case.area, self.case.name, error, limit, self.case.unit, outcome


@dataclass
class Area:
    """The cases of one subject, in the order in which their functions stand in the code."""

    name: str
    cases: list[StressCase] = field(default_factory=list)

    def case(self, name: str, *arguments: Any, limit: float, unit: str) -> Callable[[ErrorFunction], ErrorFunction]:
        """Decorator: the decorated function, called with `arguments`, returns the error of a case."""
        return self.cases_of({name: arguments}, limit=limit, unit=unit)

    def cases_of(
        self, arguments_by_name: Mapping[str, tuple[Any, ...]], *, limit: float, unit: str
    ) -> Callable[[ErrorFunction], ErrorFunction]:
        """Decorator: one case for each name, whose error is the decorated function of the arguments beside it."""

        def add(error_function: ErrorFunction) -> ErrorFunction:
            for name, arguments in arguments_by_name.items():
                run = partial(error_function, *arguments)
                self.cases.append(StressCase(name, self.name, limit, unit, run))
            return error_function

        return add
