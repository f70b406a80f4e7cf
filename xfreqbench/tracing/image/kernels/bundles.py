"""Kernels that follow a bundle of paths through a scene: one path, four, or those to the corners of the array.

It is done in three steps: fold the paths, gather the facets that they may meet, and decide which they do. What was
gathered for the corners serves every element between them.
"""

from __future__ import annotations

import math

from xfreqbench.scene.patches import PLANE_TOLERANCE

from .arrays import F64, FAR, MAX_CROSSED, MAX_NEAR, MIN_SEGMENT_M, Facets, Path, Walk
from .compiled import bare, part
from .tree import SLACK_M, Bundle, beyond_edges, next_leaf, side_of, tube_between

NOWHERE, MIXED, EVERYWHERE = 0, -1, 1  # at which elements paths arrive
UNKNOWN, MIRRORS, SLABS = 0, 1, 2  # what is gathered for a bundle of paths: with slabs, mirrors too


@part
def _holds_edge(facets: Facets, q: int, edge: F64) -> bool:
    """Whether the edge at which paths begin lies in the plane of facet q: they leave that plane at their start."""
    here = side_of(facets.face, q, edge[0, 0], edge[0, 1], edge[0, 2])
    there = side_of(facets.face, q, edge[1, 0], edge[1, 1], edge[1, 2])
    return abs(here) < PLANE_TOLERANCE and abs(there) < PLANE_TOLERANCE


@part
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


@bare
def _fold(facets: Facets, path: Path, offset_m: F64, bundle: Bundle, walk: Walk) -> int:
    """Fold the lines from the starts to the images of the elements at `offset_m` (K, 3) into the room.

    EVERYWHERE where all of them meet all planes of the path, NOWHERE where none does.
    """
    n, vertex, mirror = path.length, walk.vertex, path.mirror
    for k in range(len(bundle)):
        x, y, z = offset_m[k, 0], offset_m[k, 1], offset_m[k, 2]
        for a in range(3):
            vertex[k, 0, a] = walk.start[k, a]
            vertex[k, n + 1, a] = path.image[a] + (mirror[a, 0] * x + mirror[a, 1] * y + mirror[a, 2] * z)
    for j in range(n):
        verdict = _reflect(facets, path.plane[n - 1 - j], j, n, bundle, vertex)
        if verdict != EVERYWHERE:
            return verdict
    return EVERYWHERE


@part
def _beyond(facets: Facets, q: int, v: int, bundle: Bundle, vertex: F64) -> tuple[int, int]:
    """Edges of facet q that vertex v lies beyond on all paths, a bit set, and on how many paths it is inside."""
    beyond_all, num_inside = 31, 0
    for k in range(len(bundle)):
        beyond = beyond_edges(facets, q, vertex[k, v, 0], vertex[k, v, 1], vertex[k, v, 2])
        beyond_all &= beyond
        num_inside += beyond == 0
    return beyond_all, num_inside


@part
def _where(face: F64, q: int, s: int, k: int, vertex: F64) -> float:
    """At which share of segment s path k meets the plane of facet q."""
    here = side_of(face, q, vertex[k, s, 0], vertex[k, s, 1], vertex[k, s, 2])
    return here / (here - side_of(face, q, vertex[k, s + 1, 0], vertex[k, s + 1, 1], vertex[k, s + 1, 2]))


@part
def _crosses(facets: Facets, q: int, s: int, bundle: Bundle, vertex: F64) -> int:
    """Whether all, none or some of the segments s of the paths cross facet q, those between `CORNERS` among them."""
    has_between = len(bundle) > 1 and bundle[0] == 0
    face, beyond_all, num_inside = facets.face, 31, 0
    lowest, highest, num_crossing = FAR, -FAR, 0
    for k in range(len(bundle)):
        ax, ay, az = vertex[k, s, 0], vertex[k, s, 1], vertex[k, s, 2]
        bx, by, bz = vertex[k, s + 1, 0], vertex[k, s + 1, 1], vertex[k, s + 1, 2]
        here, there = side_of(face, q, ax, ay, az), side_of(face, q, bx, by, bz)
        lowest, highest = min(lowest, min(here, there)), max(highest, max(here, there))
        if here * there < 0.0:
            t = here / (here - there)
            beyond = beyond_edges(facets, q, ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az))
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
        beyond_all = _beyond(facets, q, s, bundle, vertex)[0] & _beyond(facets, q, s + 1, bundle, vertex)[0]
    return NOWHERE if beyond_all != 0 else MIXED


@bare
def gather_mirrors(facets: Facets, path: Path, bundle: Bundle, walk: Walk) -> int:
    """Look up the facets at which the folded paths may turn; NOWHERE where there are none, MIXED if too many."""
    vertex, n = walk.vertex, path.length
    for j in range(n):
        p, v, number = path.plane[n - 1 - j], j + 1, 0
        tube, top = tube_between(vertex, v, v, PLANE_TOLERANCE, bundle), -1
        while True:
            top, leaf = next_leaf(facets, tube, 0.0, walk, top)
            if leaf < 0:
                break
            for q in range(facets.first[leaf], facets.last[leaf]):
                if facets.plane[q] != p or (j == 0 and _holds_edge(facets, q, walk.edge)):
                    continue
                if _beyond(facets, q, v, bundle, vertex)[0] != 0:
                    continue
                if len(bundle) == 1 and number == 1:  # of those that lie on each other the first mirrors
                    walk.mirrors[j, 0] = min(walk.mirrors[j, 0], q)
                    continue
                if number == MAX_NEAR:
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
    is_parallel = abs(cosine) > 1.0 - 0.5 * PLANE_TOLERANCE**2
    return is_parallel and abs(nx * x + ny * y + nz * z - facets.offset[r]) < PLANE_TOLERANCE


@part
def _counts(facets: Facets, q: int, s: int, met: F64, number: int, path: Path, walk: Walk) -> bool:
    """Whether crossing facet q counts: it lies on none of the first so many of `met` on segment s, nor on a mirror at
    one of its ends.
    """
    vertex, r, n = walk.vertex, facets.plane[q], path.length
    ax, ay, az = vertex[0, s, 0], vertex[0, s, 1], vertex[0, s, 2]
    bx, by, bz = vertex[0, s + 1, 0], vertex[0, s + 1, 1], vertex[0, s + 1, 2]
    if s > 0 and _lies_on(facets, q, path.plane[n - s], ax, ay, az):
        return False
    if s < n and _lies_on(facets, q, path.plane[n - 1 - s], bx, by, bz):
        return False
    t = _where(facets.face, q, s, 0, vertex)
    x, y, z = ax + t * (bx - ax), ay + t * (by - ay), az + t * (bz - az)
    num_under = 0
    for i in range(0 if facets.is_opaque[q] else number):  # metal blocks on whatever it lies
        num_under += _lies_on(facets, met[s, i], r, x, y, z)
    return num_under == 0


@bare
def _gather_slabs(facets: Facets, path: Path, bundle: Bundle, walk: Walk) -> int:
    """Look up the facets that the folded paths may cross.

    NOWHERE where all of them cross an opaque one, or more than they may; MIXED if too many are met. Facets in the
    plane of a mirror at which a segment begins or ends, or in one that holds the edge where it begins, are none.
    """
    vertex, n, num_left, is_at_edge = walk.vertex, path.length, walk.limit[0], walk.edge[0, 0] < FAR
    for s in range(n + 1):
        before, after = path.plane[n - s] if s > 0 else -1, path.plane[n - 1 - s] if s < n else -1
        tube, number, top = tube_between(vertex, s, s + 1, SLACK_M, bundle), 0, -1
        while True:
            top, leaf = next_leaf(facets, tube, 1.0, walk, top)
            if leaf < 0:
                break
            for q in range(facets.first[leaf], facets.last[leaf]):
                if facets.plane[q] == before or facets.plane[q] == after:
                    continue
                if is_at_edge and s == 0 and _holds_edge(facets, q, walk.edge):
                    continue
                crossed = _crosses(facets, q, s, bundle, vertex)
                if crossed == NOWHERE:
                    continue
                if crossed == EVERYWHERE:
                    if _counts(facets, q, s, walk.slabs, number, path, walk):
                        num_left -= 1
                        if num_left < 0 or facets.is_opaque[q]:
                            return NOWHERE
                    elif len(bundle) == 1:
                        continue
                if number == MAX_NEAR:
                    return MIXED
                walk.slabs[s, number] = q
                number += 1
        walk.num_slabs[s] = number
    return EVERYWHERE


@part
def _hit(facets: Facets, j: int, bundle: Bundle, walk: Walk) -> int:
    """The facet at which all paths turn at their vertex j + 1, or else −1; −2 where only some of them turn at one."""
    vertex, found, is_mixed = walk.vertex, -1, False
    for i in range(walk.num_mirrors[j]):
        q = walk.mirrors[j, i]
        beyond_all, num_inside = _beyond(facets, q, j + 1, bundle, vertex)
        if num_inside == len(bundle):
            found = q if found < 0 else min(found, q)
        elif num_inside > 0 or (bundle[0] == 0 and beyond_all == 0):
            is_mixed = True
    return -2 if is_mixed else found


@part
def _cross(facets: Facets, q: int, s: int, t: float, num_left: int, walk: Walk) -> bool:
    """Let the paths cross facet q at share t of segment s; False where that ends them: opaque, or too deep.

    Crossings of a segment are kept in the order in which a wave from the start meets them.
    """
    crossed, crossed_at, i = walk.crossed, walk.crossed_at, walk.num_crossed[s]
    if facets.is_opaque[q] or num_left == 0 or i >= MAX_CROSSED:
        return False
    while i > 0 and crossed_at[s, i - 1] > t:
        crossed[s, i], crossed_at[s, i] = crossed[s, i - 1], crossed_at[s, i - 1]
        i -= 1
    crossed[s, i], crossed_at[s, i] = q, t
    walk.num_crossed[s] += 1
    return True


@part
def _shortest_stretch(facets: Facets, n: int, k: int, walk: Walk) -> float:
    """Shortest stretch in metres of path k between successive interactions, in the order of path 0.

    Negative where path k meets two slabs in the opposite order.
    """
    shortest, vertex, face = FAR, walk.vertex, facets.face
    for s in range(n + 1):
        ax, ay, az = vertex[k, s, 0], vertex[k, s, 1], vertex[k, s, 2]
        bx, by, bz = vertex[k, s + 1, 0], vertex[k, s + 1, 1], vertex[k, s + 1, 2]
        span = math.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + (bz - az) ** 2)
        last = 0.0
        for i in range(walk.num_crossed[s]):
            t = _where(face, walk.crossed[s, i], s, k, vertex)
            shortest = min(shortest, (t - last) * span)
            last = t
        shortest = min(shortest, (1.0 - last) * span)
    return shortest


@bare
def _decide(facets: Facets, path: Path, bundle: Bundle, walk: Walk) -> int:
    """Whether folded paths reach EVERYWHERE, NOWHERE or, MIXED, only some of their ends.

    With `CORNERS`, EVERYWHERE and NOWHERE hold for all elements between them: the point where a path meets a plane is
    a projective map of the element's position, so convex facets have convex preimages. That is so for every narrower
    aperture about the same centre too. Stretches are not quite linear in the position: each corner's have to be twice
    the shortest that a path may have. What the paths may meet was gathered: for them, or for a bundle that they lie
    in. What they meet is left in `walk`.
    """
    n, verdict, num_left, vertex = path.length, EVERYWHERE, walk.limit[0], walk.vertex
    for j in range(n):
        found = _hit(facets, j, bundle, walk)
        if found == -1:
            return NOWHERE
        if found == -2:
            verdict = MIXED
        else:
            walk.hit[j] = found
    for s in range(n + 1):
        walk.num_crossed[s] = 0
        for i in range(walk.num_slabs[s]):
            q = walk.slabs[s, i]
            crossed = _crosses(facets, q, s, bundle, vertex)
            if crossed == MIXED:
                verdict = MIXED
            elif crossed == EVERYWHERE and _counts(facets, q, s, walk.crossed, walk.num_crossed[s], path, walk):
                if not _cross(facets, q, s, _where(facets.face, q, s, 0, vertex), num_left, walk):
                    return NOWHERE
                num_left -= 1
    if verdict != EVERYWHERE:
        return verdict
    least_m = MIN_SEGMENT_M if len(bundle) == 1 else 2.0 * MIN_SEGMENT_M
    for k in range(len(bundle)):
        if _shortest_stretch(facets, n, k, walk) < least_m:
            return NOWHERE if len(bundle) == 1 else MIXED
    return EVERYWHERE


@bare
def follow(facets: Facets, path: Path, offset_m: F64, gathered: int, bundle: Bundle, walk: Walk) -> tuple[int, int]:
    """Whether paths reach the elements at `offset_m` (K, 3), as `_decide` has it, and what is gathered for them then.

    `gathered` is what was for a bundle in which they lie.
    """
    verdict = _fold(facets, path, offset_m, bundle, walk)
    if verdict != EVERYWHERE:
        return verdict, gathered
    if gathered < MIRRORS:
        verdict = gather_mirrors(facets, path, bundle, walk)
        if verdict != EVERYWHERE:
            return verdict, UNKNOWN
    if gathered < SLABS:
        for j in range(path.length):
            if _hit(facets, j, bundle, walk) == -1:
                return NOWHERE, MIRRORS
        verdict = _gather_slabs(facets, path, bundle, walk)
        if verdict != EVERYWHERE:
            return verdict, MIRRORS
    return _decide(facets, path, bundle, walk), SLABS
