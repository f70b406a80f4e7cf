from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.prediction_files import SPLITS, noisy_maps
from tests.support.synthetic import write_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, UnknownNameError, XFreqBenchError
from xfreqbench.exchange import prediction_file as external_file
from xfreqbench.exchange.score_file import score_file
from xfreqbench.runs.predictions import fault_of_maps


def spoil_maps(path: Path, values) -> None:
    with h5py.File(path, "r+") as file:
        del file["lofo-77GHz/pas"]
        file["lofo-77GHz/pas"] = values


def one_value(value: float):
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            file["lofo-77GHz/pas"][3, 20, 7] = value

    return spoil


def attribute(name: str, value):
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            if value is None:
                del file["lofo-77GHz"].attrs[name]
            else:
                file["lofo-77GHz"].attrs[name] = value

    return spoil


def maps(make):
    return lambda path: spoil_maps(path, make(noisy_maps(None, range(5))))


def edited(edit):
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            edit(file)

    return spoil


def link_elsewhere(path: Path) -> None:
    other = path.with_name("other.h5")
    other.write_bytes(path.read_bytes())
    with h5py.File(path, "r+") as file:
        del file["lofo-77GHz/pas"]
        file["lofo-77GHz/pas"] = h5py.ExternalLink("other.h5", "lofo-77GHz/pas")


def virtual(path: Path) -> None:
    other = path.with_name("other.h5")
    other.write_bytes(path.read_bytes())
    layout = h5py.VirtualLayout((5, 90, 360), "f4")
    layout[...] = h5py.VirtualSource(other, "lofo-77GHz/pas", (5, 90, 360))
    with h5py.File(path, "r+") as file:
        del file["lofo-77GHz/pas"]
        file["lofo-77GHz"].create_virtual_dataset("pas", layout)


def replace_pas_with_group(file) -> None:
    del file["lofo-77GHz/pas"]
    file.create_group("lofo-77GHz/pas")


REFUSED = {
    "text": (lambda path: path.write_text("pas"), "not HDF5"),
    "cut": (lambda path: path.write_bytes(path.read_bytes()[:5000]), "not written to its end"),
    "absent": (lambda path: path.unlink(), "There is no file"),
    "empty": (edited(lambda file: [file.pop(name) for name in SPLITS]), "is empty"),
    "group": (edited(lambda file: file.move("lofo-77GHz", "lofo-77")), r"Did you mean 'lofo-77GHz'"),
    "no group": (edited(lambda file: file.create_dataset("lofo-37GHz", data=[1])), "is no group"),
    "soft link": (edited(lambda file: file.update({"lofo-37GHz": h5py.SoftLink("/lofo-77GHz")})), "is no group"),
    "root too": (edited(lambda file: file.create_dataset("pas", data=[1])), "at its root and group"),
    "no maps": (edited(lambda file: file.move("lofo-77GHz/pas", "lofo-77GHz/PAS")), "it holds PAS"),
    "maps a group": (edited(replace_pas_with_group), "'pas' is a group"),
    "link": (link_elsewhere, "link to data elsewhere"),
    "virtual": (virtual, "link to data elsewhere"),
    "backwards": (maps(lambda each: each.T), r"\(360, 90, 5\).*permute\(pas, \[3 2 1\]\)"),
    "rows": (maps(lambda each: each[:4]), r"shape \(4, 90, 360\), but 5 test rows need \(5, 90, 360\)"),
    "scalar": (maps(lambda each: 1.0), r"shape \(\)"),
    "complex": (maps(lambda each: each.astype(complex)), "real numbers"),
    "texts": (maps(lambda each: np.full(each.shape, b"1")), "real numbers"),
    "bool": (maps(lambda each: each > 0.5), "real numbers"),
    "bytes": (maps(lambda each: (255 * each).astype(np.uint8)), r"map 0 .* at \[0, 0\]; maps are finite"),
    "nan": (one_value(np.nan), r"map 3 \(row 3\d\) has nan at \[20, 7\]"),
    "infinite": (one_value(np.inf), r"map 3 \(row \d+\) has inf at \[20, 7\]"),
    "negative": (one_value(-0.5), r"map 3 \(row \d+\) has -0\.5 at \[20, 7\]"),
    "absolute power": (maps(lambda each: each * 1e-7), r"map 0 \(row \d+\) has its peak at 1e-07\. Divide"),
    "peak": (maps(lambda each: each / 2), r"map 0 \(row \d+\) has its peak at 0\.5\. Divide"),
    "split": (attribute("split_sha256", "0" * 64), "is not that of lofo-77GHz of data.h5 under version 1"),
    "no split": (attribute("split_sha256", None), "'split_sha256': it is missing. Copy it"),
    "data": (attribute("dataset_sha256", "0" * 64), "made for the data set with sha256 000"),
    "no method": (attribute("method", None), "'method': it is missing.*--method"),
    "two lines": (attribute("method", "mine\nyours"), "'method': .*one line"),
    "nobody": (attribute("method", " "), "'method'"),
    "time": (attribute("fit_seconds", -1.0), "'fit_seconds': .*greater than or equal to 0"),
    "endless": (attribute("predict_ms_per_map", np.inf), "'predict_ms_per_map': .*finite"),
    "half": (attribute("parameters", 1.5), "'parameters': .*integer"),
    "several": (attribute("seed", [1, 2]), "'seed': .*integer"),
    "script": (attribute("url", "javascript:alert(1)"), "'url': .*https://"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_with_a_fault_is_refused_in_words_before_anything_is_scored(
    dataset: PasDataset, predictions: Path, tmp_path: Path, case: str
) -> None:
    spoil, words = REFUSED[case]
    spoil(predictions)
    with pytest.raises((DataError, UnknownNameError), match=words):
        score_file(predictions, dataset.path, tmp_path / "results")
    assert not list(tmp_path.glob("results/**/*.*"))


def test_predictions_for_another_data_set_are_refused(dataset: PasDataset, predictions: Path, tmp_path: Path) -> None:
    other = write_dataset(tmp_path / "other.h5", 5, (2.4, 24.25, 77.0), maps=False)
    with pytest.raises(DataError, match="made for the data set with sha256"):
        score_file(predictions, other.path, tmp_path / "results")


def test_rounding_at_both_ends_of_the_range_is_allowed(dataset: PasDataset, predictions: Path, tmp_path: Path) -> None:
    with h5py.File(predictions, "r+") as file:
        file["lofo-77GHz/pas"][3, 20, 7:9] = -5e-5, 1.00005  # of a division in single precision
    assert len(score_file(predictions, dataset.path, tmp_path / "results").records) == 3


TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))
VALUES = st.one_of(TEXT, st.binary(min_size=1), st.floats(), st.integers(-(2**63), 2**63 - 1), st.lists(st.floats()))


@settings(max_examples=40, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(list(external_file.Declaration.model_fields)), value=VALUES)
def test_whatever_an_attribute_holds_it_is_read_or_refused_in_words(
    dataset: PasDataset, noise: Path, tmp_path: Path, name: str, value
) -> None:
    path = tmp_path / "predictions.h5"
    path.write_bytes(noise.read_bytes())
    attribute(name, np.bytes_(value) if isinstance(value, bytes) else value)(path)
    try:
        parts = external_file.read_parts(path, dataset)
    except XFreqBenchError:
        return
    assert [part.split.name for part in parts] == SPLITS


@settings(max_examples=40, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(st.floats(width=32), min_size=1, max_size=20), kind=st.sampled_from(["<f4", "<f8"]))
def test_maps_are_accepted_where_every_value_is_and_never_otherwise(values: list[float], kind: str) -> None:
    part = np.ones((1, 1, len(values) + 1), kind)
    part[0, 0, 1:] = values
    is_allowed = all(-1e-4 <= value <= 1.0001 for value in np.asarray(values, kind).tolist())
    assert (fault_of_maps(part) is None) == is_allowed
