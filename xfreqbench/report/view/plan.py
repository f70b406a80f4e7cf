"""Reads and checks what is to be shown of a data set or a scene, and traces one transmitter's rays again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.recipe import Recipe
from xfreqbench.data.retrace import traced_scene
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.errors import DataError, SceneError, UnknownNameError, XFreqBenchError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.report.view.room import ShownRoom, strongest_rays
from xfreqbench.report.view.summary import known_line_of_sight
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.scene.placement import median_transmitter
from xfreqbench.scene.prepared import PreparedScene
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray
from xfreqbench.units import PAPER_CARRIERS_GHZ, format_ghz, ghz_to_hz


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """What is shown: a scene, a data set, or both; rays are drawn at `carrier_hz`.

    `header` is the data set's, or the one that `generate` would write for the scene. `scene` is None where the
    data do not hold it, `settings` of the tracing too; `missing` then says why. `subject` is a hash that tells
    apart what different views are about. `source` is the data set's file name, or the scene's name or path.
    """

    header: DatasetHeader
    room: ShownRoom
    carrier_hz: float
    dataset: PasDataset | None
    scene: Scene | None
    settings: TraceSettings | None
    subject: str
    missing: str = ""
    source: str = ""

    @property
    def is_traceable(self) -> bool:
        """Whether scene and settings are known, so that rays can be traced."""
        return self.scene is not None and self.settings is not None

    def with_rays(self) -> ViewPlan:
        """The same view with the rays of its transmitter; unchanged where scene or settings are not known.

        Solver and settings are those of the data. Tracing takes seconds.
        """
        if self.scene is None or self.settings is None:
            return self
        room = self.room
        carriers_hz = self.header.carrier_hz.tolist() if self.dataset else [self.carrier_hz]
        prepared = PreparedScene(self.scene, Geometry(room.meshes))
        paths = tracer_of(prepared, carriers_hz, self.settings).paths(room.tx_m)
        index = carriers_hz.index(self.carrier_hz)
        rays = strongest_rays(paths, index, room.tx_m, room.receiver_m, room.meshes)
        return replace(self, room=replace(room, rays=rays))


def plan_view(data_or_scene: str, tx: int | None = None, carrier_ghz: float | None = None) -> ViewPlan:
    """Read a data set by its path, or a scene by its name or TOML, and check what is asked for; no rays yet.

    Without `tx`, the transmitter nearest to the median of all positions is shown. Without `carrier_ghz`, rays are
    drawn at the middle one of the data's carriers; for a scene, of the paper's. Raises `DataError` for the data set,
    `SceneError` for the scene, `XFreqBenchError` for a transmitter that is not there or a carrier that is no
    frequency, and `UnknownNameError` for a carrier that the data set does not have.
    """
    path = Path(data_or_scene)
    if path.suffix == ".toml" or not (path.suffix or path.is_file()):
        return replace(_view_of_scene(load_scene(data_or_scene), tx, carrier_ghz), source=data_or_scene)
    return replace(_view_of_dataset(open_dataset(path), tx, carrier_ghz), source=path.name)


def _view_of_scene(scene: Scene, tx: int | None, carrier_ghz: float | None) -> ViewPlan:
    """What `generate` would trace at the paper's carriers; materials are extrapolated beyond their P.2040 bands."""
    paper_hz = [ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ]
    carrier_hz = _chosen_hz(carrier_ghz, paper_hz)
    plan = plan_generation(scene, GenerateOptions(materials="extrapolate", maps=False))
    room = ShownRoom(
        receiver=scene.receiver,
        lowest_hz=min(paper_hz),
        tx_position_m=plan.tx_position_m,
        in_sight=plan.line_of_sight,
        tx=_chosen_tx(tx, plan.tx_position_m, f"scene {scene.name}"),
        meshes=plan.geometry.meshes,
        rays=[],
    )
    recipe = Recipe.of_scene(scene, plan.settings, plan.header, plan.tx_position_m, AngularGrid.hemisphere())
    return ViewPlan(plan.header, room, carrier_hz, None, scene, plan.settings, recipe.sha256)


def _view_of_dataset(dataset: PasDataset, tx: int | None, carrier_ghz: float | None) -> ViewPlan:
    header, position_m = dataset.header, dataset.tables["tx_position_m"]
    carriers_hz = header.carrier_hz.tolist()
    carrier_hz = _chosen_hz(carrier_ghz, carriers_hz)
    if carrier_hz not in carriers_hz:
        raise UnknownNameError("carrier", format_ghz(carrier_hz), map(format_ghz, carriers_hz))
    chosen = _chosen_tx(tx, position_m, dataset.path.name)
    scene, settings, missing = None, None, ""
    try:
        scene = traced_scene(dataset)
    except (DataError, SceneError) as error:
        missing = f"{error} Only the receiver and the transmitters are shown."
    try:
        settings = dataset.trace_settings
    except DataError:
        missing = missing or "The data do not say how they were traced, so that no ray is drawn."
    room = ShownRoom(
        receiver=header.receiver,
        lowest_hz=float(header.carrier_hz.min()),
        tx_position_m=position_m,
        in_sight=known_line_of_sight(dataset),
        tx=chosen,
        meshes=surface_meshes(scene) if scene else [],
        rays=[],
    )
    return ViewPlan(header, room, carrier_hz, dataset, scene, settings, dataset.sha256, missing)


def _chosen_tx(tx: int | None, position_m: Float[FloatArray, "T 3"], where: str) -> int:
    if tx is None:
        return median_transmitter(position_m)
    if not 0 <= tx < len(position_m):
        raise XFreqBenchError(f"{where} has transmitters 0 to {len(position_m) - 1}, but --tx {tx} is asked for.")
    return tx


def _chosen_hz(carrier_ghz: float | None, carriers_hz: Sequence[float]) -> float:
    """The carrier that is asked for, by default the middle one of some."""
    if carrier_ghz is None:
        return carriers_hz[(len(carriers_hz) - 1) // 2]
    try:
        return ghz_to_hz(carrier_ghz)
    except ValueError as error:
        raise XFreqBenchError(f"--carrier cannot use {carrier_ghz:g}: {error}.") from error
