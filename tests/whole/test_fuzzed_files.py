"""Options that nobody should give: none ends in a traceback or costs a file."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import strategies as st

from tests.support.fuzzing.common import ODD_NUMBERS, WORDS, check_clean, fuzz, sentinel_folder, untouched, xfreqbench
from tests.support.fuzzing.hdf5 import sound_dataset
from tests.support.fuzzing.png import write_png_folder
from tests.support.fuzzing.scenes import SMALL_SCENE, toml_file

GENERATE_OPTIONS = {
    "--freqs": [
        *(",", "1,1", "1,,2", "paper", "1e300", "1e-300", "1e290", "0.0001", "450", "1_0", "-5", "nan", "2.4GHz"),
        *("", " paper", "1" * 5000, "1," * 3000 + "1"),
    ],
    "--tx": ["0", "-1", "9" * 400, "1" * 5000, "1.5", "1e3", "٣", ""],
    "--tx-positions": [".", "/no/such", "x" * 400, "/proc/self/mem", ""],
    "--solver": ["Image", "", "auto "],
    "--interactions": ["", ",", "specular,specular", "all", "diffuse", "specular;refraction"],
    "--rays": ["0", "-1", "9" * 400, "1e6", ""],
    "--max-depth": ["-1", "9" * 400, "1.0", ""],
    "--seed": ["-1", "9" * 400, "1" * 5000, "1.0", ""],
    "--pas-kind": ["", "Power", "phase"],
    "--materials": ["", "ignore", "extrapolate"],
    "--maps": ["", "maybe"],
    "--output": ["", ".", "/", "x" * 400, "taken.h5/x.h5", "taken.h5", "/proc/x.h5", "notes.txt"],
    "--no-such": [""],
}
RUN_OPTIONS = {
    "--data": ["", ".", "x" * 400, "taken.h5", "/etc/passwd", "/root/../no/such", "notes.txt/x"],
    "--results": ["notes.txt", "x" * 400, "notes.txt/x", "/proc/no"],
    "--method": ["", ",", "nearest,", "nerf", "os:path", "os:", ":", "a.b:c", "..:x", "x" * 400, "json:dumps"],
    "--protocol": ["", "Lofo", "sparse", "all"],
    "--on": ["", "tests", "Validation", "test,validation"],
    "--targets": ["", ",", "all,1", "1e300", "nan", "3", "1,1", "-1"],
    "--seed": ["", ",", "-1", "0,,1", "1.5", "9" * 5000, "9" * 40, "²", "٣", "1e3"],
    "--budget": ["", "0s", "5", "-1s", "1e3s", "9" * 400 + "s", "9" * 5000 + "steps", "9" * 400 + "steps", "٣s", "5 m"],
    "--device": ["", "gpu", "tpu"],
    "--set": [
        *("=", "x", "x=", "hidden=128", "num_nearest", "num_nearest=", "num_nearest=nan", "=1", "num_nearest={}"),
        *("", "num_nearest=-1", "num_nearest=" + "[" * 5000, "num_nearest=1" + "0" * 5000, "num_nearest=0"),
    ],
    "--executor": ["", "0", "-1", "dask://", "dask://x:1:2", "dask://localhost", "x", "9" * 5000, "http://x"],
}
IMPORT_OPTIONS = {
    "--convention": ["mine", ""],
    "--set": ["plane=zz", "x", "rows=", "=1", ""],
    "--freq": ["nan", "-1", "1e300", "x", "5", ""],
}


def option_texts(options: dict[str, list[str]], free: st.SearchStrategy[str]) -> st.SearchStrategy[dict[str, str]]:
    """One to three options with a text each, which is a `free` one now and then, but for the output."""
    option = st.sampled_from(sorted(options)).flatmap(
        lambda name: st.tuples(
            st.just(name), st.sampled_from(options[name]) | (free if name != "--output" else st.nothing())
        )
    )
    return st.lists(option, min_size=1, max_size=3).map(dict)


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
