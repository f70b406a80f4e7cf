"""Compiled kernels: the field that a wedge diffracts, by the uniform theory of diffraction.

Each of the four terms of Kouyoumjian and Pathak (Proc. IEEE 62, 1974) removes the jump of the other paths at one
boundary: of the field that goes straight on, less what the faces let through, and of the field that each face
reflects (for slabs Burnside and Burgener, IEEE Trans. Antennas Propag. 31, 1983). The two ends of a path may
change places.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .arrays import C128, F64, I64, Bools, Media
from .compiled import bare, part
from .slabs import Four, coefficients, stacked

Pair = tuple[complex, complex]
Polar = tuple[float, float, float]

SCREEN_RAD = 1e-3  # a wedge that leaves a full turn free, but for this, is the rim of a screen of one facet


class Wedges(NamedTuple):
    """Edges and the wedges around them; see `edges.Edge`. (E edges)"""

    start: F64  # (E, 3)
    along: F64  # (E, 3)
    tangent: F64  # (E, 3): along face 0
    normal: F64  # (E, 3): of face 0, into free space
    normal_n: F64  # (E, 3): of face n, into free space
    length: F64  # (E,)
    angle: F64  # (E,): through free space
    slab: I64  # (E, 2): kinds of the faces, an index into Media
    is_opaque: Bools  # (E,): one of the faces lets nothing through


def _weideman(num_terms: int) -> tuple[float, F64]:
    """Width and coefficients of Weideman's series for erfc(z)·exp(z²) (SIAM J. Numer. Anal. 31, 1994)."""
    width = math.sqrt(num_terms / math.sqrt(2))
    angle = np.arange(-2 * num_terms + 1, 2 * num_terms) * math.pi / (2 * num_terms)
    place = width * np.tan(angle / 2)
    values = np.concatenate([[0.0], np.exp(-(place**2)) * (width**2 + place**2)])
    spectrum = np.real(np.fft.fft(np.fft.fftshift(values))) / (4 * num_terms)
    return width, spectrum[num_terms:0:-1].copy()


WIDTH, SERIES = _weideman(24)


@bare
def transition(y: float) -> complex:
    """erfc(z)·exp(z²) at z = exp(jπ/4)·y, y ≥ 0: the UTD's F(y²) over √π·z. It is 1 at y = 0."""
    z = complex(y * math.sqrt(0.5), y * math.sqrt(0.5))
    inverse = 1.0 / (WIDTH + z)
    ratio, total = (WIDTH - z) * inverse, 0j
    for coefficient in SERIES:
        total = total * ratio + coefficient
    return inverse * (2.0 * total * inverse + 1.0 / math.sqrt(math.pi))


@part
def off_boundary(term: int, n: float, phi: float, source_phi: float) -> float:
    """How far off the boundary of one of the four terms the two ends are, in half turns over n."""
    apart = phi - source_phi if term < 2 else phi + source_phi
    off = (math.pi + (apart if term % 2 == 0 else -apart)) / (2.0 * n)
    return off - math.pi * math.floor(off / math.pi + 0.5)


@bare
def _term(term: int, n: float, root: float, phi: float, source_phi: float) -> complex:
    """One of the four terms of Kouyoumjian and Pathak (1974), Eq. 25: cot(turn/2n)·F, ∓1 on the sides of its boundary.

    Terms 0 and 1 belong to the fields that go straight on beside face n and beside face 0, 2 and 3 to those that face
    n and face 0 reflect. `root` is √(2kL) with L = s·s'/(s + s')·sin²β; angles are those of `Edge`.
    """
    off = off_boundary(term, n, phi, source_phi)
    # a facet's rim belongs to the facet: it blocks and reflects there
    if abs(off) < 1e-12:
        return complex(-1.0 if term < 2 else 1.0, 0.0)
    sine = abs(math.sin(n * off))
    return sine / (n * math.tan(off)) * transition(root * sine)


@bare
def _cross(a: F64, b: F64, out: F64) -> float:
    """Cross product and its norm."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    out[0], out[1], out[2] = x, y, z
    return math.sqrt(x * x + y * y + z * z)


@bare
def dot(a: F64, b: F64) -> float:
    """Scalar product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@bare
def _along(field: C128, axis: F64) -> complex:
    return field[0] * axis[0] + field[1] * axis[1] + field[2] * axis[2]


@bare
def _axes(field: C128, k: F64, axis: F64, other: F64, work: F64) -> Pair:
    """Components of a field along k×axis and k×(k×axis), of unit length; along `other` and k×other if k is the axis."""
    norm = _cross(k, axis, work[0])
    if norm < 1e-9:
        norm = 1.0
        for c in range(3):
            work[0, c] = other[c]
    _cross(k, work[0], work[1])
    return _along(field, work[0]) / norm, _along(field, work[1]) / norm


@bare
def _coefficients(media: Media, kind: int, f: int, cosine: float) -> Four:
    """Reflection TE, TM and transmission TE, TM of a slab at its front."""
    a, b = media.first[kind], media.first[kind + 1]
    if b - a == 1:
        return coefficients(cosine, media.permittivity[f, a], media.phase_thickness[f, a])
    return stacked(cosine, media.permittivity[f, a:b], media.phase_thickness[f, a:b])


@bare
def _passed(media: Media, kind: int, f: int, normal: F64, along: F64, k: F64, field: Pair, work: F64) -> Pair:
    """What a face passes of a wave along k; the field is given along k×along and k×(k×along), of unit length."""
    norm, cosine, sine = _cross(k, normal, work[0]), 1.0, 0.0
    across = _cross(k, along, work[1])
    if norm > 1e-9:
        cosine = dot(work[1], work[0]) / (norm * across)
        _cross(work[1], work[0], work[2])
        sine = dot(k, work[2]) / (norm * across)
    _, _, t_te, t_tm = _coefficients(media, kind, f, abs(dot(k, normal)))
    te = t_te * (cosine * field[0] + sine * field[1])
    tm = t_tm * (cosine * field[1] - sine * field[0])
    return cosine * te - sine * tm, sine * te + cosine * tm


@bare
def _through(wedges: Wedges, media: Media, e: int, is_from_zero: bool, f: int, k: F64, field: Pair, work: F64) -> Pair:
    """What all faces of a wedge pass of a wave that goes straight on beside the edge."""
    for face in range(2):
        is_zero = (face == 0) == is_from_zero
        if not is_zero and wedges.angle[e] > 2.0 * math.pi - SCREEN_RAD:
            continue
        kind = wedges.slab[e, 0] if is_zero else wedges.slab[e, 1]
        normal = wedges.normal[e] if is_zero else wedges.normal_n[e]
        field = _passed(media, kind, f, normal, wedges.along[e], k, field, work)
    return field


@bare
def _reflection(media: Media, kind: int, f: int, normal: F64, k: F64, out: F64) -> Pair:
    """Specular reflection TE and TM of a face, at the geometric mean of the cosines of incidence from the two ends."""
    cosine = math.sqrt(abs(dot(k, normal) * dot(out, normal)))
    r_te, r_tm, _, _ = _coefficients(media, kind, f, cosine)
    return r_te * media.specular[kind], r_tm * media.specular[kind]


@bare
def diffract(
    wedges: Wedges,
    media: Media,
    e: int,
    f: int,
    waves: tuple[F64, F64],
    fields: tuple[C128, C128],
    angles: tuple[float, float],
    root: float,
    work: F64,
) -> complex:
    """What the second of two waves to the edge takes of the first, over 1/(s + s').

    `waves` are their directions (3,), `fields` those that they bring there (3,), `angles` those of `Edge` to where
    they come from. Straight-on terms turn the field about the edge and take off what the faces pass of it, half-way
    between the two directions. Reflected terms reflect it about the plane that would turn the one direction into
    the other. So at each boundary they equal the field that jumps there, and the two waves may change places.
    """
    k, out, along, n = waves[0], work[3], wedges.along[e], wedges.angle[e] / math.pi
    for c in range(3):
        out[c] = -waves[1][c]
    source_phi, phi = angles
    beside_n, beside_0 = _term(0, n, root, phi, source_phi), _term(1, n, root, phi, source_phi)
    from_n, from_0 = _term(2, n, root, phi, source_phi), _term(3, n, root, phi, source_phi)
    hard, soft = _axes(fields[0], k, along, along, work)
    far_hard, far_soft = _axes(fields[1], out, along, along, work)
    middle = (source_phi + phi) / 2.0
    cosine, sine, mirror_normal = math.cos(middle), math.sin(middle), work[4]
    for c in range(3):
        mirror_normal[c] = cosine * wedges.tangent[e, c] + sine * wedges.normal[e, c]

    total = (beside_n + beside_0) * (hard * far_hard + soft * far_soft)
    if not wedges.is_opaque[e]:
        mean, slope = work[5], dot(k, along)
        across = math.sqrt(max(0.0, 1.0 - slope * slope))
        for i in range(2):
            for c in range(3):
                beside = cosine * wedges.normal[e, c] - sine * wedges.tangent[e, c]
                mean[c] = slope * along[c] + (across if i == 0 else -across) * beside
            passed = _through(wedges, media, e, i == 0, f, mean, (hard, soft), work)
            total -= (beside_0 if i == 0 else beside_n) * (passed[0] * far_hard + passed[1] * far_soft)

    te, tm = _axes(fields[0], k, mirror_normal, along, work)
    far_te, far_tm = _axes(fields[1], out, mirror_normal, along, work)
    r_te, r_tm = _reflection(media, wedges.slab[e, 0], f, wedges.normal[e], k, out)
    total += from_0 * (r_te * te * far_te + r_tm * tm * far_tm)
    if wedges.angle[e] < 2.0 * math.pi - SCREEN_RAD or wedges.slab[e, 0] != wedges.slab[e, 1]:
        r_te, r_tm = _reflection(media, wedges.slab[e, 1], f, wedges.normal_n[e], k, out)
    total += from_n * (r_te * te * far_te + r_tm * tm * far_tm)
    return -0.5 * total


@bare
def place(wedges: Wedges, e: int, x: F64) -> Polar:
    """Where a point is from the start of an edge: along its face 0, away from that face, and along the edge."""
    a, b, z = 0.0, 0.0, 0.0
    for c in range(3):
        gap = x[c] - wedges.start[e, c]
        a += gap * wedges.tangent[e, c]
        b += gap * wedges.normal[e, c]
        z += gap * wedges.along[e, c]
    return a, b, z


@bare
def polar(wedges: Wedges, e: int, x: F64) -> Polar:
    """Distance of a point from the line of an edge, its place along the line in metres, and its angle φ."""
    a, b, z = place(wedges, e, x)
    angle = math.atan2(b, a)
    return math.sqrt(a * a + b * b), z, angle if angle >= 0.0 else angle + 2.0 * math.pi


@bare
def edge_point(near: Polar, far: Polar) -> float:
    """Where along its line the shortest way over the edge between two points, in polar coordinates, meets it."""
    together = near[0] + far[0]
    return (near[1] * far[0] + far[1] * near[0]) / together if together > 0.0 else -1.0
