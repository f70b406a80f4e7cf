"""Tables of runs on unseen rooms: by transmitters heard, carrier, type of room, and line of sight."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import compress, groupby
from math import inf, isnan, nan
from statistics import mean
from typing import Any

import numpy as np
from scipy import ndimage

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
_SKILL = "skill over the best trivial predictor"
_MORE = ("skill", "seeds", "s a room", "s to learn", "rooms learned from")
_Chosen = Callable[[RunRecord], list[FloatArray]]  # SSIM in each room that has any such map
_Seeds = dict[int, RunRecord]
_Runs = dict[tuple[str, str], dict[int, _Seeds]]  # by rooms and method, then by the number of transmitters heard
_Values = dict[tuple[str, int], dict[str, list[FloatArray]]]  # by rooms and that number, then by method


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
    tables = []
    for group in found:
        data = recipe_name("", group[0].recipe).strip("@")
        tables += _tables(group, data if num_boards[place(group[0])] > 1 else "")
    return tables


def _tables(records: Sequence[RunRecord], data: str) -> list[BenchRecord]:
    """Tables of one board; `data` tells it from others of its family, and is empty where there are none."""
    runs = _runs(records)
    types = sorted({str(each) for record in records for each in record.settings[ROOM_TYPES]})
    choices: dict[str, dict[str, _Chosen]] = {
        "": {"": _unheard},
        "carrier": {format_ghz(ghz_to_hz(each)): partial(_at_carriers, [each]) for each in ASKED_GHZ},
        "type of room": {each: partial(_of_type, each) for each in types},
        "line of sight": {"in sight": partial(_in_sight, "1"), "hidden": partial(_in_sight, "0")},
    }
    last, machines = records[-1], machine_names(records)
    commits = Counter(short_commit(record.git_commit) for record in records)
    note = _note(last)
    if len(commits) > 1:
        note += f" Commits: {', '.join(f'{commit} ({count} runs)' for commit, count in sorted(commits.items()))}."
    note += f" Machines: {'; '.join(machines)}." if len(machines) > 1 else ""
    tables = []
    for what, named in choices.items():
        columns = ("method", "rooms", *([what] if all(named) else []))
        values = {name: _values(runs, chosen) for name, chosen in named.items()}
        rows = [
            (label, *filter(None, [part, name]), *_cells(values[name], part, label), *_seconds(found))
            for (part, label), found in runs.items()
            for name in named
        ]
        shown = [row for row in rows if any(cell != ABSENT for cell in row[len(columns) : -len(_MORE)])]
        tables.append(
            BenchRecord(
                bench=ROOMS,
                title=" · ".join(filter(None, [last.scene, last.job.protocol, data, f"by {what}" if what else ""])),
                command=f"xfreqbench run --data {last.job.dataset} --protocol {last.job.protocol} --methods … "
                "--results results",
                note=note,
                columns=(*columns, *(f"{number} heard" for number in NUMS_HEARD), *_MORE),
                rows=tuple(shown),
                figure=None if what else _figure(runs, values[""]),
                hardware=last.hardware,
                software=last.software,
                git_commit=last.git_commit,
                time_utc=last.time_utc,
            )
        )
    return tables


def _runs(records: Sequence[RunRecord]) -> _Runs:
    """The runs of each row, the best row first; a label says the budget where a method has several."""
    budgets: dict[str, set[str]] = {}
    names = [" ".join([record.job.method, *record.job.overrides]) for record in records]
    bare = [re.sub(r" trained_on=\d+", "", name) for name in names]  # without the option that chooses training rooms
    for name, record in zip(bare, records, strict=True):
        budgets.setdefault(name, set()).add(budget_text(record.job.budget))
    runs: _Runs = {}
    for name, method, record in zip(names, bare, records, strict=True):
        label = name
        if name not in EVERY_TRIVIAL:
            label += f", {budget_text(record.job.budget)}" if len(budgets[method]) > 1 else ""
        part, number = record.job.split.rpartition("heard-")[0], record.job.split.rpartition("-")[2]
        row = runs.setdefault((part.rstrip("-") or _TRAINED, label), {})
        row.setdefault(int(number), {})[record.job.seed] = record

    values = _values(runs, _unheard)

    def standing(row: tuple[str, str]) -> tuple[bool, float]:
        reached = _skill(row[1], values[row[0], max(runs[row])])
        return row[0] != _TRAINED, inf if isnan(reached) else -reached

    return {row: runs[row] for row in sorted(runs, key=standing)}


def _note(record: RunRecord) -> str:
    trained, tested = record.settings["rooms_trained_on"], record.settings["rooms_tested"]
    return (
        "A cell has the median SSIM of maps at 2.4, 24.25 and 77 GHz, where a method has heard 1, 10 and 60 GHz, and "
        "the mean over rooms of how much higher their median SSIM is than that of `line-of-sight`, with its 95 % "
        f"interval when rooms are resampled; maps of all seeds are pooled. There were {trained} rooms to train on. "
        "Skill is that over the best trivial predictor, at the most heard. Seconds a room are those to adapt to a room "
        f"and to predict {record.num_test // tested} maps."
    )


def _at_carriers(carriers_ghz: Sequence[float], record: RunRecord) -> list[FloatArray]:
    known = sorted(map(float, record.scores["ssim"].median_by_carrier_hz))
    by_carrier = np.array(record.ssim_by_tx).reshape(len(record.ssim_by_tx), -1, len(known))  # rooms, transmitters, …
    return list(by_carrier[:, :, [known.index(ghz_to_hz(each)) for each in carriers_ghz]])


_unheard = partial(_at_carriers, ASKED_GHZ)


def _of_type(name: str, record: RunRecord) -> list[FloatArray]:
    return list(compress(_unheard(record), [kind == name for kind in record.settings[ROOM_TYPES]]))


def _in_sight(flag: str, record: RunRecord) -> list[FloatArray]:
    flags = record.settings[ROOM_SIGHT]
    scores = [room[np.array([*seen]) == flag] for room, seen in zip(_unheard(record), flags, strict=True)]
    return [room for room in scores if room.size]


def _median(scores: list[FloatArray]) -> float:
    return float(np.median(np.concatenate(scores)))


def _medians(rooms: list[FloatArray]) -> FloatArray:
    owner = np.repeat(np.arange(len(rooms)), list(map(len, rooms)))
    return ndimage.median(np.concatenate(rooms), owner, np.arange(len(rooms)))


def _values(runs: _Runs, chosen: _Chosen) -> _Values:
    """Scores of every method that has any, each room's of all seeds together."""
    values: _Values = defaultdict(dict)
    for (part, label), run in runs.items():
        for number, seeds in run.items():
            scores = [np.concatenate(room, axis=None) for room in zip(*map(chosen, seeds.values()), strict=True)]
            values[part, number] |= {label: scores} if scores else {}
    return values


def _cells(values: _Values, part: str, label: str) -> list[str]:
    """Cells of one row: of each number of transmitters heard, and the skill at the most of them."""
    known = [values[part, number] for number in NUMS_HEARD]
    *_, reached = nan, *(_skill(label, found) for found in known if label in found)
    cells = [_cell(label, found) if label in found else ABSENT for found in known]
    return [*cells, ABSENT if isnan(reached) else f"{reached:.2f}"]


def _skill(label: str, found: dict[str, list[FloatArray]]) -> float:
    trivial = [_median(scores) for name, scores in found.items() if name in EVERY_TRIVIAL]
    return skill(_median(found[label]), max(trivial, default=nan))


def _cell(label: str, found: dict[str, list[FloatArray]]) -> str:
    """The median, and how far above `line-of-sight` it is, which knows geometry alone."""
    value, start = f"{_median(found[label]):.3f}", found.get("line-of-sight")
    if start is None or label == "line-of-sight":
        return value
    by_room = _medians(found[label]) - _medians(start)
    drawn = np.random.default_rng(0).choice(by_room, (NUM_RESAMPLES, len(by_room))).mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{value}, {by_room.mean():+.3f} [{low:+.3f}, {high:+.3f}]"


def _seconds(run: dict[int, _Seeds]) -> list[str]:
    """Cells of the number of seeds, and of their means: the seconds for a new room where most is heard and of the fit
    across rooms, and how many rooms it saw."""
    records = run[max(run)].values()
    room_s = mean(each.counts[ROOM_SECONDS] for each in records)
    fit_s = mean(each.fit_seconds or 0.0 for each in records)
    num_rooms = next(iter(records)).counts.get(NUM_ROOMS)
    return [f"{len(records)}", f"{room_s:.2f}", f"{fit_s:.0f}", f"{num_rooms:,.0f}" if num_rooms else ABSENT]


def _figure(runs: _Runs, values: _Values) -> BenchFigure | None:
    """Skill by the number of transmitters heard: of methods without options, or of all where each has some."""
    rows = [row for row in runs if row[1] not in EVERY_TRIVIAL]
    points = [
        (f"{label}, {part}", float(number), _skill(label, values[part, number]))
        for part, label in [row for row in rows if "=" not in row[1]] or rows
        for number in sorted(runs[part, label])
    ]
    known = tuple(BenchPoint(series=series, label="", x=x, y=y) for series, x, y in points if not isnan(y))
    if not known:
        return None
    return BenchFigure(x_label="transmitters heard", y_label=_SKILL, log_x=False, points=known, x_is_cost=False)


def rooms_overview(tables: Iterable[BenchRecord], page: str) -> list[str]:
    """The best methods and baseline in rooms of the types trained on, in short: a section of a report, or none.

    Below those that know what they hear are those that are told the plan.
    """
    every = [each for each in tables if each.bench == ROOMS and " · by " not in each.title]
    found = {each.title.split(" · ")[1]: each for each in reversed(every)}  # the first of each protocol
    if ROOMS not in found:
        return []
    rows = []
    for protocol, number, told in zip(ROOM_PROTOCOLS, (3, 2), ("", " (told the plan)"), strict=True):
        of_board = [row for row in found[protocol].rows if row[1] == _TRAINED] if protocol in found else []
        of_board.sort(key=lambda row: "=" in row[0])  # methods as they are, before those with options
        learned = [row for row in of_board if row[0] not in EVERY_TRIVIAL][:number]
        baseline = [row for row in of_board if row[0] in EVERY_TRIVIAL][:1] if protocol == ROOMS else []
        rows += [[row[0] + told, *(cell.partition(", ")[0] for cell in row[2:])] for row in learned + baseline]
    columns = [column for column in found[ROOMS].columns if column != "rooms"]
    caption = f"Median SSIM by the transmitters heard of a room that was never seen. [More]({page})."
    if found[ROOMS].figure:
        caption += f" ![{_SKILL}]({page.rpartition('/')[0]}/{bench_figure(found[ROOMS])})"
    return [f"## Unseen rooms\n\n{caption}\n\n{table(columns, rows, prose)}"]
