"""Writes what is shown of a data set or a scene into one folder: a page, its figures, and a 3D model."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from xfreqbench.maps.bartlett import power_of
from xfreqbench.report.drawing.figures import is_own_drawing, plot_pas_maps
from xfreqbench.report.drawing.orbit import BORESIGHT_M
from xfreqbench.report.drawing.templates import Picture, is_of_subject
from xfreqbench.report.view.describe import CarrierSummary, summarize
from xfreqbench.report.view.figures import group_colour, plot_carriers, plot_overview, plot_room, ray_colour
from xfreqbench.report.view.page import view_page
from xfreqbench.report.view.plan import ShownRoom, ViewPlan
from xfreqbench.scene.glb_writer import GlbModel, material_colour
from xfreqbench.system.files import atomic_path, read_text, require_own, require_space, storage_errors, write_text
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz

PAGE, MODEL, ROOM = "index.html", "scene.glb", "scene.png"
MAPS, CARRIERS, OVERVIEW = "pas.png", "carriers.svg", "overview.png"
FILES = (PAGE, MODEL, ROOM, MAPS, CARRIERS, OVERVIEW)


def claim(view: ViewPlan, folder: Path) -> None:
    """Make the folder, or check that the files of these names there were written for the same data set or scene.

    Only such files may be replaced: raises `OutputExistsError` for others, and `StorageError`.
    """
    fault, is_same = "was not written for this data set or scene", False
    with suppress(OSError, UnicodeDecodeError):
        is_same = is_of_subject(read_text(folder / PAGE), view.subject)
    for name in FILES:
        require_own(
            folder / name, lambda path: None if is_same and (path.name == PAGE or is_own_drawing(path)) else fault
        )
    require_space(folder / PAGE, 1)


def write_view(view: ViewPlan, folder: Path, tell: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Draw everything, then write `FILES`, for a scene without data only the first three; returns their paths.

    `tell` is called with the name of each step.

    Raises what `claim` raises, before anything is drawn, and `DataError`.
    """
    claim(view, folder)
    if view.dataset:
        tell(f"comparing maps between {view.dataset.header.num_carriers} carriers")
    summary = summarize(view.dataset) if view.dataset else None
    with tempfile.TemporaryDirectory() as scratch:
        tell("drawing the room, its rays and maps")
        _draw(view, summary, Path(scratch))
        drawn = {path.name: path.read_bytes() for path in (Path(scratch) / name for name in FILES) if path.exists()}
        page = view_page(view, summary, _pictures(view, summary, Path(scratch)), MODEL, MAPS)
    write_text(folder / PAGE, page)  # before the others, because it names the data set that they belong to
    for name, content in drawn.items():
        path = folder / name
        with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
            temporary.write_bytes(content)
    return [folder / PAGE, *(folder / name for name in drawn)]


def room_model(room: ShownRoom) -> GlbModel:
    """The scene as a 3D model with a node for every surface, every ray and each group of transmitters."""
    model, orange = GlbModel(), (213, 94, 0, 255)
    marker_m, line_m, element_m = 0.02, 0.008, 0.015  # radii
    for mesh in room.meshes:
        model.add_surface(mesh, material_colour(str(mesh.material), 60))
    for name, position_m in room.groups().items():
        model.add_markers(name, position_m, marker_m, group_colour(name))
    for number, ray in enumerate(room.rays, start=1):
        name = f"ray {number}: {ray.level_db:.1f} dB, {ray.label}"
        model.add_tube(name, ray.points_m, line_m, ray_colour(ray.level_db))
    model.add_ball(f"transmitter {room.tx}", room.tx_m, 0.07, (20, 20, 20, 255))
    elements_m = room.receiver.element_position_m(SPEED_OF_LIGHT_M_S / room.lowest_hz)
    ahead_m = room.receiver_m + BORESIGHT_M * room.boresight
    model.add_ball("receiver", room.receiver_m, element_m, orange)
    model.add_markers(f"array elements at {format_ghz(room.lowest_hz)}", elements_m, element_m, orange)
    model.add_tube("boresight", np.stack([room.receiver_m, ahead_m]), line_m, orange)
    return model


def _pictures(view: ViewPlan, summary: CarrierSummary | None, scratch: Path) -> dict[str, list[Picture]]:
    """The pictures of the page: narrow ones, whose paper and ink are the page's."""

    def picture(name: str, alt: str) -> Picture:
        return Picture(alt, (scratch / f"{name}.svg").read_bytes())

    plot_room(view.room, scratch / "room.svg")
    found = {"scene": [picture("room", "Plan and elevation of the scene with receiver, transmitters and rays")]}
    if view.dataset and summary:
        dataset = view.dataset
        rows = np.flatnonzero(dataset.tx_index == view.room.tx)
        shown = np.linspace(0, len(rows) - 1, min(len(rows), 12)).round().astype(int)
        titles = [format_ghz(carrier) for carrier in dataset.carrier_hz[rows[shown]]]
        maps = power_of(dataset.pas(rows[shown]), dataset.header.pas_kind)
        for index, title in enumerate(titles):
            plot_pas_maps(maps[index : index + 1], dataset.grid, [title], scratch / f"map-{index}.svg")
        found["maps"] = [
            picture(f"map-{index}", f"Power angular spectrum at {title}") for index, title in enumerate(titles)
        ]
        found["carriers"] = []
        for part, alt in (
            ("similarity", "Median SSIM of maps between each two carriers"),
            ("power", "Power of the strongest direction against the carrier"),
            ("paths", "How many transmitters have how many paths"),
        ):
            plot_carriers(summary, scratch / f"{part}.svg", [part])
            found["carriers"] += [picture(part, alt)] if (scratch / f"{part}.svg").exists() else []
    return found


def _draw(view: ViewPlan, summary: CarrierSummary | None, scratch: Path) -> None:
    """Write all files but the page."""
    room_model(view.room).write(scratch / MODEL)
    plot_room(view.room, scratch / ROOM)
    if view.dataset and summary:
        dataset = view.dataset
        rows = np.flatnonzero(dataset.tx_index == view.room.tx)
        titles = [format_ghz(carrier) for carrier in dataset.carrier_hz[rows]]
        maps = power_of(dataset.pas(rows), dataset.header.pas_kind)
        plot_pas_maps(maps, dataset.grid, titles, scratch / MAPS)
        plot_overview(view.room, maps, dataset.grid, titles, scratch / OVERVIEW)
        plot_carriers(summary, scratch / CARRIERS)
