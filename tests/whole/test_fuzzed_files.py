"""Options and folders of maps that nobody should give: none ends in a traceback or costs a file."""

from __future__ import annotations

import contextlib
from pathlib import Path

from hypothesis import strategies as st

from tests.support.fuzzing.common import NUM_INPUTS, check_clean, fuzz, refused, sentinel_folder, untouched, xfreqbench
from tests.support.fuzzing.options import RUN_OPTIONS, option_texts
from tests.support.fuzzing.png import PNG_FOLDER, png, png_folders
from tests.support.fuzzing.sound_files import DATA, sound_files


def run_refused(options: dict[str, str]) -> None:
    """A run is small where nothing is wrong; its results go where nothing was."""
    with sentinel_folder() as folder, contextlib.chdir(folder):
        Path("data.h5").write_bytes(sound_files()[DATA])
        given = {"--data": "data.h5", "--results": "new", "--method": "nearest", "--targets": "10", "--budget": "1s"}
        words = [f"{name}={text}" for name, text in (given | options).items()]
        with untouched(folder, folder / "new"):
            outcome = xfreqbench("run", *words, "-q")
        check_clean(outcome)


def test_no_option_text_of_run_ends_in_a_traceback() -> None:
    wrong = {name: texts for name, texts in RUN_OPTIONS.items() if name != "--executor"}
    options = option_texts(wrong, st.nothing()) | st.sampled_from(RUN_OPTIONS["--executor"]).map(
        lambda text: {"--executor": text, "--method": "nerf"}
    )
    fuzz(NUM_INPUTS["option texts of run"], options, run_refused)


def test_no_folder_of_png_maps_ends_in_a_traceback() -> None:
    def imports(case: tuple[dict[str, bytes | None], list[str]]) -> None:
        changed, options = case
        with sentinel_folder() as folder:
            files = {**PNG_FOLDER, "spectrum/00001.png": png(), "spectrum/00002.png": png(), **changed}
            (folder / "maps" / "spectrum").mkdir(parents=True)
            for name, content in files.items():
                if content is not None:
                    (folder / "maps" / name).write_bytes(content)
            refused(folder, "import", folder / "maps", "-o", folder / "taken.h5", "-q", *options)

    fuzz(NUM_INPUTS["a folder of PNG maps"], png_folders(), imports)


def test_no_option_text_of_split_ends_in_a_traceback() -> None:
    texts = {name: RUN_OPTIONS[name] for name in ("--data", "--protocol", "--targets", "--on")}

    def handed_out(options: dict[str, str]) -> None:
        with sentinel_folder() as folder, contextlib.chdir(folder):
            Path("data.h5").write_bytes(sound_files()[DATA])
            given = {"--data": "data.h5", "--targets": "10", "--output": "taken.h5", **options}
            refused(folder, "split", "-q", *(f"{name}={text}" for name, text in given.items()))

    fuzz(NUM_INPUTS["option texts of split"], option_texts(texts, st.nothing()), handed_out)
