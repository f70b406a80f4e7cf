"""Scenes of rough materials, and what they scatter: by a closed form, and by public Sionna RT."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.support.sionna_scenes import GRID, ONE_ELEMENT
from xfreqbench.scene.materials import Scattering, SceneMaterial
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIER_HZ = 10e9
TX_M = np.array([1.2, 2.6, 0.8])
RECEIVER_M = np.array(ONE_ELEMENT.position_m)
PATTERNS = (
    Scattering(coefficient=0.4, xpd_coefficient=0.2),
    Scattering(coefficient=0.6, pattern="directive", alpha_r=4),
    Scattering(coefficient=0.5, pattern="backscattering", alpha_r=3, alpha_i=6, lambda_=0.7),
)
ROUGH = (
    SceneMaterial("plaster", itu="plasterboard", scattering=PATTERNS[0]),
    SceneMaterial("stone", itu="concrete", scattering=PATTERNS[1]),
    SceneMaterial("felt", relative_permittivity=2.0, conductivity_s_m=0.05, scattering=PATTERNS[2]),
)
_CORNERS_M: list[tuple[Any, Any]] = [
    ((0.0, 0.0, 0.0), (4.0, 3.0, 0.0)), ((0.0, 0.0, 2.5), (4.0, 3.0, 2.5)), ((0.0, 0.0, 0.0), (0.0, 3.0, 2.5)),
    ((4.0, 0.0, 0.0), (4.0, 3.0, 2.5)), ((0.0, 0.0, 0.0), (4.0, 0.0, 2.5)), ((0.0, 3.0, 0.0), (4.0, 3.0, 2.5)),
    ((2.5, 0.5, 0.7), (3.5, 1.5, 0.7)),
]  # fmt: skip


def room(receiver: ReceiverArray = ONE_ELEMENT) -> Scene:
    """A room of 4 × 3 × 2.5 m whose walls are of the three rough materials in turn, and a table of the first."""
    walls = [Surface(f"wall {i}", ROUGH[i % 3].name, 0.1, *bounds_m) for i, bounds_m in enumerate(_CORNERS_M)]
    return Scene("rough", receiver, GRID, surface=tuple(walls), material=ROUGH)


def plate(scattering: Scattering | None, *walls: Surface, receiver: ReceiverArray = ONE_ELEMENT) -> Scene:
    """A metal floor of 4 × 4 m below the receiver that scatters, and walls."""
    floor = Surface("floor", "rough metal", 0.1, (0.0, 0.0, 0.0), (4.0, 4.0, 0.0))
    metal = SceneMaterial("rough metal", itu="metal", scattering=scattering)
    return Scene("plate", receiver, GRID, surface=(floor, *walls), material=(metal,))


def lambertian_power(coefficient: float) -> float:
    """Received over transmitted power by way of the plate, if it reflects all, and scatters by Lambert's law.

    ∫ S² · cos θᵢ/(4π rᵢ²) · cos θₛ/π · λ²/(4π rₛ²) dA: what an area receives of an isotropic transmitter's power, the
    part of it that is scattered, per steradian, and the receiver's effective area over the distance squared.
    """
    along = (np.arange(400) + 0.5) / 100
    point_m = np.stack([*np.meshgrid(along, along), np.zeros((400, 400))], axis=-1)
    (r_i, cos_i), (r_s, cos_s) = (
        (length_m := np.linalg.norm(end_m - point_m, axis=-1), end_m[2] / length_m) for end_m in (TX_M, RECEIVER_M)
    )
    effective_m2 = (SPEED_OF_LIGHT_M_S / CARRIER_HZ) ** 2 / (4 * np.pi)
    per_area = cos_i / (4 * np.pi * r_i**2) * cos_s / np.pi * effective_m2 / r_s**2
    return float(coefficient**2 * per_area.sum() / 100**2)


def octant_powers(gain: NDArray[Any], arrival: NDArray[np.float64], *kinds: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Power from each octant of paths of each kind, (kinds, 8)."""
    octant = (arrival > 0) @ np.array([1, 2, 4])
    return np.array([np.bincount(octant, np.abs(gain) ** 2 * kind, minlength=8) for kind in kinds])


def public_paths(scene: Any, interactions: Any, max_depth: int, rays: int, seed: int) -> tuple[NDArray[Any], ...]:
    """Gains (P,), arrivals (P, 3) and interactions (P, D) by public Sionna RT in a scene that it has loaded."""
    from xfreqbench.tracing.sionna.plain import solve

    theirs = solve(scene, TX_M[None], interactions, max_depth, rays, seed)
    theta, phi = (angle.numpy().ravel().astype(float) for angle in (theirs.theta_r, theirs.phi_r))
    arrival = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    gain, _ = theirs.cir(normalize_delays=False, out_type="numpy")
    return gain.ravel(), arrival, theirs.interactions.numpy().reshape(max_depth, -1).T
