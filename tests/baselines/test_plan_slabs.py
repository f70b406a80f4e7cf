"""`plan-slabs`: slabs of a room whose plan is told are found in its maps; their coefficients are the tracer's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.heard_paths import HeardPaths, slab_coefficients
from xfreqbench.baselines.plan_slabs import PlanSlabs
from xfreqbench.baselines.plan_tracer import PlanTracer

import xfreqbench as xb
from xfreqbench.data.collection import Collection, room_of, write_collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import Question
from xfreqbench.data.unseen_rooms import ASKED_GHZ, HEARD_GHZ, room_question
from xfreqbench.errors import MethodError
from xfreqbench.maps.metrics import ssim
from xfreqbench.methods.contract import Budget
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import Layer, LayeredMaterial, complex_permittivity
from xfreqbench.scene.model import ReceiverArray, Scene, Surface
from xfreqbench.tracing.image.kernels.slabs import stack_coefficients
from xfreqbench.units import SPEED_OF_LIGHT_M_S

CARRIERS_GHZ = sorted({*HEARD_GHZ, *ASKED_GHZ})
TRUE_GLASS_M = 0.0097
GLAZING = LayeredMaterial("glazing", (Layer("glass", 0.004), Layer("vacuum", 0.016), Layer("metal", 2.5e-8)))


def room(
    path: Path, size_m: tuple[float, float, float], walls: tuple[str, float], floor: tuple[str, float]
) -> PasDataset:
    """A traced box with a cabinet, of 24 transmitters."""
    x, y, z = size_m
    corners = [(0.0, 0.0), (x, 0.0), (x, y), (0.0, y)]
    surfaces = [
        Surface("floor", *floor, vertices_m=tuple((*corner, 0.0) for corner in corners)),
        Surface("ceiling", *floor, vertices_m=tuple((*corner, z) for corner in corners[::-1])),
        Surface("cabinet 1 box", "metal", 0.001, (0.1, 0.1, 0.02), (0.6, 1.1, 1.4)),
    ]
    for number, ((ax, ay), (bx, by)) in enumerate(zip(corners, corners[1:] + corners[:1], strict=True)):
        at = (ax, ay, 0.0), (bx, by, 0.0), (bx, by, z), (ax, ay, z)
        surfaces.append(Surface(f"wall {number}.1 wall", *walls, vertices_m=at))
    scene = Scene(path.stem, ReceiverArray((x / 2, y / 2, z - 0.3)), surface=tuple(surfaces))
    tx_m = np.random.default_rng(1).uniform((0.8, 0.3, 0.4), (x - 0.3, y - 0.3, 1.8), size=(24, 3))
    asked = {"interactions": ["specular", "refraction"], "rays": 5_000, "max_depth": 2, "maps": False}
    return xb.generate(scene, path, freqs_ghz=CARRIERS_GHZ, tx_positions=tx_m, progress="off", **asked)


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Collection:
    """Two rooms to learn from, and one whose walls are of glass as thick as in neither."""
    folder = tmp_path_factory.mktemp("rooms")
    room(folder / "a.h5", (5.0, 4.0, 2.6), ("concrete", 0.2), ("wood", 0.03))
    room(folder / "b.h5", (6.0, 3.5, 2.8), ("glass", 0.008), ("concrete", 0.2))
    room(folder / "c.h5", (4.5, 4.5, 2.7), ("glass", 0.012), ("concrete", 0.2))
    room(folder / "d.h5", (5.5, 3.8, 2.5), ("glass", TRUE_GLASS_M), ("wood", 0.03))
    listed = [room_of(folder, f"{name}.h5", seed, "box") for seed, name in enumerate("abcd")]
    hz = [ghz * 1e9 for ghz in CARRIERS_GHZ]
    return write_collection(folder, listed, carrier_hz=hz, name="boxes", family={}, options={}, held_out_types=[])


@pytest.fixture(scope="module")
def learned(rooms: Collection) -> PlanSlabs:
    method = PlanSlabs()
    list(method.fit(rooms[:3], Budget(), 0))
    return method


def scored(method: PlanTracer, question: Question) -> float:
    asked = question.asked
    maps = method.adapt(question.heard, Budget()).predict(asked.tx_position_m, asked.carrier_hz)
    return float(np.median(ssim(maps, asked.pas(), asked.grid)))


def test_coefficients_of_layers_are_those_of_the_tracer_from_both_sides() -> None:
    carrier_hz, slope = np.array([1e9, 6e10]), np.array([-1.0, -0.3, 0.3, 0.9])
    for material in (GLAZING, LayeredMaterial("pane", GLAZING.layers[:1])):
        found = np.concatenate(slab_coefficients(Slab(material, material.thickness_m), carrier_hz, slope), axis=1)
        for row, value in enumerate(slope.tolist()):
            layers = material.layers if value < 0 else material.layers[::-1]
            for column, hz in enumerate(carrier_hz.tolist()):
                eta = np.array([complex_permittivity(layer.material, hz) for layer in layers])
                phase = np.array([2 * np.pi * hz / SPEED_OF_LIGHT_M_S * layer.thickness_m for layer in layers])
                expected = stack_coefficients(abs(value), eta, phase)
                np.testing.assert_allclose(found[row, :, column], expected, atol=1e-9)


def test_the_true_slabs_explain_what_is_heard_and_others_do_not(rooms: Collection) -> None:
    heard = room_question(rooms[3], 3, 4, plan_told=True).heard
    slabs = [mesh.slab for mesh in Geometry.of(rooms[3].scene).meshes]
    number = np.arange(len(slabs))
    paths = HeardPaths(heard, Geometry.of(heard.scene), number, slabs)
    for group in number.tolist():
        paths.improve(group, [slabs[group]._replace(thickness_m=1.3 * slabs[group].thickness_m)])
    assert paths.slabs[3:] == slabs[3:] and paths.slabs[0] == slabs[0]


def test_glass_walls_are_found_as_thick_as_they_are(rooms: Collection, learned: PlanSlabs) -> None:
    question = room_question(rooms[3], 3, 4, plan_told=True)
    (_, _, cabinet, *walls) = learned.adapt(question.heard, Budget()).geometry.meshes
    assert cabinet.slab == Slab("metal", 0.001)
    assert {wall.material for wall in walls} == {"glass"} and len({wall.slab for wall in walls}) == 1
    assert walls[0].thickness_m == pytest.approx(TRUE_GLASS_M, abs=1.5e-4)
    assert scored(learned, question) > 0.98
    assert scored(PlanTracer(), question) < 0.95


def test_where_nothing_is_heard_slabs_are_the_usual_ones(rooms: Collection, learned: PlanSlabs, tmp_path: Path) -> None:
    question = room_question(rooms[3], 3, 0, plan_told=True)
    floor, *_, wall = learned.adapt(question.heard, Budget()).geometry.meshes
    assert (floor.slab, wall.slab) == (Slab("concrete", 0.2), Slab("glass", 0.01))
    learned.save(tmp_path)
    loaded = PlanSlabs.load(tmp_path)
    for number in (0, 4):
        question = room_question(rooms[3], 3, number, plan_told=True)
        assert scored(loaded, question) == scored(learned, question)
    assert loaded.num_parameters == learned.num_parameters > 0


def test_without_a_plan_or_anything_learned_it_refuses(rooms: Collection, learned: PlanSlabs) -> None:
    with pytest.raises(MethodError, match="The plan is not told"):
        learned.adapt(room_question(rooms[3], 3, 0).heard, Budget())
    with pytest.raises(MethodError, match="fit or load it first"):
        PlanSlabs().adapt(room_question(rooms[3], 3, 0, plan_told=True).heard, Budget())
