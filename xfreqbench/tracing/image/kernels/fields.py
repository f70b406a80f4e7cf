"""Kernels of the field along a path: from the antenna at its start to the antennas of the array."""

from __future__ import annotations

import math

from .arrays import BLOCK, F64, LANES, Antenna, Facets, Media, Path, Walk
from .compiled import bare, lane
from .slabs import cosine_and_sine, reflect, transmit

Image = tuple[float, float, float, float]  # squared distance, and the way from the image to the transmitter


@lane
def antenna_field(antenna: Antenna, x: float, y: float, z: float, pole: float) -> tuple[float, float, float]:
    """World components of the antenna's real field towards a direction.

    `pole` is the cosine of the azimuth of a vertical direction: 1 at one end of a path and −1 at the other, as the ends
    of a ray beside the vertical have opposite azimuths, however often floor and ceiling reflect it.
    """
    horizontal = math.sqrt(x * x + y * y)
    inverse = 1.0 / max(horizontal, 1e-12)
    cos_phi = x * inverse if horizontal > 1e-12 else pole
    sin_phi = y * inverse if horizontal > 1e-12 else 0.0
    scale = math.sqrt(1.5) * horizontal if antenna.is_dipole else 1.0
    if antenna.is_horizontal:
        return -scale * sin_phi, scale * cos_phi, 0.0
    return scale * z * cos_phi, scale * z * sin_phi, -scale * horizontal


@bare
def _launch(media: Media, path: Path, start: F64, offset_m: F64, wave: F64, number: int) -> None:
    """Begin waves from `start` (3,) to the images of antennas at `offset_m` (3, number), with the antenna's field."""
    image, mirror = path.image, path.mirror
    ix, iy, iz = image[0] - start[0], image[1] - start[1], image[2] - start[2]
    for i in range(number):
        x, y, z = offset_m[0, i], offset_m[1, i], offset_m[2, i]
        kx = ix + (mirror[0, 0] * x + mirror[0, 1] * y + mirror[0, 2] * z)
        ky = iy + (mirror[1, 0] * x + mirror[1, 1] * y + mirror[1, 2] * z)
        kz = iz + (mirror[2, 0] * x + mirror[2, 1] * y + mirror[2, 2] * z)
        inverse = 1.0 / math.sqrt(kx * kx + ky * ky + kz * kz)
        kx, ky, kz = kx * inverse, ky * inverse, kz * inverse
        ex, ey, ez = antenna_field(media.transmitter, kx, ky, kz, 1.0)
        wave[i], wave[BLOCK + i], wave[2 * BLOCK + i] = kx, ky, kz
        wave[3 * BLOCK + i], wave[4 * BLOCK + i], wave[5 * BLOCK + i] = ex, ey, ez
        wave[6 * BLOCK + i], wave[7 * BLOCK + i], wave[8 * BLOCK + i] = 0.0, 0.0, 0.0


@bare
def _receive(media: Media, wave: F64, gain: F64, number: int) -> None:
    """What antennas take of waves, to `gain` (2, number)."""
    for i in range(number):
        ex, ey, ez = antenna_field(media.receiver, -wave[i], -wave[BLOCK + i], -wave[2 * BLOCK + i], -1.0)
        gain[0, i] = wave[3 * BLOCK + i] * ex + wave[4 * BLOCK + i] * ey + wave[5 * BLOCK + i] * ez
        gain[1, i] = wave[6 * BLOCK + i] * ex + wave[7 * BLOCK + i] * ey + wave[8 * BLOCK + i] * ez


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
        low, padded = first + begin, -(-(end - begin) // LANES) * LANES
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
