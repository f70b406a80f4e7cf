"""The receiver array: positions of its elements, the rotation of its frame, and its steering vector."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

ArrayPlane = Literal["xy", "yz"]


def planar_array(
    rows: int, cols: int, spacing_wavelengths: float, plane: ArrayPlane = "xy"
) -> Float[FloatArray, "M 3"]:
    """Positions of M = rows·cols elements about their centre, in wavelengths, in the receiver's frame.

    Element n = row·cols + col. Columns are spaced along the plane's first axis and rows along its second. In `xy`
    the array lies in the equator and faces the pole; in `yz` the pole lies in the array, as for one on a wall.
    """
    along_columns = (np.arange(cols) - (cols - 1) / 2) * spacing_wavelengths
    along_rows = (np.arange(rows) - (rows - 1) / 2) * spacing_wavelengths
    in_plane = [np.tile(along_columns, rows), np.repeat(along_rows, cols)]
    across = np.zeros(rows * cols)
    return np.stack([*in_plane, across] if plane == "xy" else [across, *in_plane], axis=-1)


def frame_rotation(boresight: tuple[float, float, float]) -> Float[FloatArray, "3 3"]:
    """Rotation from the receiver's frame to the world; its columns are the frame's axes.

    The frame's +z is the boresight, its +x the world's +x made perpendicular to it (the world's +y
    where the boresight is along x).
    """
    pole = np.asarray(boresight, dtype=np.float64)
    pole = pole / np.linalg.norm(pole)
    reference = np.array([0.0, 1.0, 0.0]) if abs(pole[0]) > 0.99 else np.array([1.0, 0.0, 0.0])
    x = reference - (reference @ pole) * pole
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(pole, x), pole], axis=-1)


def quaternion_rotation(quaternion_xyzw: tuple[float, float, float, float]) -> Float[FloatArray, "3 3"]:
    """Rotation matrix from a quaternion x, y, z, w of any length except 0."""
    from scipy.spatial.transform import Rotation  # takes 0.2 s to import, and few receivers need it

    return Rotation.from_quat(quaternion_xyzw).as_matrix()


def rotation_quaternion(rotation: Float[FloatArray, "3 3"]) -> tuple[float, float, float, float]:
    """Unit quaternion x, y, z, w from a rotation matrix."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return x, y, z, w


def orientation_rotation(bearing_downtilt_slant_deg: tuple[float, float, float]) -> Float[FloatArray, "3 3"]:
    """Rotation of an antenna into the world, Eq. (7.1-4) of 3GPP TR 38.901; its columns are the antenna's axes.

    The antenna looks along the first. It is turned by the slant about x, then by the downtilt about y, then by the
    bearing about z, all counter-clockwise.
    """
    (cos_a, cos_b, cos_c), (sin_a, sin_b, sin_c) = (f(np.radians(bearing_downtilt_slant_deg)) for f in (np.cos, np.sin))
    bearing = np.array([[cos_a, -sin_a, 0.0], [sin_a, cos_a, 0.0], [0.0, 0.0, 1.0]])
    downtilt = np.array([[cos_b, 0.0, sin_b], [0.0, 1.0, 0.0], [-sin_b, 0.0, cos_b]])
    slant = np.array([[1.0, 0.0, 0.0], [0.0, cos_c, -sin_c], [0.0, sin_c, cos_c]])
    return np.asarray(bearing @ downtilt @ slant)


def steering_vector(
    element_position_m: Float[FloatArray, "M 3"], arrival: Float[FloatArray, "... 3"], carrier_hz: float
) -> Complex[NDArray[np.complex128], "... M"]:
    """Steering vector a_n = exp(+jk r_n·d): the phasor of a unit plane wave at each of M array elements.

    `arrival` is d, unit vectors from the receiver towards the source, in the axes of the positions r_n; k is 2πf/c.
    The phase is zero at the array centre, time running as exp(+j2πft). Shapes (M, 3), (..., 3) → (..., M).
    """
    wavenumber = 2 * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S  # rad/m
    return np.exp(1j * wavenumber * (arrival @ element_position_m.T))
