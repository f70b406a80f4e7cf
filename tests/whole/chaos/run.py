"""Rounds: in each a command is disturbed and given once more, and what is then there is judged."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.whole.chaos.commands import Command, prepare
from tests.whole.chaos.disturbances import DISTURBANCES, Round
from tests.whole.chaos.process import CommandLine, Ended, Running

# What a killed process leaves, hidden, which the next that needs the place removes.
_LITTER = ".lock", ".partial", ".removed"
_LINK = "link to "  # what it points to
_RECORD = ": "  # between the path of a file and the identifier of a record in it
_TIMED = {
    "fit_seconds",
    "fit_processor_seconds",
    "predict_ms_per_map",
    "peak_memory_mib",
    "curve",
    "time_utc",
    "hardware",
    "git_commit",
    "content_sha256",
}
Contents = Mapping[str, str]


@dataclass(frozen=True)
class Undisturbed:
    """What a command leaves where nothing happens, and how long it takes.

    `files` are the hashes of what two runs left alike, `names` all paths.
    """

    seconds: float
    files: Contents
    names: frozenset[str]


@dataclass(frozen=True)
class ChaosVerdict:
    """How a round ended: `same` bytes as undisturbed, or a `refusal` in words; `faults` if anything was wrong."""

    command: str
    disturbance: str
    seed: int
    end: str
    faults: tuple[str, ...]

    def __str__(self) -> str:
        faults = "; ".join(self.faults)
        return f"round {self.seed}: {self.command}, {self.disturbance}: {self.end}{': ' + faults if faults else ''}"


class Chaos:
    """Rounds in a folder that is made for them. A seed draws the same round again, but for what time decides."""

    def __init__(self, command_line: CommandLine, folder: Path) -> None:
        self._command_line, self._folder = command_line, folder
        self._undisturbed: dict[str, Undisturbed] = {}
        prepare(folder / "prepared", self._given)

    def round(self, command: Command, disturbance: str, seed: int) -> ChaosVerdict:
        """Disturb a command, give it once more, and judge what is then there."""
        undisturbed = self._reference(command)
        folder = self._fresh(f"round-{seed}")
        chance = random.Random(f"{seed} {command.name} {disturbance}")
        written = sorted({name.partition(_RECORD)[0] for name in undisturbed.names if not name.startswith("inputs")})
        at = Round(command, self._command_line, folder, chance, undisturbed.seconds, written)
        outside = _contents(folder / "outside")
        DISTURBANCES[disturbance](at)
        inputs = _contents(at.work / "inputs")
        last = at.start().wait()
        faults = [
            *_faults_of_outcomes(at, last),
            *(["the folder outside was touched"] if _contents(folder / "outside") != outside else []),
            *(["the inputs were touched"] if _contents(at.work / "inputs") != inputs else []),
            *(f"{path.name} of somebody else is not as it was" for path in at.planted if not _is_intact(path)),
            *(_differences(at, undisturbed) if last.code == 0 or not at.may_refuse else []),
        ]
        if not faults:
            shutil.rmtree(folder)
        return ChaosVerdict(command.name, disturbance, seed, "same" if last.code == 0 else "refusal", tuple(faults))

    def _given(self, line: str) -> None:
        ended = Running(self._command_line, line.split(), self._folder / "prepared").wait()
        if ended.code != 0:
            raise RuntimeError(f"xfreqbench {line} ended with {ended.code}: {ended.stderr}")

    def _fresh(self, name: str) -> Path:
        folder = self._folder / name
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._folder / "prepared", folder / "work")
        (folder / "outside" / "folder" / "1").mkdir(parents=True)
        for place in (folder / "outside", folder / "outside" / "folder", folder / "outside" / "folder" / "1"):
            (place / "thesis.tex").write_text("years of work", encoding="utf-8")
        return folder

    def _reference(self, command: Command) -> Undisturbed:
        """Found by two undisturbed runs, when the command is first disturbed."""
        if command.name not in self._undisturbed:
            found = []
            for number in range(2):
                folder = self._fresh(f"undisturbed-{number}")
                start = time.perf_counter()
                ended = Running(self._command_line, command.words, folder / "work").wait()
                if ended.code != 0:
                    raise RuntimeError(f"xfreqbench {command.line} ended with {ended.code}: {ended.stderr}")
                found.append((time.perf_counter() - start, folder / "work"))
            self._undisturbed[command.name] = _undisturbed(found[1][0], found[0][1], found[1][1])
        return self._undisturbed[command.name]


def _undisturbed(seconds: float, one: Path, other: Path) -> Undisturbed:
    contents, others = _contents(one), _contents(other)
    alike = {name: sha256 for name, sha256 in contents.items() if others.get(name) == sha256}
    return Undisturbed(seconds, alike, frozenset(contents))


def _faults_of_outcomes(at: Round, last: Ended) -> Iterator[str]:
    for ended in (*at.outcomes, last):
        if ended.code is None:
            yield "it did not end"
        elif "Traceback" in ended.stderr or (ended.code == 2 and not ended.is_refusal):
            yield f"no words for a user: {ended.stderr[-400:]!r}"
        elif ended.code not in (0, 2, 130, -9):
            yield f"exit code {ended.code}: {ended.stderr[-400:]!r}"


def _differences(at: Round, undisturbed: Undisturbed) -> Iterator[str]:
    """Files that are not as the undisturbed command leaves them, but for those that the disturbance put there."""
    found = _contents(at.work)
    excused = {path.relative_to(at.work).as_posix() for path in (*at.planted, *at.damaged)}
    for name, sha256 in undisturbed.files.items():
        if name.partition(_RECORD)[0] not in excused and found.get(name) != sha256:
            yield f"{name} is {'another' if name in found else 'missing'}"
    for name in found.keys() - undisturbed.names if not at.has_rival else ():
        is_hidden = any(part.startswith(".") for part in Path(name).parts) or name.endswith(_LITTER)
        if name.partition(_RECORD)[0] not in excused and not is_hidden and not found[name].startswith(_LINK):
            yield f"{name} is left over"


def _contents(folder: Path) -> dict[str, str]:
    """The hash of each file by its path, each record without its times, and of links what they point to."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = f"{_LINK}{path.readlink()}"
        elif path.is_file() and path.suffix == ".jsonl":
            for record_id, record in _records_in(path).items():
                found[f"{name}{_RECORD}{record_id}"] = json.dumps(record, sort_keys=True)
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
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
