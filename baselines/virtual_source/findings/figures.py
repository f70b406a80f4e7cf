"""Draws what was learned: planes in the scene as PNG, reflection of its materials over angle as SVG or PNG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from xfreqbench.report.drawing.figures import plain_style, plan_and_elevation, save_figure, shown
from xfreqbench.types import FloatArray
from xfreqbench.units import format_ghz

from .compared import ComparedFindings
from .materials import ShownMaterial

_LEARNED, _TRUTH, _ABSENT = "#d55e00", "#0072b2", "#cc79a7"
_MARGIN = 0.08  # around what is shown, relative to its size
_LEAST_MM, _MOST_MM = 0.1, 50.0  # range of errors that the colours tell apart
_SCALE = LogNorm(_LEAST_MM, _MOST_MM)
_WIDTH_IN = 8.5  # as wide as a page shows it without making it smaller
_ANGLE_RAD = np.radians(np.linspace(0, 89, 90))
_LINES = {"TE": "-", "TM": "--"}
_FAINTEST = 0.2


@plain_style()
def plot_scene(compared: ComparedFindings, path: Path) -> None:
    """Draw plan and elevation of a scene and the found planes, cut off outside of it, as PNG. Raises `StorageError`."""
    facets_m = [facet.corners_m for plane in compared.planes for facet in plane.facets]
    corners_m = np.concatenate([*facets_m, compared.findings.array_m[None], compared.tx_m[None]])
    margin_m = _MARGIN * np.ptp(corners_m, axis=0).max()
    bounds_m = corners_m.min(axis=0) - margin_m, corners_m.max(axis=0) + margin_m
    figure, views = plan_and_elevation(*bounds_m, _WIDTH_IN)
    found = enumerate(zip(compared.findings.planes, compared.matches, strict=True))
    drawn = [(index, np.array(plane.corners_m), match) for index, (plane, match) in found if plane.corners_m]
    for axis, axes in views:
        outlines = [_closed(facet_m)[:, axes] for facet_m in facets_m]
        axis.add_collection(LineCollection(outlines, colors="0.75", linewidths=0.8))
        for number, (index, rectangle_m, match) in enumerate(drawn, start=1):
            error_mm = max(abs(match.distance_error_m * 1e3), _LEAST_MM) if match else None
            colour = _ABSENT if error_mm is None else mpl.colormaps["viridis"](float(_SCALE(error_mm)))
            line = "--" if error_mm is None else "-"
            axis.plot(*_closed(rectangle_m)[:, axes].T, line, color=colour, linewidth=2.5)
            start, end = rectangle_m[:2, axes]
            place = start + number / (len(drawn) + 1) * (end - start)  # labels of close planes stand apart
            axis.annotate(str(index), place, fontsize=9, color=colour, ha="left", va="bottom")
        axis.plot(*compared.findings.array_m[axes], "k^", markersize=7, label="receiver")
        axis.plot(*compared.tx_m[axes], "k*", markersize=8, label="transmitter")
    note = "; dashed: no such surface" if any(match is None for _, _, match in drawn) else ""
    label = f"distance error of a found plane (mm){note}"
    look: dict[str, Any] = {"location": "bottom", "shrink": 0.6, "aspect": 40, "extend": "both"}
    scale = ScalarMappable(_SCALE, "viridis")
    figure.colorbar(scale, ax=[axis for axis, _ in views], format="{x:g}", label=label, **look)
    views[0][0].legend(loc="best", fontsize="small")
    save_figure(figure, path, "png")


@plain_style()
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
    shares = [learned.slab.share for learned in material.learned]
    for pol, (name, line) in enumerate(_LINES.items()):
        axis.plot(angle_deg, true[pol], line, color=_TRUTH, linewidth=2.2, label=f"ITU-R P.2040, {name}")
        for share, curves in zip(shares, learned, strict=True):
            label = None if curves is not learned[0] else f"learned, {name}"
            look = {"color": _LEARNED, "linewidth": 1, "alpha": max(_FAINTEST, share), "label": label}
            axis.plot(angle_deg, curves[pol], line, **look)
    axis.set(xlim=(0, 90), ylim=(0, 1), xticks=(0, 30, 60, 90))
    axis.grid(alpha=0.3)


def _closed(corners_m: Float[FloatArray, "n 3"]) -> Float[FloatArray, "m 3"]:
    return np.vstack([corners_m, corners_m[:1]])
