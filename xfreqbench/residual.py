"""What one run's maps lack: paths off planes that it did not find, or the gains of paths off those it did.

Some of the tested transmitters are traced once more by the exact image method, and maps of their true paths, with
some left out, are scored as the predicted maps are. A reflection counts as found where a plane of the findings runs
through it, is parallel to the surface there, and holds something.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import IntArray, PasDataset
from xfreqbench.errors import DataError, OutputExistsError, XFreqBenchError
from xfreqbench.findings import Findings, FoundPlane
from xfreqbench.findings_record import ComparedFindings
from xfreqbench.findings_report import title
from xfreqbench.generate import ProgressCallback
from xfreqbench.image_method import ImageTracer, can_solve
from xfreqbench.markdown import number, table, with_interval
from xfreqbench.method import TRIVIAL
from xfreqbench.metrics import Maps, psnr, ssim
from xfreqbench.paths import REFRACTION, SPECULAR, Paths
from xfreqbench.predictions import Predictions, read_predictions
from xfreqbench.records import RECORDS_FILE, RunRecord, read
from xfreqbench.scene import ReceiverArray, Scene
from xfreqbench.scoring import BATCH_SIZE, PREDICTIONS_FOLDER
from xfreqbench.storage import require_space, storage_errors, write_text
from xfreqbench.tracing import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S

FOUND_DISTANCE_M = 0.005  # beside three standard deviations of the plane's distance
FOUND_TILT_RAD = 0.002
HELD_MARGIN_M = 0.3  # a cell: what is held is known from there to the next place that training touched
_DRAW_SEED = 0
_NUM_QUARTERS = 4
_ORDERS = (0, 1, 2, 3)
_SCORE_COLUMNS = ("map of", "SSIM", "in sight", "shadowed", "PSNR (dB)")
_GROUP_COLUMNS = ("transmitters", "number", "share not found", "SSIM", "in sight", "shadowed")


class Selection(NamedTuple):
    """Which of the true paths are kept: `max_reflections` None keeps any number of them."""

    in_found_planes: bool = False
    max_reflections: int | None = None
    transmissions: bool = True

    @property
    def label(self) -> str:
        """In words."""
        where = "found planes" if self.in_found_planes else "every plane"
        through = "" if self.transmissions else ", no transmissions"
        return f"true paths, {where}{_bound(self.max_reflections)}{through}"

    def keeps(self, kinds: PathKinds) -> Bool[NDArray[np.bool_], "P"]:
        """Whether each path is kept."""
        kept = kinds.is_found | (not self.in_found_planes)
        if self.max_reflections is not None:
            kept &= kinds.num_reflections <= self.max_reflections
        return kept & (self.transmissions | (kinds.num_transmissions == 0))


SELECTIONS = (
    Selection(),
    *(Selection(True, order) for order in (*_ORDERS, None)),
    *(Selection(True, order, False) for order in (*_ORDERS, None)),
    *(Selection(False, order) for order in _ORDERS),
)


@dataclass(frozen=True, eq=False)
class PathKinds:
    """What paths meet; `is_found` where all reflections of a path lie in planes that were found."""

    num_reflections: Int[NDArray[np.int64], "P"]
    num_transmissions: Int[NDArray[np.int64], "P"]
    is_found: Bool[NDArray[np.bool_], "P"]


@dataclass(frozen=True, eq=False)
class Scores:
    """Of maps, in the order of their rows."""

    ssim: Float[FloatArray, "n"]
    psnr: Float[FloatArray, "n"]


@dataclass(frozen=True, eq=False)
class ResidualPlan:
    """What is scored: `rows` of the data set, ascending, and stored predictions by label, the method's first."""

    compared: ComparedFindings
    settings: TraceSettings
    predictions: dict[str, Predictions]
    rows: Int[IntArray, "n"]


@dataclass(frozen=True, eq=False)
class Residual:
    """Scores by label of what was predicted and of true paths, some left out; the method's come first.

    `share_not_found` is the share of the true power, at a row's carrier, of paths off planes that were not found.
    """

    compared: ComparedFindings
    scores: dict[str, Scores]
    samples: PasDataset
    share_not_found: Float[FloatArray, "n"]


def plan_residual(results: Path, compared: ComparedFindings, num_tx: int) -> ResidualPlan:
    """Draw `num_tx` of the tested transmitters, all where there are fewer, with all their tested rows.

    `results` is the record's folder, or its file of records. Raises `XFreqBenchError` for a number below 1, and
    `DataError` where predictions are missing or another split's, or the image method doesn't take the data's scene.
    """
    if num_tx < 1:
        raise XFreqBenchError(f"--tx takes a number of transmitters from 1 on, but got {num_tx}.")
    settings = _settings_of(compared)
    folder = results if results.is_dir() else results.parent
    predictions = {
        f"{compared.record.job.method}, as predicted": _predictions_of(compared.record, folder),
        **{
            f"{record.job.method}, the best trivial predictor": _predictions_of(record, folder)
            for record in _best_trivial(compared.record, folder, results)
        },
    }
    tested = next(iter(predictions.values())).rows
    return ResidualPlan(compared, settings, predictions, _drawn(tested, compared.dataset, num_tx))


def take_apart(plan: ResidualPlan, tracing: ProgressCallback, scoring: ProgressCallback) -> Residual:
    """Trace the drawn transmitters, then score all maps; the callbacks are told transmitters done and in all."""
    samples = plan.compared.dataset.subset(plan.rows)
    channels, share_not_found = _channels(plan, samples, tracing)
    stored = {label: each.maps_of(plan.rows, BATCH_SIZE) for label, each in plan.predictions.items()}
    labels = [*stored, *(selection.label for selection in SELECTIONS)]
    scored: dict[str, list[Scores]] = {label: [] for label in labels}
    for done, rows in enumerate(transmitters := _rows_by_transmitter(samples), start=1):
        truth = samples.pas(rows)
        derived = samples.beam.maps(channels[rows].reshape(-1, channels.shape[-1]), samples.header.pas_kind)[
            0
        ]
        by_selection = derived.reshape(len(rows), len(SELECTIONS), *truth.shape[1:]).swapaxes(0, 1)
        maps = [*(each[rows] for each in stored.values()), *by_selection]
        for label, predicted in zip(labels, maps, strict=True):
            scored[label].append(_scores(predicted, truth, samples))
        scoring(done, len(transmitters))
    return Residual(
        plan.compared, {label: _joined(parts) for label, parts in scored.items()}, samples, share_not_found
    )


def path_kinds(paths: Paths, tx_position_m: Float[FloatArray, "3"], findings: Findings) -> PathKinds:
    """What the paths of one transmitter meet, and which of them meet planes that were found alone."""
    is_reflection = paths.interactions == SPECULAR
    point_m, normal = _reflections(paths, tx_position_m, findings.array_m)
    is_bounce = np.arange(is_reflection.shape[1]) < is_reflection.sum(axis=1, keepdims=True)
    is_shown = np.zeros_like(is_bounce)
    for plane in findings.planes:
        is_shown |= _shows(plane, point_m, normal, findings.array_m)
    return PathKinds(
        is_reflection.sum(axis=1),
        (paths.interactions == REFRACTION).sum(axis=1),
        (is_shown | ~is_bounce).all(axis=1),
    )


def spherical_waves(
    paths: Paths, carrier: int, receiver: ReceiverArray
) -> Complex[NDArray[np.complex128], "P M"]:
    """Channel of each path at the elements: a spherical wave whose gain and source are those at the array centre.

    `carrier` is the index among the paths' carriers. Power and polarisation are the same at all elements.
    """
    carrier_hz = float(paths.carrier_hz[carrier])
    element_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz) - np.asarray(receiver.position_m)
    source_m = (paths.delay_s * SPEED_OF_LIGHT_M_S)[:, None] * paths.arrival
    length_m = np.linalg.norm(source_m[:, None] - element_m, axis=-1)
    further_s = length_m / SPEED_OF_LIGHT_M_S - paths.delay_s[:, None]
    turns = (carrier_hz * paths.delay_s % 1.0)[:, None] + carrier_hz * further_s
    return paths.gain[carrier][:, None] * np.exp(-2j * np.pi * turns)


def score_rows(residual: Residual) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells: a row for what was predicted, and for each selection of true paths; medians over maps."""
    in_sight = residual.samples.line_of_sight
    return _SCORE_COLUMNS, [
        (
            label,
            *(number(_median(scores.ssim[here]), 4) for here in (slice(None), in_sight, ~in_sight)),
            number(_median(scores.psnr), 2),
        )
        for label, scores in residual.scores.items()
    ]


def group_rows(residual: Residual) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells: transmitters in quarters by the share that was not found, and by line of sight.

    A quarter's share is the median over its transmitters, each the mean over its rows, with the least and most.
    """
    return _GROUP_COLUMNS, [
        _group_row(name, members, residual) for name, members in _groups(residual) if len(members)
    ]


def note(residual: Residual) -> str:
    """How the tables are to be read."""
    method, count = residual.compared.record.job.method, len(_rows_by_transmitter(residual.samples))
    return (
        f"Medians over the maps of {count} tested transmitters, drawn at random with seed {_DRAW_SEED}. True paths "
        "are one spherical wave each at the array centre, which is what keeps all of them from 1. “Found planes”: "
        f"every reflection lies within {FOUND_DISTANCE_M * 1e3:g} mm + 3 std of a plane of the findings, tilted by "
        f"less than {FOUND_TILT_RAD * 1e3:g} mrad, where that holds something. The gap from {method} to found planes, "
        "at as many reflections as it follows, is gains, with errors of place that are left and images that it did not "
        "keep; from found planes to every plane, at the same number, planes not found; from there to all true paths, "
        "orders. “Share not found”: of the true power, what paths off planes that were not found carry, median [least, "
        f"most]; the SSIM beside it is that of {method}."
    )


def write_residual(residual: Residual, path: Path) -> None:
    """Write both tables and the note as Markdown; raises as `claim`, and `StorageError`."""
    claim(path, residual.compared.record.id)
    tables = table(*score_rows(residual)), table(*group_rows(residual))
    write_text(path, "\n\n".join([_heading(residual.compared), *tables, note(residual)]) + "\n")


def claim(path: Path, record_id: str) -> None:
    """Raise `OutputExistsError` for a file that is no residual of this record, `StorageError` where none can be."""
    require_space(path, 1)
    with storage_errors(path):
        is_foreign = path.exists() and not _is_residual_of(path, record_id)
    if is_foreign:
        raise OutputExistsError(
            f"{path} exists and was not written for record {record_id}. Choose another file with -o, or delete it."
        )


def _bound(max_reflections: int | None) -> str:
    if max_reflections is None:
        return ""
    plural = "" if max_reflections == 1 else "s"
    return f", {max_reflections} reflection{plural} at most" if max_reflections else ", no reflections"


def _heading(compared: ComparedFindings) -> str:
    return f"# Residual of {title(compared)}"


def _is_residual_of(path: Path, record_id: str) -> bool:
    first = path.read_bytes().partition(b"\n")[0].decode("utf-8", "replace")
    return first.startswith("# Residual of ") and first.endswith(f"(record {record_id})")


def _settings_of(compared: ComparedFindings) -> TraceSettings:
    """What was asked of the rays, where the image method can be asked for it."""
    dataset = compared.dataset
    names = {field.name for field in fields(TraceSettings)}
    told = {name: value for name, value in dataset.header.settings.items() if name in names}
    try:
        settings = TypeAdapter(TraceSettings).validate_python(told)
    except ValidationError as error:
        raise DataError(f"{dataset.path} does not say how it was traced. Generate it anew.") from error
    if not can_solve(compared.meshes, settings):
        raise DataError(
            f"{dataset.path} was traced with {', '.join(settings.interactions)} to depth {settings.max_depth}, but "
            "exact paths are known for specular and refraction among planar facets alone. Use a data set of "
            "`xfreqbench generate --solver image`."
        )
    return settings


def _predictions_of(record: RunRecord, folder: Path) -> Predictions:
    path = _predictions_path(record, folder)
    if not path.exists():
        raise DataError(
            f"The predictions of record {record.id} are not at {path}. Run the same `xfreqbench run` again, which "
            "stores them, or choose another record with --id."
        )
    predictions = read_predictions(path)
    if (predictions.dataset_sha256, predictions.split_sha256) != _tested(record):
        raise DataError(f"{path} holds predictions of another split. Delete it and run again.")
    return predictions


def _predictions_path(record: RunRecord, folder: Path) -> Path:
    return folder / PREDICTIONS_FOLDER / f"{record.id}.h5"


def _tested(record: RunRecord) -> tuple[str, str]:
    return record.dataset_sha256, record.split_sha256


def _best_trivial(record: RunRecord, folder: Path, results: Path) -> list[RunRecord]:
    """The trivial predictor with the largest median SSIM on the same split, of those whose predictions are there."""
    known = read(results / RECORDS_FILE if results.is_dir() else results).records
    there = [
        each
        for each in known
        if each.job.method in TRIVIAL
        and not each.job.overrides
        and each.external is None
        and _tested(each) == _tested(record)
        and _predictions_path(each, folder).exists()
    ]
    return sorted(there, key=lambda each: each.scores["ssim"].median)[-1:]


def _drawn(tested: Int[IntArray, "N"], dataset: PasDataset, num_tx: int) -> Int[IntArray, "n"]:
    """Rows of some of the tested transmitters, ascending."""
    tx = tested // dataset.num_carriers
    known = np.unique(tx)
    chosen = np.random.default_rng(_DRAW_SEED).permutation(known)[:num_tx]
    return np.sort(tested[np.isin(tx, chosen)])


def _rows_by_transmitter(samples: PasDataset) -> list[Int[IntArray, "f"]]:
    """Positions among the samples, which ascend, of each transmitter's."""
    starts = np.flatnonzero(np.diff(samples.tx_index)) + 1
    return np.split(np.arange(len(samples)), starts)


def _channels(
    plan: ResidualPlan, samples: PasDataset, progress: ProgressCallback
) -> tuple[Complex[NDArray[np.complex128], "n S M"], Float[FloatArray, "n"]]:
    """Channels of each row and selection, and each row's share of power that was not found."""
    scene = TypeAdapter(Scene).validate_json(samples.header.scene_json)
    tracer = ImageTracer(scene, samples.header.carrier_hz.tolist(), plan.settings)
    channels = np.zeros((len(samples), len(SELECTIONS), scene.receiver.num_elements), np.complex128)
    share = np.zeros(len(samples))
    for done, rows in enumerate(transmitters := _rows_by_transmitter(samples), start=1):
        tx_m = samples.tx_position_m[rows[0]].astype(np.float64)
        paths = tracer.paths(tx_m)
        kinds = path_kinds(paths, tx_m, plan.compared.findings)
        kept = np.array([selection.keeps(kinds) for selection in SELECTIONS])
        for row, carrier in zip(rows, samples.rows[rows] % samples.num_carriers, strict=True):
            channels[row] = kept @ spherical_waves(paths, int(carrier), scene.receiver)
            share[row] = _share(np.abs(paths.gain[carrier]) ** 2, ~kinds.is_found)
        progress(done, len(transmitters))
    return channels, share


def _share(power: Float[FloatArray, "P"], part: Bool[NDArray[np.bool_], "P"]) -> float:
    return float(power[part].sum() / (power.sum() or 1.0))


def _reflections(
    paths: Paths, tx_position_m: Float[FloatArray, "3"], array_m: Float[FloatArray, "3"]
) -> tuple[Float[FloatArray, "P D 3"], Float[FloatArray, "P D 3"]]:
    """Where paths reflect, and the unit normals there, along the turn of the path; zeros after the last reflection.

    Refraction doesn't turn a path, so corners are those of its reflections alone.
    """
    is_reflection = paths.interactions == SPECULAR
    num_paths, depth = is_reflection.shape
    corner_m = np.empty((num_paths, depth + 2, 3))
    corner_m[:, 0], corner_m[:, 1:] = tx_position_m, array_m
    path, place = np.nonzero(is_reflection)
    corner_m[path, is_reflection.cumsum(axis=1)[path, place]] = paths.vertices_m[path, place]
    turn = np.diff(_unit(np.diff(corner_m, axis=1)), axis=1)
    is_bounce = np.arange(depth) < is_reflection.sum(axis=1, keepdims=True)
    return corner_m[:, 1:-1] * is_bounce[..., None], _unit(turn * is_bounce[..., None])


def _unit(vector: Float[FloatArray, "*S 3"]) -> Float[FloatArray, "*S 3"]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length == 0, 1.0, length)


def _shows(
    plane: FoundPlane,
    point_m: Float[FloatArray, "*S 3"],
    normal: Float[FloatArray, "*S 3"],
    array_m: Float[FloatArray, "3"],
) -> Bool[NDArray[np.bool_], "*S"]:
    """Whether a found plane runs through points of surfaces with those normals, and holds something there."""
    if plane.corners_m is None:
        return np.zeros(point_m.shape[:-1], bool)
    away_m = np.abs((point_m - array_m) @ plane.unit_normal - plane.distance_m)
    tilt_rad = np.linalg.norm(np.cross(normal, plane.unit_normal), axis=-1)  # whichever side is met
    beside_m = _distance_m(point_m, np.array(plane.corners_m))
    is_near = away_m < FOUND_DISTANCE_M + 3 * plane.distance_std_m
    return is_near & (tilt_rad < FOUND_TILT_RAD) & (beside_m <= HELD_MARGIN_M)


def _distance_m(
    point_m: Float[FloatArray, "*S 3"], corners_m: Float[FloatArray, "4 3"]
) -> Float[FloatArray, "*S"]:
    """From a rectangle, its corners in turn; it may have no area."""
    offset_m = point_m - corners_m[0]
    nearest_m = np.zeros_like(offset_m)
    for edge_m in (corners_m[1] - corners_m[0], corners_m[3] - corners_m[0]):
        along = offset_m @ edge_m / (edge_m @ edge_m or 1.0)
        nearest_m += along.clip(0, 1)[..., None] * edge_m
    return np.linalg.norm(offset_m - nearest_m, axis=-1)


def _scores(predicted: Float[Maps, "f E A"], truth: Float[Maps, "f E A"], samples: PasDataset) -> Scores:
    return Scores(ssim(predicted, truth, samples.grid), psnr(predicted, truth, samples.grid))


def _joined(parts: Sequence[Scores]) -> Scores:
    return Scores(
        np.concatenate([each.ssim for each in parts]), np.concatenate([each.psnr for each in parts])
    )


def _groups(residual: Residual) -> list[tuple[str, Int[IntArray, "k"]]]:
    """Names, and transmitters by their places in the order of their indices."""
    by_transmitter = _rows_by_transmitter(residual.samples)
    order = _share_of_transmitters(residual).argsort(kind="stable")
    is_seen = np.array([residual.samples.line_of_sight[rows[0]] for rows in by_transmitter])
    quarters = np.array_split(order, _NUM_QUARTERS)
    return [
        *((f"quarter {index} by share not found", each) for index, each in enumerate(quarters, start=1)),
        ("in sight", np.flatnonzero(is_seen)),
        ("shadowed", np.flatnonzero(~is_seen)),
    ]


def _share_of_transmitters(residual: Residual) -> Float[FloatArray, "T"]:
    rows = _rows_by_transmitter(residual.samples)
    return np.array([residual.share_not_found[each].mean() for each in rows])


def _group_row(name: str, members: Int[IntArray, "k"], residual: Residual) -> tuple[str, ...]:
    share = _share_of_transmitters(residual)[members]
    by_transmitter = _rows_by_transmitter(residual.samples)
    rows = np.concatenate([by_transmitter[member] for member in members])
    values, in_sight = next(iter(residual.scores.values())).ssim[rows], residual.samples.line_of_sight[rows]
    return (
        name,
        str(len(members)),
        with_interval(_median(share), (float(share.min()), float(share.max())), 4),
        *(number(_median(values[here]), 4) for here in (slice(None), in_sight, ~in_sight)),
    )


def _median(values: Float[FloatArray, "n"]) -> float:
    return float(np.median(values)) if len(values) else float("nan")
