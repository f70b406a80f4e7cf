"""What is shown while runs take place: bars of the runs and of the fit at hand, or a line for each finished run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from pathlib import Path

from xfreqbench.methods.fitting import Fit
from xfreqbench.runs.fit import FitProgress
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.system.bars import open_bars

RunProgress = Callable[[int, int, Job, RunRecord | None], None]
"""Is called with jobs done, jobs in all, the job that has ended, and its record, None where it failed."""


@contextmanager
def run_bars(quiet: bool, shows_fit: bool) -> Iterator[tuple[RunProgress | None, FitProgress | None]]:
    """The two callbacks of `run_jobs`, which show progress on stderr; with `quiet` both are None.

    The second, of the fit at hand, is None unless `shows_fit`: where several take place at once. Where bars cannot be
    drawn, as in a file, there is a line for each run that has ended, and one every ten seconds.
    """
    if quiet:
        yield None, None
        return
    with open_bars(["runs", "fitting"] if shows_fit else ["runs"]) as bars:

        def ended(done: int, total: int, job: Job, record: RunRecord | None) -> None:
            bars.show(0, done, total, f"{done} of {total} runs", f"{job.protocol} on {Path(job.dataset).name}")
            if bars.is_drawn:
                return
            result = "failed"
            if record is not None:
                fitted = "" if record.fit_seconds is None else f", {record.fit_seconds:.1f} s of fitting"
                result = f"median SSIM {record.scores['ssim'].median:.4f}{fitted}"
            line = f"{done}/{total} {job.method} on {job.split}, seed {job.seed}: {result}"
            print(line, file=sys.stderr, flush=True)

        def fitting(job: Job, fit: Fit) -> None:
            spent = fit.share or None  # of a budget; without one nobody knows when the fit ends
            bars.show(1, fit.share, 1 if spent else None, fit_state(fit), f"fitting {job.method} {job.split}")

        yield ended, fitting if shows_fit else None


def fit_state(fit: Fit) -> str:
    """How a fit stands, in words; a method that has no loss shows none."""
    loss = "" if isnan(fit.loss) else f", loss {fit.loss:.4g}"
    spent = f", {fit.share:.0%} of the budget" if fit.share else ""
    return f"step {fit.step:,}{loss}{spent}"
