from __future__ import annotations

import _imp
import ctypes
import errno
import functools
import json
import re
import resource
import shlex
import signal
import subprocess
import sys
import threading
import time
from importlib.machinery import ExtensionFileLoader
from pathlib import Path
from types import ModuleType

import pytest
from cyclopts import App

from tests.support.fuzzing.common import xfreqbench
from tests.support.leaderboard_records import make_records
from tests.support.places import ROOT
from tests.support.stored_records import make_record, store
from xfreqbench.cli import main as cli
from xfreqbench.cli.main import app, interruptions_kept
from xfreqbench.cli.options import parse_carriers_hz
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.system import machine

HEAVY = {"numpy", "torch", "sionna", "mitsuba", "drjit", "h5py", "numba", "scipy", "skimage", "matplotlib"}


def test_help_loads_no_heavy_library() -> None:
    program = f"""
import sys
from xfreqbench.cli.main import app
for words in ("--help", "generate --help", "run --help"):
    try:
        app(words)
    except SystemExit:
        pass
print("loaded", sorted({HEAVY!r} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.rstrip().endswith("loaded []")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("generate offce -o x.h5", "Did you mean 'office'"),
        ("generate office -o x.h5 --freqs 1;2", "comma-separated"),
        ("generate office -o x.h5 --freqs 0.5", "from 1 to 100 GHz"),
        ("generate office -o x.h5 --interactions refracton", "Did you mean 'refraction'"),
        ("generate office -o x.h5 --pas-kind powr", "Did you mean 'power'"),
        ("generate office -o x.h5 --tx 100000", "usable transmitter positions"),
        ("generate office -o x.h5 --tx-positions none.csv", "x,y,z in metres"),
        ("generate empty --tx 10 --dry-run -o x.h5 --executor many", "--executor takes serial, a number of processes"),
        ("info nowhere.h5", "There is no file nowhere.h5"),
        ("report nowhere", "nowhere"),
        ("bench render --gaussians 1000001", "takes whole numbers from 1 to 100"),
        ("bench render --batch 8,1001", "takes whole numbers from 1 to 100"),
        ("run --method nearest --results results --data x.h5 --on tests", 'Choose from: "test", "validation"'),
        ("split -o x.h5 --data x.h5 --on tests", 'Choose from: "test", "validation"'),
        ("generate office -o x.h5 --freq 1", "--freqs"),
        ("generate office -o x.h5 --freqs 2400", "cannot use '2400': a carrier in GHz is at most"),
        ("generate office -o x.h5 --freqs-ghz=x", "--freqs-ghz takes carriers in GHz"),
        ("generate office -o x.h5 --freqs 2_4", "--freqs takes carriers in GHz, comma-separated"),
        ("generate office -o x.h5 --tx 1.5", 'Invalid value for --tx: unable to convert "1.5" into int'),
        ("import maps -o x.h5 --freq 2_4", 'Invalid value for --freq: unable to convert "2_4" into float'),
        ("bench measured flat x.csv --freqs 2.4 --height 1_3", 'unable to convert "1_3" into float'),
        ("generate office -o x.h5 --receiver north", "There is no receiver 'north'. There are none: leave it out."),
        ("run --method nearest --results results --data x.h5 --seed x", "--seed takes whole numbers"),
        ("run --method nearest --results results --data x.h5 --seeds x", "--seeds takes whole numbers"),
        ("run --method nearest --results results --data x.h5 --targets x", "--targets takes carriers"),
        (
            "run --method nearest, gsrf --results results --data x.h5",
            "does not take 'gsrf'. A list has commas and no spaces",
        ),
        ("split -o x.h5 --data x.h5 --targets-ghz x", "--targets-ghz takes carriers"),
        ("import nowhere -o x.h5", "There is no folder nowhere."),
        ("vew", 'Did you mean "view"?'),
        ("scenes ofice --toml", "Did you mean 'office'"),
        ("scenes office", "A name and --toml need each other"),
        ("scenes --toml", "A name and --toml need each other"),
    ],
)
def test_mistakes_end_with_code_2_and_words(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = xfreqbench(*words.split())
    assert done.code == 2
    assert message in done.message
    assert "Traceback" not in done.message
    assert not list(tmp_path.iterdir())


def test_a_message_quotes_no_more_than_a_screen_of_what_was_given() -> None:
    told = xfreqbench("generate", "office", "-o", "x.h5", "--freqs", "1" * 100_000).stderr
    assert told.startswith("xfreqbench: --freqs takes carriers in GHz")
    assert " … " in told
    assert len(told) < 10_000


def test_a_shell_completes_commands_and_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    done = xfreqbench("--install-completion", "--shell", "bash")
    script = tmp_path / ".local" / "share" / "bash-completion" / "completions" / "xfreqbench"
    assert done.code == 0 and str(script) in done.stdout.replace("\n", "")
    assert str(script) in (tmp_path / ".bashrc").read_text(encoding="utf-8")
    asked = {"gen": "generate", "run --prot": "--protocol", "bench fing": "fingerprint", "run --on val": "validation"}
    lines = [f"COMP_WORDS=(xfreqbench {words}) COMP_CWORD={len(words.split())}; _xfreqbench; " for words in asked]
    program = f"source {shlex.quote(str(script))}; " + "".join(f'{line} echo "${{COMPREPLY[@]}}"; ' for line in lines)
    found = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=True).stdout
    assert found.splitlines() == list(asked.values())


VIEW, COMPARE = (
    "Example: xfreqbench view office.h5 --tx 7 -o",
    "Example: xfreqbench compare results/before results/after",
)


@pytest.mark.parametrize(
    ("words", "needed", "example"),
    [
        ("run --data d.h5 --results r", "needs --methods or --method.", "Example: xfreqbench run --data office.h5"),
        ("view office.h5", "needs --output or -o.", VIEW),
        ("bench fingerprint empty", "needs --output or -o.", "Example: xfreqbench bench fingerprint office -o"),
        ("view office.h5 -o", "-o requires an argument.", VIEW),
        ("compare results", "xfreqbench compare needs B.", COMPARE),
    ],
)
def test_a_command_line_that_lacks_something_is_told_what_and_shown_an_example(
    words: str, needed: str, example: str
) -> None:
    done = xfreqbench(*words.split())
    assert done.code == 2
    assert needed in done.message and example in done.message


def test_options_have_the_names_of_python_and_their_older_ones() -> None:
    for word in ("--methods nearest --targets-ghz 10 --seeds 1", "--method nearest --targets 10 --seed 1"):
        _, bound, _ = app.parse_args(f"run --data d.h5 --results r {word}", exit_on_error=False)
        options = bound.arguments["options"]
        assert (bound.arguments["method"], options.targets_ghz, options.seeds) == ("nearest", "10", "1")
    for word in ("--freqs-ghz", "--freqs"):
        _, bound, _ = app.parse_args(f"generate empty -o x.h5 {word} 2.4,5", exit_on_error=False)
        assert bound.arguments["options"].freqs_ghz == [2.4, 5.0]


@pytest.mark.parametrize("words", ["a b", "--results a --results b"])
def test_folders_of_results_are_given_alone_or_by_name(words: str) -> None:
    assert app.parse_args(f"report {words}", exit_on_error=False)[1].arguments["results"] == ["a", "b"]


def test_a_dry_run_prints_counts_size_and_time_and_writes_and_starts_nothing(tmp_path: Path) -> None:
    words = f"generate empty --tx 10 --freqs 1,94 --dry-run -o {tmp_path / 'x.h5'} --executor dask://nowhere:8786"
    done = xfreqbench(*words.split())
    assert done.code == 0
    assert all(text in done.stdout for text in ("10 transmitters", "20 samples", "estimated time"))
    assert not list(tmp_path.iterdir())


def test_carriers_are_read_in_gigahertz() -> None:
    assert parse_carriers_hz("1, 24.25") == [1e9, 24.25e9]
    assert len(parse_carriers_hz("paper")) == 10
    with pytest.raises(XFreqBenchError, match="GHz"):
        parse_carriers_hz("one")


def command_names(commands: App, *before: str) -> list[tuple[str, ...]]:
    found = [before]
    for name in commands:
        if not name.startswith("-"):
            found += command_names(commands[name], *before, name)
    return found


def command_named(names: tuple[str, ...]) -> App:
    return functools.reduce(lambda within, name: within[name], names, app)


COMMANDS = [names for names in command_names(app) if command_named(names).default_command is not None]


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_the_help_of_every_command_ends_with_an_example_that_can_be_given(names: tuple[str, ...]) -> None:
    told = command_named(names).help_epilogue
    assert told is not None and told.startswith(f"Example: xfreqbench {' '.join(names)}")
    words = shlex.split(told.removeprefix("Example: xfreqbench "))
    command, _, _ = app.parse_args(words, exit_on_error=False, print_error=False, help_on_error=False)
    assert command is command_named(names).default_command


@pytest.mark.parametrize("columns", ["0", "1", "2", "-1", "²", "9" * 5000, "1000000000"])
def test_the_help_of_every_command_ends_at_every_width(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for names in command_names(app) if columns == "1" else [("generate",), ("bench",)]:
        monkeypatch.setenv("COLUMNS", columns)
        done = xfreqbench(*names, "--help")
        assert done.code == 0, (names, done.stderr)
        assert max(map(len, done.stdout.splitlines())) <= 1000


def test_an_interruption_in_a_callback_of_the_garbage_collector_counts() -> None:
    class Interrupted:
        def __del__(self) -> None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), interruptions_kept():
        Interrupted()
        while True:  # until the interpreter looks for signals
            time.sleep(0.001)


def test_an_interruption_that_a_library_drops_counts() -> None:
    """C asks whether there is an attribute, and forgets whatever was raised, as while NumPy imports a part of it."""

    class Lazy:
        def __getattr__(self, name: str) -> None:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interruptions_kept():
        assert not ctypes.pythonapi.PyObject_HasAttrString(ctypes.py_object(Lazy()), b"polynomial")
        threading.Event().wait()
    assert signal.getsignal(signal.SIGINT) is before


def test_what_a_library_makes_of_an_interruption_is_one() -> None:
    """Pydantic makes of it an error in a schema, in whose text it is all that is left of it."""
    with pytest.raises(KeyboardInterrupt), interruptions_kept():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            lost = ValueError(str(error))
        raise lost


def test_an_interruption_waits_until_a_compiled_module_is_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Matplotlib's and Numba's, cut in two, made of it an `ImportError`, and an abort at the interpreter's exit."""
    done = []

    def initialise(module: object) -> None:
        signal.raise_signal(signal.SIGINT)
        done.append("whole")

    monkeypatch.setattr(_imp, "exec_dynamic", initialise)
    with pytest.raises(KeyboardInterrupt), interruptions_kept():
        ExtensionFileLoader("compiled", "compiled.so").exec_module(ModuleType("compiled"))
        threading.Event().wait()
    assert done == ["whole"]


def test_an_interruption_that_counts_is_raised_once() -> None:
    raised = []
    with pytest.raises(KeyboardInterrupt), interruptions_kept():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            while any(isinstance(thread, threading.Timer) for thread in threading.enumerate()):
                raised.append("no other")
    assert raised


@pytest.mark.parametrize("kind", [SystemError, RuntimeError])
def test_an_interrupted_kernel_is_an_interruption(kind: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba and Dr.Jit raise errors of their own where Ctrl-C meets them."""

    def interrupted() -> None:
        raise kind("encountered an exception (see above)") from KeyboardInterrupt()

    monkeypatch.setattr(cli, "app", interrupted)
    ended = xfreqbench("scenes")  # which would end the tests, if it were not for `os._exit` in its place
    assert ended.code == 130
    assert ended.stderr == "\nxfreqbench: interrupted; the same command continues where it stopped.\n"


ENDS_AT_ONCE = """
import atexit, os, sys, threading
from xfreqbench.cli import main as cli
atexit.register(print, "what libraries do at an ordinary exit")
threading.Thread(target=threading.Event().wait).start()  # one that traces, and may not be waited for

def interrupted():
    print("so far")
    raise KeyboardInterrupt

cli.app, sys.argv = interrupted, ["xfreqbench", "scenes"]
cli.main()
"""


def test_an_interrupted_command_ends_without_the_interpreters_exit() -> None:
    """There, LLVM and HDF5 free what threads are still using, and crash."""
    ended = subprocess.run([sys.executable, "-c", ENDS_AT_ONCE], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout) == (130, "so far\n")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError("Unable to allocate 8 GiB for an array"), "Unable to allocate 8 GiB for an array"),
        (MemoryError(), "MemoryError"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "[Errno 12] Cannot allocate memory"),
        (RuntimeError("can't start new thread"), "can't start new thread"),
    ],
)
def test_where_memory_runs_out_a_line_says_so(error: Exception, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> None:
        raise error

    monkeypatch.setattr(cli, "app", run)
    ended = xfreqbench("scenes")
    assert ended.code == 1
    assert ended.stderr.startswith(f"xfreqbench: memory ran out: {said}. ")
    assert re.search(r" [\d,]+ MiB are left. Close other programs.*fewer workers", ended.stderr)
    assert ended.stderr.count("\n") == 1


def test_where_hardly_any_memory_is_left_every_error_is_of_that(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> None:
        monkeypatch.setattr(machine, "available_memory_mib", lambda processes=1: 1)
        raise RuntimeError("dict.__setitem__ failed unexpectedly")  # as LLVM's binding says

    monkeypatch.setattr(cli, "app", run)
    ended = xfreqbench("scenes")
    assert ended.code == 1
    assert ended.stderr.startswith("xfreqbench: memory ran out: dict.__setitem__ failed unexpectedly. 1 MiB are left.")


def test_what_needs_more_memory_than_there_is_is_refused_before_it_starts(tmp_path: Path) -> None:
    """With 150 MB of data, OpenBLAS waited for ever for its memory where SciPy was imported."""
    limit = 150 << 20

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))

    command = [Path(sys.executable).with_name("xfreqbench"), "info", "scenes/office.h5"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, preexec_fn=bounded)
    assert ended.returncode == 1
    assert re.match(r"xfreqbench: This command needs at least 200 MiB of memory. 1\d\d MiB are left. ", ended.stderr)


REFUSE_ALL = f"""
import json, sys
from contextlib import redirect_stderr
from io import StringIO
from xfreqbench.cli.main import main
for words, expected in json.loads(sys.argv[1]):
    sys.argv[1:] = words
    with redirect_stderr(StringIO()) as said:
        try:
            main()
        except SystemExit as end:
            assert end.code == 2, (words, said.getvalue())
    assert expected in said.getvalue(), (words, said.getvalue())
    loaded = {HEAVY - {"numpy", "h5py", "scipy"} | {"trimesh"}} & set(sys.modules)
    assert not loaded, (words, loaded)
"""


def test_a_mistake_is_found_before_heavy_libraries_are_imported(dataset: PasDataset, tmp_path: Path) -> None:
    """They take seconds; the data set has no 5 GHz."""
    data, results, output = str(dataset.path), str(tmp_path / "results"), str(tmp_path / "output")
    run = ["run", "--results", results, "--data"]
    refused = [
        ([*run, data, "--method", "nosuch"], "no method 'nosuch'"),
        ([*run, data, "--method", "nosuch", "--set", "width=1"], "no method 'nosuch'"),
        ([*run, data, "--method", "xfreq-gs", "--budget", "3x"], "'3x'"),
        ([*run, data, "--method", "xfreq-gs", "--executor", "nosuch"], "'nosuch'"),
        ([*run, data, "--method", "xfreq-gs", "--seeds", "x"], "'x'"),
        ([*run, data, "--method", "xfreq-gs", "--protocol", "nosuch"], "no protocol 'nosuch'"),
        ([*run, data, "--method", "xfreq-gs", "--targets", "5"], "5 GHz"),
        ([*run, "nofile", "--method", "xfreq-gs"], "no file nofile"),
        (["generate", "nosuch", "-o", output], "no scene 'nosuch'"),
        (["generate", "office", "--freqs", "2,x", "-o", output], "'2,x'"),
        (["generate", "office", "--interactions", "nosuch", "-o", output], "no interaction 'nosuch'"),
        (["generate", "office", "--executor", "nosuch", "-o", output], "'nosuch'"),
        (["benchmark", "--preset", "nosuch"], "no preset 'nosuch'"),
        (["check-method", "nosuch"], "no method 'nosuch'"),
        (["view", "nosuch", "-o", output], "no scene 'nosuch'"),
        (["info", "nofile"], "no file nofile"),
    ]
    subprocess.run([sys.executable, "-c", REFUSE_ALL, json.dumps(refused)], check=True, cwd=tmp_path)


@pytest.mark.slow
def test_where_docstrings_are_left_out_it_says_so() -> None:
    command = [sys.executable, "-B", "-OO", "-m", "xfreqbench.cli"]
    for words in (["methods", "nearest"], ["--help"]):
        done = subprocess.run([*command, *words], capture_output=True, text=True, check=True)
        assert "PYTHONOPTIMIZE=2 (python -OO) leaves out" in done.stdout


def test_no_name_steers_the_terminal_or_turns_letters_round(tmp_path: Path) -> None:
    name = "a\x1b]0;title\x07\x9b31m\u202eb"
    folder = store(tmp_path / "results", *make_records(), make_record(name))
    for words in (("compare", f"{folder}/{name}", f"{folder}/nearest"), ("compare", folder, folder)):
        outcome = xfreqbench(*words)
        said = outcome.stdout + outcome.stderr
        assert r"a\x1b]0;title\x07\x9b31m\u202eb" in said
        assert not set("\x1b\x07\x9b\u202e") & set(said)
