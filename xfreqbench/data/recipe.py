"""The recipe of a data set: everything that determines its samples, as a hash that is the same on every machine."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import TypeAdapter

from xfreqbench.data.schema import DatasetHeader
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import Scene
from xfreqbench.system.files import json_sha256
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray

# Positions of transmitters are in the data, and their antenna is in the settings.
_NOT_PHYSICS = {"name", "description", "transmitters", "transmitter_polarization", "folder"}


@dataclass(frozen=True)
class Recipe:
    """Everything that determines a data set. Data of equal recipes have the same samples, up to the last digits.

    `sha256` is the hash of the recipe: of the physics, the carriers, the transmitters in their order, the
    directions of the maps and their kind. `physics_sha256` is the hash of what determines the channel of any
    transmitter at any carrier: the scene, the interactions with their greatest depth, the extrapolated materials, and
    the version of the physics. It is None if the data do not say how they were made, like data that others published:
    their content is their recipe, with `data` instead of the version of the physics.

    Solver, number of rays, seed, threads, processor and versions of software are in neither hash, because they change
    only the last digits. Only diffuse reflection is random: its seed is in both hashes, with the number of rays of
    solver `sionna`, or the name of solver `image`.
    """

    scene_name: str
    physics: str
    sha256: str
    physics_sha256: str | None = None

    @classmethod
    def of_scene(
        cls,
        scene: Scene,
        settings: TraceSettings,
        header: DatasetHeader,
        tx_position_m: Float[FloatArray, "T 3"],
        grid: AngularGrid,
    ) -> Recipe:
        """The recipe of channels that were traced in a scene; the rest is taken from the header."""
        drawn = "image" if settings.solver == "image" else settings.rays
        physics = json_sha256(
            {
                "version": header.physics,
                "scene": _scene_content(scene, header),
                "interactions": sorted(settings.named_interactions),
                "max_depth": settings.max_depth,
                "extrapolated_materials": header.settings.get("extrapolated_materials", []),
                "drawn": [drawn, settings.seed] if "diffuse" in settings.named_interactions else [],
            }
        )
        samples = {
            "physics": physics,
            "carrier_hz": header.carrier_hz.tolist(),
            "tx_position_um": micrometres(tx_position_m).tolist(),
            "directions_deg": [np.degrees(a).round(6).tolist() for a in (grid.elevation_rad, grid.azimuth_rad)],
            "pas_kind": header.pas_kind,
        }
        return cls(header.scene_name, header.physics, json_sha256(samples), physics)

    @property
    def id(self) -> str:
        """Physics version and whole hash, as in records: `2-3f9c…`."""
        return f"{self.physics}-{self.sha256}"

    @property
    def name(self) -> str:
        """Scene, physics version and the first digits of the hash, for users: `office@2-3f9c2ab1`."""
        return recipe_name(self.scene_name, self.id)

    def __str__(self) -> str:
        return self.name


def job_of(header: DatasetHeader, tx_position_m: Float[FloatArray, "T 3"]) -> dict[str, str]:
    """The job of a data set, by names such as `settings.seed`; long values are replaced by their hashes.

    Data of equal jobs have the same recipe, and are interchangeable: versions of software are left out, and fields of
    the scene's file that change no channel. Carriers and transmitters begin with their number.
    """
    content = {field.name: getattr(header, field.name) for field in fields(header)} | {
        "scene_json": json.loads(header.scene_json),
        "receiver": asdict(header.receiver),
        "carrier_hz": header.carrier_hz.tolist(),
        "tx_position_um": micrometres(tx_position_m).tolist(),
    }
    of_scene = (f"scene_json.{name}" for name in ("receiver", *_NOT_PHYSICS))
    left_out = ("software", "references", "rejected", *of_scene)
    numbers = {"carrier_hz": f"{len(header.carrier_hz)}: ", "tx_position_um": f"{len(tx_position_m)}: "}
    return {
        name: numbers.get(name, "")
        + (text if len(text) <= 40 else f"sha256 {hashlib.sha256(text.encode()).hexdigest()[:16]}")
        for name, text in _flat("", content)
        if not any(name == other or name.startswith(f"{other}.") for other in left_out)
    }


def job_differences(asked: Mapping[str, str], stored: Mapping[str, str]) -> str:
    """How a stored job differs from the one that is asked for: `5 carriers there, 1 here`; empty if they are equal."""
    there_and_here = {name: (stored.get(name, "none"), asked.get(name, "none")) for name in {**asked, **stored}}
    differing = {name: values for name, values in sorted(there_and_here.items()) if values[0] != values[1]}
    words = []
    if any(name.startswith("scene") for name in differing):
        there, here = there_and_here["scene_name"]
        words = [f"scene {there} there, {here} here" if there != here else f"another version of scene {there}"]
    for name, (there, here) in differing.items():
        what = {"carrier_hz": "carriers", "tx_position_um": "transmitters"}.get(name)
        if what:
            numbers = there.partition(":")[0], here.partition(":")[0]
            differ = numbers[0] != numbers[1]
            words += [f"{numbers[0]} {what} there, {numbers[1]} here" if differ else f"other {what} ({numbers[0]})"]
        elif not name.startswith("scene") and name != "num_tx":
            words += [f"{name.removeprefix('settings.')} {there} there, {here} here"]
    return "; ".join(words)


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """The values in nested dictionaries as texts, by names such as `settings.seed`."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _flat(f"{name}.{key}" if name else key, part)
    else:
        yield name, value if isinstance(value, str) else json.dumps(value, sort_keys=True)


def recipe_name(scene_name: str, recipe_id: str) -> str:
    """The name that is shown of a recipe, on one line, from the name of its scene and its `Recipe.id`."""
    physics, _, sha256 = recipe_id.partition("-")
    return f"{repr(scene_name)[1:-1]}@{physics}-{sha256[:8]}"


def micrometres(position_m: Float[FloatArray, "T 3"]) -> Any:
    """Positions in whole micrometres (T, 3): positions with equal numbers are the same place."""
    return np.rint(position_m * 1e6).astype(np.int64)


def _scene_content(scene: Scene, header: DatasetHeader) -> dict[str, Any]:
    """The fields of a scene's file that change a channel; for imported meshes the hash of all that rays can meet."""
    in_meshes = {"scene", "up", "mirrors", "least_patch_area_m2", "least_patch_width_m"}
    content = TypeAdapter(Scene).dump_python(scene, mode="json", exclude=_NOT_PHYSICS | in_meshes)
    content["receiver"].pop("name", None)
    for surface in content["surface"]:
        del surface["name"]
    meshes = {"meshes": header.scene_sha256, **scene.mirror_settings} if scene.scene else {}
    return content | meshes | scene.antenna_settings
