"""Damaged files of every kind, before every command that reads them: none ends in a traceback or costs a file."""

from __future__ import annotations

import contextlib
import functools
import typing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cyclopts import App
from hypothesis import strategies as st

from tests.support.fuzzing.commands import LINES, MEASURING, READ_NOTHING, READS, check_read, lines, names
from tests.support.fuzzing.common import NUM_INPUTS, check_refusal, fuzz, refusal, sentinel_folder
from tests.support.fuzzing.damages import damages, torn
from tests.support.fuzzing.readers import READERS, files_of
from tests.support.fuzzing.sound_files import sound_files
from xfreqbench.cli.main import app

NAMES_OR_PATHS = ("scene", "data_or_scene", "results", "a", "b")  # of shipped scenes, or of records
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_thread")]


def paths_taken(commands: App, prefix: str = "") -> dict[str, set[str]]:
    """The parameters of every command that may be paths, by the command's name."""
    found: dict[str, set[str]] = {}
    for name in commands:
        if name.startswith("-"):
            continue
        command = commands[name]
        if command.default_command is None:
            found |= paths_taken(command, f"{name} ")
        else:
            hints = typing.get_type_hints(command.default_command).items()
            found[prefix + name] = {key for key, hint in hints if _may_be_a_path(key, hint)}
    return found


def _may_be_a_path(name: str, hint: object) -> bool:
    return name in NAMES_OR_PATHS or Path in (hint, *typing.get_args(hint))


def test_every_path_that_a_command_takes_is_in_the_table() -> None:
    tabled = {command: set(parameters) for command, parameters in READS.items()}
    assert paths_taken(app) == tabled | {command: set() for command in READ_NOTHING}


def test_every_kind_of_file_has_a_line_for_each_command_that_reads_it() -> None:
    read = {(command, kind) for command, parameters in READS.items() for kinds in parameters.values() for kind in kinds}
    lined = {(command, kind) for kind, commands in LINES.items() for command in commands}
    assert read - MEASURING == lined


@functools.cache
def check_sound(line: str) -> None:
    """A command on sound files alone; the first one compiles and imports."""
    check_read(line, {}, is_bounded=False)


@pytest.mark.parametrize("kind", LINES)
def test_no_damage_ends_in_a_traceback(kind: str) -> None:
    for of_command in LINES[kind].values():
        for line in of_command:
            check_sound(line)
    cases = st.tuples(lines(kind), damages(kind))
    fuzz(NUM_INPUTS[kind], cases, lambda case: check_read(*case))


@pytest.mark.parametrize("kind", READERS)
def test_damaged_bytes_give_the_same_values_or_one_line(kind: str) -> None:
    with sentinel_folder() as folder, contextlib.chdir(folder):
        for path, content in sound_files().items():
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            Path(path).write_bytes(content)
        read = READERS[kind][1]
        sound = read()

        def check(case: tuple[str, bytes]) -> None:
            path, content = case
            Path(path).write_bytes(content)
            found: list[Any] = []
            message = refusal(lambda: found.append(read()), most_s=5)
            Path(path).write_bytes(sound_files()[path])
            if message is None:
                np.testing.assert_equal(found, [sound])
            else:
                check_refusal(message, *names())
                assert "\n" not in message

        cases = st.sampled_from(files_of(kind)).flatmap(
            lambda path: torn(sound_files()[path]).map(lambda content: (path, content))
        )
        fuzz(NUM_INPUTS["damaged bytes"], cases, check)
