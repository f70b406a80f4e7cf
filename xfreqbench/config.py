"""Options given as text, typed from the fields of a method's frozen dataclass."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError

from xfreqbench.errors import MethodError, UnknownNameError

Config = TypeVar("Config")


def override(config: Config, assignments: Iterable[str]) -> Config:
    """Copy of a configuration with `key=value` assignments, the later ones winning.

    Values are read as the field's type: `true`, `128`, `1e-3`, a word, or JSON for a tuple. Raises
    `UnknownNameError` for a key that is no field and `MethodError` for a value that is not of its type.
    """
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise MethodError(f"Option {assignment!r} has no value. Write key=value.")
        config = replace(config, **{key.strip(): _typed(config, key.strip(), text.strip())})  # type: ignore[type-var]
    return config


def _typed(config: Any, key: str, text: str) -> Any:
    names = [field.name for field in fields(config)]
    if key not in names:
        raise UnknownNameError(f"option of {type(config).__name__}", key, names or ["(it has none)"])
    kind = get_type_hints(type(config))[key]
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    try:
        return adapter.validate_json(text) if text.startswith(("[", "{")) else adapter.validate_strings(text)
    except ValidationError as error:
        expected = getattr(kind, "__name__", str(kind))
        raise MethodError(
            f"Option {key!r} of {type(config).__name__} takes {expected}, but {text!r} was given: "
            f"{error.errors()[0]['msg']}."
        ) from error
