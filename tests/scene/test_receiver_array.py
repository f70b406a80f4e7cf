"""Arrays of published data: in another plane of their frame, and turned about their pole."""

from __future__ import annotations

import json
from importlib import resources

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from xfreqbench.errors import SceneError
from xfreqbench.scene.model import ReceiverArray, parse_scene


def test_an_array_is_written_as_before_planes_and_turns_could_be_given() -> None:
    adapter = TypeAdapter(ReceiverArray)
    turned = ReceiverArray(position_m=(0.0, 0.0, 1.0), boresight=(0.0, 0.0, 1.0), orientation=(0.0, 0.0, 0.6, 0.8))
    written = json.loads(adapter.dump_json(ReceiverArray(position_m=(0.0, 0.0, 1.0))))
    assert written.keys().isdisjoint({"plane", "orientation", "name", "antenna_orientation_deg"})
    for given in (turned, ReceiverArray(position_m=(0.0, 0.0, 1.0), plane="yz")):
        assert adapter.validate_json(adapter.dump_json(given)) == given
    x_axis = [0.8**2 - 0.6**2, 2 * 0.6 * 0.8, 0]  # a turn by twice the angle of (0.8, 0.6)
    np.testing.assert_allclose(turned.rotation[:, 0], x_axis, atol=1e-12)


@pytest.mark.parametrize(
    ("orientation", "message"), [((0.0, 0.0, 0.0, 0.0), "zero quaternion"), ((1.0, 0.0, 0.0, 0.0), "turns its pole to")]
)
def test_an_orientation_agrees_with_the_boresight(orientation: tuple[float, ...], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ReceiverArray(position_m=(0.0, 0.0, 1.0), boresight=(0.0, 0.0, 1.0), orientation=orientation)


def test_rays_are_traced_to_no_upright_array() -> None:
    text = str(resources.files("xfreqbench.scenes").joinpath("empty.toml").read_text())
    with pytest.raises(SceneError, match="plane 'yz'"):
        parse_scene(text.replace("[receiver]", '[receiver]\nplane = "yz"'))


@pytest.mark.parametrize("orientation", [None, (0.0, 0.0, 0.6, 0.8)])
def test_an_array_in_another_plane_has_its_elements_where_one_in_plane_xy_has_them(
    orientation: tuple[float, float, float, float] | None,
) -> None:
    """A method may trace to it, then, though a scene file may not ask for it."""
    pole = (0.0, 0.0, 1.0) if orientation else (0.36, -0.48, -0.8)
    upright = ReceiverArray(
        position_m=(1.0, 2.0, 1.0), rows=2, cols=3, boresight=pole, plane="yz", orientation=orientation
    )
    level = upright.in_plane_xy
    assert level.plane == "xy"
    assert level.in_plane_xy == level
    np.testing.assert_allclose(level.element_position_m(0.1), upright.element_position_m(0.1), atol=1e-12)
