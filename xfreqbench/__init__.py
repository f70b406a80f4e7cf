"""Benchmark of radiance-field methods that predict wireless channels at unseen carriers.

The names of `__init__.pyi` are the public interface, described in docs/api.md; each is imported when it is first
used. Everything else may change.
"""

import os
import sys
from pathlib import Path

import lazy_loader as lazy

from xfreqbench.system.caches import settle_caches
from xfreqbench.system.callable_package import hinted

if sys.platform == "win32":
    raise ImportError("xfreqbench runs on Linux. On Windows, install it in WSL: run wsl --install, and pip there.")
# In a clone `baselines`, `scenes` and `examples` are next to this folder; in a wheel they are in it.
__path__ = [*__path__, *(str(up) for up in Path(__path__[0]).parents[:1] if (up / "pyproject.toml").is_file())]
settle_caches()  # before any library looks for its own

# Before OpenMP starts: threads that wait give their core up, unless OMP_WAIT_POLICY asks for more. By default they keep
# it, and two fits at the same time on two cores run at a hundredth of their speed.
os.environ.setdefault("GOMP_SPINCOUNT", "infinite" if os.getenv("OMP_WAIT_POLICY", "").upper() == "ACTIVE" else "1")
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
__getattr__ = hinted(__getattr__, __all__)
