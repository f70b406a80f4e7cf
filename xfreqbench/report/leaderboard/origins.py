"""Where records come from: the data, and the machine, the code and the data file that made them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from xfreqbench.runs.records import Job, RunRecord

RecordKey = tuple[str, Job, str]  # id, job and time: no two records have all in common


class Origin(NamedTuple):
    """Who made a record: the machine, the commit of the code, the file of data, and the results it lies in.

    `machine` is None for predictions that were made elsewhere, and `source` where it makes no difference.
    """

    machine: str | None
    commit: str
    dataset_sha256: str
    source: str

    @classmethod
    def of(cls, record: RunRecord, sources: Mapping[RecordKey, str]) -> Origin:
        """The origin of a record; `sources` names the results that records lie in, where there are several."""
        machine = None if record.external else machine_name(record.hardware)
        source = sources.get(record_key(record), "")
        return cls(machine, short_commit(record.git_commit), record.dataset_sha256, source)

    @property
    def place(self) -> str:
        """The machine, the file of data and the results in words, without the commit."""
        machine = "predicted elsewhere" if self.machine is None else self.machine
        source = f", from {self.source}" if self.source else ""
        return f"{machine}, data {self.dataset_sha256[:8]}{source}"


def machine_name(hardware: Mapping[str, str]) -> str:
    """A machine in one line: its processor, cores, system, threads where they are fewer, and GPUs."""
    counted = {"cores", "threads"}
    return ", ".join(_plural(value, name) if name in counted else value for name, value in hardware.items())


def _plural(number: str, name: str) -> str:
    return f"{number} {name.removesuffix('s') if number == '1' else name}"


def short_commit(commit: str | None) -> str:
    """The first seven digits of a commit with the mark of an edited source; `?` where the commit is unknown."""
    digits, plus, changes = (commit or "?").partition("+")
    return digits[:7] + plus + changes


def record_key(record: RunRecord) -> RecordKey:
    """Values that identify a record, whichever file it is stored in."""
    return record.id, record.job, record.time_utc


def origin_labels(records: Iterable[RunRecord], origin: Callable[[RunRecord], Origin]) -> Mapping[Origin, str]:
    """A label for each origin, m1, m2, …, that of the oldest record first.

    There are none where one machine made all, from one file of data.
    """
    ordered = [origin(record) for record in sorted(records, key=lambda record: (record.time_utc, record.id))]
    places = {(place.machine, place.dataset_sha256) for place in ordered if place.machine is not None}
    return {place: f"m{number}" for number, place in enumerate(dict.fromkeys(ordered), 1)} if len(places) > 1 else {}
