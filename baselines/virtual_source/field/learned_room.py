"""What the virtual sources know of a room: planes, their materials and extent, and the images in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor, nn

from ..config import SourceConfig
from ..room.faces import ALIKE, Cells, faces
from ..search.planes import Plane
from .images import Antenna, Mirrors, Touch, Traces, sequences, trace
from .slab_kernels import METAL, NOTHING
from .slabs import LearnedSlabs, Presence, path_gains

MAX_CROSSINGS = 6  # of planes that count for a path: those that are present most probably
_MARGIN_M = 1.0  # by which cells extend beyond transmitters and receiver
_CHUNK = 64  # transmitters or sequences that are traced at once
_NUM_WEIGHED = 24  # transmitters for which the power of sequences is compared
MIN_LENGTH_M = 1e-3
_MIN_PRESENCE = 0.3  # of a plane's fullest cell; with less, the plane is dropped at the next search
_MAX_ANTENNA_GAIN = 1.5  # of two dipoles together, in amplitude
_HELD = 0.3  # share of slabs from which on a cell counts as full in findings


class LearnedRoom(nn.Module):
    """The planes found so far, their learned slabs and cells, and the sequences of planes whose images are used.

    Positions are relative to the array centre, in world axes, float64.
    """

    normal: Tensor
    distance_m: Tensor
    std: Tensor  # standard deviations of distance (m) and tilt (rad), (Q, 2)
    sequence: Tensor
    trained_m: Tensor
    trained_hz: Tensor
    antenna_code: Tensor
    slabs: LearnedSlabs
    presence: Presence

    def __init__(self, config: SourceConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("antenna_code", torch.zeros(2, dtype=torch.bool))
        self._make_room(0, 1, 0, 0, Presence(0, cell_m=config.cell_m))

    def _make_room(self, num_planes: int, num_images: int, num_tx: int, num_carriers: int, presence: Presence) -> None:
        """Replace all tensors by new ones of these sizes, without planes' values."""
        order = self.config.max_order if num_planes else 0
        sizes = {
            "normal": (num_planes, 3),
            "distance_m": (num_planes,),
            "std": (num_planes, 2),
            "trained_m": (num_tx, 3),
            "trained_hz": (num_carriers,),
        }
        for name, size in sizes.items():
            self.register_buffer(name, torch.zeros(size, dtype=torch.float64))
        self.register_buffer("sequence", torch.zeros(num_images, order, dtype=torch.int64))
        self.slabs, self.presence = LearnedSlabs(num_planes), presence

    def match(self, tensors: Mapping[str, Tensor]) -> None:
        """Take the sizes of stored tensors, so that they can be loaded."""
        num_planes, rows, columns, _ = tensors["presence.logits"].shape
        num_images, num_tx, num_hz = (len(tensors[name]) for name in ("sequence", "trained_m", "trained_hz"))
        presence = Presence(num_planes, (rows, columns), self.config.cell_m)
        self._make_room(num_planes, num_images, num_tx, num_hz, presence)

    def enter(self, antenna: Antenna, offset_m: Float[Tensor, "T 3"], carrier_hz: Float[Tensor, "F"]) -> None:
        """Set the antennas, and the transmitters and carriers of the training rows."""
        pattern, polarization = antenna
        self.antenna_code.copy_(torch.tensor([pattern == "dipole", polarization == "H"]))
        self.trained_m, self.trained_hz = torch.unique(offset_m, dim=0), torch.unique(carrier_hz)

    @property
    def antenna(self) -> Antenna:
        """Pattern and polarisation of the antennas, which are the same at both ends."""
        is_dipole, is_horizontal = self.antenna_code.tolist()
        return "dipole" if is_dipole else "iso", "H" if is_horizontal else "V"

    @property
    def mirrors(self) -> Mirrors:
        """The planes as mirrors."""
        return Mirrors.of_tensors(self.normal, self.distance_m)

    @property
    def planes(self) -> list[Plane]:
        """The planes, without their scores, which are not kept."""
        rows = zip(self.normal.numpy(), self.distance_m.tolist(), self.std.tolist(), strict=True)
        return [Plane(normal, distance_m, std[0], std[1], score=0.0) for normal, distance_m, std in rows]

    def worth_keeping(self) -> list[int]:
        """Indices of planes of which some cell is full enough, by what has been learned."""
        return (self.presence.most_held() > _MIN_PRESENCE).nonzero()[:, 0].tolist()

    def take(self, kept: Sequence[int], found: Sequence[Plane]) -> None:
        """Keep some planes with all that was learned of them, add the planes found, and choose images again."""
        before = self.planes
        known = [before[index] for index in kept]
        planes = [*known, *found[: self.config.max_planes - len(known)]]
        mirrors, slabs, presence = Mirrors.of(planes), self.slabs, self.presence
        trained_m, trained_hz = self.trained_m, self.trained_hz
        is_wall = _are_walls(mirrors, trained_m) & (not known)
        low_m = trained_m.amin(0).clamp_max(0) - _MARGIN_M
        high_m = trained_m.amax(0).clamp_min(0) + _MARGIN_M
        box = product(*zip(low_m, high_m, strict=True))
        corners_m = torch.stack([torch.stack(corner) for corner in box]).float()
        cells = Presence.covering(mirrors.axes.float(), corners_m, is_wall, self.config.cell_m)
        self._make_room(len(mirrors), 1, 0, 0, cells)
        self.normal, self.distance_m = mirrors.normal, mirrors.distance_m
        self.trained_m, self.trained_hz = trained_m, trained_hz
        std = [(plane.distance_std_m, plane.tilt_std_rad) for plane in planes]
        self.std = torch.tensor(std, dtype=torch.float64).reshape(-1, 2)
        self.slabs.take(slabs, kept)
        self.presence.take(presence, kept)
        self.presence.settle()
        self._choose()

    def _choose(self) -> None:
        """Keep the sequences with most power, averaged over some of the transmitters, by what is known so far."""
        some_m = _some(self.trained_m)
        found = sequences(len(self.normal), self.config.max_order if len(self.normal) else 0)
        most, power = self._most_power(found), torch.zeros(len(found))
        num_kept = min(self.config.max_images, len(found))
        with torch.no_grad():
            for part in most.argsort(descending=True, stable=True).split(_CHUNK):
                if most[part[0]] < power.topk(num_kept).values[-1]:
                    break
                power[part] = self._power_of(found[part], some_m, self.trained_hz)
        power[0] = math.inf
        kept = power.argsort(descending=True, stable=True)[:num_kept]
        self.sequence = found[kept[power[kept] > 0]]

    def _most_power(self, sequence: Int[Tensor, "K O"]) -> Float[Tensor, "K"]:
        """Upper bound of the power: coefficients are at most 1, and a plane reflects no more than its fullest cell."""
        held = self.presence.most_held()
        return _MAX_ANTENNA_GAIN**2 * torch.cat([held, held.new_ones(1)])[sequence].prod(dim=1).square()

    def _power_of(
        self, sequence: Int[Tensor, "K O"], offset_m: Float[Tensor, "B 3"], carrier_hz: Float[Tensor, "F"]
    ) -> Float[Tensor, "K"]:
        """Power of sequences, averaged over transmitters and carriers, in units of the line of sight."""
        return self.attenuated(self._traced(sequence, offset_m), carrier_hz).abs().square().mean((0, 2))

    def traced(self, offset_m: Float[Tensor, "B 3"]) -> Traces:
        """The paths of transmitters over the chosen sequences, without crossings of empty cells."""
        return Traces.joined([self._traced(self.sequence, part) for part in offset_m.split(_CHUNK)])

    def _traced(self, sequence: Int[Tensor, "K O"], offset_m: Float[Tensor, "B 3"]) -> Traces:
        """The paths over any sequences, without crossings of empty cells."""
        traces = trace(self.mirrors, sequence, offset_m, self.antenna)
        with torch.no_grad():
            return traces.with_crossings_of(self.presence.held(traces.crossing), MAX_CROSSINGS)

    def attenuated(self, traces: Traces, carrier_hz: Float[Tensor, "F"]) -> Complex[Tensor, "B K F"]:
        """Gains of paths without phase of travel and correction, in units of the line of sight in free space."""
        spread = traces.is_real * (traces.direct_m[:, None] / traces.length_m.clamp_min(MIN_LENGTH_M))
        return path_gains(self.slabs, self.presence, traces, spread.float(), carrier_hz)

    def findings(self, array_m: Float[Tensor, "3"]) -> dict[str, Any]:
        """Planes with materials and extent, images by mean power, and faces, as JSON holds them; in world axes."""
        with torch.no_grad():
            traces = self.traced(self.trained_m)
            touched = traces.bounce[traces.is_real].flattened()
            planes = [self._finding(index, touched, array_m) for index in range(len(self.normal))]
            power = self._power_of(self.sequence, _some(self.trained_m), self.trained_hz)
            found = faces(self._cells(traces), self.trained_m.numpy())
        images = [
            {"planes": [plane for plane in sequence if plane >= 0], "power": value}
            for sequence, value in zip(self.sequence.tolist(), power.tolist(), strict=True)
        ]
        images.sort(key=lambda image: image["power"], reverse=True)
        found_faces = [{**face._asdict(), "corners_m": (array_m.numpy() + face.corners_m).tolist()} for face in found]
        return {"receiver_m": array_m.tolist(), "planes": planes, "images": images, "faces": found_faces}

    def _cells(self, traces: Traces) -> list[Cells]:
        """The cells of each plane; and the power of training paths there, if a cell were full and a perfect mirror."""
        presence, bounce = self.presence, traces.bounce
        if not len(self.normal):
            return []
        share = presence.share
        held = 1 - presence.shares(bounce.flattened())[:, NOTHING].reshape(bounce.plane.shape)
        held = torch.where(bounce.plane >= 0, held, 1.0)
        spread = traces.direct_m[:, None] / traces.length_m.clamp_min(MIN_LENGTH_M)
        bounces = range(held.shape[-1])
        others = [torch.cat([held[..., :one], held[..., one + 1 :]], -1).prod(-1) for one in bounces]
        power = (spread.float()[..., None] * torch.stack(others, dim=-1)).square()
        is_touched = (bounce.plane >= 0) & traces.is_real[..., None]
        plane, point_m = bounce.plane[is_touched], bounce.point_m[is_touched]
        limit = torch.tensor(share.shape[1:3]) - 1
        place = ((point_m - presence.low_m[plane]) / presence.cell_m).round().long().clamp_min(0).minimum(limit)
        seen = torch.zeros(share.shape[:3]).index_put((plane, *place.T), power[is_touched], accumulate=True)
        tables = (self.normal, self.distance_m, self.mirrors.axes, presence.low_m, share, seen)
        return [
            Cells(normal, float(distance_m), axes, low_m, presence.cell_m, shares, powers)
            for normal, distance_m, axes, low_m, shares, powers in zip(
                *(table.numpy().astype(float) for table in tables), strict=True
            )
        ]

    def _finding(self, index: int, touched: Touch, array_m: Float[Tensor, "3"]) -> dict[str, Any]:
        """One plane of the findings, from where the training paths bounce off it."""
        here = touched[(touched.plane == index).nonzero()[:, 0]]
        share = self.presence.shares(here)
        is_held = share[:, NOTHING] < 1 - _HELD
        distance_std_m, tilt_std_rad = self.std[index].tolist()
        corners_m = None  # of the rectangle around the points that hold something, in world coordinates
        if len(point_m := here.point_m[is_held]):
            (left, low), (right, high) = point_m.amin(0).tolist(), point_m.amax(0).tolist()
            foot_m = array_m + self.distance_m[index] * self.normal[index]
            along = foot_m.new_tensor([[left, low], [right, low], [right, high], [left, high]])
            corners_m = (foot_m + along @ self.mirrors.axes[index]).tolist()
        mixed = share[is_held].mean(0) if is_held.any() else share.new_zeros(METAL + 1)
        return {
            "normal": self.normal[index].tolist(),
            "distance_m": float(self.distance_m[index]),
            "distance_std_m": distance_std_m,
            "tilt_std_rad": tilt_std_rad,
            "held": float(is_held.float().mean()) if len(here.plane) else 0.0,
            "corners_m": corners_m,
            "slabs": self.slabs.described(index, mixed[1:].tolist()),
        }

    def clutter(self) -> Float[Tensor, ""]:
        """Mean share of slabs in the cells of all planes, which the loss keeps small."""
        held = 1 - self.presence.share[..., NOTHING]
        return held.mean() if held.numel() else held.sum()


def _some(offset_m: Float[Tensor, "T 3"]) -> Float[Tensor, "t 3"]:
    """About `_NUM_WEIGHED` of the transmitters."""
    return offset_m[:: max(1, len(offset_m) // _NUM_WEIGHED)]


def _are_walls(mirrors: Mirrors, offset_m: Float[Tensor, "T 3"]) -> Bool[Tensor, "Q"]:
    """Whether a plane is a wall: all transmitters are in front of it, and no stronger such plane faces the same way."""
    holds_all = (offset_m @ mirrors.normal.T < mirrors.distance_m).all(0)
    is_alike = mirrors.normal @ mirrors.normal.T > ALIKE
    is_stronger = torch.ones_like(is_alike).tril(-1)
    return holds_all & ~(is_alike & is_stronger & holds_all).any(1)
