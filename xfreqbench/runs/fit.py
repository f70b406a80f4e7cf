"""The fit of a task: it goes on from its checkpoint, is saved on its way, and its learning curve is taken."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset, isolated
from xfreqbench.errors import DivergenceError, XFreqBenchError
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import Fit, fit_within, predict_checked
from xfreqbench.runs import checkpoints
from xfreqbench.runs.checkpoints import CheckpointFolder
from xfreqbench.runs.jobs import Task
from xfreqbench.runs.records import CURVE_SHARES, CurvePoint, Job, curve_positions
from xfreqbench.runs.scoring import BATCH_SIZE, median
from xfreqbench.types import FloatArray

_WARM_UP_TX, _WARM_UP_BUDGET = 12, Budget(max_seconds=1.0, max_steps=1)
FitProgress = Callable[[Job, Fit], None]


class TaskFit:
    """The fit of a task. Neither checkpoints nor the learning curve are charged to the method's time.

    `method` is what is fitted: as its newest checkpoint in `saved` has it, or untrained where there is none.
    `curve` is the learning curve so far. `fitting` is called at every step with how the fit stands, and
    `require_claim` before something is saved; it raises where another process has taken over the job.
    """

    def __init__(
        self,
        task: Task,
        saved: CheckpointFolder,
        fitting: FitProgress | None = None,
        require_claim: Callable[[], None] = lambda: None,
    ) -> None:
        self._task, self._saved, self._fitting, self._require_claim = task, saved, fitting, require_claim
        earlier = saved.read()
        self._spent = earlier.fit if earlier else None
        self._saved_s = earlier.seconds if earlier else 0.0
        self._yielded_often = earlier is not None
        self.curve = earlier.curve if earlier else ()
        self.method = saved.load(task.method) if earlier else task.new_method()

    def run(self) -> Fit:
        """Fit to the split's training rows, and return how the fit stood at its end; `curve` is then whole.

        Raises `MethodError` for whatever the method raises, and `DivergenceError`.
        """
        task = self._task
        train = task.split.training_part(task.dataset)
        is_over = self._spent is not None and self._spent.share >= 1
        if task.job.budget != Budget() and not is_over:
            self._warm_up(train)
        with task.method_errors("fit"), self._divergence_advice():
            fit = fit_within(
                self.method, train, task.job.budget, task.job.seed, spent=self._spent, observe=self._observe
            )
        if task.job.budget == Budget() or not self._yielded_often:
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
            fit_within(method, few, _WARM_UP_BUDGET, self._task.job.seed)
            method.predict(shown.tx_position_m[:1], shown.carrier_hz[:1])

    def _observe(self, before: Fit | None, now: Fit) -> None:
        self._yielded_often = before is not None
        if before is None:  # the fit has started anew
            self.curve, self._saved_s = (), 0.0
        reached = before.share if before else 0.0
        if any(reached < share <= now.share for share in CURVE_SHARES):
            self.curve += (self._point(now),)
        if now.seconds - self._saved_s >= checkpoints.CHECKPOINT_SECONDS:
            self._require_claim()
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
        dataset, split, grid = self._task.dataset, self._task.split, self._task.dataset.grid
        sampled = split.test[curve_positions(split.sha256, len(split.test))]
        scores = []
        for rows in np.split(sampled, range(BATCH_SIZE, len(sampled), BATCH_SIZE)):
            asked = dataset[rows]
            predicted = predict_checked(self.method, asked.tx_position_m, asked.carrier_hz, grid.shape)
            scores.append(ssim(predicted, dataset.pas(rows), grid))
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
