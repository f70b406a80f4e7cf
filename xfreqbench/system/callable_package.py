"""A package that is also the public function of its name: `xfreqbench.methods`, and `xfreqbench.methods()`.

When Python imports a sub-package, it binds it to its name in the parent package. A function of the same name there
would hide it, or be hidden.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType


class CallablePackage(ModuleType):
    """The type of such a package: `sys.modules[__name__].__class__ = CallablePackage`.

    `NAMES` in the package is the `module:function` that gives the names. It is a text, so that whoever imports a
    module of the package does not depend on that function.
    """

    NAMES: str

    def __call__(self) -> list[str]:
        """The names that the package offers."""
        module, _, function = self.NAMES.partition(":")
        return list(getattr(import_module(module), function)())
