"""What is shown of a data set or a scene: its room, the transmitters, and the strongest rays of one, traced again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.recipe import Recipe
from xfreqbench.data.retrace import traced_scene
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.errors import DataError, SceneError, UnknownNameError, XFreqBenchError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.report.view.describe import known_line_of_sight
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.meshes import SurfaceMesh, surface_meshes
from xfreqbench.scene.model import ReceiverArray, Scene, load_scene
from xfreqbench.scene.placement import median_transmitter
from xfreqbench.tracing.paths import DIFFRACTION, DIFFUSE, NO_INTERACTION, REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import PAPER_CARRIERS_GHZ, format_ghz, ghz_to_hz

RAY_RANGE_DB = 30.0  # below the strongest ray; the range that pictures of maps have too
MAX_RAYS = 40


@dataclass(frozen=True, eq=False)
class Ray:
    """A path; its points run from the transmitter to the array centre.

    `level_db` is its power at one carrier relative to the strongest path, 0 or less. `events` say in turn what it
    meets, as in `reflected by ceiling`.
    """

    points_m: Float[FloatArray, "n 3"]
    level_db: float
    delay_s: float
    events: tuple[str, ...]

    @property
    def label(self) -> str:
        """What the ray meets, in words."""
        return "; ".join(self.events) or "line of sight"


@dataclass(frozen=True, eq=False)
class ShownRoom:
    """A scene with its receiver, T transmitters, and the rays of transmitter `tx`; positions in world axes.

    `in_sight` is None if the data do not say which transmitters the receiver sees. The array is drawn at the
    carrier `lowest_hz`, at which it is widest.
    """

    receiver: ReceiverArray
    lowest_hz: float
    tx_position_m: Float[FloatArray, "T 3"]
    in_sight: Bool[NDArray[np.bool_], "T"] | None
    tx: int
    meshes: Sequence[SurfaceMesh]
    rays: Sequence[Ray]

    @property
    def tx_m(self) -> Float[FloatArray, "3"]:
        """The position of the transmitter of the rays."""
        return self.tx_position_m[self.tx]

    @property
    def receiver_m(self) -> Float[FloatArray, "3"]:
        """Position of the array centre."""
        return np.array(self.receiver.position_m, dtype=np.float64)

    @property
    def boresight(self) -> Float[FloatArray, "3"]:
        """Unit vector along the boresight, which is the pole of the maps' hemisphere."""
        return self.receiver.rotation[:, 2]

    def groups(self) -> dict[str, Float[FloatArray, "N 3"]]:
        """Positions of the transmitters in sight and of those in shadow, or of all where that is not known; by name."""
        if self.in_sight is None:
            return {"transmitters": self.tx_position_m}
        lit, shadowed = self.tx_position_m[self.in_sight], self.tx_position_m[~self.in_sight]
        return {"transmitters in sight": lit, "transmitters in shadow": shadowed}


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """What is shown: a scene, a data set, or both; rays are drawn at `carrier_hz`.

    `header` is the data set's, or the one that `generate` would write for the scene. `scene` is None if the
    data do not hold it, `settings` of the tracing too; `missing` then says why. `subject` is a hash of what the view
    shows. `source` is the data set's file name, or the scene's name or path.
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
        paths = tracer_of(self.scene, carriers_hz, self.settings, Geometry(room.meshes)).paths(room.tx_m)
        index = carriers_hz.index(self.carrier_hz)
        return replace(self, room=replace(room, rays=_strongest_rays(paths, index, room)))


def plan_view(data_or_scene: str, tx: int | None = None, carrier_ghz: float | None = None) -> ViewPlan:
    """Read a data set by its path, or a scene by its name or TOML, and check what is asked for; no rays yet.

    Without `tx`, the transmitter nearest to the median of all positions is shown. Without `carrier_ghz`, rays are
    drawn at the middle one of the data's carriers; for a scene, of the paper's. Raises `DataError` for the data set,
    `SceneError` for the scene, `XFreqBenchError` for an unknown transmitter or a carrier that is not a frequency, and
    `UnknownNameError` for a carrier that the data set does not have.
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
        meshes=plan.tracing.geometry.meshes,
        rays=[],
    )
    recipe = Recipe.of_scene(scene, plan.tracing.settings, plan.header, plan.tx_position_m, AngularGrid.hemisphere())
    return ViewPlan(plan.header, room, carrier_hz, None, scene, plan.tracing.settings, recipe.sha256)


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


def _strongest_rays(paths: Paths, carrier_index: int, room: ShownRoom) -> list[Ray]:
    """At most `MAX_RAYS` paths within `RAY_RANGE_DB` of the strongest one at a carrier, the strongest first."""
    power = np.abs(paths.gain[carrier_index]) ** 2
    if not power.any():
        return []
    verbs = {SPECULAR: "reflected by", REFRACTION: "through", DIFFUSE: "scattered by", DIFFRACTION: "diffracted by"}
    kept = np.flatnonzero(power >= power.max() * 10 ** (-RAY_RANGE_DB / 10))
    rays = []
    for index in kept[np.argsort(-power[kept], kind="stable")][:MAX_RAYS].tolist():
        met = paths.interactions[index] != NO_INTERACTION
        codes, surfaces = (each[index][met].tolist() for each in (paths.interactions, paths.surfaces))
        rays.append(
            Ray(
                points_m=np.vstack([room.tx_m, paths.vertices_m[index][met], room.receiver_m]),
                level_db=10 * float(np.log10(float(power[index] / power.max()))),
                delay_s=float(paths.delay_s[index]),
                events=tuple(f"{verbs[code]} {room.meshes[at].name}" for code, at in zip(codes, surfaces, strict=True)),
            )
        )
    return rays
