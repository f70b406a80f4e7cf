"""Compiled kernels: the field that a wedge diffracts, by the uniform theory of diffraction.

Every other path that meets the faces of a wedge close to its edge ends where it would pass the edge: the one that goes
straight on, those that a face reflects or lets through, and those that turn to and fro inside before they come out.
To each belongs one term, which removes its jump. Unfolded, mirrored in each face that reflects it, such a path is a
straight line past the edge; it exists where the angle about the edge from its start to its end is less than a half
turn. Where no end is inside of the wedge, the terms are the four of Kouyoumjian and Pathak (Proc. IEEE 62, 1974), with
the coefficients of slabs (Burnside and Burgener, IEEE Trans. Antennas Propag. 31, 1983), and those of what both faces
let through. The two ends of a path may change places.
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
    length: F64  # (E,)
    angle: F64  # (E,): through free space
    slab: I64  # (E, 2, 2): kinds of face 0 and face n as seen from free space, and from inside; an index into Media
    is_opaque: Bools  # (E, 2): whether face 0 and face n let nothing through
    num_turns: I64  # (E,): so often can a path that meets both faces cross the inside before it has passed the edge
    has_inside: Bools  # (E,): whether ends inside of the wedge count


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
    if y > 8.0:  # the asymptotic series, to 3e-11
        turn, total = complex(0.0, 0.5 / (y * y)), 1.0 + 0j
        for k in range(15, 0, -2):
            total = 1.0 + k * turn * total
        return total * complex(math.sqrt(0.5), -math.sqrt(0.5)) / (math.sqrt(math.pi) * y)
    z = complex(y * math.sqrt(0.5), y * math.sqrt(0.5))
    inverse = 1.0 / (WIDTH + z)
    ratio, total = (WIDTH - z) * inverse, 0j
    for coefficient in SERIES:
        total = total * ratio + coefficient
    return inverse * (2.0 * total * inverse + 1.0 / math.sqrt(math.pi))


@part
def terms_of(wedges: Wedges, e: int, source_phi: float, phi: float) -> tuple[int, int, float]:
    """The first term of two ends about edge e, the one after the last, and the half turns n of their wedge.

    Terms come in pairs, one that meets face 0 first and one that meets face n first: 0 and 1 go straight on, one this
    way and one that way about the edge, 2 and 3 meet one face, and each later pair crosses the inside once more. With
    one end inside the waves spread as beside a screen (n = 2), with both as in a corner.
    """
    free = wedges.angle[e]
    num_inside, last = (source_phi > free) + (phi > free), 2 * wedges.num_turns[e] + 4
    if num_inside == 0:
        return 0, last, free / math.pi
    if num_inside == 1:
        return 2, last, 2.0
    # at right angles, and other whole parts of a half turn, the reflections join with no jump but that of polarization
    return 2, (6 if free < 1.5 * math.pi - SCREEN_RAD else 2), 2.0 - free / math.pi


@part
def _off_face(free: float, face: int, phi: float) -> float:
    """Angle between a direction about the edge and one of the faces, on the side of the face where it is."""
    if phi > free:
        return 2.0 * math.pi - phi if face == 0 else phi - free
    return phi if face == 0 else free - phi


@part
def unfolded(free: float, term: int, source_phi: float, phi: float) -> float:
    """Angle about the edge from one end to the other along the path of a term, unfolded."""
    first, num_turns = term % 2, term // 2 - 1
    if num_turns < 0:
        return phi - source_phi if first == 0 else source_phi - phi
    last = first if num_turns % 2 == 0 else 1 - first
    return _off_face(free, first, source_phi) + num_turns * (2.0 * math.pi - free) + _off_face(free, last, phi)


@part
def off_boundary(n: float, angle: float) -> float:
    """How far an unfolded angle is off a half turn, in half turns over n."""
    off = (math.pi - angle) / (2.0 * n)
    return off - math.pi * math.floor(off / math.pi + 0.5)


@bare
def _term(is_straight: bool, n: float, root: float, off: float) -> complex:
    """A term of Kouyoumjian and Pathak (1974), Eq. 25: cot(turn/2n)·F, ∓1 on the sides of its boundary.

    `root` is √(2kL) with L = s·s'/(s + s')·sin²β.
    """
    # a facet's rim belongs to the facet: it blocks, reflects and lets through there
    if abs(off) < 1e-12:
        return complex(-1.0 if is_straight else 1.0, 0.0)
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
def _axes(field: C128, k: F64, axis: F64, work: F64) -> Pair:
    """Components of a field along k×axis and k×(k×axis), of unit length."""
    norm = max(_cross(k, axis, work[0]), 1e-30)
    _cross(k, work[0], work[1])
    return _along(field, work[0]) / norm, _along(field, work[1]) / norm


@bare
def _coefficients(media: Media, kind: int, f: int, cosine: float) -> Four:
    """Reflection TE, TM and transmission TE, TM of a slab at its front."""
    a, b = media.first[kind], media.first[kind + 1]
    if b - a == 1:
        return coefficients(cosine, media.permittivity[f, a], media.phase_thickness[f, a])
    return stacked(cosine, media.permittivity[f, a:b], media.phase_thickness[f, a:b])


@part
def _over_faces(
    wedges: Wedges, media: Media, e: int, f: int, term: int, phis: tuple[float, float], slope: float, field: Pair
) -> Pair:
    """What the faces on the path of a term make of a wave from the first end at the angles `phis` to the second.

    The field is given along k×along and k×(k×along), of unit length, and `slope` is k·along. The path is turned about
    the edge to be straight: half of what its unfolded angle differs from a half turn at either end. Coefficients are
    those at the geometric mean of the cosines of incidence from the two ends.
    """
    free, first, num_turns, (hard, soft) = wedges.angle[e], term % 2, term // 2 - 1, field
    are_outside, angle = (phis[0] < free, phis[1] < free), unfolded(free, term, *phis)
    sign = 1.0 if (first == 0) == are_outside[0] else -1.0  # of the sense in which the path turns about the edge
    at, across = _off_face(free, first, phis[0]), math.sqrt(max(0.0, 1.0 - slope * slope))
    for i in range(num_turns + 1):
        if i > 0 and free > 2.0 * math.pi - SCREEN_RAD:
            break
        face = first if i % 2 == 0 else 1 - first
        is_passed = (i == 0 and are_outside[0]) != (i == num_turns and are_outside[1])
        if is_passed and wedges.is_opaque[e, face]:
            return 0j, 0j
        is_behind = not is_passed and (num_turns > 0 or not are_outside[0])
        kind = wedges.slab[e, face, 1 if is_behind else 0]
        cosine = across * math.sqrt(abs(math.sin(at) * math.sin(angle - at)))
        r_te, r_tm, t_te, t_tm = _coefficients(media, kind, f, cosine)
        aside = at + (math.pi - angle) / 2.0
        x, y = sign * slope * math.sin(aside), math.cos(aside)
        norm = math.hypot(x, y)
        x, y = (x / norm, y / norm) if norm > 1e-9 else (0.0, 1.0)
        te, tm = x * hard + y * soft, x * soft - y * hard
        if is_passed:
            te, tm = t_te * te, t_tm * tm
        else:  # unfolded, in the mirror, the TM field and k×along turn round
            te, tm = media.specular[kind] * r_te * te, -media.specular[kind] * r_tm * tm
        hard, soft = x * te - y * tm, y * te + x * tm
        at += 2.0 * math.pi - free
    num_passed = are_outside[0] + are_outside[1] if num_turns > 0 else are_outside[0] != are_outside[1]
    return (-hard if (num_turns + 1 - num_passed) % 2 == 1 else hard), soft


@bare
def diffract(
    wedges: Wedges,
    media: Media,
    e: int,
    f: int,
    waves: tuple[F64, F64],
    fields: tuple[C128, C128],
    phis: tuple[float, float],
    root: float,
    num_left: int,
    work: F64,
) -> complex:
    """What the second of two waves to the edge takes of the first, over 1/(s + s').

    `waves` are their directions (3,), `fields` those that they bring there (3,), `phis` the angles of `Edge` to where
    they come from. Paths that meet more than `num_left` faces are not traced, and have no terms.
    """
    out, along, free = work[2], wedges.along[e], wedges.angle[e]
    for c in range(3):
        out[c] = -waves[1][c]
    near, far = _axes(fields[0], waves[0], along, work), _axes(fields[1], out, along, work)
    slope, total, this_way, that_way = dot(waves[0], along), 0j, 0j, 0j
    first, last, n = terms_of(wedges, e, *phis)
    for term in range(first, last):
        num_met, field = term // 2 if free < 2.0 * math.pi - SCREEN_RAD else min(term // 2, 1), near
        if num_met > num_left:
            break
        if num_met > 0:
            field = _over_faces(wedges, media, e, f, term, phis, slope, near)
            if field[0] == 0j and field[1] == 0j:
                continue
        if first == 0 and term // 2 == 2:  # through both faces, the other way about the edge than straight on
            share = -this_way if term == 4 else -that_way
        else:
            share = _term(num_met == 0, n, root, off_boundary(n, unfolded(free, term, *phis)))
        this_way, that_way = share if term == 0 else this_way, share if term == 1 else that_way
        total += share * (field[0] * far[0] + field[1] * far[1])
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
