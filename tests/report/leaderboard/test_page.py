from __future__ import annotations

import csv
import gzip
import json
import re
from base64 import b64decode
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pooch
import pyarrow.parquet
import pytest
from PIL import Image

import xfreqbench as xb
from tests.support.leaderboard_records import make_bench
from tests.support.page_results import HOSTILE, METHODS, SPLITS, stored
from tests.support.stored_records import make_record, store
from tests.support.web import served
from xfreqbench.data.dataset import open_dataset
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.report.drawing.figures import map_png
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.results import VERSIONS, results_at

CONTENT = re.compile(r'<script type="application/json" id="content">(.*?)</script>', re.DOTALL)


class Page(HTMLParser):
    """The tags of a page with their attributes, and what its cells are sorted by, by the first cell of their rows."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.values: dict[str, list[str]] = {}
        self.feed(html)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        told = dict(attributes)
        self.tags.append((tag, told))
        if "data-label" in told:
            self._row = self.values.setdefault(told["data-label"] or "", [])
        elif "data-value" in told:
            self._row.append(told["data-value"] or "nan")


def content_of(html: str) -> Any:
    return json.loads(CONTENT.search(html)[1])  # type: ignore[index]


@pytest.fixture
def html(file: Path) -> str:
    return file.read_text("utf-8")


def test_pictures_are_found_in_whichever_folder_they_are(results: Path, html: str, tmp_path: Path) -> None:
    (tmp_path / "records.jsonl").write_bytes((results / "records.jsonl").read_bytes())
    assert write_page([tmp_path, results], tmp_path / "page.html").read_text() == html
    assert write_page(tmp_path, tmp_path / "without.html").read_text() != html


def test_the_table_without_a_script_holds_the_numbers_of_the_records(html: str, results: Path) -> None:
    page = Page(html)
    board = next(board for board in boards(stored(results)) if board.protocol == "lofo")
    for row in board.rows:
        _, average, skill, *by_split = map(float, page.values[row.label][: 3 + len(SPLITS)])
        assert by_split == [row.average([split]) for split in SPLITS]
        assert average == row.average(SPLITS)
        assert np.isnan(skill)  # two of the trivial predictors were not run
    best = max((row for row in board.rows if row.is_trivial), key=lambda row: row.average(SPLITS))
    marked = [told["data-label"] for tag, told in page.tags if tag == "tr" and told.get("class") == "best-trivial"]
    assert marked[0] == best.label and len(marked) == 2  # one a table


def test_the_leaderboard_comes_first_and_one_board_has_no_overview(html: str, tmp_path: Path) -> None:
    marks = ['<table class="leaderboard">', 'id="overview"', 'id="charts"', 'id="facts"']
    places = [html.index(mark) for mark in marks]
    assert places == sorted(places)
    alone = write_page(store(tmp_path, make_record("ours"), make_record("nearest")), tmp_path / "page.html")
    assert 'id="overview"' not in alone.read_text("utf-8")


def test_a_hostile_method_name_is_text_and_ends_no_script(html: str) -> None:
    page = Page(html)
    assert HOSTILE not in html and "<img src=x" not in html
    assert HOSTILE in page.values and HOSTILE in content_of(html)["boards"][0]["rows"]
    assert [tag for tag, _ in page.tags].count("script") == 2


def test_the_page_loads_nothing_and_links_the_papers_of_others(html: str, tmp_path: Path) -> None:
    assert set(re.findall(r"https?://[^\"'\s<)]+", html)) == {"http://www.w3.org/2000/svg"}  # a namespace
    sources = [told[key] for _, told in Page(html).tags for key in ("src", "href") if told.get(key)]
    assert sources and all(str(source).startswith("#board=") for source in sources)
    assert "default-src 'none'" in html and "@import" not in html and "url(" not in html
    page = Page(write_page(store(tmp_path, make_record("gsrf")), tmp_path / "page.html").read_text("utf-8"))
    addressed = {(tag, value) for tag, told in page.tags for value in told.values() if "://" in str(value)}
    assert {tag for tag, _ in addressed} == {"a"} and ("a", "https://github.com/nesl/GSRF") in addressed


def test_the_tables_stand_beside_the_page_for_any_reader(file: Path, tmp_path: Path) -> None:
    path = file.with_suffix(".csv")
    rows = list(csv.DictReader(path.read_text("utf-8").splitlines()))
    frame = pyarrow.parquet.read_table(path.with_suffix(".parquet")).to_pylist()
    shown = Page(file.read_text("utf-8")).values
    assert {row["method"]: row["SSIM"] for row in rows if row["protocol"] == "lofo"}.items() <= {
        (name, values[1]) for name, values in shown.items()
    }
    assert [(row["method"], row["SSIM"]) for row in frame] == [(row["method"], float(row["SSIM"])) for row in rows]
    assert all("tested transmitters" in row["trained on"] for row in rows if row["protocol"] == "lofo")
    (tmp_path / "page.csv").write_text("mine", "utf-8")
    with pytest.raises(OutputExistsError, match=r"page\.csv"):
        write_page(store(tmp_path, make_record("nearest")), tmp_path / "page.html")


def test_a_board_is_at_an_address_or_a_frozen_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    store(tmp_path, make_record("theirs"))
    with served((tmp_path / "records.jsonl").read_bytes()) as server:
        assert "theirs" in str(xb.leaderboard(server.url))
        store(tmp_path, make_record("later"))
        server.content = (tmp_path / "records.jsonl").read_bytes()
        assert "later" in str(xb.leaderboard(server.url))  # a board grows: it is asked for anew
    frozen = results_at("v2")
    assert frozen.name == "v2.parquet" and results_at(tmp_path / "v2") == tmp_path / "v2"
    (tmp_path / VERSIONS).write_text(f"v2.parquet {pooch.file_hash(frozen)}")
    (tmp_path / "v2.parquet").write_text("")
    monkeypatch.setattr("xfreqbench.report.leaderboard.results.files", lambda package: tmp_path)
    with pytest.raises(DataError, match="not the frozen version 'v2'"):
        results_at("v2")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (bytes(2_000_000), r"holds more than 1 MB\. Download it yourself"),
        (bytes(2000), "is no file of records"),
        (b"", "holds no records"),
    ],
    ids=["too much", "no records", "nothing"],
)
def test_what_an_address_gives_is_bounded_and_goes_when_it_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes, told: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("xfreqbench.report.leaderboard.results.MOST_BYTES", 1_000_000)
    with served(gzip.compress(content)) as server:
        server.encoding = "gzip"
        with pytest.raises(DataError, match=told):
            results_at(server.url)
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def test_what_is_not_finite_is_null_and_sorts_as_infinity(tmp_path: Path) -> None:
    perfect = make_record("perfect", 0.9)
    infinite = perfect.scores["psnr"].model_copy(update={"median": np.inf, "quantiles": [np.inf] * 101})
    store(tmp_path, perfect.model_copy(update={"scores": perfect.scores | {"psnr": infinite}}))
    html = write_page(tmp_path, tmp_path / "page.html").read_text()
    assert "inf" in Page(html).values["perfect"]
    assert content_of(html)["boards"][0]["rows"]["perfect"]["splits"]["lofo-24.25GHz"]["cdf"]["psnr"] == [None] * 101


def test_the_gallery_shows_the_best_and_the_worst_map_that_were_scored(html: str, results: Path) -> None:
    gallery = content_of(html)["boards"][0]["gallery"]
    assert gallery["split"] == "24.25GHz" and set(gallery["cases"]) == set(METHODS)
    record = next(r for r in stored(results) if (r.job.method, r.job.split) == ("nearest", "lofo-24.25GHz"))
    scores = sorted((score for each in record.ssim_by_tx for score in each), reverse=True)
    best, *_ = cases = gallery["cases"]["nearest"]
    expected = {"best": scores[0], "median": scores[len(scores) // 2], "worst": scores[-1]}
    assert {case["place"]: case["ssim"] for case in cases} == pytest.approx(expected, abs=1e-4)  # both are rounded
    pictures = [Image.open(BytesIO(b64decode(gallery["pictures"][best[name]]))) for name in ("truth", "predicted")]
    truth, predicted = (np.asarray(picture, dtype=np.float32) / 63 for picture in pictures)
    dataset = open_dataset(results.parent / "data.h5")
    is_best = np.abs(dataset.tx_position_m - best["tx_position_m"]).max(axis=1) < 0.01
    row = np.flatnonzero(is_best & (dataset.carrier_hz == 24.25e9))
    shown = (1 + np.log10(np.maximum(dataset.pas(row)[0], 1e-3)) / 3)[::-1][::4, ::4]
    assert np.abs(truth - shown).max() < 0.6 / 63 + 0.6 / 255  # half a step of the palette, and of the levels
    assert ssim(predicted[None], truth[None], AngularGrid.hemisphere(*shown.shape))[0] < 1


def test_a_picture_is_small_and_a_palette_of_its_colours() -> None:
    azimuth, elevation = np.meshgrid(np.linspace(0, 4 * np.pi, 180), np.linspace(0, np.pi, 45))
    png = map_png(np.float32(0.5 + 0.5 * np.sin(azimuth) * np.sin(elevation)), "magma")
    picture = Image.open(BytesIO(png))
    assert picture.mode == "P" and picture.size == (180, 45)
    assert len(png) < 12_000
    assert map_png(np.full((4, 4), -1, np.float32), "magma") == map_png(np.zeros((4, 4), np.float32), "magma")


def test_a_page_of_measurements_alone_is_refused(tmp_path: Path) -> None:
    store(tmp_path, make_bench())
    with pytest.raises(DataError, match="no runs in known rooms"):
        write_page(tmp_path, tmp_path / "page.html")
