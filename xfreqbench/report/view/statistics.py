"""The figure of a data set's statistics by carrier, beside the standards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.statistics import MECHANISMS, ChannelStatistics
from xfreqbench.report.drawing.figures import figure_kind, label_decades, save_figure, shown

_PANELS = {  # of a row's name: its title, its unit in names, and what stands beside it
    "path_loss_above_38901": ("path loss over 3GPP TR 38.901 (dB)", "db", ()),
    "k_factor": ("K (dB)", "db", ("38901", "mmmagic")),
    "delay_spread": ("delay spread (ns)", "ns", ("38901", "mmmagic", "small_room", "room_decay")),
    "arrival_azimuth_spread": ("azimuth spread at the array (°)", "deg", ("38901",)),
    "departure_azimuth_spread": ("azimuth spread at transmitters (°)", "deg", ("38901", "mmmagic")),
}
_NAMES = {"38901": "3GPP TR 38.901 InH", "mmmagic": "mmMAGIC", "small_room": "small room", "room_decay": "room's decay"}
_STYLES = {"38901": "--", "mmmagic": "-.", "small_room": ":", "room_decay": (0, (1, 3))}
_SIGHTS = {True: ("in sight", "tab:blue"), False: ("not in sight", "tab:red")}


def draw_statistics(file: Path, output: Path) -> None:
    """Draw a data set's statistics by carrier: the data as dots, the standards as lines, and the mechanisms as bars.

    Raises as `channel_statistics` does, and `StorageError`.
    """
    plot_statistics(open_dataset(file).statistics(), file.name, output)


def plot_statistics(statistics: ChannelStatistics, name: str, output: Path) -> None:
    """The figure of `draw_statistics`, of the data set of a name; raises `StorageError`."""
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for axis, (name, (title, unit, beside)) in zip(axes, _PANELS.items(), strict=False):
        for in_sight, (words, colour) in _SIGHTS.items():
            rows = [row for row in statistics.rows if row["in_sight"] == in_sight]
            carriers_ghz = [row["carrier_ghz"] for row in rows]
            axis.plot(carriers_ghz, [row[f"{name}_{unit}"] for row in rows], "o", color=colour, label=words)
            for other in beside if rows else ():
                values = [row[f"{name}_{other}_{unit}"] for row in rows]
                label = _NAMES[other] if in_sight else None
                axis.plot(carriers_ghz, values, linestyle=_STYLES[other], color=colour, label=label)
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
    labels = [f"{row['carrier_ghz']:g}" + ("" if row["in_sight"] else "*") for row in rows]
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
