"""All errors that a user can fix, as one tree.

XFreqBenchError            any of these; its message says what was given, what is allowed and what to do
├── ArgumentError          a Python function was given an argument that it cannot use; a `TypeError` too
├── UnknownNameError       there is no scene, method, material, option or protocol of that name
├── SceneError             a scene file cannot be read, or is not a valid scene
│   ├── MaterialBandError  a carrier is outside the band in which a material of the scene is defined
│   └── PlacementError     the receiver or a transmitter is inside an object, on a surface, or too near to one
├── OutputExistsError      the output exists already and holds something else, which is not overwritten
├── DataError              a stored file (data set, split, predictions, records) is missing, damaged or of another kind
├── ProtocolError          the data set lacks carriers or transmitters that the protocol needs
├── MethodError            a method cannot be imported, or breaks the `Method` contract
│   └── DivergenceError    while a method was fitted, its loss, gradients or parameters became infinite or NaN
├── RunsFailedError        some of several runs failed; it holds the error of each
├── StorageError           a file cannot be written or read: no space, no permission, no memory, a failing disk
│   └── InUseError         another process is writing it
├── OutOfMemoryError       memory ran out, or what is asked for takes more than is left
├── ClusterError           workers cannot be reached, differ from this process, or end while they work
└── MissingLLVMError       there is no LLVM library that Dr.Jit can use
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from typing import Any


class XFreqBenchError(Exception):
    """An error that a user can fix; the message says what was given, what is allowed and what to do."""


class ArgumentError(XFreqBenchError, TypeError):
    """A function was given an argument that it cannot use."""


def was_interrupted(error: BaseException | None) -> bool:
    """Whether an exception is a `KeyboardInterrupt`, or was raised because of one, as Numba raises `SystemError`."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class OutOfMemoryError(XFreqBenchError):
    """Memory ran out, or what is asked for takes more than is left."""


_NO_MEMORY = re.compile(
    "not enough memory|out of memory|(can.?not|can't|unable to|could not) allocate|allocation failed"
    "|failed to map segment|can't start new thread|return without exception set",
    re.IGNORECASE,
)


def ran_out_of_memory(error: BaseException | None) -> bool:
    """Whether memory ran out, by the type or the words of an error or of its causes.

    Threads that cannot be started, and libraries that cannot be loaded for lack of memory, count too.
    """
    while error is not None:
        words = " ".join(text for text in error.args if isinstance(text, str))  # its own text may be anybody's code
        if isinstance(error, MemoryError | OutOfMemoryError) or _NO_MEMORY.search(words):
            return True
        error = error.__cause__ or error.__context__
    return False


_OTHER_WORDS = {  # common names, and our names for them
    "leave-one-out": "lofo",
    "leave-one-frequency-out": "lofo",
    "random": "random-samples",
    "reflection": "specular",
    "reflections": "specular",
    "scattering": "diffuse",
    "transmission": "refraction",
    "drywall": "plasterboard",
    "gypsum": "plasterboard",
    "aluminium": "metal",
    "steel": "metal",
}


def did_you_mean(given: str, choices: Iterable[str]) -> str:
    """A question at the end of an error, as in ` Did you mean 'nearest'?`; empty if no choice is similar."""
    known = list(choices)
    meant = _OTHER_WORDS.get(given.lower().replace("_", "-").replace(" ", "-"))
    nearest = [meant] if meant in known else difflib.get_close_matches(given, known, n=1, cutoff=0.4)
    return f" Did you mean {nearest[0]!r}?" if nearest else ""


class UnknownNameError(XFreqBenchError):
    """There is no such `kind` of thing as `given`; the message names the nearest of `choices`, and all of them."""

    def __init__(self, kind: str, given: str, choices: Iterable[str]) -> None:
        known = sorted(filter(None, choices))
        hint = did_you_mean(given, known)
        advice = f"Choose one of: {', '.join(known)}." if known else "There are none: leave it out."
        super().__init__(f"There is no {kind} {given!r}.{hint} {advice}")
        self._arguments = kind, given, known

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments  # so that it can be pickled and raised in another process


class SceneError(XFreqBenchError):
    """A scene file cannot be read, or is not a valid scene."""


class MaterialBandError(SceneError):
    """A carrier is outside the band in which a material of the scene is defined."""


class PlacementError(SceneError):
    """The receiver or a transmitter is inside an object, on a surface, or too near to one."""


class OutputExistsError(XFreqBenchError):
    """The output exists already and holds something else, which is not overwritten."""


class DataError(XFreqBenchError):
    """A stored file is missing, damaged or of another kind."""


class ProtocolError(XFreqBenchError):
    """The data set lacks carriers or transmitters that the protocol needs."""


class MethodError(XFreqBenchError):
    """A method cannot be imported, or breaks the `Method` contract."""


class DivergenceError(MethodError):
    """At `step` of a fit, `tensor` (the loss, a gradient or a parameter, by name) became infinite or NaN."""

    def __init__(self, step: int, tensor: str, context: str = "Lower the learning rate.") -> None:
        super().__init__(f"{tensor} is not finite at step {step}. {context}")
        self.step = step
        self.tensor = tensor
        self._context = context

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.step, self.tensor, self._context)


class StorageError(XFreqBenchError):
    """A file cannot be written, or the system cannot read it: no space, no permission, no memory, a failing disk."""


class InUseError(StorageError):
    """Another process is writing the output; the message says which one, and since when."""


class RunsFailedError(XFreqBenchError):
    """Some of several runs failed; `errors` has the error of each by its name. The other runs are kept."""

    def __init__(self, errors: Mapping[str, BaseException], num_asked: int) -> None:
        self.errors = dict(errors)
        self._num_asked = num_asked
        number = f"{len(errors)} of {num_asked} runs failed; the same call tries them again."
        super().__init__("\n".join([number, *self.lines]))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.errors, self._num_asked)

    @property
    def lines(self) -> list[str]:
        """A line for each run that failed."""
        return [
            f"{run}: {error if isinstance(error, XFreqBenchError) else f'{type(error).__name__}: {error}'}"
            for run, error in self.errors.items()
        ]


class ClusterError(XFreqBenchError):
    """Workers cannot be reached, differ from this process, or end while they work."""


class MissingLLVMError(XFreqBenchError):
    """There is no LLVM library that Dr.Jit can use."""
