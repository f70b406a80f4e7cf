"""Commands that other packages bring by the entry-point group `xfreqbench.commands`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from cyclopts import App

from tests.support.packages import install
from xfreqbench.cli.plugins import COMMAND_GROUP, add_plugin_commands
from xfreqbench.errors import XFreqBenchError

THEIRS = """
from cyclopts import App

print("imported")
rooms = App(name="count-rooms", help="Count rooms.", group="Results")


@rooms.default
def count(number: int, *, twice: bool = False) -> None:
    print(f"{number * (2 if twice else 1)} rooms")
"""


PLAIN = '''
from __future__ import annotations
from pathlib import Path


def rooms(results: Path, *, output: Path, twice: bool = False, quiet: bool = False) -> None:
    """Count rooms.

    Example: xfreqbench count-rooms results -o rooms.txt

    Parameters
    ----------
    results
        Folder of the rooms.
    output
        File for their number.
    """
    print(repr(results), output, twice, quiet)
'''


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of packages, each with a `.dist-info` as pip writes it, on the path of this process."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "their_rooms", raising=False)
    (tmp_path / "their_rooms.py").write_text(THEIRS)
    return tmp_path


def program(*built_in: str) -> tuple[App, list[str]]:
    """An app with commands of its own and those of plug-ins, and what is said of those that are ignored."""
    app = App(name="xfreqbench", result_action="return_value")
    for name in built_in:
        app.command(App(name=name))
    return app, add_plugin_commands(app)


def xfreqbench(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    call = f"import sys; sys.path.insert(0, {str(folder)!r}); from xfreqbench.cli.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", call, *words], capture_output=True, text=True, timeout=120, check=False
    )


def test_a_package_brings_a_command_which_is_imported_only_when_it_runs_or_help_lists_it(installed: Path) -> None:
    install(installed, "their-rooms", COMMAND_GROUP, **{"count-rooms": "their_rooms:rooms"})
    other = xfreqbench(installed, "scenes")
    assert (other.returncode, other.stderr) == (0, "")
    assert "imported" not in other.stdout
    own = xfreqbench(installed, "count-rooms", "3", "--twice")
    assert (own.returncode, own.stdout, own.stderr) == (0, "imported\n6 rooms\n", "")
    shown = xfreqbench(installed, "--help").stdout
    assert shown.index("Results") < shown.index("Count rooms.") < shown.index("Exchange with others")


def test_a_function_is_a_command_with_the_options_of_its_parameters(installed: Path) -> None:
    install(installed, "their-rooms", COMMAND_GROUP, **{"count-rooms": "their_rooms:rooms"})
    (installed / "their_rooms.py").write_text(PLAIN)
    done = xfreqbench(installed, "count-rooms", "r", "-o", "n.txt", "--twice", "-q")
    assert (done.returncode, done.stdout, done.stderr) == (0, "PosixPath('r') n.txt True True\n", "")
    shown = xfreqbench(installed, "count-rooms", "--help").stdout
    for words in ("Count rooms.", "Folder of the rooms.", "-o PATH", "File for their number.", "Print only errors."):
        assert words in shown
    assert shown.rstrip().endswith("\nExample: xfreqbench count-rooms results -o rooms.txt")
    shown = xfreqbench(installed, "--help").stdout
    assert shown.index("Plug-ins") < shown.index("Count rooms.")
    assert "Example: xfreqbench count-rooms" in xfreqbench(installed, "count-rooms", "r").stderr


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ("import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("raise SystemExit(0)", "SystemExit: 0"),
        ("rooms = 3", "their_rooms:rooms is neither a function nor an App(name='count-rooms') of cyclopts"),
        ("from cyclopts import App\nrooms = App(name='other')", "an App(name='count-rooms') of cyclopts"),
        ("other = 3", "has no attribute 'rooms'"),
    ],
)
def test_a_broken_plugin_says_in_one_line_why_and_breaks_no_other_command(
    code: str, fault: str, installed: Path
) -> None:
    install(installed, "their-rooms", COMMAND_GROUP, **{"count-rooms": "their_rooms:rooms"})
    (installed / "their_rooms.py").write_text(code)
    app, ignored = program("generate")
    with pytest.raises(XFreqBenchError, match=r"^Command 'count-rooms' cannot be loaded: ") as refused:
        app(["count-rooms", "3", "--twice"])
    assert fault in str(refused.value)
    assert "\n" not in str(refused.value)
    assert {"count-rooms", "generate"} <= app.resolved_commands().keys()
    assert ignored == []


def test_two_packages_with_one_command_are_refused(installed: Path) -> None:
    install(installed, "first-rooms", COMMAND_GROUP, **{"count-rooms": "their_rooms:rooms"})
    install(installed, "second-rooms", COMMAND_GROUP, **{"count-rooms": "other_rooms:rooms"})
    app, ignored = program()
    with pytest.raises(XFreqBenchError, match="command 'count-rooms': first-rooms, second-rooms"):
        app(["count-rooms", "3"])
    assert ignored == []


def test_a_plugin_takes_no_name_of_ours(installed: Path) -> None:
    install(installed, "their-rooms", COMMAND_GROUP, **{"run": "their_rooms:rooms", "--help": "their_rooms:rooms"})
    app, ignored = program("run")
    own = app["run"]
    assert [line.partition(" is ignored")[0] for line in ignored] == [
        "The command '--help' of their-rooms",
        "The command 'run' of their-rooms",
    ]
    assert app["run"] is own
    said = xfreqbench(installed, "scenes")
    assert said.returncode == 0
    assert "'run' of their-rooms is ignored" in said.stderr
