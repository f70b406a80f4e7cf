"""Benchmark of radiance-field methods that predict wireless channels at unseen carriers.

The names of `__init__.pyi` are the public interface, described in docs/api.md; each is imported when it is first
used. Everything else may change.
"""

import os
import sys

import lazy_loader as lazy

from xfreqbench.system.caches import settle_caches
from xfreqbench.system.callable_package import hinted

if sys.platform == "win32":
    raise ImportError("xfreqbench runs on Linux. On Windows, install it in WSL: run wsl --install, and pip there.")
_clone = os.path.dirname(os.path.dirname(__file__))
if os.path.isfile(os.path.join(_clone, "pyproject.toml")):  # there `baselines`, `scenes`, `examples` lie beside this folder
    __path__.append(_clone)
settle_caches()  # before any library looks for its own

# Before OpenMP starts: threads that wait give their core up, unless OMP_WAIT_POLICY asks for more. By default they keep
# it, and two fits beside each other on two cores run at a hundredth of their speed.
os.environ.setdefault("GOMP_SPINCOUNT", "infinite" if os.getenv("OMP_WAIT_POLICY", "").upper() == "ACTIVE" else "1")
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
__getattr__ = hinted(__getattr__, __all__)
