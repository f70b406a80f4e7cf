"""Damaged files of every kind, before every command that reads them: none ends in a traceback or costs a file."""

from __future__ import annotations

import contextlib
import functools
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st

from tests.support.fuzzing.common import check_clean, fuzz, sentinel_folder, untouched, xfreqbench
from tests.support.fuzzing.damages import damages
from tests.support.fuzzing.sound_files import DATA, FINGERPRINT, FITTED, RECORDS, small_benchmark, sound_files
from tests.whole.test_cli import COMMANDS, command_named
from xfreqbench.cli.main import app

# They draw, trace or run for a second.
_SLOW = ("card", "view", "plot", "findings", "residual", "benchmark", "bench measured")
_QUICKER = 10  # lines of other commands, for each line of those
_RESULT_PARTS = [
    *("records.jsonl", "checkpoints", "methods", "records_maps.jsonl", ".records", "predictions", "figures"),
    *("BENCHMARK.md", "BENCHMARK-", "benchmark.html", "benchmark.csv", "benchmark.parquet"),
]
# They take no files but records, which they add to by the same lines of code as `run`, and take long, or write alone.
NOT_GIVEN = {"new-method", *(f"bench {name}" for name in ("render", "savings", "scale-out", "peers", "stress"))}

_FIT = f"--method aperture-gs --targets 10 --budget 3steps -q {' '.join(f'--set {option}' for option in FITTED)}"
_NEAREST = "--method nearest --targets 10 --budget 3steps -q"
_BENCHMARK = "benchmark --preset fuzz --data data --results results -q"
_SCORE = f"score theirs.h5 --data {DATA} -q --results"
_REPORT = "report results -o new/board.md --html new/board.html -q"
_RESIDUAL = f"residual results --data {DATA} -o new.md --tx 2 -q"
_FINDINGS = f"findings results --data {DATA} -o new -q"
_MEASURED = "bench measured ./{0}.toml measured.csv --freqs 10 --max-depth 1 -q"

# By the kind of file that they read, given in a folder with the sound files; outputs are `new` and in `results`.
LINES: dict[str, tuple[str, ...]] = {
    "data set": (
        f"info {DATA}",
        f"plot {DATA} -o new.png --tx 1",
        f"view {DATA} -o new -q",
        f"generate room.toml --tx-positions {DATA} -o taken.h5 --freqs 1,10 -q",
        f"export {DATA} -o new --convention xfreq-gs --set plane=xy -q",
        f"card {DATA} --license CC0-1.0 -o new -q",
        f"split --data {DATA} -o new.h5 --targets 10 --maps -q",
        f"{_SCORE} new",
        f"run --data {DATA} --results new {_NEAREST}",
        *(_BENCHMARK, _REPORT, _FINDINGS, _RESIDUAL),
    ),
    "stored predictions": (
        f"run --data {DATA} --results results {_NEAREST}",
        "report results -o new/board.md --maps new/maps.jsonl -q",
        f"{_SCORE} results",
        *(_RESIDUAL, _REPORT, _BENCHMARK),
    ),
    "maps to show": (_REPORT,),
    "checkpoint": (f"run --data {DATA} --results results {_FIT}", _BENCHMARK),
    "records": (
        f"run --data {DATA} --results results {_NEAREST}",
        f"{_SCORE} results",
        "report results/records.jsonl results -o new/board.md --details new/all -q",
        "compare results/records.jsonl results",
        *(_BENCHMARK, _REPORT, _FINDINGS, _RESIDUAL),
    ),
    "collection": ("info rooms", "export rooms -o new --to webdataset -q"),
    "split file": (f"split --data {DATA} -o split.h5 --targets 10 --maps -q",),
    "predictions made elsewhere": (f"{_SCORE} new",),
    "PNG folder": ("import maps -o new.h5 -q",),
    "receiver of a PNG folder": ("import maps -o new.h5 -q",),
    "table of a PNG folder": ("import maps -o new.h5 -q",),
    "DeepMIMO scenario": ("import scenarios --from deepmimo -o new.h5 -q",),
    "DeepMIMO scenario of MATLAB": ("import mats --from deepmimo -o new.h5 -q",),
    "fingerprint": (f"bench fingerprint ./room.toml -o {FINGERPRINT} --interactions specular,refraction -q",),
    "measurement": (_MEASURED.format("room"),),
    "positions": tuple(
        f"generate room.toml --tx-positions tx.{suffix} -o taken.h5 --freqs 1,10 -q"
        for suffix in ("csv", "csv.gz", "xz")
    ),
    "scene": (
        "generate room.toml -o taken.h5 --freqs 1,10 -q",
        "view room.toml -o new -q",
        "bench generate ./room.toml",
        "bench reference ./room.toml -o taken.h5 -q",
        "bench fingerprint ./room.toml -o taken.h5 -q",
        _MEASURED.format("room"),
    ),
    "mesh": (
        "generate mesh.toml -o taken.h5 --freqs 1,10 -q",
        "bench reference ./mesh.toml -o taken.h5 -q",
        "info mesh.h5 --retrace 1",
        "export mesh.h5 -o new --to deepmimo -q",
        "view mesh.h5 -o new -q",
        "plot mesh.h5 -o new.svg --of power",
        _MEASURED.format("mesh"),
    ),
}

NAMES_OR_PATHS = {"scene", "data_or_scene", "results", "a", "b"}  # of shipped scenes, or of records
NUM_INPUTS = {"maps to show": 12, "stored predictions": 12, "mesh": 10, "PNG folder": 40, "positions": 100}
NUM_INPUTS |= {"measurement": 100, "receiver of a PNG folder": 100, "table of a PNG folder": 70}  # others: 20
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]


@functools.cache
def names() -> tuple[str, ...]:
    """What a refusal may call the file that it refuses."""
    words = ("record", "checkpoint", "scene", "rooms ", "taken.h5", "tx.", "transmitter position", "Transmitter ")
    return (*words, "small_reference.npz", *(Path(path).name for path in sound_files()))


def lines(kind: str) -> st.SearchStrategy[str]:
    """Command lines that read a kind, mostly of the commands that take milliseconds."""
    quick = [line for line in LINES[kind] if not line.startswith(_SLOW)]
    return st.sampled_from([*quick * _QUICKER, *LINES[kind]])


def check_read(line: str, changed: Mapping[str, Any], is_bounded: bool = True) -> None:
    """A command on the sound files, some of them changed or absent, ends well and touches its outputs alone."""
    with sentinel_folder() as folder, contextlib.chdir(folder), small_benchmark():
        for path, content in {**sound_files(), **changed}.items():
            if content is not None:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                Path(path).write_bytes(content() if callable(content) else content)
        with _touched_alone(line, folder):
            outcome = xfreqbench(*line.split(), is_bounded=is_bounded)
    check_clean(outcome, *names())


@contextlib.contextmanager
def _touched_alone(line: str, folder: Path) -> Iterator[None]:
    """Outputs are named `new`; a folder of results grows, and gives up checkpoints and methods of what is run again."""
    if "results results" not in line:
        with untouched(folder, folder / "new"):
            yield
        return
    written = [folder / "results" / part for part in _RESULT_PARTS]
    before = Path(RECORDS).read_bytes() if Path(RECORDS).exists() else b""
    with untouched(folder, *written, may_change=written[:3]):
        yield
    whole = before[: before.rfind(b"\n") + 1]
    assert not whole or Path(RECORDS).read_bytes().startswith(whole), "records were lost"


def takes_paths(names: tuple[str, ...]) -> bool:
    hints = typing.get_type_hints(command_named(names).default_command)
    return bool(hints.keys() & NAMES_OR_PATHS) or any(Path in (hint, *typing.get_args(hint)) for hint in hints.values())


def test_every_command_that_takes_a_path_is_given_damaged_files() -> None:
    given = {app.parse_commands(line.split())[0] for of_kind in LINES.values() for line in of_kind}
    assert {" ".join(names) for names in COMMANDS if takes_paths(names)} == set(map(" ".join, given)) | NOT_GIVEN


@functools.cache
def check_sound(line: str) -> None:
    """A command on sound files alone; the first one compiles and imports."""
    check_read(line, {}, is_bounded=False)


@pytest.mark.parametrize("kind", LINES)
def test_no_damage_ends_in_a_traceback(kind: str) -> None:
    for line in LINES[kind]:
        check_sound(line)
    fuzz(NUM_INPUTS.get(kind, 20), st.tuples(lines(kind), damages(kind)), lambda case: check_read(*case))
