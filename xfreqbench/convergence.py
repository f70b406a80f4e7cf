"""PAS error against run time: which settings are converged, and what the plain way would cost.

Errors are taken against a stored reference: the public forward `PathSolver(synthetic_array=False)`, one
call per transmitter and carrier, with eight times the default rays, one more depth and another seed.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Complex
from numpy.typing import NDArray

from xfreqbench.angles import AngularGrid
from xfreqbench.generate import generate, plan_generation
from xfreqbench.machine import hardware, peak_memory_mib, reset_peak_memory
from xfreqbench.mesh import surface_meshes
from xfreqbench.metrics import psnr, ssim
from xfreqbench.pas import BartlettBeam
from xfreqbench.reference import REFERENCE_SETTINGS, Reference, read_reference
from xfreqbench.scene import Scene, load_scene
from xfreqbench.solvers import make_tracer, resolve_solver
from xfreqbench.tracing import TraceSettings
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz

MEDIAN_BAR_DB, FIFTH_PERCENTILE_BAR_DB = 40.0, 30.0
PLAIN_LADDER = (  # rays, depth, whether Sionna's table of candidates is made larger than it comes
    (100_000, 4, False),
    (100_000, 5, False),
    (100_000, 6, False),
    (200_000, 6, False),
    (1_000_000, 6, False),
    (100_000, 5, True),
    (100_000, 6, True),
    (200_000, 6, True),
)
PLAIN_WAY = (100_000, 5, False)


@dataclass(frozen=True)
class MapError:
    """Errors of maps at one carrier."""

    median_psnr_db: float
    fifth_percentile_psnr_db: float
    median_ssim: float

    @property
    def meets_bar(self) -> bool:
        """Whether it reaches the accuracy bar of the default settings."""
        return (
            self.median_psnr_db >= MEDIAN_BAR_DB and self.fifth_percentile_psnr_db >= FIFTH_PERCENTILE_BAR_DB
        )

    def __str__(self) -> str:
        return f"{self.median_psnr_db:.0f} / {self.fifth_percentile_psnr_db:.0f} / {self.median_ssim:.4f}"


def map_errors(
    scene: Scene,
    cfr: Complex[NDArray[np.complex128], "T F M"],
    truth: Complex[NDArray[np.complex128], "T F M"],
) -> list[MapError]:
    """Error of power maps at each carrier, over the transmitters."""
    grid = AngularGrid.hemisphere()
    beam = BartlettBeam(scene.receiver.element_position_wavelengths, grid)
    errors = []
    for f in range(cfr.shape[1]):
        ours, true = beam.maps(cfr[:, f])[0], beam.maps(truth[:, f])[0]
        ratios = psnr(ours, true, grid)
        errors.append(
            MapError(
                float(np.median(ratios)),
                float(np.percentile(ratios, 5, method="lower")),
                float(np.median(ssim(ours, true, grid))),
            )
        )
    return errors


@dataclass(frozen=True)
class Row:
    """One setting's cost and error."""

    label: str
    shoot_s: float
    sample_ms: float
    errors: list[MapError]

    @property
    def meets_bar(self) -> bool:
        """Whether it reaches the accuracy bar at every carrier."""
        return all(error.meets_bar for error in self.errors)


def convergence_settings(base: TraceSettings, solvers: Sequence[str]) -> Iterator[tuple[str, TraceSettings]]:
    """The settings that `bench generate` compares."""
    if "image" in solvers:
        image = replace(base, solver="image")
        for depth in (3, 4, 5, 6, 7, 8):
            yield f"image, depth {depth}", replace(image, max_depth=depth)
        for rays in (50_000, 100_000, 250_000, 1_000_000):
            yield f"image, {rays:,} rays", replace(image, rays=rays)
        yield "image, refraction off", replace(image, interactions=("specular",))
    if "sionna" in solvers:
        sionna = replace(base, solver="sionna")
        for rays, depth in ((100_000, 4), (100_000, 5), (100_000, 6), (500_000, 6)):
            yield f"sionna, {rays:,} rays, depth {depth}", replace(sionna, rays=rays, max_depth=depth)
        yield (
            "sionna, 100,000 rays, diffraction on",
            replace(sionna, rays=100_000, interactions=("specular", "refraction", "diffraction")),
        )


def measure(scene: Scene, settings: TraceSettings, reference: Reference, label: str) -> Row:
    """Trace the reference's transmitters; compilation is done before the clock starts."""
    settings = resolve_solver(surface_meshes(scene), settings)
    carriers = reference.carrier_hz.tolist()
    num_warm = 1 if "diffraction" in settings.interactions else len(reference.tx_position_m)
    make_tracer(scene, carriers, settings).channel(reference.tx_position_m[:num_warm])
    start = time.perf_counter()
    tracer = make_tracer(scene, carriers, settings)
    shot = time.perf_counter()
    channel = tracer.channel(reference.tx_position_m)
    end = time.perf_counter()
    num_samples = channel.cfr.shape[0] * channel.cfr.shape[1]
    errors = map_errors(scene, channel.cfr, reference.cfr)
    return Row(label, shot - start, (end - shot) / num_samples * 1e3, errors)


def measure_plain(
    scene: Scene, reference: Reference, rays: int, max_depth: int, is_roomy: bool, num_tx: int
) -> Row:
    """The plain way on `num_tx` of the reference's transmitters, lit and shadowed alike."""
    from xfreqbench.sionna_plain import plain_channel
    from xfreqbench.sionna_scene import roomy_hash_table

    chosen = np.linspace(0, len(reference.tx_position_m) - 1, num_tx).astype(int)
    interactions = REFERENCE_SETTINGS.interactions

    def solve(carrier_hz: float, rows: NDArray[np.int64]) -> Complex[NDArray[np.complex128], "T M"]:
        tx = reference.tx_position_m[rows]
        with roomy_hash_table() if is_roomy else nullcontext():
            return plain_channel(scene, carrier_hz, tx, interactions, max_depth, rays, seed=3)

    seconds, channels = 0.0, []
    for carrier_hz in reference.carrier_hz:
        solve(float(carrier_hz), chosen[:1])  # compiles
        start = time.perf_counter()
        channels.append(solve(float(carrier_hz), chosen))
        seconds += time.perf_counter() - start
    errors = map_errors(scene, np.stack(channels, axis=1), reference.cfr[chosen])
    return Row(
        f"plain, {rays:,} rays, depth {max_depth}{', larger table' if is_roomy else ''}",
        0.0,
        seconds / (num_tx * len(reference.carrier_hz)) * 1e3,
        errors,
    )


@dataclass(frozen=True)
class PipelineCost:
    """What `generate` took from scene to finished file, maps included."""

    num_tx: int
    num_carriers: int
    seconds: float
    peak_memory_mib: float

    @property
    def sample_ms(self) -> float:
        """Wall time per (transmitter, carrier)."""
        return self.seconds / (self.num_tx * self.num_carriers) * 1e3

    def __str__(self) -> str:
        return (
            f"{self.num_tx} transmitters × {self.num_carriers} carriers, maps included: {self.seconds:.1f} s, "
            f"{self.sample_ms:.2f} ms a sample, {1e3 / self.sample_ms:.0f} samples/s, "
            f"peak memory {self.peak_memory_mib:.0f} MiB"
        )


def measure_pipeline(
    scene: Scene,
    settings: TraceSettings,
    num_tx: int | None,
    carriers_ghz: Sequence[float] = PAPER_CARRIERS_GHZ,
) -> PipelineCost:
    """Generate a data set with maps in a temporary folder, everything counted but compilation."""
    carriers = [ghz_to_hz(carrier) for carrier in carriers_ghz]
    with tempfile.TemporaryDirectory() as folder:
        generate(plan_generation(scene, carriers, settings, num_transmitters=1), Path(folder) / "first.h5")
        reset_peak_memory()
        start = time.perf_counter()
        plan = plan_generation(scene, carriers, settings, num_transmitters=num_tx)
        generate(plan, Path(folder) / "timed.h5")
        seconds = time.perf_counter() - start
    return PipelineCost(len(plan.tx_position_m), len(carriers), seconds, peak_memory_mib())


def convergence_table(rows: Sequence[Row], carrier_hz: Sequence[float]) -> str:
    """Markdown: cost and error of each setting."""
    carriers = "".join(f" | {carrier / 1e9:g} GHz" for carrier in carrier_hz)
    lines = [
        f"| setting | rays once, s | ms a sample{carriers} | bar |",
        "|---" * (len(carrier_hz) + 4) + "|",
    ]
    for row in rows:
        cells = " | ".join(str(error) for error in row.errors)
        bar = "met" if row.meets_bar else "missed"
        lines.append(f"| {row.label} | {row.shoot_s:.2f} | {row.sample_ms:.2f} | {cells} | {bar} |")
    return "\n".join(lines)


def bench_generate(scene_name: str, solvers: Sequence[str], say: Callable[[str], None]) -> None:
    """Print error against run time for the solvers over rays, depth and interactions."""
    scene = load_scene(scene_name)
    reference = read_reference(scene)
    carriers = reference.carrier_hz.tolist()
    say(_preamble(reference))
    for number, (label, settings) in enumerate(convergence_settings(TraceSettings(), solvers)):
        row = measure(scene, settings, reference, label)
        table = convergence_table([row], carriers).splitlines()
        say("\n".join(table if number == 0 else table[-1:]))


def _preamble(reference: Reference) -> str:
    about, machine = reference.about, hardware()
    return (
        f"{machine['processor']}, {machine['cores']} cores, {machine['system']}.\n"
        f"Reference: {about['way']}, {about['rays']:,} rays, depth {about['max_depth']}, seed "
        f"{about['seed']}, {len(reference.tx_position_m)} transmitters, half shadowed; "
        f"{' and '.join(about['interactions'])}. Cells: PSNR median / 5th percentile (dB) / SSIM median.\n"
        f"Bar: median {MEDIAN_BAR_DB:g} dB and 5th percentile {FIFTH_PERCENTILE_BAR_DB:g} dB at each carrier.\n"
    )


def bench_against_plain(
    scene_name: str, num_tx: int | None, num_plain_tx: int, say: Callable[[str], None]
) -> None:
    """Print the full pipeline's rate as a ratio to the plain way, in one run, errors beside the times."""
    scene = load_scene(scene_name)
    reference = read_reference(scene)
    say(_preamble(reference))
    costs = {
        "image": measure_pipeline(scene, TraceSettings(solver="image"), num_tx),
        "sionna": measure_pipeline(scene, TraceSettings(solver="sionna"), min(num_tx or 64, 64)),
    }
    plain = [measure_plain(scene, reference, *settings, num_plain_tx) for settings in PLAIN_LADDER]
    ours = [
        measure(scene, TraceSettings(solver="image"), reference, "image, defaults, tracing alone"),
        measure(scene, TraceSettings(solver="sionna"), reference, "sionna, defaults, tracing alone"),
    ]
    say(convergence_table([*plain, *ours], reference.carrier_hz.tolist()) + "\n")
    meeting = [row for row in plain if row.meets_bar]
    compared = {"the plain way": plain[PLAIN_LADDER.index(PLAIN_WAY)]}
    if meeting:
        compared["the cheapest plain settings that meet the bar"] = min(
            meeting, key=lambda row: row.sample_ms
        )
    for name, cost in costs.items():
        say(f"{name}, {cost}")
        for what, row in compared.items():
            say(f"  {row.sample_ms / cost.sample_ms:.0f} times the rate of {what} ({row.label})")
    for count in (1, 5, 10):
        say(f"price per carrier: {measure_pipeline(scene, TraceSettings(), 64, PAPER_CARRIERS_GHZ[:count])}")
