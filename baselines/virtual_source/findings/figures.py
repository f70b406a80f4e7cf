"""Draws what was learned: planes in the scene as PNG, reflection of its materials over angle as SVG or PNG."""

from __future__ import annotations

from collections.abc import Sequence
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

from xfreqbench.report.drawing.figures import plan_and_elevation, save_figure, shown
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz

from .materials import ShownMaterial

_LEARNED, _TRUTH, _ABSENT = "#d55e00", "#0072b2", "#cc79a7"
_MARGIN = 0.08  # around what is shown, relative to its size
_LEAST_MM, _MOST_MM = 0.1, 50.0  # range of errors that the colours tell apart
_SCALE = LogNorm(_LEAST_MM, _MOST_MM)
_WIDTH_IN = 8.5  # as wide as a page shows it without making it smaller
_ANGLE_RAD = np.radians(np.linspace(0, 89, 90))
_LINES = {"TE": "-", "TM": "--"}
_FAINTEST = 0.2


@dataclass(frozen=True, eq=False)
class DrawnPlane:
    """A found plane's rectangle, its corners in turn; `error_mm` is None where no surface is there."""

    label: str
    corners_m: Float[FloatArray, "4 3"]
    error_mm: float | None


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """What a picture of the findings shows, in world axes."""

    facets_m: Sequence[Float[FloatArray, "n 3"]]
    planes: Sequence[DrawnPlane]
    receiver_m: Float[FloatArray, "3"]
    tx_m: Float[FloatArray, "3"]

    def bounds_m(self) -> tuple[FloatArray, FloatArray]:
        """The lowest and the highest x, y and z of the scene, with a margin; planes found outside are cut off."""
        corners_m = np.concatenate([*self.facets_m, self.receiver_m[None], self.tx_m[None]])
        margin_m = _MARGIN * np.ptp(corners_m, axis=0).max()
        return corners_m.min(axis=0) - margin_m, corners_m.max(axis=0) + margin_m


def plot_scene(drawn: DrawnScene, path: Path) -> None:
    """Draw plan and elevation of a scene and of the planes that were found as PNG. Raises `StorageError`."""
    figure, views = plan_and_elevation(*drawn.bounds_m(), _WIDTH_IN)
    for axis, shown_axes in views:
        _draw_view(axis, drawn, shown_axes)
    _show_scale(figure, [axis for axis, _ in views], drawn)
    views[0][0].legend(loc="best", fontsize="small")
    save_figure(figure, path, "png")


def plot_materials(
    materials: Sequence[ShownMaterial], carriers_hz: Sequence[float], path: Path, kind: str = "svg"
) -> None:
    """Draw |R| against the angle of incidence as SVG or PNG: a row for each material, a column for each carrier.

    Equal materials give equal bytes. Raises `StorageError`.
    """
    rows = max(1, len(materials))
    figure = Figure(figsize=(_WIDTH_IN, 2.1 * rows + 0.8), layout="constrained")
    axes = figure.subplots(rows, len(carriers_hz), squeeze=False, sharex=True, sharey=True)
    for row, material in zip(axes, materials, strict=False):
        for axis, carrier_hz in zip(row, carriers_hz, strict=True):
            _draw_reflection(axis, material, carrier_hz)
        row[0].set_ylabel(f"{shown(material.title)}\n|R|")
    for axis, carrier_hz in zip(axes[0], carriers_hz, strict=True):
        axis.set_title(format_ghz(carrier_hz))
    for axis in axes[-1]:
        axis.set_xlabel("angle of incidence (°)")
    if materials:
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save_figure(figure, path, kind)


def _draw_reflection(axis: Any, material: ShownMaterial, carrier_hz: float) -> None:
    """Draw the truth, and what was learned the fainter the less of its plane it fills."""
    angle_deg, true = np.degrees(_ANGLE_RAD), material.true_over_angle(carrier_hz, _ANGLE_RAD)
    learned = material.learned_over_angle(carrier_hz, _ANGLE_RAD)
    shares = [each.slab.share for each in material.learned]
    for pol, (name, line) in enumerate(_LINES.items()):
        axis.plot(angle_deg, true[pol], line, color=_TRUTH, linewidth=2.2, label=f"ITU-R P.2040, {name}")
        for share, curves in zip(shares, learned, strict=True):
            label = None if curves is not learned[0] else f"learned, {name}"
            axis.plot(
                angle_deg,
                curves[pol],
                line,
                color=_LEARNED,
                linewidth=1,
                alpha=max(_FAINTEST, share),
                label=label,
            )
    axis.set(xlim=(0, 90), ylim=(0, 1), xticks=(0, 30, 60, 90))
    axis.grid(alpha=0.3)


def _draw_view(axis: Any, drawn: DrawnScene, shown: list[int]) -> None:
    outlines = [_closed(corners_m)[:, shown] for corners_m in drawn.facets_m]
    axis.add_collection(LineCollection(outlines, colors="0.75", linewidths=0.8))
    for number, plane in enumerate(drawn.planes, start=1):
        outline = _closed(plane.corners_m)[:, shown]
        line = "--" if plane.error_mm is None else "-"
        axis.plot(*outline.T, line, color=_colour(plane), linewidth=2.5)
        _label(axis, plane, shown, number / (len(drawn.planes) + 1))
    axis.plot(*drawn.receiver_m[shown], "k^", markersize=7, label="receiver")
    axis.plot(*drawn.tx_m[shown], "k*", markersize=8, label="transmitter")


def _label(axis: Any, plane: DrawnPlane, shown: list[int], share: float) -> None:
    """Write a plane's label on an edge, `share` of the way along it, so that labels of close planes stand apart."""
    start, end = plane.corners_m[:2, shown]
    place = start + share * (end - start)
    axis.annotate(plane.label, place, fontsize=9, color=_colour(plane), ha="left", va="bottom")


def _colour(plane: DrawnPlane) -> Any:
    if plane.error_mm is None:
        return _ABSENT
    return mpl.colormaps["viridis"](float(_SCALE(max(abs(plane.error_mm), _LEAST_MM))))


def _show_scale(figure: Figure, axes: Any, drawn: DrawnScene) -> None:
    note = "; dashed: no such surface" if any(plane.error_mm is None for plane in drawn.planes) else ""
    scale = ScalarMappable(_SCALE, "viridis")
    label = f"distance error of a found plane (mm){note}"
    figure.colorbar(
        scale, ax=axes, location="bottom", shrink=0.6, aspect=40, extend="both", format="{x:g}", label=label
    )


def _closed(corners_m: Float[FloatArray, "n 3"]) -> Float[FloatArray, "m 3"]:
    return np.vstack([corners_m, corners_m[:1]])
