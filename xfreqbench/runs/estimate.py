"""An estimate of what runs will take, before the first of them starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from xfreqbench.data.unseen_rooms import RoomSplit
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.rooms import PerRoom
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task
from xfreqbench.runs.presets import COSTS
from xfreqbench.system.processes import SERIAL, require_executor


@dataclass(frozen=True)
class Estimate:
    """Runs that are asked for, and those of them that are left; `str` says it in a line.

    `seconds` is what these take one after the other, without `num_unknown` fits of which no time is known. `num_places`
    is the number of runs at a time, None where only a cluster knows.
    """

    num_asked: int
    num_left: int
    seconds: float = 0.0
    num_unknown: int = 0
    num_places: int | None = 1

    def __str__(self) -> str:
        num_finished = self.num_asked - self.num_left
        counted = f"{self.num_asked} runs" + (f", {num_finished} of them finished before" if num_finished else "")
        if not self.num_left:
            return f"{counted}: nothing is left to run"
        places = {None: " of run time, shared by the workers of the cluster", 1: ", one at a time"}
        at_a_time = places.get(self.num_places, f", {self.num_places} at a time")
        time = f"about {in_hours(self.seconds / (self.num_places or 1))}{at_a_time}"
        rest = f"; {self.num_unknown} fits come on top, of which no time is known" if self.num_unknown else ""
        return f"{counted}: {self.num_left} to run, {time}{rest}"


def estimate_runs(tasks: Sequence[Task], results_dir: Path, executor: str = SERIAL) -> Estimate:
    """What tasks will take with these workers, those that are finished in a folder left out; nothing is written.

    Raises `XFreqBenchError` for an executor that there is not.
    """
    require_executor(executor)
    folder = ResultsFolder(results_dir)
    left = [task for task in tasks if folder.finished(task.id) is None]
    seconds, num_unknown, across = 0.0, 0, set[str]()
    for task in left:
        job, split = task.job, task.split
        num_rooms = len(task.data.part(split.part)) if isinstance(split, RoomSplit) else 0
        is_per_room = num_rooms and isinstance(task.method, PerRoom)  # which is fitted in each
        num_fits = num_rooms if is_per_room else int(task.fit_id not in across)
        across.add(task.fit_id)
        num_unknown += num_fits if fit_seconds(job.method, job.budget) is None else 0
        seconds += run_seconds(job.method, job.budget, num_fits, num_rooms)
    num_places = 1 if executor == SERIAL else int(executor) if executor.isdecimal() else None
    return Estimate(len(tasks), len(left), seconds, num_unknown, num_places)


def run_seconds(method: str, budget: Budget, num_fits: float = 1, num_rooms: int = 0) -> float:
    """Seconds of one core of a run that fits so many times and scores so many rooms, or one data set without any.

    A fit of which no time is known counts as none.
    """
    beside = COSTS["trivial_run" if method in EVERY_TRIVIAL else "beside_fit"]
    scored = num_rooms * COSTS["a_tested_room"] if num_rooms else beside
    return num_fits * (fit_seconds(method, budget) or 0.0) + scored


def fit_seconds(method: str, budget: Budget) -> float | None:
    """Seconds of one core of a fit: of its budget, or of its maps, a step taken for 128; None where none are known."""
    if method in EVERY_TRIVIAL:
        return 0.0
    maps, a_map = budget.max_maps or 128 * (budget.max_steps or 0), COSTS["a_map"].get(method)
    return budget.max_seconds or (maps * a_map if maps and a_map else None)


def in_hours(seconds: float) -> str:
    """A time in minutes, or in hours and minutes: `7 min`, `2 h 05 min`."""
    minutes = max(1, round(seconds / 60))
    return f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"
