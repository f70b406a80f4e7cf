"""A package that is also the public function of its name: `xfreqbench.methods`, and `xfreqbench.methods()`.

When Python imports a sub-package, it binds it to its name in the parent package. A function of the same name there
would hide it, or be hidden. And `hinted`, for the names that a package offers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from importlib import import_module
from types import ModuleType


class CallablePackage(ModuleType):
    """The type of such a package: `sys.modules[__name__].__class__ = CallablePackage`.

    `NAMES` in the package is the `module:function` that gives the names. It is a text, so that importing a module of
    the package does not import that function.
    """

    NAMES: str

    def __call__(self) -> list[str]:
        """The names that the package offers."""
        module, _, function = self.NAMES.partition(":")
        return list(getattr(import_module(module), function)())


def hinted(found: Callable[[str], object], names: Sequence[str]) -> Callable[[str], object]:
    """The `__getattr__` of a package, with an `AttributeError` that names the nearest of its public names."""

    def find(name: str) -> object:
        try:
            return found(name)
        except AttributeError:
            nearest = [] if name.startswith("_") else get_close_matches(name, names, n=1)
            hint = f" Did you mean {nearest[0]!r}?" if nearest else " docs/api.md lists the public names."
            raise AttributeError(f"xfreqbench has no {name!r}.{hint}", name=name) from None

    return find
