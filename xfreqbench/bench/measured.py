"""Measured powers beside a scene's: how far free space, fitted laws and traced paths are from a measurement.

A measurement says nothing of absolute power (transmit power, cables, antennas), so that each model has one offset for
each receiver, which is fitted at the positions of a random tenth of the cells; everything is scored in the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from xfreqbench.bench.tables import Bench
from xfreqbench.errors import DataError, SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import ReceiverArray, Scene
from xfreqbench.scene.placement import check_inside
from xfreqbench.scene.tables import read_table
from xfreqbench.tracing.paths import DIFFRACTION, NO_INTERACTION, Paths
from xfreqbench.tracing.solvers import resolve_solver, tracer_of
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, NDArray, ProgressCallback
from xfreqbench.units import format_ghz_list

CELL_M = 0.5  # side of the blocks of space whose errors are drawn together, and over which local means are taken
NUM_NEAREST = 3


@dataclass(frozen=True, eq=False)
class Measurement:
    """Powers in dB, up to a constant for each receiver, at n positions and R receivers; nan where none was measured."""

    position_m: Float[FloatArray, "n 3"]
    power_db: Float[FloatArray, "n R"]


def read_measurement(
    path: Path, receivers: Sequence[ReceiverArray], height_m: float | None, every: int = 1
) -> Measurement:
    """A table of positions, see `read_table`, with z unless `height_m` is given, and powers in dB for each receiver.

    The column of a receiver has its name, or a name that ends in `_` and the receiver's, as `rssi_3`; a scene's lone
    receiver may have the column `power`. An empty cell, nan and -inf are not measurements. `every` is the step between
    the lines that are taken. Raises `DataError`, also for a power that repeats far from all others.
    """
    table = read_table(path)
    position_m, powers = table.position_m(height_m), list[FloatArray]()
    for receiver in receivers:
        name = receiver.name
        accepted = ("power", "power_db") if name is None else (name,)
        found = [n for n, given in enumerate(table.names) if given in accepted or (name and given.endswith(f"_{name}"))]
        if len(found) != 1:
            wanted = f"{name}, or so that it ends in _{name}" if name else "power or power_db"
            raise DataError(
                f"{path} has {len(found)} columns for {f'receiver {name}' if name else 'the power'}; its columns are "
                f"{', '.join(table.names)}. Name one {wanted}."
            )
        powers.append(table.numbers(found[0], missing=("", "nan", "-inf")))
        _require_measured(powers[-1], f"{path}, column {table.names[found[0]]},")
    power_db = np.stack(powers, axis=1)[::every]
    few = np.isfinite(power_db).sum(axis=0) < 10 * NUM_NEAREST
    if few.any():
        name = receivers[few.argmax()].name
        raise DataError(f"{path} holds fewer than {10 * NUM_NEAREST} powers{f' of receiver {name}' if name else ''}.")
    return Measurement(position_m[::every], power_db)


def _require_measured(power_db: Float[FloatArray, "n"], what: str) -> None:
    """Raise `DataError` for a highest or lowest power that stands for 'not received', most likely.

    It is more than 20 dB from all others and occurs three times, or more than 100 dB.
    """
    levels_db, counts = np.unique(power_db[np.isfinite(power_db)], return_counts=True)
    gaps_db = np.diff(levels_db)
    for end in (0, -1) if len(gaps_db) else ():
        if gaps_db[end] > (20 if counts[end] > 2 else 100):
            raise DataError(
                f"{what} holds {counts[end]} times {levels_db[end]:g} dB, which is {gaps_db[end]:g} dB from any other "
                "power. If that stands for 'not received', leave those cells empty; if it was measured, leave those "
                "lines out."
            )


def bench_measured(
    bench: Bench,
    scene: Scene,
    measurement: Measurement,
    carrier_hz: Sequence[float],
    settings: TraceSettings,
    seed: int,
    progress: ProgressCallback,
) -> None:
    """Print how far models of the power are from a measurement; see `_predictions` for the models.

    Raises `SceneError` where transmitter and receiver have one place, or no path arrives anywhere, `PlacementError`
    where all positions are outside of the scene, and `DataError` where a receiver has no power to fit.
    """
    bench.introduce()
    geometry = Geometry.of(scene)
    settings = resolve_solver(geometry, settings)
    position_m, power_db = measurement.position_m, measurement.power_db
    check_inside(scene, geometry.meshes, position_m, "Every measured position")
    cell = np.unique(np.floor(position_m / CELL_M), axis=0, return_inverse=True)[1].ravel()
    drawn = np.random.default_rng(seed).permutation(1 + cell.max())
    num_before = np.cumsum(np.bincount(cell)[drawn])
    fitted = np.isin(cell, drawn[: 1 + np.searchsorted(num_before, max(len(position_m) // 10, NUM_NEAREST))])
    for receiver, powers in zip(scene.receivers, power_db[fitted].T, strict=True):
        if not np.isfinite(powers).any():
            name = receiver.name or "the receiver"
            raise DataError(f"No position of the tenth that is fitted has a power of {name}. Give another --seed.")
    walls = np.stack(
        [_num_walls(scene, geometry, receiver, position_m, carrier_hz[0]) for receiver in scene.receivers], axis=1
    )
    predicted = _predictions(scene, geometry, measurement, carrier_hz, settings, fitted, walls, progress)
    note = (
        f"{len(position_m):,} positions × {power_db.shape[1]} receivers. Power is averaged over "
        f"{format_ghz_list(carrier_hz)}, both polarisations, and phases. Offsets are fitted in a tenth of the cells of "
        f"{CELL_M:g} m (seed {seed}), and the others are scored. In brackets are 95 % intervals by such cells, the "
        "second of the RMSE less that of multi-wall, paired. Local means are of the errors in cells; r is within a "
        "receiver."
    )
    title = f"Measured power in {scene.name}, solver {settings.solver}"
    scores = "RMSE dB", "less multi-wall", "in sight", "not in sight", "RMSE of local means", "median error dB", "r"
    error_db = {
        name: np.where(
            fitted[:, None],
            np.nan,
            model_db + np.nanmean(np.where(fitted[:, None], power_db - model_db, np.nan), axis=0) - power_db,
        )
        for name, model_db in predicted.items()
    }
    beside_db = next(errors_db for name, errors_db in error_db.items() if name.startswith("multi-wall"))
    with bench.table(title, note, ("model", *scores)) as table:
        for name, errors_db in error_db.items():
            table.add(name, *_scores(errors_db, beside_db, power_db, walls == 0, cell, seed))


def _predictions(
    scene: Scene,
    geometry: Geometry,
    measurement: Measurement,
    carrier_hz: Sequence[float],
    settings: TraceSettings,
    fitted: Bool[NDArray[np.bool_], "n"],
    walls: Float[FloatArray, "n R"],
    progress: ProgressCallback,
) -> dict[str, Float[FloatArray, "n R"]]:
    """Powers in dB, up to an offset for each receiver, by every model: those without the room come first."""
    position_m, power_db = measurement.position_m, measurement.power_db
    receiver_m = np.array([receiver.position_m for receiver in scene.receivers])
    distance_m = np.linalg.norm(position_m[:, None] - receiver_m, axis=2)
    if not distance_m.all():
        raise SceneError("A measured position is that of a receiver. Leave it out.")
    decades_db = -10 * np.log10(distance_m)
    exponent = _slope(decades_db, power_db, fitted)
    wall_db = _slope(-walls, power_db - 2 * decades_db, fitted)
    models = {
        "free space": 2 * decades_db,
        f"log-distance, fitted exponent {exponent:.2f}": exponent * decades_db,
        f"multi-wall, fitted {wall_db:.2f} dB a wall": 2 * decades_db - wall_db * walls,
        f"mean of the {NUM_NEAREST} nearest of the tenth": _nearest_db(position_m, power_db, fitted),
    }
    return models | _traced_db(scene, geometry, position_m, carrier_hz, settings, progress)


def _slope(
    regressor: Float[FloatArray, "n R"], power_db: Float[FloatArray, "n R"], fitted: Bool[NDArray[np.bool_], "n"]
) -> float:
    """Least squares of powers over a regressor at the fitted positions, with an offset for each receiver."""
    x, y = (np.where(np.isfinite(power_db), values, np.nan)[fitted] for values in (regressor, power_db))
    x, y = x - np.nanmean(x, axis=0), y - np.nanmean(y, axis=0)
    return float(np.nansum(x * y) / max(np.nansum(x * x), 1e-12))


def _nearest_db(
    position_m: Float[FloatArray, "n 3"], power_db: Float[FloatArray, "n R"], fitted: Bool[NDArray[np.bool_], "n"]
) -> Float[FloatArray, "n R"]:
    """Mean of the powers that each receiver has at the nearest fitted positions."""
    found = np.empty_like(power_db)
    for r, power in enumerate(power_db.T):
        known = np.flatnonzero(fitted & np.isfinite(power))
        near = KDTree(position_m[known]).query(position_m, k=min(NUM_NEAREST, len(known)))[1].reshape(len(power), -1)
        found[:, r] = power[known][near].mean(axis=1)
    return found


def _num_walls(
    scene: Scene, geometry: Geometry, receiver: ReceiverArray, position_m: Float[FloatArray, "n 3"], carrier_hz: float
) -> Float[FloatArray, "n"]:
    """How many surfaces the straight line from a receiver to each position passes; 16 where one is opaque."""
    settings = TraceSettings("image", ("refraction",), max_depth=16, materials="extrapolate")
    tracer = tracer_of(_alone(scene, receiver, "V"), [carrier_hz], settings, geometry)
    paths = [tracer.paths(place_m) for place_m in position_m]
    walls = [(found.interactions != NO_INTERACTION).sum() if len(found.delay_s) else 16 for found in paths]
    return np.array(walls, dtype=np.float64)


def _alone(scene: Scene, receiver: ReceiverArray, polarization: Literal["V", "H"]) -> Scene:
    """The scene with one element in the place of a receiver, isotropic and of one polarisation."""
    element = replace(receiver, rows=1, cols=1, pattern="iso", polarization=polarization, antenna_orientation_deg=None)
    return replace(scene, receiver=element, other_receivers=())


def _traced_db(
    scene: Scene,
    geometry: Geometry,
    position_m: Float[FloatArray, "n 3"],
    carrier_hz: Sequence[float],
    settings: TraceSettings,
    progress: ProgressCallback,
) -> dict[str, Float[FloatArray, "n R"]]:
    """Powers in dB by the scene's paths: Σ|gain|², the mean over some wavelengths, carriers and polarisations."""
    receivers = scene.receivers
    power: dict[str, Float[FloatArray, "n R"]] = {}
    links = traced_links(scene, geometry, receivers, [position_m] * len(receivers), carrier_hz, settings, progress)
    for r, n, paths, kept in links:
        of_path = (np.abs(paths.gain) ** 2).mean(axis=0)
        for model, is_kept in kept.items():
            power.setdefault(model, np.zeros((len(position_m), len(receivers))))[n, r] = of_path[is_kept].sum()
    if not any(each.any() for each in power.values()):
        raise SceneError("No path reaches a receiver from any measured position: these are not in this scene.")
    weakest = min(each[each > 0].min(initial=np.inf) for each in power.values())  # where no path arrives
    return {model: 10 * np.log10(np.maximum(each, weakest)) for model, each in power.items()}


def traced_links(
    scene: Scene,
    geometry: Geometry,
    receivers: Sequence[ReceiverArray],
    tx_m: Sequence[Float[FloatArray, "_ 3"]],
    carrier_hz: Sequence[float],
    settings: TraceSettings,
    progress: ProgressCallback,
) -> Iterator[tuple[int, int, Paths, dict[str, Bool[NDArray[np.bool_], "P"]]]]:
    """Numbers of receiver and transmitter, their paths, and which of these are in each model, by its name.

    Models are paths of at most 1, 2, … interactions, and those that meet no edge. Gains are those of each carrier, of
    vertical and then of horizontal antennas.
    """
    done, total = 0, sum(map(len, tx_m))
    depths = range(min(1, settings.max_depth), settings.max_depth + 1)
    for r, (receiver, places_m) in enumerate(zip(receivers, tx_m, strict=True)):
        vertical, horizontal = _alone(scene, receiver, "V"), _alone(scene, receiver, "H")
        tracer = tracer_of(vertical, carrier_hz, settings, geometry)
        both = tracer, tracer.with_antennas(horizontal)
        for n, place_m in enumerate(places_m):
            paths = Paths.joined([each.paths(place_m) for each in both])
            length = (paths.interactions != NO_INTERACTION).sum(axis=1)
            kept = {f"traced, depth {depth}": length <= depth for depth in depths}
            if "diffraction" in settings.named_interactions:
                is_diffracted = (paths.interactions == DIFFRACTION).any(axis=1)
                kept[f"traced, depth {depths[-1]}, without diffraction"] = ~is_diffracted
            yield r, n, paths, kept
            done += 1
            progress(done, total)


def _scores(
    error_db: Float[FloatArray, "n R"],
    beside_db: Float[FloatArray, "n R"],
    power_db: Float[FloatArray, "n R"],
    in_sight: Bool[NDArray[np.bool_], "n R"],
    cell: NDArray[np.int64],
    seed: int,
) -> tuple[str, ...]:
    """The cells of a model's row, behind its name; `beside_db` are the errors of the model that it is compared with."""
    num_cells = int(cell.max()) + 1
    is_scored = np.isfinite(error_db)
    counts = np.bincount(cell, is_scored.sum(axis=1), num_cells)
    drawn = drawn_cells(num_cells, seed)
    own, other = (
        np.sqrt(drawn @ np.bincount(cell, np.nansum(errors**2, axis=1), num_cells) / np.maximum(drawn @ counts, 1))
        for errors in (error_db, beside_db)
    )
    less_db = _rms(error_db[is_scored]) - _rms(beside_db[is_scored])
    (low, high), (least, most) = (np.quantile(values, [0.025, 0.975]) for values in (own, own - other))
    block = (cell[:, None] + num_cells * np.arange(error_db.shape[1]))[is_scored]  # a cell of a receiver
    num_scored = np.bincount(block)
    means = np.bincount(block, error_db[is_scored])[num_scored > 0] / num_scored[num_scored > 0]
    model_db = np.where(is_scored, error_db + power_db, np.nan)
    a, b = (values - np.nanmean(values, axis=0) for values in (model_db, np.where(is_scored, power_db, np.nan)))
    spread = np.sqrt(np.nansum(a * a) * np.nansum(b * b))
    sights = [error_db[is_scored & sight] for sight in (in_sight, ~in_sight)]
    return (
        f"{_rms(error_db[is_scored]):.2f} [{low:.2f}, {high:.2f}]",
        f"{less_db:+.2f} [{least:+.2f}, {most:+.2f}]",
        *(f"{_rms(part):.2f}" if len(part) else "–" for part in sights),
        f"{_rms(means):.2f}",
        f"{np.median(np.abs(error_db[is_scored])):.2f}",
        f"{np.nansum(a * b) / spread:.2f}" if spread else "–",
    )


def drawn_cells(number: int, seed: int) -> Int[NDArray[np.int64], "1000 C"]:
    """How often each of so many cells is drawn, of as many with replacement."""
    return np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), 1000)


def _rms(values: Float[FloatArray, "n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
