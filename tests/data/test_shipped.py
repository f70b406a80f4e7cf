from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pooch
import pytest

import xfreqbench as xb
from tests.support.web import Server, served
from xfreqbench.data import shipped
from xfreqbench.data.dataset import verify
from xfreqbench.data.fingerprint import compare_fingerprint
from xfreqbench.data.options import GenerateOptions
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.recipe import Recipe
from xfreqbench.errors import DataError, UnknownNameError
from xfreqbench.scene.toml_files import shipped_folder

OFFICE = shipped_folder() / "office.h5"


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("time.sleep", lambda _: None)  # between two tries
    with served(OFFICE.read_bytes()) as server:
        yield server


def test_the_office_ships_as_it_would_be_traced_now() -> None:
    """If not: `xfreqbench generate office --no-maps -o scenes/office.h5`, and its sha256 into scenes/registry.txt."""
    data = xb.load("office")
    assert data.path == OFFICE.resolve() and shipped.registered()["office"].sha256 == pooch.file_hash(OFFICE)
    plan = plan_generation("office", GenerateOptions(maps=False))
    asked = Recipe.of_scene(plan.tracing.scene, plan.tracing.settings, plan.header, plan.tx_position_m, data.grid)
    assert data.recipe == asked
    match = compare_fingerprint(data)
    assert match.difference is not None and match.difference <= match.tolerance
    assert data.pas(7).max() == 1


def test_one_room_ships_as_two_programs_trace_it() -> None:
    """If not: `docs/sionna.md` has the two commands; their sha256 are in scenes/registry.txt."""
    sionna, image = (xb.load(f"office_cluttered_{solver}") for solver in ("sionna", "image"))
    for solver, data in (("sionna", sionna), ("image", image)):
        assert data.trace_settings.solver == solver
        assert shipped.registered()[f"office_cluttered_{solver}"].sha256 == pooch.file_hash(data.path)
    assert "diffuse" in sionna.trace_settings.named_interactions
    assert (sionna.tx_position_m == image.tx_position_m).all() and (sionna.carrier_hz == image.carrier_hz).all()
    assert (sionna.cfr != image.cfr).any()


@pytest.mark.parametrize(
    ("call", "name", "error", "words"),
    [
        (xb.load, "offcie", UnknownNameError, "no data set 'offcie'. Did you mean 'office'"),
        (xb.load, "lounge", DataError, "generate lounge --no-maps -o lounge.h5"),
        (xb.load, "data/office.h5", DataError, r"open_dataset\('data/office.h5'\)"),
        (xb.fetch, "nowhere", UnknownNameError, "https"),
    ],
)
def test_a_name_that_does_not_ship_says_what_does(
    call: Callable[[str], object], name: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        call(name)


def test_a_download_goes_on_where_it_broke_off_and_is_kept(server: Server, tmp_path: Path) -> None:
    server.breaks_after = 600_000
    fetched = xb.fetch(server.url, hashlib.sha256(server.content).hexdigest())
    assert server.asked[0] == "" and int(server.asked[1].strip("bytes=-")) > 500_000
    assert fetched.path.read_bytes() == server.content and fetched.path.is_relative_to(tmp_path / "xfreqbench")
    assert xb.fetch(server.url).sha256 == fetched.sha256 and len(server.asked) == 2
    assert [path.name for path in fetched.path.parent.iterdir()] == [fetched.path.name]


def test_what_is_fetched_afresh_does_not_go_on_from_the_old(server: Server) -> None:
    path = shipped.fetch_file(server.url, verify)
    path.with_name(f".{path.name}.partial").write_bytes(b"an older file")
    assert shipped.fetch_file(server.url, verify, fresh=True).read_bytes() == server.content


def test_a_flipped_byte_is_refused_and_not_kept(server: Server, tmp_path: Path) -> None:
    known = hashlib.sha256(server.content).hexdigest()
    server.content = server.content[:900_000] + bytes([server.content[900_000] ^ 1]) + server.content[900_001:]
    for sha256, told in ((known, "not the expected file"), (None, "differs from its sha256")):
        with pytest.raises(DataError, match=told):
            xb.fetch(server.url, sha256)
        assert not list((tmp_path / "xfreqbench").iterdir())


def test_what_is_registered_is_fetched_by_its_name_and_then_loaded(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = f"hall.h5 {hashlib.sha256(server.content).hexdigest()} {server.url}"
    (tmp_path / "registry.txt").write_text(line)
    monkeypatch.setattr(shipped, "shipped_folder", lambda: tmp_path)
    with pytest.raises(DataError, match=r"fetch\('hall'\)"):
        xb.load("hall")
    fetched = xb.fetch("hall")
    server.content = b""  # nothing more is asked of it
    assert xb.load("hall").path == fetched.path == xb.fetch("hall").path


def test_an_address_where_nothing_answers_is_an_error_of_ours(server: Server) -> None:
    with pytest.raises(DataError, match=r"cannot be downloaded.*continues from where"):
        xb.fetch("http://127.0.0.1:9/office.h5")
