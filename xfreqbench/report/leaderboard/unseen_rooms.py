"""Tables of runs on unseen rooms: by transmitters heard, carrier, type of room, line of sight, rooms learned from."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import compress, groupby
from math import inf, isnan, nan
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.recipe import recipe_name
from xfreqbench.data.unseen_rooms import ASKED_GHZ, NUMS_HEARD, ROOM_PROTOCOLS
from xfreqbench.maps.metrics import NUM_RESAMPLES, skill
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.report.drawing.markdown import ABSENT, prose, table
from xfreqbench.report.leaderboard.boards import budget_text, short_commit
from xfreqbench.report.leaderboard.captions import machine_names
from xfreqbench.report.leaderboard.figures import bench_figure
from xfreqbench.runs.records import BenchFigure, BenchPoint, BenchRecord, RunRecord
from xfreqbench.runs.rooms import NUM_ROOMS, ROOM_SECONDS, ROOM_SIGHT, ROOM_TYPES
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz, ghz_to_hz

ROOMS = ROOM_PROTOCOLS[0]  # the name of the measurement that its tables are
_TRAINED = "trained types"
_MORE = ("skill", "s a room", "s to learn", "rooms learned from")
_Chosen = Callable[[RunRecord], list[FloatArray]]  # SSIM in each room that has any such map
_Runs = dict[tuple[str, str], dict[int, RunRecord]]  # by rooms and method, then by the number of transmitters heard


def is_of_rooms(record: RunRecord) -> bool:
    """Whether a record is of a protocol of rooms, test or validation."""
    return record.job.protocol.startswith(ROOM_PROTOCOLS)


def room_tables(records: Iterable[RunRecord]) -> list[BenchRecord]:
    """Tables of the records that are of rooms, of each collection and protocol, most general first.

    Of several collections of a family, those with most rooms to train on come first.
    """

    def place(record: RunRecord) -> tuple[str, str]:
        return record.scene, record.job.protocol

    def board(record: RunRecord) -> tuple[Any, ...]:
        num_rooms = -int(record.settings["rooms_trained_on"])
        return *place(record), num_rooms, record.recipe, record.protocol_version, record.metrics_version

    ordered = sorted(filter(is_of_rooms, records), key=lambda record: (board(record), record.time_utc))
    found = [list(group) for _, group in groupby(ordered, key=board)]
    num_boards = Counter(place(group[0]) for group in found)
    return [
        table
        for group in found
        for table in _tables(
            group, recipe_name("", group[0].recipe).strip("@") if num_boards[place(group[0])] > 1 else ""
        )
    ]


def _tables(records: Sequence[RunRecord], data: str) -> list[BenchRecord]:
    """Tables of one board; `data` tells it from others of its family, and is empty where there are none."""
    budgets: dict[str, set[str]] = {}
    seeds: dict[str, set[int]] = {}
    for record in records:
        budgets.setdefault(_without_choice(_name(record)), set()).add(budget_text(record.job.budget))
        seeds.setdefault(_name(record), set()).add(record.job.seed)
    runs: _Runs = {}
    for record in records:
        label = name = _name(record)
        if name not in EVERY_TRIVIAL:
            label += f", {budget_text(record.job.budget)}" if len(budgets[_without_choice(name)]) > 1 else ""
            label += f", seed {record.job.seed}" if len(seeds[name]) > 1 else ""
        runs.setdefault((_part(record), label), {})[int(record.job.split.rpartition("-")[2])] = record

    def standing(row: tuple[str, str]) -> tuple[bool, float]:
        reached = _skill(row[1], _values(runs, row[0], max(runs[row]), _unheard))
        return row[0] != _TRAINED, inf if isnan(reached) else -reached

    runs = {row: runs[row] for row in sorted(runs, key=standing)}  # the best first
    carriers = {format_ghz(ghz_to_hz(each)): _at_carrier(each) for each in ASKED_GHZ}
    types = sorted({str(each) for record in records for each in record.settings[ROOM_TYPES]})
    last = records[-1]
    commits = Counter(short_commit(record.git_commit) for record in records)
    others = f" Commits: {', '.join(f'{commit} ({count} runs)' for commit, count in sorted(commits.items()))}."
    machines = machine_names(records)
    others = (others if len(commits) > 1 else "") + (f" Machines: {'; '.join(machines)}." if len(machines) > 1 else "")
    tables = []
    for what, choices, figure in (
        ("", {"": _unheard}, _figure(runs)),
        ("carrier", carriers, None),
        ("type of room", {each: _of_type(each) for each in types}, None),
        ("line of sight", {"in sight": _in_sight("1"), "hidden": _in_sight("0")}, None),
        ("rooms learned from", {"": _unheard}, _curve(runs)),
    ):
        is_curve = what == _MORE[-1]
        if is_curve and figure is None:
            continue
        rows = [
            (label, *filter(None, [part, name]), *_cells(runs, part, label, chosen), *_seconds(found))
            for (part, label), found in runs.items()
            for name, chosen in choices.items()
        ]
        columns = ("method", "rooms", *([what] if all(choices) else []))
        tables.append(
            BenchRecord(
                bench=ROOMS,
                title=" · ".join(filter(None, [last.scene, last.job.protocol, data, f"by {what}" if what else ""])),
                command=f"xfreqbench run --data {last.job.dataset} --protocol {last.job.protocol} --methods … "
                "--results results",
                note=_note(last) + others,
                columns=(*columns, *(f"{number} heard" for number in NUMS_HEARD), *_MORE),
                rows=tuple(
                    row
                    for row in rows
                    if any(cell != ABSENT for cell in row[len(columns) : -len(_MORE)])
                    and not (is_curve and row[-1] == ABSENT)
                ),
                figure=figure,
                hardware=last.hardware,
                software=last.software,
                git_commit=last.git_commit,
                time_utc=last.time_utc,
            )
        )
    return tables


def _name(record: RunRecord) -> str:
    return " ".join([record.job.method, *record.job.overrides])


def _without_choice(name: str) -> str:
    """A method's name without the option that chooses training rooms."""
    return re.sub(r" trained_on=\d+", "", name)


def _part(record: RunRecord) -> str:
    return record.job.split.rpartition("heard-")[0].rstrip("-") or _TRAINED


def _note(record: RunRecord) -> str:
    trained, tested = record.settings["rooms_trained_on"], record.settings["rooms_tested"]
    return (
        "A cell has the median SSIM of maps at 2.4, 24.25 and 77 GHz, where a method has heard 1, 10 and 60 GHz, and "
        "the mean over rooms of how much higher their median SSIM is than that of `line-of-sight`, with its 95 % "
        f"interval when rooms are resampled. There were {trained} rooms to train on. Skill is that over the best "
        "trivial predictor, at the most heard. Seconds a room are those to adapt to a room and to predict "
        f"{record.num_test // tested} maps."
    )


def _ssim(record: RunRecord) -> Float[FloatArray, "R T F"]:
    """SSIM by room, transmitter and carrier."""
    carriers = len(record.scores["ssim"].median_by_carrier_hz)
    return np.array(record.ssim_by_tx).reshape(len(record.ssim_by_tx), -1, carriers)


def _at_carrier(*carriers_ghz: float) -> _Chosen:
    def chosen(record: RunRecord) -> list[FloatArray]:
        known = sorted(map(float, record.scores["ssim"].median_by_carrier_hz))
        return list(_ssim(record)[:, :, [known.index(ghz_to_hz(each)) for each in carriers_ghz]])

    return chosen


_unheard = _at_carrier(*ASKED_GHZ)


def _of_type(name: str) -> _Chosen:
    return lambda record: list(compress(_unheard(record), [kind == name for kind in record.settings[ROOM_TYPES]]))


def _in_sight(flag: str) -> _Chosen:
    def chosen(record: RunRecord) -> list[FloatArray]:
        flags = record.settings[ROOM_SIGHT]
        scores = [room[np.array([*seen]) == flag] for room, seen in zip(_unheard(record), flags, strict=True)]
        return [room for room in scores if room.size]

    return chosen


def _median(scores: list[FloatArray]) -> float:
    return float(np.median(np.concatenate(scores)))


def _values(runs: _Runs, part: str, number: int, chosen: _Chosen) -> dict[str, list[FloatArray]]:
    """Scores of every method that has any, where a number of transmitters is heard."""
    found = {label: run[number] for (of_part, label), run in runs.items() if of_part == part and number in run}
    return {label: scores for label, record in found.items() if (scores := chosen(record))}


def _cells(runs: _Runs, part: str, label: str, chosen: _Chosen) -> list[str]:
    """Cells of one row: of each number of transmitters heard, and the skill at the most of them."""
    cells, reached = [], nan
    for number in NUMS_HEARD:
        values = _values(runs, part, number, chosen)
        if label not in values:
            cells.append(ABSENT)
            continue
        start = "line-of-sight"  # which knows geometry alone, and to which the others are compared
        cells.append(_cell(values[label], values.get(start) if label != start else None))
        reached = _skill(label, values)
    return [*cells, ABSENT if isnan(reached) else f"{reached:.2f}"]


def _skill(label: str, values: dict[str, list[FloatArray]]) -> float:
    trivial = [_median(scores) for name, scores in values.items() if name in EVERY_TRIVIAL]
    return skill(_median(values[label]), max(trivial, default=nan))


def _cell(values: list[FloatArray], start: list[FloatArray] | None) -> str:
    if start is None:
        return f"{_median(values):.3f}"
    by_room = np.array([np.median(room) - np.median(other) for room, other in zip(values, start, strict=True)])
    drawn = np.random.default_rng(0).choice(by_room, (NUM_RESAMPLES, len(by_room))).mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{_median(values):.3f}, {by_room.mean():+.3f} [{low:+.3f}, {high:+.3f}]"


def _seconds(run: dict[int, RunRecord]) -> list[str]:
    """Cells of the seconds for a new room where most is heard, of the fit across rooms, and how many rooms it saw."""
    record = run[max(run)]
    learned_from = f"{record.counts[NUM_ROOMS]:,.0f}" if NUM_ROOMS in record.counts else ABSENT
    return [f"{record.counts[ROOM_SECONDS]:.2f}", f"{record.fit_seconds:.0f}", learned_from]


def _figure(runs: _Runs) -> BenchFigure | None:
    """The skill of what is not trivial, by the number of transmitters heard."""
    points = [
        BenchPoint(
            series=f"{label}, {part}", label="", x=number, y=_skill(label, _values(runs, part, number, _unheard))
        )
        for (part, label), run in runs.items()
        if label not in EVERY_TRIVIAL
        for number in sorted(run)
    ]
    return _drawn("transmitters heard", points, log_x=False)


def _curve(runs: _Runs) -> BenchFigure | None:
    """The skill of methods that learned from several numbers of rooms, by that number."""
    points = [
        BenchPoint(
            series=f"{_without_choice(label)}, {part}, {number} heard",
            label="",
            x=record.counts[NUM_ROOMS],
            y=_skill(label, _values(runs, part, number, _unheard)),
        )
        for (part, label), run in runs.items()
        for number, record in run.items()
        if number in (min(NUMS_HEARD), max(NUMS_HEARD)) and NUM_ROOMS in record.counts
    ]
    lengths = Counter(point.series for point in points)
    points = [point for point in points if lengths[point.series] > 1]
    return _drawn("rooms learned from", points, log_x=True)


def _drawn(x_label: str, points: Sequence[BenchPoint], log_x: bool) -> BenchFigure | None:
    """A figure of the points of known skill; None without any."""
    known = tuple(point for point in points if not isnan(point.y))
    y_label = "skill over the best trivial predictor"
    return BenchFigure(x_label=x_label, y_label=y_label, log_x=log_x, points=known, x_is_cost=False) if known else None


def rooms_overview(tables: Iterable[BenchRecord], page: str) -> list[str]:
    """The methods with most skill in rooms of the types trained on, in short: a section of a report, or none."""
    for found in tables:
        if found.bench == ROOMS and found.title.split(" · ")[1] == ROOMS and " · by " not in found.title:
            rows = [
                [row[0], *(cell.partition(", ")[0] for cell in row[2:])] for row in found.rows if row[1] == _TRAINED
            ]
            rows.sort(key=lambda row: "=" in row[0])  # methods as they are, before those with options
            columns = [column for column in found.columns if column != "rooms"]
            figure = f" ([figure]({page.rpartition('/')[0]}/{bench_figure(found)}))" if found.figure else ""
            caption = f"Median SSIM by the transmitters heard of a room that was never seen. [More]({page}){figure}"
            return [f"## Unseen rooms\n\n{caption}\n\n{table(columns, rows[:6], prose)}"]
    return []
