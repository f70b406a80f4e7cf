"""Whatever happens to a command, the next one leaves the bytes of an undisturbed run or refuses in words."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import time
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.whole.chaos.commands import COMMANDS, do_wrong, prepare
from tests.whole.chaos.disturbances import DISTURBANCES, Round
from tests.whole.chaos.process import CommandLine, Ended, Running
from xfreqbench.cli.main import main

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
ROUNDS = [
    *(("generate", disturbance) for disturbance in DISTURBANCES),
    *(("run", disturbance) for disturbance in ("killed", "doubled", "damaged", "foreign")),
    *((command, "killed") for command in ("report", "export", "score", "import")),
    *(("view", "linked"), ("findings", "foreign")),
]
# What a killed process leaves, hidden, which the next that needs the place removes.
_LITTER = ".lock", ".partial", ".removed"
_LINK = "link to "  # what it points to
_RECORD = ": "  # between the path of a file and the identifier of a record in it
# What differs from run to run: files with times and folders in them, and the same among the fields of records.
_VARYING = "checkpoint.json", "training_rows.json"
_TIMED = {
    *("fit_seconds", "fit_processor_seconds", "predict_ms_per_map", "peak_memory_mib", "curve"),
    *("time_utc", "hardware", "git_commit", "content_sha256"),
}


class Chaos:
    """Rounds in a folder that is made for them. A seed draws the same round again, but for what time decides."""

    def __init__(self, command_line: CommandLine, folder: Path) -> None:
        self.command_line, self._folder = command_line, folder
        self._undisturbed: dict[str, tuple[float, dict[str, str]]] = {}
        prepare(folder / "prepared", lambda line: self._give(line, folder / "prepared"))

    def faults(self, name: str, disturbance: str, seed: int) -> list[str]:
        """Disturb a command, give it once more, and judge what is then there: what is wrong, in words."""
        seconds, contents = self.undisturbed(name)
        folder = self._fresh(f"round-{seed}")
        written = {path.partition(_RECORD)[0] for path in contents if not path.startswith("inputs")}
        at = Round(
            COMMANDS[name],
            self.command_line,
            folder,
            random.Random(f"{seed} {name} {disturbance}"),
            seconds,
            sorted(written),
        )
        outside = _contents(folder / "outside")
        DISTURBANCES[disturbance](at)
        inputs = _contents(at.work / "inputs")
        last = at.start().wait()
        faults = [
            *_faults_of_outcomes(at, last),
            *(["the folder outside was touched"] if _contents(folder / "outside") != outside else []),
            *(["the inputs were touched"] if _contents(at.work / "inputs") != inputs else []),
            *(f"{path.name} of somebody else is not as it was" for path in at.planted if not _is_intact(path)),
            *(_differences(at, contents) if last.code == 0 or not at.may_refuse else []),
        ]
        if not faults:
            shutil.rmtree(folder)
        return faults

    def undisturbed(self, name: str) -> tuple[float, dict[str, str]]:
        """How long a command takes where nothing happens, and what it leaves; found when it is first disturbed."""
        if name not in self._undisturbed:
            folder, start = self._fresh("undisturbed"), time.perf_counter()
            self._give(COMMANDS[name].line, folder / "work")
            self._undisturbed[name] = time.perf_counter() - start, _contents(folder / "work")
        return self._undisturbed[name]

    def _give(self, line: str, folder: Path) -> None:
        ended = Running(self.command_line, line, folder).wait()
        assert ended.code == 0, f"xfreqbench {line} ended with {ended.code}: {ended.stderr}"

    def _fresh(self, name: str) -> Path:
        folder = self._folder / name
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._folder / "prepared", folder / "work")
        (folder / "outside" / "folder" / "1").mkdir(parents=True)
        for place in (folder / "outside", folder / "outside" / "folder", folder / "outside" / "folder" / "1"):
            (place / "thesis.tex").write_text("years of work", encoding="utf-8")
        return folder


def _faults_of_outcomes(at: Round, last: Ended) -> Iterator[str]:
    for ended in (*at.outcomes, last):
        if ended.code is None:
            yield "it did not end"
        elif "Traceback" in ended.stderr or (ended.code == 2 and not ended.is_refusal):
            yield f"no words for a user: {ended.stderr[-400:]!r}"
        elif ended.code not in (0, 2, 130, -9):
            yield f"exit code {ended.code}: {ended.stderr[-400:]!r}"


def _differences(at: Round, undisturbed: Mapping[str, str]) -> Iterator[str]:
    """Files that are not as the undisturbed command leaves them, but for those that the disturbance put there."""
    found = _contents(at.work)
    excused = {path.relative_to(at.work).as_posix() for path in (*at.planted, *at.damaged)}
    for name, sha256 in undisturbed.items():
        if name.partition(_RECORD)[0] not in excused and found.get(name) != sha256:
            yield f"{name} is {'another' if name in found else 'missing'}"
    for name in found.keys() - undisturbed.keys() if not at.has_rival else ():
        is_hidden = any(part.startswith(".") for part in Path(name).parts) or name.endswith(_LITTER)
        if name.partition(_RECORD)[0] not in excused and not is_hidden and not found[name].startswith(_LINK):
            yield f"{name} is left over"


def _contents(folder: Path) -> dict[str, str]:
    """The hash of each file by its path, none where that varies, records without times, what links point to."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = f"{_LINK}{path.readlink()}"
        elif path.is_file() and path.suffix == ".jsonl":
            for record_id, record in _records_in(path).items():
                found[f"{name}{_RECORD}{record_id}"] = json.dumps(record, sort_keys=True)
        elif path.is_file():
            found[name] = "" if path.name in _VARYING else hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def _records_in(path: Path) -> dict[str, dict[str, Any]]:
    """The records of a file without what differs from run to run; of two of one run, the latest."""
    records = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            record = json.loads(line)
        except ValueError:
            record = {"id": line}
        name = str(record.get("id", record.get("title")))
        records[name] = {key: value for key, value in record.items() if key not in _TIMED}
    return records


def _is_intact(path: Path) -> bool:
    return path.is_file() and not path.is_symlink() and path.read_bytes() == b"years of work"


@pytest.fixture(scope="module")
def rounds(tmp_path_factory: pytest.TempPathFactory) -> Chaos:
    return Chaos(main, tmp_path_factory.mktemp("chaos"))


@pytest.mark.parametrize(("command", "disturbance"), ROUNDS)
def test_the_next_command_leaves_the_same_bytes_or_refuses(rounds: Chaos, command: str, disturbance: str) -> None:
    assert rounds.faults(command, disturbance, seed=1) == []


@pytest.mark.parametrize(
    ("how", "fault"),
    [
        ("elsewhere", "the folder outside was touched"),
        ("others", "out.h5 is another"),
        ("traceback", "no words for a user"),
        ("litter", "rest.tmp is left over"),
    ],
)
def test_what_is_wrong_is_found(rounds: Chaos, how: str, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds.undisturbed("import")  # of the right command
    monkeypatch.setattr(rounds, "command_line", partial(do_wrong, how))
    assert any(fault in found for found in rounds.faults("import", "interrupted", seed=3))
