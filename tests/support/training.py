"""Learned methods trained for a few steps, stored and loaded."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from xfreqbench.baselines.xfreq_gs_paper import XFreqGSPaper

from xfreqbench.data.dataset import PasDataset
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.learning.training import LearnedMethod

TINY = {
    "width": 8,
    "layers": 2,
    "num_gaussians": 30,
    "batch_size": 8,
    "stride": 15,
    "precision": "float32",
    "blend": "none",
}
OF_PAPER = {"ssim_window": 3, "angular_size_deg": 6.0}
DIVIDING = {"densify_every": 4, "densify_until": 1.0, "growth": 0.3, "max_gaussians": 60, "move_from": 0.0}


def tiny(method: type[LearnedMethod], **options: Any) -> LearnedMethod:
    """A method with the options of `TINY` that it has, and others."""
    known = {field.name for field in fields(method.Config)}
    chosen = {name: value for name, value in TINY.items() if name in known}
    return method(method.Config(**{**chosen, **(OF_PAPER if method is XFreqGSPaper else {}), **options}))


def trained(
    method: LearnedMethod, dataset: PasDataset, num_steps: int, end: int | None = None, seed: int = 0
) -> list[Progress]:
    """Fit up to a step, as the harness does with a budget of `end` steps: told its share at each."""
    budget = Budget(max_steps=end or num_steps)
    fit = method.fit(dataset, budget, seed)
    seen = [next(fit)]
    while seen[-1].step < num_steps:
        seen.append(fit.send(budget.share(seen[-1].step, 0.0)))
    fit.close()
    return seen


def predicted(method: LearnedMethod, dataset: PasDataset) -> NDArray[np.float32]:
    return method.predict(dataset.tx_position_m[:6], dataset.carrier_hz[:6])


def reloaded(method: LearnedMethod, folder: Path) -> LearnedMethod:
    folder.mkdir()
    method.save(folder)
    return type(method).load(folder)
