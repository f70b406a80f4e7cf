"""Damaged files of every kind, before every command that reads them: none ends in a traceback or costs a file."""

from __future__ import annotations

import functools
import typing
from pathlib import Path

import pytest
from hypothesis import strategies as st

from tests.support.fuzzing.commands import LINES, NOT_GIVEN, check_read, lines
from tests.support.fuzzing.common import fuzz
from tests.support.fuzzing.damages import damages
from tests.whole.test_cli import COMMANDS, command_named
from xfreqbench.cli.main import app

NAMES_OR_PATHS = {"scene", "data_or_scene", "results", "a", "b"}  # of shipped scenes, or of records
NUM_INPUTS = {"maps to show": 12, "stored predictions": 12, "mesh": 10, "PNG folder": 40, "positions": 150}
NUM_INPUTS |= {"measurement": 150, "receiver of a PNG folder": 150, "table of a PNG folder": 100}  # others: 20
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]


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
