"""Statistics of a data set's channels by carrier, compared with standards: path loss, spreads, K, mechanisms.

They are computed from the paths to the array centre, which are stored or traced again. Path gains include both
antennas' patterns, so a path loss is that of isotropic antennas if both are (`pattern = "iso"`).

The standards are medians: of 3GPP TR 38.901 V19 (Tables 7.4.1-1, 7.5-6 and 7.5-10, indoor office), of Recommendation
ITU-R P.1238 (site-general model, office), of the mmMAGIC project (deliverable D2.2, indoor, for 6 GHz and up), and of
small rooms: the delay spread by the rule of 38.901 for a hall of given volume and surface, and the decay of room
electromagnetics (Andersen et al., 2007).
"""

from __future__ import annotations

from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import InstanceOf, PositiveInt

from xfreqbench.data.dataset import PasDataset, stored_paths
from xfreqbench.data.retrace import traced_scene
from xfreqbench.errors import DataError, SceneError
from xfreqbench.scene.facets import Geometry
from xfreqbench.system.arguments import checked
from xfreqbench.tracing.absorption import mean_absorption
from xfreqbench.tracing.paths import DIFFRACTION, DIFFUSE, REFRACTION, RaggedPaths
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz

WINDOW_DB = 25.0
CLUSTER_S = 3.91e-9  # of delays in a cluster of 38.901, whose K is that of its first
MECHANISMS = ("direct", "reflected", "transmitted", "diffracted", "diffuse")
# Of each spread, a and b of log10(value) = a + b·log10(1 + f), f in GHz, in sight and not, in seconds and degrees. In
# 38.901 the downlink leaves the array, so that its departures (lgASD, lgZSD) are our arrivals.
_SPREADS = {
    "delay_spread_s": {"38901": ((-7.692, -0.01), (-7.173, -0.28)), "mmmagic": ((-7.75, -0.13), (-7.58, -0.01))},
    "arrival_azimuth_spread_deg": {"38901": ((1.60, 0.0), (1.62, 0.0)), "mmmagic": ((1.90, -0.15), (1.70, 0.11))},
    "departure_azimuth_spread_deg": {
        "38901": ((1.781, -0.19), (1.863, -0.11)),
        "mmmagic": ((2.09, -0.24), (1.863, -0.11)),
    },
    "arrival_zenith_spread_deg": {"38901": ((2.228, -1.43), (1.08, 0.0))},
    "departure_zenith_spread_deg": {"38901": ((1.44, -0.26), (1.387, -0.15))},
}


@dataclass(frozen=True, eq=False)
class LinkStatistics:
    """Statistics of the paths of n transmitters at F carriers; nan where no path arrives, or a sample is left out.

    Path loss and the shares of the power, summed over paths, are of all paths; the rest is of those at most
    `WINDOW_DB` below the strongest, where diffuse ones count by their power in each nanosecond. Delay spreads are the
    rms of delays weighted by power, and angular spreads the circular standard deviation √(−2·ln|Σ P·exp(jφ) / Σ P|)
    (3GPP TR 38.901, Annex A), in world axes, of arrival at the array and of departure from the transmitter.
    `k_factor_db` is the power of the direct path over that of all others, and `k_factor_cluster_db` that of all paths
    within `CLUSTER_S` of the direct one over that of later ones, as standards and sounders have it; both are nan where
    either power is. The last axis of `power_share` has the `MECHANISMS`: a path is what comes last in this order of
    what it meets, so that one which is both reflected and transmitted is transmitted.
    """

    tx_index: Int[IntArray, "n"]
    carrier_hz: Float[FloatArray, "F"]
    distance_m: Float[FloatArray, "n"]
    in_sight: Bool[NDArray[np.bool_], "n"]
    path_loss_db: Float[FloatArray, "n F"]
    delay_spread_s: Float[FloatArray, "n F"]
    arrival_azimuth_spread_deg: Float[FloatArray, "n F"]
    arrival_zenith_spread_deg: Float[FloatArray, "n F"]
    departure_azimuth_spread_deg: Float[FloatArray, "n F"]
    departure_zenith_spread_deg: Float[FloatArray, "n F"]
    k_factor_db: Float[FloatArray, "n F"]
    k_factor_cluster_db: Float[FloatArray, "n F"]
    num_paths: Float[FloatArray, "n F"]
    power_share: Float[FloatArray, "n F 5"]


@dataclass(frozen=True, eq=False)
class ChannelStatistics:
    """Statistics of a data set: of every link, of the room, and, in `rows`, of all links at a carrier.

    The room is the box around the scene's surfaces, with `volume_m3` and `surface_m2`; `absorption` (F,) is the mean
    over the scene's surfaces of the share of diffuse power that they do not reflect. All are nan in a scene without
    surfaces, and if its meshes are missing. `source` says where the paths are from.
    """

    links: LinkStatistics
    volume_m3: float
    surface_m2: float
    absorption: Float[FloatArray, "F"]
    source: str

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """A row for the transmitters in sight, and one for those that are not, at each carrier, if there are any.

        Names end in units; those of the standards end in their names. Values are medians, of the exponent the least
        squares, and of a difference (`path_loss_above_…_db`) mean and standard deviation, shares are means. Those of K
        and the spreads in `…_sd_…` are standard deviations.
        """
        kinds = [(sight, carrier) for sight in (True, False) for carrier in range(len(self.links.carrier_hz))]
        return [row for kind in kinds if (row := self._row(*kind))["links"]]

    def _row(self, in_sight: bool, carrier: int) -> dict[str, Any]:
        links, carrier_hz = self.links, float(self.links.carrier_hz[carrier])
        rows = np.flatnonzero((links.in_sight == in_sight) & np.isfinite(links.path_loss_db[:, carrier]))
        loss_db, distance_m = links.path_loss_db[rows, carrier], links.distance_m[rows]
        row: dict[str, Any] = {"in_sight": in_sight, "carrier_ghz": carrier_hz / 1e9, "links": len(rows)}
        row["path_loss_db"] = _median(loss_db)
        row["path_loss_exponent"] = _exponent(loss_db, distance_m)
        standard = of_standards(distance_m, carrier_hz, in_sight)
        for name in ("38901", "p1238"):
            above_db = loss_db - standard[f"path_loss_{name}_db"]
            row[f"path_loss_above_{name}_db"] = float(above_db.mean()) if len(rows) else np.nan
            row[f"path_loss_above_{name}_sd_db"] = float(above_db.std()) if len(rows) else np.nan
        for name in ("k_factor_db", "k_factor_cluster_db"):
            values = getattr(links, name)[rows, carrier]
            row |= {name: _median(values), name.replace("_db", "_sd_db"): _scatter(values)}
        row |= {name: standard[name] for name in ("k_factor_cluster_38901_db", "k_factor_cluster_mmmagic_db")}
        row["num_paths"] = _median(links.num_paths[rows, carrier])
        for name in _SPREADS:
            unit, scale = ("ns", 1e9) if name == "delay_spread_s" else ("deg", 1.0)
            stem, _, of_unit = name.rpartition("_")
            values = getattr(links, name)[rows, carrier] * scale
            row |= {f"{stem}_{unit}": _median(values), f"{stem}_sd_{unit}": _scatter(values)}
            for kind in ("38901", "mmmagic"):
                row[f"{stem}_{kind}_{unit}"] = standard[f"{stem}_{kind}_{of_unit}"] * scale
        # 38.901's rule for factory halls (InF), 10^(log10(26·V/S + 14) − 9.35), and the time in which the diffuse power
        # of a room falls by 1/e, 4V / (c·η·S), of the mean absorption η: the spread of a channel that decays so
        volume_m3, surface_m2, absorption = self.volume_m3, self.surface_m2, float(self.absorption[carrier])
        row["delay_spread_small_room_ns"] = (26 * volume_m3 / surface_m2 + 14) * 10**-0.35
        decay_s = 4 * volume_m3 / (SPEED_OF_LIGHT_M_S * surface_m2 * absorption) if absorption else np.inf
        row["delay_spread_room_decay_ns"] = decay_s * 1e9
        shares = links.power_share[rows, carrier]
        means = shares.mean(axis=0) if len(rows) else np.full(len(MECHANISMS), np.nan)
        return {**row, **{f"share_{name}": mean for name, mean in zip(MECHANISMS, means.tolist(), strict=True)}}

    def __str__(self) -> str:
        parts = [f"statistics of {self.source}; spreads, K and paths within {WINDOW_DB:g} dB of the strongest"]
        if np.isfinite(self.volume_m3):
            parts.append(f"room       {self.volume_m3:.0f} m³ and {self.surface_m2:.0f} m² about the surfaces")
        powers = (
            *("links", "path loss dB", "over 38.901", "over P.1238", "exponent"),
            *("K of the ray, dB", "K of a cluster (38.901, mmMAGIC)"),
        )
        spreads = (
            *("paths", "delay ns (38.901, mmMAGIC, small room, decay)", "azimuth° at array (38.901, mmMAGIC)"),
            *("at transmitter (38.901, mmMAGIC)", "zenith° at array", "at transmitter"),
        )
        for in_sight, title in ((True, "in sight"), (False, "not in sight")):
            rows = [row for row in self.rows if row["in_sight"] == in_sight]
            if rows:
                parts.append("\n" + _aligned([(title, *powers, *MECHANISMS), *map(_power_cells, rows)]))
                parts.append("\n" + _aligned([(title, *spreads), *map(_spread_cells, rows)]))
        return "\n".join(parts)


def _power_cells(row: dict[str, Any]) -> tuple[str, ...]:
    above = [
        f"{row[f'path_loss_above_{name}_db']:+.1f} ± {row[f'path_loss_above_{name}_sd_db']:.1f}"
        for name in ("38901", "p1238")
    ]
    of_ray = _beside([row["k_factor_db"]], row["k_factor_sd_db"])
    cluster = [row[f"k_factor_cluster{name}_db"] for name in ("", "_38901", "_mmmagic")]
    k = of_ray, _beside(cluster, row["k_factor_cluster_sd_db"])
    shares = [f"{row[f'share_{name}']:.1%}" for name in MECHANISMS]
    loss_db, exponent = f"{row['path_loss_db']:.1f}", f"{row['path_loss_exponent']:.2f}"
    return format_ghz(row["carrier_ghz"] * 1e9), str(row["links"]), loss_db, *above, exponent, *k, *shares


def _spread_cells(row: dict[str, Any]) -> tuple[str, ...]:
    kinds, cells = ("", "_38901", "_mmmagic", "_small_room", "_room_decay"), list[str]()
    for name in ("delay", "arrival_azimuth", "departure_azimuth", "arrival_zenith", "departure_zenith"):
        unit, of = ("ns", kinds) if name == "delay" else ("deg", kinds[:3])
        cells.append(_beside([row[f"{name}_spread{kind}_{unit}"] for kind in of], row[f"{name}_spread_sd_{unit}"]))
    return format_ghz(row["carrier_ghz"] * 1e9), f"{row['num_paths']:.0f}", *cells


def _beside(values: list[float], scatter: float) -> str:
    """Our median and the standard deviation, and the values of others in brackets, what is not known left out."""
    own, *others = (f"{value:.1f}" for value in values)
    known = [other for other in others if other not in ("nan", "inf")]
    ours = f"{own} ± {scatter:.1f}".replace(" ± nan", "").replace("nan", "–")
    return f"{ours} ({', '.join(known)})" if known else ours


def _aligned(rows: list[tuple[str, ...]]) -> str:
    first, *others = [max(map(len, column)) for column in zip(*rows, strict=True)]
    form = f"{{:<{first}}}" + "".join(f"  {{:>{width}}}" for width in others)
    return "\n".join(form.format(*row) for row in rows)


@checked
def statistics(dataset: InstanceOf[PasDataset], num_tx: PositiveInt = 200, seed: int = 0) -> ChannelStatistics:
    """Path loss, spreads, K and mechanisms of a data set or a subset by carrier, with standards; it can be printed.

    Paths are the stored ones, or those of at most `num_tx` transmitters, drawn by `seed`, that are traced again from
    the scene and the settings in the file. Raises `DataError` for data without channels, and `SceneError` if the
    scene's meshes are needed and missing. With stored paths they are optional, and only describe the room.
    """
    header = dataset.header
    if not header.channels:
        raise DataError(f"{dataset.path} has maps without channels, so delays and powers are not known.")
    if dataset._is_isolated:
        raise DataError(f"{dataset.path} is given to methods without its paths.")
    is_asked = np.zeros((header.num_tx, dataset.header.num_carriers), bool)
    is_asked.flat[dataset.rows] = True
    tx, carriers = np.flatnonzero(is_asked.any(axis=1)), np.flatnonzero(is_asked.any(axis=0))
    scene = geometry = None
    with suppress(DataError, SceneError) if header.paths else nullcontext():
        scene = traced_scene(dataset)
        geometry = Geometry.of(scene)
    receiver_m = np.asarray(header.receiver.position_m, dtype=np.float64)
    if header.paths:
        paths, traced = stored_paths(dataset)[0], np.arange(header.num_tx)
        source = f"the stored paths of {len(tx)} transmitters"
    else:
        traced = tx = np.sort(np.random.default_rng(seed).choice(tx, min(num_tx, len(tx)), replace=False))
        assert scene
        tracer = tracer_of(scene, header.carrier_hz, dataset.trace_settings, geometry)
        positions_m = dataset.tables["tx_position_m"][tx]
        paths = RaggedPaths.of([tracer.paths(position_m) for position_m in positions_m], positions_m, receiver_m)
        source = f"the paths of {len(tx)} transmitters, traced again"
    found = [of_paths(paths, carrier) for carrier in carriers.tolist()]
    place = np.searchsorted(traced, tx)
    missing = ~is_asked[np.ix_(tx, carriers)]
    values = {name: np.stack([at_carrier[name][place] for at_carrier in found], axis=1) for name in found[0]}
    for of_links in values.values():
        of_links[missing] = np.nan
    carrier_hz = header.carrier_hz[carriers]
    distance_m = np.linalg.norm(dataset.tables["tx_position_m"][tx] - receiver_m, axis=1)
    in_sight = dataset.tables["line_of_sight"][tx].astype(bool)
    links = LinkStatistics(tx, carrier_hz, distance_m, in_sight, **values)
    if geometry is None or not geometry.meshes:
        return ChannelStatistics(links, np.nan, np.nan, np.full(len(carrier_hz), np.nan), source)
    corners_m = np.concatenate([mesh.vertices_m for mesh in geometry.meshes])
    x, y, z = np.ptp(corners_m, axis=0).tolist()
    policy = dataset.trace_settings.materials
    absorption = np.array([mean_absorption(geometry, carrier, policy) for carrier in carrier_hz.tolist()])
    return ChannelStatistics(links, x * y * z, 2 * (x * y + y * z + z * x), absorption, source)


def of_standards(distance_m: Float[FloatArray, "n"], carrier_hz: float, in_sight: bool) -> dict[str, Any]:
    """Values of standards for links in an office at n distances: path losses (n,), K, and the median of each spread.

    The path loss of 38.901 is for 1 to 150 m and .5 to 100 GHz, that of P.1238 for 2 to 27 m and .3 to 83.5 GHz. Values
    that a standard does not give are nan.
    """
    decades, carrier_ghz = np.log10(distance_m), carrier_hz / 1e9
    seen = 32.4 + 17.3 * decades + 20 * np.log10(carrier_ghz)
    unseen = np.maximum(seen, 17.3 + 38.3 * decades + 24.9 * np.log10(carrier_ghz))
    alpha, beta, gamma = (1.46, 34.62, 2.03) if in_sight else (2.46, 29.53, 2.38)
    is_high = carrier_ghz >= 6
    told: dict[str, Any] = {
        "path_loss_38901_db": seen if in_sight else unseen,
        "path_loss_p1238_db": 10 * alpha * decades + beta + 10 * gamma * np.log10(carrier_ghz),
        "k_factor_cluster_38901_db": 7.0 if in_sight else np.nan,
        "k_factor_cluster_mmmagic_db": float(4.9 + 5 * np.log10(1 + carrier_ghz)) if in_sight and is_high else np.nan,
    }
    for name, laws in _SPREADS.items():
        stem, _, unit = name.rpartition("_")
        for kind in ("38901", "mmmagic"):  # below 6 GHz, 38.901 takes that of 6 GHz indoors, and mmMAGIC says nothing
            is_told = kind in laws and (is_high or kind == "38901")
            constant, slope = laws[kind][0 if in_sight else 1] if is_told else (np.nan, np.nan)
            told[f"{stem}_{kind}_{unit}"] = float(10 ** (constant + slope * np.log10(1 + max(6.0, carrier_ghz))))
    return told


def of_paths(paths: RaggedPaths, carrier: int, window_db: float = WINDOW_DB) -> dict[str, Float[FloatArray, "T *S"]]:
    """The statistics of `LinkStatistics`, by name, of all T transmitters at the carrier of that number."""
    num_tx = len(paths.num_paths)
    tx = np.repeat(np.arange(num_tx), paths.num_paths)
    power = np.abs(paths.gain[:, carrier].astype(np.complex128)) ** 2
    strongest = np.zeros(num_tx)
    np.maximum.at(strongest, tx, power)
    least = np.maximum(strongest * 10 ** (-window_db / 10), np.finfo(float).tiny)[tx]
    mechanism = _mechanism(paths)
    # diffuse paths count together, so that the size of tiles does not matter
    diffuse = mechanism == MECHANISMS.index("diffuse")
    steps = 10_000  # of a nanosecond
    step = tx * steps + np.minimum(paths.delay_s * 1e9, steps - 1).astype(np.int64)
    nth = np.unique(step, return_inverse=True)[1].ravel()
    together = np.bincount(nth, power * diffuse)[nth]
    near = np.where(np.where(diffuse, together, power) >= least, power, 0.0)

    def total(weights: Float[FloatArray, "P"]) -> Float[FloatArray, "T"]:
        return np.bincount(tx, weights, num_tx).astype(np.float64)

    all_power = np.where(strongest > 0, paths.total_power(carrier), np.nan)
    near_power = np.where(strongest > 0, total(near), np.nan)
    late_s = paths.delay_s - np.nan_to_num(total(near * paths.delay_s) / near_power)[tx]

    def angular_spread_deg(angle_rad: Float[NDArray[np.float32], "P"]) -> Float[FloatArray, "T"]:
        east, north = (total(near * part(angle_rad.astype(np.float64))) for part in (np.cos, np.sin))
        length = np.clip(np.hypot(east, north) / near_power, np.finfo(float).tiny, 1)
        return np.asarray(np.degrees(np.sqrt(-2 * np.log(length))))

    first_s = np.full(num_tx, np.inf)
    np.minimum.at(first_s, tx[mechanism == 0], paths.delay_s[mechanism == 0])  # inf where no path is direct

    def k_factor_db(is_first: Bool[NDArray[np.bool_], "P"]) -> Float[FloatArray, "T"]:
        first, others = total(near * is_first), total(near * ~is_first)
        both = (first > 0) & (others > 0)
        return np.where(both, 10 * np.log10(np.where(both, first, 1) / np.where(both, others, 1)), np.nan)

    shares = [total(power * (mechanism == kind)) / all_power for kind in range(len(MECHANISMS))]
    return {
        "path_loss_db": -10 * np.log10(all_power),
        "delay_spread_s": np.sqrt(total(near * late_s**2) / near_power),
        "arrival_azimuth_spread_deg": angular_spread_deg(paths.arrival_azimuth_rad),
        "arrival_zenith_spread_deg": angular_spread_deg(paths.arrival_elevation_rad),
        "departure_azimuth_spread_deg": angular_spread_deg(paths.departure_azimuth_rad),
        "departure_zenith_spread_deg": angular_spread_deg(paths.departure_elevation_rad),
        "k_factor_db": k_factor_db(mechanism == 0),
        "k_factor_cluster_db": k_factor_db(np.abs(paths.delay_s - first_s[tx]) <= CLUSTER_S),
        "num_paths": np.where(strongest > 0, total((power >= least).astype(np.float64)), np.nan),
        "power_share": np.stack(shares, axis=-1),
    }


def _mechanism(paths: RaggedPaths) -> Int[IntArray, "P"]:
    """The place of each path in `MECHANISMS`."""
    path = np.repeat(np.arange(len(paths.delay_s)), paths.num_interactions)
    mechanism = np.minimum(paths.num_interactions, 1).astype(np.int64)
    for kind, code in enumerate((REFRACTION, DIFFRACTION, DIFFUSE), start=2):
        np.maximum.at(mechanism, path, np.where(paths.interaction == code, kind, 0))
    return np.asarray(mechanism, dtype=np.int64)


def _median(values: Float[FloatArray, "n"]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _scatter(values: Float[FloatArray, "n"]) -> float:
    known = values[np.isfinite(values)]
    return float(known.std()) if len(known) > 1 else float("nan")


def _exponent(loss_db: Float[FloatArray, "n"], distance_m: Float[FloatArray, "n"]) -> float:
    """The growth of the loss with a decade of distance, in units of 10 dB; nan if distances hardly differ."""
    decades = np.log10(distance_m)
    if len(decades) < 3 or np.ptp(decades) < 0.1:
        return float("nan")
    return float(np.polyfit(decades, loss_db, 1)[0] / 10)
