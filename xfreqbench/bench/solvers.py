"""What `bench generate` prints: errors of maps against run time, and the pipeline against the plain way.

The plain way is one call of Sionna RT's public solver for each sample. Errors are measured against a stored
reference: the public `PathSolver(synthetic_array=False)`, one call per transmitter and carrier, with eight times the
default rays, one more depth and another seed; of a scene with meshes, solver `image` with eight times the rays.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex

from xfreqbench.bench.reference import REFERENCE_SETTINGS, Reference, read_reference
from xfreqbench.bench.tables import REPEATS, Bench
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import plan_generation
from xfreqbench.errors import XFreqBenchError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import psnr, ssim
from xfreqbench.runs.records import BenchFigure, BenchPoint
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.system.machine import peak_memory_mib, reset_peak_memory
from xfreqbench.tracing.solvers import resolve_solver, tracer_of
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, Interaction, SolverName, TraceSettings
from xfreqbench.tracing.versions import software_versions
from xfreqbench.types import NDArray
from xfreqbench.units import PAPER_CARRIERS_GHZ, format_ghz

SOLVERS: tuple[SolverName, ...] = ("image", "sionna")
MEDIAN_BAR_DB, FIFTH_PERCENTILE_BAR_DB = 40.0, 30.0
PLAIN_LADDER = (  # rays, depth, whether Sionna's table of candidates is enlarged
    (100_000, 4, False),
    (100_000, 5, False),
    (100_000, 6, False),
    (200_000, 6, False),
    (1_000_000, 6, False),
    (100_000, 5, True),
    (100_000, 6, True),
    (200_000, 6, True),
)


class _MapError(NamedTuple):
    """Errors of maps at one carrier, over transmitters."""

    median_psnr_db: float
    fifth_percentile_psnr_db: float
    median_ssim: float

    @property
    def meets_bar(self) -> bool:
        """Whether the errors reach the accuracy bar of the default settings."""
        return self.median_psnr_db >= MEDIAN_BAR_DB and self.fifth_percentile_psnr_db >= FIFTH_PERCENTILE_BAR_DB

    def __str__(self) -> str:
        return f"{self.median_psnr_db:.0f} / {self.fifth_percentile_psnr_db:.0f} / {self.median_ssim:.4f}"


def map_errors(
    scene: Scene, cfr: Complex[NDArray[np.complex128], "T F M"], truth: Complex[NDArray[np.complex128], "T F M"]
) -> list[_MapError]:
    """Errors of power maps at each carrier, over the transmitters."""
    grid = AngularGrid.hemisphere()
    beam = BartlettBeam(scene.receiver.element_position_wavelengths, grid)
    errors = []
    for f in range(cfr.shape[1]):
        ours, true = beam.maps(cfr[:, f])[0], beam.maps(truth[:, f])[0]
        ratios, similarity = psnr(ours, true, grid), ssim(ours, true, grid)
        fifth = float(np.percentile(ratios, 5, method="lower"))
        errors.append(_MapError(float(np.median(ratios)), fifth, float(np.median(similarity))))
    return errors


@dataclass(frozen=True)
class _MeasuredSetting:
    """Time and errors of one setting: rays (`shoot_s`), channels (`sample_ms`), and errors for each carrier."""

    label: str
    shoot_s: float
    sample_ms: float
    errors: list[_MapError]

    @property
    def meets_bar(self) -> bool:
        """Whether the errors reach the accuracy bar at every carrier."""
        return all(error.meets_bar for error in self.errors)

    @property
    def cells(self) -> tuple[str, ...]:
        costs = self.label, f"{self.shoot_s:.2f}", f"{self.sample_ms:.2f}"
        return *costs, *map(str, self.errors), "met" if self.meets_bar else "missed"

    def point(self, series: str, label: str) -> BenchPoint:
        """A point of the figure: time per sample, and the median PSNR at the worst carrier."""
        worst_db = min(error.median_psnr_db for error in self.errors)
        return BenchPoint(series=series, label=label, x=self.sample_ms, y=worst_db)


@dataclass(frozen=True)
class Rung:
    """One setting of a solver; `varied` names what differs from the defaults, which are on every line of the figure."""

    solver: SolverName
    label: str
    varied: tuple[str, ...]
    settings: TraceSettings


def ladder(solvers: Sequence[str]) -> Iterator[Rung]:
    """The settings that `bench generate` compares: the defaults, and variations of one thing at a time."""
    with_diffraction: tuple[Interaction, ...] = ("specular", "refraction", "diffraction")
    if "image" in solvers:
        yield from _rungs("image", depths=(3, 4, 5, 7, 8), rays=(50_000, 100_000, 250_000, 1_000_000))
        yield Rung("image", "diffraction on", ("interactions",), TraceSettings("image", with_diffraction))
    if "sionna" in solvers:
        yield from _rungs("sionna", depths=(3, 4, 5, 7), rays=(50_000, 100_000, 250_000, 1_000_000))
        forward = TraceSettings("sionna", with_diffraction, rays=100_000)
        yield Rung("sionna", "diffraction on, 100,000 rays", ("interactions",), forward)


def _rungs(solver: SolverName, depths: Sequence[int], rays: Sequence[int]) -> Iterator[Rung]:
    base = TraceSettings(solver, WITHOUT_DIFFRACTION)
    yield Rung(solver, "defaults", ("depth", "rays", "interactions"), base)
    for depth in depths:
        yield Rung(solver, f"depth {depth}", ("depth",), replace(base, max_depth=depth))
    for number in rays:
        yield Rung(solver, f"{number:,} rays", ("rays",), replace(base, rays=number))
    yield Rung(solver, "refraction off", ("interactions",), replace(base, interactions=("specular",)))
    yield Rung(solver, "reflection off", ("interactions",), replace(base, interactions=("refraction",)))


def _measure(scene: Scene, settings: TraceSettings, reference: Reference, label: str) -> _MeasuredSetting:
    """Trace the reference's transmitters and measure times and errors, without compilation.

    Times are the smallest of `REPEATS`. With diffraction by Sionna RT, whose rays are shot for each transmitter, it
    is one.
    """
    settings = resolve_solver(Geometry.of(scene), settings)
    is_dear = "diffraction" in settings.named_interactions and settings.solver == "sionna"
    num_warm, repeats = (1, 1) if is_dear else (len(reference.tx_position_m), REPEATS)
    _traced(scene, settings, reference, num_warm)
    traced = [_traced(scene, settings, reference, None) for _ in range(repeats)]
    shoot_s, channel_s, (cfr, *_) = zip(*traced, strict=True)
    num_samples = cfr.shape[0] * cfr.shape[1]
    errors = map_errors(scene, cfr, reference.cfr)
    return _MeasuredSetting(label, min(shoot_s), min(channel_s) / num_samples * 1e3, errors)


def _traced(
    scene: Scene, settings: TraceSettings, reference: Reference, num_tx: int | None
) -> tuple[float, float, Complex[NDArray[np.complex128], "T F M"]]:
    """Seconds for rays and for the channels of the first `num_tx` transmitters, and these channels."""
    start = time.perf_counter()
    tracer = tracer_of(scene, reference.carrier_hz.tolist(), settings)
    shot = time.perf_counter()
    channel = tracer.channel(reference.tx_position_m[:num_tx])
    return shot - start, time.perf_counter() - shot, channel.cfr


def _measure_plain(
    scene: Scene, reference: Reference, rays: int, max_depth: int, is_roomy: bool, num_tx: int
) -> _MeasuredSetting:
    """Time and errors of the plain way for `num_tx` of the reference's transmitters, both lit and shadowed."""
    from xfreqbench.tracing.sionna.plain import plain_channel
    from xfreqbench.tracing.sionna.scene import roomy_hash_table

    chosen = np.linspace(0, len(reference.tx_position_m) - 1, num_tx).astype(int)
    interactions = REFERENCE_SETTINGS.named_interactions

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
    label = f"plain, {rays:,} rays, depth {max_depth}{', larger table' if is_roomy else ''}"
    return _MeasuredSetting(label, 0.0, seconds / (num_tx * len(reference.carrier_hz)) * 1e3, errors)


def _measure_pipeline(
    scene: Scene, settings: TraceSettings, num_tx: int | None, carriers_ghz: Sequence[float] = PAPER_CARRIERS_GHZ
) -> tuple[float, tuple[str, ...]]:
    """Time a pair of a transmitter and a carrier takes in ms, and the cells of a row, from scene to finished file.

    A data set with maps is generated in a temporary folder; compilation alone is left out.
    """
    options = GenerateOptions(carriers_ghz, **asdict(settings))
    with tempfile.TemporaryDirectory() as folder:
        generate_planned(plan_generation(scene, replace(options, tx=1)), Path(folder) / "first.h5")
        reset_peak_memory()
        start = time.perf_counter()
        plan = plan_generation(scene, replace(options, tx=num_tx))
        plan_s = time.perf_counter() - start
        generate_planned(plan, Path(folder) / "timed.h5")
        seconds = time.perf_counter() - start
    num_tx, num_carriers = len(plan.tx_position_m), len(carriers_ghz)
    sample_ms = seconds / (num_tx * num_carriers) * 1e3
    times = f"{seconds:.1f}", f"{plan_s:.2f}", f"{sample_ms:.2f}", f"{1e3 / sample_ms:.0f}"
    return sample_ms, (str(num_tx), str(num_carriers), *times, f"{peak_memory_mib():.0f}")


def bench_generate(bench: Bench, scene_name: str, solvers: Sequence[str]) -> None:
    """Print errors against run time for the solvers, for variations of rays, depth and interactions."""
    scene = load_scene(scene_name)
    reference = read_reference(scene)
    bench.introduce()
    base, points = TraceSettings(interactions=WITHOUT_DIFFRACTION), []
    note = (
        f"{_reference_note(reference)} Defaults: depth {base.max_depth}, {base.rays:,} rays, "
        f"{' and '.join(base.named_interactions)}; a row names what it changes. Rays are shot once for all "
        "transmitters, but with diffraction by Sionna RT, not reciprocal. Times are the least of "
        f"{REPEATS} warm runs, of one there."
    )
    title = f"Error of the generated maps against run time, {scene_name}"
    with bench.table(title, note, _columns(reference), _versions(solvers)) as table:
        for rung in ladder(solvers):
            row = _measure(scene, rung.settings, reference, f"{rung.solver}, {rung.label}")
            table.add(*row.cells)
            points += [row.point(f"{rung.solver}, {varied}", rung.label) for varied in rung.varied]
        table.figure = _figure(points)


def _versions(solvers: Sequence[str]) -> dict[str, str]:
    return {key: text for name in SOLVERS if name in solvers for key, text in software_versions(name).items()}


def _columns(reference: Reference) -> tuple[str, ...]:
    """Columns of tables with errors at each carrier."""
    carriers = [format_ghz(carrier) for carrier in reference.carrier_hz.tolist()]
    return "setting", "rays once, s", "ms a sample", *carriers, "bar"


def _figure(points: Sequence[BenchPoint]) -> BenchFigure:
    return BenchFigure(
        x_label="ms a sample, rays shot beforehand",
        y_label="median PSNR at the worst carrier, dB",
        log_x=True,
        points=tuple(points),
    )


def _reference_note(reference: Reference) -> str:
    """How the reference was made, and how to read the cells."""
    about = reference.about
    return (
        "Errors are those of power maps against a stored reference (`xfreqbench bench reference`): "
        f"{about['way']}, {about['rays']:,} rays, depth "
        f"{about['max_depth']}, seed {about['seed']}, {' and '.join(about['interactions'])}; "
        f"{len(reference.tx_position_m)} transmitters, up to half of them shadowed. Cells: PSNR median / 5th "
        f"percentile in dB / SSIM median. Bar: median {MEDIAN_BAR_DB:g} dB and 5th percentile "
        f"{FIFTH_PERCENTILE_BAR_DB:g} dB at each carrier."
    )


def bench_against_plain(bench: Bench, scene_name: str, num_tx: int | None, num_plain_tx: int) -> None:
    """Print the full pipeline's rate as a ratio to the plain way, both measured now, with errors."""
    scene = load_scene(scene_name)
    reference = read_reference(scene)
    most = len(reference.tx_position_m)
    if not 2 <= num_plain_tx <= most:
        raise XFreqBenchError(f"--plain-tx is {num_plain_tx}; give 2 to {most}, which the reference has.")
    bench.introduce()
    few, auto = min(num_tx or 64, 64), TraceSettings(interactions=WITHOUT_DIFFRACTION)
    pipelines = {  # first, because the plain way leaves things in memory
        "image": _measure_pipeline(scene, replace(auto, solver="image"), num_tx),
        **{
            f"price per carrier: {count}": _measure_pipeline(scene, auto, few, PAPER_CARRIERS_GHZ[:count])
            for count in (1, 5, 10)
        },
        "sionna": _measure_pipeline(scene, replace(auto, solver="sionna"), few),
    }
    plain = _tabulate_plain(bench, scene, reference, num_plain_tx)
    _tabulate_pipelines(bench, scene_name, pipelines, plain)


def _tabulate_plain(bench: Bench, scene: Scene, reference: Reference, num_tx: int) -> list[_MeasuredSetting]:
    """Print settings of the plain way, and below them the solvers at their defaults; return the plain rows."""
    note = (
        f"{_reference_note(reference)} The plain way is one public `PathSolver` call a sample, of {num_tx} of "
        "those transmitters, timed once; a larger table holds the candidates that Sionna's own table loses. The "
        f"solvers' times are the least of {REPEATS} warm runs."
    )
    title, columns = f"The plain way, {scene.name}", _columns(reference)
    with bench.table(title, note, columns, _versions(SOLVERS)) as table:
        plain, points = [], []
        for rays, depth, is_roomy in PLAIN_LADDER:
            row = _measure_plain(scene, reference, rays, depth, is_roomy, num_tx)
            table.add(*row.cells)
            plain.append(row)
            series = "plain, larger table" if is_roomy else "plain"
            points.append(row.point(series, f"{rays:,} rays, depth {depth}"))
        for solver in SOLVERS:
            settings = TraceSettings(solver, WITHOUT_DIFFRACTION)
            row = _measure(scene, settings, reference, f"{solver}, defaults, tracing alone")
            table.add(*row.cells)
            points.append(row.point(solver, "defaults"))
        table.figure = _figure(points)
    return plain


def _tabulate_pipelines(
    bench: Bench,
    scene_name: str,
    pipelines: Mapping[str, tuple[float, tuple[str, ...]]],
    plain: Sequence[_MeasuredSetting],
) -> None:
    usual = plain[PLAIN_LADDER.index((100_000, 5, False))]
    meeting = [row for row in plain if row.meets_bar]
    best = min(meeting, key=lambda row: row.sample_ms) if meeting else None
    note = (
        "From scene to finished file, maps included, compilation apart. Rates are ratios to the plain way "
        f"({usual.label}: {usual.sample_ms:.0f} ms a sample) and to "
        "the cheapest plain settings that meet the bar"
        + (f" ({best.label}: {best.sample_ms:.0f} ms a sample)." if best else ", of which there are none here.")
    )
    times = "seconds", "of planning", "ms a sample", "samples/s", "peak memory, MiB"
    rates = "rate / the plain way", "rate / the cheapest plain that meets the bar"
    columns = ("pipeline", "transmitters", "carriers", *times, *rates)
    with bench.table(f"The full pipeline, {scene_name}", note, columns, _versions(SOLVERS)) as table:
        for name, (sample_ms, cells) in pipelines.items():
            ratios = [f"{row.sample_ms / sample_ms:.0f}" if row else "–" for row in (usual, best)]
            table.add(name, *cells, *ratios)
