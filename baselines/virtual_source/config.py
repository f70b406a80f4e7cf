"""Options of the virtual sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field as Limits
from typing_extensions import Doc

LOOK_SHARES = (0.08, 0.16, 0.3)  # of the budget, after which planes are searched again


@dataclass(frozen=True)
class SourceConfig:
    """Options of the virtual sources: `max_order` limits the reflections of a path, `max_images` the paths kept.

    Planes are searched before the first step, and again at each of `looks` moments of the training, in what the
    field has not explained until then.
    """

    max_planes: Annotated[int, Limits(ge=0, le=64), Doc("most planes, of which sequences are formed")] = 32
    max_order: Annotated[int, Limits(ge=0, le=3), Doc("most reflections of a path")] = 3
    max_images: Annotated[int, Limits(ge=1), Doc("most paths that are kept")] = 160
    planes: Annotated[Literal["search", "random"], Doc("random: an ablation")] = "search"
    looks: Annotated[int, Limits(ge=0, le=len(LOOK_SHARES)), Doc("searches during training")] = len(LOOK_SHARES)
    phase: Annotated[bool, Doc("whether path lengths give phases; false is an ablation")] = True
    lengths: Annotated[Literal["float64", "float32"], Doc("precision of path lengths")] = "float64"
    cell_m: Annotated[float, Limits(ge=0.05, le=10), Doc("side of a plane's cells")] = 0.3
    gain_width: Annotated[int, Limits(ge=1), Doc("features of the layers of the network for gains")] = 64
    gain_octaves: Annotated[int, Limits(ge=0), Doc("octaves of its inputs")] = 2
    sparsity: Annotated[float, Limits(ge=0), Doc("weight of the cells' contents in the loss")] = 0.02
    max_gain: Annotated[float, Limits(ge=0, le=1), Doc("by which a network may change gains; 0: none")] = 0.0
    free_sources: Annotated[int, Limits(ge=0), Doc("sources beside the images, as in aperture-gs")] = 32
    free_modes: Annotated[int, Limits(ge=1), Doc("channels of theirs whose powers add up")] = 2
    render: Annotated[
        Literal["learned", "traced", "blended"],
        Doc("maps of the learned field, of the room that is made of it and traced, or of both, by validation rows"),
    ] = "blended"
