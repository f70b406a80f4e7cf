"""What the fuzzing tests share: the command line in this process, what is clean, and how inputs are spoilt."""

from __future__ import annotations

import io
import logging
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from xfreqbench.cli.main import main
from xfreqbench.errors import XFreqBenchError

FACTOR = int(os.environ.get("XFREQBENCH_FUZZ_FACTOR", "0"))  # 0: the same inputs at every run, else others, more
SLEEPY_S = 20  # of processor time, far beyond what any of the inputs takes: whoever gets there hangs
MEMORY_BYTES = 3 << 30  # above what is mapped before: no input here is worth a tenth of it
NOISE = ("Traceback", "[Errno", "errors.pydantic.dev", "Unable to allocate", "MemoryError", "RecursionError")
_FRAME = re.compile(r"[\s│╭╮╰╯─]+")


@dataclass(frozen=True)
class Outcome:
    """How a command ended, and what it wrote."""

    code: int
    stdout: str
    stderr: str

    @property
    def message(self) -> str:
        """All that it said, a sentence a line however wide the frame around it was."""
        return _FRAME.sub(" ", f"{self.stderr} {self.stdout}").strip()


def xfreqbench(*words: str | Path, is_bounded: bool = True) -> Outcome:
    """The command line as `main` runs it, in this process; any exception that a user would see passes.

    A command that makes sound files is not bounded, for the first one compiles kernels.
    """
    stdout, stderr = io.StringIO(), io.StringIO()
    leave = mock.patch.object(os, "_exit", side_effect=sys.exit)
    arguments = mock.patch.object(sys, "argv", ["xfreqbench", *map(str, words)])
    bound = _bounded() if is_bounded else nullcontext()
    with redirect_stdout(stdout), redirect_stderr(stderr), leave, arguments, bound, _no_warning():
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    return Outcome(code, stdout.getvalue(), stderr.getvalue())


def refusal(call: Callable[[], Any]) -> str | None:
    """Message of the `XFreqBenchError` that a call raises, or None where it raises nothing."""
    with _bounded(), _no_warning():
        try:
            call()
        except XFreqBenchError as error:
            return str(error)
    return None


@contextmanager
def _bounded() -> Iterator[None]:
    """Stop what hangs, and refuse memory that no input here is worth."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    mapped_bytes = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
    before = signal.signal(signal.SIGPROF, _hangs)
    signal.setitimer(signal.ITIMER_PROF, SLEEPY_S)
    resource.setrlimit(resource.RLIMIT_AS, (mapped_bytes + MEMORY_BYTES, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def _hangs(*_: Any) -> None:
    raise AssertionError("no end after the processor time that was given")


@contextmanager
def _no_warning() -> Iterator[None]:
    """As for a user, warnings are no errors and no `except` sees them; afterwards none may be there."""
    heard: list[logging.LogRecord] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = heard.append  # type: ignore[method-assign]
    logging.getLogger().addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            warnings.filterwarnings("ignore", "Cyclopts application invoked without tokens")  # under pytest
            yield
    finally:
        logging.getLogger().removeHandler(handler)
    told = [
        f"{warning.category.__name__}: {warning.message} ({warning.filename}:{warning.lineno})" for warning in caught
    ]
    told += [record.getMessage() for record in heard]
    assert not told, f"a user would read warnings: {told}"


def check_clean(outcome: Outcome, *names: str) -> None:
    """A success says nothing on stderr; a refusal says in words what was wrong, and names one of `names`."""
    for noise in NOISE:
        assert noise not in outcome.message, outcome.message
    if outcome.code == 0:
        assert outcome.stderr == "", outcome.stderr
        return
    assert outcome.code in (1, 2), outcome
    if outcome.code == 2:
        check_refusal(outcome.stderr.removeprefix("xfreqbench: "), *names)
    else:
        assert "Error" in outcome.message, outcome  # the frame of what is no option at all


def check_refusal(message: str | None, *names: str) -> None:
    """A refusal is more than the name of what it refuses, and no library's own words."""
    if message is None:
        return
    words = " ".join(message.split())
    for noise in NOISE:
        assert noise not in words, words
    assert len(words) > 20, words
    if names:
        assert any(" ".join(name.split()) in words for name in names), f"{words!r} names none of {names}"


@contextmanager
def untouched(folder: Path, *new: Path, may_change: Sequence[Path] = ()) -> Iterator[None]:
    """Whatever was in a folder is there afterwards, byte by byte; nothing else is, but what is `new` or in it.

    What `may_change` names, and what is in it, may be other than it was, or gone.
    """
    before = _contents(folder)
    yield
    after = _contents(folder)
    left = [path for path in after.keys() - before.keys() if not path.startswith(tuple(map(str, new)))]
    assert not left, f"files were left behind: {left}"
    for path, content in before.items():
        is_kept = after.get(path) == content or path.startswith(tuple(map(str, may_change)))
        assert is_kept, f"{path} is not what it was"


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextmanager
def sentinel_folder() -> Iterator[Path]:
    """A new folder with files that nobody may touch, one of them half a line at its end."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        (folder / "notes.txt").write_bytes(b"mine\nhalf a line")
        (folder / "taken.h5").write_bytes(b"not a data set")
        yield folder
    finally:
        shutil.rmtree(folder)


def fuzz(num_inputs: int, inputs: st.SearchStrategy[Any], check: Callable[[Any], None]) -> None:
    """Check a number of inputs, all of them where none fails; Hypothesis shrinks the one that does."""
    seen = []

    @settings(
        max_examples=num_inputs * max(1, FACTOR),
        derandomize=FACTOR == 0,
        database=None,
        phases=[Phase.generate, Phase.target, Phase.shrink],  # explaining takes longer than all of these
        # of a busy machine, and of whole files that are drawn
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
    )
    @given(st.just(None).flatmap(lambda _: inputs))  # whose own text would be too long to show
    def every(case: Any) -> None:
        seen.append(None)
        check(case)

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Generating overly large repr")  # of the case that fails
        every()
    assert len(seen) >= num_inputs, f"only {len(seen)} inputs were there to generate"


# What stands in command lines: the system passes no NUL, and no lone surrogate of a text.
WORDS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30)
_LARGE = ["1e6", "1e9", "-1e9", "1e15", "1e19", "1e155", "1e200", "1e300", "1e308", "-1e308"]
ODD_NUMBERS = st.sampled_from(["nan", "inf", "-inf", "0", "-0.0", "-1", "0.3", "3", "1e-300", "5e-324", *_LARGE])
ODD_WORDS = st.sampled_from(
    ["", " ", "\n", "é", "\u202e", "𝕏" * 80, "../..", "/", "-", "--", "null", "$x_{$", "|", "<b>", "x" * 5000]
)


def cut_or_flipped(content: bytes) -> st.SearchStrategy[bytes]:
    """The bytes of a file, cut short, with bits turned over, or with bytes inserted."""
    place = st.integers(0, max(0, len(content) - 1))
    cut = place.map(lambda end: content[:end])
    flipped = st.lists(st.tuples(place, st.integers(1, 255)), min_size=1, max_size=4).map(
        lambda flips: _flipped(content, flips)
    )
    inserted = st.tuples(place, st.binary(min_size=1, max_size=20)).map(
        lambda at: content[: at[0]] + at[1] + content[at[0] :]
    )
    return cut | flipped | inserted


def torn(content: bytes) -> st.SearchStrategy[bytes]:
    """The bytes of a file cut, flipped or inserted, half of the times near its start, where layouts are told."""
    head = cut_or_flipped(content[:6000]).map(lambda head: head + content[6000:])
    return head | cut_or_flipped(content)


def _flipped(content: bytes, flips: list[tuple[int, int]]) -> bytes:
    changed = bytearray(content)
    for place, mask in flips:
        changed[place] ^= mask
    return bytes(changed)


# Values of JSON that are of the wrong type, or far from what they should be.
JSON_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([10**30, -1, 0, 2**63, 1e308, -1e308, 5e-324, float("inf"), float("nan")])
    | st.floats()
    | ODD_WORDS
    | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def spoilt_json(value: Any) -> st.SearchStrategy[Any]:
    """A JSON value with one part of it, at any depth, replaced, removed or added."""
    options = [JSON_VALUES]
    if isinstance(value, dict) and value:
        keys = st.sampled_from(sorted(value))
        options.append(keys.flatmap(lambda key: spoilt_json(value[key]).map(lambda part: {**value, key: part})))
        options.append(keys.map(lambda key: {name: part for name, part in value.items() if name != key}))
        options.append(st.tuples(st.text(max_size=8), JSON_VALUES).map(lambda item: {**value, item[0]: item[1]}))
    if isinstance(value, list) and value:
        places = st.integers(0, len(value) - 1)
        options.append(
            places.flatmap(lambda at: spoilt_json(value[at]).map(lambda part: [*value[:at], part, *value[at + 1 :]]))
        )
        options.append(places.map(lambda at: [*value[:at], *value[at + 1 :]]))
    return st.one_of(options[1:] * 3 + options[:1])


def odd_array(array: np.ndarray) -> st.SearchStrategy[np.ndarray]:
    """An array of another dtype or shape, or with numbers in it that mean nothing."""
    odd = st.sampled_from([np.nan, np.inf, -np.inf, -1.0, 1e308, 0.0])
    dtypes = st.sampled_from(["<f8", ">f8", "<i4", "u1", "<f2", "<c16", "S3", "?"])
    shapes = [(), (0,), (1,), array.shape[1:], (*array.shape, 1), array.shape[::-1], (array.size,)]
    return (
        dtypes.map(lambda dtype: np.zeros(array.shape, dtype))
        | st.sampled_from(shapes).map(lambda shape: np.resize(array, shape))
        | st.tuples(st.integers(0, max(0, array.size - 1)), odd).map(lambda at: _with_odd(array, *at))
    )


def _with_odd(array: np.ndarray, place: int, value: float) -> np.ndarray:
    changed = array.copy()
    if changed.size:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a number that does not fit is as good as any
            changed.flat[place] = np.asarray(value).astype(array.dtype)
    return changed
