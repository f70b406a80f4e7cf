"""An estimate of what runs will take, before the first of them starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from xfreqbench.data.unseen_rooms import RoomSplit
from xfreqbench.methods.rooms import PerRoom
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task
from xfreqbench.runs.records import Job
from xfreqbench.system.processes import SERIAL, require_executor

OVERHEAD_S = 13.0  # what a run takes besides its fit: start, learning curve, predictions and scores


@dataclass(frozen=True)
class Estimate:
    """Runs that are asked for, and those of them that are left; `str` says it in a line.

    `num_fits` is how often each of those spends its budget. `num_places` is the number of runs at a time, None where
    only a cluster knows.
    """

    num_asked: int
    left: tuple[Job, ...]
    num_places: int | None = 1
    num_fits: tuple[int, ...] | None = None  # once each

    @property
    def seconds(self) -> float:
        """The most that the runs with a budget in seconds take, one after the other; other fits may take any time."""
        times = self.num_fits or (1,) * len(self.left)
        limits = (0.0 if _is_trivial(job) else job.budget.max_seconds or 0.0 for job in self.left)
        return sum(OVERHEAD_S + limit * number for limit, number in zip(limits, times, strict=True))

    def __str__(self) -> str:
        num_finished, num_left = self.num_asked - len(self.left), len(self.left)
        counted = f"{self.num_asked} runs" + (f", {num_finished} of them finished before" if num_finished else "")
        if not num_left:
            return f"{counted}: nothing is left to run"
        if self.num_places is None:
            time = f"up to {in_hours(self.seconds)} of run time, shared by the workers of the cluster"
        else:
            at_a_time = self.num_places if self.num_places > 1 else "one"
            time = f"up to {in_hours(self.seconds / self.num_places)}, {at_a_time} at a time"
        unknown = sum(job.budget.max_seconds is None and not _is_trivial(job) for job in self.left)
        rest = f"; {unknown} fits without a budget in seconds come on top" if unknown else ""
        return f"{counted}: {num_left} to run, {time}{rest}"


def estimate_runs(tasks: Sequence[Task], results_dir: Path, executor: str = SERIAL) -> Estimate:
    """What tasks will take with these workers, those that are finished in a folder left out; nothing is written.

    Raises `XFreqBenchError` for an executor that there is not.
    """
    require_executor(executor)
    folder = ResultsFolder(results_dir)
    left = [task for task in tasks if folder.finished(task.id) is None]
    across, num_fits = set[str](), []
    for task in left:
        if isinstance(task.split, RoomSplit) and isinstance(task.method, PerRoom):  # which is fitted in each room
            num_fits.append(len(task.data.part(task.split.part)))
        else:
            num_fits.append(0 if task.fit_id in across else 1)
            across.add(task.fit_id)
    num_places = 1 if executor == SERIAL else int(executor) if executor.isdecimal() else None
    return Estimate(len(tasks), tuple(task.job for task in left), num_places, tuple(num_fits))


def in_hours(seconds: float) -> str:
    """A time in minutes, or in hours and minutes: `7 min`, `2 h 05 min`."""
    minutes = max(1, round(seconds / 60))
    return f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"


def _is_trivial(job: Job) -> bool:
    return job.method in EVERY_TRIVIAL
