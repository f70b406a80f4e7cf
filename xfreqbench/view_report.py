"""A data set or a scene to look at: one page, its figures, and the scene as a 3D model, in one folder."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from xfreqbench.dataset import PasDataset
from xfreqbench.errors import OutputExistsError
from xfreqbench.mesh_glb import GlbModel
from xfreqbench.page.document import Picture, is_of_subject
from xfreqbench.pas import power_of
from xfreqbench.plots import plot_pas_maps
from xfreqbench.plots_view import group_colour, material_colour, plot_carriers, plot_room, ray_colour
from xfreqbench.storage import atomic_path, require_space, storage_errors, write_text
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz
from xfreqbench.view_page import view_page
from xfreqbench.view_scene import Room
from xfreqbench.view_summary import CarrierSummary, summarize
from xfreqbench.viewing import View

PAGE, MODEL, ROOM, MAPS, CARRIERS = "index.html", "scene.glb", "scene.png", "pas.png", "carriers.svg"
FILES = (PAGE, MODEL, ROOM, MAPS, CARRIERS)
_ALT = {
    ROOM: "Plan and elevation of the scene with receiver, transmitters and rays",
    MAPS: "Power angular spectra of one transmitter at every carrier",
    CARRIERS: "Similarity of maps, power, paths and silence against the carrier",
}
_SURFACE_OPACITY = 60
_ORANGE, _BLACK = (213, 94, 0, 255), (20, 20, 20, 255)
_BALL_M, _MARKER_M, _RAY_M, _ELEMENT_M, _BORESIGHT_M = 0.07, 0.02, 0.008, 0.015, 0.5


def claim(view: View, folder: Path) -> None:
    """Make the folder, or see that every file of ours there was written for the same data set or scene.

    Those are replaced and nothing else is touched. Raises `OutputExistsError` and `StorageError`.
    """
    present = [name for name in FILES if (folder / name).exists()]
    if present and not _is_ours(folder / PAGE, view.subject):
        raise OutputExistsError(
            f"{folder / present[0]} exists and was not written for this data set or scene. Choose another folder "
            "with -o, or delete that file."
        )
    require_space(folder / PAGE, 1)


def write_view(view: View, folder: Path) -> list[Path]:
    """Draw everything, then write it: `FILES`, of a scene without data only the first three.

    Returns the files written. Raises as `claim` does, before anything is drawn, and `DataError`.
    """
    claim(view, folder)
    summary = summarize(view.dataset) if view.dataset else None
    with tempfile.TemporaryDirectory() as scratch:
        drawn = dict(_drawn(view, summary, Path(scratch)))
    pictures = {name: Picture(name, alt, drawn[name]) for name, alt in _ALT.items() if name in drawn}
    write_text(
        folder / PAGE, view_page(view, summary, pictures, MODEL)
    )  # first: it says whose the others are
    for name, content in drawn.items():
        _write_bytes(folder / name, content)
    return [folder / PAGE, *(folder / name for name in drawn)]


def room_model(room: Room) -> GlbModel:
    """The scene as a 3D model; every surface and ray is a node, and so is each group of transmitters."""
    model = GlbModel()
    for mesh in room.meshes:
        model.add_surface(mesh, material_colour(mesh.material, _SURFACE_OPACITY))
    for name, position_m in room.groups().items():
        model.add_markers(name, position_m, _MARKER_M, group_colour(name))
    for number, ray in enumerate(room.rays, start=1):
        name = f"ray {number}: {ray.level_db:.1f} dB, {ray.label}"
        model.add_tube(name, ray.points_m, _RAY_M, ray_colour(ray.level_db))
    model.add_ball(f"transmitter {room.tx}", room.tx_m, _BALL_M, _BLACK)
    _add_receiver(model, room)
    return model


def _add_receiver(model: GlbModel, room: Room) -> None:
    elements_m = room.receiver.element_position_m(SPEED_OF_LIGHT_M_S / room.lowest_hz)
    ahead_m = room.receiver_m + _BORESIGHT_M * room.boresight
    model.add_ball("receiver", room.receiver_m, _ELEMENT_M, _ORANGE)
    model.add_markers(f"array elements at {format_ghz(room.lowest_hz)}", elements_m, _ELEMENT_M, _ORANGE)
    model.add_tube("boresight", np.stack([room.receiver_m, ahead_m]), _RAY_M, _ORANGE)


def _drawn(view: View, summary: CarrierSummary | None, scratch: Path) -> Iterator[tuple[str, bytes]]:
    """Names and contents of everything but the page."""
    room_model(view.room).write(scratch / MODEL)
    plot_room(view.room, scratch / ROOM)
    if view.dataset and summary:
        _plot_maps(view.dataset, view.room.tx, scratch / MAPS)
        plot_carriers(summary, scratch / CARRIERS)
    for name in FILES:
        if (scratch / name).exists():
            yield name, (scratch / name).read_bytes()


def _plot_maps(dataset: PasDataset, tx: int, path: Path) -> None:
    rows = np.flatnonzero(dataset.tx_index == tx)
    titles = [format_ghz(carrier) for carrier in dataset.carrier_hz[rows]]
    plot_pas_maps(power_of(dataset.pas(rows), dataset.header.pas_kind), dataset.grid, titles, path)


def _is_ours(page: Path, subject: str) -> bool:
    try:
        return is_of_subject(page.read_text("utf-8"), subject)
    except (OSError, UnicodeDecodeError):
        return False


def _write_bytes(path: Path, content: bytes) -> None:
    with atomic_path(path, len(content)) as temporary, storage_errors(path, len(content)):
        temporary.write_bytes(content)
