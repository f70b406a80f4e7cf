from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.plans import plan_generation
from tests.support.synthetic import append_all, make_header, write_dataset
from xfreqbench.data.dataset import PasDataset, open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.writer import PasWriter
from xfreqbench.errors import DataError
from xfreqbench.scene.materials import P2040_EDITION
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.tracer import TraceSettings


def test_the_header_comes_back_as_it_was_written(tmp_path: Path) -> None:
    header, written = write_dataset(tmp_path / "data.h5").header, make_header()
    np.testing.assert_array_equal(header.carrier_hz, written.carrier_hz)
    assert header.attributes() == written.attributes()


def test_attributes_are_written_in_the_order_that_gives_the_same_bytes() -> None:
    expected = "schema scene_name scene_json scene_sha256 receiver_json num_tx pas_kind maps"
    json_parts = "settings_json software_json rejected_json"
    assert list(make_header().attributes()) == f"{expected} {json_parts}".split()  # channels are the default
    assert list(replace(make_header(), channels=False).attributes()) == f"{expected} {json_parts} channels".split()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("maps", "1"),
        ("channels", "null"),
        ("num_tx", "0"),
        ("num_tx", "1" * 5000),
        ("pas_kind", "powr"),
        ("receiver_json", '{"position_m": [0, 0]}'),
        ("settings_json", "[]"),
        ("settings_json", "[" * 5000),
        ("software_json", '{"numpy": 2}'),
        ("receivers_json", "3"),
        ("polarizations_json", '["VX"]'),
        ("scene_name", None),
    ],
)
def test_a_damaged_or_missing_attribute_is_named(name: str, text: str | None) -> None:
    header = make_header()
    attributes = {key: value for key, value in {**header.attributes(), name: text}.items() if value is not None}
    with pytest.raises(ValueError, match=f"header attribute '{name}'"):
        DatasetHeader.from_attributes(attributes, header.carrier_hz)


def test_a_data_set_without_channels_stores_its_maps() -> None:
    with pytest.raises(ValueError, match="without channels stores its maps"):
        replace(make_header(maps=False), channels=False)


def with_header(path: Path, **changes: object) -> PasDataset:
    header = replace(make_header(), **changes)  # type: ignore[arg-type]
    with PasWriter(path, header) as writer:
        append_all(writer, header)
    return open_dataset(path)


def test_a_generated_data_set_knows_its_scene_and_what_was_asked_of_the_rays(tmp_path: Path) -> None:
    settings = TraceSettings(interactions=("specular", "refraction"), solver="image", max_depth=2)
    plan = plan_generation(load_scene("empty"), [1e9], settings, tx=1, maps=False)
    dataset = open_dataset(generate_planned(plan, tmp_path / "data.h5"))
    assert replace(dataset.scene, folder=load_scene("empty").folder) == load_scene("empty")
    assert dataset.trace_settings == settings
    assert f"ITU-R {P2040_EDITION}," in dataset.header.references


def test_the_hash_of_a_data_set_leaves_its_references_out(tmp_path: Path) -> None:
    untold, told = (with_header(tmp_path / f"{text}.h5", references=text) for text in ("", "ITU-R P.2040-4"))
    assert told.sha256 == untold.sha256
    assert told.header.references == "ITU-R P.2040-4"
    verify(told.path)


def test_data_that_do_not_say_their_scene_are_refused_by_name(tmp_path: Path) -> None:
    dataset = with_header(tmp_path / "imported.h5", scene_json='{"name": "hall"}')
    with pytest.raises(DataError, match=r"imported\.h5 does not say which scene"):
        _ = dataset.scene


def test_data_that_do_not_say_how_they_were_traced_are_refused_by_name(tmp_path: Path) -> None:
    dataset = with_header(tmp_path / "imported.h5", settings={})
    for settings in ({}, {"max_depth": 2}, {"max_depth": "deep"}):
        told = replace(dataset, header=replace(dataset.header, settings=settings))
        with pytest.raises(DataError, match=r"imported\.h5 does not say how it was traced"):
            _ = told.trace_settings
