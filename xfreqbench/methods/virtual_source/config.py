"""Options of the virtual sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field as Limits

LOOK_SHARES = (0.08, 0.16, 0.3)  # of the budget, after which planes are searched again


@dataclass(frozen=True)
class SourceConfig:
    """Options of the virtual sources: `max_order` limits the reflections of a path, `max_images` the paths kept.

    Planes are searched before the first step, and again at each of `looks` moments of the training, in what the
    field has not explained until then.
    """

    max_planes: Annotated[int, Limits(ge=0, le=64)] = 32  # of which sequences are formed
    max_order: Annotated[int, Limits(ge=0, le=3)] = 3
    max_images: Annotated[int, Limits(ge=1)] = 160
    planes: Literal["search", "random"] = "search"
    looks: Annotated[int, Limits(ge=0, le=len(LOOK_SHARES))] = len(LOOK_SHARES)
    phase: bool = True  # of path lengths; false is an ablation
    lengths: Literal["float64", "float32"] = "float64"
    cell_m: Annotated[float, Limits(ge=0.05, le=10)] = 0.3
    gain_width: Annotated[int, Limits(ge=1)] = 64
    gain_octaves: Annotated[int, Limits(ge=0)] = 2
    sparsity: Annotated[float, Limits(ge=0)] = 0.02  # weight of the cells' contents in the loss
    max_gain: Annotated[float, Limits(ge=0, le=1)] = (
        0.0  # by which a network may change the gain of a path; 0: no network
    )
    free_sources: Annotated[int, Limits(ge=0)] = 32
    free_modes: Annotated[int, Limits(ge=1)] = 2
    lone_sources: Annotated[int, Limits(ge=1)] = (
        128  # free sources where fewer than three planes are found, as in aperture-gs
    )
    lone_modes: Annotated[int, Limits(ge=1)] = 4
