"""Arguments of public functions: what they cannot use is refused before any work, in words.

NumPy is not imported here: the command line names these types in its help.
"""

from __future__ import annotations

import inspect
import reprlib
from collections.abc import Callable, Collection, Sequence
from difflib import get_close_matches
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, Protocol, TypeVar, cast, get_type_hints, overload

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    model_serializer,
    validate_call,
)
from typing_extensions import Doc

from xfreqbench.errors import ArgumentError
from xfreqbench.units import ghz_to_hz

if TYPE_CHECKING:
    from jaxtyping import Float

    from xfreqbench.types import FloatArray

Taken = ParamSpec("Taken")
Returned = TypeVar("Returned")
Made = TypeVar("Made", covariant=True)


def checked(function: Callable[Taken, Returned]) -> Callable[Taken, Returned]:
    """The function, with arguments that are converted to the types of its parameters by Pydantic's rules.

    A text is taken for a number where it is one, a whole float for an integer, and so on. What cannot be converted
    is an `ArgumentError` that names the parameter, its type and what was given.
    """

    @wraps(function)
    def collected(*arguments: Any, **named: Any) -> Any:
        return arguments, named

    @cache  # at the first call, when every type is defined
    def converted() -> Callable[..., Any]:
        return validate_call(config=ConfigDict(arbitrary_types_allowed=True))(collected)

    @wraps(function)
    def call(*arguments: Taken.args, **named: Taken.kwargs) -> Returned:
        try:
            arguments, named = converted()(*arguments, **named)
        except ValidationError as error:
            raise ArgumentError(_words(function, error)) from None
        return function(*arguments, **named)

    return call


class _TakesOptions(Protocol[Taken, Made]):
    """`generate`, `generate_rooms` or `run`: a function of two arguments, and of options by their names."""

    @overload
    def __call__(self, traced: Any, /, output: FilePath, *options: Taken.args, **named: Taken.kwargs) -> Made: ...

    @overload
    def __call__(self, data: Any, /, methods: Any, *options: Taken.args, **named: Taken.kwargs) -> Made: ...


def taking(
    options: Callable[Taken, Any], needed: Collection[str] = (), without: Collection[str] = ()
) -> Callable[[Callable[[Any, Any, Any], Returned]], _TakesOptions[Taken, Returned]]:
    """A decorator: the function is called with the fields of its options in place of the object, as `checked` has it.

    The options, a dataclass whose fields have a `Doc`, are its last argument. Those of `needed` have no default, and
    those of `without` cannot be given.
    """

    def decorated(function: Any) -> Any:
        known = [each for each in inspect.signature(options).parameters.values() if each.name not in without]
        known = [each.replace(default=each.empty) if each.name in needed else each for each in known]
        # annotations are texts here; without their `Doc`s they are short enough for `help`
        texts = [each.annotation.removeprefix("Annotated[").partition(", Doc(")[0] for each in known]
        known = [each.replace(annotation=text) for each, text in zip(known, texts, strict=True)]
        *own, _ = inspect.signature(function).parameters.values()
        signature = inspect.signature(function).replace(parameters=[*own, *known])
        hints = get_type_hints(options, include_extras=True)

        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            given = signature.bind(*arguments, **named).arguments
            return function(*(given.pop(each.name) for each in own), cast("Any", options)(**given))

        told = [f"    {each.name}: {hints[each.name].__metadata__[-1].documentation}" for each in known]
        call.__doc__ = "\n".join([f"{function.__doc__}\n    Options, as the command says:\n", *told])
        call.__signature__ = signature  # type: ignore[attr-defined]
        call.__annotations__ = get_type_hints(function, include_extras=True) | hints
        return checked(call)

    return decorated


@model_serializer(mode="wrap")
def only_given(self: Any, serialize: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
    """Serializer of a Pydantic class, as one of its attributes: the JSON leaves out the fields that are None."""
    return {key: value for key, value in serialize(self).items() if value is not None}


def _words(function: Callable[..., Any], error: ValidationError) -> str:
    """What is wrong with the first argument that is, from one or more reasons: one for each type it might have had."""
    names = list(inspect.signature(function).parameters)
    faults = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] != "unexpected_keyword_argument")
    first, name = faults[0], faults[0]["loc"][0]
    name = names[name] if isinstance(name, int) and name < len(names) else name
    if first["type"] in ("missing_argument", "missing_keyword_only_argument"):
        return f"{function.__name__} needs {name}. It takes {', '.join(names)}."
    if name not in names:
        nearest = get_close_matches(str(name), names, n=1)
        hint = f" Did you mean {nearest[0]}?" if nearest else ""
        return f"{function.__name__} takes no {name!r}.{hint} It takes {', '.join(names)}."
    if first["type"] == "unexpected_positional_argument":
        return f"{function.__name__} takes {name} only by its name: write {name}={reprlib.repr(first['input'])}."
    reasons = dict.fromkeys(
        fault["msg"].removeprefix("Value error, ") for fault in faults if fault["loc"][0] == first["loc"][0]
    )
    given = reprlib.repr(first["input"]).replace("\n", " ")
    is_within = any(isinstance(part, int) for part in first["loc"][1:])
    what = f"{given} in {name}" if is_within else f"{name}={given}"
    return f"{function.__name__} cannot use {what}: {'; or: '.join([*reasons][:3])}."


def listed(given: Any) -> Any:
    """One number, text or class as a list of one, an array as a list, and any other value unchanged."""
    if hasattr(given, "tolist"):
        given = given.tolist()
    return [given] if isinstance(given, int | float | str | type) else given


def _carrier_ghz(carrier_ghz: float) -> float:
    ghz_to_hz(carrier_ghz)
    return carrier_ghz


def _array(given: Any, shape: str) -> Any:
    import numpy as np

    try:
        found = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim > 2 or found.shape[-1:] != (3,) or not np.isfinite(found).all():
        raise ValueError(f"positions are finite numbers in metres, of shape {shape}, as in [2.0, 1.0, 1.5]")
    return found


def _path(given: Any) -> str | Path:
    if isinstance(given, str | Path):
        return given
    raise ValueError("Input should be the path of a file or folder")


FilePath = Annotated[str | Path, PlainValidator(_path)]
CarriersGhz = Annotated[
    Sequence[Annotated[float, AfterValidator(_carrier_ghz)]], BeforeValidator(listed), Field(min_length=1)
]  # one carrier is a list of one
TargetsGhz = Literal["all"] | CarriersGhz | None
ScoredOn = Annotated[
    Literal["test", "validation"],
    Doc(
        "test: the protocol's test rows; validation: some of its training rows, to choose settings by. "
        "They stand on a board of their own."
    ),
]
WholeNumbers = Annotated[
    Sequence[Annotated[int, Field(ge=0, lt=2**63)]], BeforeValidator(listed), Field(min_length=1)
]  # seeds: one number is a list of one
Word = Annotated[str, Field(coerce_numbers_to_str=True)]  # or a number in place of its digits
Texts = Annotated[Sequence[str], BeforeValidator(listed)]  # one text is a list of one
if TYPE_CHECKING:
    Positions = Float[FloatArray, "T 3"]
    Position = Float[FloatArray, "3"]
else:  # one position is a list of one
    Positions = Annotated[Any, PlainValidator(lambda given: _array(given, "(T, 3)").reshape(-1, 3))]
    Position = Annotated[Any, PlainValidator(lambda given: _array(given, "(3,)").reshape(3))]
