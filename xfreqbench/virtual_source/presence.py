"""Where planes are walls: what a cell of a plane holds is learned."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import embedding_bag

from xfreqbench.virtual_source.images import Touch

NOTHING, THICK, THIN = range(3)
_WALL, _FACET = (-1.0, 2.0, 0.0), (3.0, -0.7, -1.2)  # logits to start with: a wall is there, a facet hardly


class Presence(nn.Module):
    """Shares of nothing, a thick and a thin slab in the cells of each plane, softmax of what is learned.

    Cells are squares of `cell_m`, their values interpolated bilinearly; beyond the border that of the border.
    """

    low_m: Tensor
    settled: Tensor  # the logits when paths were last traced, which say what may stand in their way

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
        """Cells that cover the corners of a box on every plane, walls all present at first, others hardly."""
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
        """Let paths that are traced from now on be told of what has been learned."""
        self.settled.copy_(self.logits.detach())

    def take(self, other: Presence, kept: Sequence[int]) -> None:
        """Take over what some of another's planes hold, as the first ones; all cover the same box."""
        with torch.no_grad():
            rows, columns = map(min, self.logits.shape[1:3], other.logits.shape[1:3])
            self.logits[: len(kept), :rows, :columns] = other.logits[list(kept), :rows, :columns]

    def most_held(self) -> Float[Tensor, "Q"]:
        """Share of anything at all in the fullest cell of each plane."""
        return (1 - self.logits.detach().softmax(-1)[..., NOTHING]).flatten(1).amax(1)

    def held(self, touch: Touch) -> Float[Tensor, "*S"]:
        """Share of anything at all where planes are met, as it was settled; 0 where none is."""
        flat = touch.flattened()
        share = 1 - self._interpolated(self.settled, flat)[:, NOTHING]
        return torch.where(flat.plane >= 0, share, 0.0).reshape(touch.plane.shape)

    def shares(self, touch: Touch) -> Float[Tensor, "n 3"]:
        """Shares at points of planes, `touch` flattened; those of no plane are of plane 0, and mean nothing."""
        return self._interpolated(self.logits, touch)

    def _interpolated(self, logits: Float[Tensor, "Q I J 3"], touch: Touch) -> Float[Tensor, "n 3"]:
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
