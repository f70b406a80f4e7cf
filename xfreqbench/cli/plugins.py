"""Commands of plug-ins: each entry point of the group `xfreqbench.commands` is a function, or an `App` of cyclopts.

A plug-in is imported only when its command runs, or when the help of `xfreqbench` lists it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.metadata import entry_points
from inspect import getdoc, isfunction
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from xfreqbench.cli.options import GROUPS, PLUGINS, Quiet
from xfreqbench.errors import MethodError, XFreqBenchError
from xfreqbench.methods.guard import method_code

COMMAND_GROUP = "xfreqbench.commands"
_NAME = re.compile("[a-z][a-z0-9-]*")


def add_plugin_commands(app: App) -> list[str]:
    """Add a command for each installed entry point, by its name.

    Returns a sentence for each one that is ignored, because its name is taken or is not a valid name of a command.
    """
    names = sorted({entry.name for entry in entry_points(group=COMMAND_GROUP)})
    ignored = [name for name in names if name in app or not _NAME.fullmatch(name)]
    for name in names:
        if name not in ignored:
            app.command(f"{__name__}:{name}", name=name)  # cyclopts gets it by __getattr__, below, when it is used
    return [
        f"The command {name!r} of {_packages(name)} is ignored: xfreqbench has one of that name, or it is not valid."
        for name in ignored
    ]


def __getattr__(name: str) -> App:
    """The command of an entry point, in a group of ours or in `PLUGINS`; if it cannot be loaded, one that says why.

    Raises `AttributeError` if there is no such entry point.
    """
    found = {entry.value: entry for entry in entry_points(group=COMMAND_GROUP, name=name)}
    if not found:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        if len(found) > 1:
            raise MethodError(f"Several packages offer a command {name!r}: {_packages(name)}. Uninstall all but one.")
        (entry,) = found.values()
        with method_code(f"Command {name!r} cannot be loaded:", "Fix its package, or uninstall it.", ()):
            loaded = entry.load()
        app = _app_of(name, loaded) if isfunction(loaded) else loaded
        if not isinstance(app, App) or app.name[0] != name:
            what = f"is neither a function nor an App(name={name!r}) of cyclopts"
            raise MethodError(f"Command {name!r} cannot be loaded: {entry.value} {what}.")
    except MethodError as error:
        return _refusing(name, str(error))
    assert isinstance(app.group, tuple), "cyclopts makes it one"
    named = [group if isinstance(group, str) else group.name for group in app.group]
    app.group = next((group for group in GROUPS if group.name in named), PLUGINS)
    return app


def _app_of(name: str, function: Callable[..., Any]) -> App:
    """A command made of a function: its docstring is the help, which ends with the text after "Example: ".

    Its options have the names of its parameters, and `-o` and `-q` are `output` and `quiet`, as in all commands.
    """
    text, _, example = (getdoc(function) or "").partition("\n\nExample: ")
    shared = {"output": Annotated[Path, Parameter(name=["--output", "-o"])], "quiet": Quiet}
    function.__annotations__.update({key: shared[key] for key in shared.keys() & function.__annotations__.keys()})
    app = App(name=name, help=text.partition("\n\nParameters\n")[0])
    if example:
        app.help_epilogue = f"Example: {example.partition(chr(10))[0]}"
    app.default(function)
    return app


def _refusing(name: str, fault: str) -> App:
    """A command that cannot run: its help and its error say why."""
    app = App(name=name, help=fault, group=PLUGINS)

    @app.default
    def refuse(*words: Annotated[str, Parameter(allow_leading_hyphen=True, show=False)]) -> None:
        raise XFreqBenchError(fault)

    return app


def _packages(name: str) -> str:
    """The packages that offer a command, in words."""
    found = entry_points(group=COMMAND_GROUP, name=name)
    return ", ".join(sorted({entry.dist.name if entry.dist else entry.value for entry in found}))
