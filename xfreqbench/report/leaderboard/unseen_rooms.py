"""Tables of runs on unseen rooms: how good methods are by the number of transmitters heard, by carrier and by type."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from math import nan
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.unseen_rooms import ASKED_GHZ, NUMS_HEARD, ROOM_PROTOCOLS
from xfreqbench.maps.metrics import NUM_RESAMPLES, skill
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.records import BenchFigure, BenchPoint, BenchRecord, RunRecord
from xfreqbench.runs.rooms import ROOM_SECONDS, ROOM_TYPES
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz, ghz_to_hz

_START = "line-of-sight"  # which knows geometry alone, and to which the others are compared
_NOTE = (
    "A cell has the median SSIM of maps at 2.4, 24.25 and 77 GHz, where a method has heard 1, 10 and 60 GHz, and the "
    "mean over rooms of how much higher their median SSIM is than that of `line-of-sight`, with its 95 % interval when "
    "rooms are resampled. "
)
TRAINED_TYPES = "trained types"  # of rooms, as rows are named that are tested on such
_Chosen = Callable[[RunRecord], FloatArray]


def is_of_rooms(record: RunRecord) -> bool:
    """Whether a record is of a protocol of rooms, test or validation."""
    return record.job.protocol.startswith(ROOM_PROTOCOLS)


def room_tables(records: Iterable[RunRecord]) -> list[BenchRecord]:
    """Tables of the records that are of rooms, of each collection and protocol: by number heard, carrier and type."""

    def board(record: RunRecord) -> tuple[str, ...]:
        return record.scene, record.dataset_sha256, record.job.protocol

    ordered = sorted(filter(is_of_rooms, records), key=lambda record: (board(record), record.time_utc))
    return [table for _, found in groupby(ordered, key=board) for table in _tables(list(found))]


def _tables(records: Sequence[RunRecord]) -> list[BenchRecord]:
    by_row: dict[tuple[str, str], dict[str, RunRecord]] = {}
    for record in records:
        label = " ".join([record.job.method, *record.job.overrides])
        part = record.job.split.rpartition("heard-")[0].rstrip("-") or TRAINED_TYPES
        by_row.setdefault((part, label), {})[record.job.split] = record
    carriers = {format_ghz(ghz_to_hz(each)): _at_carrier(each) for each in ASKED_GHZ}
    types = sorted({str(each) for record in records for each in record.settings[ROOM_TYPES]})
    last = records[-1]
    tables = []
    for what, choices in (
        ("", {"": _unheard}),
        ("by carrier", carriers),
        ("by type of room", {each: _of_type(each) for each in types}),
    ):
        rows = [
            (label, *filter(None, [part, name if what else ""]), *_cells(by_row, part, label, chosen), *_seconds(found))
            for (part, label), found in by_row.items()
            for name, chosen in choices.items()
        ]
        columns = ("method", "rooms", *([what.removeprefix("by ")] if what else []))
        tables.append(
            BenchRecord(
                bench=ROOM_PROTOCOLS[0],
                title=f"{last.scene} · {last.job.protocol}" + (f" · {what}" if what else ""),
                command=f"xfreqbench run --data {last.job.dataset} --protocol {last.job.protocol} --methods … "
                "--results results",
                note=_note(last),
                columns=(*columns, *(f"{number} heard" for number in NUMS_HEARD), "skill", "s a room", "s to learn"),
                rows=tuple(row for row in rows if any(cell != "–" for cell in row[len(columns) : -3])),
                figure=None if what else _figure(by_row),
                hardware=last.hardware,
                software=last.software,
                git_commit=last.git_commit,
                time_utc=last.time_utc,
            )
        )
    return tables


def _note(record: RunRecord) -> str:
    trained, tested = record.settings["rooms_trained_on"], record.settings["rooms_tested"]
    return _NOTE + (
        f"{trained} rooms were trained on. Skill is that over the best trivial predictor, at the most heard. Seconds a "
        f"room are those to adapt to a room and to predict {record.num_test // tested} maps."
    )


def _ssim(record: RunRecord) -> Float[FloatArray, "R T F"]:
    """SSIM by room, transmitter and carrier."""
    carriers = len(record.scores["ssim"].median_by_carrier_hz)
    return np.array(record.ssim_by_tx).reshape(len(record.ssim_by_tx), -1, carriers)


def _at_carrier(*carriers_ghz: float) -> _Chosen:
    def chosen(record: RunRecord) -> FloatArray:
        known = sorted(map(float, record.scores["ssim"].median_by_carrier_hz))
        return _ssim(record)[:, :, [known.index(ghz_to_hz(each)) for each in carriers_ghz]]

    return chosen


_unheard = _at_carrier(*ASKED_GHZ)


def _of_type(name: str) -> _Chosen:
    return lambda record: _unheard(record)[np.array(record.settings[ROOM_TYPES]) == name]


def _cells(by_row: Any, part: str, label: str, chosen: _Chosen) -> list[str]:
    """Cells of one row: of each number of transmitters heard, and the skill at the most of them."""
    cells, reached = [], nan
    for number in NUMS_HEARD:
        found = {
            name: next((r for split, r in row.items() if split.endswith(f"heard-{number}")), None)
            for (of_part, name), row in by_row.items()
            if of_part == part
        }
        values = {name: chosen(record) for name, record in found.items() if record is not None}
        if label not in values or not values[label].size:
            cells.append("–")
            continue
        cells.append(_cell(values[label], values.get(_START) if label != _START else None))
        trivial = [float(np.median(each)) for name, each in values.items() if name in EVERY_TRIVIAL and each.size]
        reached = skill(float(np.median(values[label])), max(trivial, default=nan))
    return [*cells, "–" if np.isnan(reached) else f"{reached:.2f}"]


def _cell(values: FloatArray, start: FloatArray | None) -> str:
    if start is None or start.shape != values.shape:
        return f"{np.median(values):.3f}"
    by_room = np.median(values, axis=(1, 2)) - np.median(start, axis=(1, 2))
    drawn = np.random.default_rng(0).choice(by_room, (NUM_RESAMPLES, len(by_room))).mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{np.median(values):.3f}, {by_room.mean():+.3f} [{low:+.3f}, {high:+.3f}]"


def _seconds(found: dict[str, RunRecord]) -> list[str]:
    """Cells of the seconds for a new room where most is heard, and of the fit across rooms."""
    record = max(found.values(), key=lambda each: int(each.job.split.rpartition("-")[2]))
    return [f"{record.counts[ROOM_SECONDS]:.2f}", f"{record.fit_seconds:.0f}"]


def _figure(by_row: Any) -> BenchFigure:
    points = tuple(
        BenchPoint(
            series=f"{label}, {part}", label="", x=float(split.rpartition("-")[2]), y=float(np.median(_unheard(record)))
        )
        for (part, label), row in by_row.items()
        for split, record in row.items()
    )
    return BenchFigure(x_label="transmitters heard", y_label="median SSIM", log_x=False, points=points)
