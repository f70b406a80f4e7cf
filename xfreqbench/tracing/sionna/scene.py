"""A scene inside Sionna RT: its shapes, and its materials at one carrier at a time."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt

from xfreqbench.scene.materials import MaterialPolicy, ScatteringPattern, complex_permittivity, conductivity_s_m
from xfreqbench.scene.meshes import SurfaceMesh, shape_ids, slabs_of, write_mitsuba
from xfreqbench.scene.model import Antenna
from xfreqbench.scene.patches import mirror_patches
from xfreqbench.system.processes import interrupted_afterwards
from xfreqbench.tracing.sionna.llvm import ensure_llvm
from xfreqbench.types import FloatArray, NDArray

ensure_llvm()

with interrupted_afterwards():  # what is imported halfway aborts the process when it is imported again
    import drjit  # Dr.Jit looks for LLVM when it is imported
    import mitsuba
    import sionna.rt

dr: Any = drjit  # their stubs know no variant, so most of what is called here has no type there
mi: Any = mitsuba
rt: Any = sionna.rt

_PATTERNS: dict[ScatteringPattern, Any] = {
    "lambertian": rt.LambertianPattern,
    "directive": rt.DirectivePattern,
    "backscattering": rt.BackscatteringPattern,
}

__all__ = ["RadioScene", "antenna_array", "dr", "mi", "orientation_rad", "point3f", "roomy_hash_table", "rt"]


@contextmanager
def roomy_hash_table() -> Iterator[None]:
    """Make Sionna's table of candidates large enough to lose next to none; afterwards it is as before."""
    generator = rt.path_solvers.sb_candidate_generator.SBCandidateGenerator
    stock_size = generator.MIN_SPEC_COUNT_SIZE
    # Sionna's table of a million loses 9 % of the candidates of 1e5 rays, and 22 % of 5e5
    generator.MIN_SPEC_COUNT_SIZE = 2**25
    try:
        yield
    finally:
        generator.MIN_SPEC_COUNT_SIZE = stock_size


def point3f(positions_m: Float[NDArray[Any], "N 3"]) -> Any:
    """Points as Dr.Jit holds them, opaque so that one compiled kernel serves all positions."""
    columns = np.asarray(positions_m, dtype=np.float32).T
    points = mi.Point3f(*(mi.Float(np.ascontiguousarray(column)) for column in columns))
    dr.make_opaque(points)
    return points


def antenna_array(antenna: Antenna, positions_wavelengths: Float[FloatArray, "M 3"]) -> Any:
    """Sionna's array of equal antennas at the given positions, in wavelengths, in world axes.

    Its device has to be turned by `orientation_rad`.
    """
    polarization = antenna.as_vertical.polarization
    array = rt.PlanarArray(num_rows=1, num_cols=1, pattern=antenna.pattern, polarization=polarization)
    array.normalized_positions = point3f(positions_wavelengths @ antenna.as_vertical.rotation)
    return array


def orientation_rad(antenna: Antenna, number: int = 1) -> Any:
    """The orientation of so many devices with an antenna, as Sionna has it."""
    return point3f(np.radians([antenna.as_vertical.orientation_deg] * number).reshape(number, 3))


class RadioScene:
    """Meshes loaded into Sionna RT, with materials that follow `set_carrier`, and scatter where the scene says so.

    The materials are plain ones whose values come from `xfreqbench.scene.materials`. Sionna's own ITU materials
    raise for every carrier outside a band, even for the 3.5 GHz at which a scene is loaded, and leave the
    other materials half updated.
    """

    def __init__(self, meshes: Sequence[SurfaceMesh], policy: MaterialPolicy = "error") -> None:
        self.meshes = list(meshes)
        self.policy = policy
        self.sionna = _load(self.meshes) if self.meshes else rt.load_scene()
        slabs = slabs_of(self.meshes)
        for name, material in self.sionna.radio_materials.items():
            scattering = slabs[int(name.rpartition("-")[2])].scattering
            if scattering:
                material.scattering_coefficient = scattering.coefficient
                material.xpd_coefficient = scattering.xpd_coefficient
                material.scattering_pattern = _PATTERNS[scattering.pattern](**scattering.pattern_numbers)

    @cached_property
    def mirrors(self) -> Bool[NDArray[np.bool_], "K"]:
        """Whether each triangle mirrors, meshes in order."""
        return np.asarray(mirror_patches(self.meshes) >= 0)

    @property
    def mitsuba(self) -> Any:
        """The Mitsuba scene, which rays are cast into."""
        return self.sionna.mi_scene

    @property
    def shape_pointer(self) -> UInt[NDArray[np.uint32], "S"]:
        """Dr.Jit's pointer to the shape of each mesh, in the order of the meshes."""
        shapes = {shape.id(): shape for shape in self.mitsuba.shapes()}
        ordered = [shapes[identifier] for identifier in shape_ids(self.meshes)]
        pointers = [dr.reinterpret_array(mi.UInt, mi.ShapePtr(shape)).numpy()[0] for shape in ordered]
        return np.array(pointers, dtype=np.uint32)

    def set_carrier(self, carrier_hz: float) -> None:
        """Set the carrier and every material's permittivity and conductivity.

        Raises `MaterialBandError` before anything has changed. All values are opaque to Dr.Jit: ten
        carriers share one compiled kernel.
        """
        slabs = slabs_of(self.meshes)
        permittivity = [complex_permittivity(slab.homogeneous, carrier_hz, self.policy) for slab in slabs]
        self.sionna.frequency = dr.opaque(mi.Float, carrier_hz)
        for name, material in self.sionna.radio_materials.items():
            value = permittivity[int(name.rpartition("-")[2])]
            material.relative_permittivity = dr.opaque(mi.Float, value.real)
            material.conductivity = dr.opaque(mi.Float, conductivity_s_m(value, carrier_hz))


def _load(meshes: Sequence[SurfaceMesh]) -> Any:
    """Sionna's scene of some meshes, its ITU materials as plain ones of the same name and thickness."""
    with tempfile.TemporaryDirectory(prefix="xfreqbench-") as folder:
        xml = write_mitsuba(meshes, Path(folder))
        tree = ElementTree.parse(xml)
        for bsdf in tree.getroot().iter("bsdf"):
            bsdf.set("type", "radio-material")
            for itu_name in bsdf.findall("./string[@name='type']"):
                bsdf.remove(itu_name)
        tree.write(xml)
        return rt.load_scene(str(xml), merge_shapes=False)
