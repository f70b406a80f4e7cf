"""Data sets as folders of PNGs: what comes in goes out again, and channels are drawn as conventions say."""

from __future__ import annotations

import json
import os
import signal
import tarfile
import tempfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tests.support.damage import data_offset, flip
from tests.support.fuzzing.common import xfreqbench
from tests.support.places import PUBLISHED
from tests.support.prediction_files import killed
from tests.support.synthetic import RECEIVER, make_header, transmitters, write_dataset
from xfreqbench.data.collection import room_of, write_collection
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.exchange import shards
from xfreqbench.exchange.conventions import CONVENTIONS, Convention, convention_named
from xfreqbench.exchange.png_dataset import export_png_folder, import_png_folder
from xfreqbench.exchange.png_folder import read_png_folder
from xfreqbench.maps.bartlett import BartlettBeam
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.tables import read_table

TWO_BY_TWO = ["plane=xy", "array_rows=2", "array_cols=2", "spacing_wavelengths=0.5"]  # the synthetic receiver


def imported(folder: Path, path: Path, convention: Convention) -> PasDataset:
    import_png_folder(read_png_folder(folder, convention), path)
    return open_dataset(path)


def levels_of(folder: Path, number: int) -> np.ndarray:
    return np.asarray(Image.open(folder / "spectrum" / f"{number:05d}.png"))


def write_random_folder(
    folder: Path, seed: int, num_tx: int, num_carriers: int, quaternion: tuple[float, ...]
) -> dict[tuple[tuple[float, ...], float], np.ndarray]:
    """Maps of noise by position and carrier, some dark, some black, their samples in any order."""
    random = np.random.default_rng(seed)
    position_m = [tuple(each) for each in random.normal(0, 10, size=(num_tx, 3)).tolist()]
    carrier_ghz = (random.choice(10**7, num_carriers, replace=False) / 1e5 + 0.3).tolist()
    samples = [(position, carrier) for position in position_m for carrier in carrier_ghz]
    random.shuffle(samples)
    samples = [(tuple(position), float(carrier)) for position, carrier in samples]
    (folder / "spectrum").mkdir(parents=True)
    maps = {}
    for number, sample in enumerate(samples, start=1):
        maps[sample] = random.integers(0, random.choice([1, 2, 40, 255, 256]), size=(5, 7), dtype=np.uint8)
        Image.fromarray(maps[sample]).save(folder / "spectrum" / f"{number:05d}.png")
    rows = [",".join(map(repr, position)) for position, _ in samples]
    (folder / "tx_pos.csv").write_text("\n".join(["x,y,z", *rows]))
    (folder / "freq.txt").write_text("\n".join(repr(carrier) for _, carrier in samples))
    (folder / "gateway_info.yml").write_text(
        f"gateway1:\n  position: {random.normal(size=3).tolist()}\n  orientation: {list(quaternion)}\n"
    )
    return maps


COMPONENT = st.floats(-1, 1).filter(lambda component: abs(component) > 0.01)


@pytest.mark.parametrize("name", CONVENTIONS)
@settings(max_examples=6)  # of 10–50 files each
@given(
    seed=st.integers(0, 2**32 - 1),
    num_tx=st.integers(1, 3),
    num_carriers=st.integers(1, 3),
    quaternion=st.one_of(st.just((0.0, 0.0, 0.0, 1.0)), st.tuples(COMPONENT, COMPONENT, COMPONENT, COMPONENT)),
)
def test_what_was_imported_is_exported_without_loss(
    name: str, seed: int, num_tx: int, num_carriers: int, quaternion: tuple[float, ...]
) -> None:
    convention = CONVENTIONS[name]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        maps = write_random_folder(path / "first", seed, num_tx, num_carriers, quaternion)
        first = imported(path / "first", path / "first.h5", convention)
        export_png_folder(path / "first.h5", path / "second", convention)
        second = imported(path / "second", path / "second.h5", convention)
        source = read_png_folder(path / "second", convention)
        for (transmitter, carrier), number in np.ndenumerate(source.sample):
            sample = tuple(source.tx_position_m[transmitter].tolist()), source.carrier_hz[carrier]
            published = next(each for (place, ghz), each in maps.items() if (place, float(round(ghz * 1e9))) == sample)
            np.testing.assert_array_equal(levels_of(path / "second", number), published)
        np.testing.assert_array_equal(second.tx_position_m, first.tx_position_m)
        np.testing.assert_array_equal(second.carrier_hz, first.carrier_hz)
        np.testing.assert_array_equal(second.pas(), first.pas())
        np.testing.assert_array_equal(
            second.tables["peak_power"].flat[second.rows], first.tables["peak_power"].flat[first.rows]
        )
        assert second.header.receiver == first.header.receiver


def test_the_published_example_comes_back_byte_for_byte(tmp_path: Path) -> None:
    if not PUBLISHED.is_dir():
        pytest.skip(f"the published example is not at {PUBLISHED}")
    convention = CONVENTIONS["wideband3dgs"]
    imported(PUBLISHED, tmp_path / "example1.h5", convention)
    export_png_folder(tmp_path / "example1.h5", tmp_path / "out", convention)
    published = sorted((PUBLISHED / "spectrum").iterdir())
    exported = sorted((tmp_path / "out" / "spectrum").iterdir())
    for path, ours in zip(published, exported, strict=True):
        assert (ours.name, ours.read_bytes()) == (path.name, path.read_bytes())
    assert (tmp_path / "out" / "freq.txt").read_text().split() == (PUBLISHED / "freq.txt").read_text().split()
    tables = [read_table(folder / "tx_pos.csv").position_m() for folder in (PUBLISHED, tmp_path / "out")]
    np.testing.assert_array_equal(*tables)


def literal_maps(dataset: PasDataset, convention: Convention) -> np.ndarray:
    """|a(d)ᴴh| of every channel at every pixel of the convention's, in float64."""
    degrees = np.linspace(convention.first_row_deg, convention.last_row_deg, convention.num_rows)
    elevation = np.radians(90 - degrees if convention.rows == "polar" else degrees)[:, None]
    azimuth = np.radians(np.linspace(convention.first_column_deg, convention.last_column_deg, convention.num_columns))
    axes = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    looks = np.stack(np.broadcast_arrays(*axes), -1)
    steering = np.exp(2j * np.pi * looks @ RECEIVER.element_position_wavelengths.T)
    cfr = dataset.cfr.astype(complex)
    if convention.values == "phase-only-amplitude":
        cfr = np.exp(1j * np.angle(cfr))
    beam = abs(np.einsum("eam,nm->nea", steering.conj(), cfr))
    if convention.values == "power":
        beam = beam**2
    if convention.darkest == "minimum":
        beam -= beam.min(axis=(1, 2), keepdims=True)
    return beam / beam.max(axis=(1, 2), keepdims=True)


@pytest.mark.parametrize(
    ("name", "changes"),
    [("wideband3dgs", []), ("wideband3dgs", ["values=power", "num_rows=45"]), ("xfreq-gs", []), ("nerf2", [])],
)
def test_channels_are_drawn_on_the_convention_s_own_grid_to_half_a_level(
    tmp_path: Path, name: str, changes: list[str]
) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=3, carriers_ghz=(1.0, 10.0))
    convention = convention_named(name, [*TWO_BY_TWO, *changes])
    export_png_folder(dataset.path, tmp_path / "out", convention)
    expected = literal_maps(dataset, convention)
    for row in range(len(dataset)):
        transmitter, carrier = divmod(row, 2)
        found = levels_of(tmp_path / "out", carrier * 3 + transmitter + 1) / 255
        np.testing.assert_allclose(found, expected[row], atol=0.5 / 255 + 2e-5)  # float32 phases and sums


@pytest.mark.parametrize("name", CONVENTIONS)
def test_a_generated_data_set_is_read_again_where_it_was(tmp_path: Path, name: str) -> None:
    dataset = write_dataset(tmp_path / "data.h5", num_tx=2, maps=False, silent=((1, 0),))
    convention = convention_named(name, TWO_BY_TWO)
    export_png_folder(dataset.path, tmp_path / "out", convention)
    again = imported(tmp_path / "out", tmp_path / "again.h5", convention)
    np.testing.assert_array_equal(again.tx_position_m, dataset.tx_position_m)
    np.testing.assert_array_equal(again.carrier_hz, dataset.carrier_hz)
    np.testing.assert_array_equal(again.has_path, dataset.has_path)
    np.testing.assert_allclose(again.header.receiver.rotation, RECEIVER.rotation, atol=1e-12)
    assert again.header.receiver.position_m == RECEIVER.position_m
    np.testing.assert_array_equal(again.beam.element_position_wavelengths, dataset.beam.element_position_wavelengths)


def test_an_array_that_the_layout_cannot_tell_has_to_be_stated(tmp_path: Path) -> None:
    path = write_dataset(tmp_path / "data.h5").path
    with pytest.raises(DataError, match="--set plane=xy --set array_rows=2 --set array_cols=2, here"):
        export_png_folder(path, tmp_path / "out", CONVENTIONS["wideband3dgs"])
    assert not (tmp_path / "out").exists()


def maps_alone(folder: Path) -> Path:
    write_random_folder(folder / "first", 1, 2, 2, (0.0, 0.0, 0.0, 1.0))
    return imported(folder / "first", folder / "first.h5", CONVENTIONS["wideband3dgs"]).path


def test_a_folder_that_tells_how_it_was_drawn_is_not_read_otherwise(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data.h5", num_tx=2)
    drawn = convention_named("wideband3dgs", ["plane=xy", "array_rows=2", "array_cols=2"])
    export_png_folder(tmp_path / "data.h5", tmp_path / "out", drawn)
    assert read_png_folder(tmp_path / "out", drawn).receiver.plane == "xy"
    with pytest.raises(
        DataError, match=r"gateway_info\.yml says .* in plane, array_rows.* Give --set plane=xy --set array_rows=2"
    ):
        read_png_folder(tmp_path / "out", CONVENTIONS["wideband3dgs"])


def test_a_small_number_that_a_folder_tells_is_that_number(tmp_path: Path) -> None:
    """JSON writes 1e-05, which YAML takes for a text."""
    write_dataset(tmp_path / "data.h5", num_tx=2)
    drawn = convention_named("wideband3dgs", ["plane=xy", "array_rows=2", "array_cols=2", "first_row_deg=1e-5"])
    export_png_folder(tmp_path / "data.h5", tmp_path / "out", drawn)
    assert read_png_folder(tmp_path / "out", drawn).convention == drawn


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["values=power"], "values are amplitude; .* cannot be drawn as power"),
        (["darkest=minimum"], "darkest are zero; .* cannot be drawn as minimum"),
        (["first_row_deg=1"], "elevations from 0 to 90 degrees; .* from 0 to 89"),
        (["first_column_deg=0"], "azimuths from -180 to 180 degrees; .* from 0 to 180"),
    ],
)
def test_maps_alone_are_not_drawn_anew(tmp_path: Path, changes: list[str], message: str) -> None:
    path = maps_alone(tmp_path)
    with pytest.raises(DataError, match=message):
        export_png_folder(path, tmp_path / "out", convention_named("wideband3dgs", changes))


def test_two_transmitters_at_one_place_are_refused(tmp_path: Path) -> None:
    header = replace(make_header(num_tx=2), carrier_hz=np.array([1e9]))
    with PasWriter(tmp_path / "data.h5", header) as writer:
        beam = BartlettBeam(header.receiver.element_position_wavelengths, AngularGrid.hemisphere())
        samples = SampleBlock.of_channels(np.ones((2, 1, 4), complex), np.ones((2, 1), int), beam, "power")
        writer.append(transmitters(1).repeat(2, axis=0), np.ones(2, bool), samples)
    with pytest.raises(DataError, match="two transmitters at one position"):
        export_png_folder(tmp_path / "data.h5", tmp_path / "out", convention_named("wideband3dgs", TWO_BY_TWO))


def test_a_damaged_data_set_is_not_exported(tmp_path: Path) -> None:
    path = maps_alone(tmp_path)
    flip(path, data_offset(path, "pas"))
    with pytest.raises(DataError, match="damaged"):
        export_png_folder(path, tmp_path / "out", CONVENTIONS["wideband3dgs"])
    assert not (tmp_path / "out").exists()


def test_nothing_is_written_over(tmp_path: Path) -> None:
    path = maps_alone(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for output in ("mine", "file"):
        with pytest.raises(OutputExistsError, match="not an empty folder"):
            export_png_folder(path, tmp_path / output, CONVENTIONS["wideband3dgs"])
    assert [entry.name for entry in (tmp_path / "mine").iterdir()] == ["notes.txt"]
    assert (tmp_path / "file").read_text() == "mine"


def test_a_killed_export_leaves_no_folder_that_looks_whole_and_the_next_one_clears_up(tmp_path: Path) -> None:
    path, output, convention = maps_alone(tmp_path), tmp_path / "out", CONVENTIONS["wideband3dgs"]
    output.mkdir()  # an empty folder may be filled
    killed(lambda: export_png_folder(path, output, convention, lambda *_: os.kill(os.getpid(), signal.SIGKILL)))
    assert not list(output.iterdir())
    assert [entry.name for entry in tmp_path.iterdir() if entry.name.endswith(".partial")]
    export_png_folder(path, output, convention)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["first", "first.h5", "out"]
    assert len(list((output / "spectrum").iterdir())) == 4


def test_one_carrier_is_told_where_no_file_tells_it(tmp_path: Path) -> None:
    write_random_folder(tmp_path / "one", 2, 3, 1, (0.0, 0.0, 0.0, 1.0))
    with pytest.raises(DataError, match=r"freq\.txt gives the carriers"):
        read_png_folder(tmp_path / "one", CONVENTIONS["nerf2"], carrier_ghz=0.915)
    (tmp_path / "one" / "freq.txt").unlink()
    source = read_png_folder(tmp_path / "one", CONVENTIONS["nerf2"], carrier_ghz=0.915)
    np.testing.assert_array_equal(source.carrier_hz, [915e6])
    for wrong in (float("nan"), -1.0, 1e30):
        with pytest.raises(DataError, match=r"--freq is .*carrier in GHz"):
            read_png_folder(tmp_path / "one", CONVENTIONS["nerf2"], carrier_ghz=wrong)


def test_index_files_are_checked_by_the_publisher_s_numbering(tmp_path: Path) -> None:
    write_random_folder(tmp_path / "small", 3, 3, 2, (0.0, 0.0, 0.0, 1.0))
    index = tmp_path / "small" / "train_index.txt"
    index.write_text("0\n5\n")
    assert read_png_folder(tmp_path / "small", CONVENTIONS["gsrf"]).ignored == ["train_index.txt"]
    for name, text, told in (
        ("gsrf", "0\n6\n", "line 2, is '6'; 6 samples are numbered 0 to 5"),
        ("nerf2", "0\n1\n", "line 1, is '0'; 6 samples are numbered 1 to 6"),
    ):
        index.write_text(text)
        with pytest.raises(DataError, match=rf"train_index\.txt, {told}"):
            read_png_folder(tmp_path / "small", CONVENTIONS[name])


def test_the_commands_bring_a_folder_in_and_out(tmp_path: Path) -> None:
    write_random_folder(tmp_path / "first", 4, 2, 1, (0.1, 0.2, 0.3, 0.9))
    (tmp_path / "first" / "freq.txt").unlink()
    stated = ["--convention", "nerf2", "--set", "index=zero-based"]
    export = ["export", tmp_path / "data.h5", "-o", tmp_path / "out", *stated]
    brought_in = xfreqbench("import", tmp_path / "first", "-o", tmp_path / "data.h5", *stated, "--freq", "0.915")
    assert "wrote" in brought_in.stdout
    assert "(2 maps)" in xfreqbench(*export).stdout
    again = xfreqbench(*export)
    assert again.code == 2 and "not an empty folder" in again.stderr
    table = xfreqbench("import", "--conventions").stdout
    assert all(name in table for name in [*CONVENTIONS, "spacing_wavelengths"])
    np.testing.assert_array_equal(levels_of(tmp_path / "out", 2), levels_of(tmp_path / "first", 2))
    assert (tmp_path / "out" / "freq.txt").read_text() == "0.915\n0.915\n"


@pytest.mark.parametrize("of_rooms", [False, True])
@pytest.mark.parametrize("to", ["webdataset", "datasets"])
def test_shards_hold_every_map_for_whoever_has_not_this_toolkit(to, of_rooms, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(shards, "MAPS_A_SHARD", 4)
    if of_rooms:
        names = ["000/0.h5", "000/1.h5", "000/2.h5"]
        written = [write_dataset(tmp_path / "rooms" / name, num_tx=tx, maps=False) for tx, name in enumerate(names, 1)]
        rooms = [room_of(tmp_path / "rooms", name, seed, "hall" if seed else "flat") for seed, name in enumerate(names)]
        told = {"family": {}, "options": {}, "carrier_hz": written[0].header.carrier_hz.tolist()}
        write_collection(tmp_path / "rooms", rooms, name="ours", held_out_types=["hall"], **told)
        splits = {"train": written[:1], "other_type": written[1:]}
    else:
        splits = {"train": [write_dataset(tmp_path / "rooms", num_tx=3)]}
    done = []
    total = shards.export_shards(tmp_path / "rooms", tmp_path / "shards", to, lambda *told: done.append(told))
    assert done[-1] == (total, total) and total == sum(len(data) for split in splits.values() for data in split)
    told = (tmp_path / "shards/README.md").read_text()
    for split, datasets in splits.items():
        files = sorted((tmp_path / "shards").glob(f"{split}-*"))
        assert len(files) == -(-sum(map(len, datasets)) // 4)
        assert f"- split: {split}\n    path: {split}-*{files[0].suffix}\n" in told
        read_back = _read_tars(files) if to == "webdataset" else _read_parquet(files)
        maps = np.concatenate([data.pas() for data in datasets])
        np.testing.assert_allclose(np.reshape(read_back["map"], maps.shape), maps, atol=2**-11)  # half precision
        expected = {name: [getattr(data, name) for data in datasets] for name in ("tx_position_m", "carrier_hz")}
        expected["peak_power"] = [data.tables["peak_power"].flat[data.rows] for data in datasets]
        for name, parts in expected.items():
            assert np.array_equal(read_back[name], np.concatenate(parts))
        cfr = np.array(read_back["cfr_real"]) + 1j * np.array(read_back["cfr_imag"])
        assert np.array_equal(cfr, np.concatenate([data.cfr for data in datasets]))
        if of_rooms:
            seeds = [written.index(data) for data in datasets for _ in range(len(data))]
            assert read_back["room"] == seeds
            receivers = [data.header.receiver for data in datasets for _ in range(len(data))]
            assert np.array_equal(read_back["rx_position_m"], [each.position_m for each in receivers])
            assert np.array_equal(read_back["frame_rotation"], [each.rotation.ravel() for each in receivers])


def _read_tars(files):
    members = {}
    for file in files:
        with tarfile.open(file) as tar:
            members |= {member.name: tar.extractfile(member).read() for member in tar}
    keys = sorted({name.partition(".")[0] for name in members})
    samples = [json.loads(members[f"{key}.json"]) for key in keys]
    maps = [np.load(BytesIO(members[f"{key}.map.npy"])) for key in keys]
    return {"map": maps} | {name: [sample[name] for sample in samples] for name in samples[0]}


def _read_parquet(files):
    return pyarrow.concat_tables(map(pyarrow.parquet.read_table, files)).to_pydict()
