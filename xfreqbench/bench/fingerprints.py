"""Makes the fingerprints of scenes: see `xfreqbench.data.fingerprint`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from xfreqbench.data.fingerprint import read_fingerprint
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.recipe import Recipe
from xfreqbench.data.trace import traced
from xfreqbench.errors import DataError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene
from xfreqbench.scene.placement import choose_transmitters, place_transmitters
from xfreqbench.system.files import atomic_path, require_own, storage_errors
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, ProgressCallback
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

NUM_TRANSMITTERS = 64


def make_fingerprint(
    scene: Scene, path: Path, progress: ProgressCallback, interactions: Iterable[str] | None = None
) -> None:
    """Trace a scene with the default settings at up to 64 transmitters and the paper's carriers, and store that.

    Where no interactions are named they are those of ground truth, as for `generate`.

    A file that holds this scene's fingerprint stays as it is. Raises `OutputExistsError` for one that holds anything
    else, `StorageError`, and as `plan_generation` does.
    """
    carriers_hz = [ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ]
    names = None if interactions is None else tuple(interactions)
    options = GenerateOptions(interactions=names, tx_positions=_chosen(scene, min(carriers_hz)))
    plan = plan_generation(scene, options)
    header = plan.header
    recipe = Recipe.of_scene(
        plan.tracing.scene, plan.tracing.settings, header, plan.tx_position_m, AngularGrid.hemisphere()
    )

    def fault_of(file: Path) -> str | None:
        try:
            same = read_fingerprint(file).physics_sha256 == recipe.physics_sha256
        except DataError as error:
            return f"holds no fingerprint: {error}"
        return None if same else "holds the fingerprint of another scene, or of other physics"

    if require_own(path, fault_of):
        return
    rows = []
    for tx in range(len(plan.tx_position_m)):
        progress(tx, len(plan.tx_position_m))
        rows.append(traced(plan.tracing, (tx, plan.tx_position_m[tx : tx + 1])).cfr)
    cfr = np.concatenate(rows).astype(np.complex64)
    about = {"scene": scene.name, "physics_sha256": recipe.physics_sha256, "software": header.software}
    with (
        atomic_path(path, cfr.nbytes) as temporary,
        storage_errors(path, cfr.nbytes),
        temporary.open("wb") as file,  # given a path, NumPy adds .npz to its name
    ):
        np.savez_compressed(
            file, tx_position_m=plan.tx_position_m, carrier_hz=header.carrier_hz, cfr=cfr, about=json.dumps(about)
        )
    progress(len(rows), len(rows))


def _chosen(scene: Scene, lowest_carrier_hz: float) -> Float[FloatArray, "T 3"]:
    """Up to 64 positions of a scene's grid: those that `generate --tx 24` takes, then those of `--tx 48`."""
    usable = place_transmitters(scene.with_receiver(), surface_meshes(scene), lowest_carrier_hz)
    seed, most = TraceSettings().seed, len(usable.tx_position_m)
    # what documents give to `--tx`: small data sets then have transmitters of the fingerprint
    choices = [choose_transmitters(usable, min(number, most), seed).tolist() for number in (24, 48)]
    distinct = dict.fromkeys(tuple(place) for choice in choices for place in choice)
    return np.array(list(distinct)[:NUM_TRANSMITTERS])
