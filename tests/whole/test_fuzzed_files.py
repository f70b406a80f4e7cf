"""Options that nobody should give: none ends in a traceback or costs a file."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import strategies as st

from tests.support.fuzzing.common import ODD_NUMBERS, WORDS, check_clean, fuzz, sentinel_folder, untouched, xfreqbench
from tests.support.fuzzing.hdf5 import sound_dataset
from tests.support.fuzzing.options import GENERATE_OPTIONS, IMPORT_OPTIONS, RUN_OPTIONS, option_texts
from tests.support.fuzzing.png import write_png_folder
from tests.support.fuzzing.scenes import SMALL_SCENE, toml_file

NO_EXECUTOR = {name: texts for name, texts in RUN_OPTIONS.items() if name != "--executor"}
SPLIT_OPTIONS = {name: RUN_OPTIONS[name] for name in ("--data", "--protocol", "--targets", "--on")}
COMMANDS = {  # `taken.h5` is asked for, so that nothing is ever traced; a run is small where nothing is wrong
    "generate small.toml": (
        {"--output": "taken.h5", "--freqs": "1,10"},
        option_texts(GENERATE_OPTIONS, WORDS | ODD_NUMBERS),
    ),
    "run": (
        {"--data": "data.h5", "--results": "new", "--method": "nearest", "--targets": "10", "--budget": "1s"},
        option_texts(NO_EXECUTOR, st.nothing())
        | st.sampled_from(RUN_OPTIONS["--executor"]).map(lambda text: {"--executor": text, "--method": "nerf"}),
    ),
    "split": (
        {"--data": "data.h5", "--targets": "10", "--output": "taken.h5"},
        option_texts(SPLIT_OPTIONS, st.nothing()),
    ),
    "import maps": ({"--output": "taken.h5"}, option_texts(IMPORT_OPTIONS, WORDS)),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_no_text_of_an_option_ends_in_a_traceback(command: str) -> None:
    given, texts = COMMANDS[command]

    def check(options: dict[str, str]) -> None:
        with sentinel_folder() as folder, contextlib.chdir(folder):
            Path("small.toml").write_text(toml_file(SMALL_SCENE), "utf-8")
            Path("data.h5").write_bytes(sound_dataset())
            write_png_folder(Path("maps"))
            with untouched(folder, folder / "new"):
                outcome = xfreqbench(
                    *command.split(), *(f"{name}={text}" for name, text in (given | options).items()), "-q"
                )
        check_clean(outcome)

    fuzz(80 if "generate" in command else 40, texts, check)
