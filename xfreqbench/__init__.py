"""Benchmark of radiance-field methods that predict wireless channels at unseen carriers.

The names of `__init__.pyi` are the public interface, described in docs/api.md; each is imported when it is first
used. Everything else may change.
"""

import os

import lazy_loader as lazy

# Before OpenMP starts: threads that wait give their core up at once, or fits beside each other run at a hundredth of
# their speed.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "1")
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
