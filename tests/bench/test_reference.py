from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from xfreqbench.bench.reference import Reference, _write_reference, make_reference, read_reference
from xfreqbench.bench.solvers import map_errors
from xfreqbench.errors import DataError, OutputExistsError, StorageError
from xfreqbench.scene.model import load_scene
from xfreqbench.scene.prepared import PreparedScene
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import TraceSettings

pytestmark = pytest.mark.sionna


def stored(path: Path, change: Callable[[Reference], Reference] = lambda reference: reference) -> None:
    _write_reference(path, change(read_reference(load_scene("office"))))


def ignore_progress(done: int, total: int) -> None:
    pass


def about(**changes: object) -> Callable[[Reference], Reference]:
    return lambda reference: replace(reference, about={**reference.about, **changes})


def test_channels_of_a_furnished_room_reach_the_bar_against_eight_times_the_rays() -> None:
    lounge = load_scene("lounge")
    reference = read_reference(lounge)
    assert reference.about["way"] == "solver image" and reference.about["rays"] == 8 * TraceSettings().rays
    tracer = tracer_of(
        PreparedScene.of(lounge),
        reference.carrier_hz,
        TraceSettings(interactions=("specular", "refraction"), rays=100_000),
    )
    for error in map_errors(lounge, tracer.channel(reference.tx_position_m).cfr, reference.cfr):
        assert error.median_psnr_db > 50 and error.fifth_percentile_psnr_db > 40


def test_a_finished_reference_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "finished"  # without .npz, which NumPy likes to add
    stored(path)
    before = path.read_bytes()
    make_reference(load_scene("office"), path, ignore_progress)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["finished"]
    assert np.array_equal(read_reference(load_scene("office"), path).cfr, read_reference(load_scene("office")).cfr)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (about(scene_sha256="0"), "scene_sha256 is '0'"),
        (about(rays=1), "rays is 1, not"),
        (about(max_depth=1), "max_depth is 1, not"),
        (about(seed=77), "seed is 77, not"),
        (about(interactions=["specular"]), r"interactions is \['specular'\]"),
        (lambda it: replace(it, carrier_hz=it.carrier_hz * 2), "carrier_hz is"),
        (lambda it: replace(it, tx_position_m=it.tx_position_m + 0.1), "transmitters stand elsewhere"),
        (lambda it: replace(it, cfr=it.cfr[:, :, :4]), "cfr has the shape"),
    ],
)
def test_a_reference_of_something_else_is_not_gone_on_with(
    tmp_path: Path, change: Callable[[Reference], Reference], message: str
) -> None:
    path = tmp_path / "other.npz"
    stored(path, change)
    with pytest.raises(OutputExistsError, match=message):
        make_reference(load_scene("office"), path, ignore_progress)


def test_a_file_that_is_no_reference_is_called_damaged(tmp_path: Path) -> None:
    for name, content in (("text.npz", b"abc"), ("zip.npz", b"PK\x03\x04 cut off")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(DataError, match="is damaged"):
            read_reference(load_scene("office"), tmp_path / name)


def test_a_reference_that_cannot_be_written_says_where(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        stored(tmp_path / "file" / "office.npz")


def test_the_description_of_a_reference_is_plain_json(tmp_path: Path) -> None:
    stored(tmp_path / "office.npz")
    with np.load(tmp_path / "office.npz") as content:
        assert json.loads(str(content["about"]))["interactions"] == ["specular", "refraction"]
