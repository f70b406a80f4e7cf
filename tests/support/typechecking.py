"""What jaxtyping checks under pytest: shapes and types of the first calls of every function in every test.

Checking all of them takes a quarter of the time of the tests, and most of that where one function is called a hundred
thousand times in the same way. Checking a hundred of each still takes a sixth of the time of most tests, and ten a
sixteenth more than three.
"""

from __future__ import annotations

import inspect
import os
from collections import Counter
from collections.abc import Callable
from functools import cache, partial, wraps
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

CHECKS_TYPES = bool(os.getenv("CHECK_TYPES"))  # a sixth of the time of the tests
NUM_CHECKED = 3  # calls of each function in each test
typechecker = beartype(conf=BeartypeConf(is_pep484_tower=True))  # an int is accepted as a float
calls: Counter[int] = Counter()  # in the test that runs, by the identity of a function's code
_check = jaxtyping.jaxtyped


def check_first_calls(named: Any = None, *, typechecker: Callable[..., Any]) -> Any:
    """As `jaxtyping.jaxtyped`, which the import hook puts before functions and classes, but for the number of calls."""
    if named is None:
        return partial(check_first_calls, typechecker=typechecker)
    if inspect.isfunction(named):
        if calls[id(named.__code__)] >= NUM_CHECKED:  # within another function, whose every call makes it anew
            return named
        make = cache(partial(_check, named, typechecker=typechecker))
        if "<locals>" in named.__qualname__:
            make()  # while the names around it are known
        return _at_first(make, named)
    init = named.__init__
    checked = _check(named, typechecker=typechecker)
    own = checked.__init__
    if own is not init:  # of a dataclass
        checked.__init__ = _at_first(lambda: own, init)
    return checked


def _at_first(checked: Callable[[], Callable[..., Any]], unchecked: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose checked twin is made when it is first called: many never are."""
    code = id(unchecked.__code__)

    @wraps(unchecked)
    def called(*args: Any, **kwargs: Any) -> Any:
        calls[code] += 1
        return (checked() if calls[code] <= NUM_CHECKED else unchecked)(*args, **kwargs)

    return called
