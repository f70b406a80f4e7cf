"""Files of scenes and families in TOML: by the name of one that ships or by path, with every fault of form in words."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, cast, get_args, get_type_hints

from pydantic import ValidationError

from xfreqbench.errors import SceneError, UnknownNameError
from xfreqbench.system.files import read_text

Parsed = TypeVar("Parsed")


def shipped_scenes() -> dict[str, str]:
    """Names and descriptions of the scenes that ship with the toolkit."""
    return {name: content["description"] for name, content in _shipped().items() if "type" not in content}


def shipped_families() -> dict[str, str]:
    """Names and descriptions of the families of rooms that ship with the toolkit."""
    return {name: content["description"] for name, content in _shipped().items() if "type" in content}


@cache
def _shipped() -> dict[str, dict[str, Any]]:
    return {path.stem: tomllib.loads(read_text(path)) for path in sorted(shipped_folder().glob("*.toml"))}


def shipped_toml(name: str) -> str:
    """The TOML of a scene or family that ships, with whole paths to its meshes; raises `UnknownNameError`."""
    if name not in (names := _shipped()):
        raise UnknownNameError("scene", name, names)
    text = read_text(shipped_folder() / f"{name}.toml")
    return text.replace('\nscene = "', f'\nscene = "{shipped_folder()}/')


def shipped_folder() -> Path:
    """Where the scenes that ship with the toolkit are, with their meshes."""
    return Path(str(resources.files("xfreqbench.scenes")))


def load_toml(
    name_or_path: str | Path, kind: str, shipped: Iterable[str], parse: Callable[[str, Path], Parsed]
) -> Parsed:
    """What `parse` makes of a file's text and folder: the file at a path, or the one that ships by that name.

    Raises `UnknownNameError`, and `SceneError` that names the file.
    """
    given = str(name_or_path)
    path = Path(given) if given.endswith(".toml") else shipped_folder() / f"{given}.toml"
    if not given.endswith(".toml") and given not in (names := list(shipped)):
        raise UnknownNameError(kind, given, [*names, "PATH.toml"])
    try:
        return parse(read_text(path), path.parent)
    except OSError as error:
        raise SceneError(f"The scene file {path} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{path} is not text in UTF-8 ({error}). Save it in that encoding.") from error
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def toml_content(text: str) -> dict[str, Any]:
    """The content of TOML text; raises `SceneError`."""
    if any(part.count(".") > 10_000 for part in text.split("=")):  # which would take the parser minutes
        raise SceneError("a key or value has more than 10,000 points. Write shorter ones.")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise SceneError("this TOML cannot be read: it is nested too deeply") from error
    except ValueError as error:  # not TOML, or numbers of thousands of digits
        raise SceneError(f"this is not TOML: {error}") from error


@contextmanager
def form_errors(what: str, kind: type) -> Iterator[None]:
    """A block in which faults of form become a `SceneError` that lists them; `what` is to be a dataclass `kind`."""
    try:
        yield
    except ValidationError as error:
        faults = error.errors()
        words = [f"  {_place(*fault['loc']) or what}: {_fault_words(kind, fault)}" for fault in faults[:20]]
        words += [f"  and {len(faults) - len(words)} more"] * (len(faults) > len(words))
        raise SceneError("\n".join([f"the {what} has no valid form:", *words])) from error


def _place(*location: int | str) -> str:
    """Where in a file a fault is, as in `receiver.1.rows`: the other receivers of a scene are `[[receiver]]` there."""
    if location[:1] == ("other_receivers",) and len(location) > 1:
        location = ("receiver", int(location[1]) + 1, *location[2:])
    return ".".join(map(str, location))


def _fault_words(kind: type, fault: Any) -> str:
    """What Pydantic finds wrong, in words; for an unknown key the nearest one, and all keys that are possible there."""
    if fault["type"] not in ("unexpected_keyword_argument", "extra_forbidden"):
        return str(fault["msg"]).removeprefix("Value error, ")
    *tables, key = fault["loc"]
    for table in tables:
        hints: Any = get_type_hints(kind)
        kind = next(_dataclasses_in(hints[table])) if isinstance(table, str) else kind
    in_toml = {field.name for field in fields(kind)} - {"folder", "other_receivers"}
    return str(UnknownNameError("key", str(key), in_toml))


def _dataclasses_in(hint: Any) -> Iterator[type]:
    """The dataclasses that a type hint names."""
    if is_dataclass(hint):
        yield cast("type", hint)
    for part in get_args(hint):
        yield from _dataclasses_in(part)
