"""What there is to see of a data set or of a scene: checked, and one transmitter's rays traced again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from jaxtyping import Float
from pydantic import TypeAdapter, ValidationError

from xfreqbench.angles import FloatArray
from xfreqbench.dataset import DatasetHeader, PasDataset, open_dataset
from xfreqbench.errors import SceneError, UnknownNameError, XFreqBenchError
from xfreqbench.findings import median_transmitter
from xfreqbench.generate import job_sha256, plan_generation
from xfreqbench.mesh import meshes_sha256, surface_meshes
from xfreqbench.scene import Scene, load_scene
from xfreqbench.solvers import make_tracer
from xfreqbench.tracing import TraceSettings
from xfreqbench.units import PAPER_CARRIERS_GHZ, format_ghz, ghz_to_hz
from xfreqbench.view_scene import Ray, Room, strongest_rays
from xfreqbench.view_summary import known_line_of_sight


@dataclass(frozen=True, eq=False)
class View:
    """A scene, a data set, or both; `carrier_hz` is the one at which rays are drawn.

    `header` is the data set's, or what `generate` would write of the scene. `scene` is None where the data
    do not tell of one, and `missing` then says why; `settings` are those of the rays, None without any.
    """

    header: DatasetHeader
    room: Room
    carrier_hz: float
    dataset: PasDataset | None
    scene: Scene | None
    settings: TraceSettings | None
    subject: str
    missing: str = ""

    def with_rays(self) -> View:
        """Trace the transmitter that is shown, which takes seconds; the same view where there is no scene."""
        if self.scene is None or self.settings is None:
            return self
        carriers = self.header.carrier_hz.tolist() if self.dataset else [self.carrier_hz]
        rays = _traced(self.scene, self.room, carriers, carriers.index(self.carrier_hz), self.settings)
        return replace(self, room=replace(self.room, rays=rays))


def plan_view(data_or_scene: str, tx: int | None = None, carrier_ghz: float | None = None) -> View:
    """Read a data set by its path, or a scene by its name or TOML, and check what is asked for; no rays yet.

    Without `tx` the transmitter nearest to the median of all is shown, without a carrier the middle one of
    the data's, for a scene of the paper's. Raises `DataError`, `SceneError`, or `UnknownNameError` for a
    transmitter or a carrier that is not there.
    """
    path = Path(data_or_scene)
    if path.suffix == ".toml" or not (path.suffix or path.is_file()):
        return _view_of_scene(load_scene(data_or_scene), tx, carrier_ghz)
    return _view_of_dataset(open_dataset(path), tx, carrier_ghz)


def _view_of_scene(scene: Scene, tx: int | None, carrier_ghz: float | None) -> View:
    """What a generation at the paper's carriers would start from; materials hold beyond their bands here."""
    paper_hz = [ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ]
    carrier_hz = _middle(paper_hz) if carrier_ghz is None else _parsed_hz(carrier_ghz)
    plan = plan_generation(scene, paper_hz, TraceSettings(materials="extrapolate"), maps=False)
    room = Room(
        receiver=scene.receiver,
        lowest_hz=min(paper_hz),
        tx_position_m=plan.tx_position_m,
        in_sight=plan.line_of_sight,
        tx=_chosen_tx(tx, plan.tx_position_m, f"scene {scene.name}"),
        meshes=plan.meshes,
        rays=[],
    )
    subject = job_sha256(plan.header, plan.tx_position_m)
    return View(plan.header, room, carrier_hz, None, scene, plan.settings, subject)


def _view_of_dataset(dataset: PasDataset, tx: int | None, carrier_ghz: float | None) -> View:
    header, position_m = dataset.header, dataset.tables["tx_position_m"]
    carrier_hz = _chosen_carrier_hz(carrier_ghz, header.carrier_hz.tolist())
    chosen = _chosen_tx(tx, position_m, dataset.path.name)
    scene, missing = None, ""
    try:
        scene = _scene_of(dataset)
    except SceneError as error:
        missing = str(error)
    settings = _settings_of(header)
    if scene and not settings:
        missing = "The data do not say how they were traced, so that no ray is drawn."
    room = Room(
        receiver=header.receiver,
        lowest_hz=float(header.carrier_hz.min()),
        tx_position_m=position_m,
        in_sight=known_line_of_sight(dataset),
        tx=chosen,
        meshes=surface_meshes(scene) if scene else [],
        rays=[],
    )
    return View(header, room, carrier_hz, dataset, scene, settings, dataset.sha256, missing)


def _scene_of(dataset: PasDataset) -> Scene:
    """The scene in the header, with meshes beside the data or in the working folder; raises `SceneError`."""
    header = dataset.header
    try:
        scene = TypeAdapter(Scene).validate_json(header.scene_json)
    except ValidationError as error:
        raise SceneError(
            "The data do not say which scene they are of, as data that others published. Without it no surface "
            "can be drawn and no ray traced: only the receiver and the transmitters are shown."
        ) from error
    for folder in (dataset.path.parent, Path.cwd()):
        placed = replace(scene, folder=folder)
        if _are_the_meshes(placed, header.scene_sha256):
            return placed
    raise SceneError(
        f"The surfaces of scene {header.scene_name!r} are not those that the data were traced among"
        + (f": {scene.scene} is missing or another. Put it beside the data." if scene.scene else ".")
        + " Only the receiver and the transmitters are shown."
    )


def _are_the_meshes(scene: Scene, sha256: str) -> bool:
    try:
        return meshes_sha256(surface_meshes(scene)) == sha256
    except SceneError:
        return False


def _settings_of(header: DatasetHeader) -> TraceSettings | None:
    """What was asked of the rays; None where the data do not say all of it."""
    names = [field.name for field in fields(TraceSettings)]
    try:
        told = {name: header.settings[name] for name in names}
        return TypeAdapter(TraceSettings).validate_python(told)
    except (KeyError, ValidationError):
        return None


def _traced(
    scene: Scene, room: Room, carrier_hz: list[float], index: int, settings: TraceSettings
) -> list[Ray]:
    """Rays of the transmitter at one of the carriers, from the solver and the settings of the data."""
    paths = make_tracer(scene, carrier_hz, settings).paths(room.tx_m)
    return strongest_rays(paths, index, room.tx_m, room.receiver_m, room.meshes)


def _chosen_tx(tx: int | None, position_m: Float[FloatArray, "T 3"], where: str) -> int:
    if tx is None:
        return median_transmitter(position_m)
    if not 0 <= tx < len(position_m):
        raise XFreqBenchError(
            f"{where} has transmitters 0 to {len(position_m) - 1}, but --tx {tx} is asked for."
        )
    return tx


def _chosen_carrier_hz(carrier_ghz: float | None, carriers_hz: list[float]) -> float:
    if carrier_ghz is None:
        return _middle(carriers_hz)
    carrier_hz = _parsed_hz(carrier_ghz)
    if carrier_hz not in carriers_hz:
        raise UnknownNameError("carrier", format_ghz(carrier_hz), map(format_ghz, carriers_hz))
    return carrier_hz


def _middle(carriers_hz: Sequence[float]) -> float:
    return carriers_hz[(len(carriers_hz) - 1) // 2]


def _parsed_hz(carrier_ghz: float) -> float:
    if not (math.isfinite(carrier_ghz) and ghz_to_hz(carrier_ghz) > 0):
        raise XFreqBenchError(f"--carrier takes a frequency in GHz, as in 24.25, but got {carrier_ghz:g}.")
    return ghz_to_hz(carrier_ghz)
