"""The tables of a residual, the note that explains them, and the Markdown file that holds both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from xfreqbench.report.drawing.markdown import heading, literal, number, table, with_interval
from xfreqbench.system.files import require_own, require_space, write_text
from xfreqbench.types import FloatArray

from .residual import DRAW_SEED, Residual, rows_by_transmitter
from .true_paths import FOUND_DISTANCE_M, FOUND_TILT_RAD

_NUM_QUARTERS = 4
_SCORE_COLUMNS = ("map of", "SSIM", "in sight", "shadowed", "PSNR (dB)")
_GROUP_COLUMNS = ("transmitters", "number", "share not found", "SSIM", "in sight", "shadowed")


def score_rows(residual: Residual) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells: a row for what was predicted, and one for each selection of true paths; medians over maps."""
    in_sight = residual.samples.line_of_sight
    return _SCORE_COLUMNS, [
        (label, *_medians_by_sight(scores.ssim, in_sight), number(_median(scores.psnr), 2))
        for label, scores in residual.scores.items()
    ]


def group_rows(residual: Residual) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells: transmitters in quarters by their share of power that is not found, and by line of sight.

    A transmitter's share is the mean over its rows; a group's is the median over its transmitters, with the least
    and the greatest. Groups without a transmitter have no row.
    """
    by_transmitter = rows_by_transmitter(residual.samples)
    share = np.array([residual.share_not_found[rows].mean() for rows in by_transmitter])
    in_sight = residual.samples.line_of_sight
    is_seen = np.array([in_sight[rows[0]] for rows in by_transmitter])
    quarters = np.array_split(share.argsort(kind="stable"), _NUM_QUARTERS)
    groups = {f"quarter {index} by share not found": each for index, each in enumerate(quarters, start=1)}
    groups |= {"in sight": np.flatnonzero(is_seen), "shadowed": np.flatnonzero(~is_seen)}
    ssim = next(iter(residual.scores.values())).ssim
    cells = []
    for name, members in groups.items():
        if len(members):
            own = share[members]
            bounds = float(own.min()), float(own.max())
            rows = np.concatenate([by_transmitter[member] for member in members])
            shown = with_interval(_median(own), bounds, 4), *_medians_by_sight(ssim[rows], in_sight[rows])
            cells.append((name, str(len(members)), *shown))
    return _GROUP_COLUMNS, cells


def note(residual: Residual) -> str:
    """How the tables are to be read."""
    method, count = residual.compared.record.job.method, len(rows_by_transmitter(residual.samples))
    return (
        f"Medians over the maps of {count} tested transmitters, drawn at random with seed {DRAW_SEED}. Each true path "
        "is taken as one spherical wave with the power and the source that the array centre sees, so that even all "
        "true paths together score a little below 1. “Found planes”: every reflection lies "
        f"within {FOUND_DISTANCE_M * 1e3:g} mm + 3 std of a plane of the findings, is tilted against it by less than "
        f"{FOUND_TILT_RAD * 1e3:g} mrad, and the plane holds something there. How to read the steps: from {method} to "
        "found planes, at as many reflections as it follows, the gap is due to gains, to remaining errors of place "
        "and to images that it did not keep; from found planes to every plane, at the same number of reflections, to "
        "planes that were not found; from there to every plane, to higher orders; from there to every plane and edge, "
        "to diffraction. “Share not found”: the share of the true power that comes over edges or over paths at planes "
        "that were not found, median [least, greatest]; the SSIM beside "
        f"it is that of {method}."
    )


def write_residual(residual: Residual, path: Path) -> None:
    """Write both tables and the note as Markdown; raises what `claim` raises, and `StorageError`."""
    claim(path, residual.compared.record.id)
    title = f"# Residual of {heading(residual.compared.title)}"
    parts = [title, table(*score_rows(residual)), table(*group_rows(residual)), literal(note(residual))]
    write_text(path, "\n\n".join(parts) + "\n")


def claim(path: Path, record_id: str) -> None:
    """Raise `OutputExistsError` for a file that is not this record's residual, `StorageError` where none can be."""

    def fault_of(file: Path) -> str | None:
        first = file.read_bytes().partition(b"\n")[0].decode("utf-8", "replace")
        is_same = first.startswith("# Residual of ") and first.endswith(f"(record {record_id})")
        return None if is_same else f"was not written for record {record_id}"

    require_space(path, 1)
    require_own(path, fault_of)


def _medians_by_sight(values: Float[FloatArray, "n"], in_sight: Bool[NDArray[np.bool_], "n"]) -> list[str]:
    """Medians over all maps, over those in line of sight, and over the others."""
    return [number(_median(values[rows]), 4) for rows in (slice(None), in_sight, ~in_sight)]


def _median(values: Float[FloatArray, "n"]) -> float:
    return float(np.median(values)) if len(values) else float("nan")
