"""What one run's maps lack: the paths at planes that it did not find, or the gains of the paths at those it did.

Some of the tested transmitters are traced once more by the exact image method. Maps of their true paths, with some
paths left out, are scored in the same way as the predicted maps. A reflection counts as found where a plane of the
findings runs through its point, is parallel to the surface there, and holds something.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from xfreqbench import load_predictions, read_records
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.maps.metrics import psnr, ssim
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.scene.facets import Geometry
from xfreqbench.system.files import write_text
from xfreqbench.tracing.image.tracer import ImageTracer, can_solve
from xfreqbench.tracing.paths import DIFFRACTION, REFRACTION, SPECULAR, Paths, spherical_waves
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray, Maps, NDArray, ProgressCallback

from ..search.planes import Vector
from ..stored import FoundPlane, StoredFindings
from .compared import ComparedFindings
from .text import Table, claim, literal, number, table

FOUND_DISTANCE_M = 0.005  # added to three standard deviations of the plane's distance
FOUND_TILT_RAD = 0.002
HELD_MARGIN_M = 0.3  # one cell: what a plane holds is not known more finely


@dataclass(frozen=True, eq=False)
class PathKinds:
    """What each of P paths meets; `is_found` where all reflections of a path are found."""

    num_reflections: Int[NDArray[np.int64], "P"]
    num_transmissions: Int[NDArray[np.int64], "P"]
    is_diffracted: Bool[NDArray[np.bool_], "P"]
    is_found: Bool[NDArray[np.bool_], "P"]


def selections(kinds: PathKinds) -> dict[str, Bool[NDArray[np.bool_], "P"]]:
    """Which true paths each row of the table keeps, by its words: `true paths, found planes, 1 reflection at most`."""
    every, plain, straight = np.ones_like(kinds.is_found), ~kinds.is_diffracted, kinds.num_transmissions == 0
    bounds = "no reflections", "1 reflection at most", "2 reflections at most", "3 reflections at most"
    few = {f", {words}": kinds.num_reflections <= order for order, words in enumerate(bounds)}
    kept = {"every plane and edge": every, "every plane": plain}
    for through, passes in (("", every), (", no transmissions", straight)):
        for words, is_few in {**few, "": every}.items():
            kept[f"found planes{words}{through}"] = kinds.is_found & plain & is_few & passes
    kept |= {f"every plane{words}": plain & is_few for words, is_few in few.items()}
    return {f"true paths, {where}": own for where, own in kept.items()}


def path_kinds(paths: Paths, tx_position_m: Vector, findings: StoredFindings) -> PathKinds:
    """What the paths of one transmitter meet, and which of them reflect at found planes alone."""
    point_m, normal, is_reflection = _reflections(paths, tx_position_m, findings.array_m)
    is_found = np.zeros_like(is_reflection)
    for plane in findings.planes:
        is_found |= _is_on(plane, point_m, normal, findings.array_m)
    return PathKinds(
        (paths.interactions == SPECULAR).sum(axis=1),
        (paths.interactions == REFRACTION).sum(axis=1),
        (paths.interactions == DIFFRACTION).any(axis=1),
        np.asarray((is_found | ~is_reflection).all(axis=1)),
    )


def _reflections(
    paths: Paths, tx_position_m: Vector, array_m: Vector
) -> tuple[Float[FloatArray, "P D 3"], Float[FloatArray, "P D 3"], Bool[NDArray[np.bool_], "P D"]]:
    """Points where paths reflect, the unit normals there, and which of the D places are reflections at all.

    The places of a path's corners come first, in turn: its reflections and its edge; all but reflections are zeros.
    A refraction does not turn a path, so it makes no corner.
    """
    is_corner = np.isin(paths.interactions, (SPECULAR, DIFFRACTION))
    num_paths, depth = is_corner.shape
    corner_m = np.empty((num_paths, depth + 2, 3))
    corner_m[:, 0], corner_m[:, 1:] = tx_position_m, array_m
    path, place = np.nonzero(is_corner)
    corner = is_corner.cumsum(axis=1)[path, place]
    corner_m[path, corner] = paths.vertices_m[path, place]
    is_reflection = np.zeros_like(is_corner)
    is_reflection[path, corner - 1] = paths.interactions[path, place] == SPECULAR
    turn = np.diff(_unit(np.diff(corner_m, axis=1)), axis=1)
    is_there = is_reflection[..., None]
    return corner_m[:, 1:-1] * is_there, _unit(turn * is_there), is_reflection


def _unit(vector: Float[FloatArray, "*S 3"]) -> Float[FloatArray, "*S 3"]:
    """Vectors of length 1; a zero vector stays zero."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length == 0, 1.0, length)


def _is_on(
    plane: FoundPlane, point_m: Float[FloatArray, "*S 3"], normal: Float[FloatArray, "*S 3"], array_m: Vector
) -> Bool[NDArray[np.bool_], "*S"]:
    """Whether points of surfaces with these normals lie on a found plane, where the plane holds something."""
    if plane.corners_m is None:
        return np.zeros(point_m.shape[:-1], bool)
    away_m = np.abs((point_m - array_m) @ plane.unit_normal - plane.distance_m)
    tilt_rad = np.linalg.norm(np.cross(normal, plane.unit_normal), axis=-1)  # either side may be met
    beside_m = _distance_m(point_m, np.array(plane.corners_m))
    is_near = away_m < FOUND_DISTANCE_M + 3 * plane.distance_std_m
    return is_near & (tilt_rad < FOUND_TILT_RAD) & (beside_m <= HELD_MARGIN_M)


def _distance_m(point_m: Float[FloatArray, "*S 3"], corners_m: Float[FloatArray, "4 3"]) -> Float[FloatArray, "*S"]:
    """Distance of points from a rectangle, whose corners are given in turn; it may have no area."""
    offset_m = point_m - corners_m[0]
    nearest_m = np.zeros_like(offset_m)
    for edge_m in (corners_m[1] - corners_m[0], corners_m[3] - corners_m[0]):
        along = offset_m @ edge_m / (edge_m @ edge_m or 1.0)
        nearest_m += along.clip(0, 1)[..., None] * edge_m
    return np.linalg.norm(offset_m - nearest_m, axis=-1)


DRAW_SEED = 0


@dataclass(frozen=True, eq=False)
class ResidualPlan:
    """What is scored: drawn `samples` of the data set, and maps of them by label, those of the method first."""

    compared: ComparedFindings
    settings: TraceSettings
    samples: PasDataset
    predicted: dict[str, Maps]


@dataclass(frozen=True, eq=False)
class Residual:
    """SSIM and PSNR by label, of what was predicted and of true paths with some left out; the method's come first.

    `share_not_found` is the share of the true power, at a row's carrier, that comes over edges or over paths which are
    not found.
    """

    compared: ComparedFindings
    samples: PasDataset
    scores: dict[str, Float[FloatArray, "2 n"]]
    share_not_found: Float[FloatArray, "n"]


def plan_residual(results: Path, compared: ComparedFindings, num_tx: int) -> ResidualPlan:
    """Draw `num_tx` of the tested transmitters, all where there are fewer, with all their tested rows.

    `results` is the record's folder, or its file of records. Raises `XFreqBenchError` for a number below 1, and
    `DataError` where predictions are missing or another split's, or where the image method cannot trace the scene.
    """
    if num_tx < 1:
        raise XFreqBenchError(f"--tx takes a number of transmitters from 1 on, but got {num_tx}.")
    dataset, record = compared.dataset, compared.record
    settings = dataset.trace_settings
    if not can_solve(Geometry(compared.meshes), settings):
        raise DataError(
            f"{dataset.path} was traced with {', '.join(settings.named_interactions)} to depth "
            f"{settings.max_depth}, but exact paths are known for specular, refraction and diffraction among planar "
            "facets alone. Use a data set of `xfreqbench generate --solver image`."
        )
    tested = find_split(dataset, record.job.protocol, record.job.split).test
    rows = drawn_rows(dataset, tested, num_tx)
    predicted = {f"{record.job.method}, as predicted": load_predictions(results, record, rows.tolist())}
    trivial = [
        other
        for other in read_records(results)
        if other.job.method in EVERY_TRIVIAL
        and not other.job.overrides
        and other.external is None
        and (other.dataset_sha256, other.split_sha256) == (record.dataset_sha256, record.split_sha256)
    ]
    for other in sorted(trivial, key=lambda other: -other.scores["ssim"].median):
        with suppress(DataError):  # its predictions were not kept
            label = f"{other.job.method}, the best trivial predictor"
            predicted[label] = load_predictions(results, other, rows.tolist())
            break
    return ResidualPlan(compared, settings, dataset[rows], predicted)


def drawn_rows(dataset: PasDataset, tested: Int[IntArray, "n"], num_tx: int) -> Int[IntArray, "m"]:
    """The tested rows of `num_tx` transmitters that are drawn at random, of all where there are fewer; ascending."""
    tx = tested // dataset.header.num_carriers
    chosen = np.random.default_rng(DRAW_SEED).permutation(np.unique(tx))[:num_tx]
    return np.sort(tested[np.isin(tx, chosen)])


def compute_residual(plan: ResidualPlan, tracing: ProgressCallback, scoring: ProgressCallback) -> Residual:
    """Trace the drawn transmitters, then score all maps; the callbacks get transmitters done and their number."""
    samples = plan.samples
    true_labels, channels, share_not_found = _channels(plan, tracing)
    labels = [*plan.predicted, *true_labels]
    scores = {label: np.empty((2, len(samples))) for label in labels}
    for done, rows in enumerate(transmitters := rows_by_transmitter(samples), start=1):
        truth = samples.pas(rows)
        of_channels = channels[rows].reshape(-1, channels.shape[-1])
        derived = samples.beam.maps(of_channels, samples.header.pas_kind)[0]
        by_selection = derived.reshape(len(rows), len(true_labels), *truth.shape[1:]).swapaxes(0, 1)
        maps = [*(predicted[rows] for predicted in plan.predicted.values()), *by_selection]
        for label, shown in zip(labels, maps, strict=True):
            scores[label][:, rows] = ssim(shown, truth, samples.grid), psnr(shown, truth, samples.grid)
        scoring(done, len(transmitters))
    return Residual(plan.compared, samples, scores, share_not_found)


def rows_by_transmitter(samples: PasDataset) -> list[Int[IntArray, "f"]]:
    """The places of each transmitter's rows among the samples, whose rows ascend."""
    starts = np.flatnonzero(np.diff(samples.tx_index)) + 1
    return np.split(np.arange(len(samples)), starts)


def _channels(
    plan: ResidualPlan, progress: ProgressCallback
) -> tuple[list[str], Complex[NDArray[np.complex128], "n S M"], Float[FloatArray, "n"]]:
    """Words of the selections, channel of each row and selection, and each row's share of power that is not found."""
    samples, scene = plan.samples, plan.samples.scene
    tracer = ImageTracer(scene, samples.header.carrier_hz.tolist(), plan.settings)
    labels, channels, share = list[str](), [], np.zeros(len(samples))
    for done, rows in enumerate(transmitters := rows_by_transmitter(samples), start=1):
        tx_m = samples.tx_position_m[rows[0]].astype(np.float64)
        paths = tracer.paths(tx_m)
        kinds = path_kinds(paths, tx_m, plan.compared.findings)
        labels, kept = map(list, zip(*selections(kinds).items(), strict=True))
        for row, carrier in zip(rows, samples.rows[rows] % samples.header.num_carriers, strict=True):
            channels.append(np.array(kept) @ spherical_waves(paths, int(carrier), scene.receiver))
            power = np.abs(paths.gain[carrier]) ** 2
            is_left = kinds.is_diffracted | ~kinds.is_found
            share[row] = power[is_left].sum() / (power.sum() or 1.0)
        progress(done, len(transmitters))
    return labels, np.array(channels), share


def score_rows(residual: Residual) -> Table:
    """A row for what was predicted, and one for each selection of true paths; medians over maps."""
    in_sight = residual.samples.tables["line_of_sight"][residual.samples.tx_index]
    return ("map of", "SSIM", "in sight", "shadowed", "PSNR (dB)"), [
        (label, *_medians_by_sight(ssim, in_sight), number(_median(psnr), 2))
        for label, (ssim, psnr) in residual.scores.items()
    ]


def group_rows(residual: Residual) -> Table:
    """Transmitters in quarters by their share of power that is not found, and by line of sight.

    A transmitter's share is the mean over its rows; a group's is the median over its transmitters, with the least
    and the greatest. Groups without a transmitter have no row.
    """
    by_transmitter = rows_by_transmitter(residual.samples)
    share = np.array([residual.share_not_found[rows].mean() for rows in by_transmitter])
    in_sight = residual.samples.tables["line_of_sight"][residual.samples.tx_index]
    is_seen = np.array([in_sight[rows[0]] for rows in by_transmitter])
    quarters = np.array_split(share.argsort(kind="stable"), 4)
    groups = {f"quarter {index} by share not found": rows for index, rows in enumerate(quarters, start=1)}
    groups |= {"in sight": np.flatnonzero(is_seen), "shadowed": np.flatnonzero(~is_seen)}
    ssim = next(iter(residual.scores.values()))[0]
    cells = []
    for name, members in groups.items():
        if len(members):
            own = share[members]
            rows = np.concatenate([by_transmitter[member] for member in members])
            shown = f"{_median(own):.4f} ({own.min():.4f} to {own.max():.4f})"
            cells.append((name, str(len(members)), shown, *_medians_by_sight(ssim[rows], in_sight[rows])))
    return ("transmitters", "number", "share not found", "SSIM", "in sight", "shadowed"), cells


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
        "that were not found, median (least to greatest); the SSIM beside "
        f"it is that of {method}."
    )


def claim_residual(compared: ComparedFindings, path: Path) -> None:
    """Raise `OutputExistsError` for a file that is not this record's residual, `StorageError` where none can be."""
    claim(compared.record.id, _title(compared), path)


def write_residual(residual: Residual, path: Path) -> str:
    """Write both tables and how to read them as Markdown; raises what `claim_residual` raises. Returns the text."""
    claim_residual(residual.compared, path)
    parts = [_title(residual.compared), table(*score_rows(residual)), table(*group_rows(residual)), note(residual)]
    write_text(path, text := "\n\n".join(parts) + "\n")
    return text


def _title(compared: ComparedFindings) -> str:
    return f"# Residual of {literal(compared.title)}"


def _medians_by_sight(values: Float[FloatArray, "n"], in_sight: Bool[NDArray[np.bool_], "n"]) -> list[str]:
    """Medians over all maps, over those in line of sight, and over the others."""
    return [number(_median(values[rows]), 4) for rows in (slice(None), in_sight, ~in_sight)]


def _median(values: Float[FloatArray, "n"]) -> float:
    return float(np.median(values)) if len(values) else float("nan")
