"""Options of methods, given as text and read as the types of the fields of a frozen dataclass."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic.errors import PydanticUserError

from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.methods.guard import plain_json, readable

Config = TypeVar("Config")


def override(config: Config, assignments: Iterable[str]) -> Config:
    """A copy of a configuration, changed by assignments `key=value`; a later one replaces an earlier.

    A value is read as the type of its field: `true`, `128`, `1e-3`, a word, or JSON for a tuple. Raises
    `UnknownNameError` for a key that is not a field, and `MethodError` for a value of another type.
    """
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise MethodError(f"Option {assignment!r} has no value. Write key=value.")
        config = replace(config, **{key.strip(): _typed(config, key.strip(), text.strip())})  # type: ignore[type-var]
    return config


def as_json(config: Any) -> dict[str, Any]:
    """A configuration as values of JSON, a `Path` as text and a tuple as a list; raises `MethodError`."""
    adapter = _adapter(config, type(config))
    try:
        return plain_json(adapter.dump_python(config, mode="json", warnings=False))
    except (ValueError, TypeError, RecursionError) as error:
        raise MethodError(
            f"{type(config).__name__} cannot be written as JSON: {readable(str(error))}. Give it fields that can."
        ) from error


def _typed(config: Any, key: str, text: str) -> Any:
    names = [field.name for field in fields(config)]
    if not names:
        raise MethodError(f"Option {key!r} is given, but the method has none ({type(config).__name__}).")
    if key not in names:
        raise UnknownNameError(f"option of {type(config).__name__}", key, names)
    kind = _types(config)[key]
    adapter = _adapter(config, kind)
    try:
        return adapter.validate_json(text) if text.startswith(("[", "{")) else adapter.validate_strings(text)
    except ValidationError as error:
        plain = getattr(kind, "__origin__", kind) if hasattr(kind, "__metadata__") else kind
        expected = getattr(plain, "__name__", str(plain))
        raise MethodError(
            f"Option {key!r} of {type(config).__name__} takes {expected}, but {text!r} was given: "
            f"{error.errors()[0]['msg']}."
        ) from error


def _types(config: Any) -> dict[str, Any]:
    try:
        return get_type_hints(type(config), include_extras=True)
    except NameError as error:
        raise MethodError(f"{type(config).__name__} has a field of an unknown type: {error}.") from error


def _adapter(config: Any, kind: Any) -> Any:
    try:
        return TypeAdapter(kind)
    except (PydanticUserError, NameError) as error:
        raise MethodError(
            f"{type(config).__name__} has a field that no text can give: {str(error).splitlines()[0]} "
            "Use numbers, words, paths, or tuples of them."
        ) from error
