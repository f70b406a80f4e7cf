"""Generates collections: one job a room, which draws it from a family, traces it and returns its data set's bytes."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, InstanceOf, PositiveInt, TypeAdapter

from xfreqbench.data.collection import FILE, Collection, Room, entry_of, open_collection, room_of, write_collection
from xfreqbench.data.dataset import open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.data.recipe import job_differences
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.scene.drawn_rooms import draw_room, room_name
from xfreqbench.scene.families import Family, load_family
from xfreqbench.scene.materials import MaterialPolicy
from xfreqbench.system.arguments import CarriersGhz, FilePath, Texts, Word, checked
from xfreqbench.system.bars import Shown, announcing, progress_bars
from xfreqbench.system.files import atomic_path, sole_writer, storage_errors
from xfreqbench.system.processes import SERIAL, open_workers
from xfreqbench.system.workers import Workers, side_by_side
from xfreqbench.tracing.solvers import interactions_named
from xfreqbench.tracing.tracer import SolverName, TraceSettings
from xfreqbench.tracing.versions import PHYSICS_VERSION
from xfreqbench.types import ProgressCallback, ignore_progress
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

MAX_DEPTH, RAYS = 4, 50_000  # of a room by default: a fifth of the time that a scene's defaults take
_SHOWN = 5  # names of files in a message
Seed = Annotated[int, Field(ge=0, lt=2**31)]


@dataclass(frozen=True)
class RoomsPlan:
    """What is asked for: rooms of a family by their seeds, and what of the rays and of the files."""

    family: Family
    seeds: range
    carrier_hz: tuple[float, ...]
    settings: TraceSettings
    tx: int = 120
    pas_kind: str = "power"
    maps: bool = False
    paths: bool = False
    polarization: tuple[str, ...] | None = None

    @property
    def options(self) -> dict[str, Any]:
        """What all rooms have in common, as JSON holds it."""
        settings = {name: value for name, value in asdict(self.settings).items() if name != "seed"}
        told = {"tx": self.tx, "pas_kind": self.pas_kind, "maps": self.maps, "paths": self.paths}
        return TypeAdapter(dict[str, Any]).dump_python(
            {**told, "polarization": self.polarization, **settings}, mode="json"
        )

    def file_of(self, seed: int) -> str:
        """The file of a room within the folder."""
        return f"{seed // 1000:03d}/{seed:06d}.h5"


@checked
def generate_rooms(
    family: FilePath | InstanceOf[Family],
    output: FilePath,
    freqs_ghz: CarriersGhz = PAPER_CARRIERS_GHZ,
    *,
    rooms: PositiveInt,
    tx: PositiveInt = 120,
    solver: SolverName = "auto",
    interactions: Texts | None = None,
    rays: int = RAYS,
    max_depth: int = MAX_DEPTH,
    seed: Seed = 1,
    pas_kind: str = "power",
    materials: MaterialPolicy = "error",
    maps: bool = False,
    paths: bool = False,
    polarization: Texts | None = None,
    executor: Word = SERIAL,
    progress: Shown = "auto",
    tell: Callable[[str], None] | None = None,
) -> Collection:
    """Draw rooms from a family, trace each, write their data sets to the folder `output`, and open the collection.

    `family` is a shipped family's name, the path of its TOML, or a `Family`. The rooms are those of `rooms` seeds from
    `seed` on, each with `tx` transmitters. The other options are those of `generate`; each room is a job of its own,
    made by the processes or workers that `executor` names.

    The same call goes on where a killed one stopped, and gives the same bytes. Rooms whose data sets are damaged or
    lost are named to `tell`, and made again. A call with more rooms adds them. Raises what `generate`
    raises, and `OutputExistsError` where the folder holds rooms of another family or with other options.
    """
    settings = TraceSettings(solver, interactions_named(interactions), max_depth, rays, materials=materials)
    files: dict[str, Any] = {"pas_kind": pas_kind, "maps": maps, "paths": paths, "polarization": polarization}
    with announcing(progress) as is_shown:
        plan = plan_of_rooms(family, freqs_ghz, settings, rooms=rooms, seed=seed, tx=tx, **files)
        with open_workers(executor) as workers, progress_bars("rooms", ["tracing"], not is_shown) as (report,):
            return generate_planned_rooms(plan, Path(output), workers, report, tell or (lambda text: None))


@checked
def plan_of_rooms(
    family: FilePath | InstanceOf[Family],
    freqs_ghz: CarriersGhz,
    settings: InstanceOf[TraceSettings],
    *,
    rooms: PositiveInt,
    seed: Seed = 1,
    tx: PositiveInt = 120,
    polarization: Texts | None = None,
    **files: Any,
) -> RoomsPlan:
    """The plan of rooms of the seeds from `seed` on; its first room is checked as a scene is.

    `files` are `pas_kind`, `maps` and `paths` as `generate_rooms` takes them. Raises what `generate_rooms` raises.
    """
    known = family if isinstance(family, Family) else load_family(family)
    carrier_hz = tuple(sorted(map(ghz_to_hz, freqs_ghz)))
    pairs = None if polarization is None else tuple(polarization)
    plan = RoomsPlan(known, range(seed, seed + rooms), carrier_hz, settings, tx, polarization=pairs, **files)
    _, first = _planned(plan, seed)
    return replace(plan, settings=first.settings)


def generate_planned_rooms(
    plan: RoomsPlan,
    folder: Path,
    workers: Workers,
    progress: ProgressCallback = ignore_progress,
    tell: Callable[[str], None] = lambda text: None,
) -> Collection:
    """Make the rooms of a plan that the folder does not hold yet, then describe all of them; see `generate_rooms`."""
    with sole_writer(folder / FILE):
        before = _claim(plan, folder)
        seeds = sorted({*plan.seeds, *(room.seed for room in before)})
        kept = {seed: room for seed in seeds if (room := _kept(plan, folder, seed))}
        missing = [seed for seed in seeds if seed not in kept]
        known = {room.file for room in before}
        lost = [file for file in map(plan.file_of, missing) if file in known or (folder / file).exists()]
        if lost:
            shown = ", ".join(lost[:_SHOWN]) + ", …" * (len(lost) > _SHOWN)
            tell(f"missing or damaged, and made again: {len(lost)} of {len(seeds)} rooms, {shown}")
        progress(len(kept), len(seeds))
        for seed, made in side_by_side(workers, partial(made_room, plan), missing, ahead=1):
            path, (kind, content) = folder / plan.file_of(seed), made.result()
            with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
                temporary.write_bytes(content)
            kept[seed] = room_of(folder, plan.file_of(seed), seed, kind)
            progress(len(kept), len(seeds))
        rooms = [kept[seed] for seed in seeds]
        return open_collection(folder) if list(before) == rooms else _describe(plan, folder, rooms)


def made_room(plan: RoomsPlan, seed: int) -> tuple[str, bytes]:
    """Type and data set of a room, as the bytes of a file, which a worker writes in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.h5"
        kind, planned = _planned(plan, seed)
        generate_planned(planned, path)
        return kind, path.read_bytes()


def estimate_rooms(plan: RoomsPlan, probes: int = 3) -> tuple[float, float]:
    """Seconds that one core takes for all rooms, and their bytes, from a few rooms that are made and thrown away."""
    made_room(replace(plan, tx=2), plan.seeds[0])  # what has to be compiled
    seconds, sizes = list[float](), list[int]()
    for seed in plan.seeds[:probes]:
        start = time.process_time()
        sizes.append(len(made_room(plan, seed)[1]))
        seconds.append(time.process_time() - start)
    return statistics.mean(seconds) * len(plan.seeds), statistics.mean(sizes) * len(plan.seeds)


def _planned(plan: RoomsPlan, seed: int) -> tuple[str, Plan]:
    """Type of a room, and the plan of its generation."""
    room = draw_room(plan.family, seed)
    return room.type.name, plan_generation(
        room.scene,
        plan.carrier_hz,
        replace(plan.settings, seed=seed),
        tx_position_m=room.transmitters(plan.tx),
        pas_kind=plan.pas_kind,
        maps=plan.maps,
        paths=plan.paths,
        polarizations=plan.polarization,
    )


def _claim(plan: RoomsPlan, folder: Path) -> tuple[Room, ...]:
    """Describe the rooms of a plan in the folder, none of them yet, or return those that it is known to hold.

    Raises `OutputExistsError` where these are of another family, or were made with other options.
    """
    with storage_errors(folder):
        is_described, content = (folder / FILE).exists(), sorted(each.name for each in folder.iterdir())
    if not is_described:
        if foreign := [name for name in content if not name.startswith(f".{FILE}.")]:
            raise OutputExistsError(f"{folder} holds {foreign[0]!r} and no {FILE}. Choose another folder with -o.")
        _describe(plan, folder, [])
        return ()
    found = open_collection(folder).record
    asked = {"family": f"{plan.family.name} ({plan.family.sha256[:8]})", **plan.options}
    holds = {"family": f"{found.name} ({found.family_sha256[:8]})", **found.options}
    for job, carrier_hz in ((asked, plan.carrier_hz), (holds, found.carrier_hz)):
        job["carrier_hz"] = f"{len(carrier_hz)}: {carrier_hz}"
    texts = [{name: str(value) for name, value in each.items()} for each in (asked, holds)]
    if differing := job_differences(*texts):
        raise OutputExistsError(
            f"{folder} exists and holds other rooms: {differing}. Choose another folder with -o, or delete it."
        )
    return found.rooms


def _kept(plan: RoomsPlan, folder: Path, seed: int) -> Room | None:
    """The entry of a room that is there, with its hash; None where it is missing or damaged.

    Raises `OutputExistsError` where another data set is in its place, or one of another version of the physics.
    """
    file, kind = plan.file_of(seed), plan.family.type_of(seed).name
    try:
        verify(folder / file)
        dataset = open_dataset(folder / file)
    except DataError:
        return None
    found = dataset.header.scene_name, dataset.header.physics
    if found != (room_name(plan.family, seed), PHYSICS_VERSION):
        raise OutputExistsError(
            f"{folder / file} holds {found[0]!r} by version {found[1]} of the physics, not the room of that seed by "
            f"version {PHYSICS_VERSION}. Choose another folder with -o, or delete it."
        )
    return entry_of(dataset, file, seed, kind)


def _describe(plan: RoomsPlan, folder: Path, rooms: Sequence[Room]) -> Collection:
    return write_collection(
        folder,
        rooms,
        name=plan.family.name,
        family=plan.family.recipe,
        options=plan.options,
        carrier_hz=plan.carrier_hz,
        held_out_types=plan.family.held_out_types,
    )
