"""Every error a user can mend, as one tree.

XFreqBenchError
├── UnknownNameError       a scene, method, material, option or protocol that does not exist
├── SceneError             a scene file that cannot be read or describes no valid scene
│   ├── MaterialBandError  a carrier outside the band in which a used material is defined
│   └── PlacementError     a receiver or transmitter inside, or on, an object
├── OutputExistsError      an output file that holds something else than what is asked for
├── DataError              a data set, split or record that is damaged or of another schema
├── ProtocolError          a protocol that the data set cannot serve
├── MethodError            a method that breaks its contract
│   └── DivergenceError    a fit whose loss, gradients or parameters are no longer finite
├── StorageError           no space, or no permission, where the output goes
├── ClusterError           workers that cannot be reached, are unlike this process, or die of their work
└── MissingLLVMError       no LLVM library that Dr.Jit can use
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class XFreqBenchError(Exception):
    """Something a user can mend; the message says what was given, what is allowed and what to do."""


class UnknownNameError(XFreqBenchError):
    """A name that is not in its list of choices."""

    def __init__(self, kind: str, given: str, choices: Iterable[str]) -> None:
        known = sorted(choices)
        nearest = difflib.get_close_matches(given, known, n=1, cutoff=0.4)
        hint = f" Did you mean {nearest[0]!r}?" if nearest else ""
        super().__init__(f"There is no {kind} {given!r}.{hint} Choose one of: {', '.join(known)}.")
        self._arguments = kind, given, known

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments  # or another process could not tell of it


class SceneError(XFreqBenchError):
    """A scene that cannot be read or is not valid."""


class MaterialBandError(SceneError):
    """A carrier outside the band in which a used material is defined."""


class PlacementError(SceneError):
    """A receiver or transmitter where none can stand."""


class OutputExistsError(XFreqBenchError):
    """An output that exists and holds something else."""


class DataError(XFreqBenchError):
    """Stored data that are damaged or of another schema."""


class ProtocolError(XFreqBenchError):
    """A protocol that the data set cannot serve."""


class MethodError(XFreqBenchError):
    """A method that breaks the `Method` contract."""


class DivergenceError(MethodError):
    """A fit that left the finite numbers at `step`; `tensor` names the loss, a gradient or a parameter."""

    def __init__(self, step: int, tensor: str, context: str = "Lower the learning rate.") -> None:
        super().__init__(f"{tensor} is not finite at step {step}. {context}")
        self.step = step
        self.tensor = tensor
        self._context = context

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.step, self.tensor, self._context)


class StorageError(XFreqBenchError):
    """An output that cannot be written."""


class ClusterError(XFreqBenchError):
    """Workers that cannot be reached, are unlike this process, or die of their work."""


class MissingLLVMError(XFreqBenchError):
    """No LLVM library that Dr.Jit's CPU backend can use."""
