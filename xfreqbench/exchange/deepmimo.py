"""Paths as scenarios of DeepMIMO v4: a folder of arrays for each carrier, as the package `deepmimo` loads them.

DeepMIMO has base stations that transmit and users that receive. The array is its base station here, and the
transmitters are its users: the channel is the same in both directions. So departure and arrival are exchanged, and
interactions are listed in reverse order.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset, open_dataset, stored_paths
from xfreqbench.data.retrace import traced_scene
from xfreqbench.exchange.path_arrays import PaddedPaths, carrier_names
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import MaterialPolicy, complex_permittivity, conductivity_s_m
from xfreqbench.scene.meshes import SurfaceMesh, slabs_of, surface_meshes
from xfreqbench.system.files import atomic_folder, require_empty, storage_errors
from xfreqbench.tracing.paths import DIFFRACTION, DIFFUSE, REFRACTION, SPECULAR, RaggedPaths
from xfreqbench.types import FloatArray, ProgressCallback, ignore_progress

# DeepMIMO's codes of interactions.
DIGITS = {SPECULAR: 1, DIFFRACTION: 2, DIFFUSE: 3, REFRACTION: 4}


def export_deepmimo(path: Path, folder: Path, progress: ProgressCallback = ignore_progress) -> PasDataset:
    """Write the paths of the data set at `path` as scenarios `SCENE_24.25ghz`, … in a folder; returns the data set.

    A user's paths come with the strongest first; paths without any power are left out. Powers are in dB of received
    over transmitted power; phases, in degrees, include exp(−j2πfτ), because `deepmimo` adds only the phase over the
    subcarriers; angles are in degrees, elevations counted from the z axis, as its converters do.

    `progress` is called with the number of carriers that are done and of all. Raises `OutputExistsError` unless
    `folder` is absent or empty, `DataError` if no paths or no scene are stored, `SceneError` if meshes are missing, and
    `StorageError`.
    """
    require_empty(folder)
    dataset = open_dataset(path)
    paths, _ = stored_paths(dataset)
    meshes = surface_meshes(traced_scene(dataset))
    with atomic_folder(folder) as temporary, storage_errors(folder):
        for carrier, carrier_hz, name in carrier_names(dataset):
            scenario = temporary / name
            scenario.mkdir()
            tables = _tables(paths, carrier, carrier_hz)
            tables["rx_pos"] = dataset.tables["tx_position_m"]
            tables["tx_pos"] = np.array([dataset.header.receiver.position_m])
            for key, table in tables.items():  # of transmitter 0 of set 0, and the receivers of set 1
                np.savez_compressed(scenario / f"{key}_t000_tx000_r001.npz", **{key: table})
            scene = _write_scene(scenario, meshes)
            num_heard = int((~np.isnan(tables["power"])).any(axis=1).sum())
            shared = {
                "num_ant": 1,
                "dual_pol": False,
                "ant_rel_positions": [[0, 0, 0]],
                "array_orientation": [0, 0, 0],
                "grid_spacing": None,
            }
            station = {"name": "array", "id": 0, "id_orig": 0, "is_tx": True, "is_rx": False}
            station |= {"num_points": 1, "num_active_points": 1}
            users = {"name": "transmitters", "id": 1, "id_orig": 1, "is_tx": False, "is_rx": True}
            users |= {"num_points": dataset.header.num_tx, "num_active_points": num_heard}
            parameters = {
                "version": "4.0.5",  # of the package whose files these are
                "rt_params": _tracing(dataset, carrier_hz),
                "txrx_sets": {"txrx_set_0": station | shared, "txrx_set_1": users | shared},
                "materials": _materials(slabs_of(meshes), carrier_hz, dataset.trace_settings.materials),
                "scene": scene,
            }
            (scenario / "params.json").write_text(json.dumps(parameters, indent=2), encoding="utf-8")
            progress(carrier + 1, dataset.header.num_carriers)
    return dataset


def _tables(paths: RaggedPaths, carrier: int, carrier_hz: float) -> dict[str, Any]:
    """DeepMIMO's matrices of all users, (T, L) and more, padded with NaN."""
    padded = PaddedPaths(paths, carrier, strongest_first=True)
    gain, nan = padded.gain, np.nan
    with np.errstate(divide="ignore"):
        power_db = np.where(gain == 0, nan, 20 * np.log10(np.abs(gain)))
    phase = np.angle(gain * np.exp(-2j * np.pi * (carrier_hz * paths.delay_s % 1.0)))
    digit = np.zeros(max(DIGITS) + 1)
    digit[list(DIGITS)] = list(DIGITS.values())
    digits = padded.of_interactions(digit[paths.interaction], 0.0, backwards=True)
    num_left = (digits > 0).sum(axis=2, keepdims=True) - 1 - np.arange(padded.depth)
    tables = {
        "power": padded.of_paths(power_db, nan),
        "phase": padded.of_paths(np.degrees(phase), nan),
        "delay": padded.of_paths(paths.delay_s, nan),
        "aoa_az": padded.of_paths(np.degrees(paths.departure_azimuth_rad), nan),
        "aoa_el": np.degrees(padded.zenith_rad(paths.departure_elevation_rad, nan)),
        "aod_az": padded.of_paths(np.degrees(paths.arrival_azimuth_rad), nan),
        "aod_el": np.degrees(padded.zenith_rad(paths.arrival_elevation_rad, nan)),
        "inter": (digits * 10.0 ** num_left.clip(0)).sum(axis=2),  # read from the left: 14 is 1, then 4
    }
    tables["inter_pos"] = padded.of_interactions(paths.vertex_m, nan, backwards=True)
    for table in tables.values():
        table[np.isnan(tables["power"])] = nan
    return tables


def _tracing(dataset: PasDataset, carrier_hz: float) -> dict[str, Any]:
    settings = dataset.trace_settings
    named = settings.named_interactions
    return {
        "raytracer_name": f"xfreqbench, solver {settings.solver}",
        "raytracer_version": metadata.version("xfreqbench"),
        "frequency": carrier_hz,
        "max_path_depth": settings.max_depth,
        "max_reflections": settings.max_depth if "specular" in named else 0,
        "max_transmissions": settings.max_depth if "refraction" in named else 0,
        "max_diffractions": int("diffraction" in named),
        "max_scattering": int("diffuse" in named),
        "diffuse_reflections": settings.max_depth if "diffuse" in named else 0,
        **dict.fromkeys(("diffuse_diffractions", "diffuse_transmissions"), 0),
        **dict.fromkeys(("diffuse_final_interaction_only", "diffuse_random_phases"), False),
        **dict.fromkeys(("terrain_reflection", "terrain_diffraction", "terrain_scattering"), False),
        "num_rays": settings.rays,
        "ray_casting_method": "uniform",
        "ray_casting_range_az": 360.0,
        "ray_casting_range_el": 180.0,
        "synthetic_array": True,
        "gps_bbox": [0, 0, 0, 0],
        "raw_params": {"dataset_sha256": dataset.sha256},
    }


def _materials(slabs: Sequence[Slab], carrier_hz: float, policy: MaterialPolicy) -> dict[str, dict[str, Any]]:
    """What the surfaces are made of at one carrier, by number."""
    materials = {}
    for number, slab in enumerate(slabs):
        permittivity = complex(np.nan, np.nan)  # of layers, which their names list
        if len(slab.layers) == 1:
            permittivity = complex_permittivity(slab.homogeneous, carrier_hz, policy)
        materials[f"material_{number}"] = {
            "id": number,
            "name": str(slab.material),
            "permittivity": permittivity.real,
            "conductivity": conductivity_s_m(permittivity, carrier_hz),
            "thickness": slab.thickness_m,
        }
    return materials


def _write_scene(folder: Path, meshes: Sequence[SurfaceMesh]) -> dict[str, Any]:
    """Write the triangles as DeepMIMO's lossless meshes, one object a surface, and return their numbers."""
    slabs = slabs_of(meshes)
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    faces: dict[str, Any] = {str(n): (mesh.triangles + first[n]).astype(np.int32) for n, mesh in enumerate(meshes)}
    made_of: dict[str, Any] = {
        str(n): np.full(len(mesh.triangles), slabs.index(mesh.slab)) for n, mesh in enumerate(meshes)
    }
    vertices_m: Float[FloatArray, "V 3"] = np.concatenate([np.zeros((0, 3)), *(mesh.vertices_m for mesh in meshes)])
    objects = [{"name": mesh.name, "label": "objects", "id": n, "mesh_key": str(n)} for n, mesh in enumerate(meshes)]
    np.savez_compressed(folder / "vertices.npz", vertices=vertices_m)
    np.savez_compressed(folder / "faces.npz", **faces)
    np.savez_compressed(folder / "materials.npz", **made_of)
    (folder / "objects.json").write_text(json.dumps(objects, indent=2), encoding="utf-8")
    num_faces = sum(len(mesh.triangles) for mesh in meshes)
    return {
        "num_scenes": 1,
        "n_objects": len(meshes),
        "n_vertices": len(vertices_m),
        "n_faces": num_faces,
        "n_triangular_faces": num_faces,
        "representation": "mesh",
    }
