"""Draws what was learned: planes and images in the scene as PNG, reflection against the carrier as SVG or PNG."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from xfreqbench.report.drawing.figures import label_decades, save_figure
from xfreqbench.report.findings.model import Reflection
from xfreqbench.types import FloatArray

_MAX_COLUMNS = 4
_TITLE_LETTERS = 55  # what a panel has room for
_LEARNED, _TRUTH, _ABSENT = "#d55e00", "#0072b2", "#cc79a7"
_MARGIN = 0.08  # around what is shown, relative to its size
_LEAST_MM, _MOST_MM = 0.1, 50.0  # range of errors that the colours tell apart
_SCALE = LogNorm(_LEAST_MM, _MOST_MM)
_VIEWS = {"plan": (0, 1), "elevation": (0, 2)}  # world axes to the right and upwards


@dataclass(frozen=True, eq=False)
class DrawnPlane:
    """A found plane's rectangle, its corners in turn; `error_mm` is None where no surface is there."""

    label: str
    corners_m: Float[FloatArray, "4 3"]
    error_mm: float | None


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """What a picture of the findings shows, in world axes; `source_db` is relative to the line of sight."""

    facets_m: Sequence[Float[FloatArray, "n 3"]]
    planes: Sequence[DrawnPlane]
    receiver_m: Float[FloatArray, "3"]
    tx_m: Float[FloatArray, "3"]
    source_m: Float[FloatArray, "k 3"]
    source_db: Float[FloatArray, "k"]


def plot_scene(drawn: DrawnScene, path: Path) -> None:
    """Draw plan and elevation of a scene as PNG: on the left the found planes, on the right the virtual sources too.

    Raises `StorageError`.
    """
    figure = Figure(figsize=(13, 10), layout="constrained")
    axes = figure.subplots(2, 2)
    for row, (view, shown) in zip(axes, _VIEWS.items(), strict=True):
        for axis, with_sources in zip(row, (False, True), strict=True):
            _draw_view(axis, drawn, shown, with_sources)
            axis.set_title(f"{view}, virtual sources" if with_sources else f"{view}, found planes")
    _show_scale(figure, axes, drawn)
    axes[0, 1].legend(loc="best", fontsize="small")
    save_figure(figure, path, "png")


def plot_reflection(
    panels: Mapping[str, tuple[Reflection, Reflection]], path: Path, kind: str = "svg"
) -> None:
    """Draw |R| at normal incidence as SVG or PNG, one panel for each plane.

    A panel's first reflection is drawn as curves along the band, its second as dots. Equal panels give equal bytes.
    Raises `StorageError`.
    """
    columns = max(1, min(_MAX_COLUMNS, len(panels)))
    rows = max(1, -(-len(panels) // columns))
    figure = Figure(figsize=(3.6 * columns + 0.4, 2.8 * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis, (title, (band, dots)) in zip(axes, panels.items(), strict=False):
        _draw_reflection(axis, band, dots)
        axis.set_title(textwrap.fill(title, _TITLE_LETTERS), fontsize="x-small", parse_math=False)
    if panels:
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    save_figure(figure, path, kind)


def _draw_reflection(axis: Any, band: Reflection, dots: Reflection) -> None:
    carrier_ghz = band.carrier_hz / 1e9
    axis.plot(carrier_ghz, band.truth, color=_TRUTH, linewidth=1, label="ITU-R P.2040")
    axis.plot(carrier_ghz, band.learned, color=_LEARNED, linewidth=1, label="learned")
    axis.plot(
        dots.carrier_hz / 1e9, dots.learned, ".", color=_LEARNED, label="learned, at the data's carriers"
    )
    axis.set(xscale="log", ylim=(0, 1), xlabel="carrier (GHz)", ylabel="|R| at normal incidence")
    label_decades(axis)
    axis.grid(alpha=0.3)


def _draw_view(axis: Any, drawn: DrawnScene, shown: tuple[int, int], with_sources: bool) -> None:
    outlines = [_closed(corners_m)[:, shown] for corners_m in drawn.facets_m]
    axis.add_collection(LineCollection(outlines, colors="0.75", linewidths=0.8))
    for number, plane in enumerate(drawn.planes, start=1):
        outline = _closed(plane.corners_m)[:, shown]
        line = "--" if plane.error_mm is None else "-"
        axis.plot(*outline.T, line, color=_colour(plane), linewidth=1.0 if with_sources else 2.5)
        if not with_sources:
            _label(axis, plane, shown, number / (len(drawn.planes) + 1))
    if with_sources:
        size = np.interp(drawn.source_db, (-40, 0), (3, 40))
        axis.scatter(*drawn.source_m[:, shown].T, s=size, color=_TRUTH, alpha=0.7, label="virtual source")
    axis.plot(*drawn.receiver_m[list(shown)], "k^", markersize=7, label="receiver")
    axis.plot(*drawn.tx_m[list(shown)], "k*", markersize=8, label="transmitter")
    names = [f"{'xyz'[index]} (m)" for index in shown]
    axis.set(xlabel=names[0], ylabel=names[1])
    axis.margins(_MARGIN)
    axis.autoscale_view()
    if not with_sources:
        _look_at_room(axis, drawn, shown)
    axis.set_aspect("equal", adjustable="datalim" if with_sources else "box")


def _look_at_room(axis: Any, drawn: DrawnScene, shown: tuple[int, int]) -> None:
    """Bound the axis by the room; planes found far outside are seen in the wider view with the sources."""
    corners = np.concatenate([*drawn.facets_m, drawn.receiver_m[None]])[:, shown]
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = _MARGIN * (high - low).max()
    axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))


def _label(axis: Any, plane: DrawnPlane, shown: tuple[int, int], share: float) -> None:
    """Write a plane's label on an edge, `share` of the way along it, so that labels of close planes stand apart."""
    start, end = plane.corners_m[:2, shown]
    place = start + share * (end - start)
    axis.annotate(plane.label, place, fontsize=8, color=_colour(plane), ha="left", va="bottom")


def _colour(plane: DrawnPlane) -> Any:
    if plane.error_mm is None:
        return _ABSENT
    return mpl.colormaps["viridis"](float(_SCALE(max(abs(plane.error_mm), _LEAST_MM))))


def _show_scale(figure: Figure, axes: Any, drawn: DrawnScene) -> None:
    note = "; dashed: no such surface" if any(plane.error_mm is None for plane in drawn.planes) else ""
    scale = ScalarMappable(_SCALE, "viridis")
    figure.colorbar(
        scale, ax=axes, label=f"distance error of a found plane (mm){note}", shrink=0.6, extend="both"
    )


def _closed(corners_m: Float[FloatArray, "n 3"]) -> Float[FloatArray, "m 3"]:
    return np.vstack([corners_m, corners_m[:1]])
