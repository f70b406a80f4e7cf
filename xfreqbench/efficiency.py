"""What `bench savings` prints: every saving of generator, renderer and training, switched off in turn.

Each saving is taken away alone, the others at work. Where the code has no switch for one, its public calls
are made as they would have to be without it.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from xfreqbench import image_kernels
from xfreqbench.angles import AngularGrid, FloatArray
from xfreqbench.image_method import ImageSavings, ImageTracer
from xfreqbench.mesh import surface_meshes
from xfreqbench.metrics import psnr
from xfreqbench.pas import BartlettBeam
from xfreqbench.placement import choose_transmitters, place_transmitters
from xfreqbench.provenance import software_versions
from xfreqbench.rendering import CARRIERS_HZ, named
from xfreqbench.scene import Scene, load_scene
from xfreqbench.solvers import make_tracer
from xfreqbench.splatting.benchmark import num_threads
from xfreqbench.splatting.savings import Saving, savings
from xfreqbench.splatting.training_step import PAPER_NETWORK
from xfreqbench.tables import Bench
from xfreqbench.testing import plane_wave_data
from xfreqbench.tracing import SolverName, TraceSettings
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

NUM_TX = 48
TRAINING = (*PAPER_NETWORK, "num_gaussians=4000", "batch_size=8")
FEW_RAYS = 100_000  # where every transmitter shoots its own
COLUMNS = ("part", "saving", "timed", "off, ms", "on, ms", "off / on", "change in the answer")
_REPEATS = 2  # another program on the machine can only add to a time
SCENE_AND_RAYS = "meshes read, rays shot, channels"

ChannelArray = Complex[NDArray[np.complex128], "T F M"]
Answer = TypeVar("Answer")
MapArray = Float[NDArray[np.float32], "N E A"]


@dataclass(frozen=True)
class Workload:
    """What the generator's savings are timed on; each of their times is that of all its samples."""

    scene: Scene
    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: tuple[float, ...]
    settings: TraceSettings

    @property
    def num_samples(self) -> int:
        """Transmitters times carriers."""
        return len(self.tx_position_m) * len(self.carrier_hz)

    @property
    def size(self) -> str:
        """In words."""
        return f"{len(self.tx_position_m)} transmitters × {len(self.carrier_hz)} carriers"

    def few(self, num_tx: int, num_carriers: int) -> Workload:
        """The first transmitters, and carriers spread over all of them."""
        spread = np.linspace(0, len(self.carrier_hz) - 1, num_carriers).astype(int)
        carriers = tuple(self.carrier_hz[index] for index in spread)
        return replace(self, tx_position_m=self.tx_position_m[:num_tx], carrier_hz=carriers)

    def channel(self) -> ChannelArray:
        """Rays shot once and evaluated for everything, as `generate` does."""
        tracer = make_tracer(self.scene, self.carrier_hz, self.settings)
        return tracer.channel(self.tx_position_m).cfr

    def one_transmitter_each(self) -> list[Workload]:
        """The same work in pieces."""
        return [replace(self, tx_position_m=place[None]) for place in self.tx_position_m]

    def one_carrier_each(self) -> list[Workload]:
        """The same work in pieces."""
        return [replace(self, carrier_hz=(carrier,)) for carrier in self.carrier_hz]

    def saving(
        self, name: str, timed: str, off: Callable[[], ChannelArray], on: Callable[[], ChannelArray]
    ) -> Saving:
        """Times of both, and how far channels and maps lie apart."""
        off_s, without = timed_s(off)
        on_s, with_it = timed_s(on)
        change = channel_change(self.scene, with_it, without)
        per_sample = off_s / self.num_samples * 1e3, on_s / self.num_samples * 1e3
        return Saving("generator", name, f"{timed}; {self.size}", *per_sample, change)


def office_workload(solver: SolverName, num_tx: int = NUM_TX) -> Workload:
    """Transmitters of the office at the paper's carriers, the solver at its defaults."""
    scene = load_scene("office")
    tx_position_m = choose_transmitters(place_transmitters(scene, surface_meshes(scene)), num_tx, seed=1)
    carriers = tuple(ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ)
    return Workload(scene, tx_position_m, carriers, TraceSettings(solver))


def timed_s(work: Callable[[], Answer]) -> tuple[float, Answer]:
    """The least time of a few, compiled and warm, and the answer."""
    answer, seconds = work(), []
    for _ in range(_REPEATS):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds), answer


def bench_savings(bench: Bench) -> None:
    """Print every saving off and on."""
    bench.introduce()
    note = (
        f"ms a sample, the least of {_REPEATS} warm runs; the others stay on while one is off. Generator: the "
        "office at the defaults; changes are the largest error of a sample's channel relative to its norm, and PSNR "
        "of power maps (none: equal to the last bit). Times of pieces hold what each reads and shoots anew. "
        f"Renderer and training: {named(TRAINING)}, on {num_threads()} threads; changes are relative to the "
        "largest value of a field, or absolute in maps of peak 1. A saving may buy accuracy with time."
    )
    versions = software_versions("image") | software_versions("sionna")
    with bench.table("Savings, each off and on", note, COLUMNS, versions) as table:
        for saving in all_savings():
            table.add(*saving_cells(saving))


def all_savings() -> Iterator[Saving]:
    """Those of the generator, then of the renderer and of training."""
    yield from image_savings(office_workload("image"))
    yield from map_savings(office_workload("image", num_tx=6))
    yield from sionna_savings(office_workload("sionna"))
    with tempfile.TemporaryDirectory() as folder:
        train = plane_wave_data(Path(folder) / "waves.h5", CARRIERS_HZ, num_tx=32)
        yield from savings(train, TRAINING)


def saving_cells(saving: Saving) -> tuple[str, ...]:
    """As a table shows it."""
    times = f"{saving.off_ms:.2f}", f"{saving.on_ms:.2f}", f"{saving.off_ms / saving.on_ms:.2f}"
    return saving.part, saving.name, saving.timed, *times, saving.change


def image_savings(work: Workload) -> Iterator[Saving]:
    """Switches of the image method, then what it shares among transmitters and carriers."""
    per_element = max(work.scene.receiver.rows, work.scene.receiver.cols)
    for name, without, with_it in (
        ("candidates pruned by widened facets", ImageSavings(prune=False), ImageSavings()),
        (
            "visibility from four corners of the array (both: field at every element)",
            ImageSavings(share_visibility=False, field_nodes_per_axis=per_element),
            ImageSavings(field_nodes_per_axis=per_element),  # elements traced one by one share no nodes
        ),
        ("field at 2×2 points, interpolated", ImageSavings(field_nodes_per_axis=per_element), ImageSavings()),
        ("these three together", ImageSavings(False, False, per_element), ImageSavings()),
    ):
        off, on = (_image_tracer(work, savings) for savings in (without, with_it))
        yield work.saving(
            f"image: {name}",
            "channels, rays shot beforehand",
            lambda off=off: off.channel(work.tx_position_m).cfr,  # type: ignore[misc]
            lambda on=on: on.channel(work.tx_position_m).cfr,  # type: ignore[misc]
        )
    yield side_by_side(work, f"image: transmitters side by side on {image_kernels.num_threads()} threads")
    yield one_shooting_for_all_transmitters(work.few(4, len(work.carrier_hz)), "image: plane sequences once")
    yield one_shooting_for_all_carriers(work, "image: one tracing for all carriers")


def _image_tracer(work: Workload, image_savings: ImageSavings) -> ImageTracer:
    return ImageTracer(work.scene, work.carrier_hz, work.settings, image_savings)


def sionna_savings(work: Workload) -> Iterator[Saving]:
    """What Sionna RT's solver shares among transmitters, carriers and directions of travel."""
    some = work.few(8, 3)
    yield side_by_side(some, "sionna: eight transmitters a solve")
    yield one_shooting_for_all_transmitters(some, "sionna: chains from the receiver once")
    yield one_shooting_for_all_carriers(work.few(4, 10), "sionna: one tracing for all carriers")
    fewer_rays = replace(work.few(2, 3), settings=replace(work.settings, rays=FEW_RAYS))
    yield shooting_from_the_receiver(fewer_rays)
    yield larger_table(fewer_rays)


def side_by_side(work: Workload, name: str) -> Saving:
    """All transmitters in one call, against one call each, rays shot beforehand.

    The image method has a thread for each transmitter, so that its ratio is the threads' for the most part.
    """
    tracer = make_tracer(work.scene, work.carrier_hz, work.settings)

    def one_by_one() -> ChannelArray:
        return np.concatenate([tracer.channel(place[None]).cfr for place in work.tx_position_m])

    def together() -> ChannelArray:
        return tracer.channel(work.tx_position_m).cfr

    return work.saving(name, "channels, rays shot beforehand", one_by_one, together)


def one_shooting_for_all_transmitters(work: Workload, name: str) -> Saving:
    """Rays from the receiver shot once, against anew for each transmitter."""

    def anew() -> ChannelArray:
        return np.concatenate([one.channel() for one in work.one_transmitter_each()])

    return work.saving(name, SCENE_AND_RAYS, anew, work.channel)


def one_shooting_for_all_carriers(work: Workload, name: str) -> Saving:
    """Rays shot once at the widest aperture, against anew for each carrier at its own."""

    def anew() -> ChannelArray:
        return np.concatenate([one.channel() for one in work.one_carrier_each()], axis=1)

    return work.saving(name, SCENE_AND_RAYS, anew, work.channel)


def shooting_from_the_receiver(work: Workload) -> Saving:
    """Rays from the one receiver, against rays from every transmitter at every carrier, as many of them."""
    from xfreqbench.sionna_forward import ForwardRays
    from xfreqbench.sionna_scene import RadioScene

    def forward() -> ChannelArray:
        radio_scene = RadioScene(surface_meshes(work.scene), work.settings.materials)
        carriers = np.array(work.carrier_hz)
        rays = ForwardRays(radio_scene, work.scene.receiver, carriers, work.settings)
        return rays.channel(work.tx_position_m).cfr

    timed = f"{SCENE_AND_RAYS}, {work.settings.rays:,} rays"
    return work.saving("sionna: rays from the receiver", timed, forward, work.channel)


def larger_table(work: Workload) -> Saving:
    """Sionna's table of candidates enlarged, in the plain way: it loses next to none, and takes no less time."""
    from xfreqbench.sionna_scene import roomy_hash_table

    def roomy() -> ChannelArray:
        with roomy_hash_table():
            return _plain(work)

    name = "sionna: larger table of candidates, which buys accuracy"
    timed = f"plain way, {work.settings.rays:,} rays, depth {work.settings.max_depth}"
    return work.saving(name, timed, lambda: _plain(work), roomy)


def _plain(work: Workload) -> ChannelArray:
    from xfreqbench.sionna_plain import plain_channel

    settings = work.settings
    asked = settings.interactions, settings.max_depth, settings.rays, settings.seed
    channels = [plain_channel(work.scene, carrier, work.tx_position_m, *asked) for carrier in work.carrier_hz]
    return np.stack(channels, axis=1)


def map_savings(work: Workload) -> Iterator[Saving]:
    """Maps of all channels: steering vectors kept, and one product for all."""
    cfr = work.channel().reshape(-1, work.scene.receiver.num_elements)
    kept = _beam(work.scene)

    def one_by_one(beam_of: Callable[[], BartlettBeam]) -> MapArray:
        return np.concatenate([beam_of().maps(row[None])[0] for row in cfr])

    anew_s, anew = timed_s(lambda: one_by_one(lambda: _beam(work.scene)))
    singly_s, singly = timed_s(lambda: one_by_one(lambda: kept))
    together_s, together = timed_s(lambda: kept.maps(cfr)[0])
    for name, off_s, on_s, off, on in (
        ("maps: steering vectors kept", anew_s, singly_s, anew, singly),
        ("maps: one product for all samples", singly_s, together_s, singly, together),
    ):
        per_sample = off_s / len(cfr) * 1e3, on_s / len(cfr) * 1e3
        yield Saving(
            "generator",
            name,
            f"maps; {work.size}",
            *per_sample,
            f"maps: at most {np.abs(on - off).max():.0e}",
        )


def _beam(scene: Scene) -> BartlettBeam:
    return BartlettBeam(scene.receiver.element_position_wavelengths, AngularGrid.hemisphere())


def channel_change(scene: Scene, cfr: ChannelArray, other: ChannelArray) -> str:
    """Largest relative error of a sample's channel, and PSNR of the power maps; `none` where all are equal."""
    if np.array_equal(cfr, other):
        return "none"
    norm = np.linalg.norm(other, axis=2)
    relative = np.linalg.norm(cfr - other, axis=2) / np.where(norm == 0, 1, norm)
    beam = _beam(scene)
    num_elements = cfr.shape[2]
    maps, others = (beam.maps(channel.reshape(-1, num_elements))[0] for channel in (cfr, other))
    ratio_db = psnr(maps, others, beam.grid)
    return f"channels: {relative.max():.0e}; maps: worst {ratio_db.min():.0f} dB, median {np.median(ratio_db):.0f} dB"
