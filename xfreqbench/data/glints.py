"""The paths that a data set with `mirrors = "patches"` leaves out: reflections by facets that are not mirrors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.retrace import traced_scene
from xfreqbench.errors import DataError
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION
from xfreqbench.types import FloatArray, IntArray
from xfreqbench.units import format_ghz


@dataclass(frozen=True, eq=False)
class Glints:
    """Paths of n transmitters to the array centre, with patches as mirrors, and with every facet as a mirror.

    `num_paths` and, at F carriers, the sum of |gain|² over paths, `power`, are first for patches, then for facets.
    """

    carrier_hz: Float[FloatArray, "F"]
    num_paths: Int[IntArray, "2 n"]
    power: Float[FloatArray, "2 n F"]

    def __str__(self) -> str:
        patches, facets = self.num_paths.sum(axis=1)
        share = 1 - self.power[0] / np.where(self.power[1] == 0, 1, self.power[1])
        shares = ", ".join(
            f"{np.median(own):.1%} (worst {own[np.abs(own).argmax()]:.1%}) at {format_ghz(carrier)}"
            for own, carrier in zip(share.T, self.carrier_hz.tolist(), strict=True)
        )
        return (
            f"glints     with every facet as a mirror, solver sionna finds {facets} paths of {self.num_paths.shape[1]} "
            f"transmitters; patches leave out {facets - patches}, and of the power, in the median, {shares}"
        )


def glints(dataset: PasDataset, number: int, seed: int = 0, folder: Path | None = None) -> Glints:
    """Trace `number` of a data set's transmitters, drawn by `seed`, with its own mirrors and with all facets.

    Solver `sionna` traces both, because it takes any number of mirrors, with the depth and rays of the header.
    `traced_scene` says where meshes are searched. Raises `DataError` for data in which every facet is a mirror.
    """
    scene = traced_scene(dataset, folder)
    if scene.scene is None or scene.least_patch is None:
        why = "has no meshes" if scene.scene is None else "says mirrors = 'facets'"
        raise DataError(f"{dataset.path} leaves out no mirror: its scene {why}.")
    positions_m = dataset.tables["tx_position_m"]
    rows = np.random.default_rng(seed).choice(len(positions_m), min(number, len(positions_m)), replace=False)
    settings = replace(dataset.trace_settings, solver="sionna", interactions=WITHOUT_DIFFRACTION)
    both, carrier_hz = (scene, replace(scene, mirrors="facets")), dataset.header.carrier_hz
    tracers = [tracer_of(mirrored, carrier_hz, settings) for mirrored in both]
    paths = [[tracer.paths(tx_m) for tx_m in positions_m[np.sort(rows)]] for tracer in tracers]
    counts = np.array([[len(found.delay_s) for found in of_tx] for of_tx in paths], dtype=np.int64)
    return Glints(
        carrier_hz, counts, np.array([[(np.abs(found.gain) ** 2).sum(axis=1) for found in of_tx] for of_tx in paths])
    )
