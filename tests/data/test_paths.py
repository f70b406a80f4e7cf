"""Paths in a data set: what was traced, whole after a kill, refused where they are damaged or not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.support.fuzzing.common import fuzz
from tests.support.fuzzing.hdf5 import hdf5_files, spoilt_file
from tests.support.plans import CARRIERS_HZ, SETTINGS, small_plan, unfinished
from tests.support.sionna_scenes import moved
from xfreqbench.data.batches import BatchStore
from xfreqbench.data.dataset import PasDataset, isolated, open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.paths import SamplePaths
from xfreqbench.data.plan import Plan
from xfreqbench.data.retrace import require_origin
from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.scene.materials import Scattering, SceneMaterial
from xfreqbench.scene.meshes import surface_meshes
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import Channel, TraceSettings

NUM_TX = 20  # two batches


def plan_with_paths(**changes: object) -> Plan:
    return small_plan(**{"num_transmitters": NUM_TX, "maps": False, "paths": True, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module", params=["image", "far", pytest.param("sionna", marks=pytest.mark.sionna)])
def stored(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> PasDataset:
    solver = "image" if request.param == "far" else request.param
    offset_m = (691608.25, 5334762.5, 519.0) if request.param == "far" else (0.0, 0.0, 0.0)
    scene = moved(load_scene("two_rooms"), offset_m)
    plan = plan_with_paths(scene=scene, num_transmitters=4, settings=replace(SETTINGS, solver=solver))
    return open_dataset(generate_planned(plan, tmp_path_factory.mktemp("paths") / "rooms.h5"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate_planned(plan_with_paths(), tmp_path_factory.mktemp("whole") / "rooms.h5")


def test_the_paths_of_a_sample_are_those_that_were_traced(stored: PasDataset) -> None:
    verify(stored.path)
    tracer = tracer_of(stored.scene, CARRIERS_HZ, stored.trace_settings)
    names = tuple(mesh.name for mesh in surface_meshes(stored.scene))
    for sample in (0, 7, 7):
        tx, carrier = divmod(sample, 2)
        traced, paths = tracer.paths(stored.tx_position_m[sample]), stored.paths(sample)
        depth = paths.interactions.shape[1]
        assert len(paths) == len(traced.delay_s) == np.diff(stored.tables["paths/offset"])[tx]
        assert paths.carrier_hz == CARRIERS_HZ[carrier]
        assert paths.surface_names == names
        np.testing.assert_array_equal(paths.delay_s, traced.delay_s)
        np.testing.assert_allclose(paths.gain, traced.gain[carrier], rtol=1e-6)  # complex64, float32
        np.testing.assert_allclose(paths.arrival, traced.arrival, atol=1e-6)
        leaving = traced.departure(stored.tx_position_m[sample], np.asarray(stored.scene.receiver.position_m))
        np.testing.assert_allclose(paths.departure, leaving, atol=1e-6)
        np.testing.assert_array_equal(paths.interactions, traced.interactions[:, :depth])
        np.testing.assert_array_equal(paths.surfaces, traced.surfaces[:, :depth])
        np.testing.assert_allclose(paths.vertices_m, traced.vertices_m[:, :depth], atol=1e-6)


def test_samples_are_counted_as_elsewhere(stored: PasDataset) -> None:
    last = stored.paths(-1)
    np.testing.assert_array_equal(last.gain, stored.paths(7).gain)
    np.testing.assert_array_equal(stored[[5, 3]].paths(1).gain, stored.paths(3).gain)
    assert repr(last) == f"SamplePaths({len(last)} paths at 24.25 GHz)"
    with pytest.raises(IndexError, match="There are samples 0 to 7, but 8 is asked for"):
        stored.paths(8)


def test_a_method_is_not_shown_paths_which_tell_of_other_carriers(stored: PasDataset) -> None:
    with pytest.raises(DataError, match=r"rooms\.h5 is given to methods without its paths"):
        isolated(stored[[0, 2]]).paths(0)


def test_without_paths_a_file_is_what_it_was(tmp_path: Path, whole: Path) -> None:
    plan = plan_with_paths(paths=False)
    assert "paths" not in plan.header.attributes()
    path = generate_planned(plan, tmp_path / "rooms.h5")
    with h5py.File(path) as plain, h5py.File(whole) as full:
        assert set(full) - set(plain) == {"paths"}
        gain = full["paths/gain"]
        assert (gain.compression, gain.shuffle, gain.fletcher32) == ("gzip", True, True)
        for name in plain:
            np.testing.assert_array_equal(plain[name][...], full[name][...])
            assert plain[name].attrs["sha256"] == full[name].attrs["sha256"]
    with pytest.raises(DataError, match=r"rooms\.h5 holds no paths. Generate it with --paths"):
        open_dataset(path).paths(0)


def test_a_generation_that_goes_on_ends_in_the_same_bytes(tmp_path: Path, whole: Path) -> None:
    path = tmp_path / "rooms.h5"
    first, _ = sorted(unfinished(plan_with_paths(), path).glob("*.npz"))
    first.unlink()
    assert generate_planned(plan_with_paths(), path).read_bytes() == whole.read_bytes()


def test_other_paths_than_the_scenes_are_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = BatchStore.read

    def later(store: BatchStore, index: int) -> Channel:
        channel = read(store, index)
        assert channel.paths is not None
        return replace(channel, paths=replace(channel.paths, delay_s=channel.paths.delay_s + 1e-12))

    monkeypatch.setattr(BatchStore, "read", later)
    with pytest.raises(DataError, match="does not hold what its header says"):
        generate_planned(plan_with_paths(num_transmitters=4), tmp_path / "rooms.h5")
    monkeypatch.undo()
    path = generate_planned(plan_with_paths(num_transmitters=4), tmp_path / "rooms.h5")
    assert require_origin(open_dataset(path), np.arange(8)).difference < 1e-5


def test_diffuse_paths_are_refused_before_anything_is_traced() -> None:
    rough = replace(load_scene("two_rooms"), material=(SceneMaterial("concrete", scattering=Scattering(0.3)),))
    settings = TraceSettings("sionna", ("specular", "diffuse"), rays=1000)
    with pytest.raises(XFreqBenchError, match="Leave out --paths, --solver sionna, or"):
        plan_with_paths(scene=rough, settings=settings)


@pytest.mark.parametrize(
    ("name", "spoil", "told"),
    [
        ("offset", lambda values: values[::-1], "offsets that do not ascend"),
        ("offset", lambda values: values + 1, "offsets that do not ascend"),
        ("offset", lambda values: values[:-1], "asks for"),
        ("gain", lambda values: values[:, :1], "asks for"),
        ("gain", lambda values: values * np.nan, "not finite"),
        ("interaction_offset", lambda values: values[::-1], "offsets that do not ascend"),
        ("interaction_offset", lambda values: values + 10**9, "offsets that do not ascend"),
        ("surface", lambda values: values + 1000, "surfaces that do not exist"),
        ("interaction", lambda values: values + 2, "codes of unknown interactions"),
    ],
)
def test_nonsense_is_refused_by_name(
    tmp_path: Path, whole: Path, name: str, spoil: Callable[[np.ndarray], np.ndarray], told: str
) -> None:
    def change(file: h5py.File) -> None:
        values, kept = file[f"paths/{name}"][...], dict(file[f"paths/{name}"].attrs)
        del file[f"paths/{name}"]
        file[f"paths/{name}"] = spoil(values).astype(values.dtype)
        for key in ("units", "long_name"):
            file[f"paths/{name}"].attrs[key] = kept[key]

    (tmp_path / "wrong.h5").write_bytes(spoilt_file(whole.read_bytes(), change, is_sealed_again=True))
    with pytest.raises(DataError, match=told):
        open_dataset(tmp_path / "wrong.h5").paths(0)


def test_no_damage_ends_in_anything_but_a_refusal(tmp_path: Path, whole: Path) -> None:
    path = tmp_path / "damaged.h5"

    def read(content: bytes | Callable[[], bytes]) -> None:
        path.write_bytes(content() if callable(content) else content)
        try:
            dataset = open_dataset(path)
            if dataset.header.paths:
                assert isinstance(dataset.paths(3), SamplePaths)
            verify(path)
        except DataError as error:
            assert "damaged.h5" in str(error)
        except IndexError:  # there are fewer samples
            assert len(dataset) <= 3

    fuzz(40, hdf5_files(whole.read_bytes()), read)
