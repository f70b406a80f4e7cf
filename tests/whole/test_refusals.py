"""What once ended in a traceback, in warnings or in a lost file, and is refused in words."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
from datetime import datetime, tzinfo
from pathlib import Path

import numpy as np
import pytest

from tests.exchange.test_deepmimo_import import scenario_by_hand
from tests.support.forked import command_line
from tests.support.fuzzing.common import check_clean, check_refusal, refusal, untouched, xfreqbench
from tests.support.fuzzing.hdf5 import Spoil, as_other_thing, sound_dataset, sound_records, spoilt_file
from tests.support.fuzzing.png import write_png_folder
from tests.support.fuzzing.scenes import ASCII_PLY, EMPTY_SCENE, REFERRING_SCENE, SMALL_SCENE, XML, toml_file
from tests.support.stored_records import make_record
from xfreqbench.cli.options import parse_targets_ghz
from xfreqbench.data.dataset import open_dataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.records import append, read, utc_now
from xfreqbench.scene.model import MAX_CANDIDATES, parse_scene
from xfreqbench.system import machine


def test_every_file_a_command_could_write_over_is_refused(tmp_path: Path) -> None:
    (tmp_path / "records.jsonl").write_bytes(sound_records())
    (tmp_path / "data.h5").write_bytes(sound_dataset())
    mine = ("mine.png", "mine.html", "mine.md", "mine.h5", "notes", "table.csv", "rows.parquet")
    for name in (*mine, "pages/office.md", "seen/index.html"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"mine")  # half a line
    commands: list[list[str | Path]] = [
        ["plot", tmp_path / "data.h5", "-o", tmp_path / "mine.png"],
        ["report", tmp_path, "-q", "-o", tmp_path / "mine.md"],
        ["report", tmp_path, "-q", "-o", tmp_path / "new" / "r.md", "--html", tmp_path / "mine.html"],
        ["report", tmp_path, "-q", "-o", tmp_path / "new" / "r.md", "--html", tmp_path / "table.html"],
        ["report", tmp_path, "-q", "-o", tmp_path / "new" / "r.md", "--html", tmp_path / "rows.html"],
        ["report", tmp_path, "-q", "-o", tmp_path / "new" / "r.md", "--maps", tmp_path / "notes"],
        ["report", tmp_path, "-q", "--details", tmp_path / "pages"],
        ["report", tmp_path / "nowhere"],
        ["view", tmp_path / "data.h5", "-o", tmp_path / "seen"],
        ["card", tmp_path / "data.h5", "--license", "CC0-1.0", "-o", tmp_path / "seen"],
        ["export", tmp_path / "data.h5", "--convention", "xfreq-gs", "--set", "plane=xy", "-o", tmp_path / "seen"],
        ["new-method", "mine", "-o", tmp_path / "seen"],
        ["bench", "savings", "-o", tmp_path / "notes"],
        ["bench", "stress", "--only", "no such case", "-o", tmp_path / "notes"],
        ["split", "--data", tmp_path / "data.h5", "--targets", "10", "-o", tmp_path / "mine.h5", "-q"],
        ["generate", "empty", "-q", "-o", tmp_path / "mine.h5"],
    ]
    for words in commands:
        with untouched(tmp_path, tmp_path / "new"):
            outcome = xfreqbench(*words)
        assert outcome.code == 2, (words, outcome)
        check_clean(outcome, str(tmp_path), "no such case")


SCENE, POSITIONS = "generate odd.toml -o x.h5", "generate empty --tx-positions tx.csv.gz -o x.h5"
IMPORT, REPORT = "import maps -o x.h5", "report . -o report.md"
FAR = {"receiver": {"position_m": [1e300, 0.0, 0.0]}}
FLAT = {"receiver": {"position_m": [0.0, 0.0, 0.0], "boresight": [0.0, 0.0, 1e-300]}}
MESH = {"odd.toml": REFERRING_SCENE, "room.xml": XML}
TOO_LARGE = b"g:\n  position: [2,1,0]\n  orientation: [1e155, 0, 0, 1]\n"
KEYS = [(b'"24250000000":', b'":4250000000":'), (b'"power_error":', b'"power_error ":')]


@pytest.mark.parametrize(
    ("words", "files", "message"),
    [
        (SCENE, {"odd.toml": "name = " + "[" * 5000}, "nested too deeply"),
        (SCENE, {"odd.toml": "name = " + "1" * 5000}, "not TOML"),
        (SCENE, {"odd.toml": toml_file(EMPTY_SCENE | FAR)}, "less than or equal to 10000000"),
        (SCENE, {"odd.toml": toml_file(EMPTY_SCENE | FLAT)}, "zero vector"),
        (SCENE, {"odd.toml": toml_file(EMPTY_SCENE | {"scene": "a\0b"})}, "cannot be read"),
        (SCENE, {"odd.toml": toml_file(EMPTY_SCENE | {"scene": "."})}, "Is a directory"),
        (SCENE, {**MESH, "room.xml": XML.replace("utf-8", "no-such")}, "room.xml"),
        *(
            (SCENE, {**MESH, "wall.ply": ASCII_PLY.replace("0 0 0", corner, 1)}, "not finite, or beyond")
            for corner in ("inf 0 0", "nan 0 0", "1e300 0 0", "1e38 1e38 1e38")
        ),
        *(
            (POSITIONS, {"tx.csv.gz": content}, "tx.csv.gz")
            for content in (b"1,1,1e308\n", gzip.compress(b"1,1,1\n", mtime=0)[:-4], b"\xff,1,1\n", b"1,1\n")
        ),
        (IMPORT, {"maps/gateway_info.yml": TOO_LARGE}, "gateway_info.yml"),
        (IMPORT, {"maps/gateway_info.yml": None}, "gateway_info.yml"),
        (IMPORT, {"maps/tx_pos.csv": b"x,y,z\n1e300,2,3\n-1,0,0.5\n"}, "tx_pos.csv"),
        (IMPORT, {"maps/train_index.txt": b"1" * 5000}, "train_index.txt"),
        *(
            (f"{REPORT}{page}", {"records.jsonl": sound_records().replace(*change, 1)}, "records.jsonl")
            for change in KEYS
            for page in ("", " --html page.html")
        ),
    ],
)
def test_files_that_once_ended_in_a_traceback_or_warnings_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, files: dict[str, str | bytes | None], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if "import" in words:
        write_png_folder(Path("maps"))
    for name, content in files.items():
        if content is None:
            Path(name).unlink()
        else:
            Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with untouched(tmp_path):
        outcome = xfreqbench(*words.split(), "-q")
    assert outcome.code == 2
    assert message in outcome.stderr
    check_clean(outcome, "scene", *(Path(name).name for name in files))


def test_a_grid_of_a_billion_transmitters_is_refused_by_its_number_before_it_takes_memory() -> None:
    grid = {**SMALL_SCENE["transmitters"], "step_m": [0.003, 0.003, 0.001]}
    message = refusal(lambda: parse_scene(toml_file({**SMALL_SCENE, "transmitters": grid})))
    assert f"1,003,003,001 positions, and at most {MAX_CANDIDATES:,} are allowed" in str(message)


FAILING = "/proc/self/mem"  # a regular file that can be opened, of which the system says that it cannot be read


@pytest.mark.skipif(not Path(FAILING).is_file(), reason="needs Linux")
@pytest.mark.parametrize(
    ("words", "file"),
    [
        ("info odd.h5", "odd.h5"),
        ("run --data odd.h5 --method nearest --results new", "odd.h5"),
        ("score odd.h5 --data data.h5 --results new", "odd.h5"),
        ("split --data data.h5 --targets 10 -o odd.h5", "odd.h5"),
        ("report .", "records.jsonl"),
        ("info rooms", "rooms/collection.json"),
        (f"{IMPORT} -q", "maps/spectrum/00001.png"),
        ("import city --from deepmimo -o x.h5", "city/power_t001_tx000_r000.npz"),
        ("bench fingerprint ./small.toml -o odd.npz", "odd.npz"),
        (SCENE, "wall.ply"),
    ],
)
def test_a_disk_that_fails_is_not_called_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, file: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_png_folder(Path("maps"))
    scenario_by_hand(Path("city"))
    Path("rooms").mkdir()
    Path("data.h5").write_bytes(sound_dataset())
    for name, text in {**MESH, "small.toml": toml_file(SMALL_SCENE)}.items():
        Path(name).write_text(text, "utf-8")
    Path(file).unlink(missing_ok=True)
    Path(file).symlink_to(FAILING)
    outcome = xfreqbench(*words.split())
    assert outcome.code == 2
    assert outcome.message.endswith(f"{file} cannot be read: Input/output error. Try again later.")


@pytest.mark.parametrize("words", [["info"], ["generate", "empty", "-o"], ["report"], ["import", "-o", "x"]])
def test_a_path_that_the_system_does_not_take_is_refused(words: list[str]) -> None:
    outcome = xfreqbench(*words, "x" * 400)
    assert outcome.code == 2
    check_clean(outcome, "File name too long")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda file: file.attrs.__setitem__("settings_json", "[]"), "'settings_json'"),
        (lambda file: file.attrs.__setitem__("num_tx", "4"), "the header asks for"),
        (lambda file: file.__delitem__("cfr"), "no dataset 'cfr'"),
        (lambda file: file["tx_position_m"].__setitem__(0, np.nan), "'tx_position_m' holds numbers that are"),
        (lambda file: file["tx_position_m"].__setitem__(0, 1e308), "positions beyond 1e+07 m"),
        (lambda file: file["carrier_hz"].__setitem__(..., 0.0), "carriers ascend"),
        (lambda file: file.attrs.__setitem__("scene_name", b"\xff\xfe"), "surrogates not allowed"),
        (as_other_thing("peak_power", "endless"), "more than the file can hold"),
    ],
)
def test_what_is_wrong_within_a_data_set_is_named_before_it_is_used(tmp_path: Path, spoil: Spoil, message: str) -> None:
    path = tmp_path / "data.h5"
    for is_sealed_again, told in ((True, message), (False, "another program opened it to write")):
        path.write_bytes(spoilt_file(sound_dataset(), spoil, is_sealed_again))
        assert told in str(refusal(lambda: open_dataset(path)))


def test_a_text_that_ends_in_half_a_line_is_no_file_of_records(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_bytes(b"half a line")
    for call in (lambda: read(notes), lambda: append(notes, make_record())):
        check_refusal(refusal(call), str(notes))
        assert notes.read_bytes() == b"half a line"


def test_a_folder_that_is_no_number_is_no_checkpoint(tmp_path: Path) -> None:
    for name in ("²", "٣", "notes"):
        (tmp_path / name).mkdir()
    assert CheckpointFolder(tmp_path, "a").read() is None


def test_numbers_of_thousands_of_digits_are_refused(tmp_path: Path) -> None:
    data = tmp_path / "data.h5"
    data.write_bytes(sound_dataset())
    for option in ("--seed=", "--budget=steps", "--budget=s", "--executor="):
        name, _, unit = option.partition("=")
        common = ["run", "--data", data, "--results", tmp_path / "new", "--targets", "10", "--method", "nearest"]
        outcome = xfreqbench(*common, f"{name}={'9' * 5000}{unit}")
        assert outcome.code == 2
        check_clean(outcome, name.removeprefix("--"))
    check_clean(xfreqbench("bench", "render", "--gaussians", "9" * 5000), "--gaussians")


def test_a_clock_past_the_year_9999_is_said_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class PastIt(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> PastIt:
            raise ValueError("year 10000 is out of range")

    monkeypatch.setattr(machine, "datetime", PastIt)
    with untouched(tmp_path):
        outcome = xfreqbench("generate", "empty", "--freqs", "1", "-o", tmp_path / "x.h5", "-q")
    assert outcome.code == 2
    check_clean(outcome, "clock of this machine is past the year 9999")
    with pytest.raises(XFreqBenchError, match="Set it right"):
        utc_now()


def test_an_empty_list_of_targets_is_not_the_default() -> None:
    check_refusal(refusal(lambda: parse_targets_ghz("")), "GHz")
    assert parse_targets_ghz(None) is None


def test_a_real_process_says_one_line_and_leaves_with_2(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "xfreqbench.cli", "info"]
    done = subprocess.run([*map(os.fsencode, words), b"\xff.h5"], capture_output=True, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(b"xfreqbench: ")
    assert done.stderr.count(b"\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_reader_that_stops_reading_gets_no_traceback() -> None:
    words = [sys.executable, "-m", "xfreqbench.cli", "scenes", "--schema"]
    for unbuffered in ("", "1"):
        environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)
        assert process.stdout
        process.stdout.close()
        assert process.stderr
        assert process.stderr.read() == b""
        process.stderr.close()
        assert process.wait() == 1


def test_a_name_that_is_no_text_is_printed(tmp_path: Path) -> None:
    data = os.fsdecode(bytes(tmp_path) + b"/\xff.h5")
    Path(data).write_bytes(sound_dataset())
    done = subprocess.run([command_line(), "info", data], capture_output=True)
    assert done.returncode == 0, done.stderr
    assert b"every hash holds" in done.stdout
