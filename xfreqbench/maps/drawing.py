"""Draws a map as a disc that is seen from the pole of its hemisphere. Matplotlib is imported when a figure is made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from xfreqbench.maps.grid import AngularGrid
from xfreqbench.types import FloatArray, NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DISPLAY_RANGE_DB = 30.0  # below the peak
FIXED_WHITE, FIXED_BLACK = "#fffffe", "#000001"  # on a picture: a page in dark colours changes #ffffff and #000000
_RINGS_DEG, _AZIMUTHS_DEG = (0, 30, 60), (0, 90, 180, 270)  # elevations, and azimuths, that a disc names


def map_figure(power: Float[NDArray[np.float32], "E A"], grid: AngularGrid, title: str) -> Figure:
    """A Matplotlib figure of one map of linear power with peak 1, as `draw_disc` draws it, with a colour bar."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 3.5), layout="constrained")
    axis = figure.subplots(subplot_kw={"projection": "polar"})
    figure.colorbar(draw_disc(axis, power, grid), ax=axis, label="dB below the peak", shrink=0.8)
    axis.set_title(title, fontsize="medium")
    return figure


def draw_disc(
    axis: Any, pas_map: Float[NDArray[np.float32], "E A"], grid: AngularGrid, range_db: float = DISPLAY_RANGE_DB
) -> Any:
    """Draw a map of linear power on polar axes, in dB below the peak; returns what a colour bar needs.

    The centre is the pole, rings are elevations of 30° and 60°, the rim is the equator; azimuth runs counter-clockwise
    from the right.
    """
    level_db = 10 * np.log10(np.maximum(pas_map, 10 ** (-range_db / 10)))
    axis.grid(False)  # pcolormesh asks for that
    image = axis.pcolormesh(
        _edges(grid.azimuth_rad, 2 * np.pi),
        _radius_edges_deg(grid),
        level_db,
        vmin=-range_db,
        vmax=0,
        cmap="magma",
        rasterized=True,
    )
    axis.set_xticks(np.radians(_AZIMUTHS_DEG), [f"{azimuth}°" for azimuth in _AZIMUTHS_DEG], fontsize=6)
    axis.set_yticks([90 - ring for ring in _RINGS_DEG], [])
    for ring in _RINGS_DEG:
        axis.text(np.radians(45), 90 - ring, f"{ring}°", fontsize=5, color=FIXED_WHITE, ha="right", va="top")
    axis.tick_params(pad=-3)
    axis.grid(color=FIXED_WHITE, alpha=0.35, linewidth=0.4)
    axis.set_rlim(0, 90)
    return image


def _radius_edges_deg(grid: AngularGrid) -> Float[FloatArray, "E1"]:
    """Where the rows of a map begin and end, as degrees from the pole; the row next to the pole reaches it."""
    edges = np.clip(_edges(90 - np.degrees(grid.elevation_rad), 90.0), 0, 90)
    inner, step = edges.argmin(), abs(np.diff(edges)).max()
    edges[inner] = 0 if edges[inner] <= step else edges[inner]
    return edges


def _edges(centres: Float[FloatArray, "n"], whole: float) -> Float[FloatArray, "n1"]:
    """The edges of n cells by their centres: halfway between neighbours, and as far beyond the first and the last.

    A single cell is the whole axis.
    """
    if len(centres) == 1:
        return centres + np.array([-0.5, 0.5]) * whole
    between = (centres[:-1] + centres[1:]) / 2
    return np.concatenate([[2 * centres[0] - between[0]], between, [2 * centres[-1] - between[-1]]])
