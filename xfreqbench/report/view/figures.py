"""Draws a scene and a data set: plan and elevation as PNG, what carriers have in common as SVG."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from xfreqbench.maps.drawing import FIXED_BLACK, FIXED_WHITE, draw_disc
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.report.drawing.figures import figure_kind, label_decades, panels, plain_style, save_figure
from xfreqbench.report.drawing.orbit import BORESIGHT_M, by_material
from xfreqbench.report.view.describe import CarrierSummary
from xfreqbench.report.view.plan import RAY_RANGE_DB, ShownRoom
from xfreqbench.scene.facets import planar_facets
from xfreqbench.scene.glb_writer import material_hex
from xfreqbench.types import FloatArray, NDArray

NUMBERED_RAYS = 9  # more numbers would cover each other
_RAY_COLOURS = ListedColormap(mpl.colormaps["plasma"](np.linspace(0.2, 1, 256)), "rays")  # weak ones are dark
_RAY_SCALE = Normalize(-RAY_RANGE_DB, 0)
_GROUP_COLOURS = {
    "transmitters in sight": "#009e73",
    "transmitters in shadow": "#8a94a0",
    "transmitters": "#0072b2",
    "in sight": "#009e73",
    "in shadow": "#5a636e",
    "all transmitters": "#0072b2",
}
Rgba = tuple[int, int, int, int]


def ray_colour(level_db: float) -> Rgba:
    """Colour of a ray, in figures and 3D models, by its power in dB below the strongest ray, which is brightest."""
    return _bytes(_RAY_COLOURS(_RAY_SCALE(level_db)))


def group_colour(name: str) -> Rgba:
    """Colour of a group of transmitters, see `ShownRoom.groups`."""
    return _bytes(to_rgba(_GROUP_COLOURS[name]))


@plain_style()
def plot_room(room: ShownRoom, path: Path) -> None:
    """Draw plan and elevation of a scene, with the numbers of its strongest rays, as PNG or, narrower, as SVG.

    Raises `StorageError`.
    """
    kind = figure_kind(path)
    width_in = 5.2 if kind == "svg" else 9.0  # pages show the narrow one, whose text is read on a phone too
    low_m, high_m = bounds_m(room)
    heights = (high_m - low_m)[1:].tolist()
    height_in = float(np.clip(0.8 * width_in * sum(heights) / (high_m - low_m)[0] + 2, 5, 16))
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.subplots(2, 1, height_ratios=heights)
    for axis, title, up in zip(axes, ("plan", "elevation"), (1, 2), strict=True):
        axis.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[up], high_m[up]), xlabel="x (m)", ylabel=f"{'xyz'[up]} (m)")
        axis.set_aspect("equal")
        axis.set_title(title, fontsize="medium")
        _draw_view(axis, room, [0, up])
    if room.rays:
        scale = ScalarMappable(_RAY_SCALE, _RAY_COLOURS)
        figure.colorbar(scale, ax=axes, label="power of a ray (dB below the strongest)", shrink=0.6)
    handles = _place_handles(room) + [
        Line2D([], [], color=material_hex(name), label=name.replace("_", " ")) for name in by_material(room.meshes)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4 if kind == "png" else 2, fontsize="small")
    save_figure(figure, path, kind)


@plain_style()
def plot_overview(
    room: ShownRoom, maps: Float[NDArray[np.float32], "F E A"], grid: AngularGrid, titles: Sequence[str], path: Path
) -> None:
    """The plan of a room with the rays of one transmitter, next to its maps at up to six carriers: a PNG.

    `maps` are linear power, one a carrier, with one title each. Raises `StorageError`.
    """
    low_m, high_m = bounds_m(room)
    chosen = np.unique(np.linspace(0, len(maps) - 1, min(len(maps), 6)).round().astype(int))
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    left, right = halves
    plan = left.subplots()
    _draw_view(plan, room, [0, 1])
    plan.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[1], high_m[1]), xlabel="x (m)", ylabel="y (m)", aspect="equal")
    left.legend(handles=_place_handles(room), loc="outside lower center", ncols=2, fontsize="small")
    discs = panels(right, len(chosen), -(-len(chosen) // 2), subplot_kw={"projection": "polar"})
    for axis, index in zip(discs, chosen, strict=True):
        image = draw_disc(axis, maps[index], grid)
        axis.set_title(titles[index], fontsize="medium")
    right.colorbar(image, ax=discs, label="dB below the peak", location="bottom", shrink=0.7)
    save_figure(figure, path, "png")


@plain_style()
def plot_carriers(summary: CarrierSummary, path: Path, parts: Sequence[str] = ("similarity", "power", "paths")) -> None:
    """Draw, as SVG, how similar maps are between carriers, and power and paths if these are known; else nothing.

    Equal summaries give equal bytes. Raises `StorageError`.
    """
    is_known = {
        "similarity": (_draw_similarity, len(summary.compared_hz) > 1),
        "power": (_draw_power, summary.peak_db is not None),
        "paths": (_draw_path_counts, summary.num_paths is not None),
    }
    drawn = [draw for draw, known in map(is_known.__getitem__, parts) if known]
    if not drawn:
        return
    columns = min(2, len(drawn))
    figure = Figure(figsize=(5 * columns, 4.1 * -(-len(drawn) // 2)), layout="constrained")
    for axis, draw in zip(panels(figure, len(drawn), columns), drawn, strict=True):
        draw(axis, summary)
    save_figure(figure, path, "svg")


def _bytes(colour: Iterable[float]) -> Rgba:
    red, green, blue, opacity = (round(255 * part) for part in colour)
    return red, green, blue, opacity


def bounds_m(room: ShownRoom) -> tuple[FloatArray, FloatArray]:
    """The lowest and the highest x, y and z of all that is drawn of a room, and a margin around it, in metres."""
    points_m = [mesh.vertices_m for mesh in room.meshes]
    points_m += [room.receiver_m[None], room.tx_position_m, *(ray.points_m for ray in room.rays)]
    all_m = np.concatenate(points_m)
    return all_m.min(axis=0) - 0.25, all_m.max(axis=0) + 0.25


def draw_outlines(axis: Any, room: ShownRoom, shown: list[int]) -> None:
    """Draw the facets of a room and its receiver on axes that show two world axes, such as [0, 1] for a plan."""
    axis.set_facecolor("#14161c")  # on which bright rays stand out, as maps do
    for facet in planar_facets(room.meshes):
        outline = np.vstack([facet.corners_m, facet.corners_m[:1]])[:, shown]
        colour = material_hex(str(room.meshes[facet.surface].material))
        axis.plot(*outline.T, color=colour, linewidth=1.2)
    start, along = room.receiver_m[shown], room.boresight[shown] * BORESIGHT_M
    if np.linalg.norm(along) > 0.1 * BORESIGHT_M:
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "color": "#d55e00", "linewidth": 1.6}
        axis.annotate("", start + along, start, arrowprops=arrow, zorder=6)
    axis.plot(*start, "^", color="#d55e00", markersize=9, markeredgecolor="white", zorder=7)


def _draw_view(axis: Any, room: ShownRoom, shown: list[int]) -> None:
    draw_outlines(axis, room, shown)
    for line in axis.lines:
        line.set_rasterized(len(axis.lines) > 300)  # so many are stored as pixels in an SVG
    for name, position_m in room.groups().items():
        size = float(np.clip(4000 / max(1, len(room.tx_position_m)), 0.5, 16))
        colour: dict[str, Any] = {"color": _GROUP_COLOURS[name], "alpha": 0.55, "linewidths": 0}
        axis.scatter(*position_m[:, shown].T, s=size, rasterized=True, **colour)
    # the strongest on top
    colours = [_RAY_COLOURS(_RAY_SCALE(ray.level_db)) for ray in room.rays]
    lines = [ray.points_m[:, shown] for ray in room.rays]
    axis.add_collection(LineCollection(lines[::-1], colors=colours[::-1], linewidths=1.3, zorder=3))
    numbered = list(zip(lines, colours, strict=True))[:NUMBERED_RAYS]
    for number, (line, edge) in enumerate(numbered, start=1):
        # at another share of its length each: labels of rays with equal ends are kept apart
        place = point_along(line, number / (len(numbered) + 1))
        style: dict[str, Any] = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": edge}
        axis.annotate(str(number), place, fontsize=7, ha="center", va="center", bbox=style, zorder=5)
    axis.plot(*room.tx_m[shown], "*", color=FIXED_WHITE, markersize=13, markeredgecolor=FIXED_BLACK, zorder=6)


def point_along(line: Float[FloatArray, "n D"], share: float) -> Float[FloatArray, "D"]:
    """The point of a line through n points that lies at a share of its length, from 0 to 1."""
    reached = np.append(0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    return np.array([np.interp(share * reached[-1], reached, part) for part in line.T])


def _place_handles(room: ShownRoom) -> list[Line2D]:
    style: dict[str, Any] = {"linestyle": "", "markeredgecolor": "none"}
    receiver = Line2D([], [], marker="^", color="#d55e00", label="receiver and its boresight", **style)
    edge = {**style, "markeredgecolor": FIXED_BLACK, "markersize": 11}
    chosen = Line2D([], [], marker="*", color=FIXED_WHITE, label=f"transmitter {room.tx}", **edge)
    return [receiver, chosen] + [
        Line2D([], [], marker="o", color=_GROUP_COLOURS[name], label=f"{name} ({len(position_m)})", **style)
        for name, position_m in room.groups().items()
    ]


def _draw_similarity(axis: Any, summary: CarrierSummary) -> None:
    # the scale begins a tenth, rounded down, below all values
    least = float(np.floor(np.nanmin(summary.median_ssim) * 10 - 0.01) / 10)
    image = axis.pcolormesh(summary.median_ssim, vmin=least, vmax=1, cmap="viridis")
    names = [f"{carrier / 1e9:.12g}" for carrier in summary.compared_hz]
    places = np.arange(len(names)) + 0.5
    axis.set_xticks(places, names, fontsize=8)
    axis.set_yticks(places, names, fontsize=8)
    for (row, column), value in np.ndenumerate(summary.median_ssim):
        if not np.isnan(value):
            place = {"x": column + 0.5, "y": row + 0.5, "ha": "center", "va": "center"}
            axis.text(**place, s=f"{value:.2f}", fontsize=7, color=_ink_on(image.cmap(image.norm(value))))
    axis.set(xlabel="carrier (GHz)", ylabel="carrier (GHz)", aspect="equal")
    axis.set_title(f"median SSIM between carriers, {summary.num_compared} transmitters", fontsize="medium")
    axis.figure.colorbar(image, ax=axis, shrink=0.8)


def _ink_on(colour: Sequence[float]) -> str:
    """White or black, whichever has the higher contrast to a colour; neither is changed on a dark page."""
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour[:3]]
    return FIXED_WHITE if np.dot(linear, (0.2126, 0.7152, 0.0722)) < 0.179 else FIXED_BLACK


def _draw_power(axis: Any, summary: CarrierSummary) -> None:
    assert summary.peak_db is not None, "drawn where it is known"
    carrier_ghz = summary.carrier_hz / 1e9
    for name, members in summary.groups().items():
        peak_db = summary.peak_db[members]
        levels = np.full((3, peak_db.shape[1]), np.nan)  # nan where no transmitter is heard
        for carrier, column in enumerate(peak_db.T):
            if not np.isnan(column).all():
                levels[:, carrier] = np.nanpercentile(column, (10, 50, 90))
        low, middle, high = levels
        axis.fill_between(carrier_ghz, low, high, color=_GROUP_COLOURS[name], alpha=0.2, linewidth=0)
        axis.plot(carrier_ghz, middle, "o-", color=_GROUP_COLOURS[name], markersize=4, label=name)
    axis.set(xscale="log", xlabel="carrier (GHz)", ylabel="peak of the map (dB)")
    label_decades(axis)
    axis.set_title("power: median, and range of 80 %", fontsize="medium")
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small")


def _draw_path_counts(axis: Any, summary: CarrierSummary) -> None:
    assert summary.num_paths is not None, "drawn where it is known"
    most = summary.num_paths.max(axis=1)
    edges = np.histogram_bin_edges(most, bins=min(30, max(1, int(np.ptp(most)) + 1)))
    groups = summary.groups()
    axis.hist(
        [most[members] for members in groups.values()],
        bins=edges,
        stacked=True,
        color=[_GROUP_COLOURS[name] for name in groups],
        label=list(groups),
    )
    axis.set(xlabel="paths that reach the array", ylabel="transmitters")
    axis.locator_params(axis="y", integer=True)
    axis.set_title("paths a transmitter, at the carrier with most", fontsize="medium")
    axis.legend(fontsize="small")
