"""A folder of real runs on a small data set, for the tests of the page, and a measurement beside them."""

from __future__ import annotations

from pathlib import Path

from tests.support.leaderboard_records import make_bench
from tests.support.stored_records import SPLITS, make_record
from tests.support.stub_methods import run_jobs
from tests.support.synthetic import paper_dataset
from xfreqbench.runs.records import CurvePoint, Job, append, read

METHODS = ("nearest", "mean-over-frequency")
HOSTILE = "<img src=x onerror=alert(1)></script>"
LEARNED = ((HOSTILE, 0.7, 30.0, 3), ("slow (width=9)", 0.8, 300.0, 3), ("quick", 0.75, 4.0, 1))


def store_results(folder: Path) -> Path:
    """Two boards of trivial predictors, three methods known by their records alone, and a measurement."""
    data = paper_dataset(folder / "data.h5", num_tx=5)
    jobs = [Job(str(data.path), method, "lofo", split) for method in METHODS for split in SPLITS]
    jobs.append(Job(str(data.path), "nearest", "sparse", "sparse-24.25GHz-from-10-37GHz"))
    results = folder / "results"
    known = run_jobs(jobs, results)[0]
    for method, ssim, seconds, num_seeds in LEARNED:
        for split in SPLITS:
            for seed in range(num_seeds):
                _append_learned(results, known, method, split, seed, ssim, seconds)
    points = [{"series": "image", "label": f"{n} rays", "x": 10.0**n, "y": 1 / n} for n in (1, 2, 3)]
    figure = {"x_label": "seconds", "y_label": "error (dB)", "log_x": True, "points": points}
    rows = [("10", "1"), ("100", "0.5"), ("1000", "0.333")]
    told = make_bench(title="Error of the maps <against> time", columns=("rays", "error"), rows=rows, figure=figure)
    append(results / "records.jsonl", told)
    return results


def stored(results: Path) -> list:
    return list(read(results / "records.jsonl").records)


def _append_learned(results, known, method, split, seed, ssim, seconds) -> None:
    name, _, overrides = method.partition(" (")
    curve = [
        CurvePoint(step=n, seconds=seconds * n / 4, loss=1.0, ssim=ssim - 0.1 + n / 40, share=n / 4) for n in (1, 2, 4)
    ]
    same = ("dataset_sha256", "recipe", "scene", "settings", "metrics_version", "protocol_version")
    fields = {field: getattr(known, field) for field in same}
    fields |= {"fit_seconds": seconds + seed, "curve": curve}
    fields |= {"ssim_by_tx": [[ssim + 0.01 * (tx - 2)] for tx in range(5)]}
    record = make_record(name, ssim, split, id=f"{name}-{split}-{seed}", **fields)
    overrides = (overrides.rstrip(")"),) if overrides else ()
    job = Job(known.job.dataset, name, "lofo", split, overrides, seed)
    append(results / "records.jsonl", record.model_copy(update={"job": job}))
