"""Kernels of paths over one edge, with planes that reflect them before and after: their way, field and sum.

Each end of a path sees the edge directly or over some planes: that is a side, the image of the end mirrored in one
plane after another. Unfolded, a path is the shortest way from one image over the edge to the other. Turned about the
edge into one half-plane it is a straight line, which gives the point of the edge in closed form. From there on both of
its halves are paths as any other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from xfreqbench.tracing.paths import DIFFRACTION

from .arrays import BLOCK, C128, F64, I32, I64, CentrePath, Path, SceneArrays, Sums, Walk, new_walk
from .bundles import EVERYWHERE, MIXED, NOWHERE, UNKNOWN, follow
from .channels import list_interactions, met_of
from .compiled import bare, entry, lane, part, whole
from .edge_sides import MAX_SIDE_PLANES, Reflectors, Sides, sides_of
from .fields import antenna_field, antenna_of, element_gain, specular_share
from .slabs import cosine_and_sine, reflect, transmit
from .tree import CORNERS, LONE, QUAD, Bundle
from .wedges import Polar, Wedges, diffract, edge_point, off_boundary, place, polar, terms_of, unfolded

Halves = tuple[int, int]  # what is gathered for either half of paths
NEITHER: Halves = (UNKNOWN, UNKNOWN)
ARRAY_REACH = 1.6  # π/2 and some: an arc about an edge, over its array's radius, beyond which the array has one side


class EdgeContext(NamedTuple):
    """What is the same for all paths."""

    scene: SceneArrays
    wedges: Wedges
    mirrors: Reflectors
    ends: I64  # (E,): which transmitters count at each edge; see `edge_sides.Search`


class _EdgePath(NamedTuple):
    """A path over an edge, by how its two ends see it: the planes of either half are those of its end's side."""

    edge: int
    near: Path  # the half on the transmitter's side
    far: Path
    near_polar: Polar  # where the image of the transmitter is from the edge
    far_polar: Polar  # where that of the array centre is


class Limits(NamedTuple):
    """Which paths are sought, and which of them are skipped."""

    max_depth: int  # interactions in all
    max_planes: int  # reflections on either side of the edge
    share: bool  # decide at the array's corners which paths reach its elements


class Work(NamedTuple):
    """Work space of one thread: the halves of a path, each from the edge to its end, and what is at the edge."""

    near: Walk
    far: Walk
    end: F64  # (2, 3) images of the transmitter and of an element
    point: F64  # (3,) of the edge
    waves: F64  # (2, 3): unit vectors from the ends to the point
    fields: C128  # (2, 3): that they bring there
    gains: C128  # (M,)
    vectors: F64  # (3, 3)
    zeros: F64  # (4, 3)
    four: F64  # (4, 3): offsets of elements
    most: F64  # (F,): bounds of a path's amplitude over its wavelength, in 1/m
    floor: F64  # (1,): the least with which it is added


@whole
def _new_work(num_elements: int, num_carriers: int) -> Work:
    return Work(
        new_walk(MAX_SIDE_PLANES, 1, 1, np.zeros(3)),
        new_walk(MAX_SIDE_PLANES, 1, 1, np.zeros(3)),
        np.zeros((2, 3)),
        np.zeros(3),
        np.zeros((2, 3)),
        np.zeros((2, 3), np.complex128),
        np.zeros(num_elements, np.complex128),
        np.zeros((3, 3)),
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros(num_carriers),
        np.zeros(1),
    )


@bare
def _begin_at(wedges: Wedges, e: int, work: Work) -> None:
    """Let the halves of paths begin at edge e."""
    for c in range(3):
        start, along = wedges.start[e, c], wedges.along[e, c]
        work.near.edge[0, c] = work.far.edge[0, c] = start
        work.near.edge[1, c] = work.far.edge[1, c] = start + wedges.length[e] * along


@bare
def _end_at(side: Path, x: float, y: float, z: float, out: F64) -> None:
    """Image of an end's point at an offset from its centre."""
    for c in range(3):
        out[c] = side.image[c] + side.mirror[c, 0] * x + side.mirror[c, 1] * y + side.mirror[c, 2] * z


@part
def _counts(wedges: Wedges, e: int, near_phi: float, phi: float) -> bool:
    """Whether two ends at these angles about edge e, neither of them in a face, have a path over it."""
    free, is_apart = wedges.angle[e], 0.0 < phi < 2.0 * math.pi
    first, last, _ = terms_of(wedges, e, near_phi, phi)
    return is_apart and phi != free and first < last and (wedges.has_inside[e] or (phi < free and near_phi < free))


@bare
def _meets(wedges: Wedges, e: int, near: Polar, far_end: F64) -> tuple[int, float]:
    """0 where the shortest way over edge e to an end meets the edge, else the bit of the reason why it does not.

    Also returned is where along the edge it does, in metres.
    """
    far = polar(wedges, e, far_end)
    if far[0] <= 1e-9 or not _counts(wedges, e, near[2], far[2]):
        return 1, 0.0
    z = edge_point(near, far)
    if z < 0.0:
        return 2, z
    return (0 if z < wedges.length[e] else 4), z


@bare
def _reach(
    context: EdgeContext, path: _EdgePath, offset_m: F64, gathered: Halves, max_depth: int, bundle: Bundle, work: Work
) -> tuple[int, Halves]:
    """Whether paths of at most `max_depth` interactions reach EVERYWHERE, NOWHERE or, MIXED, only some ends.

    `offset_m` (K, 3) are offsets of the elements; `gathered` is what was for the halves of a bundle in which the paths
    lie, and what then is for theirs is returned too. `_begin_at` was called for the edge. What the paths meet is left
    in `work`.
    """
    facets, wedges, e, near = context.scene.facets, context.wedges, path.edge, path.near_polar
    if near[0] <= 1e-9 or near[2] == 0.0 or near[2] == wedges.angle[e]:
        return NOWHERE, gathered
    num_met, num_inside, common = 0, 0, 7
    for k in range(len(bundle)):
        _end_at(path.far, offset_m[k, 0], offset_m[k, 1], offset_m[k, 2], work.end[1])
        reason, z = _meets(wedges, e, near, work.end[1])
        num_met += reason == 0
        num_inside += polar(wedges, e, work.end[1])[2] > wedges.angle[e]
        common &= reason
        for c in range(3):
            work.near.start[k, c] = work.far.start[k, c] = wedges.start[e, c] + z * wedges.along[e, c]
    if num_met < len(bundle):
        return (NOWHERE if common != 0 else MIXED), gathered
    if 0 < num_inside < len(bundle):
        return MIXED, gathered
    work.near.limit[0] = max_depth - 1 - path.near.length - path.far.length
    before, at_near = follow(facets, path.near, work.zeros, gathered[0], bundle, work.near)
    if before == NOWHERE:
        return NOWHERE, gathered
    work.far.limit[0] = work.near.limit[0]
    if before == EVERYWHERE:
        for s in range(path.near.length + 1):
            work.far.limit[0] -= work.near.num_crossed[s]
    after, at_far = follow(facets, path.far, offset_m, gathered[1], bundle, work.far)
    return (before if after == EVERYWHERE else after), (at_near, at_far)


@bare
def _carry(scene: SceneArrays, side: Path, walk: Walk, end: F64, lane: int, half: int, work: Work) -> None:
    """Carry the field of the antenna at one end to the point of the edge, backwards over a half that was traced.

    `end` is the image of that end. The wave's direction at the edge is left in `work.waves`.
    """
    facets, media, _, _ = scene
    wave, way, mirror, field = walk.wave, work.waves[half], side.mirror, work.fields[half]
    norm = 0.0
    for c in range(3):
        way[c] = work.point[c] - end[c]
        norm += way[c] * way[c]
    for c in range(3):
        way[c] /= math.sqrt(norm)
    for c in range(3):
        wave[c * BLOCK] = mirror[0, c] * way[0] + mirror[1, c] * way[1] + mirror[2, c] * way[2]
        wave[(6 + c) * BLOCK] = 0.0
    antenna = antenna_of(media.antennas[half])
    sent = antenna_field(antenna, wave[0], wave[BLOCK], wave[2 * BLOCK])
    own = element_gain(antenna, wave[0], wave[BLOCK], wave[2 * BLOCK]) if antenna.is_directive else 1.0
    wave[3 * BLOCK], wave[4 * BLOCK], wave[5 * BLOCK] = own * sent[0], own * sent[1], own * sent[2]
    for s in range(side.length, -1, -1):
        for i in range(walk.num_crossed[s] - 1, -1, -1):
            q, kind = walk.crossed[s, i], facets.slab[walk.crossed[s, i]]
            layers = media.lanes[media.first[kind] : media.first[kind + 1], :, lane : lane + 1]
            transmit(layers, facets.face[q], wave, 1)
        if s > 0:
            q, kind = walk.hit[s - 1], facets.slab[walk.hit[s - 1]]
            layers = media.lanes[media.first[kind] : media.first[kind + 1], :, lane : lane + 1]
            reflect(layers, facets.face[q], wave, 1)
    share = specular_share(facets, media, side.length, walk)
    for c in range(3):
        field[c] = complex(wave[(3 + c) * BLOCK], wave[(6 + c) * BLOCK]) * share


@bare
def _gain(context: EdgeContext, path: _EdgePath, f: int, work: Work) -> complex:
    """Gain at carrier f of the path that was traced last, to the end in `work.end[1]`.

    Spreading and travel phase are left out, as if the path were straight.
    """
    wedges, media, lane = context.wedges, context.scene.media, f * context.scene.aperture.weight.shape[0]
    e, near, far = path.edge, path.near_polar, polar(wedges, path.edge, work.end[1])
    z = edge_point(near, far)
    before, after = math.hypot(near[0], z - near[1]), math.hypot(far[0], z - far[1])
    for c in range(3):
        work.point[c] = wedges.start[e, c] + z * wedges.along[e, c]
    _carry(context.scene, path.near, work.near, work.end[0], lane, 0, work)
    _carry(context.scene, path.far, work.far, work.end[1], lane, 1, work)
    num_left = work.far.limit[0] + 1  # of interactions, with the edge's own
    for s in range(path.far.length + 1):
        num_left -= work.far.num_crossed[s]
    size = 4.0 * math.pi / context.scene.aperture.wavelength_m[f] * before * after / (before + after)
    waves, fields = (work.waves[0], work.waves[1]), (work.fields[0], work.fields[1])
    root = math.sqrt(size) * near[0] / before
    return diffract(wedges, media, e, f, waves, fields, (near[2], far[2]), root, num_left, work.vectors)


@bare
def _length_over(wedges: Wedges, e: int, near: Polar, x: F64) -> float:
    """Length of the shortest way over the edge from a point in polar coordinates to another."""
    a, b, z = place(wedges, e, x)
    return math.sqrt((near[0] + math.sqrt(a * a + b * b)) ** 2 + (near[1] - z) ** 2)


@bare
def _gains(context: EdgeContext, path: _EdgePath, f: int, shift: float, work: Work) -> None:
    """Gains at carrier f at all elements, of a path that reaches all of them, to work.gains (M,).

    A field that hardly changes over the array is computed at its centre, one that changes a little at the nodes between
    which it is interpolated, and others at every element. `shift` is its change by the metre, relative to its size.
    """
    aperture, gains, corner = context.scene.aperture, work.gains, context.scene.aperture.corner_m[f, 0]
    changes = shift * math.sqrt(corner[0] ** 2 + corner[1] ** 2 + corner[2] ** 2)
    num_nodes, num_elements = aperture.weight.shape
    most = 0.01 * work.floor[0] / work.most[f]  # so that the errors of all paths are below 1e-3 of the channel
    if num_nodes == num_elements or changes * changes > most:
        for m in range(num_elements):
            x, y, z = aperture.element_m[f, 0, m], aperture.element_m[f, 1, m], aperture.element_m[f, 2, m]
            _end_at(path.far, x, y, z, work.end[1])
            gains[m] = _gain(context, path, f, work)
    elif changes < most:
        _end_at(path.far, 0.0, 0.0, 0.0, work.end[1])
        at_centre = _gain(context, path, f, work)
        for m in range(num_elements):
            gains[m] = at_centre
    else:
        for m in range(num_elements):
            gains[m] = 0.0
        for node in range(num_nodes):
            i = f * num_nodes + node
            _end_at(path.far, aperture.node_m[0, i], aperture.node_m[1, i], aperture.node_m[2, i], work.end[1])
            at_node = _gain(context, path, f, work)
            for m in range(num_elements):
                gains[m] += aperture.weight[node, m] * at_node


@part
def _bounds(wedges: Wedges, e: int, near: Polar, far: Polar, wavelength_m: F64, out: F64) -> None:
    """Write bounds (F,) of a diffracted path's amplitude over its wavelength, in 1/m, reflections left out.

    Each term is at most 1, and at most its value by geometrical optics far off its boundary.
    """
    free, together, (first, last, n) = wedges.angle[e], near[0] + far[0], terms_of(wedges, e, near[2], far[2])
    length_m = math.hypot(together, near[1] - far[1])
    root = math.sqrt(4.0 * math.pi * math.pi * near[0] * far[0] / length_m)
    for f in range(out.shape[0]):
        out[f] = 0.0 if first < last else 1.0 / (4.0 * math.pi * length_m)
    for term in range(first, last):
        off = off_boundary(n, unfolded(free, term, near[2], far[2]))
        sine = abs(math.sin(n * off))
        share = min(1.0, sine / (n * abs(math.tan(off)) + 1e-30)) / (8.0 * math.pi * length_m)
        far_off = 1.0 / (root * sine + 1e-30)
        for f in range(out.shape[0]):
            out[f] += share * min(1.0, far_off * math.sqrt(wavelength_m[f]))


@bare
def _change(context: EdgeContext, path: _EdgePath, work: Work) -> float:
    """By how much, relative to its size, the field changes where the far end moves by a metre; roughly."""
    wedges, e, near, far, axis = context.wedges, path.edge, path.near_polar, path.far_polar, work.end[1]
    first, last, n = terms_of(wedges, e, near[2], far[2])
    least = 1.0 if first < last else 0.0
    for term in range(first, last):
        least = min(least, 2.0 * n * abs(off_boundary(n, unfolded(wedges.angle[e], term, near[2], far[2]))))
    z, along, squared = edge_point(near, far), 0.0, 0.0  # its direction turns fast near the axis of the antenna
    x, y, up = antenna_of(context.scene.media.antennas[1]).axis
    for c in range(3):
        axis[c] = path.far.mirror[c, 0] * x + path.far.mirror[c, 1] * y + path.far.mirror[c, 2] * up
        way = wedges.start[e, c] + z * wedges.along[e, c] - path.far.image[c]
        along += way * axis[c]
        squared += way * way
    return 1.0 / (min(far[0] * least, math.sqrt(max(squared - along * along, 0.0))) + 1e-30)


@part
def _fade(work: Work, f: int) -> float:
    """The share of a path that is added at carrier f: less than 1 below twice the floor, so that none ends abruptly."""
    above = work.most[f] - work.floor[0]
    return 1.0 if above >= work.floor[0] else above / work.floor[0]


@bare
def _add_path(context: EdgeContext, path: _EdgePath, limits: Limits, work: Work, sums: Sums, num_paths: I32) -> None:
    """Add a path to `sums` (F, M) each at the carriers where it may be as strong as the floor.

    A carrier at which the corners agree decides for all narrower apertures.
    """
    (real, imag), aperture, reached, gathered = sums, context.scene.aperture, MIXED, NEITHER
    shift = _change(context, path, work)
    for f in range(num_paths.shape[0]):
        if work.most[f] < work.floor[0]:
            continue
        if limits.share and reached == MIXED:
            corner_m = aperture.corner_m[f]
            reached, gathered = _reach(context, path, corner_m, NEITHER, limits.max_depth, CORNERS, work)
        if reached == NOWHERE:
            break
        is_heard, own_sums, fade = False, (real[f], imag[f]), _fade(work, f)
        if reached == EVERYWHERE:
            _gains(context, path, f, shift, work)
            for m in range(real.shape[1]):
                is_heard |= _add_element(context, path, f, m, fade, work, own_sums)
        else:
            is_heard = _add_to_some(context, path, f, shift, gathered, limits.max_depth, work, own_sums)
        num_paths[f] += is_heard


@bare
def _add_to_some(
    context: EdgeContext,
    path: _EdgePath,
    f: int,
    shift: float,
    gathered: Halves,
    max_depth: int,
    work: Work,
    sums: Sums,
) -> bool:
    """Add a path at carrier f to those of the elements that it reaches; False where it is heard at none.

    It is decided for each quad of neighbours at once, where they agree. Those whose paths meet the same have gains as
    `_gains` computes them, unless the array reaches from one side of a face to the other.
    """
    quads, wedges, corner_m, num_inside = context.scene.quads, context.wedges, context.scene.aperture.corner_m[f], 0
    for k in range(4):
        _end_at(path.far, corner_m[k, 0], corner_m[k, 1], corner_m[k, 2], work.end[1])
        num_inside += polar(wedges, path.edge, work.end[1])[2] > wedges.angle[path.edge]
    is_heard, known, fade = False, -1, _fade(work, f)
    for b in range(quads.shape[0]):
        quad, reached, at_quad = quads[b], MIXED, gathered
        for k in range(4):
            for c in range(3):
                work.four[k, c] = context.scene.aperture.element_m[f, c, quad[k]]
        if quad[0] < quad[3]:  # else it is a single element
            reached, at_quad = _reach(context, path, work.four, gathered, max_depth, QUAD, work)
        last = -1
        for k in range(4 if reached != NOWHERE else 0):
            m, lone = quad[k], work.four[k : k + 1]
            if m <= last:  # there again, at the rim of an odd number of elements
                continue
            last = m
            if reached == MIXED and _reach(context, path, lone, at_quad, max_depth, LONE, work)[0] != EVERYWHERE:
                continue
            met = (met_of(path.near.length, work.near) * 31 + met_of(path.far.length, work.far)) & 0x7FFF_FFFF_FFFF_FFFF
            if 0 < num_inside < 4:
                _end_at(path.far, lone[0, 0], lone[0, 1], lone[0, 2], work.end[1])
                work.gains[m] = _gain(context, path, f, work)
            elif met != known:
                _gains(context, path, f, shift, work)
                known = met
            is_heard |= _add_element(context, path, f, m, fade, work, sums)
    return is_heard


@bare
def _add_element(context: EdgeContext, path: _EdgePath, f: int, m: int, fade: float, work: Work, sums: Sums) -> bool:
    """Add a share of a path at element m to `sums` (M,) of carrier f; its gain is in `work`. False if it vanished."""
    element_m, wavelength_m = context.scene.aperture.element_m, context.scene.aperture.wavelength_m[f]
    _end_at(path.far, element_m[f, 0, m], element_m[f, 1, m], element_m[f, 2, m], work.end[1])
    length_m = _length_over(context.wedges, path.edge, path.near_polar, work.end[1])
    cosine, sine = cosine_and_sine(length_m / wavelength_m)
    factor = fade * wavelength_m / (4.0 * math.pi * length_m) * complex(cosine, -sine) * work.gains[m]
    sums[0][m] += factor.real
    sums[1][m] += factor.imag
    return factor != 0


@part
def _meet(wedges: Wedges, e: int, near: Sides, a: int, far: Sides, b: int, radius_m: float) -> bool:
    """Whether the path over two sides meets edge e in the parts that they see, for ends within a radius."""
    near_m, far_m, phi = near.polar[a, 0], far.polar[b, 0], far.polar[b, 2]
    off_face = min(abs(phi - wedges.angle[e]), 2.0 * math.pi - phi)
    if off_face * far_m > ARRAY_REACH * radius_m and not _counts(wedges, e, near.polar[a, 2], phi):
        return False
    z_m = edge_point((near_m, near.polar[a, 1], 0.0), (far_m, far.polar[b, 1], 0.0))
    lean = abs(far.polar[b, 1] - near.polar[a, 1]) / (near_m + far_m)
    slack_m = 1.2 * radius_m * (1.0 + lean) + 1e-9
    low_m = max(near.span[a, 0], far.span[b, 0]) - slack_m
    return low_m <= z_m <= min(near.span[a, 1], far.span[b, 1]) + slack_m


@lane
def _path_over(e: int, near: Sides, a: int, far: Sides, b: int) -> _EdgePath:
    """The path over edge e that two of its sides make."""
    return _EdgePath(
        e,
        Path(near.length[a], near.plane[a], near.image[a], near.mirror[a]),
        Path(far.length[b], far.plane[b], far.image[b], far.mirror[b]),
        (near.polar[a, 0], near.polar[a, 1], near.polar[a, 2]),
        (far.polar[b, 0], far.polar[b, 1], far.polar[b, 2]),
    )


@bare
def _may_count(context: EdgeContext, path: _EdgePath, near_most: F64, far_most: F64, work: Work) -> bool:
    """Whether a path may be as strong as the floor at any carrier; bounds of its amplitude are left in work.most (F,).

    `near_most` and `far_most` (F,) bound what the planes of its halves reflect.
    """
    most, is_any = work.most, False
    wavelength_m = context.scene.aperture.wavelength_m
    _bounds(context.wedges, path.edge, path.near_polar, path.far_polar, wavelength_m, most)
    for f in range(most.shape[0]):
        most[f] *= near_most[f] * far_most[f]
        is_any |= most[f] >= work.floor[0]
    return is_any


@bare
def _add_all(
    context: EdgeContext, near: Sides, far: Sides, limits: Limits, work: Work, sums: Sums, num_paths: I32
) -> None:
    """Add all paths over edges to `sums` (F, M) each."""
    radius_m = context.scene.aperture.radius_m
    for e in range(context.wedges.length.shape[0]):
        _begin_at(context.wedges, e, work)
        for a in range(near.first[e], near.first[e + 1]):
            for c in range(3):
                work.end[0, c] = near.image[a, c]
            for b in range(far.first[e], far.first[e + 1]):
                is_deep = near.length[a] + far.length[b] >= limits.max_depth
                if is_deep or not _meet(context.wedges, e, near, a, far, b, radius_m):
                    continue
                path = _path_over(e, near, a, far, b)
                if _may_count(context, path, near.most[a], far.most[b], work):
                    _add_path(context, path, limits, work, sums, num_paths)


@entry
def add_over_edges(
    context: EdgeContext, far: Sides, limits: Limits, tx: F64, floor: float, sums: Sums, num_paths: I32
) -> None:
    """Add the channel (F, M) over edges of the transmitter at `tx` (1, 3) to `sums`, which hold that of other paths.

    The numbers of its paths are added to `num_paths` (F,). `far` is how the array sees the edges. Paths that a bound
    shows to be weaker than `floor`, amplitude over wavelength in 1/m, are skipped.
    """
    near = sides_of(context.scene.facets, context.mirrors, context.wedges, context.ends, tx, limits.max_planes)
    work = _new_work(sums[0].shape[1], num_paths.shape[0])
    work.floor[0] = floor
    _add_all(context, near, far, limits, work, sums, num_paths)


@entry
def paths_over_edges(
    context: EdgeContext, far: Sides, limits: Limits, surface: I64, edge_surface: I64, tx: F64, floor: float
) -> list[CentrePath]:
    """Paths over edges from the transmitter at `tx` (1, 3) to the array centre, those that `add_over_edges` adds.

    `surface` (Q,) is the mesh of each facet, `edge_surface` (E,) that of a face of each edge. The gain is 0 at carriers
    at which the path is skipped.
    """
    near = sides_of(context.scene.facets, context.mirrors, context.wedges, context.ends, tx, limits.max_planes)
    num_carriers, depth = context.scene.aperture.wavelength_m.shape[0], limits.max_depth
    work, centre, reached = _new_work(1, num_carriers), np.zeros((1, 3)), []
    work.floor[0] = floor
    for e in range(context.wedges.length.shape[0]):
        _begin_at(context.wedges, e, work)
        for a in range(near.first[e], near.first[e + 1]):
            work.end[0] = near.image[a]
            for b in range(far.first[e], far.first[e + 1]):
                if near.length[a] + far.length[b] >= depth or not _meet(context.wedges, e, near, a, far, b, 0.0):
                    continue
                path = _path_over(e, near, a, far, b)
                if not _may_count(context, path, near.most[a], far.most[b], work):
                    continue
                if _reach(context, path, centre, NEITHER, depth, LONE, work)[0] != EVERYWHERE:
                    continue
                code, met, point = np.zeros(depth, np.int64), np.full(depth, -1), np.full((depth, 3), np.nan)
                at = list_interactions(work.near, path.near.length, True, 0, surface, code, met, point)
                code[at], met[at], point[at] = DIFFRACTION, edge_surface[e], work.near.vertex[0, 0]
                list_interactions(work.far, path.far.length, False, at + 1, surface, code, met, point)
                gain = np.zeros(num_carriers, np.complex128)
                for f in range(num_carriers):
                    if work.most[f] >= work.floor[0]:
                        gain[f] = _fade(work, f) * _gain(context, path, f, work)
                length_m = _length_over(context.wedges, e, path.near_polar, work.end[1])
                way = work.far.vertex[0, path.far.length] - work.far.vertex[0, path.far.length + 1]
                reached.append((gain, length_m, way / np.linalg.norm(way), code, met, point))
    return reached
