"""Where records come from: of which data they are, and whose machine, code and file of data made them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from xfreqbench.data.recipe import recipe_name
from xfreqbench.runs.records import Job, RunRecord

RecordKey = tuple[str, Job, str]  # id, job and time: no two records have all in common
_SHOWN_DIGITS = 16
_RECORDED = {  # recipes of the data that the reference records are of, which were written before records named any
    "f422ecef971e33553863078d19d95103ac1aeed35b16db9d4c4a72abd942ceb7": "1-360896628df9c1cc458cd3f353817023331f8fb49fffe5b116fe7d604c005946",  # noqa: E501
    "617e230f790dd51b7f0ef78113e2a4cf874ab7b487b423315d9a6cb79c0e4303": "1-908fa85f448fb0d14af3bdce3af26e9009ab73264b10c598625c0a50a90cac37",  # noqa: E501
    "ff1e5019d4e6eb5ce358283b05fa53b485e3529d3d4a45a65f40cf629898da2d": "1-90ec89545357f591aa210a9dfdd5817a1d6e509572f5f278c7f00fbbfff5b6ce",  # noqa: E501
}


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
    """A machine in one line: its processor, cores, system and GPUs."""
    parts = dict(hardware)
    if "cores" in parts:
        parts["cores"] += " core" if parts["cores"] == "1" else " cores"
    return ", ".join(parts.values())


def short_commit(commit: str | None) -> str:
    """The first seven digits of a commit with the mark of an edited source; `?` where the commit is unknown."""
    digits, plus, changes = (commit or "?").partition("+")
    return digits[:7] + plus + changes


def record_key(record: RunRecord) -> RecordKey:
    """What tells a record from all others, in whatever file it lies."""
    return record.id, record.job, record.time_utc


def data_identities(records: Iterable[RunRecord]) -> Callable[[RunRecord], str]:
    """A function from a record to what its data are told apart by: their recipe, or else the sha256 of their bytes.

    A record that was written before records named recipes has that of its bytes, where any of `records` tells it;
    the recipes of the reference records are known besides, and serve where any of `records` has them.
    """
    told = {record.dataset_sha256: record.recipe for record in records if record.recipe}
    named = set(told.values())
    recipes = {sha256: recipe for sha256, recipe in _RECORDED.items() if recipe in named} | told

    def identity(record: RunRecord) -> str:
        return record.recipe or recipes.get(record.dataset_sha256, record.dataset_sha256)

    return identity


def data_name(scene: str, identity: str) -> str:
    """What is shown of an identity of data: the recipe's name, or the first digits of the sha256 of their bytes."""
    return recipe_name(scene, identity) if "-" in identity else identity[:_SHOWN_DIGITS]


def origin_labels(
    records: Iterable[RunRecord], origin: Callable[[RunRecord], Origin]
) -> Mapping[Origin, str]:
    """A label for each origin, m1, m2, …, that of the oldest record first.

    There are none where one machine made all, from one file of data.
    """
    ordered = [origin(record) for record in sorted(records, key=lambda record: (record.time_utc, record.id))]
    places = {(each.machine, each.dataset_sha256) for each in ordered if each.machine is not None}
    return (
        {each: f"m{number}" for number, each in enumerate(dict.fromkeys(ordered), 1)}
        if len(places) > 1
        else {}
    )
