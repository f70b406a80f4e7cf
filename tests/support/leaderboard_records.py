"""Records for whole leaderboards, and the rows of their tables read back from Markdown."""

from __future__ import annotations

import numpy as np

from tests.support.stored_records import SPLITS, make_record
from xfreqbench.methods.contract import Budget
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.report import report_markdown
from xfreqbench.runs.records import BenchFigure, BenchPoint, BenchRecord, CurvePoint


def leaderboard_markdown(records, benches=()):
    """What a report says of records and measurements."""
    return report_markdown(boards(records), benches)


def make_records():
    ssim = {"line-of-sight": 0.8, "nearest": 0.85, "mean-over-frequency": 0.9, "log-frequency": 0.88, "ours": 0.95}
    return [make_record(method, value, split) for split in SPLITS for method, value in ssim.items()]


def rows_of(markdown, method):
    """Rows of a method in the order of their tables, each by its table's header."""
    header: list[str] = []
    found = []
    for line in markdown.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")] if line.startswith("|") else []
        header = header if cells and header else cells
        if method in cells[:2]:
            found.append(dict(zip(header, cells, strict=True)))
    return found


def with_job(record, **changes):
    return record.model_copy(update={"job": record.job.__class__(**{**vars(record.job), **changes})})


def of_three_seeds(method, shift, first):
    """Records whose samples differ between transmitters alike for every method."""
    records = []
    for seed in range(3):
        place = np.random.default_rng(0).normal(0.8, 0.02, 50)
        noise = np.random.default_rng(first + seed).normal(shift, 0.002, 50)
        ssim = np.round(place + noise, 4)
        record = make_record(method, float(np.median(ssim)), ssim_by_tx=[(float(value),) for value in ssim])
        records.append(with_job(record, seed=seed))
    return records


def make_followed(method="ours", seed=0, end=0.7):
    """A fit of 64 steps with a learning curve that has no point at half of its shares."""
    points = [
        CurvePoint(step=step, seconds=step / 10, loss=0.1, ssim=ssim, share=step / 64)
        for step, ssim in ((1, 0.5), (9, 0.6), (64, end))
    ]
    record = make_record(method, 0.7, SPLITS[0], curve=points)
    return with_job(record, budget=Budget(max_steps=64), seed=seed)


def make_bench(bench="generate", title="Error against run time", **changes):
    points = [BenchPoint(series="image", label=f"depth {x}", x=x, y=40 + x) for x in (1, 2)]
    fields = {
        "bench": bench,
        "title": title,
        "command": f"xfreqbench bench {bench}",
        "note": "Two columns.",
        "columns": ("setting", "ms"),
        "rows": (("image", "1.5"),),
        "figure": BenchFigure(x_label="ms a sample", y_label="PSNR (dB)", log_x=True, points=tuple(points)),
        "hardware": {"processor": "AMD EPYC", "cores": "2"},
        "software": {},
        "git_commit": "0123456789",
        "time_utc": "2026-01-01T00:00:00+00:00",
    }
    return BenchRecord.model_validate(fields | changes)
