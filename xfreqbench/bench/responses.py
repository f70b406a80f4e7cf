"""Measured impulse responses beside those of a scene's paths: delay spread, K and first path of each link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Int, Shaped

from xfreqbench.bench.measured import CELL_M, drawn_cells, traced_links
from xfreqbench.bench.tables import Bench
from xfreqbench.data.statistics import WINDOW_DB
from xfreqbench.errors import DataError
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.model import Scene
from xfreqbench.scene.placement import check_inside
from xfreqbench.system.array_files import read_arrays
from xfreqbench.tracing.solvers import resolve_solver
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import FloatArray, IntArray, NDArray, ProgressCallback
from xfreqbench.units import format_ghz_list

NOISE_DB = 12.0  # over the mean power of noise: one tap of noise in eight million is above
NUM_DRAWS = 16  # of the phases of traced paths, at each carrier and polarisation
QUANTITIES = "delay spread ns", "K dB", "first path dB"
_FORMS = {"tx_m": "real L 3", "receiver_m": "real L 3", "cir": "<c8 L R N", "first_tap": "real L"}
_FORMS |= {"label": "text L", "name": "text L", "tap_s": "real", "bandwidth_hz": "real", "roll_off": "real"}


@dataclass(frozen=True, eq=False)
class Responses:
    """R impulse responses of N taps, `tap_s` apart, of each of L links, which have names, and labels of their kinds.

    The pulse in them is a raised cosine, whose spectrum is `bandwidth_hz` wide at half its height. `first_tap` is where
    the first path arrives.
    """

    tx_m: Float[FloatArray, "L 3"]
    receiver_m: Float[FloatArray, "L 3"]
    cir: Complex[NDArray[np.complex128], "L R N"]
    first_tap: Float[FloatArray, "L"]
    label: Shaped[NDArray[Any], "L"]
    name: Shaped[NDArray[Any], "L"]
    tap_s: float
    bandwidth_hz: float
    roll_off: float


def read_responses(path: Path, every: int = 1) -> Responses:
    """Each `every`-th link of an `.npz` with the arrays of `Responses`, single-precision responses, all numbers finite.

    Raises `DataError`.
    """
    advice = "docs/data-format.md lists the arrays of impulse responses."
    held = read_arrays(path, _FORMS, advice)
    finite = all(np.isfinite(each).all() for name, each in held.items() if name not in ("label", "name"))
    inside = finite and ((held["first_tap"] >= 0) & (held["first_tap"] < held["cir"].shape[2])).all()
    scales = held["tap_s"] > 0 < held["bandwidth_hz"] and 0 <= held["roll_off"] <= 1
    if not (inside and scales and held["cir"].any(axis=2).all() and len(held["cir"])):
        raise DataError(f"{path} holds a number that is not finite, or impossible, or a response of zeros. {advice}")
    kinds: dict[str, Any] = {"c": np.complex128, "U": np.str_}
    given: dict[str, Any] = {name: each.astype(kinds.get(each.dtype.kind, np.float64)) for name, each in held.items()}
    given |= {name: each[::every] if each.ndim else float(each) for name, each in given.items()}
    return Responses(**given)


def bench_responses(
    bench: Bench,
    scene: Scene,
    found: Responses,
    carrier_hz: Sequence[float],
    settings: TraceSettings,
    seed: int,
    progress: ProgressCallback,
) -> None:
    """Print statistics of measured responses, and how far those of traced paths are from them.

    Traced paths are convolved with the pulse, and sampled in the taps of the measured response. Places are not known
    within a wavelength, so that phases of paths are drawn. Raises `PlacementError` where all links are outside.
    """
    bench.introduce()
    geometry = Geometry.of(scene)
    settings = resolve_solver(geometry, settings)
    ends_m = np.hstack([found.tx_m, found.receiver_m])
    check_inside(scene, geometry.meshes, ends_m.reshape(-1, 3), "Every measured position")
    power = np.abs(found.cir) ** 2
    # of noise alone, a tenth of the taps is below ln(10/9) of its mean
    noise = np.quantile(power, 0.1, axis=2) / np.log(10 / 9) * 10 ** (NOISE_DB / 10)
    level = np.median(np.maximum(noise / power.max(axis=2), 10 ** (-WINDOW_DB / 10)), axis=1)
    known = np.array([_statistics(found, n, each, level[n]) for n, each in enumerate(found.cir)])
    values, rng = {"measured": known}, np.random.default_rng(seed)
    places_m = np.unique(found.receiver_m, axis=0)
    rows = [np.flatnonzero((found.receiver_m == place_m).all(axis=1)).tolist() for place_m in places_m]
    ends = [replace(scene.receiver, position_m=tuple(place_m)) for place_m in places_m.tolist()]
    tx_m = [found.tx_m[each] for each in rows]
    for r, nth, paths, kept in traced_links(scene, geometry, ends, tx_m, carrier_hz, settings, progress):
        n, late_s = rows[r][nth], paths.delay_s[:, None] - paths.delay_s.min(initial=np.inf)
        time = ((np.arange(found.cir.shape[2]) - found.first_tap[n]) * found.tap_s - late_s) * found.bandwidth_hz
        # cos(πx) / (1 − 4x²) = π/4 · (sinc(x + ½) + sinc(x − ½)), x = roll-off · time, without its limit at x = ½
        x = found.roll_off * time
        pulses = np.sinc(time) * np.pi / 4 * (np.sinc(x + 0.5) + np.sinc(x - 0.5))
        gains = paths.gain * np.exp(2j * np.pi * rng.random((NUM_DRAWS, *paths.gain.shape)))
        for model, is_kept in kept.items():
            cir = ((gains * is_kept) @ pulses).reshape(-1, found.cir.shape[2])
            values.setdefault(model, np.full_like(known, np.nan))[n] = _statistics(found, n, cir, level[n])
    note = (
        f"{len(known)} links, {format_ghz_list(carrier_hz)}, a pulse of {found.bandwidth_hz / 1e6:g} MHz with roll-off "
        f"{found.roll_off:g}. Of taps within {WINDOW_DB:g} dB of the strongest that are {NOISE_DB:g} dB above the "
        "noise: rms delay spread; power within two pulses of the first tap over that of later ones; and the strongest "
        "tap within two pulses of the first over the strongest of all. Of a link it is the median over its responses, "
        "or over phases of its paths, V and H. Cells: median over links [quartiles]; mean of traced less measured, "
        "with 95 % intervals by cells of both ends; correlation."
    )
    cell = np.unique(np.floor(ends_m / CELL_M), axis=0, return_inverse=True)[1].ravel()
    kinds = np.unique(found.label)
    groups = {"all": np.ones(len(known), bool)} | {kind: found.label == kind for kind in kinds if len(kinds) > 1}
    columns = "links", "model", *(column for name in QUANTITIES for column in (name, "less measured", "r"))
    with bench.table(f"Measured responses in {scene.name}, solver {settings.solver}", note, columns) as table:
        for (kind, links), (model, each) in product(groups.items(), values.items()):
            cells = [_compared(each[links, q], known[links, q], cell[links], seed) for q in range(len(QUANTITIES))]
            table.add(f"{kind} ({np.isfinite(each[links, 0]).sum()})", model, *chain(*cells))
    model = f"traced, depth {settings.max_depth}"
    with bench.table("Responses, by link", f"Measured / {model}.", ("link", "kind", "m", *QUANTITIES)) as table:
        for n, distance_m in enumerate(np.linalg.norm(found.tx_m - found.receiver_m, axis=1)):
            both = (f"{a:.1f} / {b:.1f}" for a, b in zip(known[n], values[model][n], strict=True))
            table.add(found.name[n], found.label[n], f"{distance_m:.1f}", *both)


def _statistics(
    found: Responses, n: int, cir: Complex[NDArray[np.complex128], "R N"], level: float
) -> Float[FloatArray, "3"]:
    """The `QUANTITIES` of link n, medians over responses; nan without power.

    Left out are taps below `level` of the peak, and those more than a pulse before the first path.
    """
    time_s, width_s = np.arange(cir.shape[1]) * found.tap_s, 1 / found.bandwidth_hz
    power = np.where(time_s >= found.first_tap[n] * found.tap_s - width_s, np.abs(cir) ** 2, 0)
    peak = power.max(axis=1, keepdims=True)
    if not peak.all():
        return np.full(len(QUANTITIES), np.nan)
    near = np.where(power >= level * peak, power, 0) / peak
    total = near.sum(axis=1)
    late_s = time_s - (near @ time_s / total)[:, None]
    early = np.where(time_s - time_s[(near > 0).argmax(axis=1)][:, None] <= 2 * width_s, near, 0)
    with np.errstate(divide="ignore"):
        k_db = 10 * np.log10(early.sum(axis=1) / (total - early.sum(axis=1)))  # inf where nothing comes later
    spread_s = np.sqrt((near * late_s**2).sum(axis=1) / total)
    return np.median([spread_s * 1e9, k_db, 10 * np.log10(early.max(axis=1))], axis=1)


def _compared(
    model: Float[FloatArray, "n"], known: Float[FloatArray, "n"], cell: Int[IntArray, "n"], seed: int
) -> tuple[str, str, str]:
    """The cells of a quantity: quartiles, mean difference with its interval, and correlation, over links with both."""
    both = np.isfinite(model) & np.isfinite(known)
    if not both.any():
        return "–", "–", "–"
    model, known, cell = model[both], known[both], np.unique(cell[both], return_inverse=True)[1].ravel()
    low, median, high = np.quantile(model, [0.25, 0.5, 0.75])
    drawn = drawn_cells(int(cell.max()) + 1, seed)
    least, most = np.quantile(drawn @ np.bincount(cell, model - known) / (drawn @ np.bincount(cell)), [0.025, 0.975])
    r = f"{np.corrcoef(model, known)[0, 1]:.2f}" if np.ptp(model) > 0 < np.ptp(known) else "–"
    return f"{median:.1f} [{low:.1f}, {high:.1f}]", f"{(model - known).mean():+.1f} [{least:+.1f}, {most:+.1f}]", r
