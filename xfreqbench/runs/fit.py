"""The fit of a task: it goes on from its checkpoint, is saved on its way, and its learning curve is taken."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.errors import DivergenceError, InUseError, XFreqBenchError
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import Fit, fit_within, predict_checked
from xfreqbench.runs import checkpoints
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import Task
from xfreqbench.runs.records import CURVE_SHARES, CurvePoint, Job, curve_positions
from xfreqbench.runs.scoring import BATCH_SIZE, median
from xfreqbench.types import FloatArray

_WARM_UP_TX = 12
FitProgress = Callable[[Job, Fit], None]


def fitted(
    task: Task, folder: ResultsFolder, fitting: FitProgress | None = None
) -> tuple[Any, Fit, tuple[CurvePoint, ...]]:
    """The method of a task as it is fitted, how its fit stood at its end, and its learning curve.

    It is fitted here and then stored, or it is loaded where it is stored: another job may share the fit, which is
    waited for, and a process that was killed may have left it. `fitting` is called at every step with how the fit
    stands. Raises `MethodError` for whatever the method raises, and `DivergenceError`.
    """
    stored, unfinished = folder.fitted(task.fit_id), folder.checkpoints(task.fit_id)
    while True:
        try:
            with folder.lock(task.fit_id):
                if done := stored.read():
                    return stored.load(task.method), done.fit, done.curve
                fit = _TaskFit(task, unfinished, fitting)
                ended = fit.run()
                with task.method_errors("save"):
                    stored.write(fit.method, ended, fit.curve)
                unfinished.remove()
                return fit.method, ended, fit.curve
        except InUseError:
            if task.fit_id == task.id:
                raise
            time.sleep(0.5)


class _TaskFit:
    """The fit of a task. Neither checkpoints nor the learning curve are charged to the method's time.

    `method` is what is fitted: as its newest checkpoint in `saved` has it, or untrained where there is none.
    `curve` is the learning curve so far; across rooms there is none.
    """

    def __init__(self, task: Task, saved: CheckpointFolder, fitting: FitProgress | None) -> None:
        self._task, self._saved, self._fitting = task, saved, fitting
        self._train = task.split.training_part(task.data)
        earlier = saved.read()
        self._spent = earlier.fit if earlier else None
        self._saved_s = earlier.seconds if earlier else 0.0
        self._yielded_often = earlier is not None
        self.curve = earlier.curve if earlier else ()
        self.method = saved.load(task.method) if earlier else task.new_method()

    def run(self) -> Fit:
        """Fit to the training part, and return how the fit stood at its end; `curve` is then whole."""
        task, train = self._task, self._train
        is_over = self._spent is not None and self._spent.share >= 1
        if isinstance(train, PasDataset) and task.job.budget != Budget() and not is_over:
            self._warm_up(train)
        with task.method_errors("fit"), self._divergence_advice():
            fit = fit_within(
                self.method, train, task.job.budget, task.job.seed, spent=self._spent, observe=self._observe
            )
        if task.job.budget == Budget() or not self._yielded_often or not isinstance(train, PasDataset):
            self.curve = ()
        elif not self.curve or self.curve[-1].step != fit.step:
            self.curve += (self._point(fit),)
        return fit

    def _warm_up(self, train: PasDataset) -> None:
        """Let another method of the same kind make one step and one map, so that compilation is not on the clock.

        It sees a few of the training transmitters. If it fails, the fit itself will say why.
        """
        few = replace(_few(train), other_receivers=tuple(map(_few, train.other_receivers)))
        shown = (*few.other_receivers, few)[0]
        with suppress(XFreqBenchError), self._task.method_errors("fit"):
            method = self._task.new_method()
            fit_within(method, few, Budget(max_seconds=1.0, max_steps=1), self._task.job.seed)
            method.predict(shown.tx_position_m[:1], shown.carrier_hz[:1])

    def _observe(self, before: Fit | None, now: Fit) -> None:
        self._yielded_often = before is not None
        if before is None:  # the fit has started anew
            self.curve, self._saved_s = (), 0.0
        reached = before.share if before else 0.0
        if isinstance(self._train, PasDataset) and any(reached < share <= now.share for share in CURVE_SHARES):
            self.curve += (self._point(now),)
        if now.seconds - self._saved_s >= checkpoints.CHECKPOINT_SECONDS:
            with self._task.method_errors("save"):
                self._saved.write(self.method, now, self.curve)
            self._saved_s = now.seconds
        if self._fitting:
            self._fitting(self._task.job, now)

    def _point(self, fit: Fit) -> CurvePoint:
        with self._task.method_errors("predict"):
            ssim_median = median(self._sampled_ssim())
        return CurvePoint(step=fit.step, seconds=fit.seconds, loss=fit.loss, ssim=ssim_median, share=fit.share)

    def _sampled_ssim(self) -> Float[FloatArray, "n"]:
        """SSIM of what the method now predicts for a sample of the test rows, the same sample for every method."""
        (question,) = self._task.split.questions(self._task.data)
        test = question.asked
        sampled = curve_positions(self._task.split.sha256, len(test))
        scores = []
        for rows in np.split(sampled, range(BATCH_SIZE, len(sampled), BATCH_SIZE)):
            asked = test[rows]
            predicted = predict_checked(self.method, asked.tx_position_m, asked.carrier_hz, test.grid.shape)
            scores.append(ssim(predicted, asked.pas(), test.grid))
        return np.concatenate(scores)

    @contextmanager
    def _divergence_advice(self) -> Iterator[None]:
        """Add to a divergence which job it was, and which checkpoint is left of it."""
        try:
            yield
        except DivergenceError as error:
            job, newest = self._task.job, self._saved.newest()
            left = f"its last good checkpoint is {newest}" if newest else "it has no checkpoint yet"
            raise DivergenceError(
                error.step,
                error.tensor,
                f"Method {job.method!r} diverged on split {self._task.split.name!r} with seed {job.seed}; {left}. "
                "Lower the learning rate, as in --set learning_rate=…; to start anew, delete the checkpoint.",
            ) from error


def _few(train: PasDataset) -> PasDataset:
    """A copy of the samples of the first transmitters of a training part."""
    return isolated(train[np.isin(train.tx_index, np.unique(train.tx_index)[:_WARM_UP_TX])])
