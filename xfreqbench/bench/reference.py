"""Reference channels of the shipped scenes: how they are made, stored and read.

They are computed in the plain way, by Sionna RT's public solver, at settings beyond the defaults. Other solvers and
settings are measured against them. Those of scenes with meshes are computed by solver `image`, at settings as far
beyond the defaults, because the public solver mirrors at every triangle.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from pydantic import TypeAdapter, ValidationError

from xfreqbench.errors import DataError
from xfreqbench.scene.meshes import meshes_sha256, surface_meshes
from xfreqbench.scene.model import Scene
from xfreqbench.scene.placement import choose_transmitters, place_transmitters
from xfreqbench.scene.visibility import sees
from xfreqbench.system.array_files import read_arrays
from xfreqbench.system.files import atomic_path, require_own, sole_writer, storage_errors
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.tracing.versions import software_versions
from xfreqbench.types import FloatArray, NDArray, ProgressCallback

REFERENCE_CARRIERS_HZ = (1e9, 10e9, 94e9)
REFERENCE_TRANSMITTERS = 24
REFERENCE_SETTINGS = TraceSettings(
    interactions=WITHOUT_DIFFRACTION,
    solver="sionna",
    rays=8 * TraceSettings().rays,
    max_depth=TraceSettings().max_depth + 1,
    seed=2,
)

_ADVICE = "Delete it, and make it again."


@dataclass(frozen=True)
class Reference:
    """Reference channels (T, F, M) of T transmitters at F carriers; `about` says how they were made."""

    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: Float[FloatArray, "F"]
    cfr: Complex[NDArray[np.complex128], "T F M"]
    about: dict[str, Any]


def reference_path(scene_name: str) -> Path:
    """The file with the reference of a shipped scene."""
    return Path(str(files("xfreqbench.scenes"))) / f"{scene_name}_reference.npz"


def read_reference(scene: Scene, path: Path | None = None) -> Reference:
    """The stored reference of a scene; raises `DataError` where it is missing, unfinished or of another scene."""
    path = path or reference_path(scene.name)
    if not path.exists():
        raise DataError(f"{path} does not exist. Make it with: xfreqbench bench reference {scene.name} (or its TOML)")
    reference = _read(path)
    if reference.about.get("scene_sha256") != meshes_sha256(surface_meshes(scene)):
        raise DataError(f"{path} was made of another version of {scene.name!r}. Delete it and make it again.")
    if not np.isfinite(reference.cfr).all():
        raise DataError(f"{path} is unfinished. Go on with: xfreqbench bench reference {scene.name}")
    return reference


def _read(path: Path) -> Reference:
    wanted = {"about": "text", "tx_position_m": "<f8 T 3", "carrier_hz": "<f8 F", "cfr": "<c16 T F M"}
    stored = read_arrays(path, wanted, _ADVICE)
    try:
        about = TypeAdapter(dict[str, Any]).validate_json(str(stored.pop("about")))
    except ValidationError as error:
        raise DataError(f"{path} does not tell how it was made. {_ADVICE}") from error
    return Reference(**stored, about=about)


def make_reference(scene: Scene, path: Path, progress: ProgressCallback) -> None:
    """Compute and store the reference, transmitter by transmitter; it continues what a killed run left.

    Raises `OutputExistsError` where the file holds a reference of another scene or other settings, and `StorageError`
    where another process makes it.
    """
    from xfreqbench.tracing.sionna.plain import plain_channel
    from xfreqbench.tracing.sionna.scene import roomy_hash_table

    asked = _empty_reference(scene)

    def fault_of(file: Path) -> str | None:
        differences = _differences(_read(file), asked)
        return f"holds a reference of something else: {'; '.join(differences)}" if differences else None

    with sole_writer(path):
        reference = _read(path) if require_own(path, fault_of) else asked
        if scene.scene is not None and np.isnan(reference.cfr).any():
            settings = replace(REFERENCE_SETTINGS, solver="image")
            tracer = tracer_of(scene, reference.carrier_hz.tolist(), settings)
            reference.cfr[:] = tracer.channel(reference.tx_position_m).cfr
            _write_reference(path, reference)
        missing = np.argwhere(np.isnan(reference.cfr[..., 0]))
        total = reference.cfr.shape[0] * reference.cfr.shape[1]
        progress(total - len(missing), total)
        of = REFERENCE_SETTINGS
        options = of.named_interactions, of.max_depth, of.rays, of.seed
        for done, (t, f) in enumerate(missing, start=total - len(missing) + 1):
            carrier_hz, tx_m = float(reference.carrier_hz[f]), reference.tx_position_m[t : t + 1]
            with roomy_hash_table():
                reference.cfr[t, f] = plain_channel(scene, carrier_hz, tx_m, *options)[0]
            _write_reference(path, reference)
            progress(done, total)


def _differences(stored: Reference, asked: Reference) -> list[str]:
    """In words, how the stored reference differs from the one asked for; versions of software do not count."""
    wanted = json.loads(json.dumps(asked.about))  # a tuple comes back as a list
    differences = [  # of what has to agree when a reference is continued
        f"{key} is {stored.about.get(key)!r}, not {wanted[key]!r}"
        for key in ("scene_sha256", "rays", "max_depth", "seed", "interactions")
        if stored.about.get(key) != wanted[key]
    ]
    if not np.array_equal(stored.carrier_hz, asked.carrier_hz):
        differences.append(f"carrier_hz is {stored.carrier_hz.tolist()}, not {asked.carrier_hz.tolist()}")
    if not np.array_equal(stored.tx_position_m, asked.tx_position_m):
        differences.append("the transmitters stand elsewhere")
    if stored.cfr.shape != asked.cfr.shape:
        differences.append(f"cfr has the shape {stored.cfr.shape}, not {asked.cfr.shape}")
    return differences


def _empty_reference(scene: Scene) -> Reference:
    """The reference that is asked for, with channels of NaN."""
    tx, has_meshes = _lit_and_shadowed(scene), scene.scene is not None
    shape = (len(tx), len(REFERENCE_CARRIERS_HZ), scene.receiver.num_elements)
    public = "public forward PathSolver(synthetic_array=False), one call per transmitter and carrier"
    about = {
        "way": "solver image" if has_meshes else f"{public}, hash table of 2^25 candidates",
        "scene_sha256": meshes_sha256(surface_meshes(scene)),
        "rays": REFERENCE_SETTINGS.rays,
        "max_depth": REFERENCE_SETTINGS.max_depth,
        "seed": REFERENCE_SETTINGS.seed,
        "interactions": REFERENCE_SETTINGS.named_interactions,
        "software": software_versions("image" if has_meshes else "sionna"),
    }
    return Reference(tx, np.array(REFERENCE_CARRIERS_HZ), np.full(shape, np.nan, np.complex128), about)


def _lit_and_shadowed(scene: Scene) -> Float[FloatArray, "T 3"]:
    """Positions of transmitters. Half of them see the receiver, or more if too few are in shadow."""
    meshes = surface_meshes(scene)
    usable = place_transmitters(scene.with_receiver(), meshes)
    lit = sees(meshes, usable.tx_position_m, np.asarray(scene.receiver.position_m))
    num_shadowed = min(REFERENCE_TRANSMITTERS // 2, int((~lit).sum()))
    kinds = ((lit, REFERENCE_TRANSMITTERS - num_shadowed), (~lit, num_shadowed))
    chosen = [
        choose_transmitters(replace(usable, tx_position_m=usable.tx_position_m[is_so]), number, REFERENCE_SETTINGS.seed)
        for is_so, number in kinds
        if number
    ]
    return np.concatenate(chosen)


def _write_reference(path: Path, reference: Reference) -> None:
    num_bytes = reference.cfr.nbytes
    with (
        atomic_path(path, num_bytes) as temporary,
        storage_errors(path, num_bytes),
        temporary.open("wb") as file,  # given a path, NumPy adds .npz to its name
    ):
        np.savez(file, **(vars(reference) | {"about": json.dumps(reference.about)}))
