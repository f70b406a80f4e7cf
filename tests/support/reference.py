"""Literal transcriptions of published equations, in double precision: what the tests compare with."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from xfreqbench.tracing.paths import Paths

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
    """Field of an unrotated antenna: theta-hat (V) or phi-hat (H), or a short dipole's along z (V) or y (H)."""
    x, y, z = direction
    if (pattern, polarization) == ("dipole", "H"):
        return np.asarray(np.sqrt(1.5) * (np.array([0.0, 1.0, 0.0]) - y * direction))
    horizontal = np.hypot(x, y)
    theta_hat = np.array([x * z / horizontal, y * z / horizontal, -horizontal])
    phi_hat = np.array([-y / horizontal, x / horizontal, 0.0])
    weight = np.sqrt(1.5) * horizontal if pattern == "dipole" else 1.0
    return weight * (theta_hat if polarization == "V" else phi_hat)


def over_one_slab(
    field: np.ndarray, incident: np.ndarray, outgoing: np.ndarray, normal: np.ndarray, te: complex, tm: complex
) -> np.ndarray:
    """Field behind one interaction: parts across and along the plane of incidence have their own factors."""
    across = np.cross(incident, normal)
    across = across / np.linalg.norm(across)
    along_in, along_out = np.cross(across, incident), np.cross(across, outgoing)
    return te * (field @ across) * across + tm * (field @ along_in) * along_out


def cfr_at_centre(paths: Paths) -> np.ndarray:
    """Σ_l a_l(f)·exp(−j2πf τ_l), Eq. (1): the channel (F,) of an element at the array centre."""
    turns = paths.carrier_hz[:, None] * paths.delay_s
    return (paths.gain * np.exp(-2j * np.pi * (turns % 1.0))).sum(axis=1)


def covariance(quaternion: Tensor, log_scale: Tensor) -> Tensor:
    """Σ = R S Sᵀ Rᵀ of one Gaussian, Eq. (5): quaternion (w, x, y, z) of any length, log_scale (3,) → (3, 3)."""
    w, x, y, z = quaternion / torch.sqrt((quaternion**2).sum())
    rotation = torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )
    scale = torch.diag(torch.exp(log_scale))
    return rotation @ scale @ scale.T @ rotation.T


def angular_centre(offset_m: Tensor) -> Tensor:
    """(azimuth, elevation) in rad of the direction from the receiver to μ, Eq. (8): offset μ − r_0, (3,) → (2,)."""
    x, y, z = offset_m
    return torch.stack([torch.atan2(y, x), torch.asin(z / torch.sqrt(x**2 + y**2 + z**2))])


def projection_jacobian(offset_m: Tensor) -> Tensor:
    """∂(azimuth, elevation)/∂(x, y, z) in rad/m, the J of Eq. (9): (3,) → (2, 3)."""
    x, y, z = offset_m
    horizontal_squared = x**2 + y**2
    squared, horizontal = horizontal_squared + z**2, torch.sqrt(horizontal_squared)
    azimuth = torch.stack([-y / horizontal_squared, x / horizontal_squared, torch.zeros_like(z)])
    elevation = torch.stack([-x * z / (squared * horizontal), -y * z / (squared * horizontal), horizontal / squared])
    return torch.stack([azimuth, elevation])


def projected_covariance(offset_m: Tensor, covariance_m2: Tensor) -> Tensor:
    """J Σ Jᵀ in rad² of (azimuth, elevation), Eq. (9): (3,), (3, 3) → (2, 2)."""
    jacobian = projection_jacobian(offset_m)
    return jacobian @ covariance_m2 @ jacobian.T


def accumulate(footprint: Tensor, signal: Tensor, factor: Tensor) -> Tensor:
    """R = Σ_i G_i S_i Π_{m<i} factor_m of one pixel, nearest first, Eq. (11): (L, …) each → (…).

    The paper's factor is δ; `continuous_factor` has no jump at a footprint's edge and equals it at G = 1.
    """
    field, product = torch.zeros_like(signal[:1].sum(0)), torch.ones_like(factor[:1].sum(0))
    for own_footprint, own_signal, own_factor in zip(footprint, signal, factor, strict=True):
        field = field + own_footprint * own_signal * product
        product = product * own_factor
    return field


def continuous_factor(footprint: Tensor, attenuation: Tensor) -> Tensor:
    """1 − G (1 − δ)."""
    return 1 - footprint * (1 - attenuation)
