"""Generates collections: one job a room, which draws the room from a family, traces it and returns its data set."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import InstanceOf, TypeAdapter

from xfreqbench.data.collection import FILE, Collection, Room, open_collection, room_of, write_collection
from xfreqbench.data.dataset import open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import Plan, plan_generation
from xfreqbench.data.recipe import job_differences
from xfreqbench.errors import ArgumentError, DataError, OutputExistsError
from xfreqbench.scene.drawn_rooms import draw_room, room_name
from xfreqbench.scene.families import Family, load_family
from xfreqbench.system.arguments import FilePath, taking
from xfreqbench.system.bars import announcing, progress_bars
from xfreqbench.system.files import atomic_path, sole_writer, storage_errors
from xfreqbench.system.processes import open_workers
from xfreqbench.system.workers import Workers, side_by_side
from xfreqbench.tracing.versions import PHYSICS_VERSION
from xfreqbench.types import ProgressCallback, ignore_progress
from xfreqbench.units import ghz_to_hz


@dataclass(frozen=True)
class RoomsPlan:
    """Rooms of a family, and the options of each, with the solver and the interactions of the first."""

    family: Family
    options: GenerateOptions

    @property
    def seeds(self) -> range:
        """The seeds of the rooms."""
        return range(self.options.seed, self.options.seed + (self.options.rooms or 0))

    @property
    def carrier_hz(self) -> tuple[float, ...]:
        """The carriers of all rooms in hertz, ascending."""
        return tuple(sorted(map(ghz_to_hz, self.options.freqs_ghz)))

    @property
    def common(self) -> dict[str, Any]:
        """The options that all rooms have in common, as for JSON."""
        names = ("tx", "pas_kind", "maps", "paths", "polarization", *asdict(self.options.settings))
        return TypeAdapter(dict[str, Any]).dump_python(
            {name: getattr(self.options, name) for name in names if name != "seed"}, mode="json"
        )

    def file_of(self, seed: int) -> str:
        """The file of a room within the folder."""
        return f"{seed // 1000:03d}/{seed:06d}.h5"


@taking(GenerateOptions, needed=("rooms",), without=("tx_positions", "receiver"))
def generate_rooms(family: FilePath | InstanceOf[Family], output: FilePath, options: GenerateOptions) -> Collection:
    """Draw rooms from a family, trace each, write their data sets to the folder `output`, and open the collection.

    `family` is a shipped family's name, the path of its TOML, or a `Family`. The rooms have the `rooms` seeds from
    `seed` on, and `tx` transmitters each. The other options are those of `generate`; each room is a job of its own for
    the processes or workers that `executor` names.

    The same call continues where a killed one stopped, and gives the same bytes. `tell` is called with the names of
    rooms whose data sets are damaged or lost; these are made again. A call with more rooms adds them. Raises what
    `generate` raises, and `OutputExistsError` if the folder holds rooms of another family or with other options.
    """
    with announcing(options.progress) as is_shown:
        plan = plan_rooms(family, options)
        with open_workers(options.executor) as workers, progress_bars("rooms", ["tracing"], not is_shown) as (report,):
            return generate_planned_rooms(plan, Path(output), workers, report, options.tell or (lambda text: None))


def plan_rooms(family: str | Path | Family, options: GenerateOptions) -> RoomsPlan:
    """The plan of rooms; the first room is checked like a scene. Raises what `generate_rooms` raises."""
    # a fifth of the time that a scene's defaults take
    usual: dict[str, Any] = {"tx": 120, "rays": 50_000, "max_depth": 4, "maps": False}
    options = replace(options, **{name: usual[name] for name in usual if getattr(options, name) is None})
    for name, least in (("rooms", 1), ("tx", 1), ("seed", 0)):
        if not least <= (given := getattr(options, name)) < 2**31:
            raise ArgumentError(f"generate_rooms cannot use {name}={given}: it is {least} to {2**31 - 1:,}.")
    known = family if isinstance(family, Family) else load_family(family)
    plan = RoomsPlan(known, options)
    _, first = _planned(plan, options.seed)
    solved = first.tracing.settings
    return RoomsPlan(known, replace(options, solver=solved.solver, interactions=solved.interactions))


def generate_planned_rooms(
    plan: RoomsPlan,
    folder: Path,
    workers: Workers,
    progress: ProgressCallback = ignore_progress,
    tell: Callable[[str], None] = lambda text: None,
) -> Collection:
    """Make the rooms of a plan that are missing in the folder, then describe all of them; see `generate_rooms`."""
    with sole_writer(folder / FILE):
        before = _claim(plan, folder)
        seeds = sorted({*plan.seeds, *(room.seed for room in before)})
        kept = {seed: room for seed in seeds if (room := _kept(plan, folder, seed))}
        missing = [seed for seed in seeds if seed not in kept]
        known = {room.file for room in before}
        lost = [file for file in map(plan.file_of, missing) if file in known or (folder / file).exists()]
        if lost:
            shown = ", ".join(lost[:5]) + ", …" * (len(lost) > 5)
            tell(f"missing or damaged, and made again: {len(lost)} of {len(seeds)} rooms, {shown}")
        progress(len(kept), len(seeds))
        for seed, made in side_by_side(workers, partial(_made_room, plan), missing, ahead=1):
            path, (kind, content) = folder / plan.file_of(seed), made.result()
            with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
                temporary.write_bytes(content)
            kept[seed] = room_of(folder, plan.file_of(seed), seed, kind)
            progress(len(kept), len(seeds))
        rooms = [kept[seed] for seed in seeds]
        return open_collection(folder) if list(before) == rooms else _describe(plan, folder, rooms)


def _made_room(plan: RoomsPlan, seed: int) -> tuple[str, bytes]:
    """Type and data set of a room, as the bytes of a file that a worker writes in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.h5"
        kind, planned = _planned(plan, seed)
        generate_planned(planned, path)
        return kind, path.read_bytes()


def estimate_rooms(plan: RoomsPlan, probes: int = 3) -> tuple[float, float]:
    """Seconds that one core takes for all rooms, and their bytes, from a few rooms that are made and deleted."""
    _made_room(replace(plan, options=replace(plan.options, tx=2)), plan.seeds[0])  # what has to be compiled
    seconds, sizes = list[float](), list[int]()
    for seed in plan.seeds[:probes]:
        start = time.process_time()
        sizes.append(len(_made_room(plan, seed)[1]))
        seconds.append(time.process_time() - start)
    return statistics.mean(seconds) * len(plan.seeds), statistics.mean(sizes) * len(plan.seeds)


def _planned(plan: RoomsPlan, seed: int) -> tuple[str, Plan]:
    """Type of a room, and the plan of its generation."""
    room = draw_room(plan.family, seed)
    tx_m = room.transmitters(plan.options.tx or 0)
    return room.type.name, plan_generation(room.scene, replace(plan.options, seed=seed, tx=None, tx_positions=tx_m))


def _claim(plan: RoomsPlan, folder: Path) -> tuple[Room, ...]:
    """Describe the plan in a new folder, without rooms, or return the rooms that the folder's description has.

    Raises `OutputExistsError` if these are of another family, or were made with other options.
    """
    with storage_errors(folder):
        is_described, content = (folder / FILE).exists(), sorted(each.name for each in folder.iterdir())
    if not is_described:
        if foreign := [name for name in content if not name.startswith(f".{FILE}.")]:
            raise OutputExistsError(f"{folder} holds {foreign[0]!r} and no {FILE}. Choose another folder with -o.")
        _describe(plan, folder, [])
        return ()
    found = open_collection(folder).record
    asked = {"family": f"{plan.family.name} ({plan.family.sha256[:8]})", **plan.common}
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
    """The entry of a room that is in the folder, with its hash; None if it is missing or damaged.

    Raises `OutputExistsError` if its file is another data set, or one of another version of the physics.
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
            f"{folder / file} holds {found[0]!r} by version {found[1]} of the physics, not the room of this seed by "
            f"version {PHYSICS_VERSION}. Choose another folder with -o, or delete it."
        )
    return Room(seed, kind, file, dataset.file_sha256, dataset.header.num_tx)


def _describe(plan: RoomsPlan, folder: Path, rooms: Sequence[Room]) -> Collection:
    return write_collection(
        folder,
        rooms,
        name=plan.family.name,
        family=plan.family.recipe,
        options=plan.common,
        carrier_hz=plan.carrier_hz,
        held_out_types=[kind.name for kind in plan.family.type if kind.held_out],
    )
