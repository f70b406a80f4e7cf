"""What is shown while runs take place: bars of the runs and of the fit at hand, or a line for each finished run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import isnan
from pathlib import Path

from xfreqbench.methods.fitting import Fit
from xfreqbench.runs import on_workers
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.run import ProgressCallback
from xfreqbench.runs.watch import FittingCallback
from xfreqbench.system.bars import Bars, open_bars
from xfreqbench.types import ignore_progress


@contextmanager
def run_bars(quiet: bool) -> Iterator[tuple[ProgressCallback | None, FittingCallback | None]]:
    """The two callbacks of `run_jobs`, which draw bars on stderr; with `quiet` both are None.

    Where bars cannot be drawn, as in a file, there is a line for each finished run instead.
    """
    if quiet:
        yield None, None
        return
    with open_bars(["runs", "fitting"]) as bars:

        def finished(done: int, total: int, record: RunRecord) -> None:
            scored = f"median SSIM {record.scores['ssim'].median:.4f}"
            fitted = "" if record.fit_seconds is None else f", {record.fit_seconds:.1f} s of fitting"
            _show_run(bars, done, total, record.job, f": {scored}{fitted}")

        def fitting(job: Job, fit: Fit) -> None:
            if bars.is_drawn:
                spent = fit.share or None  # of a budget; without one nobody knows when the fit ends
                title = f"fitting {job.method} {job.split}"
                bars.show(1, fit.share, 1 if spent else None, fit_state(fit), title)

        yield finished, fitting


@contextmanager
def worker_bar(quiet: bool) -> Iterator[on_workers.ProgressCallback]:
    """The callback of `run_on`, which draws a bar, or prints a line for each run that has ended."""
    if quiet:
        yield lambda done, total, job: ignore_progress(done, total)
        return
    with open_bars(["runs"]) as bars:
        yield lambda done, total, job: _show_run(bars, done, total, job, "")


def fit_state(fit: Fit) -> str:
    """How a fit stands, in words; a method that has no loss shows none."""
    loss = "" if isnan(fit.loss) else f", loss {fit.loss:.4g}"
    spent = f", {fit.share:.0%} of the budget" if fit.share else ""
    return f"step {fit.step:,}{loss}, {fit.seconds:.0f} s{spent}"


def _show_run(bars: Bars, done: int, total: int, job: Job, told: str) -> None:
    if bars.is_drawn:
        bars.show(0, done, total, f"{done}/{total} runs", f"{job.protocol} on {Path(job.dataset).name}")
    else:
        line = f"{done}/{total} {job.method} on {job.split}, seed {job.seed}{told}"
        print(line, file=sys.stderr, flush=True)
