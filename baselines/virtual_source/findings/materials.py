"""What was learned of each material of a scene: the slabs of found planes where the scene has it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from xfreqbench.data.splits import LOFO_TARGETS_HZ
from xfreqbench.scene.materials import conductivity_s_m
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz

from ..room.surfaces import SlabNames, polygon_area_m2, slab_reflection
from ..stored import FoundFace, FoundSlab
from .compared import ComparedFindings, Match, TrueSlab, nearest_point, true_reflection
from .text import ABSENT, Table, number

LEAST_SHARE = 0.05  # of a plane: a slab that fills less of it is not shown
_ANGLES_DEG = 0, 30, 45, 60, 75, 85


class LearnedSlab(NamedTuple):
    """A slab of a found plane, and the scene's slab that is there.

    `seen` is the share of its faces that paths of the training rows tell of; nan if it has no faces.
    """

    truth: TrueSlab
    plane: int
    slab: FoundSlab
    seen: float

    @property
    def title(self) -> str:
        """Material and thickness of the scene's slab in words, as in `plasterboard 12.5 mm`."""
        material, thickness_m = self.truth
        return f"{str(material).replace('_', ' ')} {thickness_m * 1e3:g} mm"

    def reflections(
        self, carrier_hz: float, angle_rad: Float[FloatArray, "A"]
    ) -> tuple[Float[FloatArray, "A 2"], Float[FloatArray, "A 2"]]:
        """|R| over the angle of incidence, TE and TM: of what was learned, and of the scene's slab by P.2040."""
        cosine, eta = np.cos(angle_rad), self.slab.permittivity_at(carrier_hz)
        learned = slab_reflection([eta], self.slab.thickness_m, [carrier_hz], cosine)[0]
        return np.abs(learned), np.abs(true_reflection(self.truth, carrier_hz, cosine))


def learned_slabs(compared: ComparedFindings) -> list[LearnedSlab]:
    """The slabs of found planes that show the scene directly, in the order of the scene's slabs that they are."""
    learned = []
    for index, (plane, match) in enumerate(zip(compared.findings.planes, compared.matches, strict=True)):
        for number_of_slab, slab in enumerate(plane.slabs):
            if match and match.mirror is None and slab.share >= LEAST_SHARE:
                faces = [face for face in compared.findings.faces if (face.plane, face.slab) == (index, number_of_slab)]
                areas_m2 = np.array([polygon_area_m2(np.array(face.corners_m)) for face in faces])
                seen = float(areas_m2 @ [face.seen for face in faces] / areas_m2.sum()) if faces else np.nan
                learned.append(LearnedSlab(_true_slab(compared, match, faces), index, slab, seen))
    return sorted(learned, key=lambda slab: str(slab.truth))


def shown_carriers_hz(compared: ComparedFindings) -> list[float]:
    """The carriers of the data that are nearest, on a logarithmic scale, to those that the paper tests."""
    carrier_hz = compared.dataset.header.carrier_hz
    places = [int(np.abs(np.log(carrier_hz / target)).argmin()) for target in LOFO_TARGETS_HZ]
    return [float(carrier_hz[place]) for place in sorted(set(places))]


def material_rows(compared: ComparedFindings) -> Table:
    """One row for each learned slab: what it is like, and the P.2040 slab nearest to it, if any is defined.

    Its σ is that at the middle one of the shown carriers.
    """
    carriers_hz = shown_carriers_hz(compared)
    carrier_hz = carriers_hz[len(carriers_hz) // 2]
    names, rows = SlabNames(compared.dataset.header.carrier_hz.tolist()), []
    for learned in learned_slabs(compared):
        slab, nearest = learned.slab, names.nearest(learned.slab)[:1]
        rows.append(
            (
                learned.title,
                str(learned.plane),
                f"{slab.share:.0%}",
                ABSENT if np.isnan(learned.seen) else f"{learned.seen:.0%}",
                number(slab.permittivity, 2),
                f"{conductivity_s_m(slab.permittivity_at(carrier_hz), carrier_hz):.3g}",
                number(slab.thickness_m * 1e3, 2),
                *[f"{named.material.replace('_', ' ')} {named.thickness_m * 1e3:.2f} mm" for named in nearest],
                *[number(named.distance, 3) for named in nearest],
                *([] if nearest else [ABSENT, ABSENT]),
            )
        )
    sigma = f"σ (S/m), {format_ghz(carrier_hz)}"
    header = ("material", "plane", "of the plane", "seen", "ε′", sigma, "thickness (mm)", "nearest of P.2040")
    return (*header, "to that, rms |ΔR|"), rows


def reflection_rows(compared: ComparedFindings) -> Table:
    """|R| of each learned slab over the angle of incidence, with that of the scene's slab by P.2040 in brackets."""
    rows = []
    for learned in learned_slabs(compared):
        for carrier_hz in shown_carriers_hz(compared):
            own, true = learned.reflections(carrier_hz, np.radians(_ANGLES_DEG))
            for column, polarisation in enumerate(("TE", "TM")):
                pairs = zip(own[:, column], true[:, column], strict=True)
                cells = [f"{value:.2f} ({truth:.2f})" for value, truth in pairs]
                rows.append((learned.title, str(learned.plane), format_ghz(carrier_hz), polarisation, *cells))
    return ("material", "plane", "carrier", "polarisation", *(f"{angle}°" for angle in _ANGLES_DEG)), rows


def _true_slab(compared: ComparedFindings, match: Match, faces: Sequence[FoundFace]) -> TrueSlab:
    """What the scene has where most of these faces are, or where most of the found plane is if there are none."""
    if not faces:
        shares = match.slabs(compared.meshes)
        return max(shares, key=lambda slab: shares[slab])
    plane, areas_m2 = match.plane, dict[TrueSlab, float]()
    for face in faces:
        centre_m = np.mean(face.corners_m, axis=0)
        beyond_m = (centre_m - compared.findings.array_m) @ plane.normal - plane.distance_m
        foot_m = centre_m - beyond_m * plane.normal
        away_m = [
            np.linalg.norm(nearest_point(facet.corners_m, plane.normal, foot_m) - foot_m) for facet in plane.facets
        ]
        mesh = compared.meshes[plane.facets[int(np.argmin(away_m))].surface]
        slab = mesh.material, mesh.thickness_m
        areas_m2[slab] = areas_m2.get(slab, 0.0) + polygon_area_m2(np.array(face.corners_m))
    return max(areas_m2, key=lambda slab: areas_m2[slab])
