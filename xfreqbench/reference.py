"""Stored reference channels: the plain way, at settings beyond the defaults, for others to be measured by."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.errors import DataError
from xfreqbench.generate import ProgressCallback
from xfreqbench.mesh import meshes_sha256, sees, surface_meshes
from xfreqbench.placement import choose_transmitters, place_transmitters
from xfreqbench.provenance import software_versions
from xfreqbench.scene import Scene
from xfreqbench.tracing import TraceSettings

REFERENCE_CARRIERS_HZ = (1e9, 10e9, 94e9)
REFERENCE_TRANSMITTERS = 24
REFERENCE_SETTINGS = TraceSettings(
    solver="sionna", rays=8 * TraceSettings().rays, max_depth=TraceSettings().max_depth + 1, seed=2
)


@dataclass(frozen=True)
class Reference:
    """Channels of the plain way at settings beyond the defaults. (T, F, M)"""

    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    cfr: Complex[NDArray[np.complex128], "T F M"]
    about: dict[str, Any]


def reference_path(scene_name: str) -> Path:
    """Where the reference of a shipped scene is stored."""
    return Path(str(files("xfreqbench.scenes"))) / f"{scene_name}_reference.npz"


def read_reference(scene: Scene, path: Path | None = None) -> Reference:
    """The stored reference; raises `DataError` where it is missing, unfinished or of another scene."""
    path = path or reference_path(scene.name)
    if not path.exists():
        raise DataError(f"{path} does not exist. Make it with: xfreqbench bench reference {scene.name}")
    with np.load(path) as content:
        about = json.loads(str(content["about"]))
        reference = Reference(content["tx_position_m"], content["carrier_hz"], content["cfr"], about)
    if about["scene_sha256"] != meshes_sha256(surface_meshes(scene)):
        raise DataError(f"{path} was made of another version of {scene.name!r}. Delete it and make it anew.")
    if not np.isfinite(reference.cfr).all():
        raise DataError(f"{path} is unfinished. Go on with: xfreqbench bench reference {scene.name}")
    return reference


def make_reference(scene: Scene, path: Path, progress: ProgressCallback) -> None:
    """Compute and store the reference, transmitter by transmitter; a killed run goes on."""
    from xfreqbench.sionna_plain import plain_channel
    from xfreqbench.sionna_scene import roomy_hash_table

    reference = _unfinished_reference(scene, path)
    missing = np.argwhere(np.isnan(reference.cfr[..., 0]))
    total = reference.cfr.shape[0] * reference.cfr.shape[1]
    progress(total - len(missing), total)
    for done, (t, f) in enumerate(missing, start=total - len(missing) + 1):
        with roomy_hash_table():
            reference.cfr[t, f] = plain_channel(
                scene,
                float(reference.carrier_hz[f]),
                reference.tx_position_m[t : t + 1],
                REFERENCE_SETTINGS.interactions,
                REFERENCE_SETTINGS.max_depth,
                REFERENCE_SETTINGS.rays,
                REFERENCE_SETTINGS.seed,
            )[0]
        _write_reference(path, reference)
        progress(done, total)


def _unfinished_reference(scene: Scene, path: Path) -> Reference:
    if path.exists():
        with np.load(path) as content:
            about = json.loads(str(content["about"]))
            return Reference(content["tx_position_m"], content["carrier_hz"], content["cfr"], about)
    tx = _lit_and_shadowed(scene)
    shape = (len(tx), len(REFERENCE_CARRIERS_HZ), scene.receiver.num_elements)
    about = {
        "way": "public forward PathSolver(synthetic_array=False), one call per transmitter and carrier, "
        "hash table of 2^25 candidates",
        "scene_sha256": meshes_sha256(surface_meshes(scene)),
        "rays": REFERENCE_SETTINGS.rays,
        "max_depth": REFERENCE_SETTINGS.max_depth,
        "seed": REFERENCE_SETTINGS.seed,
        "interactions": REFERENCE_SETTINGS.interactions,
        "software": software_versions("sionna"),
    }
    return Reference(tx, np.array(REFERENCE_CARRIERS_HZ), np.full(shape, np.nan, np.complex128), about)


def _lit_and_shadowed(scene: Scene) -> Float[FloatArray, "T 3"]:
    """Half of the transmitters in sight of the receiver, half out of it."""
    meshes = surface_meshes(scene)
    usable = place_transmitters(scene, meshes)
    lit = sees(meshes, usable.tx_position_m, np.asarray(scene.receiver.position_m))
    half = REFERENCE_TRANSMITTERS // 2
    kinds = (replace(usable, tx_position_m=usable.tx_position_m[which]) for which in (lit, ~lit))
    return np.concatenate([choose_transmitters(kind, half, REFERENCE_SETTINGS.seed) for kind in kinds])


def _write_reference(path: Path, reference: Reference) -> None:
    temporary = path.with_suffix(".writing.npz")
    np.savez(
        temporary,
        tx_position_m=reference.tx_position_m,
        carrier_hz=reference.carrier_hz,
        cfr=reference.cfr,
        about=json.dumps(reference.about),
    )
    temporary.replace(path)
