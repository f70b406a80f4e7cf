"""Rooms of any number of triangles, with positions of transmitters: closed, of one thick material, full of panels."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from xfreqbench.errors import XFreqBenchError
from xfreqbench.scene.model import ReceiverArray, Scene, Surface, TransmitterGrid
from xfreqbench.types import FloatArray

ROOM_M = (8.0, 6.0, 3.0)
SHELL_TRIANGLES = 12
_RECEIVER_M = (4.1, 2.9, 2.7)
_PANEL_M = (0.3, 1.2)  # least and greatest side of a panel
_MARGIN_M = 0.3  # of panels and transmitters from the walls; panels hang below the receiver
_THICKNESS_M = 1.0  # nothing comes through


def panel_room(num_triangles: int, num_elements_a_side: int = 4, seed: int = 0) -> Scene:
    """A room of `num_triangles` triangles, an even number from 12 on: six walls, and panels in random places.

    Walls and panels are rectangles along the axes; panels may cross each other. Raises `XFreqBenchError`.
    """
    if num_triangles < SHELL_TRIANGLES or num_triangles % 2:
        raise XFreqBenchError(
            f"A room of rectangles has 12, 14, 16, … triangles, but {num_triangles} are asked for."
        )
    rng = np.random.default_rng(seed)
    panels = (num_triangles - SHELL_TRIANGLES) // 2
    return Scene(
        name=f"room of {num_triangles} triangles",
        receiver=ReceiverArray(_RECEIVER_M, rows=num_elements_a_side, cols=num_elements_a_side),
        transmitters=TransmitterGrid(_RECEIVER_M, _RECEIVER_M, (1.0, 1.0, 1.0)),
        surface=(*_walls(), *(_panel(rng, number) for number in range(panels))),
    )


def transmitters(number: int, seed: int = 1) -> Float[FloatArray, "T 3"]:
    """Random positions in the room."""
    low, high = np.full(3, _MARGIN_M), np.array(ROOM_M) - _MARGIN_M
    return np.random.default_rng(seed).uniform(low, high, (number, 3))


def _walls() -> list[Surface]:
    walls = list[Surface]()
    for axis in range(3):
        for side in (0.0, ROOM_M[axis]):
            low, high = np.zeros(3), np.array(ROOM_M)
            low[axis] = high[axis] = side
            walls.append(_rectangle(f"wall {len(walls)}", low, high))
    return walls


def _panel(rng: np.random.Generator, number: int) -> Surface:
    size_m = rng.uniform(*_PANEL_M, 3)
    size_m[rng.integers(3)] = 0.0
    highest_m = np.array([ROOM_M[0], ROOM_M[1], _RECEIVER_M[2]]) - _MARGIN_M - size_m
    low_m = rng.uniform(np.full(3, _MARGIN_M), highest_m)
    return _rectangle(f"panel {number}", low_m, low_m + size_m)


def _rectangle(name: str, low_m: Float[FloatArray, "3"], high_m: Float[FloatArray, "3"]) -> Surface:
    return Surface(name, "concrete", _THICKNESS_M, tuple(low_m.tolist()), tuple(high_m.tolist()))
