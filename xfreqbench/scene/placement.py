"""Possible positions of the receiver and the transmitters of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from xfreqbench.errors import PlacementError, SceneError
from xfreqbench.scene.meshes import SIONNA, SurfaceMesh, bounds_m
from xfreqbench.scene.model import FAR_M, Scene
from xfreqbench.scene.polygons import is_flat
from xfreqbench.scene.rooms import objects_of
from xfreqbench.scene.visibility import distance_to_surfaces, enclosing_mesh, sees
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, format_ghz, format_point

HIGHEST_ROOM_M = 60.0  # what is higher is asked for its unit
MIN_SEPARATION_M = 0.01  # Sionna RT drops every path with a shorter segment


@dataclass(frozen=True)
class Placement:
    """The T usable positions of a transmitter grid, and how many were left out for each reason."""

    tx_position_m: Float[FloatArray, "T 3"]
    rejected: dict[str, int]


def place_transmitters(
    scene: Scene, meshes: Sequence[SurfaceMesh], lowest_carrier_hz: float | None = None
) -> Placement:
    """Positions of the scene's grid outside every object and at least `clearance_m` from surfaces and receiver.

    The receiver is the whole array, as wide as at the lowest carrier, if that is given, otherwise its centre; all
    receivers of the scene count. Raises `PlacementError` if no position is left, and for a scene without a grid.
    """
    if scene.transmitters is None:
        raise PlacementError(
            f"Scene {scene.name!r} has no grid of transmitters. Give their positions (--tx-positions, or tx_positions= "
            "in Python), or write a [transmitters] table into the scene."
        )
    lattice_m = scene.transmitters.lattice_m
    clearance_m = scene.transmitters.clearance_m
    inside = enclosing_mesh(objects_of(scene, meshes), lattice_m) >= 0
    near_surface = ~inside & (distance_to_surfaces(meshes, lattice_m) < clearance_m)
    near_receiver = np.zeros_like(inside)
    carrier_hz = np.inf if lowest_carrier_hz is None else lowest_carrier_hz
    for receiver in scene.receivers:
        to_receiver_m = np.linalg.norm(lattice_m - np.asarray(receiver.position_m), axis=1)
        offset_m = receiver.element_position_wavelengths * SPEED_OF_LIGHT_M_S / carrier_hz
        near_receiver |= to_receiver_m < clearance_m + np.linalg.norm(offset_m, axis=1).max()
    near_receiver &= ~inside & ~near_surface
    usable = ~(inside | near_surface | near_receiver)
    rejected = {
        "inside an object": int(inside.sum()),
        f"within {clearance_m:g} m of a surface": int(near_surface.sum()),
        f"within {clearance_m:g} m of the receiver": int(near_receiver.sum()),
    }
    if not usable.any():
        raise PlacementError(
            f"None of the {len(lattice_m)} transmitter positions of scene {scene.name!r} is usable "
            f"({rejected}). Move the grid into free space or lower clearance_m."
        )
    check_inside(scene, meshes, lattice_m[usable], "Every transmitter")
    return Placement(lattice_m[usable], rejected)


def choose_transmitters(placement: Placement, num_transmitters: int | None, seed: int) -> Float[FloatArray, "T 3"]:
    """All usable positions, or a random choice of `num_transmitters` in grid order, which depends only on the seed.

    Raises `PlacementError` if more are asked for than there are, or none.
    """
    usable = placement.tx_position_m
    if num_transmitters is None:
        return usable
    if not 1 <= num_transmitters <= len(usable):
        raise PlacementError(
            f"The scene has {len(usable)} usable transmitter positions, but {num_transmitters} are "
            f"asked for. Ask for 1 to {len(usable)}, or give the scene's grid a smaller step_m."
        )
    chosen = np.random.default_rng(seed).choice(len(usable), num_transmitters, replace=False)
    return usable[np.sort(chosen)]


def check_transmitters(
    scene: Scene, meshes: Sequence[SurfaceMesh], tx_position_m: Float[FloatArray, "T 3"], carrier_hz: Sequence[float]
) -> None:
    """Raise `PlacementError` for the first position where no transmitter can be.

    That is a position that is not finite, in an object, on a surface, or on an element of the array at one of the
    carriers.
    """
    from scipy.spatial import KDTree

    if len(tx_position_m) == 0:
        raise PlacementError("No transmitter position is given; give at least one.")
    is_near = np.abs(tx_position_m) <= FAR_M  # and finite
    if not is_near.all():
        row = int(np.flatnonzero(~is_near.all(axis=1))[0])
        raise PlacementError(
            f"Transmitter {row} is at {format_point(tx_position_m[row])} m; give finite metres, up to {FAR_M:g}."
        )
    _check_free(scene, meshes, tx_position_m, "Transmitter")
    check_inside(scene, meshes, tx_position_m, "Every transmitter")
    for receiver, carrier in product(scene.receivers, carrier_hz):
        element_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier)
        points_m = np.vstack([receiver.position_m, element_m])
        distance_m = KDTree(points_m).query(tx_position_m)[0]
        _check_distance(distance_m, tx_position_m, "Transmitter", "the receiver array", carrier)


def _check_distance(
    distance_m: Float[FloatArray, "N"],
    points_m: Float[FloatArray, "N 3"],
    what: str,
    of: str,
    carrier_hz: float | None = None,
) -> None:
    """Raise `PlacementError` for the nearest point where it is nearer than `MIN_SEPARATION_M`."""
    index = int(distance_m.argmin())
    if distance_m[index] < MIN_SEPARATION_M:
        at = f" at {format_ghz(carrier_hz)}" if carrier_hz else ""
        raise PlacementError(
            f"{what} {index} is {distance_m[index] * 1e3:.1f} mm from {of}, at {format_point(points_m[index])} m"
            f"{at}. Keep at least {MIN_SEPARATION_M * 1e3:g} mm away."
        )


def check_receiver(scene: Scene, meshes: Sequence[SurfaceMesh], lowest_carrier_hz: float) -> None:
    """Raise `PlacementError` if an element of the array is in an object, on a surface or behind one.

    It is checked at the lowest carrier, where the array is widest. With a mesh file the array may not be outside of
    everything either, and a room that is too high raises `SceneError`.
    """
    check_inside(scene, meshes, np.array([scene.receiver.position_m]), "The receiver")
    _check_height(scene, meshes)
    element_m = scene.receiver.element_position_m(SPEED_OF_LIGHT_M_S / lowest_carrier_hz)
    points_m = np.vstack([scene.receiver.position_m, element_m])
    name = "" if scene.receiver.name is None else f" {scene.receiver.name!r}:"
    _check_free(scene, meshes, points_m, f"Receiver{name} array point", lowest_carrier_hz)
    is_behind = ~sees(meshes, element_m, points_m[0])
    if is_behind.any():
        raise PlacementError(
            f"Receiver{name} at {format_ghz(lowest_carrier_hz)} a surface is between the array's centre and its "
            f"element at {format_point(element_m[is_behind.argmax()])} m. Move the array, or ask for higher carriers, "
            "at which it is smaller."
        )


def check_inside(scene: Scene, meshes: Sequence[SurfaceMesh], points_m: Float[FloatArray, "N 3"], what: str) -> None:
    """Raise `PlacementError` if all points are outside of a scene, unless it has `outside`.

    With a mesh file that is outside of all meshes; for any scene, three times as far from surfaces and receivers as
    these measure, which is where positions in centimetres or millimetres would be.
    """
    if scene.outside or not meshes:
        return
    known_m = np.vstack([bounds_m(meshes), *(receiver.position_m for receiver in scene.receivers)])
    off_m = np.abs(points_m - points_m.clip(known_m.min(axis=0), known_m.max(axis=0))).max(axis=1)
    is_of_file, are_far = _has_file(scene), off_m.min() > 3 * np.ptp(known_m, axis=0).max()
    if are_far or (is_of_file and are_outside(meshes, points_m).all()):
        how = "how the file is meant, as in unit = 'mm' and up = 'y', or " if is_of_file else ""
        raise PlacementError(
            f"{what} of scene {scene.name!r} is outside of all {'meshes' if is_of_file else 'surfaces'}, at "
            f"{format_point(points_m[0])} m; they measure {_size(meshes)} from {format_point(bounds_m(meshes)[0])} m. "
            f"Move it, in metres, or write into the scene's TOML {how}outside = true if it is meant to be there."
        )


def _check_height(scene: Scene, meshes: Sequence[SurfaceMesh]) -> None:
    """Raise `SceneError` if the room of a mesh file is so high that its unit, which is not given, is not the metre."""
    if not _has_file(scene) or scene.unit is not None:
        return
    receiver_m, (low_m, high_m) = np.asarray(scene.receiver.position_m), bounds_m(meshes)
    beyond_m = 2 * float(np.abs([low_m - receiver_m, high_m - receiver_m]).max())
    height_m = np.outer([HIGHEST_ROOM_M, beyond_m, -HIGHEST_ROOM_M, -beyond_m], [0.0, 0.0, 1.0])
    free_above, has_no_roof, free_below, has_no_floor = sees(meshes, receiver_m + height_m, receiver_m)
    is_high_room = (free_above or free_below) and not (has_no_roof or has_no_floor)
    if is_high_room or high_m[2] - low_m[2] > 1000.0:
        raise SceneError(
            f"Scene {scene.name!r} measures {_size(meshes)}; its room is more than {HIGHEST_ROOM_M:g} m high. Write "
            "the unit of its mesh file into its TOML: unit = 'mm', 'cm', 'in' or 'ft', or unit = 'm' for metres."
        )


def _has_file(scene: Scene) -> bool:
    """Whether the meshes are of somebody's file, and not of Sionna RT."""
    return scene.scene is not None and not scene.scene.startswith(SIONNA)


def _size(meshes: Sequence[SurfaceMesh]) -> str:
    return " × ".join(f"{extent:,.2f}" for extent in np.ptp(bounds_m(meshes), axis=0)) + " m"


def are_outside(meshes: Sequence[SurfaceMesh], points_m: Float[FloatArray, "N 3"]) -> Bool[NDArray[np.bool_], "N"]:
    """Whether each of N points is next to or below all meshes, or farther above them than they are large.

    Nothing is outside of a single wall or ground, which holds nothing.
    """
    low_m, high_m = bounds_m(meshes)
    if is_flat(np.concatenate([mesh.vertices_m for mesh in meshes]), 0.01):
        return np.zeros(len(points_m), dtype=bool)
    high_m[2] += (high_m - low_m).max()
    return np.asarray(((points_m < low_m) | (points_m > high_m)).any(axis=1))


def _check_free(
    scene: Scene,
    meshes: Sequence[SurfaceMesh],
    points_m: Float[FloatArray, "N 3"],
    what: str,
    carrier_hz: float | None = None,
) -> None:
    at = f" at {format_ghz(carrier_hz)}" if carrier_hz else ""
    objects = objects_of(scene, meshes)
    enclosing = enclosing_mesh(objects, points_m)
    if (enclosing >= 0).any():
        index = int(np.flatnonzero(enclosing >= 0)[0])
        name = objects[enclosing[index]].name
        raise PlacementError(
            f"{what} {index} is inside {name!r}, at {format_point(points_m[index])} m{at}. "
            f"Move it into free space, or, if that is a room, write rooms = [{name!r}] into the scene's TOML."
        )
    _check_distance(distance_to_surfaces(meshes, points_m), points_m, what, "a surface", carrier_hz)


def median_transmitter(tx_position_m: Float[FloatArray, "T 3"]) -> int:
    """Index of the transmitter nearest to the median of all positions."""
    return int(np.linalg.norm(tx_position_m - np.median(tx_position_m, axis=0), axis=1).argmin())
