"""Benchmark of radiance-field methods that predict wireless channels at unseen carriers.

The names of `__init__.pyi` are the public interface, described in docs/api.md; each is imported when it is first
used. Everything else may change.
"""

import os

import lazy_loader as lazy

os.environ.setdefault(  # before OpenMP starts; `system.waiting` says what for
    "GOMP_SPINCOUNT",
    {"PASSIVE": "0", "ACTIVE": "infinite"}.get(os.getenv("OMP_WAIT_POLICY", "").upper(), "1001"),
)
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
