"""Kernels that follow a bundle of paths among many facets: one path, four, or those to the corners of the aperture.

It is done in three steps: fold the paths, gather the facets that they may meet, and decide. What was gathered for the
corners serves every element between them, at every carrier. Kernels here are compiled by who calls them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from xfreqbench.tracing.image import kernels
from xfreqbench.tracing.image.box_tree import BoxTree
from xfreqbench.tracing.image.box_tree_kernels import (
    FAR,
    MOST_NEAR,
    Walk,
    bare,
    beyond_edges,
    next_leaf,
    part,
    side_of,
    tube_about,
    tube_along,
)
from xfreqbench.tracing.image.kernels import (
    EVERYWHERE,
    LONE,
    MAX_CROSSED,
    MIN_SEGMENT_M,
    MIXED,
    NOWHERE,
    Bundle,
    Facets,
    Path,
    Scratch,
)

F64 = NDArray[np.float64]

QUAD = (1, 1, 1, 1)  # a bundle of four paths with none between them, as there are between `CORNERS`
COPLANAR_M = 1e-4  # as in `scene.facets`: facets of one plane that lie on each other count once


@part
def _crosses(tree: BoxTree, q: int, s: int, bundle: Bundle, vertex: F64) -> int:
    """Whether all, none or some of the segments s of the paths cross facet q, those between `CORNERS` among them."""
    has_between = len(bundle) > 1 and bundle[0] == 0
    face, beyond_all, num_inside, is_triangle = tree.face, 31, 0, tree.is_triangle[q]
    lowest, highest, num_crossing = FAR, -FAR, 0
    for k in range(len(bundle)):
        ax, ay, az = vertex[k, s, 0], vertex[k, s, 1], vertex[k, s, 2]
        bx, by, bz = vertex[k, s + 1, 0], vertex[k, s + 1, 1], vertex[k, s + 1, 2]
        here, there = side_of(face, q, ax, ay, az), side_of(face, q, bx, by, bz)
        lowest, highest = min(lowest, min(here, there)), max(highest, max(here, there))
        if here * there < 0.0:
            t = here / (here - there)
            beyond = beyond_edges(
                face, q, ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az), is_triangle
            )
            beyond_all &= beyond
            num_inside += beyond == 0
            num_crossing += 1
    if num_inside == len(bundle):
        return EVERYWHERE
    if not has_between:
        return NOWHERE if num_inside == 0 else MIXED
    if lowest > 0.0 or highest < 0.0:
        return NOWHERE
    if num_crossing < len(bundle):  # others may end on it: all ends must lie beyond a common edge
        beyond_all = 31
        for k in range(len(bundle)):
            for v in range(s, s + 2):
                x, y, z = vertex[k, v, 0], vertex[k, v, 1], vertex[k, v, 2]
                beyond_all &= beyond_edges(face, q, x, y, z, is_triangle)
    return NOWHERE if beyond_all != 0 else MIXED


@bare
def fold(facets: Facets, path: Path, offset_m: F64, bundle: Bundle, walk: Walk) -> int:
    """Fold the lines from the transmitter to the images of the elements at `offset_m` (K, 3) into the room.

    EVERYWHERE where all of them meet all planes of the path, NOWHERE where none does.
    """
    n, vertex = path.length, walk.scratch.vertex
    for k in range(len(bundle)):
        for a in range(3):
            vertex[k, 0, a] = walk.scratch.tx[a]
            vertex[k, n + 1, a] = path.image[a] + kernels._dot(path.mirror[a], offset_m[k])
    for j in range(n):
        verdict = kernels._reflect(facets, path.plane[n - 1 - j], j, n, bundle, vertex)
        if verdict != EVERYWHERE:
            return verdict
    return EVERYWHERE


@bare
def gather_mirrors(tree: BoxTree, path: Path, bundle: Bundle, walk: Walk) -> int:
    """Look up the facets at which the folded paths may turn; NOWHERE where there are none, MIXED if too many."""
    vertex, n = walk.scratch.vertex, path.length
    for j in range(n):
        p, v, number = path.plane[n - 1 - j], j + 1, 0
        tube, top = tube_about(vertex, v, COPLANAR_M, bundle), -1
        while True:
            top, leaf = next_leaf(tree, tube, 0.0, walk, top)
            if leaf < 0:
                break
            for q in range(tree.first[leaf], tree.last[leaf]):
                if tree.plane[q] != p:
                    continue
                beyond_all = 31
                for k in range(len(bundle)):
                    x, y, z = vertex[k, v, 0], vertex[k, v, 1], vertex[k, v, 2]
                    beyond_all &= beyond_edges(tree.face, q, x, y, z, tree.is_triangle[q])
                if beyond_all != 0:
                    continue
                if len(bundle) == 1 and number == 1:  # of those that lie on each other the first mirrors
                    walk.mirrors[j, 0] = min(walk.mirrors[j, 0], q)
                    continue
                if number == MOST_NEAR:
                    return MIXED
                walk.mirrors[j, number] = q
                number += 1
        if number == 0:
            return NOWHERE
        walk.num_mirrors[j] = number
    return EVERYWHERE


@part
def _lies_on(facets: Facets, q: int, p: int, x: float, y: float, z: float) -> bool:
    """Whether facet q is parallel to plane p and a point of plane p lies in its plane."""
    r, normal = facets.plane[q], facets.normal
    nx, ny, nz = normal[0, r], normal[1, r], normal[2, r]
    cosine = nx * normal[0, p] + ny * normal[1, p] + nz * normal[2, p]
    is_parallel = abs(cosine) > 1.0 - 0.5 * COPLANAR_M**2
    return is_parallel and abs(nx * x + ny * y + nz * z - facets.offset[r]) < COPLANAR_M


@part
def _lies_at_an_end(facets: Facets, q: int, s: int, before: int, after: int, vertex: F64) -> bool:
    """Whether facet q lies on a mirror at which segment s begins, of plane `before`, or ends, of plane `after`."""
    if before >= 0 and _lies_on(facets, q, before, vertex[0, s, 0], vertex[0, s, 1], vertex[0, s, 2]):
        return True
    x, y, z = vertex[0, s + 1, 0], vertex[0, s + 1, 1], vertex[0, s + 1, 2]
    return after >= 0 and _lies_on(facets, q, after, x, y, z)


@part
def _is_slab(facets: Facets, q: int, s: int, number: int, before: int, after: int, walk: Walk) -> bool:
    """Whether facet q lies on none of the first so many gathered for segment s, nor on a mirror at its ends."""
    vertex, r = walk.scratch.vertex, facets.plane[q]
    ax, ay, az = vertex[0, s, 0], vertex[0, s, 1], vertex[0, s, 2]
    bx, by, bz = vertex[0, s + 1, 0], vertex[0, s + 1, 1], vertex[0, s + 1, 2]
    if _lies_at_an_end(facets, q, s, before, after, vertex):
        return False
    nx, ny, nz = facets.normal[0, r], facets.normal[1, r], facets.normal[2, r]
    here = nx * ax + ny * ay + nz * az - facets.offset[r]
    there = nx * bx + ny * by + nz * bz - facets.offset[r]
    t = here / (here - there)
    x, y, z = ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az)
    num_under = 0
    for i in range(number):
        num_under += _lies_on(facets, walk.slabs[s, i], r, x, y, z)
    return num_under == 0


@bare
def gather_slabs(facets: Facets, tree: BoxTree, path: Path, bundle: Bundle, walk: Walk) -> int:
    """Look up the facets that the folded paths may cross.

    NOWHERE where all of them cross an opaque one, or more than they may at their depth; MIXED if too many are met.
    Facets in the plane of a mirror at which a segment begins or ends are none of them.
    """
    vertex, n = walk.scratch.vertex, path.length
    num_left = path.plane.shape[0] - n
    for s in range(n + 1):
        before, after = path.plane[n - s] if s > 0 else -1, path.plane[n - 1 - s] if s < n else -1
        tube, number, top = tube_along(vertex, s, bundle), 0, -1
        while True:
            top, leaf = next_leaf(tree, tube, 1.0, walk, top)
            if leaf < 0:
                break
            for q in range(tree.first[leaf], tree.last[leaf]):
                p = tree.plane[q]
                if p in (before, after):
                    continue
                crossed = _crosses(tree, q, s, bundle, vertex)
                if crossed == NOWHERE:
                    continue
                if crossed == EVERYWHERE:
                    num_under = 0 if tree.is_opaque[q] else number  # metal blocks on whatever it lies
                    if _is_slab(facets, q, s, num_under, before, after, walk):
                        num_left -= 1
                        if num_left < 0 or tree.is_opaque[q]:
                            return NOWHERE
                    elif len(bundle) == 1:
                        continue
                if number == MOST_NEAR:
                    return MIXED
                walk.slabs[s, number] = q
                number += 1
        walk.num_slabs[s] = number
    return EVERYWHERE


@part
def _hit(tree: BoxTree, j: int, bundle: Bundle, walk: Walk) -> int:
    """The facet at which all paths turn at their vertex j + 1, or else −1; −2 where only some of them turn at one."""
    vertex, found, is_mixed = walk.scratch.vertex, -1, False
    for i in range(walk.num_mirrors[j]):
        q, beyond_all, num_inside = walk.mirrors[j, i], 31, 0
        for k in range(len(bundle)):
            x, y, z = vertex[k, j + 1, 0], vertex[k, j + 1, 1], vertex[k, j + 1, 2]
            beyond = beyond_edges(tree.face, q, x, y, z, tree.is_triangle[q])
            beyond_all &= beyond
            num_inside += beyond == 0
        if num_inside == len(bundle):
            found = q if found < 0 else min(found, q)
        elif num_inside > 0 or (bundle[0] == 0 and beyond_all == 0):
            is_mixed = True
    return -2 if is_mixed else found


@part
def _counts(facets: Facets, q: int, s: int, before: int, after: int, scratch: Scratch) -> bool:
    """Whether facet q, unless it is opaque, lies on no other that segment s crosses, nor on a mirror at its ends."""
    vertex = scratch.vertex
    ax, ay, az = vertex[0, s, 0], vertex[0, s, 1], vertex[0, s, 2]
    bx, by, bz = vertex[0, s + 1, 0], vertex[0, s + 1, 1], vertex[0, s + 1, 2]
    if _lies_at_an_end(facets, q, s, before, after, vertex):
        return False
    for i in range(0 if facets.is_opaque[q] else scratch.num_crossed[s]):
        t = scratch.crossed_at[s, i]
        x, y, z = ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az)
        if _lies_on(facets, q, facets.plane[scratch.crossed[s, i]], x, y, z):
            return False
    return True


@part
def _cross(tree: BoxTree, q: int, s: int, t: float, scratch: Scratch) -> bool:
    """Let the paths cross facet q at share t of segment s; False where that ends them: opaque, or too deep.

    Crossings of a segment are kept in the order in which a wave from the transmitter meets them.
    """
    crossed, crossed_at, i = scratch.crossed, scratch.crossed_at, scratch.num_crossed[s]
    if tree.is_opaque[q] or scratch.num_left[0] == 0 or i >= MAX_CROSSED:
        return False
    while i > 0 and crossed_at[s, i - 1] > t:
        crossed[s, i], crossed_at[s, i] = crossed[s, i - 1], crossed_at[s, i - 1]
        i -= 1
    crossed[s, i], crossed_at[s, i] = q, t
    scratch.num_crossed[s] += 1
    scratch.num_left[0] -= 1
    return True


@part
def _shortest_stretch(tree: BoxTree, n: int, k: int, scratch: Scratch) -> float:
    """Shortest stretch in metres of path k between successive interactions, in the order of path 0.

    Negative where path k meets two slabs in the opposite order.
    """
    shortest, vertex, face = FAR, scratch.vertex, tree.face
    for s in range(n + 1):
        ax, ay, az = vertex[k, s, 0], vertex[k, s, 1], vertex[k, s, 2]
        bx, by, bz = vertex[k, s + 1, 0], vertex[k, s + 1, 1], vertex[k, s + 1, 2]
        span = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + (bz - az) ** 2)
        last = 0.0
        for i in range(scratch.num_crossed[s]):
            q = scratch.crossed[s, i]
            here, there = side_of(face, q, ax, ay, az), side_of(face, q, bx, by, bz)
            t = here / (here - there)
            shortest = min(shortest, (t - last) * span)
            last = t
        shortest = min(shortest, (1.0 - last) * span)
    return shortest


@part
def _are_long(tree: BoxTree, n: int, bundle: Bundle, walk: Walk) -> int:
    """Whether no stretch is too short; for a bundle, twice as long as it has to be, or else MIXED."""
    is_lone = len(bundle) == 1
    for k in range(len(bundle)):
        stretch_m = _shortest_stretch(tree, n, k, walk.scratch)
        if stretch_m < (MIN_SEGMENT_M if is_lone else 2 * MIN_SEGMENT_M):
            return NOWHERE if is_lone else MIXED
    return EVERYWHERE


@bare
def decide(facets: Facets, tree: BoxTree, path: Path, bundle: Bundle, walk: Walk) -> int:
    """Whether folded paths reach EVERYWHERE, NOWHERE or, MIXED, only some of their ends: see `kernels.trace`.

    What they may meet was gathered: for them, or for a bundle that they lie in. Facets met are left in `scratch`.
    """
    n, scratch, verdict = path.length, walk.scratch, EVERYWHERE
    vertex, face = scratch.vertex, tree.face
    for j in range(n):
        found = _hit(tree, j, bundle, walk)
        if found == -1:
            return NOWHERE
        if found == -2:
            verdict = MIXED
        else:
            scratch.hit[j] = found
    scratch.num_left[0] = path.plane.shape[0] - n
    for s in range(n + 1):
        before, after = path.plane[n - s] if s > 0 else -1, path.plane[n - 1 - s] if s < n else -1
        scratch.num_crossed[s] = 0
        for i in range(walk.num_slabs[s]):
            q = walk.slabs[s, i]
            crossed = _crosses(tree, q, s, bundle, vertex)
            if crossed == MIXED:
                verdict = MIXED
            elif crossed == EVERYWHERE:
                here = side_of(face, q, vertex[0, s, 0], vertex[0, s, 1], vertex[0, s, 2])
                there = side_of(face, q, vertex[0, s + 1, 0], vertex[0, s + 1, 1], vertex[0, s + 1, 2])
                t = here / (here - there)
                if _counts(facets, q, s, before, after, scratch) and not _cross(tree, q, s, t, scratch):
                    return NOWHERE
    return _are_long(tree, n, bundle, walk) if verdict == EVERYWHERE else verdict


@bare
def turns(tree: BoxTree, path: Path, bundle: Bundle, walk: Walk) -> bool:
    """Whether each of the folded paths turns at some facet of every plane, of those that were gathered."""
    num_missed = 0
    for j in range(path.length):
        num_missed += _hit(tree, j, bundle, walk) == -1
    return num_missed == 0


@bare
def reaches(
    facets: Facets, tree: BoxTree, path: Path, offset_m: F64, are_mirrors_gathered: bool, walk: Walk
) -> bool:
    """Whether a path reaches an element at `offset_m` (1, 3), for which no slabs were gathered, nor perhaps mirrors."""
    if fold(facets, path, offset_m, LONE, walk) != EVERYWHERE:
        return False
    if not are_mirrors_gathered and gather_mirrors(tree, path, LONE, walk) != EVERYWHERE:
        return False
    if not turns(tree, path, LONE, walk):
        return False
    if gather_slabs(facets, tree, path, LONE, walk) != EVERYWHERE:
        return False
    return decide(facets, tree, path, LONE, walk) == EVERYWHERE
