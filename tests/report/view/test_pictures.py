"""What `xfreqbench plot` draws, and the colours of rays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from tests.support.screened_room import CARRIERS_GHZ
from xfreqbench.cli.data import plot
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import XFreqBenchError
from xfreqbench.report.drawing import figures as drawing
from xfreqbench.report.view import figures, pictures
from xfreqbench.report.view.figures import plot_room, ray_colour
from xfreqbench.report.view.pictures import plot_power
from xfreqbench.report.view.plan import ViewPlan


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that would be written."""
    kept: list[Figure] = []
    for module in (drawing, figures, pictures):
        monkeypatch.setattr(module, "save_figure", lambda figure, path, kind: kept.append(figure))
    return kept


def panels(figure: Figure) -> list[Any]:
    """The axes that show something but the colour bar."""
    return [axis for axis in figure.axes if axis.get_visible() and axis.get_label() != "<colorbar>"]


def of_kind(axis: Any, kind: type) -> Any:
    (found,) = (each for each in axis.collections if type(each) is kind)
    return found


def brightness(colour: Any) -> float:
    return float(np.dot(colour[:3], (0.299, 0.587, 0.114)))


def test_chosen_carriers_are_drawn_in_their_order_with_their_own_maps(
    dataset: PasDataset, tmp_path: Path, drawn: list[Figure]
) -> None:
    plot(dataset.path, output=tmp_path / "maps.svg", tx=4, carriers="77,2.4", db_range=50)
    shown = panels(drawn[0])
    assert [axis.get_title() for axis in shown] == ["77 GHz", "2.4 GHz"]
    for axis, carrier_hz in zip(shown, (77e9, 2.4e9), strict=True):
        (row,) = np.flatnonzero((dataset.tx_index == 4) & (dataset.carrier_hz == carrier_hz))
        expected_db = 10 * np.log10(np.maximum(dataset.pas(int(row))[0], 1e-5))
        mesh = axis.collections[0]
        np.testing.assert_allclose(np.reshape(mesh.get_array(), dataset.grid.shape), expected_db, atol=1e-4)


def test_a_plan_has_a_square_for_every_transmitter_in_the_colour_of_its_power(
    dataset: PasDataset, tmp_path: Path, drawn: list[Figure]
) -> None:
    plot(dataset.path, output=tmp_path / "power.pdf", of="power", db_range=60)
    (figure,) = drawn
    assert figure.get_suptitle() == "room.h5, scene screened\npower received from 35 transmitters"
    for axis, carrier_ghz in zip(panels(figure), CARRIERS_GHZ, strict=True):
        received = np.mean(np.abs(dataset.cfr[dataset.carrier_hz == carrier_ghz * 1e9]) ** 2, axis=1)
        assert axis.get_title() == f"{carrier_ghz:g} GHz, strongest {10 * np.log10(received.max()):.0f} dB"
        squares = of_kind(axis, PolyCollection)
        level_db = dict(
            zip(
                (tuple(path.vertices[:4].mean(axis=0).round(6)) for path in squares.get_paths()),
                squares.get_array(),
                strict=True,
            )
        )
        for place, power_now in zip(dataset.tables["tx_position_m"], received, strict=True):
            expected_db = 10 * np.log10(power_now / received.max())
            assert level_db[tuple(place[:2].round(6))] == pytest.approx(expected_db, abs=1e-4)
        assert len(level_db) == 35
        assert squares.get_clim() == (-60, 0)
        corners = squares.get_paths()[0].vertices
        np.testing.assert_allclose(np.ptp(corners, axis=0), 0.5)  # a grid of one metre; no square is larger


def test_transmitters_above_each_other_share_a_square_with_their_mean(
    view: ViewPlan, tmp_path: Path, drawn: list[Figure]
) -> None:
    position_m = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 2.0], [2.0, 1.0, 1.0], [3.0, 1.0, 1.0]])
    room = replace(view.room, tx_position_m=position_m, in_sight=None, tx=0)
    plot_power(room, np.array([[1.0, 3.0, 0.5, 0.0], [0.0, 0.0, 0.0, 0.0]]), [1e9, 2e9], tmp_path / "p.pdf")
    first, silent = panels(drawn[0])
    np.testing.assert_allclose(of_kind(first, PolyCollection).get_array(), [10 * np.log10(0.5 / 2), 0])
    assert silent.get_title() == "2 GHz, no path"
    assert not len(of_kind(silent, PolyCollection).get_paths())


def test_strong_rays_are_brighter_and_drawn_over_weak_ones(view: ViewPlan, tmp_path: Path, drawn: list[Figure]) -> None:
    plot_room(view.room, tmp_path / "room.png")
    levels_db = [ray.level_db for ray in view.room.rays]
    assert len(levels_db) > 3
    assert levels_db == sorted(levels_db, reverse=True)
    for axis in panels(drawn[0]):
        lines = of_kind(axis, LineCollection)
        colours = lines.get_colors()  # the last is drawn over the others
        assert len(colours) == len(levels_db)
        assert [brightness(colour) for colour in colours] == sorted(map(brightness, colours))
        strongest = lines.get_segments()[-1]
        assert len(strongest) == len(view.room.rays[0].points_m)
        assert brightness(axis.get_facecolor()) < brightness(colours[0])
    shades = [brightness(ray_colour(level_db)) for level_db in np.linspace(-30, 0, 31)]
    assert shades == sorted(shades)


def test_what_cannot_be_drawn_is_refused_before_anything_is_written(
    dataset: PasDataset, imported: PasDataset, tmp_path: Path
) -> None:
    theirs = tmp_path / "talk.pdf"
    theirs.write_bytes(b"%PDF-1.4 mine")
    for options, words in (
        ({"carriers": "2.4,5"}, r"no carrier '5 GHz'.*2.4 GHz, 24.25 GHz, 77 GHz"),
        ({"carriers": "2.4;5"}, "--carriers takes carriers in GHz"),
        *(({"db_range": each}, "--db-range takes dB above 0") for each in (0.0, float("nan"), float("inf"))),
        ({"tx": 35}, "holds transmitters 0 to 34, but 35"),
        ({"of": "power", "tx": 1}, "leave --tx out"),
        ({"output": tmp_path / "new.gif"}, "end its name in"),
        ({"output": theirs, "of": "power"}, r"talk\.pdf exists"),
        ({"file": imported.path, "of": "power"}, "maps without channels"),
    ):
        with pytest.raises(XFreqBenchError, match=words):
            plot(**{"file": dataset.path, "output": tmp_path / "new.png", **options})
    assert [*tmp_path.iterdir()] == [theirs] and theirs.read_bytes() == b"%PDF-1.4 mine"


def test_maps_alone_are_drawn(imported: PasDataset, tmp_path: Path) -> None:
    plot(imported.path, output=tmp_path / "maps.png")
    assert (tmp_path / "maps.png").exists()
