"""Kernels of the sequences of mirror planes: which of them rays find, and which a transmitter may have.

Sequences are the nodes of a trie: a node is a sequence of mirror planes from the receiver on. It knows the image of
the array centre behind these planes, and the part of its last plane that the image shines on through the mirrors
before it. So most nodes are turned down for a transmitter by one test.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .arrays import F64, FAR, I16, I64, NUM_CHUNKS, Facets, Walk, new_walk
from .compiled import bare, entry, part, whole
from .tree import first_hit


class Shots(NamedTuple):
    """How `launch` shoots its rays, from each of O origins."""

    origin_m: F64  # (O, 3)
    turn_rad: F64  # (O,) of the sphere of rays about the vertical
    num_rays: int
    max_depth: int
    num_planes: int  # that mirror; facets of later planes do not


class Trie(NamedTuple):
    """Sequences of mirror planes, sorted by their last plane; the first is the empty one. (N nodes, P planes)"""

    parent: I64  # (N,)
    plane: I64  # (N,): the last plane, or −1
    length: I64  # (N,)
    image_m: F64  # (N, 3) of the array centre
    place_m: F64  # (N, 8): image along its plane's axes u, v, n; lowest and highest u and v that it shines on; how far
    # images of elements are from that of the array centre along n
    first: I64  # (P + 1,): nodes that end at plane p are first[p]:first[p + 1]
    axis: F64  # (P, 3, 3): u, v and n of each plane
    offset_m: F64  # (P,)
    radius_m: float  # of the widest aperture


@whole
def _follow(facets: Facets, shots: Shots, ray: F64, state: I64, walk: Walk, trie: Any) -> None:
    """Follow the ray on the bottom of the stack, and all that branch off it, and put its sequences in `trie`.

    A ray that meets a facet branches into a reflected and a transmitted one.

    The stack holds origin and direction of each `ray` (S, 2, 3), and as its `state` (S, 2) a node of the trie and
    the number of interactions. `trie` maps parent · P + plane to a node's number.
    """
    num_rays = 1
    while num_rays > 0:
        top = num_rays - 1
        o, d = ray[top, 0], ray[top, 1]
        q, t = first_hit(facets, o, d, walk)
        num_rays = top
        if q < 0:
            continue
        p, state[top, 1] = facets.plane[q], state[top, 1] + 1
        child = np.int64(0)
        if p < shots.num_planes:
            key = state[top, 0] * shots.num_planes + p
            child = trie.get(key, np.int64(len(trie)))
            trie[key] = child
        if state[top, 1] >= shots.max_depth:
            continue
        speed = 0.0
        for c in range(3):
            o[c] += t * d[c]
            speed += facets.normal[c, p] * d[c]
        if not facets.is_opaque[q]:
            num_rays += 1  # the transmitted ray stays where it is
        if p < shots.num_planes:
            for c in range(3):
                ray[num_rays, 0, c] = o[c]
                ray[num_rays, 1, c] = d[c] - 2.0 * speed * facets.normal[c, p]
            state[num_rays, 0], state[num_rays, 1] = child, state[top, 1]
            num_rays += 1


@whole
def _keys_of(trie: Any) -> I64:
    """Keys of a trie's nodes, in the order of their numbers."""
    keys = np.empty(len(trie), np.int64)
    for key, node in trie.items():
        keys[node] = key
    return keys


@entry
def shot(facets: Facets, shots: Shots, chunk: int) -> I64:
    """Keys of the nodes that one of the `NUM_CHUNKS` chunks of the rays from one of the origins finds.

    A key is parent · P + plane, where the parent is the place of another key before it; the first is the root.
    """
    origin, first = chunk // NUM_CHUNKS, chunk % NUM_CHUNKS
    ray, state = np.zeros((shots.max_depth + 2, 2, 3)), np.zeros((shots.max_depth + 2, 2), np.int64)
    walk, trie = new_walk(1, 1, 1, ray[0, 0]), {np.int64(-1): np.int64(0)}
    for index in range(first, shots.num_rays, NUM_CHUNKS):
        z = 1.0 - 2.0 * (index + 0.5) / shots.num_rays
        horizontal = math.sqrt(1.0 - z * z)
        azimuth = (index * 2.399963229728653 + shots.turn_rad[origin]) % (2.0 * math.pi)  # the golden angle
        ray[0, 0] = shots.origin_m[origin]
        ray[0, 1, 0], ray[0, 1, 1] = horizontal * math.cos(azimuth), horizontal * math.sin(azimuth)
        ray[0, 1, 2] = z
        state[0] = 0
        _follow(facets, shots, ray, state, walk, trie)
    return _keys_of(trie)


@entry
def joined(keys: I64, num_planes: int, most: int) -> I64:
    """Keys of the nodes of several tries as one: theirs one after another, each beginning with its root, −1.

    Sequences of more than `most` planes are left out.
    """
    trie, node, first = {np.int64(-1): np.int64(0)}, np.zeros(len(keys), np.int64), 0
    length = np.zeros(len(keys), np.int64)
    for k in range(len(keys)):
        if keys[k] < 0:
            first = k
            continue
        parent = first + keys[k] // num_planes
        length[k] = length[parent] + 1
        if length[k] > most:
            continue
        key = node[parent] * num_planes + keys[k] % num_planes
        node[k] = trie.get(key, np.int64(len(trie)))
        trie[key] = node[k]
    return _keys_of(trie)


@part
def _passes(
    place: F64, node: int, u: float, v: float, here: float, radius_m: float, total: float, margin: float
) -> tuple[float, float, float]:
    """Where the line from a point (u, v, here) to a node's image meets the node's plane; its margin, or −1.

    The margin is how far the path to an element within `radius_m` of the array centre may be from there; it is −1
    where no such path meets the part of the plane that the image shines on, and `FAR` where some elements' paths may
    begin, or end, on the other side of the plane than others'. `total` is the length of the path to the centre, 0
    where it begins at the point. An element's path meets a plane at D from the image at the share
    f·D / (D − (1 − f)·radius) of its length at most, where f is the share for the array centre.
    """
    there, extent, away = place[node, 2], place[node, 7], abs(place[node, 2])
    if away <= 2.0 * extent or abs(here) <= margin:
        return u, v, FAR
    if here * there >= 0.0:
        return u, v, -1.0
    du, dv, t = place[node, 0] - u, place[node, 1] - v, here / (here - there)
    left = math.sqrt(du * du + dv * dv + (here - there) ** 2)
    u, v = u + t * du, v + t * dv
    whole = total if total > 0.0 else left
    rest = (1.0 - t) * left / whole
    most = (1.0 - rest) * away / (away - rest * extent)
    along = math.sqrt(max(0.0, whole * whole - (away / rest) ** 2))
    margin = (most - 1.0 + rest) * along + most * radius_m + 1e-6
    if u < place[node, 3] - margin or u > place[node, 4] + margin:
        return u, v, -1.0
    if v < place[node, 5] - margin or v > place[node, 6] + margin:
        return u, v, -1.0
    return u, v, margin


@part
def _passes_roughly(
    place: F64, node: int, u: float, v: float, here: float, radius_m: float, margin: float
) -> tuple[float, float, float]:
    """As `_passes`, for lines from within a margin of the point, whichever side of the node's plane they begin on.

    The share t = a / (a + b) of a line before the plane lies between the two that its distances a and b from its
    start and its end allow. At the share t all lines are within the margin, or the radius, of the one at hand.
    """
    there, extent, low, high = place[node, 2], place[node, 7], 1.0, 0.0
    for side in (1.0, -1.0):
        most_here, most_there = margin + side * here, extent - side * there
        if most_here > 0.0 and most_there > 0.0:
            least_here, least_there = max(0.0, side * here - margin), max(0.0, -side * there - extent)
            low = min(low, least_here / (least_here + most_there))
            high = max(high, most_here / (most_here + least_there))
    if low > high:
        return u, v, -1.0
    du, dv, margin = place[node, 0] - u, place[node, 1] - v, max(margin, radius_m) + 1e-6
    low_u, high_u, low_v, high_v = low * du, high * du, low * dv, high * dv
    if u + max(low_u, high_u) < place[node, 3] - margin or u + min(low_u, high_u) > place[node, 4] + margin:
        return u, v, -1.0
    if v + max(low_v, high_v) < place[node, 5] - margin or v + min(low_v, high_v) > place[node, 6] + margin:
        return u, v, -1.0
    middle = 0.5 * (low + high)
    margin += 0.5 * (high - low) * math.sqrt(du * du + dv * dv)
    return u + middle * du, v + middle * dv, margin


@part
def _may_reach(trie: Trie, node: int, tx: F64) -> bool:
    """Whether any element could see the path of a node, walls on the way aside; never wrongly no."""
    x, y, z, margin, is_rough = tx[0], tx[1], tx[2], 0.0, False
    image = trie.image_m[node]
    total = math.sqrt((image[0] - x) ** 2 + (image[1] - y) ** 2 + (image[2] - z) ** 2)
    while node > 0:
        axis = trie.axis[trie.plane[node]]
        u = axis[0, 0] * x + axis[0, 1] * y + axis[0, 2] * z
        v = axis[1, 0] * x + axis[1, 1] * y + axis[1, 2] * z
        w = axis[2, 0] * x + axis[2, 1] * y + axis[2, 2] * z
        offset, before = trie.offset_m[trie.plane[node]], margin
        if not is_rough:
            u, v, margin = _passes(trie.place_m, node, u, v, w - offset, trie.radius_m, total, before)
            is_rough = margin == FAR
        if is_rough:
            u, v, margin = _passes_roughly(trie.place_m, node, u, v, w - offset, trie.radius_m, before)
        if margin < 0.0:
            return False
        x = axis[0, 0] * u + axis[1, 0] * v + axis[2, 0] * offset
        y = axis[0, 1] * u + axis[1, 1] * v + axis[2, 1] * offset
        z = axis[0, 2] * u + axis[1, 2] * v + axis[2, 2] * offset
        node = trie.parent[node]
    return True


@bare
def candidates_of(trie: Trie, tx: F64, found: I64) -> int:
    """Put the nodes that may reach an element from the transmitter into `found` (N,); returns their number."""
    found[0], number = 0, 1
    for p in range(len(trie.offset_m)):
        axis = trie.axis[p]
        u = axis[0, 0] * tx[0] + axis[0, 1] * tx[1] + axis[0, 2] * tx[2]
        v = axis[1, 0] * tx[0] + axis[1, 1] * tx[1] + axis[1, 2] * tx[2]
        here = axis[2, 0] * tx[0] + axis[2, 1] * tx[1] + axis[2, 2] * tx[2] - trie.offset_m[p]
        for node in range(trie.first[p], trie.first[p + 1]):
            if _passes(trie.place_m, node, u, v, here, trie.radius_m, 0.0, 0.0)[2] >= 0.0:
                found[number] = node
                number += 1
    kept = 1
    for c in range(1, number):
        found[kept] = found[c]
        kept += _may_reach(trie, found[c], tx)
    return kept


@bare
def mirrored_offsets(facets: Facets, plane: I16, length: int, mirror: F64) -> None:
    """Write to `mirror` (3, 3) what so many planes, one after another, make of an offset."""
    normal = facets.normal
    for a in range(3):
        for b in range(3):
            mirror[a, b] = 1.0 if a == b else 0.0
    for step in range(length):
        p = plane[step]
        for b in range(3):
            along = normal[0, p] * mirror[0, b] + normal[1, p] * mirror[1, b] + normal[2, p] * mirror[2, b]
            for a in range(3):
                mirror[a, b] -= 2.0 * along * normal[a, p]


@bare
def line_of(facets: Facets, trie: Trie, node: int, walk: Walk) -> int:
    """Write the path of a node to `walk`: its planes from the receiver on, its image, what they make of an offset.

    Returned is the number of planes. The path may cross as many slabs as it may have interactions besides.
    """
    length, at = trie.length[node], node
    for step in range(length - 1, -1, -1):
        walk.plane[step], at = trie.plane[at], trie.parent[at]
    for a in range(3):
        walk.image[a] = trie.image_m[node, a]
    mirrored_offsets(facets, walk.plane, length, walk.mirror)
    walk.limit[0] = len(walk.hit) - 1 - length
    return length
