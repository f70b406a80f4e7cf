from __future__ import annotations

import os

import pytest

from tests.support.clock import set_clock
from xfreqbench.system import bars as module
from xfreqbench.system.bars import ANNOUNCES, announce_compilation, announcing, open_bars, progress_bars, report


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_INTERACTIVE", "1")


def test_nothing_is_drawn_before_the_first_report(capsys: pytest.CaptureFixture[str], terminal: None) -> None:
    with pytest.raises(ValueError, match="refused"), progress_bars("maps", ["checking"], False):
        raise ValueError("refused")
    assert not capsys.readouterr().err


@pytest.mark.parametrize("is_quiet", [False, True])
def test_a_bar_shows_how_much_is_done_unless_nothing_is_to_be_shown(
    capsys: pytest.CaptureFixture[str], terminal: None, is_quiet: bool
) -> None:
    with progress_bars("maps", ["checking", "scoring"], is_quiet) as (checking, scoring):
        checking(3, 3)
        scoring(1, 4)
    shown = capsys.readouterr().err
    if is_quiet:
        assert not shown
    else:
        assert "3 of 3 maps" in shown and "1 of 4 maps" in shown


def test_work_inside_a_stage_is_shown_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[tuple[int, int, int, str | None]] = []
    monkeypatch.setattr(
        module._Bars,
        "show",
        lambda self, stage, done, total, state, title=None: shown.append((stage, done, total, title)),
    )
    report("shooting rays", 1, 9)  # nobody listens
    with progress_bars("transmitters", ["tracing", "writing"], False) as (tracing, _):
        report("shooting rays", 3, 8)
        tracing(16, 48)
        report("transmitters", 5, 16)
        tracing(48, 48)
        report("transmitters", 1, 4)  # of those that are traced again to prove the file
    assert shown == [(0, 3, 8, "shooting rays"), (0, 16, 48, None), (0, 21, 48, None), (0, 48, 48, None)]


def test_a_file_is_no_place_for_bars_that_are_drawn_over(request: pytest.FixtureRequest) -> None:
    with open_bars(["runs"]) as bars:
        assert not bars.is_drawn
    request.getfixturevalue("terminal")
    with open_bars(["runs"]) as bars:
        assert bars.is_drawn


def test_a_line_in_a_file_says_how_much_is_done_and_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = set_clock(monkeypatch, module)
    with open_bars(["tracing"]) as bars:
        bars.show(0, 2, 12, "2 of 12 rooms")  # 2 were there before
        bars.print_line()
        clock.sleep(30)
        bars.show(0, 5, 12, "5 of 12 rooms")
        bars.print_line()
        bars.show(0, 0, None, "step 1", "fitting")
        clock.sleep(7)
        bars.print_line()
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "tracing: 2 of 12 rooms, 0 s",
        "tracing: 5 of 12 rooms, 30 s, about 70 s left",
        "fitting: step 1, 7 s",
    ]


def test_lines_come_by_themselves_in_a_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "_EVERY_S", 0)
    shown = ""
    with progress_bars("rooms", ["tracing"], False) as (tracing,):
        tracing(1, 3)
        while not shown:
            shown = capsys.readouterr().err
    assert shown.startswith("tracing: 1 of 3 rooms, ")


def test_compilation_is_announced_once_where_progress_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(ANNOUNCES)
    announce_compilation()
    with announcing(False) as is_shown, announcing(True):
        announce_compilation()
    with announcing("auto") as is_watched:
        announce_compilation()
    assert not is_shown and not is_watched and not capsys.readouterr().err  # nobody looks at a file
    with announcing(True):
        announce_compilation()
        assert os.environ[ANNOUNCES] == "0"  # for workers too
        announce_compilation()
    assert capsys.readouterr().err.count("compiling kernels") == 1


def test_compilation_is_announced_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], terminal: None
) -> None:
    monkeypatch.delenv(ANNOUNCES)
    with announcing("auto") as is_watched:
        announce_compilation()
    assert is_watched and "compiling kernels" in capsys.readouterr().err
