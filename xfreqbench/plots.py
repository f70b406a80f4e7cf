"""Figures: score distributions and costs as SVG, maps as PNG."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import Bbox
from numpy.typing import NDArray
from PIL import Image

from xfreqbench.angles import AngularGrid
from xfreqbench.pareto import pareto_front
from xfreqbench.records import BenchFigure, BenchPoint
from xfreqbench.storage import atomic_path, storage_errors

_MAX_COLUMNS = 3
_SOFTWARE = "xfreqbench"  # in the PNGs that we write, and may write over
_MAX_DISCS = 5  # maps side by side
_DISPLAY_RANGE_DB = 30.0
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito
_LINES = ("-", "--", ":", "-.")
_NUM_COLOURS = 64  # of a small picture: an eye sees no more, and its PNG is half as large as with 256
_MARKERS = ("o", "s", "D", "^", "v", "P", "X")
_LABEL_GAPS_PX = (9, 16, 26, 40)
_TRIVIAL_LABEL, _FRONT_LABEL = "best trivial predictor", "Pareto front"

Curves = Mapping[str, Sequence[float]]


@dataclass(frozen=True)
class TimePanel:
    """One panel of error against time: a line a method and the Pareto front, (seconds, SSIM) each.

    `trivial` is the SSIM of the best trivial predictor, None where unknown.
    """

    lines: Mapping[str, Sequence[tuple[float, float]]]
    front: Sequence[tuple[float, float]]
    trivial: float | None


def plot_score_cdf(panels: Mapping[str, Curves], score_name: str, path: Path) -> None:
    """Empirical CDFs as SVG: one panel a split, one curve a method (equally spaced quantiles from 0 to 1).

    Equal curves give equal bytes. Raises `StorageError`.
    """
    labels = _labels(panels.values())
    figure, axes = _panel_figure(len(panels), labels)
    for axis, (title, curves) in zip(axes, panels.items(), strict=True):
        for label, quantiles in curves.items():
            axis.plot(
                quantiles, np.linspace(0, 1, len(quantiles)), label=label, **_style(labels.index(label))
            )
        axis.set(xlabel=score_name, ylabel="share of maps at or below", ylim=(0, 1))
        axis.set_title(title, fontsize="medium")
    _share_legend(figure, axes)
    save_figure(figure, path, "svg")


def plot_error_against_time(panels: Mapping[str, TimePanel], path: Path) -> None:
    """Median SSIM against seconds of fitting as SVG: one panel a split, one line a method.

    Points of the Pareto front are ringed, the best trivial predictor is a dashed line. Equal panels give
    equal bytes. Raises `StorageError`.
    """
    labels = _labels(panel.lines for panel in panels.values())
    figure, axes = _panel_figure(len(panels), [*labels, _TRIVIAL_LABEL, _FRONT_LABEL])
    for axis, (title, panel) in zip(axes, panels.items(), strict=True):
        _draw_against_time(axis, panel, labels)
        axis.set(xlabel="seconds of fitting", xscale="log", ylabel="median SSIM, sample of maps")
        label_decades(axis)
        axis.set_title(title, fontsize="medium")
    _share_legend(figure, axes)
    save_figure(figure, path, "svg")


def plot_pas_maps(
    maps: Float[NDArray[np.float32], "N E A"], grid: AngularGrid, titles: Sequence[str], path: Path
) -> None:
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
        image = _draw_disc(axis, pas_map, grid)
        axis.set_title(title, fontsize="medium")
    figure.colorbar(image, ax=list(axes), label="dB below the peak", shrink=0.8)
    save_figure(figure, path, "png")


def plot_cost(figure: BenchFigure, path: Path) -> None:
    """What accuracy costs, as SVG: `x` is a cost, the less the better, `y` an accuracy, the more the better.

    One line a series in the order of its costs; the measurements that no other beats in both are ringed and
    joined by a grey step. A label that its points share is written once. Equal figures give equal bytes.
    Raises `StorageError`.
    """
    canvas = Figure(figsize=(8.0, 5.4), layout="constrained")
    axis = canvas.subplots()
    by_series = _by_series(figure.points)
    for index, (series, points) in enumerate(by_series.items()):
        _draw_series(axis, index, series, points)
    _draw_front(axis, figure.points)
    axis.set(xlabel=figure.x_label, ylabel=figure.y_label, xscale="log" if figure.log_x else "linear")
    if figure.log_x:
        label_decades(axis)
    axis.margins(0.1)
    axis.grid(alpha=0.3)
    canvas.legend(loc="outside lower center", ncols=3, fontsize="small")
    _write_labels(canvas, axis, figure.points, list(by_series))
    save_figure(canvas, path, "svg")


def _by_series(points: Sequence[BenchPoint]) -> dict[str, list[BenchPoint]]:
    """Points of each series by cost, series in their order."""
    names = dict.fromkeys(point.series for point in points)
    by_cost = sorted(points, key=lambda point: point.x)
    return {name: [point for point in by_cost if point.series == name] for name in names}


def _draw_series(axis: Any, index: int, series: str, points: Sequence[BenchPoint]) -> None:
    style = _LINES[index // len(_COLOURS) % len(_LINES)]
    axis.plot(
        [point.x for point in points],
        [point.y for point in points],
        style,
        marker=_MARKERS[index % len(_MARKERS)],
        markersize=5,
        color=_COLOURS[index % len(_COLOURS)],
        label=series,
        linewidth=1.2,
    )


def _draw_front(axis: Any, points: Sequence[BenchPoint]) -> None:
    front = pareto_front(points, cost=lambda point: point.x, score=lambda point: point.y)
    x, y = [point.x for point in front], [point.y for point in front]
    axis.step(x, y, where="post", color="0.7", linewidth=4, alpha=0.5, zorder=0)
    ring = {"facecolors": "none", "edgecolors": "0.2", "linewidths": 1.0, "zorder": 3}
    axis.scatter(x, y, s=90, label="no other is both cheaper and better", **ring)


def _write_labels(canvas: Figure, axis: Any, points: Sequence[BenchPoint], series: Sequence[str]) -> None:
    """Each label in its series' colour, tied to its point, where it covers least of other labels and marks."""
    canvas.draw_without_rendering()
    canvas.set_layout_engine("none")  # the axes stay where the places were looked for
    shown = {(point.label, point.x, point.y): point.series for point in reversed(points)}
    taken = [_around(*axis.transData.transform((x, y)).tolist()) for _, x, y in shown]
    for (label, x, y), name in reversed(shown.items()):
        colour = _COLOURS[series.index(name) % len(_COLOURS)]
        tie = {"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkA": 0, "shrinkB": 0}
        place = {"xytext": (0, 0), "textcoords": "offset points", "arrowprops": tie}
        text = axis.annotate(label, (x, y), **place, fontsize=7, color=colour)
        size = text.get_window_extent().padded(2)
        boxes = [_around(*place, size.width, size.height) for place in _places(axis, x, y, size)]
        best = min(boxes, key=lambda box: _covered(box, taken, axis.bbox.frozen()))
        points_per_px = 72 / canvas.dpi
        text.set_position(((best.x0 - size.x0) * points_per_px, (best.y0 - size.y0) * points_per_px))
        taken.append(best)


def _places(axis: Any, x: float, y: float, size: Bbox) -> list[tuple[float, float]]:
    """Centres of a label in pixels, the nearest first: on eight sides of its point."""
    at_x, at_y = axis.transData.transform((x, y)).tolist()
    return [
        (at_x + right * (size.width / 2 + gap), at_y + up * (size.height / 2 + gap))
        for gap in _LABEL_GAPS_PX
        for right, up in ((1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1), (-1, 0))
    ]


def _around(x: float, y: float, width: float = 10.0, height: float = 10.0) -> Bbox:
    return Bbox.from_bounds(x - width / 2, y - height / 2, width, height)


def _covered(box: Bbox, taken: Sequence[Bbox], frame: Bbox) -> float:
    """Area of others that a label would cover, and of itself that would stick out of the frame."""
    return box.width * box.height - _overlap(box, frame) + sum(_overlap(box, other) for other in taken)


def _overlap(box: Bbox, other: Bbox) -> float:
    common = Bbox.intersection(box, other)
    return common.width * common.height if common else 0.0


def map_png(values: Float[NDArray[np.floating], "E A"], colormap: str) -> bytes:
    """Values from 0 to 1, clipped, as a small PNG with a palette, a pixel a value, the first row at the top."""
    levels = np.round(np.clip(values, 0, 1) * (_NUM_COLOURS - 1)).astype(np.uint8)
    colours = mpl.colormaps[colormap](np.linspace(0, 1, _NUM_COLOURS), bytes=True)[:, :3]
    picture = Image.fromarray(levels)
    picture.putpalette(colours.tobytes())
    buffer = BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def label_decades(axis: Any) -> None:
    """Numbers written out at each decade, and at 2 and 5 of it where there are few decades."""
    low, high = axis.get_xlim()
    is_wide = np.log10(high / low) > 3
    axis.xaxis.set_major_locator(LogLocator(subs=(1,) if is_wide else (1, 2, 5)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def _draw_against_time(axis: Any, panel: TimePanel, labels: Sequence[str]) -> None:
    for label, points in panel.lines.items():
        seconds, ssim = zip(*points, strict=True)
        axis.plot(seconds, ssim, marker=".", markersize=4, label=label, **_style(labels.index(label)))
    if panel.trivial is not None:
        axis.axhline(panel.trivial, color="0.4", linestyle="--", linewidth=1, label=_TRIVIAL_LABEL)
    if panel.front:
        ring: dict[str, Any] = {"facecolors": "none", "edgecolors": "black", "zorder": 3, "linewidth": 0.8}
        axis.scatter(*zip(*panel.front, strict=True), s=42, label=_FRONT_LABEL, **ring)
    axis.set_ylim(bottom=_lowest_shown(panel))


def _lowest_shown(panel: TimePanel) -> float:
    """The first seconds of a fit may lie far below: what is shown is where methods differ."""
    ends = [points[-1][1] for points in panel.lines.values()] + ([panel.trivial] if panel.trivial else [])
    return max(0.0, min(ends) - 0.12)


def _panel_figure(number: int, labels: Sequence[str]) -> tuple[Figure, list[Any]]:
    """A figure with a grid of that many axes, and room for a legend of the labels below."""
    columns = number if number <= _MAX_COLUMNS else -(-number // 2)
    rows = -(-number // columns)
    width_in = max(3.6 * columns, 6.0)
    legend_rows = -(-len(labels) // _legend_columns(labels, width_in))
    figure = Figure(figsize=(width_in, 3.0 * rows + 0.3 + 0.19 * legend_rows), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axis in axes[:number]:
        axis.grid(alpha=0.3)
    for axis in axes[number:]:
        axis.set_visible(False)
    return figure, axes[:number]


def _legend_columns(labels: Sequence[str], width_in: float) -> int:
    """As many as the longest label leaves room for: a letter is about 0.065 inches wide, a line 0.6."""
    return max(1, int(width_in / (0.6 + 0.065 * max(map(len, labels)))))


def _share_legend(figure: Figure, axes: Sequence[Any]) -> None:
    found = [pair for axis in axes for pair in zip(*axis.get_legend_handles_labels(), strict=True)]
    handles = {label: handle for handle, label in found}
    labels = sorted(handles, key=(_TRIVIAL_LABEL, _FRONT_LABEL).__contains__)  # methods first
    columns = _legend_columns(labels, figure.get_figwidth())
    figure.legend(
        [handles[label] for label in labels],
        labels,
        loc="outside lower center",
        ncols=columns,
        fontsize="small",
    )


def _labels(panels: Iterable[Mapping[str, Any]]) -> list[str]:
    """Every label once, so that a method looks alike in every panel."""
    return list(dict.fromkeys(label for panel in panels for label in panel))


def _style(index: int) -> dict[str, Any]:
    return {
        "color": _COLOURS[index % len(_COLOURS)],
        "linestyle": _LINES[index // len(_COLOURS) % len(_LINES)],
        "linewidth": 1.4,
    }


def _draw_disc(axis: Any, pas_map: Float[NDArray[np.float32], "E A"], grid: AngularGrid) -> Any:
    level_db = 10 * np.log10(np.maximum(pas_map, 10 ** (-_DISPLAY_RANGE_DB / 10)))
    axis.set(xticks=[], yticks=[])
    axis.grid(False)
    image = axis.pcolormesh(
        grid.azimuth_rad,
        90 - np.degrees(grid.elevation_rad),
        level_db,
        shading="nearest",
        vmin=-_DISPLAY_RANGE_DB,
        vmax=0,
        cmap="magma",
        rasterized=True,
    )
    axis.set_rlim(0, 90)
    return image


def is_own_png(path: Path) -> bool:
    """Whether a file is a PNG that `save_figure` wrote; raises `StorageError` where it cannot be read."""
    with storage_errors(path), path.open("rb") as file:
        head = file.read(256)  # the text chunk stands behind the size
    return head.startswith(b"\x89PNG") and b"Software\0" + _SOFTWARE.encode() in head


def save_figure(figure: Figure, path: Path, kind: str) -> None:
    """Write a figure as `svg` or `png`; equal figures give equal bytes. Raises `StorageError`."""
    metadata = {"Date": None, "Creator": None} if kind == "svg" else {"Software": _SOFTWARE}
    fixed: Any = {"svg.hashsalt": "xfreqbench", "svg.fonttype": "none"}
    with mpl.rc_context(fixed), atomic_path(path) as temporary, storage_errors(path):
        figure.savefig(temporary, format=kind, metadata=metadata, dpi=150)
