"""A named check of numerical stability, and what became of it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass


class NothingToCompareError(Exception):
    """This machine lacks what a case compares."""


@dataclass(frozen=True)
class Case:
    """`run` returns how far the code is from a reference of its own; `limit` is how far it may be."""

    name: str
    area: str
    limit: float
    unit: str
    run: Callable[[], float]

    def judge(self) -> Verdict:
        """Run it; an exception or a warning is a fault, and no reason to stop. `NothingToCompareError` skips it."""
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
    """The error of a case; nan, with the exception's text as `fault`, where it raised one or was skipped."""

    case: Case
    error: float
    fault: str = ""
    is_skipped: bool = False

    @property
    def is_within(self) -> bool:
        """Whether the error keeps the limit; nan does not."""
        return self.error <= self.case.limit

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table: area, case, error, limit, unit, and ok or what failed."""
        word = "skipped:" if self.is_skipped else "FAILED"
        outcome = "ok" if self.is_within else " ".join(f"{word} {self.fault}".split())
        error, limit = f"{self.error:.1e}", f"{self.case.limit:.1e}"
        return self.case.area, self.case.name, error, limit, self.case.unit, outcome
