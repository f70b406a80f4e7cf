"""Long lists of scores as short texts: a record has thousands of them."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

_MAX_NUMBERS = 10_000_000  # of a text that is unpacked


def pack(numbers: Sequence[float], step: float) -> str | list[float]:
    """A text that stands for numbers to the nearest multiple of `step`; the numbers themselves where one is infinite.

    Each multiple less the one before is an `int32`. The lowest bytes of all come first, then the second, third and
    fourth; they are deflated (zlib) and written in base64.
    """
    multiples = np.round(np.asarray(numbers, np.float64) / step)
    if not (np.abs(multiples) < 2**30).all():
        return list(numbers)
    differences = np.diff(multiples, prepend=0.0).astype("<i4")
    content = differences.view(np.uint8).reshape(-1, 4).T.tobytes()
    return base64.b64encode(zlib.compress(content, 9)).decode()


def unpack(packed: Any, step: float) -> Any:
    """The numbers that a text of `pack` stands for; what is no text comes back as it is.

    Raises `ValueError` for a text that `pack` does not write.
    """
    if not isinstance(packed, str):
        return packed
    inflate = zlib.decompressobj()
    try:
        content = inflate.decompress(base64.b64decode(packed, validate=True), 4 * _MAX_NUMBERS)
    except zlib.error as error:
        raise ValueError(f"a packed list cannot be read: {error}") from error
    if not inflate.eof or len(content) % 4:
        raise ValueError("a packed list is cut off, or longer than ten million numbers")
    differences = np.frombuffer(content, np.uint8).reshape(4, -1).T.copy().view("<i4")
    return (differences.ravel().cumsum(dtype=np.int64) * step).tolist()
