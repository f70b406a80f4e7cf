from __future__ import annotations

import pytest

from xfreqbench.system.bars import open_bars, progress_bars


def test_nothing_is_drawn_before_the_first_report(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="refused"), progress_bars("maps", ["checking"], False):
        raise ValueError("refused")
    assert not capsys.readouterr().err


def test_a_bar_shows_how_much_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars("maps", ["checking", "scoring"], False) as (checking, scoring):
        checking(3, 3)
        scoring(1, 4)
    shown = capsys.readouterr().err
    assert "3/3 maps" in shown and "1/4 maps" in shown


def test_who_is_quiet_draws_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars("maps", ["checking", "scoring"], True) as callbacks:
        for callback in callbacks:
            callback(1, 2)
    assert not capsys.readouterr().err


def test_a_file_is_no_place_for_bars_that_are_drawn_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_bars(["runs"]) as bars:
        assert not bars.is_drawn
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_INTERACTIVE", "1")
    with open_bars(["runs"]) as bars:
        assert bars.is_drawn
