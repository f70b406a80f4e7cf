"""What jaxtyping checks under pytest: shapes and types of the first calls of every function in every test.

Checking all of them takes a quarter of the time of the tests, and most of that where one function is called a hundred
thousand times in the same way. Checking a hundred of each still takes a sixth of the time of most tests, and ten a
sixteenth more than three.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

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
        return _at_first(_check(named, typechecker=typechecker), named)
    init = named.__init__
    checked = _check(named, typechecker=typechecker)
    if checked.__init__ is not init:  # of a dataclass
        checked.__init__ = _at_first(checked.__init__, init)
    return checked


def _at_first(checked: Callable[..., Any], unchecked: Callable[..., Any]) -> Callable[..., Any]:
    code = id(unchecked.__code__)

    @wraps(unchecked)
    def called(*args: Any, **kwargs: Any) -> Any:
        calls[code] += 1
        return (checked if calls[code] <= NUM_CHECKED else unchecked)(*args, **kwargs)

    return called
