"""Chooses a record with findings, and compares these with the scene of the record's data set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float
from pydantic import ValidationError

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import RunRecord
from xfreqbench.scene.facets import planar_facets
from xfreqbench.scene.materials import Material, complex_permittivity
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes
from xfreqbench.scene.placement import median_transmitter
from xfreqbench.types import FloatArray

from ..room.surfaces import slab_reflection
from ..search.planes import Vector
from ..stored import FoundSlab, StoredFindings
from .match import Match, ScenePlane, TrueSlab, compare, not_found, scene_planes

MAX_IMAGE_ORDER = 2
_LEAST_POWER = 1e-4  # −40 dB relative to the line of sight: weaker images are not shown


@dataclass(frozen=True, eq=False)
class Reflection:
    """Magnitude of the reflection coefficient at normal incidence, as learned and by ITU-R P.2040."""

    carrier_hz: Float[FloatArray, "F"]
    learned: Float[FloatArray, "F"]
    truth: Float[FloatArray, "F"]

    @property
    def difference(self) -> Float[FloatArray, "F"]:
        """Distance between the two magnitudes, at each carrier."""
        return np.abs(self.learned - self.truth)


@dataclass(frozen=True, eq=False)
class ImageSource:
    """Where a transmitter seems to be after it is mirrored in found planes, given in the order of the bounces."""

    planes: tuple[int, ...]
    power: float
    position_m: Vector


def reflection(
    slabs: Sequence[FoundSlab], truth: Mapping[TrueSlab, float], carrier_hz: Float[FloatArray, "F"]
) -> Reflection:
    """|R| of learned slabs and of true ones, each mixed by shares; what the shares leave open reflects nothing."""
    carriers, normal = carrier_hz.tolist(), np.ones(1)
    learned, true = [nothing := np.zeros(len(carriers), dtype=np.complex128)], [nothing]
    for slab in slabs:
        permittivity = [slab.permittivity_at(carrier) for carrier in carriers]
        reflected = slab_reflection(permittivity, slab.thickness_m, carriers, normal)
        learned.append(slab.share * reflected[:, 0, 0])
    for (material, thickness_m), share in truth.items():
        permittivity = [true_permittivity(material, carrier) for carrier in carriers]
        true.append(share * slab_reflection(permittivity, thickness_m, carriers, normal)[:, 0, 0])
    return Reflection(carrier_hz, np.abs(sum(learned)), np.abs(sum(true)))


def true_permittivity(material: Material, carrier_hz: float) -> complex:
    """Complex relative permittivity by P.2040, whose power laws are extrapolated beyond a material's band."""
    return complex_permittivity(material, carrier_hz, "extrapolate")


def virtual_sources(findings: StoredFindings, tx_position_m: Vector) -> list[ImageSource]:
    """Images of a transmitter after 1 to `MAX_IMAGE_ORDER` bounces, the strongest first."""
    sources = []
    for image in findings.images:
        position_m = tx_position_m
        for plane in (findings.planes[index] for index in image.planes):
            beyond_m = plane.unit_normal @ (position_m - findings.array_m) - plane.distance_m
            position_m = position_m - 2 * beyond_m * plane.unit_normal
        if 0 < len(image.planes) <= MAX_IMAGE_ORDER:
            sources.append(ImageSource(image.planes, image.power, position_m))
    return sources


def choose_record(
    results: Path, id_prefix: str | None = None, split: str | None = None, seed: int | None = None
) -> RunRecord:
    """The newest record with findings that fits what is asked for; `results` is a folder of runs or a file of records.

    Raises `DataError` where no record has findings, `UnknownNameError` where none of those fits.
    """
    folder = ResultsFolder.holding(results)
    path, records = folder.records_path, folder.records
    if not records:
        raise DataError(f"{path} holds no records of runs. Run `xfreqbench run` first, or mend the path.")
    told = [record for record in records if "planes" in record.findings]
    if not told:
        methods = ", ".join(sorted({record.job.method for record in records}))
        raise DataError(
            f"No record in {path} has findings; its methods are {methods}. Run a method that tells what it "
            "has learned, such as virtual-source."
        )
    told = _only(told, "run with findings on split", split, lambda record: record.job.split)
    told = _only(told, "run with findings of seed", seed, lambda record: record.job.seed)
    chosen = [record for record in told if record.id.startswith(id_prefix or "")]
    if not chosen:
        raise UnknownNameError(
            "record with findings whose id begins with", str(id_prefix), {each.id for each in told}
        )
    return max(chosen, key=lambda record: record.time_utc)


def _only(
    records: list[RunRecord], kind: str, given: object, value_of: Callable[[RunRecord], object]
) -> list[RunRecord]:
    chosen = [record for record in records if given is None or value_of(record) == given]
    if not chosen:
        raise UnknownNameError(kind, str(given), {str(value_of(record)) for record in records})
    return chosen


@dataclass(frozen=True, eq=False)
class ComparedFindings:
    """The findings of a record, and the surfaces of its data set's scene; all comparisons follow from them."""

    record: RunRecord
    dataset: PasDataset
    findings: StoredFindings
    meshes: list[SurfaceMesh]

    @classmethod
    def of(cls, record: RunRecord, dataset: PasDataset) -> ComparedFindings:
        """Compare a record with its data set.

        Raises `DataError` for another data set, one without a scene, or findings that are not planes and images.
        """
        if record.dataset_sha256 != dataset.sha256:
            raise DataError(
                f"Record {record.id} was run on {record.job.dataset} (sha256 {record.dataset_sha256[:16]}…), but "
                f"{dataset.path} has sha256 {dataset.sha256[:16]}…. Give --data the file of the run."
            )
        try:
            findings = StoredFindings.model_validate(record.findings)
        except ValidationError as error:
            fault = error.errors()[0]
            raise DataError(
                f"The findings of record {record.id} ({record.job.method}) are no planes and images: "
                f"{'.'.join(map(str, fault['loc'])) or 'all'}: {fault['msg']}. Choose another record with --id."
            ) from error
        if dataset.scene.scene is not None:
            raise DataError(
                f"{dataset.path} was traced among the meshes of {dataset.scene.scene}, which data sets do not hold. "
                "Use a data set whose scene is made of surfaces alone."
            )
        return cls(record, dataset, findings, surface_meshes(dataset.scene))

    @property
    def title(self) -> str:
        """The run in words: its method, scene, split, seed and record."""
        job = self.record.job
        return f"{job.method} on {self.record.scene}, {job.split}, seed {job.seed} (record {self.record.id})"

    @cached_property
    def planes(self) -> list[ScenePlane]:
        """All planes of the scene."""
        return scene_planes(planar_facets(self.meshes), self.findings.array_m)

    @cached_property
    def matches(self) -> list[Match | None]:
        """What each found plane shows, as `match.compare` says."""
        return compare(self.findings, self.planes)

    @cached_property
    def missing(self) -> list[ScenePlane]:
        """Planes of the scene that were not found, the largest first."""
        return not_found(self.matches, self.planes)

    @cached_property
    def reflections(self) -> list[Reflection | None]:
        """|R| of each found plane at the data's carriers; None where it shows no surface directly, or holds nothing."""
        return [self._reflection(index, self.dataset.header.carrier_hz) for index in range(len(self.matches))]

    @cached_property
    def tx(self) -> int:
        """Index of the transmitter whose virtual sources are shown."""
        return median_transmitter(self.dataset.tables["tx_position_m"])

    @property
    def tx_m(self) -> Vector:
        """Position of that transmitter."""
        return np.asarray(self.dataset.tables["tx_position_m"][self.tx], dtype=np.float64)

    @cached_property
    def sources(self) -> list[ImageSource]:
        """Images of that transmitter with a power of at least `_LEAST_POWER`, the strongest first."""
        return [each for each in virtual_sources(self.findings, self.tx_m) if each.power >= _LEAST_POWER]

    def _reflection(self, index: int, carrier_hz: Float[FloatArray, "F"]) -> Reflection | None:
        match, slabs = self.matches[index], self.findings.planes[index].slabs
        if match is None or match.mirror is not None or not any(slab.share for slab in slabs):
            return None
        return reflection(slabs, match.slabs(self.meshes), carrier_hz)

    def surface(self, index: int) -> str:
        """What the found plane with this index shows, in words."""
        match = self.matches[index]
        if match is None:
            return "no such surface"
        names = self.names(match.surfaces)
        if match.mirror is None:
            return names
        mirror = self.matches[match.mirror]
        assert mirror is not None, "images are told of planes that are the scene's"
        return f"image of {names} in {self.names(mirror.surfaces[:1])}"

    def names(self, surfaces: Sequence[int]) -> str:
        """The names of surfaces, given by index."""
        return "; ".join(self.meshes[surface].name for surface in surfaces)
