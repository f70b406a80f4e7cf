"""Compiled kernels of the image method, in float64 for planar facets.

A candidate is a sequence of planes, in the order in which a wave from the receiver meets them. Two things
describe its path completely: the image of the array centre, mirrored in one plane after another, and the
orthogonal matrix that mirrors an element's offset from the centre. The path is the straight line from the
transmitter to the element's image, folded back at every plane.

All kernels are in this one file because Numba's cache notices only changes of the file that a kernel is in.
A tuple that is passed on costs time for each array in it, so kernels take the tuples that they need and no more.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U64 = NDArray[np.uint64]
C128 = NDArray[np.complex128]
Bundle = tuple[int, ...]
Image = tuple[float, F64]
Sums = tuple[F64, F64]
Setup = tuple["Facets", "Media", "Aperture"]

MIN_SEGMENT_M = 0.01  # Sionna RT's MIN_SEGMENT_LENGTH: a path with a shorter segment is dropped
MAX_CROSSED = 16  # slabs on one segment; a path that crosses more is dropped, but is deeper than the limit
NOWHERE, MIXED, EVERYWHERE = 0, -1, 1  # at which elements a path arrives
LONE, CORNERS = (0,), (0, 1, 2, 3)  # bundles of paths that are followed side by side
NUM_CHUNKS = 64  # that the rays are divided into, for the threads
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}

# A kernel that calls no other and raises nothing does not count references to arrays, which took half the time.
_whole = njit(cache=True, fastmath=FAST, error_model="numpy")
_part = njit(cache=True, fastmath=FAST, error_model="numpy", forceinline=True)


class Facets(NamedTuple):
    """Convex planar facets, sorted by plane. (P planes, Q facets)"""

    normal: F64  # (3, P)
    offset: F64  # (P,): normal · x = offset
    first: I64  # (P + 1,): facets of plane p are first[p]:first[p + 1]
    plane: I64  # (Q,): the plane of each facet
    origin: F64  # (Q, 3)
    along_u: F64  # (Q, 3): u = (x − origin)·along_u runs 0…1 across the facet
    along_v: F64  # (Q, 3)
    is_triangle: NDArray[np.bool_]  # (Q,): u + v ≤ 1 holds too
    slab: I64  # (Q,): its kind, an index into Media
    is_opaque: NDArray[np.bool_]  # (Q,)


class Media(NamedTuple):
    """Kinds of slabs at each carrier, and the one antenna that all devices have. (F carriers, K kinds)"""

    permittivity: C128  # (F, K) relative
    phase_thickness: F64  # (F, K): 2π d / λ
    is_horizontal: bool
    is_dipole: bool


class Candidates(NamedTuple):
    """Plane sequences and the mirror images of the array centre behind them. (C candidates, depth limit D)"""

    length: I64  # (C,)
    plane: NDArray[np.int16]  # (C, D)
    image: F64  # (C, 3)
    mirror: F64  # (C, 3, 3)


class Aperture(NamedTuple):
    """The array at each carrier, carriers ascending. (M elements, N field nodes)"""

    wavelength_m: F64  # (F,)
    element_m: F64  # (F, M, 3) world offsets from the array centre
    corner_m: F64  # (F, 4, 3)
    node_m: F64  # (F, N, 3)
    weight: F64  # (N, M): field at the elements from the field at the nodes
    radius_m: float  # of the widest aperture; 1e30 lets every candidate pass the first rough test


class Path(NamedTuple):
    """One candidate; see `Candidates`."""

    length: int
    plane: NDArray[np.int16]  # (D,)
    image: F64  # (3,)
    mirror: F64  # (3, 3)


@njit(cache=True, inline="always")
def _dot(a: F64, b: F64) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _coordinates(facets: Facets, q: int, x: float, y: float, z: float) -> tuple[float, float]:
    dx, dy, dz = x - facets.origin[q, 0], y - facets.origin[q, 1], z - facets.origin[q, 2]
    u = dx * facets.along_u[q, 0] + dy * facets.along_u[q, 1] + dz * facets.along_u[q, 2]
    v = dx * facets.along_v[q, 0] + dy * facets.along_v[q, 1] + dz * facets.along_v[q, 2]
    return u, v


@njit(cache=True)
def _beyond(facets: Facets, q: int, x: float, y: float, z: float) -> int:
    """Bit set of the facet's edges that a point of its plane lies beyond; 0 means inside."""
    u, v = _coordinates(facets, q, x, y, z)
    if facets.is_triangle[q]:
        return (u < 0.0) | (v < 0.0) << 1 | (u + v > 1.0) << 4
    return (u < 0.0) | (v < 0.0) << 1 | (u > 1.0) << 2 | (v > 1.0) << 3


# --- which plane sequences matter: rays that branch into a reflected and a transmitted one ---


class Launch(NamedTuple):
    """How `launch` shoots its rays."""

    num_rays: int
    turn_rad: float  # of the sphere of rays about the vertical
    max_depth: int
    bits: int  # of a key that one plane takes


@njit(cache=True, fastmath=FAST)
def _first_hit(facets: Facets, o: F64, d: F64) -> tuple[int, int, float]:
    """Plane, facet and distance of what a ray from o along d meets first; plane −1 where it meets nothing."""
    hit_plane, hit_facet, nearest = -1, -1, 1e30
    normal = facets.normal
    for p in range(facets.offset.shape[0]):
        speed = normal[0, p] * d[0] + normal[1, p] * d[1] + normal[2, p] * d[2]
        if speed == 0.0:
            continue
        t = (facets.offset[p] - (normal[0, p] * o[0] + normal[1, p] * o[1] + normal[2, p] * o[2])) / speed
        if t < 1e-9 or t >= nearest:
            continue
        for q in range(facets.first[p], facets.first[p + 1]):
            if _beyond(facets, q, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]) == 0:
                hit_plane, hit_facet, nearest = p, q, t
                break
    return hit_plane, hit_facet, nearest


@njit(cache=True)
def _follow(facets: Facets, shot: Launch, top: int, ray: F64, state: U64, found: set[np.uint64]) -> int:
    """Follow the ray on top of the stack, and put the rays that go on from the facet it meets in its place.

    The stack holds origin and direction of each `ray` (S, 2, 3), and as its `state` (S, 3) a key, the number
    of reflections and that of all interactions. Returns the number of rays left; `found` gets the new key.
    """
    o, d, key, length = ray[top, 0], ray[top, 1], state[top, 0], state[top, 1]
    p, q, t = _first_hit(facets, o, d)
    if p < 0:
        return top
    reflected_key = key | (np.uint64(p + 1) << (np.uint64(shot.bits) * length))
    found.add(reflected_key)
    state[top, 2] += np.uint64(1)
    if state[top, 2] >= np.uint64(shot.max_depth):
        return top
    speed = facets.normal[0, p] * d[0] + facets.normal[1, p] * d[1] + facets.normal[2, p] * d[2]
    for c in range(3):
        o[c] += t * d[c]
    reflected = top if facets.is_opaque[q] else top + 1  # else the transmitted ray stays at `top`
    for c in range(3):
        ray[reflected, 0, c] = o[c]
        ray[reflected, 1, c] = d[c] - 2.0 * speed * facets.normal[c, p]
    state[reflected, 2] = state[top, 2]
    state[reflected, 0], state[reflected, 1] = reflected_key, length + np.uint64(1)
    return reflected + 1


@njit(cache=True)
def _sequences(facets: Facets, origin: F64, shot: Launch, chunk: int) -> U64:
    """Keys of the plane sequences that one chunk of the rays meets, in no particular order."""
    ray = np.zeros((shot.max_depth + 2, 2, 3))
    state = np.zeros((shot.max_depth + 2, 3), np.uint64)
    found = {np.uint64(0)}
    for index in range(chunk, shot.num_rays, NUM_CHUNKS):
        z = 1.0 - 2.0 * (index + 0.5) / shot.num_rays
        horizontal = math.sqrt(1.0 - z * z)
        azimuth = (index * 2.399963229728653 + shot.turn_rad) % (2.0 * math.pi)  # the golden angle
        ray[0, 0] = origin
        ray[0, 1, 0], ray[0, 1, 1] = horizontal * math.cos(azimuth), horizontal * math.sin(azimuth)
        ray[0, 1, 2] = z
        state[0] = 0
        num_rays = 1
        while num_rays > 0:
            num_rays = _follow(facets, shot, num_rays - 1, ray, state, found)
    return np.array(list(found))


@njit(cache=True, parallel=True)
def launch(facets: Facets, origin: F64, shot: Launch) -> list[U64]:
    """Keys of the plane sequences that a Fibonacci sphere of branching rays from `origin` meets, by chunk.

    A key holds plane + 1 of the i-th reflection in its i-th group of `bits` bits. Chunks have keys in common.
    """
    found = [np.zeros(0, np.uint64) for _ in range(NUM_CHUNKS)]
    for chunk in prange(NUM_CHUNKS):
        number: Any = np.int64(chunk)  # signed in prange too: compiled for one type
        found[chunk] = _sequences(facets, origin, shot, number)
    return found


# --- is a candidate worth tracing? ---


@_part
def _is_near_a_facet(facets: Facets, p: int, x: float, y: float, z: float, margin: float) -> bool:
    """Whether a point of plane p lies in one of its facets, each widened by `margin` metres."""
    for q in range(facets.first[p], facets.first[p + 1]):
        u, v = _coordinates(facets, q, x, y, z)
        au, av = facets.along_u[q], facets.along_v[q]
        u_margin, v_margin = margin * math.sqrt(_dot(au, au)), margin * math.sqrt(_dot(av, av))
        if u < -u_margin or v < -v_margin:
            continue
        if facets.is_triangle[q]:
            if u + v <= 1.0 + u_margin + v_margin:
                return True
        elif u <= 1.0 + u_margin and v <= 1.0 + v_margin:
            return True
    return False


@_whole
def _plausible(facets: Facets, path: Path, tx: F64, radius_m: float) -> bool:
    """Whether any element within `radius_m` of the array centre could see the path; never wrongly no.

    The path to the centre is tested against facets widened by what an element's offset can move the reflection at
    a share f of its length L: a plane at D from the image is at f·D / (D − (1 − f)·radius) at most for an element.
    """
    px, py, pz = tx[0], tx[1], tx[2]
    ix, iy, iz = path.image[0], path.image[1], path.image[2]
    total = math.sqrt((ix - px) ** 2 + (iy - py) ** 2 + (iz - pz) ** 2)
    passed, margin = 0.0, 0.0
    for step in range(path.length - 1, -1, -1):
        p = path.plane[step]
        nx, ny, nz = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p]
        here = nx * px + ny * py + nz * pz - facets.offset[p]
        there = nx * ix + ny * iy + nz * iz - facets.offset[p]
        if abs(there) <= radius_m or abs(here) <= margin:
            return True  # an offset may change the side: let the exact test decide
        if here * there >= 0.0:
            return False
        t = here / (here - there)
        px += t * (ix - px)
        py += t * (iy - py)
        pz += t * (iz - pz)
        away, passed = abs(there), passed + t * (1.0 - passed)
        along = math.sqrt(max(0.0, total * total - (away / (1.0 - passed)) ** 2))  # L in the plane
        most = passed * away / (away - (1.0 - passed) * radius_m)
        margin = (most - passed) * along + most * radius_m + 1e-9
        if not _is_near_a_facet(facets, p, px, py, pz, margin):
            return False
        ix -= 2.0 * there * nx
        iy -= 2.0 * there * ny
        iz -= 2.0 * there * nz
    return True


# --- a bundle of K paths side by side: to one element, or to the four corners of the aperture, which decide for
# --- the elements between them. The length of the tuple `bundle` is K, so that Numba compiles the loops for each K.


class Scratch(NamedTuple):
    """Work space of one thread, for a transmitter and up to four paths from it. (D depth, P planes)"""

    tx: F64  # (3,)
    vertex: F64  # (4, D + 2, 3): from the transmitter to the element
    side: F64  # (4, D + 2, P): signed distance of each vertex from each plane
    hit: I64  # (D + 1,) facet of each reflection, from the transmitter
    crossed: I64  # (D + 1, MAX_CROSSED) facets crossed on each segment, from the transmitter
    crossed_at: F64  # (D + 1, MAX_CROSSED): where, as a share of the first path's segment
    num_crossed: I64  # (D + 1,)
    num_left: I64  # (1,): interactions that the paths may still have
    direction: F64  # (3,): of the wave
    field: C128  # (3,)
    gain: C128  # (N,)


@njit(cache=True)
def new_scratch(num_planes: int, max_depth: int, num_nodes: int, tx: F64) -> Scratch:
    """Work space for paths of the transmitter at `tx` (3,) with at most `max_depth` interactions."""
    return Scratch(
        tx,
        np.zeros((4, max_depth + 2, 3)),
        np.zeros((4, max_depth + 2, num_planes)),
        np.zeros(max_depth + 1, np.int64),
        np.zeros((max_depth + 1, MAX_CROSSED), np.int64),
        np.zeros((max_depth + 1, MAX_CROSSED)),
        np.zeros(max_depth + 1, np.int64),
        np.zeros(1, np.int64),
        np.zeros(3),
        np.zeros(3, np.complex128),
        np.zeros(num_nodes, np.complex128),
    )


@_part
def _reflect(facets: Facets, p: int, j: int, n: int, bundle: Bundle, vertex: F64) -> int:
    """Fold the paths at plane p: vertex j + 1 is where they meet it, and their ends, vertex n + 1, are mirrored.

    EVERYWHERE where all of them meet it, NOWHERE where they all stay on the same side.
    """
    nx, ny, nz, offset = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p], facets.offset[p]
    num_apart = num_above = 0
    for k in range(len(bundle)):
        here = nx * vertex[k, j, 0] + ny * vertex[k, j, 1] + nz * vertex[k, j, 2] - offset
        there = nx * vertex[k, n + 1, 0] + ny * vertex[k, n + 1, 1] + nz * vertex[k, n + 1, 2] - offset
        num_above += here > 0.0
        num_apart += here * there < 0.0
        t = here / (here - there) if here * there < 0.0 else 0.0
        for a in range(3):
            vertex[k, j + 1, a] = vertex[k, j, a] + t * (vertex[k, n + 1, a] - vertex[k, j, a])
            vertex[k, n + 1, a] -= 2.0 * there * facets.normal[a, p]
    if num_apart == 0 and (num_above == 0 or num_above == len(bundle)):
        return NOWHERE
    return EVERYWHERE if num_apart == len(bundle) else MIXED


@_part
def _hit(facets: Facets, p: int, j: int, bundle: Bundle, scratch: Scratch) -> int:
    """Find the facet of plane p that all paths hit at their vertex j + 1.

    MIXED where only some of them hit a facet that comes before it: each path takes the first that it meets.
    """
    vertex = scratch.vertex
    for q in range(facets.first[p], facets.first[p + 1]):
        beyond_all, num_inside = 31, 0
        for k in range(len(bundle)):
            beyond = _beyond(facets, q, vertex[k, j + 1, 0], vertex[k, j + 1, 1], vertex[k, j + 1, 2])
            beyond_all &= beyond
            num_inside += beyond == 0
        if num_inside == len(bundle):
            scratch.hit[j] = q
            return EVERYWHERE
        if beyond_all == 0:
            return MIXED
    return NOWHERE


@_part
def _fold(facets: Facets, path: Path, offset_m: F64, bundle: Bundle, scratch: Scratch) -> int:
    """Fold the lines from the transmitter to the images of the elements at `offset_m` (K, 3) into the room."""
    n, vertex = path.length, scratch.vertex
    for k in range(len(bundle)):
        for a in range(3):
            vertex[k, 0, a] = scratch.tx[a]
            vertex[k, n + 1, a] = path.image[a] + _dot(path.mirror[a], offset_m[k])
    for j in range(n):
        p = path.plane[n - 1 - j]
        verdict = _reflect(facets, p, j, n, bundle, vertex)
        if verdict == EVERYWHERE:
            verdict = _hit(facets, p, j, bundle, scratch)
        if verdict != EVERYWHERE:
            return verdict
    return EVERYWHERE


@_part
def _crosses(facets: Facets, q: int, s: int, bundle: Bundle, vertex: F64, side: F64) -> int:
    """Whether all, none or some of the segments s of the paths cross facet q."""
    p, beyond_all, num_inside, num_crossing = facets.plane[q], 31, 0, 0
    for k in range(len(bundle)):
        here, there = side[k, s, p], side[k, s + 1, p]
        if here * there < 0.0:
            t = here / (here - there)
            ax, ay, az = vertex[k, s, 0], vertex[k, s, 1], vertex[k, s, 2]
            bx, by, bz = vertex[k, s + 1, 0], vertex[k, s + 1, 1], vertex[k, s + 1, 2]
            beyond = _beyond(facets, q, ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az))
            beyond_all &= beyond
            num_inside += beyond == 0
            num_crossing += 1
    if num_inside == len(bundle):
        return EVERYWHERE
    if num_crossing < len(bundle) > 1:  # others may end on it: all ends must lie beyond a common edge
        beyond_all = 31
        for k in range(len(bundle)):
            for v in range(s, s + 2):
                beyond_all &= _beyond(facets, q, vertex[k, v, 0], vertex[k, v, 1], vertex[k, v, 2])
    return NOWHERE if beyond_all != 0 else MIXED


@_part
def _cross(facets: Facets, q: int, s: int, t: float, scratch: Scratch) -> bool:
    """Let the paths cross facet q at share t of segment s; False where that ends them: opaque, or too deep.

    Crossings of a segment are kept in the order in which a wave from the transmitter meets them.
    """
    crossed, crossed_at, i = scratch.crossed, scratch.crossed_at, scratch.num_crossed[s]
    if facets.is_opaque[q] or scratch.num_left[0] == 0 or i >= MAX_CROSSED:
        return False
    while i > 0 and crossed_at[s, i - 1] > t:
        crossed[s, i], crossed_at[s, i] = crossed[s, i - 1], crossed_at[s, i - 1]
        i -= 1
    crossed[s, i], crossed_at[s, i] = q, t
    scratch.num_crossed[s] += 1
    scratch.num_left[0] -= 1
    return True


@_part
def _cross_all(facets: Facets, before: int, after: int, s: int, bundle: Bundle, scratch: Scratch) -> int:
    """Find what the segments s of all paths cross between planes `before` and `after`, where they turn.

    NOWHERE where it ends the paths, MIXED where they do not all cross the same facets.
    """
    verdict, side = EVERYWHERE, scratch.side
    scratch.num_crossed[s] = 0
    for p in range(facets.offset.shape[0]):
        lowest = highest = side[0, s, p]
        for k in range(len(bundle)):
            lowest = min(lowest, min(side[k, s, p], side[k, s + 1, p]))
            highest = max(highest, max(side[k, s, p], side[k, s + 1, p]))
        if lowest > 0.0 or highest < 0.0 or p == before or p == after:
            continue
        for q in range(facets.first[p], facets.first[p + 1]):
            crossed = _crosses(facets, q, s, bundle, scratch.vertex, side)
            if crossed == NOWHERE:
                continue
            if crossed == MIXED:
                verdict = MIXED
            elif not _cross(facets, q, s, side[0, s, p] / (side[0, s, p] - side[0, s + 1, p]), scratch):
                return NOWHERE
            break  # of the facets in a plane only the first that a path meets counts
    return verdict


@_part
def _shortest_stretch(facets: Facets, n: int, k: int, scratch: Scratch) -> float:
    """Shortest stretch in metres of path k between successive interactions, in the order of path 0.

    Negative where path k meets two slabs in the opposite order.
    """
    shortest, vertex = 1e30, scratch.vertex
    for s in range(n + 1):
        dx = vertex[k, s + 1, 0] - vertex[k, s, 0]
        dy = vertex[k, s + 1, 1] - vertex[k, s, 1]
        dz = vertex[k, s + 1, 2] - vertex[k, s, 2]
        span = math.sqrt(dx**2 + dy**2 + dz**2)
        last = 0.0
        for i in range(scratch.num_crossed[s]):
            p = facets.plane[scratch.crossed[s, i]]
            here, there = scratch.side[k, s, p], scratch.side[k, s + 1, p]
            at = here / (here - there)
            shortest = min(shortest, (at - last) * span)
            last = at
        shortest = min(shortest, (1.0 - last) * span)
    return shortest


@_whole
def trace(facets: Facets, path: Path, offset_m: F64, bundle: Bundle, scratch: Scratch) -> int:
    """Whether a path reaches EVERYWHERE, NOWHERE or, MIXED, only some of `offset_m` (K, 3).

    With four corners, EVERYWHERE and NOWHERE hold for all elements between them: the point where a path meets
    a plane is a projective map of the element's position, so convex facets have convex preimages. That is so for
    every narrower aperture about the same centre too. Stretches are not quite linear in the position: each
    corner's have to be twice the shortest that a path may have. Facets met are left in `scratch`.
    """
    verdict = _fold(facets, path, offset_m, bundle, scratch)
    if verdict != EVERYWHERE:
        return verdict
    n, plane, normal, vertex = path.length, path.plane, facets.normal, scratch.vertex
    for k in range(len(bundle)):
        for v in range(n + 2):
            x, y, z = vertex[k, v, 0], vertex[k, v, 1], vertex[k, v, 2]
            side = scratch.side[k, v]
            for p in range(facets.offset.shape[0]):
                side[p] = normal[0, p] * x + normal[1, p] * y + normal[2, p] * z - facets.offset[p]
    scratch.num_left[0] = plane.shape[0] - n
    for s in range(n + 1):
        before, after = plane[n - s] if s > 0 else -1, plane[n - 1 - s] if s < n else -1
        crossed = _cross_all(facets, before, after, s, bundle, scratch)
        if crossed == NOWHERE:
            return NOWHERE
        if crossed == MIXED:
            verdict = MIXED
    is_lone = len(bundle) == 1
    for k in range(len(bundle)):
        if _shortest_stretch(facets, n, k, scratch) < (MIN_SEGMENT_M if is_lone else 2 * MIN_SEGMENT_M):
            return NOWHERE if is_lone else MIXED
    return verdict


# --- the field along a path ---


@njit(cache=True, fastmath=FAST)
def slab_coefficients(
    cosine: float, permittivity: complex, phase_thickness: float
) -> tuple[complex, complex, complex, complex]:
    """Reflection TE, TM and transmission TE, TM of a slab (ITU-R P.2040, Eqs. 37, 43, 44)."""
    root = np.sqrt(permittivity - (1.0 - cosine * cosine))
    if root.imag > 0.0:
        root = -root
    te = (cosine - root) / (cosine + root)
    tm = (permittivity * cosine - root) / (permittivity * cosine + root)
    q = phase_thickness * root
    if q.imag < -40.0:  # nothing comes back from the far face
        return te, tm, 0j, 0j
    decay = math.exp(q.imag)
    once = complex(decay * math.cos(q.real), -decay * math.sin(q.real))
    twice = once * once
    te2, tm2 = te * te, tm * tm
    inverse_te, inverse_tm = 1.0 / (1.0 - te2 * twice), 1.0 / (1.0 - tm2 * twice)
    return (
        te * (1.0 - twice) * inverse_te,
        tm * (1.0 - twice) * inverse_tm,
        (1.0 - te2) * once * inverse_te,
        (1.0 - tm2) * once * inverse_tm,
    )


@njit(cache=True, fastmath=FAST)
def _interact(facets: Facets, media: Media, q: int, f: int, is_reflected: bool, scratch: Scratch) -> None:
    """Apply a slab to the field: E_s along k×n, E_p along k×s, both before and after."""
    k, field, p, kind = scratch.direction, scratch.field, facets.plane[q], facets.slab[q]
    nx, ny, nz = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p]
    slope = k[0] * nx + k[1] * ny + k[2] * nz
    permittivity, phase_thickness = media.permittivity[f, kind], media.phase_thickness[f, kind]
    r_te, r_tm, t_te, t_tm = slab_coefficients(abs(slope), permittivity, phase_thickness)
    sx, sy, sz = k[1] * nz - k[2] * ny, k[2] * nx - k[0] * nz, k[0] * ny - k[1] * nx
    norm = math.sqrt(sx * sx + sy * sy + sz * sz)
    if norm < 1e-9:  # normal incidence: any transverse direction is both TE and TM
        if abs(nx) < 0.5:
            sx, sy, sz = 0.0, nz, -ny
        else:
            sx, sy, sz = -nz, 0.0, nx
        norm = math.sqrt(sx * sx + sy * sy + sz * sz)
    sx, sy, sz = sx / norm, sy / norm, sz / norm
    px, py, pz = k[1] * sz - k[2] * sy, k[2] * sx - k[0] * sz, k[0] * sy - k[1] * sx
    te = field[0] * sx + field[1] * sy + field[2] * sz
    tm = field[0] * px + field[1] * py + field[2] * pz
    if is_reflected:
        te, tm = r_te * te, r_tm * tm
        k[0] -= 2.0 * slope * nx
        k[1] -= 2.0 * slope * ny
        k[2] -= 2.0 * slope * nz
        px, py, pz = k[1] * sz - k[2] * sy, k[2] * sx - k[0] * sz, k[0] * sy - k[1] * sx
    else:
        te, tm = t_te * te, t_tm * tm
    field[0] = te * sx + tm * px
    field[1] = te * sy + tm * py
    field[2] = te * sz + tm * pz


@njit(cache=True)
def _antenna_field(media: Media, x: float, y: float, z: float) -> tuple[float, float, float]:
    """World components of the antenna's real field towards a direction."""
    horizontal = math.sqrt(x * x + y * y)
    if horizontal > 1e-12:
        cos_phi, sin_phi = x / horizontal, y / horizontal
    else:  # opposite directions, as the ends of a vertical ray see them, have opposite azimuths here too
        cos_phi, sin_phi = math.copysign(1.0, z), 0.0
    scale = math.sqrt(1.5) * horizontal if media.is_dipole else 1.0
    if media.is_horizontal:
        return -scale * sin_phi, scale * cos_phi, 0.0
    return scale * z * cos_phi, scale * z * sin_phi, -scale * horizontal


@njit(cache=True, fastmath=FAST)
def gains(facets: Facets, media: Media, path: Path, offset_m: F64, f: int, scratch: Scratch) -> C128:
    """Field that antennas at `offset_m` (N, 3) take at carrier f from the path traced last. (N,)

    Spreading and travel phase are left out. `scratch.direction` is then that of the wave at the last antenna.
    """
    k, field = scratch.direction, scratch.field
    for node in range(offset_m.shape[0]):
        norm = 0.0
        for a in range(3):
            k[a] = path.image[a] + _dot(path.mirror[a], offset_m[node]) - scratch.tx[a]
            norm += k[a] * k[a]
        norm = math.sqrt(norm)
        for a in range(3):
            k[a] /= norm
        ex, ey, ez = _antenna_field(media, k[0], k[1], k[2])
        field[0], field[1], field[2] = ex, ey, ez
        for s in range(path.length + 1):
            for i in range(scratch.num_crossed[s]):
                _interact(facets, media, scratch.crossed[s, i], f, False, scratch)
            if s < path.length:
                _interact(facets, media, scratch.hit[s], f, True, scratch)
        ex, ey, ez = _antenna_field(media, -k[0], -k[1], -k[2])
        scratch.gain[node] = field[0] * ex + field[1] * ey + field[2] * ez
    return scratch.gain[: offset_m.shape[0]]


# --- channels: sums over paths ---


@njit(cache=True, fastmath=FAST)
def _spread(gain: C128, weight: F64, image: Image, element_m: F64, wavelength_m: float, sums: Sums) -> None:
    """Add gain·(λ/4πL)·exp(−j2πL/λ) at every element, L the exact distance to the element's image.

    `weight` (N, E) takes the gain at N nodes to E elements. Sine and cosine are polynomials of half the
    phase within ±π/2 (error below 1e-10), so that the elements run in vector lanes.
    """
    (distance2, toward), (real, imag) = image, sums
    for e in range(element_m.shape[0]):
        x, y, z = element_m[e, 0], element_m[e, 1], element_m[e, 2]
        distance = math.sqrt(
            distance2 - 2.0 * (toward[0] * x + toward[1] * y + toward[2] * z) + (x * x + y * y + z * z)
        )
        turns = distance / wavelength_m
        half = math.pi * (turns - math.floor(turns + 0.5))
        h2 = half * half
        sine = -1 / 39916800 + h2 * (1 / 6227020800 - h2 / 1307674368000)
        sine = -1 / 6 + h2 * (1 / 120 + h2 * (-1 / 5040 + h2 * (1 / 362880 + h2 * sine)))
        sine = half * (1.0 + h2 * sine)
        cosine = -1 / 3628800 + h2 * (1 / 479001600 - h2 / 87178291200)
        cosine = -1 / 2 + h2 * (1 / 24 + h2 * (-1 / 720 + h2 * (1 / 40320 + h2 * cosine)))
        cosine = 1.0 + h2 * cosine
        gain_real = gain_imag = 0.0
        for node in range(weight.shape[0]):
            gain_real += weight[node, e] * gain[node].real
            gain_imag += weight[node, e] * gain[node].imag
        scale = wavelength_m / (4.0 * math.pi * distance)
        phase_real = scale * (1.0 - 2.0 * sine * sine)
        phase_imag = -scale * 2.0 * sine * cosine
        real[e] += gain_real * phase_real - gain_imag * phase_imag
        imag[e] += gain_real * phase_imag + gain_imag * phase_real


@njit(cache=True)
def _add_path(setup: Setup, path: Path, share: bool, scratch: Scratch, sums: Sums, num_paths: I32) -> None:
    """Add a path to `sums` (F, M) each; at the first carrier, the widest aperture, it is decided for all."""
    facets, media, aperture = setup
    (real, imag), one, reach = sums, np.ones((1, 1)), MIXED
    distance2, toward = 0.0, np.zeros(3)  # transmitter − image of the array centre, in the elements' axes
    for a in range(3):
        gap = scratch.tx[a] - path.image[a]
        distance2 += gap * gap
        for b in range(3):
            toward[b] += gap * path.mirror[a, b]
    for f in range(num_paths.shape[0]):
        element_m, wavelength_m = aperture.element_m[f], aperture.wavelength_m[f]
        if share and reach == MIXED:
            reach = trace(facets, path, aperture.corner_m[f], CORNERS, scratch)
        if reach == NOWHERE:
            break
        is_heard = False
        if reach == EVERYWHERE:
            gain = gains(facets, media, path, aperture.node_m[f], f, scratch)
            _spread(gain, aperture.weight, (distance2, toward), element_m, wavelength_m, (real[f], imag[f]))
            is_heard = bool(np.any(gain != 0))
        else:
            for e in range(element_m.shape[0]):
                own = element_m[e : e + 1]
                if trace(facets, path, own, LONE, scratch) == EVERYWHERE:
                    gain = gains(facets, media, path, own, f, scratch)
                    _spread(
                        gain,
                        one,
                        (distance2, toward),
                        own,
                        wavelength_m,
                        (real[f, e : e + 1], imag[f, e : e + 1]),
                    )
                    is_heard |= gain[0] != 0
        num_paths[f] += is_heard


@njit(cache=True, parallel=True)
def channels(
    facets: Facets, media: Media, candidates: Candidates, aperture: Aperture, tx_position_m: F64, share: bool
) -> tuple[F64, F64, I32]:
    """Channels (T, F, M), real and imaginary, and path counts (T, F); each is summed in a fixed order.

    A path counts where its field reaches at least one element and has not vanished on the way. With `share`
    the corners of the aperture decide for the elements between them, which changes the answer by rounding only.
    """
    max_depth, num_nodes = candidates.plane.shape[1], aperture.node_m.shape[1]
    shape = len(tx_position_m), aperture.element_m.shape[0], aperture.element_m.shape[1]
    real, imag, num_paths = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int32)
    for i in prange(len(tx_position_m)):
        scratch = new_scratch(facets.offset.shape[0], max_depth, num_nodes, tx_position_m[i])
        for c in range(candidates.length.shape[0]):
            path = Path(candidates.length[c], candidates.plane[c], candidates.image[c], candidates.mirror[c])
            if _plausible(facets, path, scratch.tx, aperture.radius_m):
                _add_path((facets, media, aperture), path, share, scratch, (real[i], imag[i]), num_paths[i])
    return real, imag, num_paths


@njit(cache=True)
def reaching(facets: Facets, candidates: Candidates, tx: F64) -> I64:
    """Candidates whose path reaches the array centre from the transmitter at `tx` (3,)."""
    scratch = new_scratch(facets.offset.shape[0], candidates.plane.shape[1], 1, tx)
    found = np.zeros(candidates.length.shape[0], np.bool_)
    for c in range(found.shape[0]):
        path = Path(candidates.length[c], candidates.plane[c], candidates.image[c], candidates.mirror[c])
        if _plausible(facets, path, tx, 0.0):
            found[c] = trace(facets, path, np.zeros((1, 3)), LONE, scratch) == EVERYWHERE
    return np.flatnonzero(found)
