"""The two solvers have two limits beyond which a slab passes nothing; this pins both, and their difference.

The image solver asks for the transmission of the slab as P.2040 gives it, faces included, and its limit is
120 dB: it branches every ray, and pays for a slab that passes little with time alone. Sionna's chains ask for the
absorption of one straight passage, and their limit is 100 dB: each ray is either reflected or transmitted, by
chance, so rays that are sent into a slab which passes nothing are lost to the search.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import TraceSettings

GRID = TransmitterGrid(min_m=(0.0, 0.0, 0.0), max_m=(1.0, 1.0, 1.0), step_m=(1.0, 1.0, 1.0))
CORNERS_M = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])


def is_opaque_to_image(material: str, thickness_m: float, carrier_hz: list[float]) -> bool:
    floor = Surface("floor", material, thickness_m, (-9.0, -9.0, 0.0), (9.0, 9.0, 0.0))
    scene = Scene(name="floor", receiver=ReceiverArray((0.0, 0.0, 2.0)), transmitters=GRID, surface=(floor,))
    tracer = ImageTracer(
        scene, carrier_hz, TraceSettings(interactions=("specular", "refraction"), max_depth=1, rays=10)
    )
    return bool(tracer.facets.is_opaque.all())


def is_opaque_to_sionna(material: str, thickness_m: float, carrier_hz: list[float]) -> bool:
    from xfreqbench.tracing.sionna.chains import opaque_meshes

    mesh = SurfaceMesh("floor", material, thickness_m, CORNERS_M, np.array([[0, 1, 2], [0, 2, 3]]))
    return bool(opaque_meshes([mesh], carrier_hz, "error").all())


@pytest.mark.sionna
@pytest.mark.parametrize(
    ("slab", "carrier_hz", "to_image", "to_sionna"),
    [
        (("metal", 0.002), [1e9, 94e9], True, True),
        (("concrete", 0.2), [1e9, 94e9], False, False),  # one carrier passes: so do rays
        (("concrete", 0.2), [47e9, 94e9], False, True),  # of solver image it is what passes at 1 GHz
        (("concrete", 5.0), [47e9, 94e9], True, True),
        (("glass", 0.008), [94e9], False, False),
    ],
)
def test_a_slab_is_opaque_beyond_a_loss_that_is_each_solvers_own(
    slab: Any, carrier_hz: list[float], to_image: bool, to_sionna: bool
) -> None:
    assert is_opaque_to_image(*slab, carrier_hz) is to_image
    assert is_opaque_to_sionna(*slab, carrier_hz) is to_sionna
