"""Learns across rooms what mirrors hang where: images of the transmitter, added up in the array's lag functions.

A room's walls mirror a transmitter. From what was heard, every plane of a fixed set may be a wall: upright ones of 32
headings and level ones, each at 20 distances from the array. Evidence for a plane is the power that the heard maps have
where its image of the transmitter would be seen, beyond what the direct wave puts there. For a transmitter that is
asked for, a small network, the same for all planes, turns evidence and geometry into the power of each image. Images
and direct wave add up as sums over lags, without phases, and a second network corrects the sums. Where nothing is
heard, what is left is what rooms have in common: floors and ceilings, and walls somewhere.
"""

from __future__ import annotations

import json
import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from pydantic import Field
from torch import Tensor, nn
from torch.nn.functional import linear, pad, softplus
from typing_extensions import Doc

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.unseen_rooms import HEARD_GHZ, NUMS_HEARD
from xfreqbench.errors import DivergenceError, MethodError
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.methods.config import as_json
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.learning.loss import map_loss
from xfreqbench.methods.learning.stored import moments_of, named
from xfreqbench.methods.learning.targets import Beams, GridView, as_kind, in_kind
from xfreqbench.methods.learning.training import Adam
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import ghz_to_hz

_NEAREST_M, _FARTHEST_M = 0.15, 12.0  # planes, from the array
_RELEVANT_M = 1.0  # evidence at a heard transmitter counts less by e for each metre from the one that is asked for
_LEAST_EXCESS = 0.003  # of power beyond the direct wave's, before its logarithm
_MAX_GRADIENT, _WARM_UP_STEPS, _MIN_RATE = 1.0, 50, 0.02
_PREDICT_BATCH = 32
_FIRST_GAIN = -6.0  # logarithm of an image's power before training
_STATE_FILE, _TENSORS_FILE = "state.json", "tensors.npz"
_CPU = torch.device("cpu")
Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class RoomLagsConfig:
    """Options of `room-lags`; a fit ends after `steps`, or before when the budget is spent."""

    steps: Annotated[Count, Doc("most steps of a fit")] = 200_000
    trained_on: Annotated[int, Field(ge=0), Doc("the first so many of the training rooms; 0: all")] = 0
    rooms: Annotated[Count, Doc("rooms of a step")] = 4
    queries: Annotated[Count, Doc("maps of each room that a step asks for")] = 16
    headings: Annotated[int, Field(ge=4), Doc("of upright planes")] = 32
    distances: Annotated[int, Field(ge=2), Doc("of planes from the array, evenly spaced as logarithms")] = 20
    width: Annotated[Count, Doc("of the network that weighs planes")] = 40
    hears: Annotated[bool, Doc("whether what is heard in a room is used")] = True
    images: Annotated[bool, Doc("whether planes mirror; else the sums of the direct wave are corrected alone")] = True
    learning_rate: Annotated[float, Field(gt=0), Doc("of Adam")] = 2e-3
    ssim_weight: Annotated[float, Field(ge=0, le=1), Doc("of 1 − SSIM in the loss, beside L1")] = 0.8
    stride: Annotated[Count, Doc("a step uses every so many rows and columns of a map")] = 5
    ssim_window: Annotated[int, Field(ge=2), Doc("rows and columns in view of the loss's SSIM")] = 3


@dataclass(frozen=True, eq=False)
class _Heard:
    """Evidence of K heard transmitters at C carriers for the A × D planes.

    `power` is what their maps have at the plane's image of the transmitter, `direct` what the direct wave puts there,
    and `is_beyond` says that the transmitter stands behind the plane.
    """

    position_m: Float[Tensor, "K 3"]
    power: Float[Tensor, "K C A D"]
    direct: Float[Tensor, "K A D"]
    is_beyond: Bool[Tensor, "K A D"]

    def of(self, tx: Int[Tensor, "k"]) -> _Heard:
        return _Heard(self.position_m[tx], self.power[tx], self.direct[tx], self.is_beyond[tx])


class _Images:
    """Geometry of one room in the array's frame: its planes, their images of transmitters, and evidence for them."""

    def __init__(self, field: RoomField, up: Float[Tensor, "3"]) -> None:
        self.field, self.up = field, up
        across = torch.linalg.cross(torch.eye(3)[int(up.abs().argmin())], up)
        across = across / across.norm()
        heading = torch.arange(field.config.headings) * (2 * math.pi / field.config.headings)
        upright = heading.cos()[:, None] * across + heading.sin()[:, None] * torch.linalg.cross(up, across)
        self.normal = torch.cat([upright, up[None], -up[None]])  # (A, 3), level planes last
        ends = math.log10(_NEAREST_M), math.log10(_FARTHEST_M)
        self.distance_m = torch.logspace(*ends, field.config.distances)  # (D,)

    def towards(
        self, position_m: Float[Tensor, "T 3"]
    ) -> tuple[Float[Tensor, "T A D 3"], Float[Tensor, "T A D"], Float[Tensor, "T A D"]]:
        """Directions of the images of transmitters, their distances, and how far transmitters are from the planes."""
        before_m = self.distance_m - (position_m @ self.normal.T)[..., None]
        image_m = position_m[:, None, None] + 2 * before_m[..., None] * self.normal[:, None]
        length_m = image_m.norm(dim=-1)
        return image_m / length_m[..., None], length_m, before_m

    def heard(self, position_m: Float[Tensor, "K 3"], sums: Float[Tensor, "K C L"]) -> _Heard:
        """Evidence from transmitters whose maps, of peak 1, are given by their sums over lags."""
        power, direct, beyond = [], [], []
        for place_m, part in zip(position_m.split(16), sums.split(16), strict=True):
            direction, _, before_m = self.towards(place_m)
            wave, weight = self.field.wave(direction), self.field.weight
            power.append(torch.einsum("tadl,tcl->tcad", wave, weight * part))
            direct.append(torch.einsum("tadl,tl->tad", wave, weight * self.field.plane_wave(_unit(place_m))))
            beyond.append(before_m <= 0)
        return _Heard(position_m, torch.cat(power).half(), torch.cat(direct).half(), torch.cat(beyond))


def _unit(position_m: Float[Tensor, "T 3"]) -> Float[Tensor, "T 3"]:
    return position_m / position_m.norm(dim=1, keepdim=True)


class RoomField(nn.Module):
    """The networks, and the array that they are for: sums over lags of what is asked for in a room."""

    def __init__(self, config: RoomLagsConfig, beam: BartlettBeam) -> None:
        super().__init__()
        self.config, self.beams = config, Beams(beam, _CPU)
        lags = LagFunctions(beam)
        self._lag, self.weight, self._count = (
            torch.as_tensor(table, dtype=torch.float32)
            for table in (lags.lag, np.tile(lags.weight, 2), np.tile(lags.count, 2))
        )
        num_sums, carriers, width = 2 * len(lags.lag), len(HEARD_GHZ), config.width
        num_features = 3 * carriers + 4  # about a plane by all that was heard
        self.upright = nn.Sequential(nn.Conv2d(num_features, 16, 3), nn.SiLU(), nn.Conv2d(16, 8, 1))
        self.level = nn.Sequential(nn.Conv1d(num_features, 16, 3, padding=1), nn.SiLU(), nn.Conv1d(16, 8, 1))
        # features of an image: of it alone, of its plane whoever is asked for, and of the transmitter whose it is
        self.parts = 6 + carriers, 3 + 8 + 3 * carriers, 3
        self.gain = _perceptron(sum(self.parts), width, width, 1)
        nn.init.constant_(self.gain[-1].bias, _FIRST_GAIN)  # type: ignore[arg-type]
        self.correction = _perceptron(num_sums + 8, 96, 96, num_sums)
        for parameter in self.correction[-1].parameters():
            nn.init.zeros_(parameter)

    def wave(self, direction: Float[Tensor, "... 3"]) -> Float[Tensor, "... L"]:
        """Cosines and sines of a direction's phases: times sums over lags and `weight`, they add up to its power."""
        phase = 2 * math.pi * direction @ self._lag.T
        return torch.cat([phase.cos(), phase.sin()], dim=-1)

    def plane_wave(self, direction: Float[Tensor, "... 3"]) -> Float[Tensor, "... L"]:
        """Sums over lags of a plane wave from a direction, whose map has peak 1."""
        return self._count * self.wave(direction)

    def forward(
        self, room: _Images, heard: _Heard, position_m: Float[Tensor, "Q 3"], carrier_hz: Float[Tensor, "Q"]
    ) -> Float[Tensor, "Q L"]:
        """Sums over lags of maps, in any scale, for transmitters in the array's frame."""
        number = len(heard.position_m) if self.config.hears else 0
        share = math.log1p(number) / math.log1p(max(NUMS_HEARD))
        range_m, direction = position_m.norm(dim=1), _unit(position_m)
        direct = self.plane_wave(direction)
        octave, carriers = torch.log10(carrier_hz / 1e10).float(), len(HEARD_GHZ)
        sums, total = direct, torch.zeros_like(octave)
        if self.config.images:
            towards, length_m, before_m = room.towards(position_m)
            about, near = self._evidence(heard, position_m, number, share)
            wave = self.wave(towards)
            seen = [
                torch.log(length_m / range_m[:, None, None]),
                (room.distance_m + before_m) / length_m,  # cosine of incidence
                torch.einsum("qadl,ql->qad", wave, self.weight * direct),
                before_m.clamp(-1, 3),
            ]
            rise = (room.normal @ room.up)[:, None].expand(about.shape[1:])
            place = [room.distance_m.log().expand_as(rise)[None], rise[None], rise.abs()[None], self._context(about)]
            told = (
                torch.cat([torch.stack(seen, 1), near], dim=1).movedim(1, -1),
                torch.cat([*place, about[: 3 * carriers]]).movedim(0, -1),
                torch.stack([octave, range_m.log(), direction @ room.up], dim=-1)[:, None, None],
            )
            first: Any = self.gain[0]
            of_image, of_plane, of_transmitter = map(linear, told, first.weight.split(self.parts, dim=1))
            hidden = of_image + (of_plane + first.bias) + of_transmitter
            gain = softplus(self.gain[1:](hidden)[..., 0])
            gain = gain * (before_m > 0) * (range_m[:, None, None] / length_m) ** 2
            sums, total = sums + self._count * torch.einsum("qad,qadl->ql", gain, wave), gain.sum(dim=(1, 2))
        known = [octave, range_m.log(), *direction.T, torch.full_like(octave, share)]
        known += [torch.full_like(octave, number > 0), total]
        size = (self._count.sum() / 2) ** 0.5
        return sums + size * self.correction(torch.cat([direct / size**2, torch.stack(known, dim=1)], dim=1))

    def _evidence(
        self, heard: _Heard, position_m: Float[Tensor, "Q 3"], number: int, share: float
    ) -> tuple[Float[Tensor, "N A D"], Float[Tensor, "Q n A D"]]:
        """About every plane: means over all that was heard; and means over what was heard near each transmitter."""
        planes = (self.config.headings + 2, self.config.distances)
        carriers = len(HEARD_GHZ)
        amount = torch.tensor([share, float(number > 0)])[:, None, None].expand(-1, *planes)
        if not number:
            nothing = torch.zeros(3 * carriers + 2, *planes)
            return torch.cat([nothing, amount]), torch.zeros(len(position_m), carriers + 2, *planes)
        power, direct, beyond = heard.power.float(), heard.direct.float(), heard.is_beyond.float()
        is_before = 1 - beyond
        count = is_before.sum(0).clamp_min(1)
        excess = (power - direct[:, None]) * is_before[:, None]
        # a wall mirrors everyone before it: the mean of logarithms is high only where all have the image
        level = (torch.log(excess.clamp_min(0) + _LEAST_EXCESS) + 4) / 3
        sums = [power * is_before[:, None], excess * (1 - direct[:, None]), level * is_before[:, None]]
        about = torch.cat([*(part.sum(0) / count for part in sums), ((direct * is_before).sum(0) / count)[None]])
        about = torch.cat([about, beyond.mean(0)[None], amount])
        weight = torch.softmax(-torch.cdist(position_m, heard.position_m) / _RELEVANT_M, dim=1)
        features = torch.cat([excess, (direct * is_before)[:, None], beyond[:, None]], dim=1)
        return about, (weight @ features.flatten(1)).reshape(len(position_m), -1, *planes)

    def _context(self, about: Float[Tensor, "N A D"]) -> Float[Tensor, "8 A D"]:
        """What the planes around each say of it; headings are periodic."""
        upright, level = about[:, : self.config.headings], about[:, self.config.headings :]
        around = pad(torch.cat([upright[:, -1:], upright, upright[:, :1]], dim=1), (1, 1))
        return torch.cat([self.upright(around[None])[0], self.level(level.movedim(1, 0)).movedim(0, 1)], dim=1)


def _perceptron(*sizes: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.SiLU()]
    return nn.Sequential(*layers[:-1])


class _TrainingRoom:
    """A room with all its samples: positions in the array's frame, and sums over lags of maps with peak 1."""

    def __init__(self, field: RoomField, dataset: PasDataset) -> None:
        receiver = dataset.header.receiver
        self.images = _Images(field, _up(dataset))
        position_m, power = dataset.tables["tx_position_m"], dataset.tables["peak_power"]
        self.position_m = torch.as_tensor((position_m - receiver.position_m) @ receiver.rotation, dtype=torch.float32)
        self.carrier_hz = torch.as_tensor(dataset.header.carrier_hz)
        self.tx = torch.as_tensor(np.flatnonzero((power > 0).all(axis=1)))
        cfr = dataset.tables["cfr"].astype(np.complex128) / np.sqrt(np.where(power > 0, power, 1))[..., None]
        sums = field.beams.lags_of_channels(torch.as_tensor(cfr.reshape(-1, cfr.shape[-1]).astype(np.complex64)))
        self.sums = sums.reshape(*power.shape, -1)
        self._evidence: _Heard | None = None

    @property
    def evidence(self) -> _Heard:
        """Of all transmitters at the carriers that a method hears; half a megabyte, made once."""
        if self._evidence is None:
            columns = [int((self.carrier_hz - ghz_to_hz(carrier)).abs().argmin()) for carrier in HEARD_GHZ]
            self._evidence = self.images.heard(self.position_m, self.sums[:, columns])
        return self._evidence


def _up(dataset: PasDataset) -> Float[Tensor, "3"]:
    """The vertical in the array's frame."""
    return torch.as_tensor(dataset.header.receiver.rotation[2], dtype=torch.float32)


def heard_sums(heard: PasDataset) -> tuple[Float[FloatArray, "K 3"], Float[NDArray[np.float32], "K C L"]]:
    """The transmitters heard at all of `HEARD_GHZ`, in the array's frame, and the sums over lags of their maps."""
    receiver = heard.header.receiver
    by_carrier = {carrier: np.flatnonzero(heard.carrier_hz == ghz_to_hz(carrier)) for carrier in HEARD_GHZ}
    tx = [set(heard.tx_index[rows].tolist()) for rows in by_carrier.values()]
    rows = [rows[np.isin(heard.tx_index[rows], [*set.intersection(*tx)])] for rows in by_carrier.values()]
    lags = LagFunctions(heard.beam)
    sums = np.stack([lags.of_maps(heard.pas(at_carrier), heard.header.pas_kind) for at_carrier in rows], axis=1)
    return (heard.tx_position_m[rows[0]] - receiver.position_m) @ receiver.rotation, sums


@dataclass
class _State:
    """All that training changes, and what predictions need beside it."""

    field: RoomField
    optimizer: torch.optim.Adam
    generator: torch.Generator
    kind: PasKind
    step: int = 0
    share: float = 0.0


class RoomLags:
    """Learns from many rooms how power arrives by mirror images, and weighs planes by what is heard in a new one."""

    Config = RoomLagsConfig

    def __init__(self, config: RoomLagsConfig = RoomLagsConfig()) -> None:
        self.config = config
        self._state: _State | None = None

    @property
    def num_parameters(self) -> int:
        """Number of values that training sets; 0 before it."""
        return sum(parameter.numel() for parameter in self._state.field.parameters()) if self._state else 0

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Generator[Progress, float, None]:
        """Minimise L1 and 1 − SSIM of maps by Adam; the learning rate falls as half a cosine over the budget.

        Each step draws rooms, in each of them how many transmitters are heard, which, and which are asked for, at any
        carrier of the training rooms. Raises `MethodError` for rooms whose arrays differ, and `DivergenceError`.
        """
        state = self._state or self._started(rooms, seed)
        self._state = state
        chosen = rooms.select(num_rooms=self.config.trained_on or None)
        known = [_TrainingRoom(state.field, _of_one_array(dataset, state.field)) for dataset in chosen]
        maps = self.config.rooms * self.config.queries
        state.share = max(state.share, state.step / self.config.steps, budget.share(state.step, 0, maps * state.step))
        while state.step < self.config.steps:
            loss = self._train(state, known)
            spent = yield Progress(state.step, loss, {"maps": maps * state.step, "rooms": len(known)})
            state.share = max(spent or 0.0, state.step / self.config.steps)

    def adapt(self, heard: PasDataset, budget: Budget) -> RoomLagsPredictor:
        """The evidence of what is heard, with which maps of the room are predicted; nothing is trained."""
        return self.adapted(heard, *heard_sums(heard))

    def adapted(
        self, heard: PasDataset, position_m: Float[FloatArray, "K 3"], sums: Float[NDArray[np.float32], "K C L"]
    ) -> RoomLagsPredictor:
        """As `adapt`, where `heard_sums` are known."""
        state = self._trained()
        field, images = state.field, _Images(state.field, _up(heard))
        with torch.no_grad():
            evidence = images.heard(torch.as_tensor(position_m, dtype=torch.float32), torch.as_tensor(sums))
        return RoomLagsPredictor(field, images, evidence, heard)

    def save(self, directory: Path) -> None:
        """Store weights, optimiser and random state as arrays, the rest as JSON; loading runs no stored code."""
        state = self._trained()
        beams = state.field.beams
        tensors = {f"field.{name}": value for name, value in state.field.state_dict().items()}
        tensors |= moments_of(state.field, state.optimizer)
        tensors["generator"] = state.generator.get_state()
        arrays: dict[str, Any] = {name: value.numpy() for name, value in tensors.items()}
        arrays |= {"elevation_rad": beams.grid.elevation_rad, "azimuth_rad": beams.grid.azimuth_rad}
        np.savez(directory / _TENSORS_FILE, **arrays, elements=beams.element_position_wavelengths)
        stored = {"config": as_json(self.config), "step": state.step, "share": state.share, "kind": state.kind}
        (directory / _STATE_FILE).write_text(json.dumps(stored), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> RoomLags:
        """The method as it was saved; its `fit` goes on from there."""
        stored = json.loads((directory / _STATE_FILE).read_text(encoding="utf-8"))
        method = cls(cls.Config(**stored["config"]))
        with np.load(directory / _TENSORS_FILE) as file:
            arrays: Mapping[str, NDArray[Any]] = dict(file)
        beam = BartlettBeam(arrays["elements"], AngularGrid(arrays["elevation_rad"], arrays["azimuth_rad"]))
        state = method._new_state(beam, stored["kind"])
        tensors = {name: torch.from_numpy(value) for name, value in arrays.items()}
        state.field.load_state_dict(named(tensors, "field."))
        for name, parameter in state.field.named_parameters():
            moments = {key: tensors.get(f"adam.{key}.{name}") for key in ("step", "exp_avg", "exp_avg_sq")}
            if all(value is not None for value in moments.values()):
                state.optimizer.state[parameter] = moments
        state.generator.set_state(tensors["generator"])
        state.step, state.share = stored["step"], stored["share"]
        method._state = state
        return method

    def _started(self, rooms: Collection, seed: int) -> _State:
        first = rooms[0]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            state = self._new_state(first.beam, first.header.pas_kind)
        state.generator.manual_seed(seed)
        return state

    def _new_state(self, beam: BartlettBeam, kind: PasKind) -> _State:
        field = RoomField(self.config, beam)
        optimizer = Adam(field.parameters(), lr=self.config.learning_rate)
        return _State(field, optimizer, torch.Generator(), kind)

    def _trained(self) -> _State:
        if self._state is None:
            raise MethodError("RoomLags knows nothing yet; fit or load it first.")
        return self._state

    def _train(self, state: _State, rooms: list[_TrainingRoom]) -> float:
        """Make one step; return the loss before it."""
        config, generator = self.config, state.generator
        view = GridView.draw(config.stride, generator)
        predicted, truth = [], []
        for number in torch.randint(len(rooms), (config.rooms,), generator=generator).tolist():
            room = rooms[number]
            tx = room.tx[torch.randperm(len(room.tx), generator=generator)]
            most = [count for count in NUMS_HEARD if count + config.queries <= len(tx)] or [0]
            count = most[int(torch.randint(len(most), (1,), generator=generator))]
            asked = tx[count : count + config.queries]
            carrier = torch.randint(len(room.carrier_hz), (len(asked),), generator=generator)
            query = room.position_m[asked], room.carrier_hz[carrier]
            predicted.append(state.field(room.images, room.evidence.of(tx[:count]), *query))
            truth.append(room.sums[asked, carrier])
        beams, sums = state.field.beams, torch.cat(predicted)
        peak = beams.peak_of_lags(sums, view, GridView(config.stride))[..., None]
        maps = in_kind(beams.power_of_lags(sums, view) / peak, state.kind)
        target = in_kind(beams.power_of_lags(torch.cat(truth), view), state.kind)
        loss = map_loss(maps, target, config.ssim_weight, config.ssim_window, config.stride)
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(state.field.parameters(), _MAX_GRADIENT)
        state.step += 1
        if not bool(torch.isfinite(norm) & torch.isfinite(loss)):
            raise DivergenceError(state.step, "loss")
        falling = _MIN_RATE + (1 - _MIN_RATE) * (0.5 + 0.5 * math.cos(math.pi * min(state.share, 1.0)))
        for group in state.optimizer.param_groups:
            group["lr"] = config.learning_rate * falling * min(1.0, state.step / _WARM_UP_STEPS)
        state.optimizer.step()
        return float(loss.detach())


class RoomLagsPredictor:
    """Predicts the maps of one room, from the evidence of what was heard in it."""

    def __init__(self, field: RoomField, images: _Images, heard: _Heard, data: PasDataset) -> None:
        self.field, self._images, self._heard = field, images, heard
        self.receiver, self._kind = data.header.receiver, data.header.pas_kind

    def predict(
        self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]
    ) -> Float[NDArray[np.float32], "B E A"]:
        """Maps with peak 1."""
        batches = range(_PREDICT_BATCH, len(carrier_hz), _PREDICT_BATCH)
        with torch.no_grad():
            maps = []
            for query in zip(np.split(tx_position_m, batches), np.split(carrier_hz, batches), strict=True):
                power = self.field.beams.power_of_lags(self.sums(*query), GridView())
                maps.append(as_kind(power, self._kind))
        return torch.cat(maps).numpy()

    def sums(self, tx_position_m: Float[FloatArray, "B 3"], carrier_hz: Float[FloatArray, "B"]) -> Float[Tensor, "B L"]:
        """Sums over lags of maps, where those of a direct wave are as of a map with peak 1."""
        offset_m = (tx_position_m - np.asarray(self.receiver.position_m)) @ self.receiver.rotation
        position_m, carriers = torch.as_tensor(offset_m, dtype=torch.float32), torch.as_tensor(carrier_hz)
        sums: Tensor = self.field(self._images, self._heard, position_m, carriers)
        return sums


def _of_one_array(dataset: PasDataset, field: RoomField) -> PasDataset:
    """The room, if its array and grid are those of the field; raises `MethodError`."""
    same = np.array_equal(dataset.beam.element_position_wavelengths, field.beams.element_position_wavelengths)
    if not same or dataset.grid.shape != field.beams.grid.shape:
        raise MethodError(f"{dataset.path} has another array or grid than the rooms before; room-lags learns one.")
    return dataset
