"""What figures and 3D models of a scene show: surfaces, receiver, transmitters, and the strongest rays of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing.paths import DIFFRACTION, DIFFUSE, NO_INTERACTION, REFRACTION, SPECULAR, Paths
from xfreqbench.types import FloatArray, NDArray

RAY_RANGE_DB = 30.0  # below the strongest ray; the range that pictures of maps have too
MAX_RAYS = 40
LINE_OF_SIGHT = "line of sight"
_VERBS = {SPECULAR: "reflected by", REFRACTION: "through", DIFFUSE: "scattered by", DIFFRACTION: "diffracted by"}


@dataclass(frozen=True, eq=False)
class Ray:
    """A path; its points run from the transmitter to the array centre.

    `level_db` is its power at one carrier relative to the strongest path, 0 or less. `events` say in turn what it
    meets, as in `reflected by ceiling`.
    """

    points_m: Float[FloatArray, "n 3"]
    level_db: float
    delay_s: float
    events: tuple[str, ...]

    @property
    def label(self) -> str:
        """What the ray meets, in words."""
        return "; ".join(self.events) or LINE_OF_SIGHT


@dataclass(frozen=True, eq=False)
class ShownRoom:
    """A scene with its receiver, T transmitters, and the rays of transmitter `tx`; positions in world axes.

    `in_sight` is None where the data do not say which transmitters the receiver sees. The array is drawn at the
    carrier `lowest_hz`, at which it is widest.
    """

    receiver: ReceiverArray
    lowest_hz: float
    tx_position_m: Float[FloatArray, "T 3"]
    in_sight: Bool[NDArray[np.bool_], "T"] | None
    tx: int
    meshes: Sequence[SurfaceMesh]
    rays: Sequence[Ray]

    @property
    def tx_m(self) -> Float[FloatArray, "3"]:
        """Where the transmitter of the rays stands."""
        return self.tx_position_m[self.tx]

    @property
    def receiver_m(self) -> Float[FloatArray, "3"]:
        """Position of the array centre."""
        return np.array(self.receiver.position_m, dtype=np.float64)

    @property
    def boresight(self) -> Float[FloatArray, "3"]:
        """Unit vector along the boresight, which is the pole of the maps' hemisphere."""
        return self.receiver.rotation[:, 2]

    def groups(self) -> dict[str, Float[FloatArray, "N 3"]]:
        """Positions of the transmitters in sight and of those in shadow, or of all where that is not known; by name."""
        if self.in_sight is None:
            return {"transmitters": self.tx_position_m}
        lit, shadowed = self.tx_position_m[self.in_sight], self.tx_position_m[~self.in_sight]
        return {"transmitters in sight": lit, "transmitters in shadow": shadowed}


def strongest_rays(
    paths: Paths,
    carrier_index: int,
    tx_m: Float[FloatArray, "3"],
    receiver_m: Float[FloatArray, "3"],
    meshes: Sequence[SurfaceMesh],
) -> list[Ray]:
    """At most `MAX_RAYS` paths within `RAY_RANGE_DB` of the strongest one at a carrier, the strongest first."""
    power = np.abs(paths.gain[carrier_index]) ** 2
    if not power.any():
        return []
    kept = np.flatnonzero(power >= power.max() * 10 ** (-RAY_RANGE_DB / 10))
    rays = []
    for index in kept[np.argsort(-power[kept], kind="stable")][:MAX_RAYS].tolist():
        met = paths.interactions[index] != NO_INTERACTION
        verbs = [_VERBS[code] for code in paths.interactions[index][met].tolist()]
        names = [meshes[surface].name for surface in paths.surfaces[index][met].tolist()]
        rays.append(
            Ray(
                points_m=np.vstack([tx_m, paths.vertices_m[index][met], receiver_m]),
                level_db=10 * float(np.log10(float(power[index] / power.max()))),
                delay_s=float(paths.delay_s[index]),
                events=tuple(map(" ".join, zip(verbs, names, strict=True))),
            )
        )
    return rays
