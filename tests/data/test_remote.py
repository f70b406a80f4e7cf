from __future__ import annotations

import pickle
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from torch.utils.data import DataLoader

import xfreqbench as xb
from tests.support.plans import small_plan
from tests.support.web import Server, served
from xfreqbench.data.collection import FILE, Room, write_collection
from xfreqbench.data.dataset import verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.errors import DataError
from xfreqbench.system import remote


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate_planned(small_plan(num_transmitters=40), tmp_path_factory.mktemp("remote") / "rooms.h5")


@pytest.fixture
def server(local: Path) -> Iterator[Server]:
    with served(local.read_bytes()) as server:
        yield server


def test_one_map_is_read_from_afar_without_the_file(server: Server, local: Path) -> None:
    afar, near = xb.open_dataset(server.url), xb.open_dataset(local)
    assert np.array_equal(afar[61].map, near[61].map) and np.array_equal(afar.cfr, near.cfr)
    assert server.num_sent < len(server.content) / 4
    assert server.url in repr(afar) and afar.recipe == near.recipe
    again = pickle.loads(pickle.dumps(afar))
    assert again.path == afar.path == pickle.loads(pickle.dumps(afar.path)) == xb.open_dataset(afar.path).path
    assert np.array_equal(again.pas(7), near.pas(7))
    verify(afar.path)


def test_workers_of_a_loader_read_from_afar(server: Server) -> None:
    loader = DataLoader(xb.to_torch(xb.open_dataset(server.url)[::8]), batch_size=5, num_workers=2)  # type: ignore[var-annotated]
    assert [batch.map.shape[0] for batch in loader] == [5, 5]


def test_what_is_read_from_afar_is_compared_with_its_hash_or_checksum(server: Server, local: Path) -> None:
    with h5py.File(local) as file:
        channels, chunk = file["cfr"].id.get_offset(), file["pas"].id.get_chunk_info(50).byte_offset

    def flip(byte: int) -> None:
        server.content = server.content[:byte] + bytes([server.content[byte] ^ 1]) + server.content[byte + 1 :]

    flip(chunk + 500)
    data = xb.open_dataset(server.url)
    assert data[5].map.max() == 1
    with pytest.raises(DataError, match="'pas' cannot be read"):
        data.pas(50)
    flip(channels + 80)
    with pytest.raises(DataError, match="'cfr' differs from its sha256"):
        xb.open_dataset(f"{server.url}?again")


def test_servers_that_fail_or_give_no_ranges_are_errors_of_ours(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)  # between remfile's tries
    data = xb.open_dataset(server.url)
    server.is_failing = True
    with pytest.raises(DataError, match=r"'pas' cannot be read"):
        data.pas(40)
    with pytest.raises(DataError, match="cannot be opened"):
        xb.open_dataset(f"{server.url}?again")
    server.is_failing, server.gives_ranges = False, False
    with pytest.raises(DataError, match=r"Download it: xfreqbench.fetch\("):
        xb.open_dataset(f"{server.url}?whole")


def test_a_collection_is_read_from_afar(
    server: Server, local: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = xb.open_dataset(local)
    told = {"name": "rooms", "family": {}, "options": {}, "carrier_hz": data.header.carrier_hz.tolist()}
    write_collection(tmp_path, [Room(1, "office", "served.h5", data.file_sha256, data.header.num_tx)], **told)
    server.others[f"/{FILE}"] = (tmp_path / FILE).read_bytes()
    rooms = xb.open_collection(server.url.removesuffix("/served.h5"))
    assert np.array_equal(rooms[0].pas(61), data.pas(61))
    assert len(pickle.loads(pickle.dumps(rooms))) == 1
    with monkeypatch.context() as patch, pytest.raises(DataError, match="bytes, more than 10"):
        patch.setattr(remote, "MOST_BYTES", 10)
        xb.open_collection(server.url.removesuffix("/served.h5"))
    server.is_failing = True
    with pytest.raises(DataError, match=r"other/collection\.json cannot be opened"):
        xb.open_collection(server.url.replace("served.h5", "other"))
