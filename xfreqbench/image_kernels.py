"""Compiled kernels of the image method: planar facets, float64, one path at a time.

A candidate is a sequence of planes in the order a wave from the receiver meets them. The receiver's
mirror image behind them and the orthogonal matrix that mirrors an element's offset are all that a path
needs: the path is the straight line from the transmitter to that image, folded back at every plane.

All kernels stand in this one file because Numba's cache notices changes of a kernel's own file only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MIN_SEGMENT_M = 0.01  # Sionna RT's MIN_SEGMENT_LENGTH: shorter segments void a path
MAX_CROSSED = 16  # transmissions on one segment; more void the path, and the depth limit is far below
NOWHERE, MIXED, EVERYWHERE = 0, -1, 1
FAST = {"nnan", "ninf", "nsz", "arcp", "contract", "afn", "reassoc"}


class Facets(NamedTuple):
    """Convex planar facets, sorted by plane. (P planes, Q facets)"""

    normal: F64  # (3, P)
    offset: F64  # (P,): normal · x = offset
    first: I64  # (P + 1,): facets of plane p are first[p]:first[p + 1]
    origin: F64  # (Q, 3)
    along_u: F64  # (Q, 3): u = (x − origin)·along_u runs 0…1 across the facet
    along_v: F64  # (Q, 3)
    is_triangle: NDArray[np.bool_]  # (Q,): u + v ≤ 1 holds too
    slab: I64  # (Q,): index into Slabs
    is_opaque: NDArray[np.bool_]  # (Q,)


class Slabs(NamedTuple):
    """Materials at each carrier. (F carriers, K kinds)"""

    permittivity: NDArray[np.complex128]  # (F, K) relative
    phase_thickness: F64  # (F, K): 2π d / λ


class Candidates(NamedTuple):
    """Plane sequences and the mirror images of the array centre behind them. (C candidates)"""

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
    radius_m: float  # of the widest aperture


class Antenna(NamedTuple):
    """The one antenna of all devices."""

    is_horizontal: bool
    is_dipole: bool


def num_threads() -> int:
    """Threads that `launch` and `channels` run on."""
    return int(get_num_threads())


@njit(cache=True, inline="always")
def _dot(a: F64, b: F64) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _coordinates(facets: Facets, q: int, x: float, y: float, z: float) -> tuple[float, float]:
    dx = x - facets.origin[q, 0]
    dy = y - facets.origin[q, 1]
    dz = z - facets.origin[q, 2]
    u = dx * facets.along_u[q, 0] + dy * facets.along_u[q, 1] + dz * facets.along_u[q, 2]
    v = dx * facets.along_v[q, 0] + dy * facets.along_v[q, 1] + dz * facets.along_v[q, 2]
    return u, v


@njit(cache=True)
def _outside(facets: Facets, q: int, u: float, v: float) -> int:
    """Bit set of the edges that a point lies beyond; 0 is inside."""
    beyond = 0
    if u < 0.0:
        beyond |= 1
    if v < 0.0:
        beyond |= 2
    if facets.is_triangle[q]:
        if u + v > 1.0:
            beyond |= 16
    else:
        if u > 1.0:
            beyond |= 4
        if v > 1.0:
            beyond |= 8
    return beyond


# --- which plane sequences matter: rays that branch into a reflected and a transmitted one ---


@njit(cache=True, fastmath=FAST)
def _first_hit(facets: Facets, o: F64, d: F64) -> tuple[int, int, float]:
    nearest = 1e30
    hit_plane = -1
    hit_facet = -1
    normal = facets.normal
    for p in range(facets.offset.shape[0]):
        speed = normal[0, p] * d[0] + normal[1, p] * d[1] + normal[2, p] * d[2]
        if speed == 0.0:
            continue
        gap = facets.offset[p] - (normal[0, p] * o[0] + normal[1, p] * o[1] + normal[2, p] * o[2])
        t = gap / speed
        if t < 1e-9 or t >= nearest:
            continue
        for q in range(facets.first[p], facets.first[p + 1]):
            u, v = _coordinates(facets, q, o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
            if _outside(facets, q, u, v) == 0:
                nearest = t
                hit_plane = p
                hit_facet = q
                break
    return hit_plane, hit_facet, nearest


@njit(cache=True, parallel=True)
def launch(
    facets: Facets, origin: F64, num_rays: int, turn: float, max_depth: int, bits: int, num_chunks: int
) -> list[NDArray[np.uint64]]:
    """Keys of the plane sequences that a Fibonacci sphere of branching rays meets.

    A key holds plane + 1 of the i-th reflection in its i-th group of `bits` bits. Chunks are merged by
    the caller, so the result does not depend on the number of threads.
    """
    found = [np.zeros(0, np.uint64) for _ in range(num_chunks)]
    for chunk in prange(num_chunks):
        stack_o = np.zeros((max_depth + 2, 3))
        stack_d = np.zeros((max_depth + 2, 3))
        stack_key = np.zeros(max_depth + 2, np.uint64)
        stack_depth = np.zeros(max_depth + 2, np.int64)
        stack_length = np.zeros(max_depth + 2, np.int64)
        o = np.zeros(3)
        d = np.zeros(3)
        seen = {np.uint64(0)}
        for ray in range(chunk, num_rays, num_chunks):
            z = 1.0 - 2.0 * (ray + 0.5) / num_rays
            r = math.sqrt(1.0 - z * z)
            azimuth = (ray * 2.399963229728653 + turn) % (2.0 * math.pi)  # the golden angle
            top = 1
            stack_o[0] = origin
            stack_d[0, 0] = r * math.cos(azimuth)
            stack_d[0, 1] = r * math.sin(azimuth)
            stack_d[0, 2] = z
            stack_key[0] = 0
            stack_depth[0] = 0
            stack_length[0] = 0
            while top > 0:
                top -= 1
                o[:] = stack_o[top]
                d[:] = stack_d[top]
                key = stack_key[top]
                depth = stack_depth[top]
                length = stack_length[top]
                p, q, t = _first_hit(facets, o, d)
                if p < 0:
                    continue
                for c in range(3):
                    o[c] += t * d[c]
                # the reflected ray is a sequence of its own; either goes on while the depth allows more
                reflected_key = key | (np.uint64(p + 1) << np.uint64(bits * length))
                seen.add(reflected_key)
                if depth + 1 >= max_depth:
                    continue
                if not facets.is_opaque[q]:
                    stack_o[top] = o
                    stack_d[top] = d
                    stack_key[top] = key
                    stack_depth[top] = depth + 1
                    stack_length[top] = length
                    top += 1
                speed = 0.0
                for c in range(3):
                    speed += facets.normal[c, p] * d[c]
                stack_o[top] = o
                for c in range(3):
                    stack_d[top, c] = d[c] - 2.0 * speed * facets.normal[c, p]
                stack_key[top] = reflected_key
                stack_depth[top] = depth + 1
                stack_length[top] = length + 1
                top += 1
        keys = np.zeros(len(seen), np.uint64)
        index = 0
        for key in seen:
            keys[index] = key
            index += 1
        found[chunk] = keys
    return found


# --- one path: where it meets the planes, what it crosses ---


class Scratch(NamedTuple):
    """Work space of one thread. (D depth, P planes)"""

    target: F64  # (4, 3)
    vertex: F64  # (4, D + 2, 3)
    side: F64  # (4, D + 2, P)
    hit: I64  # (D,) facet of each reflection, from the transmitter
    crossed: I64  # (D + 1, MAX_CROSSED) facets crossed on each segment, from the transmitter
    crossed_at: F64  # (D + 1, MAX_CROSSED)
    num_crossed: I64  # (D + 1,)
    direction: F64  # (3,)
    field: NDArray[np.complex128]  # (3,)


@njit(cache=True)
def new_scratch(depth: int, num_planes: int) -> Scratch:
    """Work space for paths of at most `depth` interactions."""
    return Scratch(
        np.zeros((4, 3)),
        np.zeros((4, depth + 2, 3)),
        np.zeros((4, depth + 2, num_planes)),
        np.zeros(depth + 1, np.int64),
        np.zeros((depth + 1, MAX_CROSSED), np.int64),
        np.zeros((depth + 1, MAX_CROSSED)),
        np.zeros(depth + 1, np.int64),
        np.zeros(3),
        np.zeros(3, np.complex128),
    )


@njit(cache=True, fastmath=FAST)
def _plausible(facets: Facets, candidates: Candidates, c: int, tx: F64, radius_m: float) -> bool:
    """Whether any element within `radius_m` of the array centre could see the path; never wrongly no.

    The path to the centre is tested against facets widened by what an element's offset can move the
    point of reflection: (s/L)·radius/cos θ at distance s of L, to first order, with a fifth to spare.
    """
    px, py, pz = tx[0], tx[1], tx[2]
    ix, iy, iz = candidates.image[c, 0], candidates.image[c, 1], candidates.image[c, 2]
    total = math.sqrt((ix - px) ** 2 + (iy - py) ** 2 + (iz - pz) ** 2)
    margin = 0.0
    for step in range(candidates.length[c] - 1, -1, -1):
        p = candidates.plane[c, step]
        nx, ny, nz = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p]
        here = nx * px + ny * py + nz * pz - facets.offset[p]
        there = nx * ix + ny * iy + nz * iz - facets.offset[p]
        if abs(there) <= radius_m or abs(here) <= margin:
            return True  # an offset may change the side: let the exact test decide
        if here * there >= 0.0:
            return False
        t = here / (here - there)
        remaining = math.sqrt((ix - px) ** 2 + (iy - py) ** 2 + (iz - pz) ** 2)
        px += t * (ix - px)
        py += t * (iy - py)
        pz += t * (iz - pz)
        cosine = abs(here - there) / remaining
        share = 1.0 - (1.0 - t) * remaining / total
        margin = 1.2 * radius_m * share / cosine + 1e-9
        near = False
        for q in range(facets.first[p], facets.first[p + 1]):
            u, v = _coordinates(facets, q, px, py, pz)
            au, av = facets.along_u[q], facets.along_v[q]
            u_margin = margin * math.sqrt(_dot(au, au))
            v_margin = margin * math.sqrt(_dot(av, av))
            if u < -u_margin or v < -v_margin:
                continue
            if facets.is_triangle[q]:
                if u + v > 1.0 + u_margin + v_margin:
                    continue
            elif u > 1.0 + u_margin or v > 1.0 + v_margin:
                continue
            near = True
            break
        if not near:
            return False
        ix -= 2.0 * there * nx
        iy -= 2.0 * there * ny
        iz -= 2.0 * there * nz
    return True


@njit(cache=True, fastmath=FAST)
def _sides(facets: Facets, scratch: Scratch, corner: int, num_vertices: int) -> None:
    for v in range(num_vertices):
        x, y, z = scratch.vertex[corner, v, 0], scratch.vertex[corner, v, 1], scratch.vertex[corner, v, 2]
        side = scratch.side[corner, v]
        for p in range(facets.offset.shape[0]):
            side[p] = (
                facets.normal[0, p] * x + facets.normal[1, p] * y + facets.normal[2, p] * z - facets.offset[p]
            )


@njit(cache=True, fastmath=FAST)
def _insert_crossing(scratch: Scratch, segment: int, q: int, t: float) -> None:
    """Keep the crossings of a segment in the order a wave from the transmitter meets them."""
    i = scratch.num_crossed[segment]
    while i > 0 and scratch.crossed_at[segment, i - 1] > t:
        scratch.crossed[segment, i] = scratch.crossed[segment, i - 1]
        scratch.crossed_at[segment, i] = scratch.crossed_at[segment, i - 1]
        i -= 1
    scratch.crossed[segment, i] = q
    scratch.crossed_at[segment, i] = t
    scratch.num_crossed[segment] += 1


@njit(cache=True, fastmath=FAST)
def _shortest_piece(facets: Facets, scratch: Scratch, corner: int, length: int) -> float:
    """Shortest stretch of a corner's path between successive interactions, in corner 0's order.

    Negative where this corner meets two slabs the other way round.
    """
    shortest = 1e30
    for s in range(length + 1):
        a, b = scratch.vertex[corner, s], scratch.vertex[corner, s + 1]
        span = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
        last = 0.0
        for i in range(scratch.num_crossed[s]):
            p = _plane_of(facets, scratch.crossed[s, i])
            here, there = scratch.side[corner, s, p], scratch.side[corner, s + 1, p]
            at = here / (here - there)
            shortest = min(shortest, (at - last) * span)
            last = at
        shortest = min(shortest, (1.0 - last) * span)
    return shortest


@njit(cache=True, fastmath=FAST)
def _fold(facets: Facets, candidates: Candidates, c: int, tx: F64, offset: F64, scratch: Scratch) -> bool:
    """Fold the line from the transmitter to one element's image back into the room, into corner 0."""
    vertex = scratch.vertex[0]
    target = scratch.target[0]
    n = candidates.length[c]
    for a in range(3):
        vertex[0, a] = tx[a]
        target[a] = candidates.image[c, a] + _dot(candidates.mirror[c, a], offset)
    for j in range(n):
        p = candidates.plane[c, n - 1 - j]
        nx, ny, nz = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p]
        here = nx * vertex[j, 0] + ny * vertex[j, 1] + nz * vertex[j, 2] - facets.offset[p]
        there = nx * target[0] + ny * target[1] + nz * target[2] - facets.offset[p]
        if here * there >= 0.0:
            return False
        t = here / (here - there)
        for a in range(3):
            vertex[j + 1, a] = vertex[j, a] + t * (target[a] - vertex[j, a])
        hit = -1
        for q in range(facets.first[p], facets.first[p + 1]):
            u, v = _coordinates(facets, q, vertex[j + 1, 0], vertex[j + 1, 1], vertex[j + 1, 2])
            if _outside(facets, q, u, v) == 0:
                hit = q
                break
        if hit < 0:
            return False
        scratch.hit[j] = hit
        target[0] -= 2.0 * there * nx
        target[1] -= 2.0 * there * ny
        target[2] -= 2.0 * there * nz
    for a in range(3):
        vertex[n + 1, a] = target[a]
    return True


@njit(cache=True, fastmath=FAST)
def trace(
    facets: Facets, candidates: Candidates, c: int, tx: F64, offset: F64, max_depth: int, scratch: Scratch
) -> bool:
    """Whether the path reaches the element at `offset`; its hits and crossings are left in `scratch`."""
    if not _fold(facets, candidates, c, tx, offset, scratch):
        return False
    n = candidates.length[c]
    total = n
    vertex = scratch.vertex[0]
    _sides(facets, scratch, 0, n + 2)
    for s in range(n + 1):
        scratch.num_crossed[s] = 0
        before = candidates.plane[c, n - s] if s > 0 else -1
        after = candidates.plane[c, n - 1 - s] if s < n else -1
        for p in range(facets.offset.shape[0]):
            here, there = scratch.side[0, s, p], scratch.side[0, s + 1, p]
            if here * there >= 0.0 or p == before or p == after:
                continue
            t = here / (here - there)
            x = vertex[s, 0] + t * (vertex[s + 1, 0] - vertex[s, 0])
            y = vertex[s, 1] + t * (vertex[s + 1, 1] - vertex[s, 1])
            z = vertex[s, 2] + t * (vertex[s + 1, 2] - vertex[s, 2])
            for q in range(facets.first[p], facets.first[p + 1]):
                u, v = _coordinates(facets, q, x, y, z)
                if _outside(facets, q, u, v) == 0:
                    total += 1
                    if facets.is_opaque[q] or total > max_depth or scratch.num_crossed[s] >= MAX_CROSSED:
                        return False
                    _insert_crossing(scratch, s, q, t)
                    break
    return _shortest_piece(facets, scratch, 0, n) >= MIN_SEGMENT_M


# --- the whole aperture at once: four corners decide for every element between them ---


@njit(cache=True, fastmath=FAST)
def _fold_corners(
    facets: Facets, candidates: Candidates, c: int, tx: F64, corner_m: F64, scratch: Scratch
) -> int:
    n = candidates.length[c]
    vertex = scratch.vertex
    target = scratch.target
    for k in range(4):
        for a in range(3):
            vertex[k, 0, a] = tx[a]
            target[k, a] = candidates.image[c, a] + _dot(candidates.mirror[c, a], corner_m[k])
    for j in range(n):
        p = candidates.plane[c, n - 1 - j]
        nx, ny, nz = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p]
        num_apart = 0
        num_above = 0
        for k in range(4):
            here = nx * vertex[k, j, 0] + ny * vertex[k, j, 1] + nz * vertex[k, j, 2] - facets.offset[p]
            there = nx * target[k, 0] + ny * target[k, 1] + nz * target[k, 2] - facets.offset[p]
            num_above += here > 0.0
            num_apart += here * there < 0.0
            t = here / (here - there) if here * there < 0.0 else 0.0
            for a in range(3):
                vertex[k, j + 1, a] = vertex[k, j, a] + t * (target[k, a] - vertex[k, j, a])
            target[k, 0] -= 2.0 * there * nx
            target[k, 1] -= 2.0 * there * ny
            target[k, 2] -= 2.0 * there * nz
        if num_apart == 0 and (num_above == 0 or num_above == 4):
            return NOWHERE
        if num_apart < 4:
            return MIXED
        verdict = NOWHERE
        for q in range(facets.first[p], facets.first[p + 1]):
            beyond_all = 31
            num_inside = 0
            for k in range(4):
                u, v = _coordinates(facets, q, vertex[k, j + 1, 0], vertex[k, j + 1, 1], vertex[k, j + 1, 2])
                beyond = _outside(facets, q, u, v)
                beyond_all &= beyond
                num_inside += beyond == 0
            if num_inside == 4 and verdict != MIXED:  # `_fold` takes the first facet that an element meets
                scratch.hit[j] = q
                verdict = EVERYWHERE
                break
            if beyond_all == 0:
                verdict = MIXED
        if verdict != EVERYWHERE:
            return verdict
    for k in range(4):
        for a in range(3):
            vertex[k, n + 1, a] = target[k, a]
    return EVERYWHERE


@njit(cache=True, fastmath=FAST)
def _facet_crossed(facets: Facets, q: int, p: int, s: int, scratch: Scratch) -> int:
    """Whether all, none or some of the segments s of the four corners cross the facet."""
    beyond_all = 31
    num_inside = 0
    for k in range(4):
        here, there = scratch.side[k, s, p], scratch.side[k, s + 1, p]
        a, b = scratch.vertex[k, s], scratch.vertex[k, s + 1]
        if here * there < 0.0:
            t = here / (here - there)
            u, v = _coordinates(
                facets, q, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])
            )
            beyond = _outside(facets, q, u, v)
            beyond_all &= beyond
            num_inside += beyond == 0
        else:  # which side differs between the corners: both ends must lie beyond a common edge
            u, v = _coordinates(facets, q, a[0], a[1], a[2])
            beyond_all &= _outside(facets, q, u, v)
            u, v = _coordinates(facets, q, b[0], b[1], b[2])
            beyond_all &= _outside(facets, q, u, v)
    if num_inside == 4:
        return EVERYWHERE
    return NOWHERE if beyond_all != 0 else MIXED


@njit(cache=True, fastmath=FAST)
def trace_aperture(
    facets: Facets, candidates: Candidates, c: int, tx: F64, corner_m: F64, max_depth: int, scratch: Scratch
) -> int:
    """Whether the path reaches EVERYWHERE or NOWHERE within the corners, by the same facets, or MIXED.

    The point where a path meets a plane is a projective map of the element's position, so convex facets
    have convex preimages: what holds at the four corners holds between them, and for every narrower
    aperture about the same centre. Stretches are not quite linear in the position: each corner's have to be
    twice the shortest that a path may have, or its elements are traced. Facets crossed are left in `scratch`.
    """
    verdict = _fold_corners(facets, candidates, c, tx, corner_m, scratch)
    if verdict != EVERYWHERE:
        return verdict
    n = candidates.length[c]
    total = n
    for k in range(4):
        _sides(facets, scratch, k, n + 2)
    side = scratch.side
    is_mixed = False
    for s in range(n + 1):
        scratch.num_crossed[s] = 0
        before = candidates.plane[c, n - s] if s > 0 else -1
        after = candidates.plane[c, n - 1 - s] if s < n else -1
        for p in range(facets.offset.shape[0]):
            above = min(
                min(min(side[0, s, p], side[1, s, p]), min(side[2, s, p], side[3, s, p])),
                min(min(side[0, s + 1, p], side[1, s + 1, p]), min(side[2, s + 1, p], side[3, s + 1, p])),
            )
            below = max(
                max(max(side[0, s, p], side[1, s, p]), max(side[2, s, p], side[3, s, p])),
                max(max(side[0, s + 1, p], side[1, s + 1, p]), max(side[2, s + 1, p], side[3, s + 1, p])),
            )
            if above > 0.0 or below < 0.0 or p == before or p == after:
                continue
            is_plane_mixed = False
            for q in range(facets.first[p], facets.first[p + 1]):
                crossed = _facet_crossed(facets, q, p, s, scratch)
                if crossed == NOWHERE:
                    continue
                if crossed == MIXED or is_plane_mixed:
                    is_plane_mixed = True
                    is_mixed = True
                    continue
                total += 1
                if facets.is_opaque[q] or total > max_depth or scratch.num_crossed[s] >= MAX_CROSSED:
                    return NOWHERE
                here, there = side[0, s, p], side[0, s + 1, p]
                _insert_crossing(scratch, s, q, here / (here - there))
                break  # one slab a plane, the first, as in `trace`
    if is_mixed:
        return MIXED
    for k in range(4):
        if _shortest_piece(facets, scratch, k, n) < 2 * MIN_SEGMENT_M:
            return MIXED
    return EVERYWHERE


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
def _interact(
    facets: Facets, slabs: Slabs, p: int, q: int, carrier: int, is_reflected: bool, scratch: Scratch
) -> None:
    """Apply a slab to the field: E_s along k×n, E_p along k×s, both before and after."""
    k, field = scratch.direction, scratch.field
    nx, ny, nz = facets.normal[0, p], facets.normal[1, p], facets.normal[2, p]
    slope = k[0] * nx + k[1] * ny + k[2] * nz
    kind = facets.slab[q]
    r_te, r_tm, t_te, t_tm = slab_coefficients(
        abs(slope), slabs.permittivity[carrier, kind], slabs.phase_thickness[carrier, kind]
    )
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
def _antenna_field(antenna: Antenna, x: float, y: float, z: float) -> tuple[float, float, float]:
    """World components of the antenna's real field towards a direction."""
    horizontal = math.sqrt(x * x + y * y)
    if horizontal > 1e-12:
        cos_phi, sin_phi = x / horizontal, y / horizontal
    else:  # opposite directions, as the ends of a vertical ray see them, have opposite azimuths here too
        cos_phi, sin_phi = math.copysign(1.0, z), 0.0
    scale = math.sqrt(1.5) * horizontal if antenna.is_dipole else 1.0
    if antenna.is_horizontal:
        return -scale * sin_phi, scale * cos_phi, 0.0
    return scale * z * cos_phi, scale * z * sin_phi, -scale * horizontal


@njit(cache=True, fastmath=FAST)
def path_gain(
    facets: Facets,
    slabs: Slabs,
    candidates: Candidates,
    c: int,
    tx: F64,
    offset: F64,
    carrier: int,
    antenna: Antenna,
    scratch: Scratch,
) -> complex:
    """Field that the element's antenna takes from a traced path, without spreading and travel phase."""
    k = scratch.direction
    norm = 0.0
    for a in range(3):
        k[a] = candidates.image[c, a] + _dot(candidates.mirror[c, a], offset) - tx[a]
        norm += k[a] * k[a]
    norm = math.sqrt(norm)
    for a in range(3):
        k[a] /= norm
    ex, ey, ez = _antenna_field(antenna, k[0], k[1], k[2])
    scratch.field[0], scratch.field[1], scratch.field[2] = ex, ey, ez
    n = candidates.length[c]
    for s in range(n + 1):
        for i in range(scratch.num_crossed[s]):
            q = scratch.crossed[s, i]
            _interact(facets, slabs, _plane_of(facets, q), q, carrier, False, scratch)
        if s < n:
            _interact(facets, slabs, candidates.plane[c, n - 1 - s], scratch.hit[s], carrier, True, scratch)
    ex, ey, ez = _antenna_field(antenna, -k[0], -k[1], -k[2])
    return scratch.field[0] * ex + scratch.field[1] * ey + scratch.field[2] * ez


@njit(cache=True)
def _plane_of(facets: Facets, q: int) -> int:
    return int(np.searchsorted(facets.first, q, side="right")) - 1


@njit(cache=True, fastmath=FAST)
def _spread(
    gain: NDArray[np.complex128],
    weight: F64,
    centre_distance2: float,
    toward: F64,
    element_m: F64,
    wavelength_m: float,
    real: F64,
    imag: F64,
) -> None:
    """Add gain·(λ/4πL)·exp(−j2πL/λ) at every element, L the exact distance to the element's image.

    sin and cos are polynomials of half the phase within ±π/2 (error below 1e-10), so that the elements
    run in vector lanes.
    """
    for e in range(element_m.shape[0]):
        x, y, z = element_m[e, 0], element_m[e, 1], element_m[e, 2]
        distance = math.sqrt(
            centre_distance2 - 2.0 * (toward[0] * x + toward[1] * y + toward[2] * z) + (x * x + y * y + z * z)
        )
        turns = distance / wavelength_m
        half = math.pi * (turns - math.floor(turns + 0.5))
        h2 = half * half
        sine = half * (
            1.0
            + h2
            * (
                -1 / 6
                + h2
                * (
                    1 / 120
                    + h2
                    * (
                        -1 / 5040
                        + h2
                        * (1 / 362880 + h2 * (-1 / 39916800 + h2 * (1 / 6227020800 - h2 / 1307674368000)))
                    )
                )
            )
        )
        cosine = 1.0 + h2 * (
            -1 / 2
            + h2
            * (
                1 / 24
                + h2
                * (
                    -1 / 720
                    + h2 * (1 / 40320 + h2 * (-1 / 3628800 + h2 * (1 / 479001600 - h2 / 87178291200)))
                )
            )
        )
        gain_real = 0.0
        gain_imag = 0.0
        for node in range(weight.shape[0]):
            gain_real += weight[node, e] * gain[node].real
            gain_imag += weight[node, e] * gain[node].imag
        scale = wavelength_m / (4.0 * math.pi * distance)
        phase_real = scale * (1.0 - 2.0 * sine * sine)
        phase_imag = -scale * 2.0 * sine * cosine
        real[e] += gain_real * phase_real - gain_imag * phase_imag
        imag[e] += gain_real * phase_imag + gain_imag * phase_real


@njit(cache=True, parallel=True)
def channels(
    facets: Facets,
    slabs: Slabs,
    candidates: Candidates,
    aperture: Aperture,
    antenna: Antenna,
    tx_position_m: F64,
    max_depth: int,
    prune: bool,
    share_visibility: bool,
) -> tuple[NDArray[np.complex128], NDArray[np.int32]]:
    """Channels (T, F, M) and path counts (T, F); one transmitter a task, each summed in a fixed order.

    A path counts where its field reaches at least one element and has not vanished on the way.

    `prune` tests each candidate roughly first; `share_visibility` lets four corners decide for the
    elements between them. Both leave the answer as it is, to rounding, and are there to be priced.
    """
    num_tx = tx_position_m.shape[0]
    num_carriers, num_elements = aperture.element_m.shape[0], aperture.element_m.shape[1]
    cfr = np.zeros((num_tx, num_carriers, num_elements), np.complex128)
    num_paths = np.zeros((num_tx, num_carriers), np.int32)
    for i in prange(num_tx):
        tx = tx_position_m[i]
        scratch = new_scratch(max_depth, facets.offset.shape[0])
        real = np.zeros((num_carriers, num_elements))
        imag = np.zeros((num_carriers, num_elements))
        toward = np.zeros(3)
        nodes = np.zeros(aperture.node_m.shape[1], np.complex128)
        single = np.zeros(1, np.complex128)
        one = np.ones((1, 1))
        for c in range(candidates.length.shape[0]):
            if prune and not _plausible(facets, candidates, c, tx, aperture.radius_m):
                continue
            distance2 = 0.0
            toward[:] = 0.0
            for a in range(3):
                gap = tx[a] - candidates.image[c, a]
                distance2 += gap * gap
                for b in range(3):
                    toward[b] += gap * candidates.mirror[c, a, b]
            reach = MIXED
            for f in range(num_carriers):
                if share_visibility and reach == MIXED:
                    reach = trace_aperture(
                        facets, candidates, c, tx, aperture.corner_m[f], max_depth, scratch
                    )
                if reach == NOWHERE:
                    break
                wavelength_m = aperture.wavelength_m[f]
                if reach == EVERYWHERE:
                    for node in range(nodes.shape[0]):
                        nodes[node] = path_gain(
                            facets, slabs, candidates, c, tx, aperture.node_m[f, node], f, antenna, scratch
                        )
                    _spread(
                        nodes,
                        aperture.weight,
                        distance2,
                        toward,
                        aperture.element_m[f],
                        wavelength_m,
                        real[f],
                        imag[f],
                    )
                    num_paths[i, f] += np.any(nodes != 0)
                    continue
                is_seen = False
                for e in range(num_elements):
                    offset = aperture.element_m[f, e]
                    if trace(facets, candidates, c, tx, offset, max_depth, scratch):
                        single[0] = path_gain(facets, slabs, candidates, c, tx, offset, f, antenna, scratch)
                        is_seen |= single[0] != 0
                        _spread(
                            single,
                            one,
                            distance2,
                            toward,
                            aperture.element_m[f, e : e + 1],
                            wavelength_m,
                            real[f, e : e + 1],
                            imag[f, e : e + 1],
                        )
                num_paths[i, f] += is_seen
        for f in range(num_carriers):
            for e in range(num_elements):
                cfr[i, f, e] = complex(real[f, e], imag[f, e])
    return cfr, num_paths


@njit(cache=True)
def reaching(facets: Facets, candidates: Candidates, tx: F64, max_depth: int) -> NDArray[np.int64]:
    """Candidates whose path reaches the array centre."""
    scratch = new_scratch(max_depth, facets.offset.shape[0])
    centre = np.zeros(3)
    found = np.zeros(candidates.length.shape[0], np.bool_)
    for c in range(candidates.length.shape[0]):
        if _plausible(facets, candidates, c, tx, 0.0):
            found[c] = trace(facets, candidates, c, tx, centre, max_depth, scratch)
    return np.flatnonzero(found)
