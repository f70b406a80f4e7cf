"""The room that a run has learned, as surfaces that a tracer can trace."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import DataError
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.report.findings.materials import SlabNames
from xfreqbench.scene.meshes import SurfaceMesh
from xfreqbench.scene.placement import MIN_SEPARATION_M
from xfreqbench.scene.visibility import distance_to_surfaces
from xfreqbench.types import FloatArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

_MIN_SEEN = 0.05  # of a face; where paths tell of less, its material is what learning began with


@dataclass(frozen=True, eq=False)
class RoomSurface:
    """A convex polygon of a learned room, its corners in turn, with the P.2040 material nearest to what was learned.

    `distance` is that of the reflection coefficients, as `NamedSlab` has it; `seen` is that of `FoundFace`.
    """

    name: str
    plane: int
    corners_m: Float[FloatArray, "n 3"]
    material: str
    thickness_m: float
    distance: float
    seen: float
    is_wall: bool

    @property
    def mesh(self) -> SurfaceMesh:
        """The polygon as a fan of triangles."""
        number = np.arange(1, len(self.corners_m) - 1)
        triangles = np.stack([np.zeros_like(number), number, number + 1], axis=1)
        return SurfaceMesh(self.name, self.material, self.thickness_m, self.corners_m, triangles)

    @property
    def area_m2(self) -> float:
        """Area of the polygon."""
        edges_m = self.corners_m[1:] - self.corners_m[0]
        return float(np.linalg.norm(np.cross(edges_m[:-1], edges_m[1:]).sum(0)) / 2)

    @property
    def slab_name(self) -> str:
        """Material and thickness in words, as in `glass 7.90 mm`."""
        return f"{self.material} {self.thickness_m * 1e3:.2f} mm"

    @property
    def is_unseen(self) -> bool:
        """Whether too few paths tell of it for its material to mean anything."""
        return self.seen < _MIN_SEEN

    def made_of(self, material: str, thickness_m: float, distance: float) -> RoomSurface:
        """The same polygon of another slab."""
        return replace(self, material=material, thickness_m=thickness_m, distance=distance)


def learned_surfaces(compared: ComparedFindings) -> list[RoomSurface]:
    """The faces of findings, each of the P.2040 material that is nearest over the carriers of the data.

    A face on which the array or a transmitter of the data stands is left out. Raises `DataError` for findings
    without faces.
    """
    findings, header = compared.findings, compared.dataset.header
    if not findings.faces:
        raise DataError(
            f"Record {compared.record.id} has no faces from which a room could be made: the run found no plane that "
            "holds anything, or the record was written before faces were stored. Run virtual-source again."
        )
    names = SlabNames(header.carrier_hz.tolist())
    nearest = {
        (face.plane, face.slab): names.nearest(findings.planes[face.plane].slabs[face.slab])[0]
        for face in findings.faces
    }
    aperture_m = header.receiver.element_position_m(SPEED_OF_LIGHT_M_S / header.carrier_hz.min())
    standing_m = np.concatenate([aperture_m, compared.dataset.tables["tx_position_m"]])
    surfaces = []
    for number, face in enumerate(findings.faces):
        name = f"{'wall' if face.is_wall else 'face'} {number} of plane {face.plane}"
        slab = nearest[face.plane, face.slab]
        surface = RoomSurface(name, face.plane, np.array(face.corners_m), *slab, face.seen, face.is_wall)
        if distance_to_surfaces([surface.mesh], standing_m).min() >= MIN_SEPARATION_M:
            surfaces.append(surface)
    return surfaces
