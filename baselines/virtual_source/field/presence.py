"""Where planes are walls: the contents of the cells of each plane, which are learned."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import embedding_bag

from .images import Touch

NOTHING, THICK, THIN, METAL = range(4)
# Logits at the start: walls are present, facets hardly.
_WALL, _FACET = (-1.0, 2.0, 0.0, -1.0), (3.0, -0.7, -1.2, -1.2)


class Presence(nn.Module):
    """Shares of nothing, a thick slab, a thin slab and metal in the cells of each plane: a softmax of learned logits.

    Cells are squares with sides of `cell_m`. Values are interpolated bilinearly, and constant beyond the border.
    """

    low_m: Tensor
    settled: Tensor  # the logits at the last search; they decide which crossings of paths count

    def __init__(self, num_planes: int, size: tuple[int, int] = (2, 2), cell_m: float = 0.3) -> None:
        super().__init__()
        self.cell_m = cell_m
        self.register_buffer("low_m", torch.zeros(num_planes, 2))
        self.logits = nn.Parameter(torch.zeros(num_planes, *size, len(_WALL)))
        self.register_buffer("settled", torch.zeros_like(self.logits))

    @classmethod
    def covering(
        cls,
        axes: Float[Tensor, "Q 2 3"],
        corners_m: Float[Tensor, "c 3"],
        is_wall: Bool[Tensor, "Q"],
        cell_m: float,
    ) -> Presence:
        """Cells that cover the projection of a box on every plane.

        At the start walls are present in all their cells, and other planes hardly.
        """
        place_m = torch.einsum("qac,nc->qna", axes, corners_m)
        low_m, high_m = place_m.amin(1), place_m.amax(1)
        extent_m = (high_m - low_m).flatten(0, -2).amax(0) if len(axes) else low_m.new_ones(2)
        size = ((extent_m / cell_m).ceil().long() + 1).clamp_min(2)
        presence = cls(len(axes), (int(size[0]), int(size[1])), cell_m)
        presence.low_m.copy_(low_m)
        start = torch.where(is_wall[:, None], torch.tensor(_WALL), torch.tensor(_FACET))
        with torch.no_grad():
            presence.logits.copy_(start[:, None, None])
        return presence

    def settle(self) -> None:
        """Use what has been learned for the crossings of paths that are traced from now on."""
        self.settled.copy_(self.logits.detach())

    def take(self, other: Presence, kept: Sequence[int]) -> None:
        """Copy the cells of some planes of `other` to the first planes; all cover the same box."""
        with torch.no_grad():
            rows, columns = map(min, self.logits.shape[1:3], other.logits.shape[1:3])
            self.logits[: len(kept), :rows, :columns] = other.logits[list(kept), :rows, :columns]

    def most_held(self) -> Float[Tensor, "Q"]:
        """Share of anything in the fullest cell of each plane."""
        return (1 - self.logits.detach().softmax(-1)[..., NOTHING]).flatten(1).amax(1)

    def held(self, touch: Touch) -> Float[Tensor, "*S"]:
        """Settled share of anything where paths meet planes; 0 where they meet none."""
        flat = touch.flattened()
        share = 1 - self._interpolated(self.settled, flat)[:, NOTHING]
        return torch.where(flat.plane >= 0, share, 0.0).reshape(touch.plane.shape)

    def shares(self, touch: Touch) -> Float[Tensor, "n 4"]:
        """Shares at points of planes, `touch` flattened; values where no plane is met are meaningless."""
        return self._interpolated(self.logits, touch)

    def _interpolated(self, logits: Float[Tensor, "Q I J 4"], touch: Touch) -> Float[Tensor, "n 4"]:
        """Softmax of logits interpolated between the four cells around each point."""
        _, rows, columns, _ = logits.shape
        plane = touch.plane.clamp_min(0)
        place = (touch.point_m - self.low_m[plane]) / self.cell_m
        limit = place.new_tensor([rows - 1, columns - 1])
        place = place.clamp_min(0).minimum(limit)
        below = place.long().minimum(limit.long() - 1)
        weight = place - below
        corner = (plane * rows + below[:, 0]) * columns + below[:, 1]
        cells = torch.stack([corner, corner + 1, corner + columns, corner + columns + 1], dim=-1)
        along, across = (torch.stack([1 - part, part], dim=-1) for part in weight.unbind(-1))
        blend = (along[:, :, None] * across[:, None]).flatten(1)
        return embedding_bag(cells, logits.flatten(0, 2), per_sample_weights=blend, mode="sum").softmax(-1)
