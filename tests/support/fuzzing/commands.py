"""Which command reads which kind of file, and a command line for each of them."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from tests.support.fuzzing.common import Outcome, check_clean, sentinel_folder, untouched, xfreqbench
from tests.support.fuzzing.sound_files import DATA, FINGERPRINT, FITTED, RECORDS, small_benchmark, sound_files

RESULTS = ("records", "stored predictions", "checkpoint")
SCENE = ("scene", "mesh")
WRITTEN: tuple[str, ...] = ()  # an output, of which is read only whether it is the command's own

_SLOW = (
    "card",
    "view",
    "plot",
    "findings",
    "residual",
    "benchmark",
    "bench measured",
)  # they draw, trace or run for a second
_QUICKER = 10  # lines of other commands, for each line of those
RESULT_PARTS = (
    "records.jsonl",
    "checkpoints",
    "methods",
    "records_maps.jsonl",
    ".records",
    "predictions",
    "BENCHMARK.md",
    "BENCHMARK-",
    "benchmark.html",
    "figures",
)

# Every path that a command takes, with the kinds of files that are read there.
READS: dict[str, dict[str, tuple[str, ...]]] = {
    "info": {"file": ("data set", "mesh")},
    "plot": {"file": ("data set", "mesh"), "output": WRITTEN},
    "view": {"data_or_scene": ("data set", *SCENE), "output": WRITTEN},
    "generate": {"scene": SCENE, "tx_positions": ("positions", "data set"), "output": WRITTEN},
    "import": {"folder": ("PNG folder", "DeepMIMO scenario", "DeepMIMO scenario of MATLAB"), "output": WRITTEN},
    "export": {"data": ("data set", "mesh"), "output": WRITTEN},
    "card": {"data": ("data set", "mesh"), "output": WRITTEN},
    "split": {"data": ("data set",), "output": ("split file",)},
    "score": {
        "predictions": ("predictions made elsewhere",),
        "data": ("data set",),
        "results": ("records", "stored predictions"),
    },
    "run": {"data": ("data set",), "results": RESULTS},
    "benchmark": {"data": ("data set",), "results": RESULTS},
    "report": {
        "results": ("records", "stored predictions", "data set", "maps to show"),
        "output": WRITTEN,
        "html": WRITTEN,
        "maps": WRITTEN,
        "details": WRITTEN,
    },
    "compare": {"a": ("records",), "b": ("records",)},
    "new-method": {"output": WRITTEN},
    "findings": {"results": ("records",), "data": ("data set",), "output": WRITTEN, "room": WRITTEN},
    "residual": {"results": ("records", "stored predictions"), "data": ("data set",), "output": WRITTEN},
    "bench generate": {"scene": SCENE, "output": ("records",)},
    "bench reference": {"scene": SCENE, "output": WRITTEN},
    "bench fingerprint": {"scene": SCENE, "output": ("fingerprint",)},
    "bench render": {"output": ("records",)},
    "bench savings": {"output": ("records",)},
    "bench scale-out": {"output": ("records",)},
    "bench peers": {"output": ("records",)},
    "bench stress": {"output": ("records",)},
    "bench measured": {"scene": SCENE, "measured": ("measurement",), "output": ("records",)},
}
READ_NOTHING = ("scenes", "methods", "check-method")
MEASURING = {  # which take long, and read the records that they add to by the same lines of code as `report`
    *(
        (f"bench {name}", "records")
        for name in ("generate", "render", "savings", "scale-out", "peers", "stress", "measured")
    )
}

_FIT = f"--method aperture-gs --targets 10 --budget 3steps -q {' '.join(f'--set {option}' for option in FITTED)}"
_NEAREST = "--method nearest --targets 10 --budget 3steps -q"
_BENCHMARK = "benchmark --preset fuzz --data data --results results -q"
_SCORE = f"score theirs.h5 --data {DATA} -q --results"
_REPORT = "report results -o new/board.md --html new/board.html -q"
_MEASURED = "bench measured ./{0}.toml measured.csv --freqs 10 --max-depth 1 -q"
_MAPS = "report results -o new/board.md --maps new/maps.jsonl -q"

# The command lines by kind and command, given in a folder with the sound files; outputs are `new` and in `results`.
LINES: dict[str, dict[str, tuple[str, ...]]] = {
    "data set": {
        "info": (f"info {DATA}", f"info {DATA} --retrace 1"),
        "plot": (f"plot {DATA} -o new.png --tx 1", f"plot {DATA} -o new.pdf --of power"),
        "view": (f"view {DATA} -o new -q",),
        "generate": (f"generate room.toml --tx-positions {DATA} -o taken.h5 --freqs 1,10 -q",),
        "export": (f"export {DATA} -o new --convention xfreq-gs --set plane=xy -q",),
        "card": (f"card {DATA} --license CC0-1.0 -o new -q",),
        "split": (f"split --data {DATA} -o new.h5 --targets 10 --maps -q",),
        "score": (f"{_SCORE} new",),
        "run": (f"run --data {DATA} --results new {_NEAREST}",),
        "benchmark": (_BENCHMARK,),
        "report": (_REPORT, _MAPS),
        "findings": (f"findings results --data {DATA} -o new -q",),
        "residual": (f"residual results --data {DATA} -o new.md --tx 2 -q",),
    },
    "stored predictions": {
        "residual": (f"residual results --data {DATA} -o new.md --tx 2 -q",),
        "report": (_REPORT, _MAPS),
        "run": (f"run --data {DATA} --results results {_NEAREST}",),
        "score": (f"{_SCORE} results",),
        "benchmark": (_BENCHMARK,),
    },
    "maps to show": {"report": (_REPORT,)},
    "checkpoint": {"run": (f"run --data {DATA} --results results {_FIT}",), "benchmark": (_BENCHMARK,)},
    "records": {
        "run": (f"run --data {DATA} --results results {_NEAREST}",),
        "score": (f"{_SCORE} results",),
        "benchmark": (_BENCHMARK,),
        "report": (
            "report results -o new/board.md -q",
            "report results/records.jsonl results -o new/board.md --details new/all -q",
            _REPORT,
        ),
        "compare": ("compare results/records.jsonl results", "compare results/f results"),
        "findings": (f"findings results --data {DATA} -o new -q",),
        "residual": (f"residual results --data {DATA} -o new.md --tx 2 -q",),
    },
    "split file": {"split": (f"split --data {DATA} -o split.h5 --targets 10 --maps -q",)},
    "predictions made elsewhere": {"score": (f"{_SCORE} new",)},
    "PNG folder": {"import": ("import maps -o new.h5 -q",)},
    "DeepMIMO scenario": {"import": ("import scenarios --from deepmimo -o new.h5 -q",)},
    "DeepMIMO scenario of MATLAB": {"import": ("import mats --from deepmimo -o new.h5 -q",)},
    "fingerprint": {
        "bench fingerprint": (f"bench fingerprint ./room.toml -o {FINGERPRINT} --interactions specular,refraction -q",)
    },
    "measurement": {"bench measured": (_MEASURED.format("room"),)},
    "positions": {"generate": ("generate room.toml --tx-positions tx.csv -o taken.h5 --freqs 1,10 -q",)},
    "scene": {
        "generate": ("generate room.toml -o taken.h5 --freqs 1,10 -q",),
        "view": ("view room.toml -o new -q",),
        "bench generate": ("bench generate ./room.toml",),
        "bench measured": (_MEASURED.format("room"),),
        "bench reference": ("bench reference ./room.toml -o taken.h5 -q",),
        "bench fingerprint": ("bench fingerprint ./room.toml -o taken.h5 -q",),
    },
    "mesh": {
        "generate": ("generate mesh.toml -o taken.h5 --freqs 1,10 -q",),
        "view": ("view mesh.toml -o new -q", "view mesh.h5 -o new -q"),
        "info": ("info mesh.h5 --retrace 1",),
        "plot": ("plot mesh.h5 -o new.svg --of power",),
        "export": ("export mesh.h5 -o new --to deepmimo -q",),
        "card": ("card mesh.h5 --license CC0-1.0 -o new -q",),
        "bench generate": ("bench generate ./mesh.toml",),
        "bench measured": (_MEASURED.format("mesh"),),
        "bench reference": ("bench reference ./mesh.toml -o taken.h5 -q",),
        "bench fingerprint": ("bench fingerprint ./mesh.toml -o taken.h5 -q",),
    },
}


@functools.cache
def names() -> tuple[str, ...]:
    """What a refusal may call the file that it refuses."""
    words = (
        "record",
        "checkpoint",
        "scene",
        "taken.h5",
        "tx.csv",
        "transmitter position",
        "Transmitter ",
        "small_reference.npz",
    )
    return (*words, *(Path(path).name for path in sound_files()))


def lines(kind: str) -> st.SearchStrategy[str]:
    """Command lines that read a kind, mostly of the commands that take milliseconds."""
    quick = [line for command, of_command in LINES[kind].items() if command not in _SLOW for line in of_command]
    every = [line for of_command in LINES[kind].values() for line in of_command]
    return st.sampled_from([*quick * _QUICKER, *every])


def check_read(line: str, changed: Mapping[str, Any], is_bounded: bool = True) -> Outcome:
    """A command on the sound files, some of them changed or absent, ends well and touches its outputs alone."""
    with sentinel_folder() as folder, contextlib.chdir(folder), small_benchmark():
        for path, content in {**sound_files(), **changed}.items():
            if content is not None:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                Path(path).write_bytes(content() if callable(content) else content)
        with _touched_alone(line, folder):
            outcome = xfreqbench(*line.split(), is_bounded=is_bounded)
    check_clean(outcome, *names())
    return outcome


@contextlib.contextmanager
def _touched_alone(line: str, folder: Path) -> Iterator[None]:
    """Outputs are named `new`; a folder of results grows, and gives up checkpoints and methods of what is run again."""
    if "results results" not in line and "-o results" not in line:
        with untouched(folder, folder / "new"):
            yield
        return
    written = [folder / "results" / part for part in RESULT_PARTS]
    before = Path(RECORDS).read_bytes() if Path(RECORDS).exists() else b""
    with untouched(folder, *written, may_change=written[:3]):
        yield
    whole = before[: before.rfind(b"\n") + 1]
    assert not whole or Path(RECORDS).read_bytes().startswith(whole), "records were lost"
