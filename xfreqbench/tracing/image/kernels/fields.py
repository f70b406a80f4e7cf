"""Kernels of the field along a path: from the antenna at its start to the antennas of the array."""

from __future__ import annotations

import math

from .arrays import BLOCK, F64, SIMD_WIDTH, AntennaArrays, Facets, Media, Path, Vector, Walk
from .compiled import bare, lane
from .slabs import cosine_and_sine, reflect, transmit

Image = tuple[float, float, float, float]  # squared distance, and the way from the image to the transmitter


@lane
def antenna_of(row: F64) -> AntennaArrays:
    """An antenna from its row (12,) in `Media`."""
    axis, aside, ahead = (row[3], row[4], row[5]), (row[6], row[7], row[8]), (row[9], row[10], row[11])
    return AntennaArrays(row[0] != 0.0, row[1] != 0.0, row[2] != 0.0, axis, aside, ahead)


@lane
def antenna_field(antenna: AntennaArrays, x: float, y: float, z: float) -> Vector:
    """World components of the antenna's real field towards a direction, without the gain of a directive element.

    With the antenna's axis a, it is along the polar angle's unit vector (a·k)ρ − |k − (a·k)a|a or, if it is horizontal,
    the azimuth's a×ρ; ρ is along k − (a·k)a.
    """
    ax, ay, az = antenna.axis
    along = ax * x + ay * y + az * z
    x, y, z = x - along * ax, y - along * ay, z - along * az
    across = math.sqrt(x * x + y * y + z * z)
    inverse = 1.0 / max(across, 1e-12)
    is_aside = across > 1e-12
    x = x * inverse if is_aside else antenna.aside[0]
    y = y * inverse if is_aside else antenna.aside[1]
    z = z * inverse if is_aside else antenna.aside[2]
    scale = math.sqrt(1.5) * across if antenna.is_dipole else 1.0
    if antenna.is_horizontal:
        return scale * (ay * z - az * y), scale * (az * x - ax * z), scale * (ax * y - ay * x)
    return (scale * (along * x - across * ax), scale * (along * y - across * ay), scale * (along * z - across * az))


@bare
def element_gain(antenna: AntennaArrays, x: float, y: float, z: float) -> float:
    """Amplitude of the element of 3GPP TR 38.901, Table 7.3-1: 8 dBi where it looks, up to 30 dB less elsewhere."""
    (ax, ay, az), (bx, by, bz) = antenna.axis, antenna.ahead
    along, ahead = ax * x + ay * y + az * z, bx * x + by * y + bz * z
    left = (ay * bz - az * by) * x + (az * bx - ax * bz) * y + (ax * by - ay * bx) * z
    elevation, azimuth = math.atan2(along, math.hypot(ahead, left)), math.atan2(left, ahead)
    width = math.radians(65.0)
    loss_db = min(12.0 * (elevation / width) ** 2, 30.0) + min(12.0 * (azimuth / width) ** 2, 30.0)
    return float(10.0 ** ((8.0 - min(loss_db, 30.0)) / 20.0))


@bare
def _launch(media: Media, path: Path, start: F64, offset_m: F64, wave: F64, number: int) -> None:
    """Begin waves from `start` (3,) to the images of antennas at `offset_m` (3, number), with the antenna's field."""
    image, mirror, antenna = path.image, path.mirror, antenna_of(media.antennas[0])
    ix, iy, iz = image[0] - start[0], image[1] - start[1], image[2] - start[2]
    for i in range(number):
        x, y, z = offset_m[0, i], offset_m[1, i], offset_m[2, i]
        kx = ix + (mirror[0, 0] * x + mirror[0, 1] * y + mirror[0, 2] * z)
        ky = iy + (mirror[1, 0] * x + mirror[1, 1] * y + mirror[1, 2] * z)
        kz = iz + (mirror[2, 0] * x + mirror[2, 1] * y + mirror[2, 2] * z)
        inverse = 1.0 / math.sqrt(kx * kx + ky * ky + kz * kz)
        kx, ky, kz = kx * inverse, ky * inverse, kz * inverse
        ex, ey, ez = antenna_field(antenna, kx, ky, kz)
        wave[i], wave[BLOCK + i], wave[2 * BLOCK + i] = kx, ky, kz
        wave[3 * BLOCK + i], wave[4 * BLOCK + i], wave[5 * BLOCK + i] = ex, ey, ez
        wave[6 * BLOCK + i], wave[7 * BLOCK + i], wave[8 * BLOCK + i] = 0.0, 0.0, 0.0
    if antenna.is_directive:
        for i in range(number):
            own = element_gain(antenna, wave[i], wave[BLOCK + i], wave[2 * BLOCK + i])
            for c in range(3, 6):
                wave[c * BLOCK + i] *= own


@bare
def _receive(media: Media, wave: F64, gain: F64, number: int) -> None:
    """What antennas take of waves, to `gain` (2, number)."""
    antenna = antenna_of(media.antennas[1])
    for i in range(number):
        ex, ey, ez = antenna_field(antenna, -wave[i], -wave[BLOCK + i], -wave[2 * BLOCK + i])
        gain[0, i] = wave[3 * BLOCK + i] * ex + wave[4 * BLOCK + i] * ey + wave[5 * BLOCK + i] * ez
        gain[1, i] = wave[6 * BLOCK + i] * ex + wave[7 * BLOCK + i] * ey + wave[8 * BLOCK + i] * ez
    if antenna.is_directive:
        for i in range(number):
            own = element_gain(antenna, -wave[i], -wave[BLOCK + i], -wave[2 * BLOCK + i])
            gain[0, i] *= own
            gain[1, i] *= own


@bare
def specular_share(facets: Facets, media: Media, length: int, walk: Walk) -> float:
    """What rough facets leave of the field of a path that was traced and is reflected so many times."""
    share = 1.0
    for s in range(length):
        share *= media.specular[facets.slab[walk.hit[s]]]
    return share


@bare
def gains(
    facets: Facets, media: Media, path: Path, offset_m: F64, first: int, number: int, walk: Walk, gain: F64
) -> None:
    """Field that antennas at `offset_m` (3, number) take from the path traced last, to `gain` (2, number).

    They are lanes `first` and after of `media`. Spreading and travel phase are left out.
    """
    wave, share = walk.wave, specular_share(facets, media, path.length, walk)
    for begin in range(0, number, BLOCK):
        end = min(number, begin + BLOCK)
        low, padded = first + begin, -(-(end - begin) // SIMD_WIDTH) * SIMD_WIDTH
        _launch(media, path, walk.start[0], offset_m[:, begin:end], wave, end - begin)
        for s in range(path.length + 1):
            for i in range(walk.num_crossed[s]):
                q, kind = walk.crossed[s, i], facets.slab[walk.crossed[s, i]]
                transmit(media.lanes[media.first[kind] : media.first[kind + 1], :, low:], facets.face[q], wave, padded)
            if s < path.length:
                q, kind = walk.hit[s], facets.slab[walk.hit[s]]
                reflect(media.lanes[media.first[kind] : media.first[kind + 1], :, low:], facets.face[q], wave, padded)
        _receive(media, wave, gain[:, begin:end], end - begin)
    if share < 1.0:
        for i in range(number):
            gain[0, i] *= share
            gain[1, i] *= share


@bare
def interpolate(gain: F64, first: int, weight: F64, own: F64) -> None:
    """Gains at M elements, to `own` (2, M), from those at N nodes, lanes `first` and after of `gain` (2, L)."""
    num_nodes, num_elements = weight.shape
    for e in range(num_elements):
        real = imag = 0.0
        for node in range(num_nodes):
            real += weight[node, e] * gain[0, first + node]
            imag += weight[node, e] * gain[1, first + node]
        own[0, e], own[1, e] = real, imag


@bare
def spread(gain: F64, image: Image, element_m: F64, wavelength_m: float) -> None:
    """Multiply the gains (2, M) at elements (3, M) with (λ/4πL)·exp(−j2πL/λ), L the exact distance to their images."""
    distance2, toward_x, toward_y, toward_z = image
    for e in range(element_m.shape[1]):
        x, y, z = element_m[0, e], element_m[1, e], element_m[2, e]
        distance = math.sqrt(distance2 - 2.0 * (toward_x * x + toward_y * y + toward_z * z) + (x * x + y * y + z * z))
        cosine, sine = cosine_and_sine(distance / wavelength_m)
        scale, real, imag = wavelength_m / (4.0 * math.pi * distance), gain[0, e], gain[1, e]
        gain[0, e] = scale * (real * cosine + imag * sine)
        gain[1, e] = scale * (imag * cosine - real * sine)
