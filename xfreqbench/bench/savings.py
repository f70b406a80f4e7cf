"""What `bench savings` prints: the time and the effect of each saving of the generator.

Each saving is switched off alone, while all others stay on. Where the code has no switch for a saving, its public
functions are called as they would have to be without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numba import get_num_threads

from xfreqbench.bench.tables import REPEATS, Bench, timed_s
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import psnr
from xfreqbench.scene.materials import Scattering, SceneMaterial
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.scene.placement import choose_transmitters, place_transmitters
from xfreqbench.tracing.image.tracer import ImageSavings, ImageTracer
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, SolverName, TraceSettings
from xfreqbench.tracing.versions import software_versions
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

SCENE_AND_RAYS = "meshes read, rays shot, channels"

ChannelArray = Complex[NDArray[np.complex128], "T F M"]


class Saving(NamedTuple):
    """A row of the table: ms a sample without and with a saving, and how it changes the result."""

    name: str
    timed: str
    off_ms: str
    on_ms: str
    ratio: str
    change: str


@dataclass(frozen=True)
class Workload:
    """The work on which the generator's savings are measured; a time is that of all its samples."""

    scene: Scene
    tx_position_m: Float[FloatArray, "T 3"]
    carrier_hz: tuple[float, ...]
    settings: TraceSettings

    def few(self, num_tx: int, num_carriers: int) -> Workload:
        """A smaller workload: the first transmitters, and carriers spread over the band."""
        spread = np.linspace(0, len(self.carrier_hz) - 1, num_carriers).astype(int)
        carriers = tuple(self.carrier_hz[index] for index in spread)
        return replace(self, tx_position_m=self.tx_position_m[:num_tx], carrier_hz=carriers)

    def channel(self) -> ChannelArray:
        """Channels as `generate` computes them, with rays that are shot once for everything."""
        tracer = tracer_of(self.scene, self.carrier_hz, self.settings)
        return tracer.channel(self.tx_position_m).cfr

    def saving(self, name: str, timed: str, off: Callable[[], ChannelArray], on: Callable[[], ChannelArray]) -> Saving:
        """Measure both ways, and compare their channels and maps."""
        off_s, without = timed_s(off)
        on_s, with_it = timed_s(on)
        change, num_samples = channel_change(self.scene, with_it, without), without.shape[0] * without.shape[1]
        off_ms, on_ms = (f"{1e3 * seconds / num_samples:.2f}" for seconds in (off_s, on_s))
        size = f"{len(self.tx_position_m)} transmitters × {len(self.carrier_hz)} carriers"
        return Saving(name, f"{timed}; {size}", off_ms, on_ms, f"{off_s / on_s:.2f}", change)

    def by_tracers(self, name: str, timed: str, off: ImageTracer, on: ImageTracer) -> Saving:
        """Measure the channels of two tracers, whose rays are shot beforehand."""
        both = (lambda: off.channel(self.tx_position_m).cfr), (lambda: on.channel(self.tx_position_m).cfr)
        return self.saving(f"image: {name}", f"{timed}, rays shot beforehand", *both)


def office_workload(solver: SolverName, num_tx: int = 48) -> Workload:
    """Transmitters of the office at the paper's carriers, with a solver at its defaults."""
    scene = load_scene("office")
    tx_position_m = choose_transmitters(
        place_transmitters(scene.with_receiver(), surface_meshes(scene)), num_tx, seed=1
    )
    carriers = tuple(ghz_to_hz(carrier) for carrier in PAPER_CARRIERS_GHZ)
    return Workload(scene, tx_position_m, carriers, TraceSettings(solver, WITHOUT_DIFFRACTION))


def bench_savings(bench: Bench) -> None:
    """Print the time of each saving off and on."""
    bench.introduce()
    note = (
        f"ms a sample, the least of {REPEATS} warm runs; the others stay on while one is off. The "
        "office at the defaults; changes are the largest error of a sample's channel relative to its norm, and PSNR "
        "of power maps (none: equal to the last bit). Times of pieces hold what each reads and shoots anew."
    )
    versions = software_versions("image") | software_versions("sionna")
    columns = ("saving", "timed", "off, ms", "on, ms", "off / on", "change in the answer")
    with bench.table("Savings, each off and on", note, columns, versions) as table:
        for saving in chain(
            image_savings(office_workload("image")),
            diffuse_savings(office_workload("image", num_tx=4)),  # what diffuse reflection costs, which is off
            _sionna_savings(office_workload("sionna")),
        ):
            table.add(*saving)


def image_savings(work: Workload) -> Iterator[Saving]:
    """Savings of the image method: its switches, then what transmitters and carriers share."""
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
        off, on = (
            ImageTracer(work.scene, work.carrier_hz, work.settings, image_savings)
            for image_savings in (without, with_it)
        )
        yield work.by_tracers(name, "channels", off, on)
    yield from _edge_savings(work.few(2, 3))
    yield all_at_once(work, f"image: transmitters side by side on {get_num_threads()} threads")
    yield one_shooting_for_all_transmitters(work.few(4, len(work.carrier_hz)), "image: plane sequences once")
    yield _one_shooting_for_all_carriers(work, "image: one tracing for all carriers")


def _edge_savings(work: Workload) -> Iterator[Saving]:
    """Diffracted paths that are left out, against all of them traced: weak ones, and those of many reflections."""
    settings = replace(work.settings, interactions=("specular", "refraction", "diffraction"))
    on = ImageTracer(work.scene, work.carrier_hz, settings)
    for name, without in (
        ("paths over edges that a bound shows to be weak", ImageSavings(diffraction_floor=0.0)),
        ("one reflection on each side of an edge, not three", ImageSavings(diffraction_planes=3)),
    ):
        off = ImageTracer(work.scene, work.carrier_hz, settings, without)
        yield work.by_tracers(name, "channels with diffraction", off, on)


def diffuse_savings(work: Workload) -> Iterator[Saving]:
    """Diffuse reflection left out, where every material scatters: all of it, and that over a mirror."""
    names = sorted({str(surface.material) for surface in work.scene.surface})
    rough = tuple(SceneMaterial(name, scattering=Scattering(0.3)) for name in names)
    scene, every = replace(work.scene, material=rough), (*WITHOUT_DIFFRACTION, "diffuse")
    settings, timed = replace(work.settings, interactions=every), "channels with all materials rough, S = 0.3"
    whole = ImageTracer(scene, work.carrier_hz, settings)
    smooth = ImageTracer(scene, work.carrier_hz, work.settings)
    yield work.by_tracers("no diffuse reflection", timed, whole, smooth)
    direct = ImageTracer(scene, work.carrier_hz, settings, ImageSavings(diffuse_mirrors=0))
    yield work.by_tracers("no diffuse reflection over a mirror", timed, whole, direct)


def _sionna_savings(work: Workload) -> Iterator[Saving]:
    """Savings of Sionna RT's solver: what transmitters, carriers and directions of travel share."""
    some = work.few(8, 3)
    yield all_at_once(some, "sionna: eight transmitters a solve")
    yield one_shooting_for_all_transmitters(some, "sionna: chains from the receiver once")
    yield _one_shooting_for_all_carriers(work.few(4, 10), "sionna: one tracing for all carriers")
    # few, because each transmitter shoots its own
    fewer_rays = replace(work.few(2, 3), settings=replace(work.settings, rays=100_000))
    yield shooting_from_the_receiver(fewer_rays)


def all_at_once(work: Workload, name: str) -> Saving:
    """All transmitters in one call, against one call for each, with rays shot beforehand.

    The image method has a thread for each transmitter, so its ratio is mostly due to threads.
    """
    tracer = tracer_of(work.scene, work.carrier_hz, work.settings)
    return work.saving(
        name,
        "channels, rays shot beforehand",
        lambda: np.concatenate([tracer.channel(place[None]).cfr for place in work.tx_position_m]),
        lambda: tracer.channel(work.tx_position_m).cfr,
    )


def one_shooting_for_all_transmitters(work: Workload, name: str) -> Saving:
    """Rays shot from the receiver once, against anew for each transmitter."""
    parts = [replace(work, tx_position_m=place[None]) for place in work.tx_position_m]
    return work.saving(name, SCENE_AND_RAYS, lambda: np.concatenate([part.channel() for part in parts]), work.channel)


def _one_shooting_for_all_carriers(work: Workload, name: str) -> Saving:
    """Rays shot once for the widest aperture, against anew for the aperture of each carrier."""
    parts = [replace(work, carrier_hz=(carrier,)) for carrier in work.carrier_hz]
    return work.saving(
        name, SCENE_AND_RAYS, lambda: np.concatenate([part.channel() for part in parts], axis=1), work.channel
    )


def shooting_from_the_receiver(work: Workload) -> Saving:
    """Rays from the receiver, against as many rays from each transmitter at each carrier."""
    from xfreqbench.tracing.sionna.forward import ForwardRays
    from xfreqbench.tracing.sionna.scene import RadioScene

    def forward() -> ChannelArray:
        radio_scene = RadioScene(surface_meshes(work.scene), work.settings.materials)
        carriers = np.array(work.carrier_hz)
        rays = ForwardRays(radio_scene, work.scene.receiver, work.scene.transmitter_antenna, carriers, work.settings)
        return rays.channel(work.tx_position_m).cfr

    timed = f"{SCENE_AND_RAYS}, {work.settings.rays:,} rays"
    return work.saving("sionna: rays from the receiver", timed, forward, work.channel)


def channel_change(scene: Scene, cfr: ChannelArray, other: ChannelArray) -> str:
    """In words, the largest relative error of a sample's channel, and PSNR of power maps; `none` if all are equal."""
    if np.array_equal(cfr, other):
        return "none"
    norm = np.linalg.norm(other, axis=2)
    relative = np.linalg.norm(cfr - other, axis=2) / np.where(norm == 0, 1, norm)
    beam = BartlettBeam(scene.receiver.element_position_wavelengths, AngularGrid.hemisphere())
    num_elements = cfr.shape[2]
    maps, others = (beam.maps(channel.reshape(-1, num_elements))[0] for channel in (cfr, other))
    ratio_db = psnr(maps, others, beam.grid)
    return f"channels: {relative.max():.0e}; maps: worst {ratio_db.min():.0f} dB, median {np.median(ratio_db):.0f} dB"
