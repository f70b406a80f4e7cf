"""DiffeRT, a differentiable ray tracer on JAX, brought into the form of the other solvers.

Everything is DiffeRT's own: candidates, image method, visibility and fields. Facets are given as quadrilaterals,
which halves what it has to try; materials are ITU-R P.2040 slabs as everywhere here. It computes in float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.materials import Material, complex_permittivity, conductivity_s_m
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

Candidates = Literal["exhaustive", "hybrid"]


def has_differt() -> bool:
    """Whether the extra `peers` is installed."""
    return find_spec("differt") is not None


class DiffeRTSolver:
    """Paths of every number of reflections up to `order` at one carrier, to each element as a receiver of its own."""

    def __init__(self, scene: Scene, carriers_hz: Sequence[float], order: int, candidates: Candidates) -> None:
        (carrier_hz,) = carriers_hz
        self._materials, self._mesh = _mesh(Geometry(surface_meshes(scene)), carrier_hz)
        self._carrier_hz, self._order, self._candidates = carrier_hz, order, candidates
        receiver, wavelength_m = scene.receiver, SPEED_OF_LIGHT_M_S / carrier_hz
        offset_m = receiver.element_position_wavelengths @ receiver.rotation.T * wavelength_m
        self._element_m = np.asarray(receiver.position_m) + offset_m

    def channels(self, tx_position_m: Float[FloatArray, "T 3"]) -> Complex[NDArray[np.complex128], "T M"]:
        """Sums of the fields at the M elements, travel phases included, one transmitter after the other."""
        from differt.em import TracedFields

        channels = np.zeros((len(tx_position_m), len(self._element_m)), np.complex128)
        for row, tx in zip(channels, tx_position_m, strict=True):
            for paths in self._paths(tx):
                fields = TracedFields.from_paths(paths, self._mesh, self._carrier_hz, radio_materials=self._materials)
                row += np.where(fields.mask, fields.fields, 0).sum(axis=-1)
        return channels

    def lengths_m(self, tx_position_m: Float[FloatArray, "3"]) -> Float[FloatArray, "P"]:
        """Lengths of the paths of one transmitter to the first element, ascending."""
        found = []
        for paths in self._paths(tx_position_m):
            vertex_m = np.asarray(paths.vertices, np.float64)[0][np.asarray(paths.mask)[0]]
            found.append(np.linalg.norm(np.diff(vertex_m, axis=1), axis=2).sum(axis=1))
        return np.sort(np.concatenate(found))

    def _paths(self, tx: Float[FloatArray, "3"]) -> list[Any]:
        import jax.numpy as jnp
        from differt.geometry import Scene as DiffeRTScene

        scene = DiffeRTScene(jnp.asarray(tx), jnp.asarray(self._element_m), self._mesh)
        return [scene.trace_paths(order, solver=self._candidates) for order in range(self._order + 1)]


def _mesh(geometry: Geometry, carrier_hz: float) -> tuple[dict[str, Any], Any]:
    """Materials by name, and the mesh, two triangles for each parallelogram."""
    import jax.numpy as jnp
    from differt.geometry import Mesh

    slabs = [(mesh.slab.homogeneous, mesh.thickness_m) for mesh in geometry.meshes]
    names = {slab: f"{slab[0]}-{number}" for number, slab in enumerate(dict.fromkeys(slabs))}
    corners_m = np.array([facet.corners_m for facet in geometry.facets]).reshape(-1, 4, 3)
    corner = np.arange(4 * len(corners_m)).reshape(-1, 4)
    of_facet = [list(names).index(slabs[facet.surface]) for facet in geometry.facets]
    mesh = Mesh(
        vertices=jnp.asarray(corners_m.reshape(-1, 3)),
        triangles=jnp.asarray(corner[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)),
        face_materials=jnp.asarray(np.repeat(of_facet, 2)),
        material_names=tuple(names.values()),
        assume_quads=True,
    )
    return {name: _material(name, *slab, carrier_hz) for slab, name in names.items()}, mesh


def _material(name: str, material: Material, thickness_m: float, carrier_hz: float) -> Any:
    import jax.numpy as jnp
    from differt.em import Material as DiffeRTMaterial

    permittivity = complex_permittivity(material, carrier_hz)
    sigma_s_m = conductivity_s_m(permittivity, carrier_hz)

    def properties(frequency_hz: Any) -> tuple[Any, Any]:
        shape = jnp.shape(frequency_hz)
        return jnp.full(shape, permittivity.real), jnp.full(shape, sigma_s_m)

    return DiffeRTMaterial(name=name, properties=properties, thickness=thickness_m)
