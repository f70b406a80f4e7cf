"""Small scenes on which Sionna's plain solve has converged, so that answers can be compared path by path."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid
from xfreqbench.tracing.tracer import TraceSettings

GRID = TransmitterGrid(min_m=(0.0, 0.0, 0.0), max_m=(1.0, 1.0, 1.0), step_m=(1.0, 1.0, 1.0))
RECEIVER = ReceiverArray(position_m=(2.0, 1.5, 2.0))
ONE_ELEMENT = ReceiverArray(position_m=(2.0, 1.5, 2.0), rows=1, cols=1)
ANTENNAS = [("iso", "V"), ("iso", "H"), ("dipole", "V")]
CARRIERS_HZ = [1e9, 10e9, 94e9]
TRANSMITTERS_M = np.array([[3.1, 4.2, 1.1], [1.35, 3.9, 1.7], [2.6, 2.9, 0.4]])
SETTINGS = TraceSettings(interactions=("specular", "refraction"), rays=100_000, max_depth=3)

CONCRETE_WALL = Surface(
    name="wall", material="concrete", thickness_m=0.2, min_m=(0.0, -4.0, -3.0), max_m=(0.0, 6.0, 6.0)
)
GLASS_PANE = Surface(
    name="pane, between", material="glass", thickness_m=0.008, min_m=(-1.0, 2.6, -3.0), max_m=(6.0, 2.6, 6.0)
)
METAL_BOX = Surface(name="metal box", material="metal", thickness_m=0.002, min_m=(1.0, 2.2, 0.0), max_m=(1.8, 3.1, 0.9))
WOODEN_BOX = Surface(name="wooden box", material="wood", thickness_m=0.02, min_m=(2.9, 2.3, 0.1), max_m=(3.7, 3.2, 1.0))
SLOPE = Surface(  # with a notch where no path turns
    name="slope",
    material="concrete",
    thickness_m=0.2,
    vertices_m=(
        (-1.0, -4.0, -2.0),
        (1.0, -4.0, 6.0),
        (1.0, 6.0, 6.0),
        (-0.5, 6.0, 0.0),
        (-0.5, 5.0, 0.0),
        (-1.0, 5.0, -2.0),
    ),
)


def scene_of(*surfaces: Surface, receiver: ReceiverArray = RECEIVER) -> Scene:
    return Scene(name="test", receiver=receiver, transmitters=GRID, surface=surfaces)


def moved(scene: Scene, offset_m: tuple[float, float, float]) -> Scene:
    """The scene without its mesh file, everything shifted."""

    def shifted(point_m: tuple[float, float, float]) -> Any:
        return tuple(here + by for here, by in zip(point_m, offset_m, strict=True))

    def box(part: Any) -> Any:
        return replace(part, min_m=shifted(part.min_m), max_m=shifted(part.max_m))

    return replace(
        scene,
        receiver=replace(scene.receiver, position_m=shifted(scene.receiver.position_m)),
        transmitters=box(scene.transmitters),
        surface=tuple(map(box, scene.surface)),
    )


def simple_scenes(receiver: ReceiverArray = RECEIVER) -> dict[str, Scene]:
    return {
        "a wall": scene_of(CONCRETE_WALL, receiver=receiver),
        "a wall and a pane between": scene_of(CONCRETE_WALL, GLASS_PANE, receiver=receiver),
        "a slope and a pane between": scene_of(SLOPE, GLASS_PANE, receiver=receiver),
        "two boxes": scene_of(METAL_BOX, WOODEN_BOX, receiver=receiver),
    }


def sionna_tracer(scene: Scene, carrier_hz: Any = CARRIERS_HZ, settings: TraceSettings = SETTINGS) -> Any:
    from xfreqbench.tracing.sionna.tracer import SionnaTracer

    return SionnaTracer(scene, carrier_hz, settings)


def relative_error(cfr: NDArray[np.complex128], truth: NDArray[np.complex128]) -> float:
    return float(np.abs(cfr - truth).max() / np.abs(truth).max())
