from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from xfreqbench.errors import OutputExistsError, XFreqBenchError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.report.drawing.figures import draw_disc, is_own_drawing, plot_pas_maps, require_own_figure, save_figure

FIRST_BYTES = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
WHOLE_TURN = AngularGrid(np.radians(np.arange(91)), np.radians(np.arange(-180, 181)))  # both ends of either axis
ONE_RING = AngularGrid(np.radians([10.0]), np.radians(np.arange(0, 360, 10)))
GRIDS = [AngularGrid.hemisphere(), AngularGrid.hemisphere(9, 12), WHOLE_TURN, ONE_RING, AngularGrid.hemisphere(9, 1)]


def disc(pas_map: np.ndarray, grid: AngularGrid, **options: Any) -> tuple[Any, Any]:
    """The axes of a disc and its mesh of cells."""
    axis = Figure().subplots(subplot_kw={"projection": "polar"})
    return axis, draw_disc(axis, pas_map.astype(np.float32), grid, **options)


@pytest.mark.parametrize("grid", GRIDS, ids=["fine", "coarse", "both ends", "one elevation", "one azimuth"])
def test_every_value_is_drawn_around_its_direction_and_cells_cover_the_hemisphere_up_to_the_pole(
    grid: AngularGrid,
) -> None:
    power = np.random.default_rng(0).uniform(0.01, 1, grid.shape)
    _, mesh = disc(power, grid)
    np.testing.assert_allclose(np.reshape(mesh.get_array(), grid.shape), 10 * np.log10(power), atol=1e-4)  # float32
    corners = mesh.get_coordinates()
    for axis, centre in ((0, grid.azimuth_rad[None]), (1, (90 - np.degrees(grid.elevation_rad))[:, None])):
        ends = np.sort([corners[:-1, :-1, axis], corners[1:, 1:, axis]], axis=0)
        assert (ends[0] <= centre + 1e-9).all() and (centre - 1e-9 <= ends[1]).all()
    assert (corners[..., 1].min(), corners[..., 1].max()) == (0, 90)
    assert np.ptp(corners[..., 0]) >= 2 * np.pi * (1 - 1e-12)  # rounding


def test_colours_reach_as_far_below_the_peak_as_is_asked_for() -> None:
    grid = AngularGrid.hemisphere(9, 12)
    power = np.full(grid.shape, 1e-6)
    power[4, 4] = 1
    for range_db in (20.0, 45.0):
        _, mesh = disc(power, grid, range_db=range_db)
        assert mesh.get_clim() == (-range_db, 0)
        assert mesh.get_array().min() == pytest.approx(-range_db)


def test_a_disc_names_azimuths_and_elevations() -> None:
    grid = AngularGrid.hemisphere(9, 12)
    axis, _ = disc(np.ones(grid.shape), grid)
    ticks = dict(zip(np.degrees(axis.get_xticks()), axis.get_xticklabels(), strict=True))
    assert {angle: label.get_text() for angle, label in ticks.items()} == {
        angle: f"{angle}°" for angle in (0, 90, 180, 270)
    }
    rings = {label.get_text(): label.get_position()[1] for label in axis.texts}
    assert rings == {"0°": 90, "30°": 60, "60°": 30}
    assert set(axis.get_yticks()) == {30, 60, 90}


@pytest.mark.parametrize("kind", FIRST_BYTES)
def test_pictures_of_maps_are_equal_bytes_for_equal_maps(tmp_path: Path, kind: str) -> None:
    grid = AngularGrid.hemisphere(9, 12)
    maps = np.random.default_rng(0).random((2, 9, 12), dtype=np.float32)
    paths = [tmp_path / f"{name}.{kind}" for name in "abc"]
    for path, drawn in zip(paths, (maps, maps, maps[::-1]), strict=True):
        plot_pas_maps(drawn, grid, ["truth", "predicted"], path, "office: transmitter 3")
    a, b, c = (path.read_bytes() for path in paths)
    assert a == b != c
    assert a.startswith(FIRST_BYTES[kind])
    if kind == "svg":
        assert all(text in a.decode() for text in ("truth", "predicted", "office: transmitter 3", "90°"))


@pytest.mark.parametrize("kind", FIRST_BYTES)
def test_our_figures_are_replaced_and_those_of_others_are_not(tmp_path: Path, kind: str) -> None:
    figure = Figure()
    figure.subplots().plot(np.random.default_rng(0).random(20_000))  # marks stand at an end of a long file
    path = tmp_path / f"figure.{kind}"
    save_figure(figure, path, kind)
    assert is_own_drawing(path)
    require_own_figure(path)
    figure.savefig(path)
    assert not is_own_drawing(path)
    with pytest.raises(OutputExistsError):
        require_own_figure(path)


def test_a_figure_of_another_kind_is_refused_by_its_name(tmp_path: Path) -> None:
    maps = np.ones((1, 9, 12), np.float32)
    with pytest.raises(XFreqBenchError, match=r"maps\.jpg is asked for; end its name in \.png, \.svg or \.pdf"):
        plot_pas_maps(maps, AngularGrid.hemisphere(9, 12), ["1 GHz"], tmp_path / "maps.jpg")
    assert not list(tmp_path.iterdir())
    plot_pas_maps(maps, AngularGrid.hemisphere(9, 12), ["1 GHz"], tmp_path / "maps.PNG")
    assert is_own_drawing(tmp_path / "maps.PNG")
