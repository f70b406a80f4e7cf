"""Records as a run stores them, with scores of one's choice."""

from __future__ import annotations

from pathlib import Path

from xfreqbench.runs.records import NUM_QUANTILES, BenchRecord, Job, RunRecord, Summary, append

SPLITS = ("lofo-2.4GHz", "lofo-24.25GHz", "lofo-77GHz")


def make_summary(median: float) -> Summary:
    spread = [median + 0.1 * (level / 100 - 0.5) for level in range(NUM_QUANTILES)]
    return Summary(
        mean=median, median=median, p10=median - 0.04, quantiles=spread, median_by_carrier_hz={"24250000000": median}
    )


def make_record(
    method: str = "nearest", ssim: float = 0.9, split: str = "lofo-24.25GHz", protocol: str = "lofo", **changes: object
) -> RunRecord:
    job = Job("data.h5", method, protocol, split, ("num_nearest=3",) if "=" in method else ())
    fields: dict[str, object] = {
        "id": f"{method}-{split}",
        "job": job,
        "dataset_sha256": "a" * 64,
        "recipe": f"1-{changes.get('dataset_sha256', 'a' * 64)}",
        "scene": "office",
        "pas_kind": "power",
        "settings": {"solver": "image", "interactions": ["specular"], "max_depth": 1},
        "split_sha256": "b" * 64,
        "protocol_version": "1",
        "metrics_version": "1",
        "config": {},
        "step": 1,
        "fit_seconds": 0.5,
        "predict_ms_per_map": 1.25,
        "peak_memory_mib": 200.0,
        "parameters": 1234,
        "num_test": 100,
        "num_without_path": 0,
        "shares_transmitters": True,
        "scores": {
            name: make_summary(ssim)
            for name in ("ssim", "ssim_wrapped", "psnr", "power_error", "aoa_error", "beam_loss")
        },
        "hardware": {"processor": "AMD EPYC", "cores": "2"},
        "software": {"numpy": "2"},
        "git_commit": None,
        "time_utc": "2026-01-01T00:00:00+00:00",
    }
    return RunRecord.model_validate(fields | changes)


def external(split: str = SPLITS[0], seed: int = 0, file: str = "a", method: str = "theirs", **changes):
    job = Job("data.h5", method, "lofo", split, seed=seed)
    unknown = {"fit_seconds": None, "predict_ms_per_map": None, "peak_memory_mib": None, "parameters": None}
    declared = {"external": {"sha256": file * 64}, "hardware": {}}
    return make_record(method, 0.9, split, job=job, id=f"{file}{split}{seed}", **(unknown | declared | changes))


def store(folder: Path, *records: RunRecord | BenchRecord) -> Path:
    """Write records into a results folder, which is made, and return it."""
    for record in records:
        append(folder / "records.jsonl", record)
    return folder
