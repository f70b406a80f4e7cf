"""Thousands of spoilt files and options that nobody should give: none ends in a traceback or costs a file."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest
from fuzzed_hdf5 import (
    Spoil,
    sound_dataset,
    sound_records,
    spoilt_attributes,
    spoilt_dataset,
    spoilt_predictions,
    spoilt_tables,
)
from fuzzed_options import RUN_OPTIONS, option_texts
from fuzzed_png import PNG_FOLDER, png, png_folders
from fuzzing import (
    NUM_INPUTS,
    check_clean,
    check_refusal,
    cut_or_flipped,
    fuzz,
    refusal,
    refused,
    sentinel_folder,
    spoilt_json,
    untouched,
    xfreqbench,
)
from hypothesis import strategies as st

from xfreqbench.maps import metrics
from xfreqbench.runs.checkpoints import CheckpointFolder


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Intervals take most of a run's scoring, and nothing here asks for them."""
    monkeypatch.setattr(metrics, "NUM_RESAMPLES", 10)


def read_all_ways(content: bytes, command: str) -> None:
    with sentinel_folder() as folder:
        path = folder / "data.h5"
        path.write_bytes(content)
        words: dict[str, list[str | Path]] = {
            "info": ["info", path],
            "plot": ["plot", path, "-o", folder / "new.png", "--tx", "99"],
            "run": [
                "run",
                "--data",
                path,
                "--results",
                folder / "new",
                "--method",
                "nearest",
                "--protocol",
                "held-out-tx",
                "-q",
            ],
        }
        with untouched(folder, folder / "new"):
            outcome = xfreqbench(*words[command])
        check_clean(outcome, str(path), "held-out-tx")


COMMANDS = st.sampled_from(["info", "info", "plot", "run"])


def test_no_bytes_of_a_data_set_end_in_a_traceback() -> None:
    content = sound_dataset()
    header = cut_or_flipped(content[:6000]).map(lambda head: head + content[6000:])
    files = header | header | cut_or_flipped(content) | cut_or_flipped(content) | st.binary(max_size=100)
    check = st.tuples(files, COMMANDS)
    fuzz(NUM_INPUTS["bytes of a data set"], check, lambda case: read_all_ways(*case))


def read_spoilt(case: tuple[Spoil, bool, str]) -> None:
    spoil, is_sealed_again, command = case
    read_all_ways(spoilt_dataset(spoil, is_sealed_again), command)


def test_no_header_of_a_data_set_ends_in_a_traceback() -> None:
    cases = st.tuples(spoilt_attributes(), st.booleans(), COMMANDS)
    fuzz(NUM_INPUTS["header of a data set"], cases, read_spoilt)


def test_no_table_of_a_data_set_ends_in_a_traceback() -> None:
    fuzz(NUM_INPUTS["tables of a data set"], st.tuples(spoilt_tables(), st.booleans(), COMMANDS), read_spoilt)


def reports(content: bytes) -> None:
    """Records end in a report, or in a refusal; what they are read from stays."""
    with sentinel_folder() as folder:
        (folder / "records.jsonl").write_bytes(content)
        with untouched(folder, folder / "new"):
            outcome = xfreqbench("report", folder, "-o", folder / "new" / "report.md", "-q")
        check_clean(outcome, str(folder))


def test_no_bytes_of_records_end_in_a_traceback() -> None:
    content = sound_records()
    torn = cut_or_flipped(content).filter(lambda changed: changed != content)
    endings = st.sampled_from([b"{", b"x", b"\xff", b"[" * 5000, b"\n\n", b"{}\n", b"[" * 5000 + b"\n"]).map(
        lambda end: content + end
    )
    fuzz(NUM_INPUTS["bytes of records"], torn | torn | endings | st.binary(max_size=80), reports)


def test_no_record_ends_in_a_traceback() -> None:
    whole = [json.loads(line) for line in sound_records().splitlines()]
    lines = spoilt_json(whole[0]).map(
        lambda first: "\n".join(map(json.dumps, [first, *whole[1:], ""])).encode()
    )
    fuzz(NUM_INPUTS["a record with one part spoilt"], lines, reports)


def test_no_checkpoint_ends_in_a_traceback() -> None:
    state: dict[str, Any] = {
        "task_id": "a",
        "step": 3,
        "loss": 0.1,
        "seconds": 2.0,
        "share": 0.5,
        "counts": {"maps": 1.0},
        "curve": [{"step": 1, "seconds": 1.0, "loss": 0.2, "ssim": 0.5}],
        "sha256": {},
    }
    whole = json.dumps(state).encode()
    files = spoilt_json(state).map(json.dumps).map(str.encode) | cut_or_flipped(whole) | st.none()
    names = st.sampled_from(["1", "1", "2", "²", "٣", "x", "-1"])

    def resumes(case: tuple[bytes | None, str]) -> None:
        content, name = case
        with sentinel_folder() as folder:
            (folder / "checkpoint" / name / "method").mkdir(parents=True)
            if content is not None:
                (folder / "checkpoint" / name / "checkpoint.json").write_bytes(content)
            with untouched(folder):
                check_refusal(refusal(CheckpointFolder(folder / "checkpoint", "a").read), str(folder))

    fuzz(NUM_INPUTS["a checkpoint with one part spoilt"], st.tuples(files, names), resumes)


def run_refused(options: dict[str, str]) -> None:
    """A run is small where nothing is wrong; its results go where nothing was."""
    with sentinel_folder() as folder, contextlib.chdir(folder):
        Path("data.h5").write_bytes(sound_dataset())
        given = {
            "--data": "data.h5",
            "--results": "new",
            "--method": "nearest",
            "--targets": "10",
            "--budget": "1s",
        }
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


def test_no_predictions_made_elsewhere_end_in_a_traceback() -> None:
    def scored(content: bytes) -> None:
        with sentinel_folder() as folder:
            (folder / "data.h5").write_bytes(sound_dataset())
            (folder / "maps.h5").write_bytes(content)
            with untouched(folder, folder / "new"):
                outcome = xfreqbench(
                    "score",
                    folder / "maps.h5",
                    "--data",
                    folder / "data.h5",
                    "--results",
                    folder / "new",
                    "-q",
                )
            check_clean(outcome, "maps.h5")

    fuzz(NUM_INPUTS["predictions made elsewhere"], spoilt_predictions(), scored)


def test_no_option_text_of_split_ends_in_a_traceback() -> None:
    texts = {name: RUN_OPTIONS[name] for name in ("--data", "--protocol", "--targets")}

    def handed_out(options: dict[str, str]) -> None:
        with sentinel_folder() as folder, contextlib.chdir(folder):
            Path("data.h5").write_bytes(sound_dataset())
            given = {"--data": "data.h5", "--targets": "10", "--output": "taken.h5", **options}
            refused(folder, "split", "-q", *(f"{name}={text}" for name, text in given.items()))

    fuzz(NUM_INPUTS["option texts of split"], option_texts(texts, st.nothing()), handed_out)


def test_thousands_of_inputs_are_tried() -> None:
    assert sum(NUM_INPUTS.values()) >= 2000
