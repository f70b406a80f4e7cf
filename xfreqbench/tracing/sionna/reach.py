"""Which chains may reach some element of an array: a test in double precision that drops none that does.

A path to an element off the array's centre runs beside the path to the centre. Unfolded at its mirrors, both are
straight lines from the transmitter to images of the receiver, which lie as far apart as the element from the centre.
Where the path to the centre meets a mirror, the other meets it no farther away than that distance, times the share of
the path travelled so far, over the cosine of incidence. A chain is dropped where this disc lies outside the bounding
box of the mirror's triangles, or where transmitter and image lie on one side of the mirror. What is kept is solved at
every element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.tracing.paths import SPECULAR
from xfreqbench.tracing.sionna.chains import Chains, Planes
from xfreqbench.types import FloatArray, IntArray, NDArray

NEAR = 6.0  # times the array's radius: nearer images are kept, for the disc is no longer a disc
_SLACK_M = 1e-3  # of vertices that are stored in single precision


@dataclass(frozen=True)
class PlaneBoxes:
    """The bounding box of the triangles in each of P planes, along two axes in the plane."""

    axis: Float[FloatArray, "P 2 3"]
    low_m: Float[FloatArray, "P 2"]
    high_m: Float[FloatArray, "P 2"]

    @classmethod
    def of(cls, planes: Planes, corners_m: Float[FloatArray, "K 3 3"]) -> PlaneBoxes:
        """Boxes of the planes of K triangles; the first axis runs along an edge of the largest triangle of each."""
        num_planes = int(planes.index.max(initial=-1)) + 1
        edge_m = corners_m[:, 1] - corners_m[:, 0]
        area_m2 = np.linalg.norm(np.cross(edge_m, corners_m[:, 2] - corners_m[:, 0]), axis=1)
        largest = np.zeros(num_planes, dtype=np.int64)
        by_area = np.argsort(area_m2, kind="stable")
        largest[planes.index[by_area]] = by_area
        along = edge_m[largest] / np.linalg.norm(edge_m[largest], axis=1, keepdims=True)
        axis = np.stack([along, np.cross(planes.normal[largest], along)], axis=1)
        place_m = np.einsum("kcx,kax->kca", corners_m, axis[planes.index])
        low_m, high_m = np.full((num_planes, 2), np.inf), np.full((num_planes, 2), -np.inf)
        np.minimum.at(low_m, planes.index, place_m.min(axis=1))
        np.maximum.at(high_m, planes.index, place_m.max(axis=1))
        return cls(axis, low_m, high_m)

    def are_near(
        self, plane: Int[IntArray, "C"], point_m: Float[FloatArray, "C 3"], distance_m: Float[FloatArray, "C"]
    ) -> Bool[NDArray[np.bool_], "C"]:
        """Whether each point of a plane is within a distance of the plane's box."""
        place_m = np.einsum("cx,cax->ca", point_m, self.axis[plane])
        beyond_m = np.maximum(self.low_m[plane] - place_m, place_m - self.high_m[plane])
        return (beyond_m <= distance_m[:, None]).all(axis=1)


@dataclass(frozen=True)
class Reach:
    """The test for one receiver: `radius_m` is how far its elements lie from `centre_m`, at any carrier."""

    chains: Chains
    planes: Planes
    boxes: PlaneBoxes
    centre_m: Float[FloatArray, "3"]
    radius_m: float

    def may_reach(
        self, tx_position_m: Float[FloatArray, "C 3"], chain: Int[IntArray, "C"]
    ) -> Bool[NDArray[np.bool_], "C"]:
        """Whether a path from each transmitter along its chain may reach some element, walls on the way aside."""
        image_m = self._images_m(chain)
        total_m = np.linalg.norm(image_m[-1] - tx_position_m, axis=1)
        point_m, margin_m = tx_position_m.copy(), np.zeros(len(chain))
        kept, undecided = np.ones(len(chain), dtype=bool), np.zeros(len(chain), dtype=bool)
        for depth in range(len(image_m) - 2, -1, -1):
            rows = np.flatnonzero(kept & ~undecided & (self.chains.interaction[chain, depth] == SPECULAR))
            triangle = self.chains.triangle[chain[rows], depth]
            normal, offset_m = self.planes.normal[triangle], self.planes.offset_m[triangle]
            ahead_m = image_m[depth + 1][rows] - point_m[rows]
            here = np.einsum("cx,cx->c", normal, point_m[rows]) - offset_m
            there = np.einsum("cx,cx->c", normal, image_m[depth + 1][rows]) - offset_m
            is_near = (np.abs(there) <= NEAR * self.radius_m) | (np.abs(here) <= margin_m[rows] + _SLACK_M)
            undecided[rows[is_near]] = True
            kept[rows[~is_near & (here * there >= 0)]] = False
            crossing = np.flatnonzero(~is_near & (here * there < 0))
            rows, here, there, ahead_m = rows[crossing], here[crossing], there[crossing], ahead_m[crossing]
            share = here / (here - there)
            left_m = np.linalg.norm(ahead_m, axis=1)
            cosine = np.abs(here - there) / left_m
            travelled = 1 - (1 - share) * left_m / total_m[rows]
            point_m[rows] += share[:, None] * ahead_m
            second_order = 1 / (1 - 1 / NEAR)  # how much wider the disc may be than to first order
            margin_m[rows] = second_order * self.radius_m * travelled / cosine + _SLACK_M
            plane = self.planes.index[triangle[crossing]]
            kept[rows[~self.boxes.are_near(plane, point_m[rows], margin_m[rows])]] = False
        return kept

    def _images_m(self, chain: Int[IntArray, "C"]) -> list[Float[FloatArray, "C 3"]]:
        """Images of the centre, in none of the mirrors, in the one nearest to it, and so on."""
        images_m = [np.tile(self.centre_m, (len(chain), 1))]
        for depth in range(self.chains.interaction.shape[1]):
            image_m = images_m[-1].copy()
            rows = np.flatnonzero(self.chains.interaction[chain, depth] == SPECULAR)
            triangle = self.chains.triangle[chain[rows], depth]
            image_m[rows] = self.planes.mirrored(triangle, image_m[rows])
            images_m.append(image_m)
        return images_m
