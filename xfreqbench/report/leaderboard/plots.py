"""Figures of the leaderboard: distributions of scores, SSIM against time, accuracy against cost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from xfreqbench.report.drawing.figures import any_letters, label_decades, panels, plain_style, save_figure, shown
from xfreqbench.report.drawing.templates import COLOURS
from xfreqbench.report.leaderboard.figures import pareto_front
from xfreqbench.report.leaderboard.maps import Levels
from xfreqbench.runs.records import BenchFigure, BenchPoint
from xfreqbench.types import FloatArray

_TRIVIAL_LABEL, _FRONT_LABEL = "best trivial predictor", "Pareto front"
_Points = Sequence[tuple[float, float]]  # of seconds and SSIM


@plain_style()
def plot_score_cdf(panels: Mapping[str, Mapping[str, Sequence[float]]], level: float, path: Path) -> None:
    """Draw empirical CDFs as SVG: a panel for each score, in it a curve for each method.

    `level` is a share of maps at which a dashed line is drawn. A curve is given by equally spaced quantiles from 0
    to 1. Equal curves give equal bytes. Raises `StorageError`.
    """
    labels = _labels(panels.values())
    figure, axes = _panel_figure(len(panels), labels)
    for axis, (title, curves) in zip(axes, panels.items(), strict=True):
        for label, quantiles in curves.items():
            axis.plot(quantiles, np.linspace(0, 1, len(quantiles)), label=shown(label), **_style(labels.index(label)))
        axis.axhline(level, color="0.4", linestyle="--", linewidth=1)
        axis.set(ylabel="share of maps at or below", ylim=(0, 1))
        axis.set_title(shown(title), fontsize="medium")
    _share_legend(figure, axes)
    save_figure(figure, path, "svg")


@plain_style()
def plot_map_grid(
    columns: Mapping[str, tuple[Levels, Levels, Sequence[float]]], rows: Sequence[str], path: Path
) -> None:
    """Draw maps as a PNG: a row for each transmitter, a column for each carrier, the truth above the prediction.

    A column has levels of true and of predicted maps, shape (rows, E, A), and the SSIM of each prediction. Equal
    maps give equal bytes. Raises `StorageError`.
    """
    figure = Figure(figsize=(2.1 * len(columns) + 1.2, 1.35 * len(rows) + 0.6), layout="constrained")
    axes = figure.subplots(2 * len(rows), len(columns), squeeze=False)
    for column, (title, (truth, predicted, ssim)) in enumerate(columns.items()):
        axes[0, column].set_title(shown(title), fontsize="medium")
        for row, name in enumerate(rows):
            for axis, levels in zip(axes[2 * row : 2 * row + 2, column], (truth, predicted), strict=True):
                axis.imshow(levels[row], cmap="magma", vmin=0, vmax=255, aspect="auto", interpolation="nearest")
                axis.set(xticks=[], yticks=[])
            axes[2 * row + 1, column].set_xlabel(f"SSIM {ssim[row]:.3f}", fontsize=6, labelpad=1)
            if column == 0:
                axes[2 * row, 0].set_ylabel("truth", fontsize=6)
                axes[2 * row + 1, 0].set_ylabel(f"predicted\n{shown(name)}", fontsize=6)
    save_figure(figure, path, "png")


@plain_style()
def plot_error_against_time(
    panels: Mapping[str, tuple[Mapping[str, _Points], _Points, float | None]], path: Path
) -> None:
    """Draw median SSIM against seconds of fitting as SVG: a panel for each split.

    A panel has a line for each method, the Pareto front, whose points have rings, and the SSIM of the best trivial
    predictor, a dashed line, or None where it is unknown. Equal panels give equal bytes. Raises `StorageError`.
    """
    labels = _labels(lines for lines, *_ in panels.values())
    figure, axes = _panel_figure(len(panels), [*labels, _TRIVIAL_LABEL, _FRONT_LABEL])
    for axis, (title, (lines, front, trivial)) in zip(axes, panels.items(), strict=True):
        for label, points in lines.items():
            seconds, ssim = zip(*points, strict=True)
            axis.plot(seconds, ssim, marker=".", markersize=4, label=shown(label), **_style(labels.index(label)))
        if trivial is not None:
            axis.axhline(trivial, color="0.4", linestyle="--", linewidth=1, label=_TRIVIAL_LABEL)
        if front:
            ring: dict[str, Any] = {"facecolors": "none", "edgecolors": "black", "zorder": 3, "linewidth": 0.8}
            axis.scatter(*zip(*front, strict=True), s=42, label=_FRONT_LABEL, **ring)
        ends = [points[-1][1] for points in lines.values()] + ([trivial] if trivial else [])
        axis.set_ylim(bottom=max(0.0, min(ends) - 0.12))  # the first seconds of fits may lie far lower
        axis.set(xlabel="seconds of fitting", xscale="log", ylabel="median SSIM, sample of maps")
        label_decades(axis)
        axis.set_title(shown(title), fontsize="medium")
    _share_legend(figure, axes)
    save_figure(figure, path, "svg")


@plain_style()
def plot_cost(figure: BenchFigure, path: Path) -> None:
    """Draw accuracy against cost, or against something else, as SVG.

    Each series is a line by increasing `x`. Of a cost, points that no other point beats in both have rings, and a grey
    step joins them. Points that are not finite have no place. Points of one place and label are labelled once. Equal
    figures give equal bytes. Raises `StorageError`.
    """
    canvas = Figure(figsize=(8.0, 5.4), layout="constrained")
    axis = canvas.subplots()
    drawn = [
        point
        for point in figure.points
        if isfinite(point.x) and isfinite(point.y) and (point.x > 0 or not figure.log_x)
    ]
    by_series: dict[str, list[BenchPoint]] = {point.series: [] for point in drawn}
    for point in sorted(drawn, key=lambda point: point.x):
        by_series[point.series].append(point)
    for index, (series, points) in enumerate(by_series.items()):
        at = [point.x for point in points], [point.y for point in points]
        marker: dict[str, Any] = {"marker": "osD^vPX"[index % 7], "markersize": 5}
        axis.plot(*at, label=shown(series), **_style(index, 1.2), **marker)
    if figure.x_is_cost:
        front = pareto_front(drawn, cost=lambda point: point.x, score=lambda point: point.y)
        x, y = [point.x for point in front], [point.y for point in front]
        axis.step(x, y, where="post", color="0.7", linewidth=4, alpha=0.5, zorder=0)
        ring: dict[str, Any] = {"facecolors": "none", "edgecolors": "0.2", "linewidths": 1.0, "zorder": 3}
        axis.scatter(x, y, s=90, label="no other is both cheaper and better", **ring)
    axis.set(xlabel=shown(figure.x_label), ylabel=shown(figure.y_label), xscale="log" if figure.log_x else "linear")
    if figure.log_x:
        label_decades(axis)
    axis.margins(0.1)
    axis.grid(alpha=0.3)
    canvas.legend(loc="outside lower center", ncols=3, fontsize="small")
    _write_labels(canvas, axis, drawn, list(by_series))
    save_figure(canvas, path, "svg")


def _write_labels(canvas: Figure, axis: Any, points: Sequence[BenchPoint], series: Sequence[str]) -> None:
    """Write each label in the colour of its series where it covers least of others, with a line to its point.

    It may be on eight sides of its point, nearer places first. Of a place, the area in square pixels counts that it
    would cover of others, and that would lie outside the frame.
    """
    with any_letters():
        canvas.draw_without_rendering()
    canvas.set_layout_engine("none")  # the axes stay where the places were looked for
    named = {(point.label, point.x, point.y): point.series for point in reversed(points)}
    centres = {(x, y): axis.transData.transform((x, y)).tolist() for _, x, y in named}
    taken = [_around(*centres[x, y]) for _, x, y in named]
    sides = ((1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1), (-1, 0))
    for (label, x, y), name in reversed(named.items()):
        colour = COLOURS[series.index(name) % len(COLOURS)]
        tie = {"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkA": 0, "shrinkB": 0}
        place = {"xytext": (0, 0), "textcoords": "offset points", "arrowprops": tie}
        text = axis.annotate(shown(label), (x, y), **place, fontsize=7, color=colour)
        with any_letters():
            size = text.get_window_extent().padded(2)
        (at_x, at_y), width, height = centres[x, y], size.width, size.height
        boxes = [
            _around(at_x + right * (width / 2 + gap), at_y + up * (height / 2 + gap), width, height)
            for gap in (9, 16, 26, 40)
            for right, up in sides
        ]
        inside, *covered = _overlaps(boxes, [axis.bbox.extents.tolist(), *taken]).T
        outside = np.diag(_overlaps(boxes, boxes)) - inside
        best = boxes[np.argmin(outside + np.sum(covered, axis=0))]
        text.set_position((np.array(best[:2]) - size.min) * 72 / canvas.dpi)
        taken.append(best)


def _around(x: float, y: float, width: float = 10.0, height: float = 10.0) -> tuple[float, float, float, float]:
    return x - width / 2, y - height / 2, x + width / 2, y + height / 2


def _overlaps(boxes: Sequence[Sequence[float]], others: Sequence[Sequence[float]]) -> Float[FloatArray, "B O"]:
    """The area that each of B boxes, as in `_around`, has in common with each of O others."""
    box, other = np.array(boxes)[:, None], np.array(others)
    common = np.minimum(box[..., 2:], other[..., 2:]) - np.maximum(box[..., :2], other[..., :2])
    return np.clip(common, 0, None).prod(axis=-1)


def _panel_figure(number: int, labels: Sequence[str]) -> tuple[Figure, list[Any]]:
    """A figure with that many axes in a grid, and room below them for a legend of the labels."""
    columns = number if number <= 3 else -(-number // 2)
    rows = -(-number // columns)
    width_in = max(3.6 * columns, 6.0)
    legend_rows = -(-len(labels) // _legend_columns(labels, width_in))
    figure = Figure(figsize=(width_in, 3.0 * rows + 0.3 + 0.19 * legend_rows), layout="constrained")
    axes = panels(figure, number, columns)
    for axis in axes:
        axis.grid(alpha=0.3)
    return figure, axes


def _legend_columns(labels: Sequence[str], width_in: float) -> int:
    """How many columns of labels fit in a width: a letter takes about 0.065 inches, the line before it 0.6."""
    return max(1, int(width_in / (0.6 + 0.065 * max((len(shown(label)) for label in labels), default=0))))


def _share_legend(figure: Figure, axes: Sequence[Any]) -> None:
    found = [pair for axis in axes for pair in zip(*axis.get_legend_handles_labels(), strict=True)]
    handles = {label: handle for handle, label in found}
    labels = sorted(handles, key=(_TRIVIAL_LABEL, _FRONT_LABEL).__contains__)  # methods first
    columns = _legend_columns(labels, figure.get_figwidth())
    figure.legend(
        [handles[label] for label in labels], labels, loc="outside lower center", ncols=columns, fontsize="small"
    )


def _labels(panels: Iterable[Mapping[str, Any]]) -> list[str]:
    """Every label of the panels once; its index decides the method's colour and line in all of them."""
    return list(dict.fromkeys(label for panel in panels for label in panel))


def _style(index: int, width: float = 1.4) -> dict[str, Any]:
    style = ("-", "--", ":", "-.")[index // len(COLOURS) % 4]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": style, "linewidth": width}
