"""Generate a data set: plan, trace in batches that survive a kill, assemble one HDF5 file."""

from __future__ import annotations

import hashlib
import io
import json
import platform
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from xfreqbench.angles import FloatArray
from xfreqbench.cluster import differences
from xfreqbench.dataset import DatasetHeader, PasWriter, open_dataset, verify
from xfreqbench.errors import ClusterError, DataError, OutputExistsError, StorageError, XFreqBenchError
from xfreqbench.materials import check_dispersion
from xfreqbench.mesh import SurfaceMesh, meshes_sha256, sees, surface_meshes
from xfreqbench.overlaps import check_overlaps
from xfreqbench.parallel import HERE, Workers, side_by_side
from xfreqbench.pas import pas_kind_named
from xfreqbench.placement import check_receiver, check_transmitters, choose_transmitters, place_transmitters
from xfreqbench.provenance import software_versions
from xfreqbench.scene import Scene
from xfreqbench.solvers import make_tracer, resolve_solver
from xfreqbench.storage import atomic_path, require_space, storage_errors, write_text
from xfreqbench.tracing import Channel, Tracer, TraceSettings
from xfreqbench.units import format_ghz_list

BATCH = 16  # transmitters a batch: what a kill can lose
ProgressCallback = Callable[[int, int], None]


def _ignore(done: int, total: int) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True)
class Tracing:
    """What a worker has to know before it traces: some kilobytes, equal where they give equal channels."""

    scene: Scene
    scene_sha256: str
    carrier_hz: tuple[float, ...]
    settings: TraceSettings


@dataclass(frozen=True)
class Plan:
    """A checked job: nothing in it can fail for a reason that is known before the first ray."""

    scene: Scene
    meshes: list[SurfaceMesh]
    tx_position_m: Float[FloatArray, "T 3"]
    line_of_sight: Bool[NDArray[np.bool_], "T"]
    settings: TraceSettings
    header: DatasetHeader

    @property
    def num_samples(self) -> int:
        """Channels to compute: transmitters × carriers."""
        return len(self.tx_position_m) * len(self.header.carrier_hz)

    @property
    def num_bytes(self) -> int:
        """Size of the finished file."""
        return self.header.num_bytes

    @property
    def summary(self) -> str:
        """Counts and size, for a user to check before the work starts."""
        rejected = sum(self.header.rejected.values())
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.header.rejected.items() if count)
        return (
            f"{self.scene.name}: {len(self.tx_position_m)} transmitters ({self.line_of_sight.sum()} in sight) "
            f"× {len(self.header.carrier_hz)} carriers = {self.num_samples} samples, {self.num_bytes / 1e6:.0f} MB\n"
            f"solver {self.settings.solver}, {' and '.join(self.settings.interactions)}, depth "
            f"{self.settings.max_depth}, {self.settings.rays:,} rays, seed {self.settings.seed}\n"
            f"{rejected} grid positions left out{': ' + reasons if reasons else ''}"
        )

    @cached_property
    def sha256(self) -> str:
        """Names the job: two plans with the same digest give the same data."""
        return job_sha256(self.header, self.tx_position_m)

    @property
    def tracing(self) -> Tracing:
        """The job without its transmitters, and with absolute paths."""
        scene = replace(self.scene, folder=self.scene.folder.absolute())
        carriers = tuple(self.header.carrier_hz.tolist())
        return Tracing(scene, self.header.scene_sha256, carriers, self.settings)

    @property
    def batches(self) -> list[slice]:
        """Transmitters of each batch."""
        count = len(self.tx_position_m)
        return [slice(start, min(start + BATCH, count)) for start in range(0, count, BATCH)]


def plan_generation(
    scene: Scene,
    carrier_hz: Sequence[float],
    settings: TraceSettings = TraceSettings(),
    *,
    num_transmitters: int | None = None,
    tx_position_m: Float[FloatArray, "T 3"] | None = None,
    pas_kind: str = "power",
    maps: bool = True,
) -> Plan:
    """Check a job before any ray is shot.

    Transmitters are the scene's usable grid positions, `num_transmitters` of them chosen by the seed, or
    those given. Raises `MaterialBandError`, `PlacementError` or another `XFreqBenchError`.
    """
    carriers = _checked_carriers(carrier_hz)
    meshes = surface_meshes(scene)
    settings = resolve_solver(meshes, settings)
    extrapolated = check_dispersion((mesh.material for mesh in meshes), carriers, settings.materials)
    check_overlaps(meshes)
    check_receiver(scene, meshes, min(carriers))
    if tx_position_m is None:
        placement = place_transmitters(scene, meshes, min(carriers))
        tx_position_m = choose_transmitters(placement, num_transmitters, settings.seed)
        rejected = placement.rejected
    else:
        check_transmitters(scene, meshes, tx_position_m, carriers)
        rejected = {}
    header = DatasetHeader(
        scene_name=scene.name,
        scene_json=scene.canonical_json,
        scene_sha256=meshes_sha256(meshes),
        receiver=scene.receiver,
        carrier_hz=np.array(carriers),
        num_tx=len(tx_position_m),
        pas_kind=pas_kind_named(pas_kind),
        maps=maps,
        settings={**_as_json(settings), "extrapolated_materials": extrapolated},
        software=software_versions(settings.solver),
        rejected=rejected,
    )
    free = sees(meshes, tx_position_m, np.asarray(scene.receiver.position_m))
    return Plan(scene, meshes, tx_position_m, free, settings, header)


def job_sha256(header: DatasetHeader, tx_position_m: Float[FloatArray, "T 3"]) -> str:
    """Digest of everything that determines a data set's content."""
    digest = hashlib.sha256(json.dumps(header.attributes(), sort_keys=True).encode())
    digest.update(header.carrier_hz.tobytes())
    digest.update(np.ascontiguousarray(tx_position_m).tobytes())
    return digest.hexdigest()


def _checked_carriers(carrier_hz: Sequence[float]) -> list[float]:
    carriers = [float(carrier) for carrier in carrier_hz]
    if not carriers or not all(np.isfinite(carriers)) or min(carriers) <= 0:
        raise XFreqBenchError(
            f"Carriers must be positive frequencies, but {format_ghz_list(carriers)} are given."
        )
    if len(set(carriers)) < len(carriers):
        raise XFreqBenchError(
            f"Each carrier can be given once, but {format_ghz_list(carriers)} names one twice."
        )
    return sorted(carriers)


def _as_json(settings: TraceSettings) -> dict[str, Any]:
    return json.loads(json.dumps(asdict(settings)))


def generate(
    plan: Plan,
    path: Path,
    progress: ProgressCallback = _ignore,
    write_progress: ProgressCallback = _ignore,
    workers: Workers = HERE,
) -> Path:
    """Trace every transmitter, then write the data set; a killed run goes on where it stopped.

    `progress` and `write_progress` are told transmitters done and in all, of the two stages. `workers` trace;
    files are written here, and are the same whoever traced.

    Finished batches are kept beside the output, in `PATH.parts`, until the file is whole. An output that
    already holds this job is left as it is. Raises `OutputExistsError` for one that holds another,
    `StorageError` where there is no room, and `ClusterError` for workers whose solvers differ, or that die.
    """
    num_tx = len(plan.tx_position_m)
    if path.exists():
        require_same_job(path, plan.sha256, "job")
        progress(num_tx, num_tx)
        write_progress(num_tx, num_tx)
        return path
    require_space(path, plan.num_bytes)
    _require_same_solver(plan, workers)
    store = BatchStore(path.with_name(path.name + ".parts"), plan)
    _trace_missing(plan, store, progress, workers)
    with PasWriter(path, plan.header) as writer:
        for index, rows in enumerate(plan.batches):
            channel = store.read(index)
            writer.append(plan.tx_position_m[rows], plan.line_of_sight[rows], channel.cfr, channel.num_paths)
            write_progress(rows.stop, num_tx)
    store.remove()
    return path


def require_same_job(path: Path, sha256: str, kind: str) -> None:
    """Raise `OutputExistsError` unless a whole data set of that `job_sha256` is there; `kind` is what it says."""
    if not path.is_file():
        raise StorageError(f"{path} is not a file that a data set can be written to. Choose another with -o.")
    try:
        verify(path)
        existing = open_dataset(path)
    except DataError as error:
        raise OutputExistsError(
            f"{path} exists, but holds no data set that can be read: {error} Delete it, or choose another "
            "output with -o."
        ) from error
    if job_sha256(existing.header, existing.tables["tx_position_m"]) != sha256:
        raise OutputExistsError(
            f"{path} exists and holds another {kind} ({existing.header.scene_name}, "
            f"{existing.header.num_tx} transmitters, settings {existing.header.settings}). Choose another "
            "output with -o, or delete that file."
        )


def _require_same_solver(plan: Plan, workers: Workers) -> None:
    for worker, software in workers.ask(software_versions, plan.settings.solver).items():
        differing = differences(plan.header.software, software)
        if differing:
            raise ClusterError(
                f"Worker {worker} traces with other software: {differing}. Install the same versions on both."
            )


def _trace_missing(plan: Plan, store: BatchStore, report: ProgressCallback, workers: Workers) -> None:
    missing = store.missing()
    done = len(plan.tx_position_m) - sum(rows.stop - rows.start for _, rows in missing)
    report(done, len(plan.tx_position_m))
    batches = ((index, plan.tx_position_m[rows]) for index, rows in missing)
    try:
        for (index, tx), traced in side_by_side(workers, partial(_traced, plan.tracing), batches, ahead=1):
            store.write(index, traced.result())
            done += len(tx)
            report(done, len(plan.tx_position_m))
    finally:
        _tracer.cache_clear()  # here; in a worker it stays for the next batch


def _traced(tracing: Tracing, batch: tuple[int, Float[FloatArray, "T 3"]]) -> Channel:
    _, tx_position_m = batch
    return _tracer(tracing).channel(tx_position_m)


@lru_cache(maxsize=1)
def _tracer(tracing: Tracing) -> Tracer:
    """Rays are shot once a process. Raises `ClusterError` where a worker finds other meshes under their names."""
    if meshes_sha256(surface_meshes(tracing.scene)) != tracing.scene_sha256:
        raise ClusterError(
            f"A worker on {platform.node()} finds other meshes of scene {tracing.scene.name!r} in "
            f"{tracing.scene.folder}. Keep them on a file system that all workers share."
        )
    return make_tracer(tracing.scene, tracing.carrier_hz, tracing.settings)


class BatchStore:
    """Finished batches of one job in a folder; each file's name carries the digest of its bytes.

    A file is written under another name, synced and renamed, so one that is there with the right digest
    is whole: a batch lost, cut short or damaged is traced again.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder = folder
        self.plan = plan
        self._claim()
        self._paths = self._found()

    def _claim(self) -> None:
        """Make the folder this job's, or raise `OutputExistsError` where it is another's."""
        marker = self.folder / "job.sha256"
        if marker.exists() and marker.read_text() != self.plan.sha256:
            raise OutputExistsError(
                f"{self.folder} holds the batches of an unfinished run with other settings, software or "
                "transmitters. Run that one to its end, delete the folder, or choose another output with -o."
            )
        write_text(marker, self.plan.sha256)

    def _found(self) -> dict[int, Path]:
        """Whole batches by index; the others are removed."""
        found = {}
        for path in self.folder.glob("[0-9]*-*.npz"):
            index, _, sha256 = path.stem.partition("-")
            if _sha256(path) == sha256:
                found[int(index)] = path
            else:
                path.unlink()
        return found

    def missing(self) -> list[tuple[int, slice]]:
        """Batches that have to be traced."""
        return [(i, rows) for i, rows in enumerate(self.plan.batches) if i not in self._paths]

    def write(self, index: int, channel: Channel) -> None:
        """Keep a batch; raises `StorageError`."""
        buffer = io.BytesIO()
        np.savez(buffer, cfr=channel.cfr, num_paths=channel.num_paths)
        content = buffer.getvalue()
        path = self.folder / f"{index:06d}-{hashlib.sha256(content).hexdigest()}.npz"
        with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
            temporary.write_bytes(content)
        self._paths[index] = path

    def read(self, index: int) -> Channel:
        """A batch that was kept."""
        path = self._paths[index]
        if not path.is_file() or _sha256(path) != path.stem.partition("-")[2]:
            raise StorageError(f"Batch {index} has gone from {self.folder}. Run the same command again.")
        with np.load(path) as content:
            return Channel(content["cfr"], content["num_paths"])

    def remove(self) -> None:
        """Forget the batches, once the data set is whole."""
        shutil.rmtree(self.folder)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def estimate_seconds(plan: Plan, probes: int = 4) -> float:
    """Time the job will take here, from tracing a few of its transmitters."""
    start = time.perf_counter()
    tracer = make_tracer(plan.scene, plan.header.carrier_hz.tolist(), plan.settings)
    spread = np.linspace(0, len(plan.tx_position_m) - 1, probes).astype(int)
    tracer.channel(plan.tx_position_m[spread[:1]])  # compiles
    shot = time.perf_counter()
    tracer.channel(plan.tx_position_m[spread])
    per_transmitter = (time.perf_counter() - shot) / probes
    return shot - start + per_transmitter * len(plan.tx_position_m)
