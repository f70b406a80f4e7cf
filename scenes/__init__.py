"""Scene files that ship with xfreqbench, and their names: `xfreqbench.scenes()`."""

import sys

from xfreqbench.system.callable_package import CallablePackage

NAMES = "xfreqbench.scene.toml_files:shipped_scenes"
sys.modules[__name__].__class__ = CallablePackage
