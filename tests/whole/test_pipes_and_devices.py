"""What is to be a file and is a pipe or a device is refused at once: reading or writing it might never end."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.support.fuzzing.common import check_clean, xfreqbench
from tests.support.fuzzing.hdf5 import sound_dataset, sound_records
from tests.support.fuzzing.png import PNG_FOLDER, write_png_folder
from tests.support.fuzzing.scenes import ASCII_PLY, REFERRING_SCENE, XML

IMPORT = "import maps -o x.h5 -q"
COMMANDS = [
    ("room.toml", "generate room.toml -o x.h5"),
    ("room.xml", "generate room.toml -o x.h5"),
    ("wall.ply", "generate room.toml -o x.h5"),
    ("tx.csv", "generate empty --tx-positions tx.csv -o x.h5"),
    ("data.h5", "info data.h5"),
    ("data.h5", "view data.h5 -o seen"),
    ("split.h5", "score split.h5 --data data.h5 --results results -q"),
    ("records.jsonl", "report records.jsonl -o report.md"),
    ("records.jsonl", "run --method nearest --targets 10 --data data.h5 --results . -q"),
    ("records.jsonl", "bench savings -o records.jsonl"),
    ("records.jsonl", "bench stress --only phase -o records.jsonl"),
    ("report.md", "report records.jsonl -o report.md"),
    ("page.html", "report records.jsonl -o report.md --html page.html"),
    ("seen/index.html", "view empty -o seen"),
    ("plot.png", "plot data.h5 -o plot.png"),
    ("reference.npz", "bench reference office -o reference.npz -q"),
    *((f"maps/{name}", IMPORT) for name in [*PNG_FOLDER, "train_index.txt", "spectrum/00001.png"]),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a sound file of every kind, which is the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "seen").mkdir()
    write_png_folder(tmp_path / "maps")
    texts = {"room.toml": REFERRING_SCENE, "room.xml": XML, "wall.ply": ASCII_PLY}
    sound = {"data.h5": sound_dataset(), "records.jsonl": sound_records()}
    for name, content in (sound | {name: text.encode() for name, text in texts.items()}).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


@pytest.mark.parametrize("kind", ["pipe", "/dev/zero"])
@pytest.mark.parametrize(("name", "command"), COMMANDS, ids=lambda text: text.replace(" ", "_"))
def test_a_pipe_or_a_device_in_the_place_of_a_file_is_refused(folder: Path, name: str, command: str, kind: str) -> None:
    (folder / name).unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(folder / name)
    else:
        (folder / name).symlink_to(kind)
    outcome = xfreqbench(*command.split())
    assert outcome.code == 2, outcome
    check_clean(outcome, Path(name).name)
