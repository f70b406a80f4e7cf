"""Planes of a room from its maps, against a room that the tracer made; and where `room-planes` is `room-lags`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.room_lags import RoomLags, RoomLagsConfig
from xfreqbench.baselines.room_planes.method import RoomPlanes, RoomPlanesConfig
from xfreqbench.baselines.room_planes.search import ArrayView, FoundPlane, PlaneSearch, slabs_in
from xfreqbench.baselines.room_planes.shares import HeardShares
from xfreqbench.examples.what_room_planes_miss import parts_of, true_planes

from tests.support.rooms import tiny_rooms
from xfreqbench.data.collection import Collection
from xfreqbench.data.unseen_rooms import HEARD_GHZ, room_splits
from xfreqbench.errors import DataError, MethodError
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.fitting import fit_within
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

RECEIVER = ReceiverArray(position_m=(0.0, 0.0, 2.3))
CONCRETE, GLASS, OTHER = Slab("concrete", 0.2), Slab("glass", 0.008), Slab("plasterboard", 0.03)
FLOOR = FoundPlane(np.array([0.0, 0, -1]), 2.3, CONCRETE, 1.0)
WALL = FoundPlane(np.array([1.0, 0, 0]), 1.7, GLASS, 1.0)
CARRIER_HZ = np.array([ghz_to_hz(carrier) for carrier in HEARD_GHZ])
VIEW = ArrayView(RECEIVER.element_position_wavelengths @ RECEIVER.rotation.T, ("iso", "V"))


def traced(num_tx: int) -> tuple[FloatArray, NDArray[np.complex128]]:
    """Transmitters (T, 3), seen from the array, and their channels (T, F, 16) in a room of a floor and a wall."""
    surfaces = (
        Surface("floor", "concrete", 0.2, (-30.0, -30.0, 0.0), (30.0, 30.0, 0.0)),
        Surface("wall", "glass", 0.008, (1.7, -30.0, 0.0), (1.7, 30.0, 30.0)),
    )
    settings = TraceSettings("image", WITHOUT_DIFFRACTION, max_depth=2, rays=20_000)
    tracer = ImageTracer(Scene("corner", RECEIVER, surface=surfaces), CARRIER_HZ.tolist(), settings)
    tx_m = np.random.default_rng(4).uniform((-2, -2, 0.5), (1.5, 2, 1.8), size=(num_tx, 3))
    return tx_m - np.asarray(RECEIVER.position_m), tracer.channel(tx_m).cfr


def test_reflections_by_planes_are_those_that_the_tracer_finds() -> None:
    offset_m, cfr = traced(6)
    length_m = np.linalg.norm(offset_m, axis=1)[:, None]
    wavelength_m = SPEED_OF_LIGHT_M_S / CARRIER_HZ
    direct = wavelength_m / (4 * np.pi * length_m) * np.exp(-2j * np.pi * length_m / wavelength_m)
    channels = VIEW.channels([FLOOR, WALL], offset_m, CARRIER_HZ).swapaxes(0, 1) * direct[..., None]
    error = np.linalg.norm(channels - cfr, axis=(0, 2)) / np.linalg.norm(cfr, axis=(0, 2))
    assert (error < (0.05, 5e-3, 1e-3)).all()  # planes of angles of incidence that are those at the centre


def test_planes_are_found_to_a_millimetre_with_their_slabs() -> None:
    offset_m, cfr = traced(36)
    beam = BartlettBeam(RECEIVER.element_position_wavelengths, AngularGrid.hemisphere())
    lags = LagFunctions(beam)
    sums = np.stack([lags.of_maps(beam.maps(cfr[:, column], "power")[0], "power") for column in range(3)], axis=1)
    search = PlaneSearch(VIEW, lags, offset_m, sums, [CONCRETE, GLASS, OTHER], least=0.03, max_planes=4)
    assert search.num_in_sight == 36
    found = sorted(search.planes(), key=lambda plane: plane.distance_m)
    assert [plane.slab for plane in found] == [GLASS, CONCRETE]
    for plane, true in zip(found, (WALL, FLOOR), strict=True):
        np.testing.assert_array_equal(plane.normal, true.normal)
        assert abs(plane.distance_m - true.distance_m) < 1e-3


def test_a_plane_has_a_share_where_it_is_heard_and_none_where_it_ends_or_is_false() -> None:
    random = np.random.default_rng(1)
    tx_m = random.uniform((0, 0, 1), (10, 6, 2), size=(400, 3))
    known, effect = random.normal(size=(400, 3, 24)), 0.2 * random.normal(size=(2, 400, 3, 24))
    is_seen = tx_m[:, 0] < 5  # the first plane ends; the second is none
    heard = 7.0 * (known + 0.8 * is_seen[:, None, None] * effect[0])  # maps say nothing of power
    shares = HeardShares.of(tx_m, heard, known, effect, random.uniform(1, 4, 24))
    seen, unseen = shares.at(np.array([[1.0, 3, 1.5], [9, 3, 1.5]]))
    np.testing.assert_allclose(seen, [0.8, 0], atol=0.12)
    np.testing.assert_allclose(unseen, [0, 0], atol=0.12)
    assert (shares.at(np.array([[1.0, 3, 40]])) < 1e-6).all()  # nothing is heard there


def test_shares_scale_the_field_that_planes_reflect() -> None:
    offset_m, _ = traced(3)
    none, half, whole = (VIEW.channels([WALL], offset_m, CARRIER_HZ, share) for share in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(half, (none + whole) / 2, rtol=1e-12)
    np.testing.assert_array_equal(none, VIEW.channels([], offset_m, CARRIER_HZ))


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    return tiny_rooms(tmp_path_factory.mktemp("rooms"), train=2, test=1)


@pytest.mark.usefixtures("one_thread")
def test_it_is_room_lags_where_little_is_heard_and_the_same_when_it_is_loaded(
    rooms: Collection, tmp_path: Path
) -> None:
    small = {"headings": 8, "distances": 4, "queries": 4}
    planes = RoomPlanes(RoomPlanesConfig(**small, max_planes=1, least_score=1e-3))
    methods = {"lags": RoomLags(RoomLagsConfig(**small)), "planes": planes}
    for method in methods.values():
        fit_within(method, rooms.part("train"), Budget(max_steps=1), 0)
    assert slabs_in(rooms.part("train")) == methods["planes"].slabs == [Slab("wood", 0.02)]
    methods["planes"].save(tmp_path)
    methods["loaded"] = RoomPlanes.load(tmp_path)
    for split in room_splits(rooms, "unseen-rooms"):
        (question,) = split.questions(rooms)
        asked = question.asked[np.arange(12)]
        maps = {
            name: method.adapt(question.heard, Budget()).predict(asked.tx_position_m, asked.carrier_hz)
            for name, method in methods.items()
        }
        np.testing.assert_array_equal(maps["planes"], maps["loaded"])
        assert np.array_equal(maps["planes"], maps["lags"]) == (split.num_heard < 32)
    (room,), (seed,) = rooms.part("test"), [each.seed for each in rooms.part("test").rooms]
    ((area_m2, wall),) = true_planes(room)
    assert (wall.normal == (1, 0, 0)).all() and 1.5 < wall.distance_m < 4 and wall.slab == Slab("wood", 0.02)
    parts = dict[str, float]()
    with pytest.raises(DataError, match="does not say how it was traced"):  # what comes last traces the room
        for words, value in parts_of(room, seed, planes):
            parts[words] = value
    assert (parts["large planes"], parts["their area, m²"]) == (1, area_m2) == (1, 30)
    ssim = {words: value for words, value in parts.items() if words.startswith("- ")}
    assert len({*ssim.values()}) > 3 and all(0 < value < 1 for value in ssim.values())
    assert max(ssim, key=lambda words: ssim[words]) != "- room-lags"


def test_it_refuses_to_adapt_before_it_has_learned(rooms: Collection) -> None:
    with pytest.raises(MethodError, match="knows nothing yet"):
        RoomPlanes().adapt(next(room_splits(rooms, "unseen-rooms")[0].questions(rooms)).heard, Budget())
