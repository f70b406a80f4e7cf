"""What is shown while runs take place: a bar of the runs, and one of the fit at hand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from xfreqbench.methods.fitting import Fit
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.run import ProgressCallback
from xfreqbench.runs.watch import FittingCallback
from xfreqbench.system.bars import open_bars


@contextmanager
def run_bars(quiet: bool) -> Iterator[tuple[ProgressCallback | None, FittingCallback | None]]:
    """The two callbacks of `run_jobs`, which draw the bars on stderr; with `quiet` both are None."""
    if quiet:
        yield None, None
        return
    with open_bars(["runs", "fitting"]) as bars:

        def finished(done: int, total: int, record: RunRecord) -> None:
            title = f"{record.job.protocol} on {Path(record.job.dataset).name}"
            bars.show(0, done, total, f"{done}/{total} runs", title)

        def fitting(job: Job, fit: Fit) -> None:
            spent = f", {fit.share:.0%} of the budget" if fit.share else ""
            state = f"step {fit.step:,}, loss {fit.loss:.4g}, {fit.seconds:.0f} s{spent}"
            bars.show(1, fit.share, 1 if fit.share else None, state, f"fitting {job.method} {job.split}")

        yield finished, fitting
