"""Literal transcriptions of published equations, in double precision: what the tests compare with."""

from __future__ import annotations

import numpy as np

SPEED_OF_LIGHT_M_S = 299_792_458.0


def slab_coefficients(
    permittivity: complex, thickness_m: float, carrier_hz: float, cos_incidence: float
) -> tuple[complex, complex, complex, complex]:
    """R_TE, R_TM, T_TE, T_TM of a single slab: Recommendation ITU-R P.2040-3, Eqs. (37), (38), (43)–(45)."""
    root = np.sqrt(permittivity - (1 - cos_incidence**2))
    q = 2 * np.pi * thickness_m * carrier_hz / SPEED_OF_LIGHT_M_S * root
    te = (cos_incidence - root) / (cos_incidence + root)
    tm = (permittivity * cos_incidence - root) / (permittivity * cos_incidence + root)
    coefficients = []
    for interface in (te, tm):
        denominator = 1 - interface**2 * np.exp(-2j * q)
        coefficients.append(interface * (1 - np.exp(-2j * q)) / denominator)
        coefficients.append((1 - interface**2) * np.exp(-1j * q) / denominator)
    r_te, t_te, r_tm, t_tm = coefficients
    return r_te, r_tm, t_te, t_tm


def antenna_field(direction: np.ndarray, pattern: str, polarization: str) -> np.ndarray:
    """Field of an unrotated antenna: theta-hat (V) or phi-hat (H), a short dipole weighted by √1.5·sin θ."""
    x, y, z = direction
    horizontal = np.hypot(x, y)
    theta_hat = np.array([x * z / horizontal, y * z / horizontal, -horizontal])
    phi_hat = np.array([-y / horizontal, x / horizontal, 0.0])
    weight = np.sqrt(1.5) * horizontal if pattern == "dipole" else 1.0
    return weight * (theta_hat if polarization == "V" else phi_hat)


def over_one_slab(
    field: np.ndarray,
    incident: np.ndarray,
    outgoing: np.ndarray,
    normal: np.ndarray,
    te: complex,
    tm: complex,
) -> np.ndarray:
    """Field behind one interaction: parts across and along the plane of incidence have their own factors."""
    across = np.cross(incident, normal)
    across = across / np.linalg.norm(across)
    along_in, along_out = np.cross(across, incident), np.cross(across, outgoing)
    return te * (field @ across) * across + tm * (field @ along_in) * along_out
