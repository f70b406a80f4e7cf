"""The plan of a generation: everything is looked up and checked before the first ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import cast

import numpy as np
from jaxtyping import Bool, Float
from pydantic import TypeAdapter

from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.recipe import job_of
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.trace import Tracing
from xfreqbench.errors import UnknownNameError, XFreqBenchError
from xfreqbench.maps.bartlett import pas_kind_named
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import P2040_EDITION, ConstantMaterial, check_dispersion
from xfreqbench.scene.meshes import bounds_m, meshes_sha256, slabs_of, triangle_corners_m
from xfreqbench.scene.model import POLARIZATION_PAIRS, PolarizationPair, Scene, load_scene
from xfreqbench.scene.overlaps import check_overlaps, nearly_in_one_plane
from xfreqbench.scene.patches import PLANE_TOLERANCE
from xfreqbench.scene.placement import (
    MIN_SEPARATION_M,
    Placement,
    are_outside,
    check_receiver,
    check_transmitters,
    choose_transmitters,
    place_transmitters,
)
from xfreqbench.scene.polygons import extents_m
from xfreqbench.scene.rooms import check_closed
from xfreqbench.scene.visibility import is_closed, sees
from xfreqbench.system.files import json_sha256
from xfreqbench.system.machine import require_memory
from xfreqbench.system.source import package_sha256
from xfreqbench.tracing.solvers import resolve_solver
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.tracing.versions import PHYSICS_VERSION, software_versions
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import format_ghz_list, ghz_to_hz

# Transmitters a batch: the most that a killed process has to trace again.
BATCH = 16


@dataclass(frozen=True)
class Plan:
    """A job whose input is checked; everything that can be refused before the first ray is refused.

    `tracing` is sent to workers, and `header` will be the header of the file.
    """

    tracing: Tracing
    tx_position_m: Float[FloatArray, "T 3"]
    header: DatasetHeader

    @cached_property
    def line_of_sight(self) -> Bool[NDArray[np.bool_], "T *R"]:
        """Whether each transmitter is in sight of the receiver, or of each of several."""
        meshes, receivers = self.tracing.geometry.meshes, self.tracing.scene.receivers
        in_sight = [sees(meshes, self.tx_position_m, np.asarray(receiver.position_m)) for receiver in receivers]
        return np.stack(in_sight, axis=1) if self.header.receivers else in_sight[0]

    @property
    def num_links(self) -> int:
        """Number of receivers times that of pairs of polarizations."""
        return prod(self.header.link_axes.values())

    @property
    def summary(self) -> str:
        """Counts and size in a few lines, for a user to check before the work starts."""
        header, scene, settings, geometry = (
            self.header,
            self.tracing.scene,
            self.tracing.settings,
            self.tracing.geometry,
        )
        num_samples = len(self.tx_position_m) * self.num_links * header.num_carriers
        rejected = sum(header.rejected.values())
        reasons = ", ".join(f"{count} {reason}" for reason, count in header.rejected.items() if count)
        in_sight = ", ".join(map(str, np.atleast_1d(self.line_of_sight.sum(axis=0)).tolist()))
        links = "".join(
            f"× {len(names)} {what} ({', '.join(names)}) "
            for what, names in zip(("receivers", "pairs"), header.link_names, strict=True)
            if names
        )
        lines = [
            f"{scene.name}: {len(self.tx_position_m)} transmitters ({in_sight} in sight) {links}"
            f"× {len(header.carrier_hz)} carriers = {num_samples} samples, {header.num_bytes / 1e6:.0f} MB"
            f"{' and the paths' if header.paths else ''}",
            f"solver {settings.solver}, {' and '.join(settings.named_interactions)}, depth {settings.max_depth}, "
            f"{settings.rays:,} rays, seed {settings.seed}",
            f"{rejected} grid positions left out{': ' + reasons if reasons else ''}",
        ]
        if scene.scene is not None:
            lines.append(self._mesh_note())
        # Sionna RT drops all paths through both faces of closed meshes as thin as this
        thin = [
            mesh.name
            for mesh in (geometry.meshes if settings.solver == "sionna" else ())
            if PLANE_TOLERANCE < extents_m(mesh.vertices_m)[0] < MIN_SEPARATION_M
            and mesh.material != "metal"
            and is_closed(mesh)
        ]
        if thin:
            lines.append(
                f"thinner than {MIN_SEPARATION_M * 1e3:g} mm, so that in Sionna RT nothing passes both faces: "
                f"{', '.join(thin)}; use a rectangle with a thickness_m, or solver image"
            )
        if near := nearly_in_one_plane(geometry):
            lines.append(f"{near}: a path passes both; if they are the same wall or object, leave one out")
        lines += self._material_notes()
        if not header.receiver.resolves_directions:
            lines.append("maps are nearly constant: the array has hardly any extent")
        return "\n".join(lines)

    def _mesh_note(self) -> str:
        """A line on the size of a scene with a mesh file, and on how much of it reflects."""
        geometry = self.tracing.geometry
        x, y, z = (f"{extent:,.2f}" for extent in np.ptp(bounds_m(geometry.meshes), axis=0))
        sides_m = np.diff(triangle_corners_m(geometry.meshes), axis=1)
        area_m2 = np.linalg.norm(np.cross(sides_m[:, 0], sides_m[:, 1]), axis=1) / 2
        patch, mirrors = geometry.mirror_patch, geometry.mirrors
        patches_m2 = np.bincount(patch[mirrors], weights=area_m2[mirrors], minlength=1)
        num_outside = np.count_nonzero(are_outside(geometry.meshes, self.tx_position_m))
        return (
            f"meshes: {x} × {y} m, {z} m high; {patches_m2.sum():,.2f} of {area_m2.sum():,.2f} m² mirror, the "
            f"largest patch is {patches_m2.max():,.2f} m²; {np.count_nonzero(~mirrors):,} of {len(mirrors):,} "
            "triangles do not" + (f"; {num_outside:,} transmitters are outside" if num_outside else "")
        )

    def _material_notes(self) -> list[str]:
        """Lines on materials that the scene defines itself, and on those that scatter."""
        geometry = self.tracing.geometry
        layers = [layer for slab in slabs_of(geometry.meshes) for layer in slab.layers]
        own = {layer.material for layer in layers if isinstance(layer.material, ConstantMaterial)}
        constant = ", ".join(
            f"{material.name} (ε′ {material.relative_permittivity:g}, σ {material.conductivity_s_m:g} S/m)"
            for material in sorted(own, key=str)
        )
        rough = ", ".join(f"{name} (S {how.coefficient:g}, {how.pattern})" for name, how in geometry.scattering)
        is_traced = "diffuse" in self.tracing.settings.named_interactions
        untraced = "" if is_traced else ", but the interaction diffuse is not traced"
        notes = {"the same at every carrier": constant, "scattering": rough and rough + untraced}
        return [f"{what}: {names}" for what, names in notes.items() if names]

    @cached_property
    def job(self) -> dict[str, str]:
        """The job by `job_of`, and what makes it: versions of software, and the code of this package."""
        software = {f"software.{name}": version for name, version in self.header.software.items()}
        return {**job_of(self.header, self.tx_position_m), **software, "software.code": package_sha256()[:16]}

    @cached_property
    def sha256(self) -> str:
        """Hash of `job`: plans of the same hash give the same bytes."""
        return json_sha256(self.job)

    @property
    def batches(self) -> list[slice]:
        """Transmitters of each batch: fewer where each has several links, or more than a hundred carriers."""
        samples_each = self.num_links * max(1, len(self.header.carrier_hz) // 100)
        count, step = len(self.tx_position_m), max(1, BATCH // samples_each)
        return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def plan_generation(scene: str | Path | Scene, options: GenerateOptions) -> Plan:
    """Check the options for a scene's data set and look up all that it needs; no ray is shot.

    The transmitters are those of `tx_positions`, or otherwise the scene's usable grid positions; the seed chooses `tx`
    of them if that is given. Raises `MaterialBandError`, `PlacementError` or another `XFreqBenchError`.
    """
    if options.tx is not None and options.tx_positions is not None:
        raise XFreqBenchError("tx chooses from the scene's grid and tx_positions replaces it; give one of them.")
    scene = load_scene(scene) if isinstance(scene, str | Path) else scene
    settings, paths = options.settings, options.paths
    carriers = sorted(map(ghz_to_hz, options.freqs_ghz))
    if len(set(carriers)) < len(carriers):
        raise XFreqBenchError(f"Each carrier can be given once, but {format_ghz_list(carriers)} names one twice.")
    geometry, pairs = Geometry.of(scene), _pairs(options.polarization)
    scene = _with_receivers(scene, options.receiver)
    scene = scene.with_polarization(pairs[0]) if pairs else scene
    rays = settings.rays if settings.solver == "sionna" else 0
    require_memory(
        # at the peak: a triangle's where solver `image` sorts them, measured in scene `lounge`, and a ray's of `sionna`
        (geometry.num_triangles * 800 + rays * 300) / 2**20,
        f"Tracing the {geometry.num_triangles:,} triangles of scene {scene.name!r} with {settings.rays:,} rays",
    )
    settings = resolve_solver(geometry, settings)
    if paths and settings.solver == "sionna" and "diffuse" in settings.named_interactions:
        raise XFreqBenchError(
            "Diffuse paths of solver sionna cannot be stored: they are random samples, different at each carrier, and "
            "up to one for each ray. Leave out --paths, --solver sionna, or the interaction diffuse."
        )
    materials = (layer.material for slab in slabs_of(geometry.meshes) for layer in slab.layers)
    extrapolated = check_dispersion(materials, carriers, settings.materials)
    check_overlaps(geometry)
    for receiver in scene.receivers:
        alone = replace(scene, receiver=receiver, other_receivers=())
        check_receiver(alone, geometry.meshes, min(carriers))
        check_closed(alone, geometry.meshes)
    if options.tx_positions is None:
        usable = place_transmitters(scene, geometry.meshes, min(carriers))
        placed = replace(usable, tx_position_m=choose_transmitters(usable, options.tx, settings.seed))
    else:
        check_transmitters(scene, geometry.meshes, options.tx_positions, carriers)
        placed = Placement(options.tx_positions, rejected={})
    sha256 = meshes_sha256(geometry.meshes)
    absolute = replace(scene, folder=scene.folder.absolute())  # for workers that started in another folder
    several = pairs if len(pairs) > 1 else ()
    names = tuple(receiver.name or "" for receiver in scene.receivers)
    rough = [{"material": name, **how.stated} for name, how in geometry.scattering]
    header = DatasetHeader(
        scene_name=scene.name,
        scene_json=scene.canonical_json,
        scene_sha256=sha256,
        receiver=scene.receiver,
        carrier_hz=np.array(carriers),
        num_tx=len(placed.tx_position_m),
        pas_kind=pas_kind_named(options.pas_kind),
        maps=options.maps is not False,
        settings={
            **TypeAdapter(TraceSettings).dump_python(settings, mode="json"),
            "extrapolated_materials": extrapolated,
            **({"scattering": rough} if rough else {}),
            **scene.mirror_settings,
            **scene.antenna_settings,
        },
        software=software_versions(settings.solver),
        rejected=placed.rejected,
        paths=paths,
        physics=PHYSICS_VERSION,
        receivers=names if scene.other_receivers else (),
        polarizations=several,
        references=f"Recommendation ITU-R {P2040_EDITION}, Table 3 (materials)",
    )
    tracing = Tracing(absolute, sha256, tuple(carriers), settings, paths, several, geometry)
    return Plan(tracing, placed.tx_position_m, header)


def _with_receivers(scene: Scene, names: Sequence[str] | None) -> Scene:
    """The scene with the receivers that are asked for; raises `XFreqBenchError` if their arrays differ."""
    known = [receiver.name for receiver in scene.receivers if receiver.name is not None]
    if names is not None and [*names] == ["all"] and "all" not in known:
        names = known
    chosen = scene.with_receiver(*(names or ()))
    first, *others = chosen.receivers
    for other in others:
        if any(getattr(other, name) != getattr(first, name) for name in ("rows", "cols", "spacing_wavelengths")):
            raise XFreqBenchError(
                f"Receivers {first.name!r} and {other.name!r} have different arrays, but those of one file need the "
                "same rows, cols and spacing_wavelengths. Generate a file for each, as with --receiver "
                f"{first.name}, or give them the same array."
            )
    return chosen


def _pairs(polarizations: Sequence[str] | None) -> tuple[PolarizationPair, ...]:
    """Pairs of polarizations, sent and received: those that are named, or all pairs of the letters that are."""
    names = tuple(dict.fromkeys(polarizations or ()))
    if set(names) <= {"V", "H"}:
        names = tuple(sent + heard for sent in names for heard in names)
    for name in names:
        if name not in POLARIZATION_PAIRS:
            raise UnknownNameError("pair of polarizations", name, POLARIZATION_PAIRS)
    return cast("tuple[PolarizationPair, ...]", names)
