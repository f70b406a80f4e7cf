"""Images in planes against the exact image method: which paths there are, and the gain of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from xfreqbench.baselines.virtual_source.config import SourceConfig
from xfreqbench.baselines.virtual_source.field import learned_room as room_module
from xfreqbench.baselines.virtual_source.field import slabs as slabs_module
from xfreqbench.baselines.virtual_source.field.images import Antenna, Touch, Traces, sequences, trace
from xfreqbench.baselines.virtual_source.field.learned_room import MAX_CROSSINGS, LearnedRoom
from xfreqbench.baselines.virtual_source.field.slab_kernels import METAL, METAL_REFLECTION, NOTHING, THICK, THIN
from xfreqbench.baselines.virtual_source.field.slabs import LearnedSlabs, Presence
from xfreqbench.baselines.virtual_source.search.planes import Plane

from tests.support.box_room import SIDES, SIZE_M, closed_room, plane
from xfreqbench.scene.materials import ITU_MATERIALS, complex_permittivity
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.tracing.image.kernels.slabs import slab_coefficients
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.paths import Paths
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.units import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M

pytestmark = pytest.mark.usefixtures("one_thread")
RECEIVER = ReceiverArray(position_m=(2.1, 1.7, 2.2))
ARRAY_M = np.array(RECEIVER.position_m)
TX_M = np.array([(0.7, 3.1, 0.9), (4.4, 0.6, 1.5), (2.4, 1.6, 2.45)])  # the last one above the array
CARRIER_HZ = np.array([1e9, 5e9, 28e9])
SLABS = (  # no two alike, so that no wall can stand for another
    ("concrete", 0.12),
    ("plasterboard", 0.03),
    ("glass", 0.01),
    ("wood", 0.04),
    ("chipboard", 0.025),
    ("ceiling_board", 0.02),
)
ANTENNAS: tuple[Antenna, ...] = tuple(product(("iso", "dipole"), ("V", "H")))


def fill(room: LearnedRoom, share: int) -> None:
    """All cells hold the same, but for 1e-30."""
    with torch.no_grad():
        room.presence.logits.fill_(-35.0)
        room.presence.logits[..., share] = 35.0
    room.presence.settle()


def known_box(antenna: Antenna, tx_m: np.ndarray = TX_M) -> LearnedRoom:
    """The room that learning could at best arrive at."""
    room = LearnedRoom(SourceConfig())
    room.enter(antenna, torch.as_tensor(tx_m - ARRAY_M), torch.as_tensor(CARRIER_HZ))
    room.take(
        [], [plane(np.eye(3)[axis] * (2 * side - 1), abs(side * SIZE_M[axis] - ARRAY_M[axis])) for axis, side in SIDES]
    )
    fill(room, THICK)
    with torch.no_grad():
        for index, (material, thickness_m) in enumerate(SLABS):
            band = ITU_MATERIALS[material][0]
            room.slabs.log_susceptibility[0, index] = np.log(band.a - 1)
            room.slabs.log_conductivity[0, index] = np.log(band.c)
            room.slabs.power[0, index] = band.d
            room.slabs.log_thickness[0, index] = np.log(thickness_m)
    return room


def solved(antenna: Antenna, tx_m: np.ndarray) -> Paths:
    """Reflections alone, by the solver that makes the data sets."""
    pattern, polarization = antenna
    receiver = replace(RECEIVER, pattern=pattern, polarization=polarization)
    settings = TraceSettings(max_depth=3, interactions=("specular",), rays=20_000)
    return ImageTracer(closed_room(receiver, SLABS), list(CARRIER_HZ), settings).paths(tx_m)


def walls_of(paths: Paths) -> list[tuple[int, ...]]:
    """The walls on which the vertices of each path lie, padded with −1."""
    found = []
    for vertices in paths.vertices_m:
        off_m = np.abs([vertices[:, axis] - side * SIZE_M[axis] for axis, side in SIDES]).T
        found.append(tuple(-1 if np.isnan(row).any() else int(row.argmin()) for row in off_m))
    return found


def traced_in_box(antenna: Antenna) -> tuple[LearnedRoom, torch.Tensor, Traces]:
    room = known_box(antenna)
    sequence = sequences(len(SLABS), 3)
    return room, sequence, trace(room.mirrors, sequence, torch.as_tensor(TX_M - ARRAY_M), antenna)


@pytest.mark.parametrize("antenna", ANTENNAS)
def test_every_reflection_of_a_room_is_an_image_as_long_from_the_same_direction_and_as_strong(
    antenna: Antenna, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slabs_module, "NUM_COSINES", 20_000)  # the table's own error is looked at elsewhere
    room, sequence, traces = traced_in_box(antenna)
    with torch.no_grad():
        gain = room.attenuated(traces, torch.as_tensor(CARRIER_HZ)).numpy()
    place = {walls: index for index, walls in enumerate(map(tuple, sequence.tolist()))}
    for tx, tx_m in enumerate(TX_M):
        paths = solved(antenna, tx_m)
        at = [place[walls] for walls in walls_of(paths)]
        assert len(set(at)) == len(at) == 63  # 1 + 6 + 18 + 38: images of a box of order 3 and less
        length_m = traces.length_m[tx, at].numpy()
        np.testing.assert_allclose(length_m, paths.delay_s * SPEED_OF_LIGHT_M_S, rtol=0, atol=1e-9)
        np.testing.assert_allclose(traces.arrival[tx, at].numpy(), paths.arrival, atol=1e-6)  # float32
        # both ends' unit vectors of the azimuth oppose each other: one sign for all paths
        sign = -1 if antenna == ("iso", "H") else 1
        direct = SPEED_OF_LIGHT_M_S / CARRIER_HZ / (4 * np.pi * float(traces.direct_m[tx]))
        error = np.abs(sign * gain[tx, at].T * direct[:, None] - paths.gain)
        assert (error / direct[:, None]).max() < 3e-6  # float32; measured 6e-7


def test_a_path_that_the_room_has_not_is_not_real_or_would_go_through_a_wall() -> None:
    antenna: Antenna = ("iso", "V")
    _, sequence, traces = traced_in_box(antenna)
    is_free = traces.is_real & (traces.crossing.plane < 0).all(-1)
    for tx, tx_m in enumerate(TX_M):
        found = {tuple(walls) for walls in sequence[is_free[tx]].tolist()}
        assert found == set(walls_of(solved(antenna, tx_m)))
    assert not traces.is_real.all()
    assert bool((traces.bounce.plane[~traces.is_real] == -1).all())
    assert bool((traces.crossing.plane[~traces.is_real] == -1).all())


@pytest.mark.parametrize("material", ["concrete", "glass"])
def test_coefficients_are_those_of_the_solver(material: str) -> None:
    band, thickness_m = ITU_MATERIALS[material][0], 0.02
    slabs = LearnedSlabs(1)
    with torch.no_grad():
        slabs.log_susceptibility.fill_(np.log(band.a - 1))
        slabs.log_conductivity.fill_(np.log(band.c))
        slabs.power.fill_(band.d)
        slabs.log_thickness.fill_(np.log(thickness_m))
        cosine = torch.linspace(0.02, 1, 23)
        carrier_hz = torch.tensor([1e9, 10e9, 94e9], dtype=torch.float64)
        reflected, transmitted = slabs.coefficients(carrier_hz, cosine)
    for row, angle_cosine in enumerate(cosine.double().tolist()):
        for column, carrier in enumerate(carrier_hz.tolist()):
            phase = 2 * np.pi * carrier / SPEED_OF_LIGHT_M_S * thickness_m
            te, tm, *passed = slab_coefficients(angle_cosine, complex_permittivity(material, carrier), phase)
            # 200 turns of phase at 94 GHz, in float32
            np.testing.assert_allclose(reflected[0, 0, row, :, column].numpy(), [te, tm], atol=2e-5)
            np.testing.assert_allclose(transmitted[0, 0, row, column].numpy(), np.mean(passed), atol=2e-5)


def test_coefficients_and_their_slopes_are_those_of_the_formula() -> None:
    generator = torch.Generator().manual_seed(0)
    slabs, cosine, carrier_hz = LearnedSlabs(5), torch.linspace(0, 1, 23), torch.tensor([1e9, 10e9]).double()
    with torch.no_grad():
        for parameter in slabs.parameters():
            parameter += 0.3 * torch.randn(parameter.shape, generator=generator)
    results = []
    for tables in (slabs.coefficients(carrier_hz, cosine), literal_coefficients(slabs, carrier_hz, cosine)):
        weights = [torch.randn(part.shape, generator=torch.Generator().manual_seed(1)) for part in tables]
        total = sum((part.real * weight - part.imag).sum() for part, weight in zip(tables, weights, strict=True))
        results.append((*(part.detach() for part in tables), *torch.autograd.grad(total, list(slabs.parameters()))))
    for own, literal in zip(*results, strict=True):
        torch.testing.assert_close(own, literal, rtol=1e-4, atol=1e-5 * float(literal.abs().max()))  # float32


def literal_coefficients(
    slabs: LearnedSlabs, carrier_hz: torch.Tensor, cosine: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """ITU-R P.2040, Eqs. 37, 43 and 44."""
    slab, ghz, cosine = (..., None, None), (carrier_hz / 1e9).float(), cosine[:, None]
    conductivity = slabs.log_conductivity.exp()[slab] * ghz ** slabs.power[slab]
    loss = conductivity / (2 * math.pi * VACUUM_PERMITTIVITY_F_M * carrier_hz.float())
    permittivity = torch.complex(1 + slabs.log_susceptibility.exp()[slab].expand_as(loss), -loss)
    root = (permittivity - (1 - cosine * cosine)).sqrt()
    te = (cosine - root) / (cosine + root)
    tm = (permittivity * cosine - root) / (permittivity * cosine + root)
    depth = 2 * math.pi * carrier_hz.float() / SPEED_OF_LIGHT_M_S * slabs.log_thickness.exp()[slab]
    face, once = torch.stack([te, tm], dim=-2), (-1j * depth * root).exp()[..., None, :]
    loop = 1 - (face * once) ** 2
    return face * (1 - once**2) / loop, ((1 - face**2) * once / loop).mean(dim=-2)


def test_gains_of_paths_and_their_slopes_are_those_of_sums_over_all_choices_of_polarisation() -> None:
    room, _, traces = traced_in_box(("dipole", "V"))
    generator = torch.Generator().manual_seed(0)
    disturb(room, generator)
    with torch.no_grad():
        traces = traces.with_crossings_of(room.presence.held(traces.crossing), MAX_CROSSINGS)
    assert bool((traces.bounce.plane >= 0).all(-1).any()) and bool((traces.crossing.plane >= 0).all(-1).any())
    carrier_hz, results = torch.as_tensor(CARRIER_HZ), []
    for gain in (room.attenuated(traces, carrier_hz), literal_gains(room, traces, carrier_hz)):
        weight = torch.randn(gain.shape, generator=torch.Generator().manual_seed(1))
        results.append(
            (gain.detach(), *torch.autograd.grad((gain.real * weight + gain.imag).sum(), list(room.parameters())))
        )
    for own, literal in zip(*results, strict=True):
        torch.testing.assert_close(own, literal, rtol=1e-4, atol=1e-5 * float(literal.abs().max()))  # float32


def test_a_table_of_coefficients_is_a_good_stand_in_at_angles_between_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    room, _, traces = traced_in_box(("iso", "V"))
    disturb(room, torch.Generator().manual_seed(0))
    gains = []
    for num_cosines in (slabs_module.NUM_COSINES, 20_000):
        monkeypatch.setattr(slabs_module, "NUM_COSINES", num_cosines)
        with torch.no_grad():
            gains.append(room.attenuated(traces, torch.as_tensor(CARRIER_HZ)))
    error = (gains[0] - gains[1]).abs()
    assert float(error.square().mean().sqrt()) < 1e-3
    assert float(error.max()) < 1e-2


def disturb(room: LearnedRoom, generator: torch.Generator) -> None:
    """Other materials in every plane, and anything in its cells."""
    with torch.no_grad():
        room.slabs.log_susceptibility += 0.5 * torch.randn(room.slabs.power.shape, generator=generator)
        room.presence.logits[:] = torch.randn(room.presence.logits.shape, generator=generator)
    room.presence.settle()


def literal_gains(room: LearnedRoom, traces: Traces, carrier_hz: torch.Tensor) -> torch.Tensor:
    """What `LearnedRoom.attenuated` computes, as its formula says it."""
    cosine = torch.linspace(0, 1, slabs_module.NUM_COSINES)
    reflecting, transmitting = room.slabs.coefficients(carrier_hz, cosine)
    bounce = literal_factors(room.presence, traces.bounce, reflecting, METAL, METAL_REFLECTION)
    through = literal_factors(room.presence, traces.crossing, transmitting[:, :, :, None], NOTHING, (1.0,))
    gain = torch.zeros(*traces.is_real.shape, len(carrier_hz), dtype=torch.complex64)
    for nth, choice in enumerate(product((0, 1), repeat=bounce.shape[2])):
        term = traces.polarised[..., nth, None].to(gain.dtype)
        for order, polarisation in enumerate(choice):
            term = term * bounce[:, :, order, polarisation]
        gain = gain + term
    spread = (traces.is_real * traces.direct_m[:, None] / traces.length_m).float()
    return gain * through[..., 0, :].prod(dim=2) * spread[..., None]


def literal_factors(
    presence: Presence, touch: Touch, table: torch.Tensor, kind: int, plain: Sequence[float]
) -> torch.Tensor:
    """Factors (B, K, O, V, F) where paths meet planes; 1 where they meet none."""
    plane, limit = touch.plane.clamp_min(0), torch.tensor(presence.logits.shape[1:3]) - 1
    place = ((touch.point_m - presence.low_m[plane]) / presence.cell_m).clamp_min(0).minimum(limit)
    below = place.long().minimum(limit - 1)
    (i, j), (along, across) = below.unbind(-1), (place - below).unbind(-1)
    corners = product(enumerate((1 - along, along)), enumerate((1 - across, across)))
    logits = [(a * b)[..., None] * presence.logits[plane, i + row, j + column] for (row, a), (column, b) in corners]
    share = torch.stack(logits).sum(0).softmax(-1)[..., None, None]
    angle = touch.cosine * (table.shape[2] - 1)
    first = angle.long().clamp_max(table.shape[2] - 2)
    weight = (angle - first)[..., None, None]
    slabs = (1 - weight) * table[:, plane, first] + weight * table[:, plane, first + 1]
    value = share[:, :, :, kind] * torch.tensor(plain)[:, None]
    for slab, held in enumerate((THICK, THIN)):
        value = value + share[:, :, :, held] * slabs[slab]
    return torch.where((touch.plane >= 0)[..., None, None], value, 1)


def room_of(planes: Sequence[Plane], tx_m: Sequence[Sequence[float]], max_order: int = 1) -> LearnedRoom:
    """The array is the origin."""
    room = LearnedRoom(SourceConfig(max_order=max_order))
    room.enter(("iso", "H"), torch.tensor(tx_m, dtype=torch.float64), torch.as_tensor(CARRIER_HZ))
    room.take([], planes)
    return room


def direct_gain(room: LearnedRoom) -> torch.Tensor:
    with torch.no_grad():
        return room.attenuated(room.traced(room.trained_m), room.trained_hz)[:, 0]


def test_a_plane_in_the_way_lets_through_what_a_slab_does_and_an_empty_one_all() -> None:
    tx_m = [(3.0, 0.4, 0.2), (4.0, -1.0, 0.3)]
    room = room_of([plane((1, 0, 0), 1.3)], tx_m)
    fill(room, THICK)
    free = direct_gain(room_of([], tx_m))
    cosine = (room.trained_m[:, 0] / room.trained_m.norm(dim=-1)).float()
    with torch.no_grad():
        passed = room.slabs.coefficients(room.trained_hz, cosine)[1][0, 0]
    torch.testing.assert_close(direct_gain(room), free * passed, rtol=0, atol=5e-3)  # the table's error
    fill(room, NOTHING)
    torch.testing.assert_close(direct_gain(room), free, rtol=0, atol=1e-6)


def test_an_empty_plane_reflects_nothing() -> None:
    room = room_of([plane((1, 0, 0), 3.0)], [(2.0, 0.4, 0.2)])
    for share, is_there in ((THICK, True), (NOTHING, False)):
        fill(room, share)
        traces = trace(room.mirrors, sequences(1, 1), room.trained_m, room.antenna)
        with torch.no_grad():
            gain = room.attenuated(traces, room.trained_hz)
        assert bool((gain[:, 1].abs() > 0.05).all()) == is_there
        assert bool((gain[:, 1].abs() < 1e-6).all()) != is_there


def test_of_more_planes_in_the_way_than_are_told_those_that_hold_most_are() -> None:
    number = MAX_CROSSINGS + 4
    room = room_of([plane((1, 0, 0), 0.5 + 0.2 * index) for index in range(number)], [(4.0, 0.4, 0.2)])
    held = np.random.default_rng(0).permutation(number)
    with torch.no_grad():
        room.presence.logits[:] = 0.0
        room.presence.logits[..., THICK] = torch.as_tensor(held, dtype=torch.float32)[:, None, None]
    room.presence.settle()
    kept = room.traced(room.trained_m).crossing.plane[0, 0]
    assert sorted(held[kept.numpy()]) == list(range(number - MAX_CROSSINGS, number))


def test_paths_of_transmitters_with_fewer_planes_in_the_way_are_padded_and_mean_the_same() -> None:
    tx_m = [(0.5, 0.4, 0.2), (4.0, 0.4, 0.2), (2.0, 0.3, 0.1)]
    room = room_of([plane((1, 0, 0), 1.0), plane((1, 0, 0), 3.0)], tx_m, max_order=2)
    fill(room, THICK)
    alone = [room.traced(one[None]) for one in room.trained_m]
    joined = Traces.joined(alone)
    with torch.no_grad():
        together = room.attenuated(room.traced(room.trained_m), room.trained_hz)
        torch.testing.assert_close(room.attenuated(joined, room.trained_hz), together)
        for index, part in enumerate(alone):
            torch.testing.assert_close(room.attenuated(part, room.trained_hz), together[index : index + 1])
        picked = room.attenuated(joined[torch.tensor([2, 0, 2])], room.trained_hz)
    torch.testing.assert_close(picked, together[[2, 0, 2]])
    assert len({part.crossing.plane.shape[-1] for part in alone}) > 1


def test_images_are_chosen_by_the_power_they_carry_however_many_are_weighed_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chosen = []
    for chunk, bound in ((10_000, None), (7, None), (7, np.inf)):
        monkeypatch.setattr(room_module, "_CHUNK", chunk)
        if bound is not None:
            monkeypatch.setattr(LearnedRoom, "_most_power", lambda self, found: torch.full((len(found),), np.inf))
        room = known_box(("iso", "V"))
        room.config = replace(room.config, max_images=12)
        room._choose()
        chosen.append({tuple(planes) for planes in room.sequence.tolist()})
    assert chosen[0] == chosen[1] == chosen[2]
    with torch.no_grad():
        found = sequences(len(SLABS), 3)
        power = room._power_of(found, room.trained_m, room.trained_hz)
    best = found[power.argsort(descending=True)[:12]].tolist()
    assert {tuple(planes) for planes in best} == chosen[0]  # the line of sight is among them


def test_no_path_carries_more_than_its_planes_could() -> None:
    generator = torch.Generator().manual_seed(0)
    room = known_box(("dipole", "V"))
    with torch.no_grad():
        room.presence.logits.copy_(3 * torch.randn(room.presence.logits.shape, generator=generator))
        room.presence.settle()
        found = sequences(len(SIDES), 3)
        assert bool((room._power_of(found, room.trained_m, room.trained_hz) <= room._most_power(found)).all())


def test_a_walls_corners_are_those_of_the_room_for_paths_beyond_it_are_none() -> None:
    tx_m = np.random.default_rng(0).uniform((0.3, 0.3, 0.3), (4.7, 3.7, 1.9), (100, 3))
    found = known_box(("iso", "V"), tx_m).findings(torch.as_tensor(ARRAY_M))
    for told in found["planes"]:
        corners_m = np.array(told["corners_m"])
        assert (corners_m > -1e-5).all()  # float32
        assert (corners_m < np.array(SIZE_M) + 1e-5).all()
        assert told["held"] == 1


@pytest.mark.parametrize(
    ("normal", "distance_m"),
    [((1, 0, 0), 0.0), ((1, 0, 0), 2.0), ((0, 0, 1), 1e-8), ((0.6, 0.8, 0), 1.0)],
    ids=["through the array", "through a transmitter", "in the array", "oblique"],
)
def test_gains_and_gradients_are_finite_wherever_a_plane_lies(normal: tuple[float, ...], distance_m: float) -> None:
    tx_m = [(2.0, 0.3, -1.0), (2.0, 0.0, 0.0), (0.0, 0.0, -1.5), (1.0, 2.0, 0.7), (1.2, 1.6, 0.0)]
    room = room_of([plane(normal, distance_m), plane((0, 0, -1), 2.0)], tx_m, max_order=3)
    traces = trace(room.mirrors, sequences(2, 3), room.trained_m, room.antenna)
    gain = room.attenuated(traces, room.trained_hz)
    gain.abs().square().sum().backward()
    assert bool(torch.isfinite(gain).all())
    assert float(gain.detach().abs().max()) <= 1 + 1e-5
    for name, parameter in room.named_parameters():
        assert bool(torch.isfinite(parameter.grad).all()), name


def test_gradients_are_those_of_differences() -> None:
    room = room_of([plane((1, 0, 0), 3.0), plane((0, 0, -1), 1.8)], [(2.0, 0.4, -0.9)], max_order=2)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        room.presence.logits.copy_(torch.randn(room.presence.logits.shape, generator=generator))
    traces = room.traced(room.trained_m)
    carrier_hz = torch.tensor([1e9, 2e9], dtype=torch.float64)
    weight = torch.randn(len(room.sequence), 2, generator=generator)

    def value() -> torch.Tensor:
        return (room.attenuated(traces, carrier_hz).sum(1).abs().square() * weight[0]).sum()

    value().backward()
    for name, parameter in room.named_parameters():
        flat, gradient = parameter.data.view(-1), parameter.grad.view(-1)
        for place in gradient.abs().topk(2).indices.tolist():
            before, step = float(flat[place]), 0.02
            values = []
            for sign in (1, -1):
                flat[place] = before + sign * step
                values.append(float(value().detach()))
            flat[place] = before
            # curvature over 0.02, and 1e-7 of float32 over it
            expected = (values[0] - values[1]) / (2 * step)
            assert float(gradient[place]) == pytest.approx(expected, rel=0.02, abs=2e-5), name
