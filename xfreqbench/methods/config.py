"""Options of methods, given as text and read as the types of the fields of a frozen dataclass."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, NamedTuple, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic.errors import PydanticUserError

from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.methods.guard import plain_json, readable
from xfreqbench.units import parse_number

Config = TypeVar("Config")
_KINDS = {"integer": "whole number", "boolean": "true, false", "string": "text", "array": "list", "null": "nothing"}
AIDED = "aided"
# what helps maps and is in no paper, each off and on; the option `aided` sets those that a method has
AIDS: Mapping[str, tuple[Any, Any]] = {
    "direct_wave": (False, True),
    "tx_levels": (0, 4),
    "band": (False, True),
    "blend": ("none", "auto"),
}
_ENDS = {"exclusiveMinimum": "above", "minimum": "from", "exclusiveMaximum": "to below", "maximum": "to"}


def override(config: Config, assignments: Iterable[str]) -> Config:
    """A copy of a configuration, changed by assignments `key=value`; a later one replaces an earlier.

    A value is read as the type of its field: `true`, `128`, `1e-3`, a word, or JSON for a tuple. `aided=true` and
    `aided=false` set all `AIDS` that the configuration has. Raises `UnknownNameError` for a key that is not a field,
    and `MethodError` for a value of another type.
    """
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise MethodError(f"Option {assignment!r} has no value. Write key=value.")
        if key.strip() == AIDED and (aids := _aids_of(config)):
            if text.strip() not in ("true", "false"):
                raise MethodError(f"Option 'aided' takes true or false, but {text.strip()!r} was given.")
            config = replace(config, **{name: AIDS[name][text.strip() == "true"] for name in aids})  # type: ignore[type-var]
            continue
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


class OptionRow(NamedTuple):
    """One field of a configuration, in words: its name, its default, what it may be, and what it means."""

    name: str
    default: str
    allowed: str
    meaning: str


def option_rows(config: Any) -> list[OptionRow]:
    """Every field of a configuration. Its meaning is the `Doc` of its annotation, or that of the class it overrides.

    A description of a Pydantic `Field` does too; a field without either has an empty meaning. `aided` is last, where
    the configuration has aids.
    """
    kinds = _types(config)
    aids = _aids_of(config)
    are_on = {getattr(config, name) == AIDS[name][1] for name in aids}
    rows = [
        OptionRow(
            field.name,
            json.dumps(value) if isinstance(value := getattr(config, field.name), bool) else str(value),
            _allowed_values(config, kinds[field.name]),
            _meaning(config, field.name),
        )
        for field in fields(config)
    ]
    if aids:
        default = "in part" if len(are_on) > 1 else json.dumps(are_on.pop())
        rows.append(OptionRow(AIDED, default, "true, false", f"sets what is in no paper: {', '.join(aids)}"))
    return rows


def _aids_of(config: Any) -> list[str]:
    """The names of the aids that a configuration has, where it has several."""
    names = [field.name for field in fields(config) if field.name in AIDS]
    return names if len(names) > 1 else []


def _meaning(config: Any, name: str) -> str:
    for base in type(config).__mro__:
        hint = get_type_hints(base, include_extras=True).get(name)
        for said in getattr(hint, "__metadata__", ()):
            text = getattr(said, "documentation", None) or getattr(said, "description", None)
            if text:
                return str(text)
    return ""


def _allowed_values(config: Any, kind: Any) -> str:
    try:
        return _allowed(_adapter(config, kind).json_schema())
    except (MethodError, PydanticUserError):
        return "what no text can give"


def _allowed(schema: Mapping[str, Any]) -> str:
    """What a JSON schema lets a value be, in words: `whole number from 0 to 8`."""
    if "enum" in schema or "const" in schema:
        return ", ".join(map(str, schema.get("enum", [schema.get("const")])))
    if "anyOf" in schema:
        return " or ".join(map(_allowed, schema["anyOf"]))
    kind = str(schema.get("format", schema.get("type", "anything")))
    ends = [f"{word} {schema[key]:g}" for key, word in _ENDS.items() if key in schema]
    return " ".join([_KINDS.get(kind, kind), *ends])


def _typed(config: Any, key: str, text: str) -> Any:
    names = [field.name for field in fields(config)]
    if not names:
        raise MethodError(f"Option {key!r} is given, but this method has no options. Leave it out.")
    if key not in names:
        raise UnknownNameError(f"option of {type(config).__name__}", key, names)
    kind = _types(config)[key]
    adapter = _adapter(config, kind)
    try:
        value = adapter.validate_json(text) if text.startswith(("[", "{")) else adapter.validate_strings(text)
        if isinstance(value, int | float) and "_" in text:
            parse_number(text)  # which raises, while Pydantic takes 1_0 for 10
        return value
    except ValueError as error:
        fault = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        plain = getattr(kind, "__origin__", kind) if hasattr(kind, "__metadata__") else kind
        expected = getattr(plain, "__name__", str(plain))
        raise MethodError(
            f"Option {key!r} of {type(config).__name__} takes {expected}, but {text!r} was given: {fault}."
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
