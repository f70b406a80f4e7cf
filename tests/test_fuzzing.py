"""Thousands of inputs that nobody should give: none ends in a traceback, none costs a file that was there."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import json
import lzma
import re
from pathlib import Path
from typing import Any

import pytest
from fuzzed_inputs import (
    ASCII_PLY,
    EMPTY_SCENE,
    GENERATE_OPTIONS,
    PNG_FOLDER,
    REFERRING_SCENE,
    RUN_OPTIONS,
    SMALL_SCENE,
    XML,
    Spoil,
    binary_ply,
    edited,
    option_texts,
    png,
    png_folders,
    sound_dataset,
    sound_records,
    spoilt_attributes,
    spoilt_dataset,
    spoilt_predictions,
    spoilt_tables,
    toml_file,
)
from fuzzing import (
    ODD_NUMBERS,
    ODD_WORDS,
    WORDS,
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

from xfreqbench import metrics
from xfreqbench.checkpoints import CheckpointFolder

NUM_INPUTS = {
    "random scene text": 100,
    "a small scene with one part spoilt": 400,
    "a shipped scene with one edit": 150,
    "a Mitsuba XML with one edit": 150,
    "the place of a Mitsuba XML": 60,
    "a PLY file with one edit": 150,
    "positions of transmitters": 200,
    "option texts of generate": 250,
    "bytes of a data set": 150,
    "header of a data set": 250,
    "tables of a data set": 250,
    "bytes of records": 120,
    "a record with one part spoilt": 100,
    "a checkpoint with one part spoilt": 100,
    "option texts of run": 60,
    "a folder of PNG maps": 120,
    "predictions made elsewhere": 80,
    "option texts of split": 40,
}


SCENES = Path(__file__).parents[1] / "scenes"


def generates_nothing(scene: str, *options: str) -> None:
    """A scene's text ends in a refusal of the scene, or in one of the output that is there already."""
    with sentinel_folder() as folder:
        path = folder / "odd.toml"
        path.write_bytes(scene.encode("utf-8", "surrogateescape"))
        refused(folder, "generate", path, "-o", folder / "taken.h5", "--freqs", "1,10", "-q", *options)


def test_no_text_as_a_scene_ends_in_a_traceback() -> None:
    texts = st.text(max_size=60) | st.tuples(
        st.sampled_from(["name", "[receiver]\nposition_m", "[[surface]]\nname", "scene"]),
        st.sampled_from(
            [
                "1" * 5000,
                "[" * 3000,
                "[" * 3000 + "]" * 3000,
                "{a=" * 3000,
                "1979-02-30",
                '"\\ud800"',
                '"\\u0000"',
                '"""',
                "0x" + "f" * 6000,
            ]
        )
        | ODD_NUMBERS,
    ).map(" = ".join)
    fuzz(NUM_INPUTS["random scene text"], texts, generates_nothing)


def test_no_spoilt_part_of_a_scene_ends_in_a_traceback() -> None:
    scenes = spoilt_json(SMALL_SCENE).map(toml_file)
    fuzz(NUM_INPUTS["a small scene with one part spoilt"], scenes, generates_nothing)


def test_no_edit_of_a_shipped_scene_ends_in_a_traceback() -> None:
    texts = st.sampled_from([path.read_text() for path in sorted(SCENES.glob("*.toml"))])
    fuzz(NUM_INPUTS["a shipped scene with one edit"], texts.flatmap(edited), generates_nothing)


def refused_room(xml: bytes, ply: bytes | None, scene: str = REFERRING_SCENE) -> None:
    with sentinel_folder() as folder:
        (folder / "odd.toml").write_text(scene)
        (folder / "room.xml").write_bytes(xml)
        if ply is not None:
            (folder / "wall.ply").write_bytes(ply)
        refused(folder, "generate", folder / "odd.toml", "-o", folder / "taken.h5", "--freqs", "1,10", "-q")


def test_no_mitsuba_scene_ends_in_a_traceback() -> None:
    encodings = st.sampled_from(["latin-1", "utf-16", "utf-7", "cp037", "no-such", "\0", ""])
    replaced = st.sampled_from(
        [".", "/", "wall.obj", "wall.glb", "wall.stl", "no/such.ply", "wall.ply/x", "\x01"]
    )
    parts = re.findall(r'"[^"]*"', XML)
    strange = (
        encodings.map(lambda encoding: XML.replace("utf-8", encoding).encode())
        | replaced.map(lambda name: XML.replace("wall.ply", name).encode())
        | st.tuples(st.sampled_from(parts), WORDS | ODD_NUMBERS | ODD_WORDS).map(
            lambda change: XML.replace(change[0], f'"{change[1]}"').encode("utf-8", "replace")
        )
        | st.sampled_from([XML.replace("<string", "<b><string"), "<scene/>", "<a>" * 5000, XML + XML]).map(
            str.encode
        )
        | edited(XML).map(lambda text: text.encode("utf-8", "surrogateescape"))
    )
    fuzz(
        NUM_INPUTS["a Mitsuba XML with one edit"], strange, lambda xml: refused_room(xml, ASCII_PLY.encode())
    )


def test_no_place_of_a_mitsuba_scene_ends_in_a_traceback() -> None:
    places = WORDS | ODD_WORDS | st.sampled_from([".", "\0", "room.xml/x", "odd.toml", "wall.ply", "~", "\n"])
    scenes = places.map(lambda place: toml_file({**EMPTY_SCENE, "scene": place}))
    fuzz(
        NUM_INPUTS["the place of a Mitsuba XML"],
        scenes,
        lambda scene: refused_room(XML.encode(), ASCII_PLY.encode(), scene),
    )


def test_no_ply_file_ends_in_a_traceback() -> None:
    headers = st.tuples(
        st.sampled_from(["vertex 4", "face 2", "float x", "uchar int vertex_indices", "ascii 1.0"]),
        st.sampled_from(
            [
                "vertex 999999999999",
                "face 999999999",
                "face 0",
                "vertex 0",
                "vertex -1",
                "float",
                "list",
                "binary_little_endian 1.0",
                "double q",
                "vertex 1e9",
            ]
        ),
    ).map(lambda change: ASCII_PLY.replace(*change).encode())
    texts = edited(ASCII_PLY).map(lambda text: text.encode("utf-8", "surrogateescape"))
    files = st.none() | headers | texts | texts | cut_or_flipped(binary_ply()) | st.binary(max_size=50)
    fuzz(NUM_INPUTS["a PLY file with one edit"], files, lambda ply: refused_room(XML.encode(), ply))


def positions_refused(content: bytes, name: str = "tx.csv") -> None:
    with sentinel_folder() as folder:
        (folder / "small.toml").write_text(toml_file(SMALL_SCENE))
        (folder / name).write_bytes(content)
        words = ["generate", folder / "small.toml", "--tx-positions", folder / name, "-q", "--freqs", "1,10"]
        refused(folder, *words, "-o", folder / "taken.h5")


def test_no_file_of_positions_ends_in_a_traceback() -> None:
    numbers = st.lists(
        st.lists(ODD_NUMBERS | st.floats().map(str) | WORDS, max_size=4).map(",".join), max_size=4
    )
    texts = (
        numbers.map("\n".join).map(str.encode)
        | st.binary(max_size=60)
        | cut_or_flipped(b"1.0,1.0,1.0\n0.5,0.5,1.5\n")
    )
    names = st.sampled_from(["tx.csv", "tx.csv", "tx.csv.gz", "tx.bz2", "tx.xz", "tx.npy"])
    packed = st.tuples(names, texts).flatmap(
        lambda file: st.sampled_from(
            [
                file[1],
                gzip.compress(file[1], mtime=0)[:-4],
                bz2.compress(file[1])[:-4],
                lzma.compress(file[1])[:-4],
            ]
        ).map(lambda content: (content, file[0]))
    )
    fuzz(NUM_INPUTS["positions of transmitters"], packed, lambda file: positions_refused(*file))


def options_refused(options: dict[str, str]) -> None:
    """`taken.h5` is asked for unless an option says otherwise, so that nothing is ever traced."""
    with sentinel_folder() as folder, contextlib.chdir(folder):
        (folder / "small.toml").write_text(toml_file(SMALL_SCENE))
        given = {"--output": "taken.h5", "--freqs": "1,10", **options}
        words = [f"{name}={text}" for name, text in given.items()]
        refused(folder, "generate", "small.toml", "-q", *words)


def test_no_option_text_of_generate_ends_in_a_traceback() -> None:
    option = st.sampled_from(sorted(GENERATE_OPTIONS)).flatmap(
        lambda name: st.tuples(
            st.just(name),
            st.sampled_from(GENERATE_OPTIONS[name])
            | (WORDS | ODD_NUMBERS if name != "--output" else st.nothing()),
        )
    )
    options = st.lists(option, min_size=1, max_size=3).map(dict)
    fuzz(NUM_INPUTS["option texts of generate"], options, options_refused)


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
