"""Kernels that look up which facets a ray, or a bundle of segments, meets in the tree of boxes."""

from __future__ import annotations

from xfreqbench.tracing.image.kernels.arrays import F64, FAR, Bundle, Facets, Walk
from xfreqbench.tracing.image.kernels.compiled import bare, part

Span = tuple[float, float, float, float]
Tube = tuple[Span, Span, Span]  # see `tube_along`

SLACK_M = 1e-9  # by which a tube is wider than its paths


@part
def beyond_edges(facets: Facets, q: int, x: float, y: float, z: float) -> int:
    """Bit set of the edges of facet q that a point of its plane lies beyond; 0 means inside."""
    face = facets.face
    u = face[q, 4] * x + face[q, 5] * y + face[q, 6] * z - face[q, 7]
    v = face[q, 8] * x + face[q, 9] * y + face[q, 10] * z - face[q, 11]
    if facets.is_triangle[q]:
        return (u < 0.0) | (v < 0.0) << 1 | (u + v > 1.0) << 4
    return (u < 0.0) | (v < 0.0) << 1 | (u > 1.0) << 2 | (v > 1.0) << 3


@part
def side_of(face: F64, q: int, x: float, y: float, z: float) -> float:
    """Signed distance of a point from the plane of facet q."""
    return face[q, 0] * x + face[q, 1] * y + face[q, 2] * z - face[q, 3]


@part
def inverse_of(d: float) -> float:
    """1 / d, and a large number where d is next to nothing."""
    return 1.0 / d if abs(d) > 1e-12 else 1e12


@part
def _extent(vertex: F64, v: int, a: int, bundle: Bundle) -> tuple[float, float]:
    """Lowest and highest coordinate a of vertex v of the paths of a bundle."""
    low = high = vertex[0, v, a]
    for k in range(1, len(bundle)):
        low, high = min(low, vertex[k, v, a]), max(high, vertex[k, v, a])
    return low, high


@part
def _span_along(vertex: F64, s: int, a: int, bundle: Bundle) -> Span:
    (low, high), (low_end, high_end) = _extent(vertex, s, a, bundle), _extent(vertex, s + 1, a, bundle)
    return low - SLACK_M, inverse_of(low_end - low), high + SLACK_M, inverse_of(high_end - high)


@part
def _span_about(vertex: F64, v: int, a: int, margin: float, bundle: Bundle) -> Span:
    low, high = _extent(vertex, v, a, bundle)
    return low - margin, inverse_of(0.0), high + margin, inverse_of(0.0)


@part
def tube_along(vertex: F64, s: int, bundle: Bundle) -> Tube:
    """The tube about the segments s of all paths of a bundle.

    For each axis it has the lowest and the highest coordinate at its start, each followed by the inverse of how much
    that grows along the tube. So at the share t of its length it is a box, of which each face moves evenly with t.
    """
    x, y = _span_along(vertex, s, 0, bundle), _span_along(vertex, s, 1, bundle)
    return x, y, _span_along(vertex, s, 2, bundle)


@part
def tube_about(vertex: F64, v: int, margin: float, bundle: Bundle) -> Tube:
    """The box about vertex v of all paths of a bundle, widened by a margin, as a tube without length."""
    x, y = _span_about(vertex, v, 0, margin, bundle), _span_about(vertex, v, 1, margin, bundle)
    return x, y, _span_about(vertex, v, 2, margin, bundle)


@part
def _shared(low: float, high: float, span: Span, enters: float, leaves: float) -> tuple[float, float]:
    """The part of the stretch enters … leaves in which a tube's span meets that from low to high; reversed for none."""
    until, since = (high - span[0]) * span[1], (low - span[2]) * span[3]
    if span[1] > 0.0:
        leaves = min(leaves, until)
    else:
        enters = max(enters, until)
    if span[3] > 0.0:
        enters = max(enters, since)
    else:
        leaves = min(leaves, since)
    return enters, leaves


@part
def _entry(box: F64, b: int, tube: Tube, reach: float) -> float:
    """Where a tube enters a box, or `FAR` where it does not up to `reach`."""
    enters, leaves = _shared(box[b, 0], box[b, 3], tube[0], 0.0, reach)
    enters, leaves = _shared(box[b, 1], box[b, 4], tube[1], enters, leaves)
    enters, leaves = _shared(box[b, 2], box[b, 5], tube[2], enters, leaves)
    return enters if enters <= leaves else FAR


@part
def next_leaf(facets: Facets, tube: Tube, reach: float, walk: Walk, top: int) -> tuple[int, int]:
    """The next leaf on a tube's way, or −1, and the number of boxes that are then still to be looked into.

    With `top` −1 the search begins anew. Nearer boxes come first.
    """
    box, box_at = walk.box, walk.box_at
    if top < 0:
        top = 0
        if len(facets.box):
            box[0], box_at[0] = 0, _entry(facets.box, 0, tube, reach)
            top = 1
    while top > 0:
        top -= 1
        b = box[top]
        if box_at[top] > reach:
            continue
        near = facets.child[b]
        if near < 0:
            return top, b
        far = near + 1
        near_at = _entry(facets.box, near, tube, reach)
        far_at = _entry(facets.box, far, tube, reach)
        if far_at < near_at:
            near, far, near_at, far_at = far, near, far_at, near_at
        if far_at < FAR:
            box[top], box_at[top] = far, far_at
            top += 1
        if near_at < FAR:
            box[top], box_at[top] = near, near_at
            top += 1
    return 0, -1


@bare
def first_hit(facets: Facets, o: F64, d: F64, walk: Walk) -> tuple[int, float]:
    """Facet and distance of what a ray from o along d meets first; facet −1 where it meets nothing."""
    hit, nearest, top, face = -1, FAR, -1, facets.face
    ix, iy, iz, m = inverse_of(d[0]), inverse_of(d[1]), inverse_of(d[2]), SLACK_M
    x, y, z = o[0], o[1], o[2]
    tube = (x - m, ix, x + m, ix), (y - m, iy, y + m, iy), (z - m, iz, z + m, iz)
    while True:
        top, leaf = next_leaf(facets, tube, nearest, walk, top)
        if leaf < 0:
            return hit, nearest
        for q in range(facets.first[leaf], facets.last[leaf]):
            speed = face[q, 0] * d[0] + face[q, 1] * d[1] + face[q, 2] * d[2]
            if speed == 0.0:
                continue
            t = -side_of(face, q, o[0], o[1], o[2]) / speed
            if t < 1e-7 or t >= nearest:
                continue
            x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
            if beyond_edges(facets, q, x, y, z) == 0:
                hit, nearest = q, t
