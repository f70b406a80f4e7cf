"""Steps of 0.1 mm in the shipped scenes: a channel changes by what the phases of its paths do, and by a bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xfreqbench.bench.stress.case import Area
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.scene.placement import place_transmitters
from xfreqbench.scene.toml_files import shipped_scenes
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

CONTINUITY = Area("continuity")
_CARRIERS_GHZ = np.array([2.4, 24.25, 77.0])
_STEP_M = 1e-4
NUM_STEPS = 1000


def jumps(scene: Scene, num_steps: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far the channel jumps along random steps of a transmitter (T, F), and where they begin, in metres (T, 3).

    A jump is what is left of the channel's change where each path has turned by the change of its length. It is
    relative to the root of the sum of the powers of all paths. The receiver is one element.
    """
    scene = replace(scene, receiver=replace(scene.receiver, rows=1, cols=1))
    geometry = Geometry.of(scene)
    settings = TraceSettings(solver="image", interactions=("specular", "refraction", "diffraction"))
    tracer = ImageTracer(scene, [ghz_to_hz(ghz) for ghz in _CARRIERS_GHZ], settings, geometry=geometry)
    random, receiver_m = np.random.default_rng(0), np.array(scene.receiver.position_m)
    places_m = place_transmitters(scene, geometry.meshes).tx_position_m
    tx_m = places_m[random.integers(len(places_m), size=num_steps)] + random.uniform(-0.1, 0.1, (num_steps, 3))
    step_m = random.normal(size=(num_steps, 3))
    step_m *= _STEP_M / np.linalg.norm(step_m, axis=1)[:, None]
    found, left = tracer.channel(tx_m + step_m).cfr[..., 0], np.empty((num_steps, len(_CARRIERS_GHZ)))
    for i in range(num_steps):
        paths = tracer.paths(tx_m[i])
        towards_m = np.where(np.isnan(paths.vertices_m[:, 0]), receiver_m, paths.vertices_m[:, 0]) - tx_m[i]
        nearer_m = towards_m @ step_m[i] / np.linalg.norm(towards_m, axis=1)
        turns = paths.carrier_hz[:, None] * (paths.delay_s - nearer_m / SPEED_OF_LIGHT_M_S)
        expected = (paths.gain * np.exp(-2j * np.pi * turns)).sum(axis=1)
        left[i] = np.abs(found[i] - expected) / np.linalg.norm(paths.gain, axis=1)
    return left, tx_m


@CONTINUITY.cases_of(
    {f"steps of 0.1 mm in {name}": (name,) for name in sorted(shipped_scenes())},
    limit=0.3,  # docs/physics.md, Diffraction
    unit="relative",
)
def _largest_jump(name: str) -> tuple[float, str]:
    """The largest jump of all steps, and the three worst places."""
    jump, tx_m = jumps(load_scene(name), NUM_STEPS)
    worst = np.argsort(-jump.max(axis=1))[:3]
    places = [
        f"{jump[i].max():.0e} at {_CARRIERS_GHZ[jump[i].argmax()]:g} GHz, {', '.join(f'{x:.4f}' for x in tx_m[i])} m"
        for i in worst
    ]
    return float(jump.max()), "; ".join(places)
