"""The true paths of a transmitter, and which of them reflect at found planes alone.

A reflection counts as found where a plane of the findings runs through its point, is parallel to the surface there,
and holds something.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from xfreqbench.tracing.paths import DIFFRACTION, REFRACTION, SPECULAR, Paths
from xfreqbench.types import FloatArray

from ..search.planes import Vector
from ..stored import FoundPlane, StoredFindings

FOUND_DISTANCE_M = 0.005  # added to three standard deviations of the plane's distance
FOUND_TILT_RAD = 0.002
HELD_MARGIN_M = 0.3  # one cell: what a plane holds is not known more finely
_ORDERS = (0, 1, 2, 3)


@dataclass(frozen=True, eq=False)
class PathKinds:
    """What each of P paths meets; `is_found` where all reflections of a path are found."""

    num_reflections: Int[NDArray[np.int64], "P"]
    num_transmissions: Int[NDArray[np.int64], "P"]
    is_diffracted: Bool[NDArray[np.bool_], "P"]
    is_found: Bool[NDArray[np.bool_], "P"]


class Selection(NamedTuple):
    """A rule that keeps some of the true paths; `max_reflections` None keeps any number of reflections."""

    in_found_planes: bool = False
    max_reflections: int | None = None
    transmissions: bool = True
    edges: bool = False

    @property
    def label(self) -> str:
        """The rule in words, as in `true paths, found planes, 1 reflection at most`."""
        where = "found planes" if self.in_found_planes else "every plane"
        where += " and edge" if self.edges else ""
        through = "" if self.transmissions else ", no transmissions"
        bound = ""
        if self.max_reflections is not None:
            number = f"{self.max_reflections} reflection{'' if self.max_reflections == 1 else 's'} at most"
            bound = f", {number}" if self.max_reflections else ", no reflections"
        return f"true paths, {where}{bound}{through}"

    def keeps(self, kinds: PathKinds) -> Bool[NDArray[np.bool_], "P"]:
        """Whether each path is kept."""
        kept = kinds.is_found | (not self.in_found_planes)
        if self.max_reflections is not None:
            kept &= kinds.num_reflections <= self.max_reflections
        kept &= self.edges | ~kinds.is_diffracted
        return kept & (self.transmissions | (kinds.num_transmissions == 0))


SELECTIONS = (
    Selection(edges=True),
    Selection(),
    *(Selection(True, order) for order in (*_ORDERS, None)),
    *(Selection(True, order, False) for order in (*_ORDERS, None)),
    *(Selection(False, order) for order in _ORDERS),
)


def path_kinds(paths: Paths, tx_position_m: Vector, findings: StoredFindings) -> PathKinds:
    """What the paths of one transmitter meet, and which of them reflect at found planes alone."""
    point_m, normal, is_reflection = _reflections(paths, tx_position_m, findings.array_m)
    is_found = np.zeros_like(is_reflection)
    for plane in findings.planes:
        is_found |= _is_on(plane, point_m, normal, findings.array_m)
    return PathKinds(
        (paths.interactions == SPECULAR).sum(axis=1),
        (paths.interactions == REFRACTION).sum(axis=1),
        (paths.interactions == DIFFRACTION).any(axis=1),
        np.asarray((is_found | ~is_reflection).all(axis=1)),
    )


def _reflections(
    paths: Paths, tx_position_m: Vector, array_m: Vector
) -> tuple[Float[FloatArray, "P D 3"], Float[FloatArray, "P D 3"], Bool[NDArray[np.bool_], "P D"]]:
    """Points where paths reflect, the unit normals there, and which of the D places are reflections at all.

    The places of a path's corners come first, in turn: its reflections and its edge; all but reflections are zeros.
    A refraction does not turn a path, so it makes no corner.
    """
    is_corner = np.isin(paths.interactions, (SPECULAR, DIFFRACTION))
    num_paths, depth = is_corner.shape
    corner_m = np.empty((num_paths, depth + 2, 3))
    corner_m[:, 0], corner_m[:, 1:] = tx_position_m, array_m
    path, place = np.nonzero(is_corner)
    corner = is_corner.cumsum(axis=1)[path, place]
    corner_m[path, corner] = paths.vertices_m[path, place]
    is_reflection = np.zeros_like(is_corner)
    is_reflection[path, corner - 1] = paths.interactions[path, place] == SPECULAR
    turn = np.diff(_unit(np.diff(corner_m, axis=1)), axis=1)
    is_there = is_reflection[..., None]
    return corner_m[:, 1:-1] * is_there, _unit(turn * is_there), is_reflection


def _unit(vector: Float[FloatArray, "*S 3"]) -> Float[FloatArray, "*S 3"]:
    """Vectors of length 1; a zero vector stays zero."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return vector / np.where(length == 0, 1.0, length)


def _is_on(
    plane: FoundPlane, point_m: Float[FloatArray, "*S 3"], normal: Float[FloatArray, "*S 3"], array_m: Vector
) -> Bool[NDArray[np.bool_], "*S"]:
    """Whether points of surfaces with these normals lie on a found plane, where the plane holds something."""
    if plane.corners_m is None:
        return np.zeros(point_m.shape[:-1], bool)
    away_m = np.abs((point_m - array_m) @ plane.unit_normal - plane.distance_m)
    tilt_rad = np.linalg.norm(np.cross(normal, plane.unit_normal), axis=-1)  # either side may be met
    beside_m = _distance_m(point_m, np.array(plane.corners_m))
    is_near = away_m < FOUND_DISTANCE_M + 3 * plane.distance_std_m
    return is_near & (tilt_rad < FOUND_TILT_RAD) & (beside_m <= HELD_MARGIN_M)


def _distance_m(
    point_m: Float[FloatArray, "*S 3"], corners_m: Float[FloatArray, "4 3"]
) -> Float[FloatArray, "*S"]:
    """Distance of points from a rectangle, whose corners are given in turn; it may have no area."""
    offset_m = point_m - corners_m[0]
    nearest_m = np.zeros_like(offset_m)
    for edge_m in (corners_m[1] - corners_m[0], corners_m[3] - corners_m[0]):
        along = offset_m @ edge_m / (edge_m @ edge_m or 1.0)
        nearest_m += along.clip(0, 1)[..., None] * edge_m
    return np.linalg.norm(offset_m - nearest_m, axis=-1)
