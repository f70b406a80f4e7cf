"""Kernels that sum the paths of a transmitter to its channel, and list those that reach the array centre."""

from __future__ import annotations

import numpy as np

from xfreqbench.tracing.paths import REFRACTION, SPECULAR

from .arrays import BLOCK, F64, I32, I64, CentrePath, Facets, Media, Path, SceneArrays, Sums, Walk, new_walk
from .bundles import EVERYWHERE, MIXED, NOWHERE, UNKNOWN, follow
from .compiled import bare, entry, whole
from .fields import Image, gains, interpolate, spread
from .sequences import Trie, candidates_of, line_of
from .tree import CORNERS, LONE, QUAD

NEAR = 20.0  # half diagonals of the array: to shorter paths than so many its elements differ too much to interpolate


@bare
def met_of(length: int, walk: Walk) -> int:
    """A number, not negative, that stands for the facets that the path traced last meets."""
    met = 0
    for s in range(length + 1):
        for i in range(walk.num_crossed[s]):
            met = met * 1_000_003 + 2 * walk.crossed[s, i] + 1
        met = met * 1_000_003 + 2 * walk.hit[s]
    return met & 0x7FFF_FFFF_FFFF_FFFF


@bare
def _add_to_some(scene: SceneArrays, path: Path, f: int, image: Image, gathered: int, walk: Walk, sums: Sums) -> bool:
    """Add a path at carrier f to those of the elements that it reaches; False where it is heard at none.

    It is decided for each quad of neighbours at once, where they agree. `gathered` is what was for all elements.
    """
    facets, media, aperture, quads = scene
    (real, imag), own = sums, walk.own
    element_m, wavelength_m, num_elements = aperture.element_m[f], aperture.wavelength_m[f], real.shape[0]
    first = aperture.node_m.shape[1] + f * num_elements
    four, is_heard, known = walk.four, False, -1
    for b in range(quads.shape[0]):
        quad, reach, at_quad = quads[b], MIXED, gathered
        for k in range(4):
            for a in range(3):
                four[k, a] = element_m[a, quad[k]]
        if quad[0] < quad[3]:  # else it is a single element
            reach, at_quad = follow(facets, path, four, gathered, QUAD, walk)
        last = -1
        for k in range(4 if reach != NOWHERE else 0):
            e = quad[k]
            if e <= last:  # there again, at the rim of an odd number of elements
                continue
            last = e
            if reach == MIXED and follow(facets, path, four[k : k + 1], at_quad, LONE, walk)[0] != EVERYWHERE:
                continue
            met = met_of(path.length, walk)
            if met != known:  # else the waves at all elements are known, which meet the same
                gains(facets, media, path, element_m, first, num_elements, walk, own)
                spread(own, image, element_m, wavelength_m)
                known = met
            real[e] += own[0, e]
            imag[e] += own[1, e]
            is_heard |= own[0, e] != 0.0 or own[1, e] != 0.0
    return is_heard


@bare
def _add_path(scene: SceneArrays, path: Path, share: bool, walk: Walk, sums: Sums, num_paths: I32) -> None:
    """Add a path to `sums` (F, M) each. A carrier at which the corners agree decides for all narrower apertures."""
    facets, media, aperture, _ = scene
    (real, imag), reach, num_carriers, num_nodes = sums, MIXED, num_paths.shape[0], aperture.weight.shape[0]
    start, end, mirror = walk.start, path.image, path.mirror
    x, y, z = start[0, 0] - end[0], start[0, 1] - end[1], start[0, 2] - end[2]
    image = (  # the way from the image of the array centre to the transmitter, in the elements' axes
        x * x + y * y + z * z,
        x * mirror[0, 0] + y * mirror[1, 0] + z * mirror[2, 0],
        x * mirror[0, 1] + y * mirror[1, 1] + z * mirror[2, 1],
        x * mirror[0, 2] + y * mirror[1, 2] + z * mirror[2, 2],
    )
    gathered = UNKNOWN
    for f in range(num_carriers):
        if share and reach == MIXED:
            # what wider corners gathered is not used: whether the field is interpolated would depend on them
            reach, gathered = follow(facets, path, aperture.corner_m[f], UNKNOWN, CORNERS, walk)
            if reach == EVERYWHERE:
                first, last = f * num_nodes, num_carriers * num_nodes
                gain = walk.gain[:, first:last]
                gains(facets, media, path, aperture.node_m[:, first:last], first, last - first, walk, gain)
        if reach == NOWHERE:
            break
        own_sums = real[f], imag[f]
        if reach == EVERYWHERE:
            corner = aperture.corner_m[f, 0]
            if image[0] < NEAR**2 * (corner[0] ** 2 + corner[1] ** 2 + corner[2] ** 2):
                own_lane = num_carriers * num_nodes + f * real.shape[1]
                gains(facets, media, path, aperture.element_m[f], own_lane, real.shape[1], walk, walk.own)
            else:
                interpolate(walk.gain, f * num_nodes, aperture.weight, walk.own)
            spread(walk.own, image, aperture.element_m[f], aperture.wavelength_m[f])
            size = 0.0
            for e in range(real.shape[1]):
                real[f, e] += walk.own[0, e]
                imag[f, e] += walk.own[1, e]
                size += abs(walk.own[0, e]) + abs(walk.own[1, e])
            num_paths[f] += size > 0.0
        else:
            num_paths[f] += _add_to_some(scene, path, f, image, gathered, walk, own_sums)


@entry
def add_channel(
    scene: SceneArrays, trie: Trie, tx: F64, max_depth: int, share: bool, sums: Sums, num_paths: I32
) -> None:
    """Add the channel (F, M) of the transmitter at `tx` (3,) to `sums`, and the number of its paths (F,).

    A path counts where its field reaches at least one element and has not vanished on the way. With `share` the
    corners of the aperture decide for the elements between them, which changes the answer by rounding only.
    """
    walk = new_walk(max_depth, scene.aperture.node_m.shape[1], scene.aperture.weight.shape[1], tx)
    found = np.empty(len(trie.parent), np.int64)
    for c in range(candidates_of(trie, tx, found)):
        length = line_of(scene.facets, trie, found[c], walk)
        path = Path(length, walk.plane, walk.image, walk.mirror)
        _add_path(scene, path, share, walk, sums, num_paths)


@whole
def list_interactions(
    walk: Walk, length: int, backward: bool, at: int, surface: I64, code: I64, met: I64, point: F64
) -> int:
    """Write the interactions of the path traced last, as `CentrePath` has them, to rows `at` and after; the next row.

    `surface` is the mesh of each facet.
    """
    for step in range(length + 1):
        s = length - step if backward else step
        start, end = walk.vertex[0, s], walk.vertex[0, s + 1]
        for i in range(walk.num_crossed[s]):
            which = walk.num_crossed[s] - 1 - i if backward else i
            code[at], met[at] = REFRACTION, surface[walk.crossed[s, which]]
            point[at] = start + walk.crossed_at[s, which] * (end - start)
            at += 1
        if step < length:
            turn = s if backward else s + 1
            code[at], met[at], point[at] = SPECULAR, surface[walk.hit[turn - 1]], walk.vertex[0, turn]
            at += 1
    return at


@entry
def paths_to_centre(
    facets: Facets, media: Media, trie: Trie, surface: I64, tx: F64, max_depth: int
) -> list[CentrePath]:
    """Paths from `tx` (3,) to the array centre; `surface` is the mesh of each facet.

    The lanes of `media` are its carriers.
    """
    num_carriers = media.permittivity.shape[0]
    centre, centres = np.zeros((1, 3)), np.zeros((3, num_carriers))
    found, reached = np.empty(len(trie.parent), np.int64), []
    walk = new_walk(max_depth, num_carriers, 1, tx)
    for c in range(candidates_of(trie, tx, found)):
        length = line_of(facets, trie, found[c], walk)
        path = Path(length, walk.plane, walk.image, walk.mirror)
        if follow(facets, path, centre, UNKNOWN, LONE, walk)[0] == EVERYWHERE:
            gains(facets, media, path, centres, 0, num_carriers, walk, walk.gain)
            code, met, point = (np.zeros(max_depth, np.int64), np.full(max_depth, -1), np.full((max_depth, 3), np.nan))
            list_interactions(walk, length, False, 0, surface, code, met, point)
            arrival, gain = -walk.wave[: 3 * BLOCK : BLOCK], walk.gain[0] + 1j * walk.gain[1]
            length_m = float(np.linalg.norm(tx - walk.image))
            reached.append((gain, length_m, arrival, code, met, point))
    return reached
