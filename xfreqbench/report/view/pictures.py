"""Single pictures of a data set, for papers and talks: one transmitter's maps, the power of all, or statistics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from scipy.spatial import KDTree

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.power import power_db
from xfreqbench.data.statistics import MECHANISMS, ChannelStatistics, statistics
from xfreqbench.errors import DataError, UnknownNameError, XFreqBenchError
from xfreqbench.maps.bartlett import power_of
from xfreqbench.maps.drawing import DISPLAY_RANGE_DB
from xfreqbench.report.drawing.figures import (
    figure_kind,
    label_decades,
    panels,
    plain_style,
    plot_pas_maps,
    save_figure,
    shown,
)
from xfreqbench.report.view.describe import known_line_of_sight
from xfreqbench.report.view.figures import bounds_m, draw_outlines
from xfreqbench.report.view.plan import ShownRoom, plan_view
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz


def draw_maps(file: Path, tx: int, carriers_hz: Sequence[float] | None, range_db: float, output: Path) -> None:
    """Draw the maps of one transmitter at some carriers, at all if None, with a title that says which one it is.

    Raises `DataError`, `XFreqBenchError` for an unknown transmitter, `UnknownNameError` for an unknown carrier, and
    `StorageError`.
    """
    dataset = open_dataset(file)
    if not 0 <= tx < dataset.header.num_tx:
        raise XFreqBenchError(f"{file} holds transmitters 0 to {dataset.header.num_tx - 1}, but {tx} is asked for.")
    chosen_hz = _chosen_hz(dataset, carriers_hz)
    known_hz = dataset.header.carrier_hz.tolist()
    samples = dataset[[tx * len(known_hz) + known_hz.index(carrier) for carrier in chosen_hz]]
    titles = [format_ghz(carrier) for carrier in chosen_hz]
    maps = power_of(samples.pas(), dataset.header.pas_kind)
    place = ", ".join(f"{metres:.2f}" for metres in dataset.tables["tx_position_m"][tx])
    in_sight = known_line_of_sight(dataset)
    sight = "" if in_sight is None else (", in sight" if in_sight[tx] else ", in shadow")
    title = f"{_name(dataset)}\ntransmitter {tx} at ({place}) m{sight}"
    plot_pas_maps(maps, dataset.grid, titles, output, title, range_db)


def draw_power(file: Path, carriers_hz: Sequence[float] | None, range_db: float, output: Path) -> None:
    """Draw the plan of a data set's room with the power received from every transmitter, at all carriers if None.

    Raises as `draw_maps` does, and `DataError` for data without channels.
    """
    dataset = open_dataset(file)
    chosen_hz = _chosen_hz(dataset, carriers_hz)
    if not dataset.header.channels:
        raise DataError(f"{file} has maps without channels, so powers are not known; draw --of maps.")
    power = np.stack([10 ** (power_db(dataset[dataset.carrier_hz == f]) / 10) for f in chosen_hz])
    room = plan_view(str(file)).room
    title = f"{_name(dataset)}\npower received from {dataset.header.num_tx} transmitters"
    plot_power(room, power, chosen_hz, output, title, range_db)


def _chosen_hz(dataset: PasDataset, carriers_hz: Sequence[float] | None) -> list[float]:
    """Each carrier once; raises `UnknownNameError` for one that the data set does not have."""
    known_hz = dataset.header.carrier_hz.tolist()
    chosen_hz = list(dict.fromkeys(known_hz if carriers_hz is None else carriers_hz))
    for carrier in chosen_hz:
        if carrier not in known_hz:
            raise UnknownNameError("carrier", format_ghz(carrier), map(format_ghz, known_hz))
    return chosen_hz


def _name(dataset: PasDataset) -> str:
    return shown(f"{dataset.path.name}, scene {dataset.header.scene_name}")


@plain_style()
def plot_power(
    room: ShownRoom,
    power: Float[FloatArray, "F T"],
    carrier_hz: Sequence[float],
    path: Path,
    title: str = "",
    range_db: float = DISPLAY_RANGE_DB,
) -> None:
    """Draw the plan of a room with a square for each transmitter, coloured by its power in dB below the strongest.

    `power` has F carriers and the room's T transmitters; each carrier has a panel, whose title says how strong the
    strongest is. Of transmitters above each other the mean is shown; no square is drawn where no path arrives. The
    suffix of `path` says which kind of figure is written. Raises `StorageError`.
    """
    same_place_m = 1e-3
    in_plan = np.round(room.tx_position_m[:, :2] / same_place_m)
    places, which = np.unique(in_plan, axis=0, return_inverse=True)
    which, place_m = which.ravel(), places * same_place_m
    number = np.bincount(which)
    columns = min(3, len(power))
    rows = -(-len(power) // columns)
    low_m, high_m = bounds_m(room)
    width_m, depth_m = (high_m - low_m)[:2]
    size_in = 3.4 * columns + 1.0, float(np.clip(3.0 * depth_m / width_m + 0.6, 1.5, 7.0)) * rows + 0.4
    figure = Figure(figsize=size_in, layout="constrained")
    axes = panels(figure, len(power), columns)
    for axis, of_carrier, carrier in zip(axes, power, carrier_hz, strict=True):
        mean = np.bincount(which, of_carrier) / number
        draw_outlines(axis, room, [0, 1])
        squares = _draw_squares(axis, place_m, mean, range_db)
        axis.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[1], high_m[1]), aspect="equal")
        axis.set(xlabel="x (m)", ylabel="y (m)")
        strongest = f"strongest {10 * np.log10(mean.max()):.0f} dB" if mean.any() else "no path"
        axis.set_title(f"{format_ghz(carrier)}, {strongest}", fontsize="medium")
    figure.colorbar(squares, ax=axes, label="dB below the strongest", shrink=0.8)
    if title:
        figure.suptitle(title, fontsize="medium")
    save_figure(figure, path, figure_kind(path))


def _draw_squares(
    axis: Any, place_m: Float[FloatArray, "P 2"], power: Float[FloatArray, "P"], range_db: float
) -> PolyCollection:
    """Squares that touch if transmitters are on a grid; the strong ones are drawn over the weak ones."""
    heard = np.flatnonzero(power > 0)
    order = heard[np.argsort(power[heard], kind="stable")]
    apart_m = KDTree(place_m).query(place_m, k=2)[0][:, 1] if len(place_m) > 1 else np.array([np.inf])
    half_m = min(float(np.median(apart_m)), 0.5) / 2
    corners = half_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    level_db = 10 * np.log10(power[order] / power.max()) if len(order) else np.zeros(0)
    outlines_m: Any = place_m[order, None] + corners
    colours: dict[str, Any] = {"array": level_db, "cmap": "viridis", "clim": (-range_db, 0), "linewidths": 0}
    above_lines = 3 if len(axis.lines) > 1000 else 1  # outlines of many facets would hide the squares
    squares = PolyCollection(outlines_m, zorder=above_lines, **colours)
    axis.add_collection(squares)
    return squares


def draw_statistics(file: Path, output: Path) -> None:
    """Draw a data set's statistics by carrier: the data as dots, the standards as lines, and the mechanisms as bars.

    Raises as `statistics` does, and `StorageError`.
    """
    plot_statistics(statistics(open_dataset(file)), file.name, output)


@plain_style()
def plot_statistics(statistics: ChannelStatistics, name: str, output: Path) -> None:
    """The figure of `draw_statistics`, of the data set of a name; raises `StorageError`."""
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    standards = {
        "38901": ("3GPP TR 38.901 InH", "--"),
        "mmmagic": ("mmMAGIC", "-."),
        "small_room": ("small room", ":"),
        "room_decay": ("room's decay", (0, (1, 3))),
    }
    drawn = (
        ("path_loss_above_38901", "path loss over 3GPP TR 38.901 (dB)", "db", ()),
        ("k_factor_cluster", "K of a cluster (dB)", "db", ("38901", "mmmagic")),
        ("delay_spread", "delay spread (ns)", "ns", tuple(standards)),
        ("arrival_azimuth_spread", "azimuth spread at the array (°)", "deg", ("38901", "mmmagic")),
        ("departure_azimuth_spread", "azimuth spread at transmitters (°)", "deg", ("38901", "mmmagic")),
    )
    first_sight = any(row["in_sight"] for row in statistics.rows)
    for axis, (what, title, unit, beside) in zip(axes, drawn, strict=False):
        for in_sight, words, colour in ((True, "in sight", "tab:blue"), (False, "not in sight", "tab:red")):
            rows = [row for row in statistics.rows if row["in_sight"] == in_sight]
            carriers_ghz = [row["carrier_ghz"] for row in rows]
            axis.plot(carriers_ghz, [row[f"{what}_{unit}"] for row in rows], "o", color=colour, label=words)
            for other in beside if rows else ():
                values = [row[f"{what}_{other}_{unit}"] for row in rows]
                name_of, style = standards[other]
                label = name_of if in_sight == first_sight else None
                axis.plot(carriers_ghz, values, linestyle=style, color=colour, label=label)
        axis.set(xscale="log", xlabel="carrier (GHz)")
        axis.set_title(title, fontsize="medium")
        if unit != "db":
            axis.set_ylim(bottom=0)
        label_decades(axis)
    figure.legend(*axes[2].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize="small")
    _draw_shares(axes[5], statistics.rows)
    figure.suptitle(shown(f"{name}: {statistics.source}"), fontsize="medium")
    save_figure(figure, output, figure_kind(output))


def _draw_shares(axis: Any, rows: list[dict[str, Any]]) -> None:
    """Stacked bars of the power by mechanism, a bar for each row."""
    labels = [f"{row['carrier_ghz']:.12g}" + ("" if row["in_sight"] else "*") for row in rows]
    bottom = np.zeros(len(rows))
    for mechanism in MECHANISMS:
        share = np.array([row[f"share_{mechanism}"] for row in rows])
        if share.any():
            axis.bar(range(len(rows)), share, bottom=bottom, label=mechanism)
            bottom += share
    axis.set(xlabel="carrier (GHz), * not in sight", ylim=(0, 1))
    axis.set_title("power by mechanism", fontsize="medium")
    axis.set_xticks(range(len(rows)), labels, rotation=90, fontsize="small")
    axis.legend(fontsize="x-small", loc="lower right")
