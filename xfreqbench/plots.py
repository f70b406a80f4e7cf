"""Figures: score distributions as SVG, maps as PNG. The only module that imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy.typing import NDArray

from xfreqbench.storage import atomic_path, storage_errors

_MAX_COLUMNS = 3
_MAX_DISCS = 5  # maps side by side
_DISPLAY_RANGE_DB = 30.0
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito
_LINES = ("-", "--", ":", "-.")

Curves = Mapping[str, Sequence[float]]


def plot_score_cdf(panels: Mapping[str, Curves], score_name: str, path: Path) -> None:
    """Empirical CDFs as SVG: one panel a split, one curve a method (equally spaced quantiles from 0 to 1).

    Equal curves give equal bytes. Raises `StorageError`.
    """
    columns = min(_MAX_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.6 * columns, 3.0 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, (title, curves) in zip(axes, panels.items(), strict=False):
        _draw_curves(axis, curves)
        axis.set(title=title, xlabel=score_name, ylabel="share of maps at or below", ylim=(0, 1))
        axis.grid(alpha=0.3)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    handles = {line.get_label(): line for axis in axes for line in axis.get_lines()}
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=3, fontsize="small"
    )
    _save(figure, path, "svg")


def plot_pas_maps(maps: Float[NDArray[np.float32], "N E A"], titles: Sequence[str], path: Path) -> None:
    """Maps of a whole hemisphere as discs seen from the pole, in dB below the peak: a PNG.

    The rim is the equator, azimuth runs counter-clockwise from the right. Raises `StorageError`.
    """
    columns = min(_MAX_DISCS, len(maps))
    rows = -(-len(maps) // columns)
    figure = Figure(figsize=(2.2 * columns + 0.9, 2.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "polar"}).ravel()
    for axis in axes[len(maps) :]:
        axis.set_visible(False)
    for axis, pas_map, title in zip(axes, maps, titles, strict=False):
        image = _draw_disc(axis, pas_map)
        axis.set_title(title, fontsize="medium")
    figure.colorbar(image, ax=list(axes), label="dB below the peak", shrink=0.8)
    _save(figure, path, "png")


def _draw_curves(axis: Any, curves: Curves) -> None:
    for index, (label, quantiles) in enumerate(curves.items()):
        levels = np.linspace(0, 1, len(quantiles))
        colour = _COLOURS[index % len(_COLOURS)]
        style = _LINES[index // len(_COLOURS) % len(_LINES)]
        axis.plot(quantiles, levels, style, color=colour, label=label, linewidth=1.4)


def _draw_disc(axis: Any, pas_map: Float[NDArray[np.float32], "E A"]) -> Any:
    num_elevations, num_azimuths = pas_map.shape
    azimuth_edge_rad = (np.arange(num_azimuths + 1) - 0.5) * (2 * np.pi / num_azimuths)
    polar_edge_deg = 90 - np.arange(num_elevations + 1) * (90 / num_elevations)
    level_db = 10 * np.log10(np.maximum(pas_map, 10 ** (-_DISPLAY_RANGE_DB / 10)))
    axis.set(xticks=[], yticks=[])
    axis.grid(False)
    return axis.pcolormesh(
        azimuth_edge_rad,
        polar_edge_deg,
        level_db,
        vmin=-_DISPLAY_RANGE_DB,
        vmax=0,
        cmap="magma",
        rasterized=True,
    )


def _save(figure: Figure, path: Path, kind: str) -> None:
    metadata = {"Date": None, "Creator": None} if kind == "svg" else {"Software": None}
    fixed: Any = {"svg.hashsalt": "xfreqbench", "svg.fonttype": "none"}
    with mpl.rc_context(fixed), atomic_path(path) as temporary, storage_errors(path):
        figure.savefig(temporary, format=kind, metadata=metadata, dpi=150)
