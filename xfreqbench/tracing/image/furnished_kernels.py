"""Compiled kernels of the image method among many facets, of which few mirror: `bundle_kernels`, `trie_kernels`.

Numba's cache notices changes of this file alone. So what is called from outside is made by `_compiled`, whose argument
is a hash of the other files of kernels, and a part of the cache's key.
"""

from __future__ import annotations

import hashlib
import pathlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import get_num_threads, njit
from numpy.typing import NDArray

from xfreqbench.tracing.image import box_tree, box_tree_kernels, bundle_kernels, kernels, trie_kernels
from xfreqbench.tracing.image.box_tree import BoxTree
from xfreqbench.tracing.image.box_tree_kernels import Walk, new_walk, whole
from xfreqbench.tracing.image.bundle_kernels import QUAD, decide, fold, gather_mirrors, gather_slabs, reaches
from xfreqbench.tracing.image.kernels import (
    CORNERS,
    EVERYWHERE,
    LONE,
    MIXED,
    NOWHERE,
    NUM_CHUNKS,
    Aperture,
    Facets,
    Image,
    Media,
    Path,
)
from xfreqbench.tracing.image.trie_kernels import Shots, Trie, candidates_of, joined_keys, line_of, shot_by

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@whole
def _add_to_some(
    facets: Facets,
    tree: BoxTree,
    media: Media,
    element_m: F64,
    quads: I64,
    path: Path,
    f: int,
    spread: tuple[Image, float],
    are_gathered: tuple[bool, bool],
    walk: Walk,
    sums: tuple[F64, F64],
) -> bool:
    """Add a path at carrier f to those of the elements (M, 3) that it reaches; False where it is heard at none.

    It is decided for each of the `quads` (B, 4) of neighbours at once, where they agree. `are_gathered` says whether
    the mirrors and the slabs that the path may meet on its way to any of the elements were gathered.
    """
    (has_mirrors, has_slabs), (image, wavelength_m), (real, imag) = are_gathered, spread, sums
    four, one, is_heard = np.empty((4, 3)), np.ones((1, 1)), False
    for quad in quads:
        for k in range(4):
            four[k] = element_m[quad[k]]
        reach, is_gathered = MIXED, has_slabs
        if quad[0] < quad[3]:  # else it is a single element
            reach = fold(facets, path, four, QUAD, walk)
        if reach == EVERYWHERE and not has_mirrors:
            reach = gather_mirrors(tree, path, QUAD, walk)
        if reach == EVERYWHERE and not has_slabs:
            reach = gather_slabs(facets, tree, path, QUAD, walk)
            is_gathered = reach == EVERYWHERE
        if reach == EVERYWHERE:
            reach = decide(facets, tree, path, QUAD, walk)
        if reach == NOWHERE:
            continue
        last = -1
        for e in quad:
            if e <= last:  # there again, at the rim of an odd number of elements
                continue
            last = e
            own = element_m[e : e + 1]
            if reach == MIXED and is_gathered:
                if fold(facets, path, own, LONE, walk) != EVERYWHERE:
                    continue
                if decide(facets, tree, path, LONE, walk) != EVERYWHERE:
                    continue
            elif reach == MIXED and not reaches(facets, tree, path, own, has_mirrors, walk):
                continue
            gain = kernels.gains(facets, media, path, own, f, walk.scratch)
            kernels._spread(gain, one, image, own, wavelength_m, (real[e : e + 1], imag[e : e + 1]))
            is_heard |= gain[0] != 0
    return is_heard


@whole
def _add_path(
    facets: Facets,
    tree: BoxTree,
    media: Media,
    aperture: Aperture,
    quads: I64,
    path: Path,
    share: bool,
    walk: Walk,
    sums: tuple[F64, F64],
    num_paths: NDArray[np.int32],
) -> None:
    """Add a path to `sums` (F, M) each, as `kernels._add_path` does."""
    (real, imag), reach, scratch = sums, MIXED, walk.scratch
    distance2, toward = 0.0, np.zeros(3)  # transmitter − image of the array centre, in the elements' axes
    for a in range(3):
        gap = scratch.tx[a] - path.image[a]
        distance2 += gap * gap
        for b in range(3):
            toward[b] += gap * path.mirror[a, b]
    image = (distance2, toward)
    has_slabs = has_mirrors = False
    for f in range(num_paths.shape[0]):
        element_m, wavelength_m = aperture.element_m[f], aperture.wavelength_m[f]
        if share and reach == MIXED:
            folded = fold(facets, path, aperture.corner_m[f], CORNERS, walk)
            if folded == EVERYWHERE and not has_slabs:
                folded = gather_mirrors(tree, path, CORNERS, walk)
                has_mirrors = folded == EVERYWHERE
                if has_mirrors:
                    folded = gather_slabs(facets, tree, path, CORNERS, walk)
                    has_slabs = folded == EVERYWHERE
            reach = decide(facets, tree, path, CORNERS, walk) if folded == EVERYWHERE else folded
        if reach == NOWHERE:
            break
        if reach == EVERYWHERE:
            gain = kernels.gains(facets, media, path, aperture.node_m[f], f, scratch)
            kernels._spread(gain, aperture.weight, image, element_m, wavelength_m, (real[f], imag[f]))
            num_paths[f] += bool(np.any(gain != 0))
        else:
            own_sums, spread, are_gathered = (
                (real[f], imag[f]),
                (image, wavelength_m),
                (has_mirrors, has_slabs),
            )
            num_paths[f] += _add_to_some(
                facets, tree, media, element_m, quads, path, f, spread, are_gathered, walk, own_sums
            )


def _compiled(version: int) -> tuple[Any, ...]:
    """Kernels that are called from outside; another version compiles them anew."""

    @njit(cache=True, nogil=True)
    def shot(facets: Facets, tree: BoxTree, shots: Shots, chunk: int) -> I64:
        """Keys of the nodes that one of the `NUM_CHUNKS` chunks of the rays from one of the origins finds.

        A key is parent · P + plane, where the parent is the place of another key before it; the first is the root.
        """
        return shot_by(facets, tree, shots, chunk) if version >= 0 else np.zeros(0, np.int64)

    @njit(cache=True, nogil=True)
    def joined(keys: I64, num_planes: int) -> I64:
        """Keys of the nodes of several tries as one."""
        return joined_keys(keys, num_planes) if version >= 0 else np.zeros(0, np.int64)

    @njit(cache=True, nogil=True)
    def add_channel(
        facets: Facets,
        tree: BoxTree,
        media: Media,
        trie: Trie,
        aperture: Aperture,
        quads: I64,
        tx: F64,
        max_depth: int,
        share: bool,
        sums: tuple[F64, F64],
        num_paths: NDArray[np.int32],
    ) -> None:
        """Add the channel (F, M) of the transmitter at `tx` (3,) to `sums`, real and imaginary, and count its paths."""
        walk = new_walk(max_depth, aperture.node_m.shape[1], tx)
        found = np.empty(len(trie.parent), np.int64)
        for c in range(candidates_of(trie, tx, found) if version >= 0 else 0):
            path = line_of(facets, trie, found[c], walk)
            _add_path(facets, tree, media, aperture, quads, path, share, walk, sums, num_paths)

    @njit(cache=True)
    def reaching(
        facets: Facets, tree: BoxTree, media: Media, trie: Trie, tx: F64, max_depth: int
    ) -> list[tuple[int, NDArray[np.complex128], Walk]]:
        """Nodes whose path reaches the array centre from `tx` (3,), with its gain (F,), and how it runs."""
        centre, found = np.zeros((1, 3)), np.empty(len(trie.parent), np.int64)
        reached = []
        for c in range(candidates_of(trie, tx, found) if version >= 0 else 0):
            walk = new_walk(max_depth, 1, tx)
            path = line_of(facets, trie, found[c], walk)
            if reaches(facets, tree, path, centre, False, walk):
                gain = np.zeros(media.permittivity.shape[0], np.complex128)
                for f in range(len(gain)):
                    gain[f] = kernels.gains(facets, media, path, centre, f, walk.scratch)[0]
                reached.append((found[c], gain, walk))
        return reached

    return shot, joined, add_channel, reaching


_MODULES = (kernels, box_tree, box_tree_kernels, bundle_kernels, trie_kernels)
_FILES = (str(module.__file__) for module in _MODULES)
_SHA256 = hashlib.sha256(b"".join(pathlib.Path(file).read_bytes() for file in _FILES))
shot, joined, add_channel, reaching = _compiled(int.from_bytes(_SHA256.digest()[:7], "big"))


def launch(facets: Facets, tree: BoxTree, shots: Shots) -> I64:
    """Keys of the nodes that a Fibonacci sphere of branching rays from each origin finds, as `shot` returns them."""
    with ThreadPoolExecutor(get_num_threads()) as threads:
        chunks = range(NUM_CHUNKS * len(shots.origin_m))
        found = list(threads.map(lambda chunk: shot(facets, tree, shots, chunk), chunks))
    keys: I64 = joined(np.concatenate(found), shots.num_planes)
    return keys


def channels(
    facets: Facets,
    tree: BoxTree,
    media: Media,
    trie: Trie,
    aperture: Aperture,
    quads: I64,
    tx_position_m: F64,
    max_depth: int,
    share: bool,
) -> tuple[F64, F64, NDArray[np.int32]]:
    """Channels (T, F, M), real and imaginary, and path counts (T, F), as `kernels.channels` returns them."""
    shape = len(tx_position_m), aperture.element_m.shape[0], aperture.element_m.shape[1]
    real, imag, num_paths = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2], np.int32)

    def add(i: int) -> None:
        sums, tx = (real[i], imag[i]), tx_position_m[i]
        add_channel(facets, tree, media, trie, aperture, quads, tx, max_depth, share, sums, num_paths[i])

    with ThreadPoolExecutor(get_num_threads()) as threads:
        list(threads.map(add, range(len(tx_position_m))))
    return real, imag, num_paths
