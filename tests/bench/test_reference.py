from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from xfreqbench.bench.reference import Reference, _write_reference, make_reference, read_reference
from xfreqbench.bench.solvers import map_errors
from xfreqbench.errors import OutputExistsError
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import TraceSettings
from xfreqbench.types import ignore_progress

pytestmark = pytest.mark.sionna


def stored(path: Path, change: Callable[[Reference], Reference] = lambda reference: reference) -> None:
    _write_reference(path, change(read_reference(load_scene("office"))))


def about(**changes: object) -> Callable[[Reference], Reference]:
    return lambda reference: replace(reference, about={**reference.about, **changes})


def test_channels_of_a_furnished_room_reach_the_bar_against_eight_times_the_rays() -> None:
    lounge = load_scene("lounge")
    reference = read_reference(lounge)
    assert reference.about["way"] == "solver image" and reference.about["rays"] == 8 * TraceSettings().rays
    settings = TraceSettings(interactions=("specular", "refraction"), rays=100_000)
    tracer = tracer_of(lounge, reference.carrier_hz, settings)
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
        (about(rays=1, interactions=["specular"]), r"rays is 1, not .*interactions is \['specular'\]"),
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
