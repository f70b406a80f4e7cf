"""Methods by name: found through entry points or as `package.module:Class`, and built with their options."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import is_dataclass
from importlib import import_module
from importlib.metadata import entry_points
from inspect import getdoc, getsource
from pathlib import Path
from typing import Any, cast

from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.methods.config import OptionRow, option_rows, override
from xfreqbench.methods.guard import method_code, readable
from xfreqbench.system.source import method_sha256

ENTRY_POINT_GROUP, ROOM_ENTRY_POINT_GROUP = "xfreqbench.methods", "xfreqbench.room_methods"
_CONTRACT = ("fit", "predict", "save", "load")


def method_names() -> list[str]:
    """Names of the installed methods that predict one room, in alphabetical order."""
    return sorted({entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)})


def room_method_names() -> list[str]:
    """Names of the installed methods that learn across rooms, in alphabetical order."""
    return sorted({entry.name for entry in entry_points(group=ROOM_ENTRY_POINT_GROUP)})


def _entries() -> list[Any]:
    """The entry points of all installed methods, by name."""
    every = (*entry_points(group=ENTRY_POINT_GROUP), *entry_points(group=ROOM_ENTRY_POINT_GROUP))
    return sorted(every, key=lambda entry: entry.name)


def method_summaries() -> dict[str, str]:
    """A line on each installed method by its name, without running a plug-in's code, in alphabetical order.

    It is the first line of a built-in method's docstring; of a plug-in, it says which distribution it is from.
    """
    return {entry.name: _summary(entry) for entry in _entries()}


def _summary(entry: Any) -> str:
    """A line on an entry point, of `importlib.metadata` or of the library that it came from, where that is loaded."""
    if entry.value.startswith("xfreqbench."):
        return _docstring(entry.load()).partition("\n")[0]
    return f"plug-in, from {entry.dist.name}" if entry.dist else "plug-in"


def method_description(name: str) -> tuple[str, list[OptionRow]]:
    """What the docstrings of one method and of its options say, and every option; imports no other method.

    Raises as `build_method` does.
    """
    config = build_method(name).config
    with method_code(f"Method {name!r} cannot be described:", "Fix its docstring or its config."):
        own, generated = _docstring(type(config)), f"{type(config).__name__}("  # as dataclasses write theirs
        texts = [_docstring(resolve_method(name)), "" if own.startswith(generated) else own]
        return "\n\n".join(filter(None, dict.fromkeys(texts))), option_rows(config)


def _docstring(named: Any) -> str:
    stripped = "PYTHONOPTIMIZE=2 (python -OO) leaves out what describes it." if sys.flags.optimize > 1 else ""
    return readable(getdoc(named) or stripped)


def name_of(method: str | type) -> str:
    """The name by which `resolve_method` finds a method: a class's entry point or `package.module:Class`; a text stays.

    Raises `MethodError` for a class that cannot be found by its name, such as one defined in a function.
    """
    if isinstance(method, str):
        return method
    name = f"{method.__module__}:{method.__qualname__}"
    if getattr(sys.modules.get(method.__module__), method.__qualname__, None) is not method:
        raise MethodError(f"Class {name!r} cannot be found by this name. Define it at the top level of a module.")
    return next((entry.name for entry in _entries() if entry.value == name), name)


def resolve_method(name: str) -> Callable[..., Any]:
    """The class of a method, by the name of its entry point or as `package.module:Class`.

    Raises `UnknownNameError` for a name that is not installed, and `MethodError` for a method that cannot be
    imported or lacks a part of the contract.
    """
    module, colon, attribute = name.partition(":")
    if not colon:
        module, _, attribute = _entry_value(name).partition(":")
    elif str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # last, so that a module of the working folder hides no other
    advice = "Install it, or correct its name or its code."
    with method_code(f"Method {name!r} cannot be imported:", advice, passed=()):
        method_class = getattr(import_module(module), attribute)
    _check_contract(name, method_class)
    return cast("Callable[..., Any]", method_class)


def require_installed(name: str) -> None:
    """Raise `UnknownNameError` for a name without a colon that no installed method has; no method is imported."""
    if ":" not in name:
        _entry_value(name)


def _entry_value(name: str) -> str:
    """The `package.module:Class` of an installed method; raises `MethodError` where two packages offer the name."""
    values = sorted({entry.value for entry in _entries() if entry.name == name})
    if not values:
        raise UnknownNameError("method", name, [*method_names(), *room_method_names(), "package.module:Class"])
    if len(values) > 1:
        raise MethodError(f"Several packages offer a method {name!r}. Uninstall one, or name {' or '.join(values)}.")
    return values[0]


def _check_contract(name: str, method_class: Any) -> None:
    if not isinstance(method_class, type):
        raise MethodError(f"Method {name!r} is {method_class!r}; it must be a class.")
    declared = {key for base in method_class.__mro__ for key in (*vars(base), *vars(base).get("__annotations__", ()))}
    missing = [part for part in _CONTRACT if part not in declared]
    if missing and (missing != ["predict"] or "adapt" not in declared):
        raise MethodError(
            f"Method {name!r} lacks {', '.join(missing)}. A method has {', '.join(_CONTRACT)}, or `adapt` in place of "
            "`predict` if it learns across rooms; baselines/README.md shows one."
        )


def build_method(name: str, overrides: Iterable[str] = ()) -> Any:
    """An untrained `Method` or `RoomMethod` by name, with its default configuration changed by texts `key=value`.

    Raises what `resolve_method` and `override` raise, and `MethodError` for a method that cannot be constructed, or
    has no `config` or no `num_parameters`.
    """
    method_class = resolve_method(name)
    overrides = tuple(overrides)
    defaults = _constructed(name, method_class)
    for attribute in ("config", "num_parameters"):
        with method_code(f"Method {name!r} failed in {attribute}:", "Fix it."):
            if not hasattr(defaults, attribute):
                raise MethodError(f"Method {name!r} has no {attribute}; baselines/README.md shows where it goes.")
    if isinstance(defaults.config, type) or not is_dataclass(defaults.config):
        raise MethodError(
            f"Method {name!r} has config {defaults.config!r}; it must be an instance of a frozen dataclass."
        )
    if not overrides:
        return defaults
    with method_code(f"Method {name!r} cannot be configured with {', '.join(overrides)}:", "Correct the values."):
        config = override(defaults.config, overrides)
    return _constructed(name, method_class, config)


def _constructed(name: str, method_class: Callable[..., Any], *config: Any) -> Any:
    given = f"with {config[0]!r}" if config else "without arguments"
    advice = "Its constructor takes one config, with a default."
    with method_code(f"Method {name!r} cannot be constructed {given}:", advice):
        return method_class(*config)


def device_option(name: str, device: str) -> tuple[str, ...]:
    """The `key=value` texts that make a method compute on a device.

    None for the device `cpu`, and for a method whose configuration has no field `device`, or one that is `cpu` alone.
    """
    if device == "cpu":
        return ()
    config, chosen = build_method(name).config, f"device={device}"
    try:
        override(config, [chosen])
    except (UnknownNameError, MethodError):
        return ()
    return (chosen,)


def code_sha256(method: object) -> str:
    """Hash of a method's own package and of those of this one that methods compute with; see `method_sha256`.

    Of a class in a notebook it is that of its own text. Libraries such as PyTorch, and packages from which no base
    class comes, are not part of it; the versions of the libraries are in every record.
    """
    found = method_sha256(base.__module__ for base in type(method).__mro__)
    if getattr(sys.modules.get(type(method).__module__), "__file__", None):
        return found
    with suppress(OSError, TypeError):  # a class typed into a plain shell has no text
        found = hashlib.sha256(f"{found}{getsource(type(method))}".encode()).hexdigest()
    return found
