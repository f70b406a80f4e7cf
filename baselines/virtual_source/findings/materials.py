"""What was learned of each material of a scene: the slabs of found planes where the scene has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from xfreqbench.data.splits import LOFO_TARGETS_HZ
from xfreqbench.report.drawing.markdown import ABSENT, number
from xfreqbench.scene.materials import conductivity_s_m
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz

from ..room.surfaces import NamedSlab, SlabNames, polygon_area_m2, slab_reflection
from ..stored import FoundFace, FoundSlab
from .compared import ComparedFindings, Match, TrueSlab, nearest_point, true_reflection

LEAST_SHARE = 0.05  # of a plane: a slab that fills less of it is not shown
_SLAB_COLUMNS = ("ε′", "σ (S/m)", "thickness (mm)", "nearest of P.2040", "to that, rms |ΔR|")
_COLUMNS = ("material", "plane", "of the plane", "seen", *_SLAB_COLUMNS)


@dataclass(frozen=True, eq=False)
class LearnedSlab:
    """A slab of a found plane; `named` is the P.2040 slab nearest to it, if any is defined at all carriers.

    `seen` is the share of its faces that paths of the training rows tell of; nan if it has no faces.
    """

    plane: int
    slab: FoundSlab
    seen: float
    named: NamedSlab | None


@dataclass(frozen=True, eq=False)
class ShownMaterial:
    """A slab of the scene, and what was learned where it is."""

    truth: TrueSlab
    learned: Sequence[LearnedSlab]

    @property
    def title(self) -> str:
        """Material and thickness in words, as in `plasterboard 12.5 mm`."""
        material, thickness_m = self.truth
        return f"{str(material).replace('_', ' ')} {thickness_m * 1e3:g} mm"

    def true_over_angle(self, carrier_hz: float, angle_rad: Float[FloatArray, "A"]) -> Float[FloatArray, "2 A"]:
        """|R| of the scene's slab by P.2040, TE and TM."""
        return np.abs(true_reflection(self.truth, carrier_hz, np.cos(angle_rad))).T

    def learned_over_angle(
        self, carrier_hz: float, angle_rad: Float[FloatArray, "A"]
    ) -> list[Float[FloatArray, "2 A"]]:
        """|R| of each learned slab, TE and TM."""
        return [
            _over_angle(slab.permittivity_at(carrier_hz), slab.thickness_m, carrier_hz, angle_rad)
            for slab in (learned.slab for learned in self.learned)
        ]


def _over_angle(
    permittivity: complex, thickness_m: float, carrier_hz: float, angle_rad: Float[FloatArray, "A"]
) -> Float[FloatArray, "2 A"]:
    """|R| of a slab, TE and TM, at angles of incidence from the normal."""
    return np.abs(slab_reflection([permittivity], thickness_m, [carrier_hz], np.cos(angle_rad))[0]).T


@lru_cache(maxsize=1)  # every table and figure of one run asks
def shown_materials(compared: ComparedFindings) -> list[ShownMaterial]:
    """The slabs of the scene that found planes show directly, by material and thickness."""
    names = SlabNames(compared.dataset.header.carrier_hz.tolist())
    learned: dict[TrueSlab, list[LearnedSlab]] = {}
    for index, (plane, match) in enumerate(zip(compared.findings.planes, compared.matches, strict=True)):
        if match is None or match.mirror is not None:
            continue
        for number_of_slab, slab in enumerate(plane.slabs):
            if slab.share >= LEAST_SHARE:
                faces = [face for face in compared.findings.faces if (face.plane, face.slab) == (index, number_of_slab)]
                areas_m2 = np.array([polygon_area_m2(np.array(face.corners_m)) for face in faces])
                seen = float(areas_m2 @ [face.seen for face in faces] / areas_m2.sum()) if faces else np.nan
                nearest = names.nearest(slab)
                shown = LearnedSlab(index, slab, seen, nearest[0] if nearest else None)
                learned.setdefault(_true_slab(compared, match, faces), []).append(shown)
    return [ShownMaterial(truth, learned[truth]) for truth in sorted(learned, key=str)]


def shown_carriers_hz(compared: ComparedFindings) -> list[float]:
    """The carriers of the data that are nearest, on a logarithmic scale, to those that the paper tests."""
    carrier_hz = compared.dataset.header.carrier_hz
    places = [int(np.abs(np.log(carrier_hz / target)).argmin()) for target in LOFO_TARGETS_HZ]
    return [float(carrier_hz[place]) for place in sorted(set(places))]


def material_rows(
    materials: Sequence[ShownMaterial], carrier_hz: float
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Header and cells of a table with one row for each learned slab; its σ is that at a carrier."""
    header = tuple(f"{name}, {format_ghz(carrier_hz)}" if name.startswith("σ") else name for name in _COLUMNS)
    return header, [_row(material, learned, carrier_hz) for material in materials for learned in material.learned]


def _row(material: ShownMaterial, learned: LearnedSlab, carrier_hz: float) -> tuple[str, ...]:
    slab, named = learned.slab, learned.named
    return (
        material.title,
        str(learned.plane),
        f"{slab.share:.0%}",
        ABSENT if np.isnan(learned.seen) else f"{learned.seen:.0%}",
        number(slab.permittivity, 2),
        f"{conductivity_s_m(slab.permittivity_at(carrier_hz), carrier_hz):.3g}",
        number(slab.thickness_m * 1e3, 2),
        f"{named.material.replace('_', ' ')} {named.thickness_m * 1e3:.2f} mm" if named else ABSENT,
        number(named.distance, 3) if named else ABSENT,
    )


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
