"""Mirror images of transmitters in sequences of planes, and the bounces and crossings of the paths (float64)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise, product

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize, pad

from ..search.planes import Plane
from .slab_kernels import crossings

Antenna = tuple[str, str]  # pattern and polarisation, as a `ReceiverArray` has them

_MIN_HELD = 0.03  # share of slabs in a cell; with less, it is an opening
_TOUCH_M = 1e-6  # a path that ends this close to a plane bounces off it and does not cross it
_MIN_SIN = 1e-9


@dataclass(frozen=True, eq=False)
class Mirrors:
    """Q planes n·x = s as tensors, with x relative to the array centre in world axes, and two axes within each."""

    normal: Float[Tensor, "Q 3"]
    distance_m: Float[Tensor, "Q"]
    axes: Float[Tensor, "Q 2 3"]

    @classmethod
    def of(cls, planes: Sequence[Plane]) -> Mirrors:
        """The mirrors of planes that were found."""
        normal = np.array([plane.normal for plane in planes], dtype=np.float64).reshape(-1, 3)
        distance_m = np.array([plane.distance_m for plane in planes], dtype=np.float64)
        return cls.of_tensors(torch.as_tensor(normal), torch.as_tensor(distance_m))

    @classmethod
    def of_tensors(cls, normal: Float[Tensor, "Q 3"], distance_m: Float[Tensor, "Q"]) -> Mirrors:
        """Mirrors with axes within each plane: the first is level; for a level plane it is the world's x axis.

        `findings.compared.axes_within` computes the same axes by NumPy, which rounds cross products differently.
        """
        up, east = (normal.new_tensor(axis).expand_as(normal) for axis in ((0.0, 0, 1), (1.0, 0, 0)))
        level = torch.linalg.cross(up, normal)
        across = east - (east * normal).sum(-1, keepdim=True) * normal
        first = normalize(torch.where(level.norm(dim=-1, keepdim=True) > 0.1, level, across), dim=-1)
        return cls(normal, distance_m, torch.stack([first, torch.linalg.cross(normal, first)], dim=1))

    def __len__(self) -> int:
        return len(self.distance_m)


@dataclass(frozen=True, eq=False)
class Touch:
    """Where paths meet planes: the plane's index (−1: none), the point along its axes, the cosine to its normal."""

    plane: Int[Tensor, "*S"]
    point_m: Float[Tensor, "*S 2"]
    cosine: Float[Tensor, "*S"]

    def __getitem__(self, rows: Tensor) -> Touch:
        return Touch(self.plane[rows], self.point_m[rows], self.cosine[rows])

    def flattened(self) -> Touch:
        """The same with all axes flattened to one."""
        return Touch(self.plane.flatten(), self.point_m.flatten(0, -2), self.cosine.flatten())

    @property
    def by_path(self) -> tuple[Int[Tensor, "N C"], Float[Tensor, "N C 2"], Float[Tensor, "N C"]]:
        """Planes, points and cosines, with the first two axes flattened to one."""
        return self.plane.flatten(0, 1), self.point_m.flatten(0, 1), self.cosine.flatten(0, 1)


@dataclass(frozen=True, eq=False)
class Traces:
    """K paths from each of B transmitters to the array centre.

    `length_m` is the distance of the image, float64, and `direct_m` that of the transmitter. `arrival` is the
    direction of the image in world axes. A path that `is_real` bounces off its planes in order, at points between
    the ends of the adjoining stretches; other paths have no bounces and no crossings. `polarised` holds P = 2^O
    factors, one for each choice of TE or TM at the O bounces: the gain of the path is
    Σ_c polarised_c Π_o R_{o, c_o}, where c counts in binary from the first bounce on.
    """

    direct_m: Float[Tensor, "B"]
    length_m: Float[Tensor, "B K"]
    arrival: Float[Tensor, "B K 3"]
    is_real: Bool[Tensor, "B K"]
    polarised: Float[Tensor, "B K P"]
    bounce: Touch  # (B, K, O)
    crossing: Touch  # (B, K, C)

    def __getitem__(self, rows: Tensor) -> Traces:
        return Traces(**{entry.name: getattr(self, entry.name)[rows] for entry in fields(self)})

    def with_crossings_of(self, held: Float[Tensor, "B K C"], number: int) -> Traces:
        """The same paths with at most `number` crossings each, those of cells with the largest `held` share."""
        is_some = held > _MIN_HELD
        width = min(number, int(is_some.sum(-1).max())) if held.numel() else 0
        kept, which = (held * is_some).topk(width, dim=-1)
        plane = torch.where(kept > 0, self.crossing.plane.gather(-1, which), -1)
        point_m = self.crossing.point_m.gather(-2, which[..., None].expand(*which.shape, 2))
        return replace(self, crossing=Touch(plane, point_m, self.crossing.cosine.gather(-1, which)))

    @classmethod
    def joined(cls, parts: Sequence[Traces]) -> Traces:
        """The traces of several groups of transmitters as one; groups with fewer crossings are padded."""
        width = max(part.crossing.plane.shape[-1] for part in parts)
        padded = []
        for touch in (part.crossing for part in parts):  # entries that are added meet no plane
            more = width - touch.plane.shape[-1]
            plane, point_m = pad(touch.plane, (0, more), value=-1), pad(touch.point_m, (0, 0, 0, more))
            padded.append(Touch(plane, point_m, pad(touch.cosine, (0, more))))
        plain = {
            name: torch.cat([getattr(part, name) for part in parts])
            for name in ("direct_m", "length_m", "arrival", "is_real", "polarised")
        }
        return cls(**plain, bounce=_cat([part.bounce for part in parts]), crossing=_cat(padded))


def _cat(touches: Sequence[Touch]) -> Touch:
    """Joined along the first axis."""
    return Touch(*(torch.cat([getattr(touch, entry.name) for touch in touches]) for entry in fields(Touch)))


def sequences(num_planes: int, max_order: int) -> Int[Tensor, "K O"]:
    """All sequences of at most `max_order` planes without repetition in a row, padded with −1; the first is empty."""
    found = [
        (*planes, *(-1,) * (max_order - order))
        for order in range(max_order + 1)
        for planes in product(range(num_planes), repeat=order)
        if all(one != other for one, other in pairwise(planes))
    ]
    return torch.tensor(found, dtype=torch.int64).reshape(len(found), max_order)


def trace(mirrors: Mirrors, sequence: Int[Tensor, "K O"], tx_m: Float[Tensor, "B 3"], antenna: Antenna) -> Traces:
    """The paths from B transmitters over K sequences of planes; `tx_m` is relative to the array centre."""
    images = _images(mirrors, sequence, tx_m)
    points, is_real = _bounces(mirrors, sequence, images)
    start = tx_m[:, None, None].expand(-1, len(sequence), 1, 3)
    nodes = torch.cat([start, points, torch.zeros_like(start)], dim=2)
    stretch = normalize(nodes[:, :, 1:] - nodes[:, :, :-1], dim=-1)
    length_m = images[-1].norm(dim=-1)
    return Traces(
        direct_m=tx_m.norm(dim=-1),
        length_m=length_m,
        arrival=(images[-1] / length_m.clamp_min(_TOUCH_M)[..., None]).float(),
        is_real=is_real,
        polarised=_polarised(mirrors, sequence, stretch, antenna).float(),
        bounce=_touch(mirrors, torch.where(is_real[..., None], sequence, -1), points, stretch[:, :, :-1]),
        crossing=_crossings(mirrors, nodes, is_real),
    )


def _images(mirrors: Mirrors, sequence: Int[Tensor, "K O"], tx_m: Float[Tensor, "B 3"]) -> list[Float[Tensor, "B K 3"]]:
    """Positions of the transmitter and of its image after each bounce; the receiver sees the last one."""
    images = [tx_m[:, None].expand(-1, len(sequence), 3)]
    for plane in sequence.T:
        normal, distance_m = mirrors.normal[plane], mirrors.distance_m[plane]
        height = (images[-1] * normal).sum(-1) - distance_m
        mirrored = images[-1] - 2 * height[..., None] * normal
        images.append(torch.where((plane >= 0)[:, None], mirrored, images[-1]))
    return images


def _bounces(
    mirrors: Mirrors, sequence: Int[Tensor, "K O"], images: list[Float[Tensor, "B K 3"]]
) -> tuple[Float[Tensor, "B K O 3"], Bool[Tensor, "B K"]]:
    """Points of the bounces, from the receiver backwards, where padded ones lie; and whether a path is real."""
    point = torch.zeros_like(images[0])
    is_real = torch.ones(point.shape[:2], dtype=torch.bool)
    points: list[Tensor] = []
    for plane, image in zip(sequence.T.flip(0), reversed(images[1:]), strict=True):
        normal, distance_m = mirrors.normal[plane], mirrors.distance_m[plane]
        way = image - point
        slope = (way * normal).sum(-1)
        share = (distance_m - (point * normal).sum(-1)) / torch.where(slope == 0, 1.0, slope)
        is_none = plane < 0
        is_real = is_real & (is_none | ((share > 0) & (share < 1) & (slope != 0)))
        point = torch.where(is_none[:, None], point, point + share[..., None] * way)
        points.insert(0, point)
    return torch.stack(points, dim=2) if points else point[:, :, None][:, :, :0], is_real


def antenna_field(direction: Float[Tensor, "... 3"], antenna: Antenna) -> Float[Tensor, "... 3"]:
    """Real field vector of an antenna along the world's vertical towards a direction (see `ReceiverArray`)."""
    pattern, polarization = antenna
    x, y, z = direction.unbind(-1)
    if pattern == "dipole" and polarization == "H":  # a short dipole along y: what of y is across the direction
        return 1.5**0.5 * (direction.new_tensor([0.0, 1.0, 0.0]) - y[..., None] * direction)
    level = (x * x + y * y).sqrt().clamp_min(_MIN_SIN)
    scale = 1.5**0.5 * level if pattern == "dipole" else torch.ones_like(level)
    if polarization == "H":
        return torch.stack([-scale * y / level, scale * x / level, torch.zeros_like(x)], dim=-1)
    return torch.stack([scale * z * x / level, scale * z * y / level, -scale * level], dim=-1)


def _polarised(
    mirrors: Mirrors, sequence: Int[Tensor, "K O"], stretch: Float[Tensor, "B K S 3"], antenna: Antenna
) -> Float[Tensor, "B K 2**O"]:
    """`Traces.polarised`: at every bounce the field is split along k×n (TE) and (k×n)×k (TM); padded ones are TE."""
    fields_ = [antenna_field(stretch[:, :, 0], antenna)]
    for bounce, plane in enumerate(sequence.T):
        before, after = stretch[:, :, bounce], stretch[:, :, bounce + 1]
        normal = mirrors.normal[plane].expand_as(before)
        across, other = (torch.linalg.cross(before, vector) for vector in (normal, normal.roll(1, dims=-1)))
        is_slanted = across.norm(dim=-1, keepdim=True) > _MIN_SIN  # else any unit vector within the plane
        te = normalize(torch.where(is_slanted, across, other), dim=-1)
        tm_before, tm_after = torch.linalg.cross(te, before), torch.linalg.cross(te, after)
        is_none = (plane < 0)[:, None]
        split = [
            part
            for field in fields_
            for part in (
                torch.where(is_none, field, (field * te).sum(-1, keepdim=True) * te),
                torch.where(is_none, 0.0, (field * tm_before).sum(-1, keepdim=True) * tm_after),
            )
        ]
        fields_ = split
    order = (sequence >= 0).sum(-1)
    received = antenna_field(stretch[:, torch.arange(len(sequence)), order], antenna)  # along the last stretch
    return torch.stack([(field * received).sum(-1) for field in fields_], dim=-1)


def _touch(
    mirrors: Mirrors, plane: Int[Tensor, "*S"], point: Float[Tensor, "*S 3"], direction: Float[Tensor, "*S 3"]
) -> Touch:
    """Where planes are met: world points are converted to the planes' own axes."""
    axes, normal = mirrors.axes[plane], mirrors.normal[plane]
    return Touch(
        plane=plane,
        point_m=(axes @ point[..., None])[..., 0].float(),
        cosine=(direction * normal).sum(-1).abs().float(),
    )


def _crossings(mirrors: Mirrors, nodes: Float[Tensor, "B K N 3"], is_real: Bool[Tensor, "B K"]) -> Touch:
    """Where the stretches of real paths go through planes."""
    height = nodes @ mirrors.normal.T - mirrors.distance_m
    tensors = nodes.flatten(0, 1), height.flatten(0, 1), is_real.flatten(), mirrors.axes
    nodes_m, height_m, are_real, axes = (each.contiguous().numpy() for each in tensors)
    met = crossings(nodes_m, height_m, are_real, axes, _TOUCH_M)
    return Touch(*(torch.from_numpy(each).unflatten(0, is_real.shape) for each in met))
