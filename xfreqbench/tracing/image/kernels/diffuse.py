"""Kernels of diffuse reflection: what the tiles of rough facets scatter to the array.

A path meets one tile. Its two legs, to the transmitter and to the centre of the array, are traced from the middle of
the tile as any path, directly or over one mirror. The power that falls on a tile is that of the solid angle which the
tile fills for the transmitter or its image, so that it does not depend on how fine the tiles are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from xfreqbench.scene.patches import PLANE_TOLERANCE
from xfreqbench.tracing.paths import DIFFUSE

from .arrays import (
    BLOCK,
    F64,
    FAR,
    I32,
    I64,
    SIMD_WIDTH,
    Bools,
    CentrePath,
    Facets,
    Media,
    Path,
    SceneArrays,
    Sums,
    Walk,
    new_walk,
)
from .bundles import EVERYWHERE, UNKNOWN, follow, gather_mirrors
from .channels import list_interactions
from .compiled import bare, entry
from .fields import antenna_field, antenna_of, element_gain, specular_share, spread
from .sequences import mirrored_offsets
from .slabs import cosine_and_sine, reflect, transmit
from .tree import LONE, side_of
from .wedges import dot


class Roughness(NamedTuple):
    """How kinds of slabs scatter. (K kinds)"""

    amplitude: F64  # (K, 2): of the field that keeps its polarisation, and of that which changes it
    alpha: F64  # (K, 2): exponents of the lobes about the specular direction and to the source; 0 for Lambert's law
    share: F64  # (K,): of the first lobe
    norm: F64  # (K, C): the lobes' integral is norm₀ + cos θ·Σ norm_m·sin²ᵐ⁻² θ at the angle of incidence θ


class Tiles(NamedTuple):
    """Parts of rough facets. (N tiles)"""

    middle: F64  # (N, 3)
    sides: F64  # (N, 3, 3): a corner, and from there the sides
    facet: I64  # (N,)
    turns: F64  # (N,): random phase, over 2π


class Windows(NamedTuple):
    """Planes that mirror: their axes u, v and normal, and the rectangle that holds their facets. (P planes)"""

    axis: F64  # (P, 3, 3)
    low: F64  # (P, 2)
    high: F64  # (P, 2)


class Views(NamedTuple):
    """How the array sees tiles; the views of a tile stand together, the direct one first. (V views, F carriers)"""

    first: I64  # (N + 1,): of each tile
    plane: I64  # (V,): that mirrors between the tile and the array, or −1
    num_met: I64  # (V,): interactions between them
    leaves: F64  # (V, 3): unit vector of the wave that leaves the tile
    source: F64  # (V, 3): from the array's centre to the tile, or to its image
    response: F64  # (V, 4, F): what the antenna takes of a field along θ and along φ; of each real and imaginary part


class DiffuseContext(NamedTuple):
    """What is the same for all transmitters. The lanes of `media` are its carriers."""

    facets: Facets
    media: Media
    roughness: Roughness
    windows: Windows
    tiles: Tiles
    views: Views


@bare
def _reach(
    facets: Facets, windows: Windows, tiles: Tiles, n: int, plane: int, end: F64, side: float, most: int, walk: Walk
) -> int:
    """Number of interactions, at most so many, between tile n and `end` (3,); −1 where the way there is blocked.

    It leads over a plane that mirrors, or directly where that is −1. It leaves the tile on the side of its normal where
    `side` is positive, on the other where it is negative, on either where that is 0. It is left in `walk`.
    """
    middle, image, length, face, q = tiles.middle[n], walk.image, 0, facets.face, tiles.facet[n]
    for a in range(3):
        image[a] = end[a]
    if plane >= 0:
        axis, length = windows.axis[plane], 1
        here = there = -facets.offset[plane]
        for a in range(3):
            here += axis[2, a] * middle[a]
            there += axis[2, a] * end[a]
        if here * there <= 0.0 or abs(here) < PLANE_TOLERANCE:
            return -1
        for b in range(2):
            from_tile = axis[b, 0] * middle[0] + axis[b, 1] * middle[1] + axis[b, 2] * middle[2]
            to_end = axis[b, 0] * end[0] + axis[b, 1] * end[1] + axis[b, 2] * end[2]
            at = from_tile + here / (here + there) * (to_end - from_tile)
            if at < windows.low[plane, b] - PLANE_TOLERANCE or at > windows.high[plane, b] + PLANE_TOLERANCE:
                return -1
        for a in range(3):
            image[a] -= 2.0 * there * axis[2, a]
        walk.plane[0] = plane
    if side_of(face, q, image[0], image[1], image[2]) * side < 0.0:
        return -1
    mirrored_offsets(facets, walk.plane, length, walk.mirror)
    walk.limit[0] = most - length
    for a in range(3):
        walk.start[0, a] = walk.edge[0, a] = middle[a]
        walk.edge[1, a] = (
            middle[a] + 0.3141 * tiles.sides[n, 1, a] + 0.1729 * tiles.sides[n, 2, a]
        )  # in its plane alone
        walk.four[0, a] = 0.0
    path = Path(length, walk.plane, image, walk.mirror)
    if most < length or follow(facets, path, walk.four[:1], UNKNOWN, LONE, walk)[0] != EVERYWHERE:
        return -1
    for s in range(path.length + 1):
        length += walk.num_crossed[s]
    return length


@bare
def _bring(facets: Facets, media: Media, half: int, has_mirror: int, first: int, walk: Walk) -> int:
    """Bring the field of an antenna at the end of the way traced last back to its tile, at carriers `first` and after.

    `half` is 0 for the transmitter's antenna, 1 for the receiver's. The waves are left in `walk.wave`; their number is
    returned.
    """
    wave, start, image, mirror = walk.wave, walk.start, walk.image, walk.mirror
    number = min(BLOCK, media.permittivity.shape[0] - first)
    padded = -(-number // SIMD_WIDTH) * SIMD_WIDTH
    x, y, z = start[0, 0] - image[0], start[0, 1] - image[1], start[0, 2] - image[2]
    inverse = 1.0 / math.sqrt(x * x + y * y + z * z)
    x, y, z = x * inverse, y * inverse, z * inverse
    kx = mirror[0, 0] * x + mirror[1, 0] * y + mirror[2, 0] * z
    ky = mirror[0, 1] * x + mirror[1, 1] * y + mirror[2, 1] * z
    kz = mirror[0, 2] * x + mirror[1, 2] * y + mirror[2, 2] * z
    antenna = antenna_of(media.antennas[half])
    ex, ey, ez = antenna_field(antenna, kx, ky, kz)
    if antenna.is_directive:
        own = element_gain(antenna, kx, ky, kz)
        ex, ey, ez = own * ex, own * ey, own * ez
    for i in range(padded):
        wave[i], wave[BLOCK + i], wave[2 * BLOCK + i] = kx, ky, kz
        wave[3 * BLOCK + i], wave[4 * BLOCK + i], wave[5 * BLOCK + i] = ex, ey, ez
        wave[6 * BLOCK + i], wave[7 * BLOCK + i], wave[8 * BLOCK + i] = 0.0, 0.0, 0.0
    for s in range(has_mirror, -1, -1):
        for i in range(walk.num_crossed[s] - 1, -1, -1):
            q, kind = walk.crossed[s, i], facets.slab[walk.crossed[s, i]]
            transmit(media.lanes[media.first[kind] : media.first[kind + 1], :, first:], facets.face[q], wave, padded)
        if s > 0:
            q, kind = walk.hit[s - 1], facets.slab[walk.hit[s - 1]]
            reflect(media.lanes[media.first[kind] : media.first[kind + 1], :, first:], facets.face[q], wave, padded)
    return number


@bare
def _resolve(wave: F64, x: float, y: float, z: float, share: float, first: int, number: int, out: F64) -> None:
    """So many waves' fields times `share` along θ and φ of a direction, to `out` (4, F), carriers `first` and after."""
    horizontal = math.sqrt(x * x + y * y)
    cos_phi = x / horizontal if horizontal > 1e-12 else 1.0
    sin_phi = y / horizontal if horizontal > 1e-12 else 0.0
    for part in range(2):
        at = (3 + 3 * part) * BLOCK
        for i in range(number):
            ex, ey, ez = wave[at + i], wave[at + BLOCK + i], wave[at + 2 * BLOCK + i]
            out[part, first + i] = share * (z * (cos_phi * ex + sin_phi * ey) - horizontal * ez)
            out[2 + part, first + i] = share * (cos_phi * ey - sin_phi * ex)


@bare
def _triangle(corner: F64, i: int, j: int, k: int) -> float:
    """Solid angle of a triangle seen from the origin (van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983)."""
    a, b, c = corner[i], corner[j], corner[k]
    p, q, r = math.sqrt(dot(a, a)), math.sqrt(dot(b, b)), math.sqrt(dot(c, c))
    volume = (
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    return 2.0 * math.atan2(abs(volume), p * q * r + dot(a, b) * r + dot(a, c) * q + dot(b, c) * p)


@bare
def _solid_angle(sides: F64, is_triangle: bool, eye: F64, corner: F64) -> float:
    """Of a triangle or parallelogram, a corner and two sides, seen from `eye` (3,); `corner` (4, 3) is work space."""
    for a in range(3):
        corner[0, a] = sides[0, a] - eye[a]
        corner[1, a] = corner[0, a] + sides[1, a]
        corner[2, a] = corner[0, a] + sides[2, a]
        corner[3, a] = corner[1, a] + sides[2, a]
    return _triangle(corner, 0, 1, 2) + (0.0 if is_triangle else _triangle(corner, 3, 1, 2))


@bare
def pattern(roughness: Roughness, kind: int, normal: F64, k_in: F64, k_out: F64) -> float:
    """Share of the scattered power that goes along k_out, per steradian, of a wave that comes along k_in.

    Degli-Esposti et al., IEEE Trans. Antennas Propag. 55, 2007: Lambert's law, or lobes ((1 + cos ψ)/2)^α.
    """
    cos_in, cos_out, straight = dot(normal, k_in), dot(normal, k_out), dot(k_in, k_out)
    alpha, share, norm = roughness.alpha[kind], roughness.share[kind], roughness.norm[kind]
    if alpha[0] == 0.0:
        return abs(cos_out) / math.pi
    lobes = share * max(0.0, 0.5 + 0.5 * straight - cos_in * cos_out) ** alpha[0]
    lobes += (1.0 - share) * max(0.0, 0.5 - 0.5 * straight) ** alpha[1]
    sine2, total = 1.0 - cos_in * cos_in, 0.0
    for m in range(norm.shape[0] - 1, 0, -1):
        total = total * sine2 + norm[m]
    return lobes / (norm[0] + abs(cos_in) * total)


@bare
def _light(
    context: DiffuseContext, n: int, plane: int, tx: F64, side: float, most: int, walk: Walk, k_in: F64, field: F64
) -> tuple[int, float]:
    """Number of interactions on the leg from the transmitter to tile n, −1 for none, and the solid angle of the tile.

    Left are the wave's direction in `k_in` (3,), and in `field` (4, F) its components θ and φ times |R·E| / |E|.
    """
    facets, media, _, windows, tiles, _ = context
    q, kind, wave = tiles.facet[n], facets.slab[tiles.facet[n]], walk.wave
    num_met = _reach(facets, windows, tiles, n, plane, tx, side, most, walk)
    if num_met < 0:
        return num_met, 0.0
    has_mirror = 1 if plane >= 0 else 0
    share = specular_share(facets, media, has_mirror, walk)
    for first in range(0, media.permittivity.shape[0], BLOCK):
        number = _bring(facets, media, 0, has_mirror, first, walk)
        for c in range(3):
            k_in[c] = wave[c * BLOCK]
        _resolve(wave, k_in[0], k_in[1], k_in[2], share, first, number, field)
        padded = -(-number // SIMD_WIDTH) * SIMD_WIDTH
        reflect(media.lanes[media.first[kind] : media.first[kind + 1], :, first:], facets.face[q], wave, padded)
        for i in range(number):
            before = after = 0.0
            for c in range(4):
                before += field[c, first + i] ** 2
            for c in range(3, 9):
                after += wave[c * BLOCK + i] ** 2
            ratio = share * math.sqrt(after / before) if before > 0.0 else 0.0
            for c in range(4):
                field[c, first + i] *= ratio
    return num_met, _solid_angle(tiles.sides[n], facets.is_triangle[q], walk.image, walk.four)


@bare
def _scatter(context: DiffuseContext, n: int, v: int, solid: float, k_in: F64, field: F64, gain: F64) -> bool:
    """What view v of tile n takes of the field that falls on it, to `gain` (2, F); False where it sees the other side.

    Spreading from the tile on, travel phase and random phase are left out.
    """
    facets, _, roughness, _, tiles, views = context
    q, leaves, response = tiles.facet[n], views.leaves[v], views.response[v]
    kind, normal = facets.slab[q], facets.face[q, :3]
    if dot(normal, k_in) * dot(normal, leaves) >= 0.0:
        return False
    root = math.sqrt(solid * pattern(roughness, kind, normal, k_in, leaves))
    kept, changed = root * roughness.amplitude[kind, 0], root * roughness.amplitude[kind, 1]
    for f in range(gain.shape[1]):
        a, b = kept * field[0, f] - changed * field[2, f], kept * field[1, f] - changed * field[3, f]
        c, d = changed * field[0, f] + kept * field[2, f], changed * field[1, f] + kept * field[3, f]
        u, v_, s, t = response[0, f], response[1, f], response[2, f], response[3, f]
        gain[0, f] = a * u - b * v_ + c * s - d * t
        gain[1, f] = a * v_ + b * u + c * t + d * s
    return True


@entry
def find_views(facets: Facets, windows: Windows, tiles: Tiles, end: F64, max_depth: int, num_mirrors: int) -> Bools:
    """Whether `end` (3,) sees each tile directly, or over each plane, with at most so many mirrors: (N, 1 + P).

    Of tiles that lie on each other those of the first facet are seen.
    """
    num_planes = len(windows.axis) if num_mirrors else 0
    seen, walk = np.zeros((len(tiles.facet), 1 + num_planes), np.bool_), new_walk(max_depth, 1, 1, end)
    for n in range(len(tiles.facet)):
        q = walk.mirrors[0, 0] = tiles.facet[n]
        if facets.plane[q] < len(windows.axis):
            walk.edge[0, 0], walk.vertex[0, 1], walk.plane[0] = FAR, tiles.middle[n], facets.plane[q]
            gather_mirrors(facets, Path(1, walk.plane, walk.image, walk.mirror), LONE, walk)
        if walk.mirrors[0, 0] == q:
            for p in range(-1, num_planes):
                seen[n, p + 1] = _reach(facets, windows, tiles, n, p, end, 0.0, max_depth - 1, walk) >= 0
    return seen


@entry
def responses(
    facets: Facets, media: Media, windows: Windows, tiles: Tiles, tile: I64, plane: I64, end: F64, max_depth: int
) -> tuple[I64, F64, F64, F64]:
    """`num_met` to `response` of the views of tiles over planes, both (V,), by an array with its centre at `end`."""
    num_views, num_carriers = len(tile), media.permittivity.shape[0]
    num_met, leaves, source = np.zeros(num_views, np.int64), np.zeros((num_views, 3)), np.zeros((num_views, 3))
    response, walk = np.zeros((num_views, 4, num_carriers)), new_walk(max_depth, 1, 1, end)
    wave = walk.wave
    for v in range(num_views):
        num_met[v] = _reach(facets, windows, tiles, tile[v], plane[v], end, 0.0, max_depth - 1, walk)
        has_mirror = 1 if plane[v] >= 0 else 0
        for a in range(3):  # the centre of the array is its own image
            for b in range(3):
                source[v, a] += walk.mirror[b, a] * (walk.start[0, b] - walk.image[b])
        share = specular_share(facets, media, has_mirror, walk)
        for first in range(0, num_carriers, BLOCK):
            number = _bring(facets, media, 1, has_mirror, first, walk)
            for c in range(3):
                leaves[v, c] = -wave[c * BLOCK]
            _resolve(wave, leaves[v, 0], leaves[v, 1], leaves[v, 2], share, first, number, response[v])
    return num_met, leaves, source, response


@entry
def add_diffuse(
    scene: SceneArrays, context: DiffuseContext, tx: F64, max_depth: int, num_mirrors: int, sums: Sums, num_paths: I32
) -> None:
    """Add to `sums` (F, M) what tiles scatter from `tx` (3,) to the array over so many mirrors in all, and count it.

    A tile and what it is seen through are those of the array's centre; each element has its own distance to it.
    """
    (real, imag), aperture, facets, tiles, views = sums, scene.aperture, context.facets, context.tiles, context.views
    num_carriers, num_elements = real.shape
    wavelength_m, num_planes = aperture.wavelength_m, len(context.windows.axis) if num_mirrors else 0
    walk, k_in, field = new_walk(max_depth, 1, num_elements, tx), np.zeros(3), np.zeros((4, num_carriers))
    gain, own = np.zeros((2, num_carriers)), walk.own
    both, is_heard = np.zeros((1 + num_planes, 2, num_carriers)), np.zeros(1 + num_planes, np.bool_)
    for n in range(len(tiles.facet)):
        begin, end = views.first[n], views.first[n + 1]
        is_heard[:] = False
        for p in range(-1, num_planes):
            if begin == end or (p >= 0 and views.plane[begin] >= 0):
                break
            if p < 0 and num_mirrors and views.plane[end - 1] < 0:
                continue
            side = dot(facets.face[tiles.facet[n], :3], views.leaves[begin]) if (p >= 0) == num_mirrors else 0.0
            num_met, solid = _light(context, n, p, tx, side, max_depth - 1, walk, k_in, field)
            if num_met < 0:
                continue
            distance = 0.0
            for c in range(3):
                distance += (walk.start[0, c] - walk.image[c]) ** 2
            distance = math.sqrt(distance)
            for v in range(begin, end):
                if (p >= 0) + (views.plane[v] >= 0) != num_mirrors or num_met + 1 + views.num_met[v] > max_depth:
                    continue
                if not _scatter(context, n, v, solid, k_in, field, gain):
                    continue
                i = v - begin
                if not is_heard[i]:
                    is_heard[i], both[i] = True, 0.0
                for f in range(num_carriers):
                    cosine, sine = cosine_and_sine(distance / wavelength_m[f] + tiles.turns[n])
                    both[i, 0, f] += gain[0, f] * cosine + gain[1, f] * sine
                    both[i, 1, f] += gain[1, f] * cosine - gain[0, f] * sine
                    num_paths[f] += gain[0, f] != 0.0 or gain[1, f] != 0.0
        for v in range(begin, end):
            if is_heard[v - begin]:
                x, y, z = views.source[v, 0], views.source[v, 1], views.source[v, 2]
                for f in range(num_carriers):
                    for e in range(num_elements):
                        own[0, e], own[1, e] = both[v - begin, 0, f], both[v - begin, 1, f]
                    spread(own, (x * x + y * y + z * z, x, y, z), aperture.element_m[f], wavelength_m[f])
                    for e in range(num_elements):
                        real[f, e] += own[0, e]
                        imag[f, e] += own[1, e]


@entry
def diffuse_paths(
    context: DiffuseContext, surface: I64, tx: F64, receiver: F64, max_depth: int, num_mirrors: int
) -> list[CentrePath]:
    """The paths that `add_diffuse` adds, to the array's centre at `receiver` (3,), with their random phases.

    `surface` is the mesh of each facet. Their gains lack the spreading of as long a straight line, as those of others.
    """
    facets, media, _, windows, tiles, views = context
    num_carriers, reached = media.permittivity.shape[0], []
    num_planes = len(windows.axis) if num_mirrors else 0
    near, far = new_walk(max_depth, 1, 1, tx), new_walk(max_depth, 1, 1, tx)
    k_in, field, gain = np.zeros(3), np.zeros((4, num_carriers)), np.zeros((2, num_carriers))
    for n in range(len(tiles.facet)):
        for p in range(-1, num_planes):
            if views.first[n] == views.first[n + 1]:
                break
            num_met, solid = _light(context, n, p, tx, 0.0, max_depth - 1, near, k_in, field)
            if num_met < 0:
                continue
            for v in range(views.first[n], views.first[n + 1]):
                if (p >= 0) + (views.plane[v] >= 0) != num_mirrors or num_met + 1 + views.num_met[v] > max_depth:
                    continue
                if not _scatter(context, n, v, solid, k_in, field, gain):
                    continue
                _reach(facets, windows, tiles, n, views.plane[v], receiver, 0.0, max_depth - 1, far)
                code, met, point = (
                    np.zeros(max_depth, np.int64),
                    np.full(max_depth, -1),
                    np.full((max_depth, 3), np.nan),
                )
                at = list_interactions(near, 1 if p >= 0 else 0, True, 0, surface, code, met, point)
                code[at], met[at], point[at] = DIFFUSE, surface[tiles.facet[n]], tiles.middle[n]
                list_interactions(far, 1 if views.plane[v] >= 0 else 0, False, at + 1, surface, code, met, point)
                after = np.linalg.norm(views.source[v])
                length = float(np.linalg.norm(near.start[0] - near.image) + after)
                cosine, sine = cosine_and_sine(tiles.turns[n])
                scale = length / after * complex(cosine, -sine)
                reached.append((scale * (gain[0] + 1j * gain[1]), length, views.source[v] / after, code, met, point))
    return reached
