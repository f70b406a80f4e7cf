"""The check of a data set's origin: some of its samples are traced again, by its header, and compared."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.paths import SamplePaths
from xfreqbench.data.trace import Tracing, traced
from xfreqbench.errors import DataError, SceneError
from xfreqbench.scene.meshes import meshes_sha256, surface_meshes
from xfreqbench.scene.model import Scene
from xfreqbench.scene.toml_files import shipped_folder
from xfreqbench.system.workers import HERE, Workers, side_by_side
from xfreqbench.tracing.tracer import Channel
from xfreqbench.types import IntArray, NDArray
from xfreqbench.units import format_ghz

TOLERANCE = 1e-3  # a path that is a millimetre longer differs by 0.02 at 1 GHz


@dataclass(frozen=True)
class Retraced:
    """A sample that was traced again: its transmitter's index, its carrier, and its difference from the file.

    `difference` is the larger of ‖h − h′‖ / ‖h′‖, where h is the stored channel and h′ the one traced again, and
    of the greatest difference between the stored map and the map of h, whose peak is 1. Stored paths are compared by
    the channel that they give.
    """

    tx: int
    carrier_hz: float
    difference: float

    def __str__(self) -> str:
        return f"transmitter {self.tx} at {format_ghz(self.carrier_hz)} differs by {self.difference:.1e}"


def require_origin(
    dataset: PasDataset, rows: Int[IntArray, "n"], *, folder: Path | None = None, workers: Workers = HERE
) -> Retraced:
    """Trace samples of a whole data set again, those of n rows, and return the worst.

    Scene, carriers and settings are those of the header, so every mistake in writing the file is found. The scene's
    meshes are in `folder`, or where `traced_scene` looks for them. `workers` trace. Raises `DataError` if a sample
    differs by more than `TOLERANCE` or the file does not say how it was traced, and `SceneError` if the scene's meshes
    are missing.
    """
    header, num_carriers = dataset.header, dataset.header.num_carriers
    scene, carriers_hz = traced_scene(dataset, folder), tuple(header.carrier_hz.tolist())
    tracing = Tracing(scene, header.scene_sha256, carriers_hz, dataset.trace_settings, header.paths)
    rows_of = {tx: rows[rows // num_carriers == tx] for tx in np.unique(rows // num_carriers).tolist()}
    batches = ((tx, dataset.tables["tx_position_m"][tx : tx + 1]) for tx in rows_of)
    samples = [
        sample
        for (tx, _), channel in side_by_side(workers, partial(traced, tracing), batches)
        for sample in _compared(dataset, rows_of[tx], channel.result())
    ]
    worst = max(samples, key=lambda sample: (np.isnan(sample.difference), sample.difference))
    if not worst.difference <= TOLERANCE:
        raise DataError(
            f"{dataset.path} does not hold what its header says: traced again, {worst}, more than {TOLERANCE:g}. "
            "It was damaged before its hashes were computed, or other software wrote it. Generate it again."
        )
    return worst


def drawn_rows(dataset: PasDataset, number: int, seed: int = 0) -> Int[IntArray, "n"]:
    """Rows of `number` samples of a data set, or of all if there are fewer, drawn by `seed`."""
    return np.random.default_rng(seed).choice(len(dataset), min(number, len(dataset)), replace=False)


def traced_scene(dataset: PasDataset, folder: Path | None = None) -> Scene:
    """The scene that was traced, its meshes in `folder`, or next to the data, in the working folder or shipped.

    Raises `DataError` if no scene is stored, and `SceneError` if its surfaces are not those that were traced.
    """
    scene = dataset.scene
    for place in [folder] if folder else [dataset.path.parent, Path.cwd(), shipped_folder()]:
        placed = replace(scene, folder=place.absolute())
        with suppress(SceneError):
            if meshes_sha256(surface_meshes(placed)) == dataset.header.scene_sha256:
                return placed
    raise SceneError(
        f"The surfaces of scene {scene.name!r} are not those that the data were traced with"
        + (f": {scene.scene} is missing or was changed. Put it next to the data." if scene.scene else ".")
    )


def _compared(dataset: PasDataset, rows: Int[IntArray, "n"], again: Channel) -> Iterator[Retraced]:
    """Samples of one transmitter, compared with its channel at all carriers, traced again."""
    asked = dataset[rows]
    maps = dataset.beam.maps(asked.cfr, dataset.header.pas_kind)[0]
    map_differences = np.abs(asked.pas() - maps).max(axis=(1, 2))
    for row, stored, map_difference in zip(rows, asked.cfr, map_differences, strict=True):
        carrier = row % dataset.header.num_carriers
        carrier_hz = float(dataset.header.carrier_hz[carrier])
        differences = [float(map_difference), _apart(stored, again.cfr[0, carrier])]
        if again.paths is not None:
            compared = dataset.paths(row), SamplePaths.of(again.paths, int(carrier), dataset.header)
            differences.append(_apart(*(paths.impulse_response().gain.sum(axis=0) for paths in compared)))
        yield Retraced(int(row // dataset.header.num_carriers), carrier_hz, float(np.max(differences)))


def _apart(
    stored: Complex[NDArray[np.complexfloating], "M"], again: Complex[NDArray[np.complexfloating], "M"]
) -> float:
    """Distance of a channel from the one traced again, relative to that one."""
    length = np.linalg.norm(again)
    return float(np.linalg.norm(stored - again) / length) if length else float(stored.any())
