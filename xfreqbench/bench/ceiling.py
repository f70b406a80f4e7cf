"""What `bench ceiling` prints: the scores of maps that are made of the true paths, less something that is not known.

Phases unknown: every true path is known with its direction and its power, and the phase of each is random. The best
map then is the one with the largest SSIM on average over the phases. Order limited: the true paths are known with
their phases, but only those with few reflections, and none over an edge or by diffuse reflection.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from xfreqbench.bench.phase_blind import BandOfArray, random_phase_maps
from xfreqbench.bench.tables import Bench
from xfreqbench.bench.threads import one_thread
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.retrace import traced_scene
from xfreqbench.data.splits import LOFO_TARGETS_HZ
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.maps.metrics import bootstrap_interval, ssim
from xfreqbench.methods.virtual_source.config import SourceConfig
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.system.machine import one_blas_thread
from xfreqbench.tracing.paths import NO_INTERACTION, REFRACTION, SPECULAR, Paths
from xfreqbench.tracing.solvers import make_tracer
from xfreqbench.tracing.tracer import Tracer
from xfreqbench.tracing.waves import spherical_waves
from xfreqbench.types import FloatArray, IntArray, Maps, ProgressCallback
from xfreqbench.units import format_ghz, format_ghz_list

NUM_DRAWS = 256  # of phases for each map
ORDERS = tuple(range(1, SourceConfig().max_order + 1))
PHASE_BLIND = ("ceiling (phases unknown)", "mean map of random phases", "one map of random phases")


@dataclass(frozen=True, eq=False)
class CeilingPlan:
    """What is scored: transmitters `tx` of a data set at some of its carriers, and a tracer of its scene at these.

    `carrier` holds the indices of the carriers in the data set.
    """

    dataset: PasDataset
    receiver: ReceiverArray
    tracer: Tracer
    tx: Int[IntArray, "n"]
    carrier: Int[IntArray, "F"]
    seed: int


@dataclass(frozen=True, eq=False)
class CeilingScores:
    """SSIM of the maps of R rows, for n transmitters at F carriers.

    `wave_error` is ‖h − h′‖ / ‖h‖, where h is the stored channel and h′ the sum of the traced waves.
    """

    rows: tuple[str, ...]
    ssim: Float[FloatArray, "n F R"]
    wave_error: Float[FloatArray, "n F"]


def plan_ceiling(
    dataset: PasDataset, carriers_hz: Sequence[float] | None, num_transmitters: int, seed: int
) -> CeilingPlan:
    """Draw transmitters that a path reaches at every carrier, all where there are fewer, and make the tracer.

    The carriers are those of the paper's targets that the data have if `carriers_hz` is None. Raises
    `XFreqBenchError` for numbers out of range and for carriers that the data lack, `DataError` where nothing says how
    the data were traced, and `SceneError` as `traced_scene` does.
    """
    if num_transmitters < 1 or seed < 0:
        raise XFreqBenchError(
            f"--transmitters takes a number from 1 on and --seed one from 0 on, but got {num_transmitters} and {seed}."
        )
    carrier = _carriers(dataset, carriers_hz)
    scene, settings = traced_scene(dataset), dataset.trace_settings
    is_heard = dataset.has_path.reshape(-1, dataset.num_carriers)[:, carrier].all(axis=1)
    heard = np.random.default_rng(seed).permutation(np.flatnonzero(is_heard))
    if not heard.size:
        raise DataError(
            f"{dataset.path} has no transmitter that a path reaches at each of the carriers. Name fewer with --freqs."
        )
    tracer = make_tracer(scene, dataset.header.carrier_hz[carrier].tolist(), settings)
    return CeilingPlan(dataset, scene.receiver, tracer, np.sort(heard[:num_transmitters]), carrier, seed)


def compute_ceiling(plan: CeilingPlan, progress: ProgressCallback) -> CeilingScores:
    """Trace the transmitters of a plan and score their maps; the callback gets transmitters done and their number."""
    band = BandOfArray(plan.dataset.beam)
    rows = (*PHASE_BLIND, *(f"ceiling (paths of order ≤ {order})" for order in ORDERS))
    scores = np.zeros((len(plan.tx), len(plan.carrier), len(rows)))
    wave_error = np.zeros(scores.shape[:2])
    with one_thread(), one_blas_thread():  # the arrays are small: a second thread would mostly wait
        for done, tx in enumerate(plan.tx.tolist()):
            scores[done], wave_error[done] = _scored(plan, band, tx)
            progress(done + 1, len(plan.tx))
    return CeilingScores(rows, scores, wave_error)


def _scored(
    plan: CeilingPlan, band: BandOfArray, tx: int
) -> tuple[Float[FloatArray, "F R"], Float[FloatArray, "F"]]:
    """Scores of the maps of one transmitter at every carrier, and how far its waves are off the stored channels."""
    samples = plan.dataset.subset(tx * plan.dataset.num_carriers + plan.carrier)
    paths = plan.tracer.paths(samples.tx_position_m[0].astype(np.float64))
    kept = [has_order(paths, order) for order in ORDERS]
    scores, wave_error = [], []
    for f, (truth, stored) in enumerate(zip(samples.pas(), samples.cfr.astype(np.complex128), strict=True)):
        waves = spherical_waves(paths, f, plan.receiver)
        generator = np.random.default_rng([plan.seed, tx, int(plan.carrier[f])])
        blind = phase_blind_maps(waves, band, plan.dataset, generator)
        maps = np.stack([*blind, *order_limited_maps(stored, waves, kept, plan.dataset)])
        scores.append(ssim(maps, np.broadcast_to(truth, maps.shape), samples.grid))
        wave_error.append(np.linalg.norm(stored - waves.sum(axis=0)) / (float(np.linalg.norm(stored)) or 1.0))
    return np.array(scores), np.array(wave_error)


def bench_ceiling(bench: Bench, plan: CeilingPlan, scores: CeilingScores) -> None:
    """Print medians and means of the scores over transmitters, each with its bootstrap interval."""
    header = plan.dataset.header
    carriers_hz = header.carrier_hz[plan.carrier].tolist()
    errors = ", ".join(f"{error:.1%}" for error in np.median(scores.wave_error, axis=0))
    note = (
        f"No methods: SSIM of maps made of the true paths of {len(plan.tx):,} of {header.num_tx:,} transmitters, with "
        "95 % bootstrap intervals over transmitters. Phases unknown: all paths with their true powers, and of "
        f"{NUM_DRAWS} draws of their phases the map in the array's band with the largest mean SSIM to all of them. "
        "Paths of order ≤ n: the stored channel without the paths of more than n reflections, and without those over "
        "edges or by diffuse reflection. Waves are spherical, with the power that they have at the array's centre: at "
        f"{format_ghz_list(carriers_hz)} their sum is {errors} off the stored channel in the median. "
        f"Data sha256 {plan.dataset.sha256[:16]}."
    )
    columns = [f"{format_ghz(carrier)} {name}" for carrier in carriers_hz for name in ("median", "mean")]
    title = f"Ceilings, {header.scene_name}, {header.pas_kind} maps"
    with bench.table(title, note, ("maps", *columns)) as table:
        for row, of_row in zip(scores.rows, np.moveaxis(scores.ssim, 2, 0), strict=True):
            cells = (
                _cell(at_carrier, statistic, plan.seed)
                for at_carrier in of_row.T
                for statistic in (np.median, np.mean)
            )
            table.add(row, *cells)


def phase_blind_maps(
    waves: Complex[NDArray[np.complex128], "P M"],
    band: BandOfArray,
    dataset: PasDataset,
    generator: np.random.Generator,
) -> list[Float[Maps, "E A"]]:
    """Of P waves with random phases the map of the largest mean SSIM, the mean of the maps, and the first of them."""
    drawn = random_phase_maps(waves, dataset.beam, dataset.header.pas_kind, NUM_DRAWS, generator)
    return [band.best_map(drawn), drawn.mean(axis=0), drawn[0]]


def order_limited_maps(
    cfr: Complex[NDArray[np.complexfloating], "M"],
    waves: Complex[NDArray[np.complex128], "P M"],
    kept: Sequence[Bool[NDArray[np.bool_], "P"]],
    dataset: PasDataset,
) -> Float[Maps, "n E A"]:
    """Maps of a stored channel less the waves that are not kept, for each of n choices.

    What is left out is subtracted, so that what waves are too simple for, such as a path that reaches only some
    elements of the array, remains as it is stored.
    """
    channels = np.array([cfr - waves[~each].sum(axis=0) for each in kept])
    return dataset.beam.maps(channels, dataset.header.pas_kind)[0]


def has_order(paths: Paths, order: int) -> Bool[NDArray[np.bool_], "P"]:
    """Whether each path is one of so many mirror reflections at most, through any number of slabs, and nothing else."""
    is_of_mirrors = np.isin(paths.interactions, (NO_INTERACTION, SPECULAR, REFRACTION)).all(axis=1)
    is_short: Bool[NDArray[np.bool_], "P"] = (paths.interactions == SPECULAR).sum(axis=1) <= order
    return is_of_mirrors & is_short


def _carriers(dataset: PasDataset, carriers_hz: Sequence[float] | None) -> Int[IntArray, "F"]:
    """Indices of carriers in a data set, ascending; raises `XFreqBenchError` for those it lacks."""
    present = dataset.header.carrier_hz
    asked = LOFO_TARGETS_HZ if carriers_hz is None else carriers_hz
    missing = [carrier for carrier in asked if carrier not in present]
    if missing and (carriers_hz is not None or len(missing) == len(asked)):
        raise XFreqBenchError(
            f"{format_ghz_list(missing)} is asked for, but {dataset.path} has {format_ghz_list(present)}. Name some of "
            "these with --freqs."
        )
    return np.flatnonzero(np.isin(present, asked))


def _cell(scores: Float[FloatArray, "n"], statistic: Callable[[FloatArray], Any], seed: int) -> str:
    """A statistic of the scores of n transmitters with its interval: `0.8475 [0.8440, 0.8510]`."""
    interval = bootstrap_interval(scores, np.arange(len(scores)), lambda drawn: float(statistic(drawn)), seed)
    return "{:.4f} [{:.4f}, {:.4f}]".format(statistic(scores), *interval)
