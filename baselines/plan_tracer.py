"""Traces the plan of a room that it is told, whose materials are not the true ones: what geometry alone is worth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import nan
from pathlib import Path

import numpy as np
from jaxtyping import Float

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, MethodError
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.lookup import NoOptions
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import Scene
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.types import FloatArray, NDArray


class PlanTracer:
    """Knows a room's plan, by protocol `unseen-rooms-plan`, and traces it; what is heard makes no difference to it."""

    num_parameters = 0

    def __init__(self, config: NoOptions | None = None) -> None:
        self.config = config or NoOptions()

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Iterator[Progress]:
        """Nothing is learned; one step says so."""
        yield Progress(step=1, loss=nan)

    def adapt(self, heard: PasDataset, budget: Budget) -> TracedPlan:
        """The plan, prepared for tracing; raises `MethodError` where it is not told."""
        try:
            return TracedPlan(heard, heard.scene)
        except DataError as error:
            raise MethodError("The plan is not told. Use protocol unseen-rooms-plan.") from error

    def save(self, directory: Path) -> None:
        """Store that there is nothing to store."""
        (directory / "state.json").write_text(json.dumps({}), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> PlanTracer:
        """A method like any other of its class."""
        return cls()


class TracedPlan:
    """Predicts the maps of one room by tracing its plan, as its data were traced."""

    def __init__(self, heard: PasDataset, scene: Scene) -> None:
        self._heard, self._scene, self.geometry = heard, scene, Geometry.of(scene)

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Maps with peak 1."""
        place_m, tx = np.unique(tx_position_m, axis=0, return_inverse=True)
        known_hz, carrier = np.unique(carrier_hz, return_inverse=True)
        cfr = tracer_of(self._scene, known_hz, self._heard.trace_settings, self.geometry).channel(place_m).cfr
        return self._heard.beam.maps(cfr[tx.ravel(), carrier], self._heard.header.pas_kind)[0]
