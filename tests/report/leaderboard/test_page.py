from __future__ import annotations

import csv
import json
import re
from base64 import b64decode
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pooch
import pyarrow.parquet
import pytest
from PIL import Image

import xfreqbench as xb
from tests.support.page_results import HOSTILE, METHODS, SPLITS, store_results, stored
from tests.support.stored_records import external, make_record
from tests.support.web import served
from xfreqbench.data.dataset import open_dataset
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.metrics import ssim
from xfreqbench.report.drawing.figures import map_png
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.results import VERSIONS, results_at
from xfreqbench.report.leaderboard.rows import median_ssim
from xfreqbench.runs.records import append

CONTENT = re.compile(r'<script type="application/json" id="content">(.*?)</script>', re.DOTALL)


class Tables(HTMLParser):
    """Every table's rows by their first header cell, each a dict from column to (text, sorted value).

    The first table is the overview.
    """

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tables: list[list[list[tuple[str, str | None]]]] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self._cell: str | None = None
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self._cell, self._value = "", dict(attributes).get("data-value")
        elif tag == "small" and self._cell:
            self._cell += "|"

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.tables[-1][-1].append((self._cell, self._value))
            self._cell = None

    def handle_data(self, data):
        if self._cell is not None:
            self._cell += data

    def rows(self, table: int = 1) -> dict[str, dict[str, tuple[str, str | None]]]:
        head, *rows = self.tables[table]
        names = [text for text, _ in head]
        return {row[0][0].partition("|")[0].strip(): dict(zip(names, row, strict=True)) for row in rows}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return store_results(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module")
def html(results: Path) -> str:
    return write_page(results, results.parent / "page.html").read_text()


def test_pictures_are_found_in_whichever_folder_they_are(results: Path, html: str, tmp_path: Path) -> None:
    (tmp_path / "records.jsonl").write_bytes((results / "records.jsonl").read_bytes())
    assert write_page([tmp_path, results], tmp_path / "page.html").read_text() == html
    assert write_page(tmp_path, tmp_path / "without.html").read_text() != html


def content_of(html: str):
    return json.loads(CONTENT.search(html).group(1))


def test_the_table_without_a_script_holds_the_numbers_of_the_records(html: str, results: Path) -> None:
    rows = Tables(html).rows()
    board = next(board for board in boards(stored(results)) if board.protocol == "lofo")
    for row in board.rows:
        cells = rows[row.label]
        for split in SPLITS:
            assert float(cells[split.partition("-")[2]][1]) == row.value(split, median_ssim)
        assert float(cells["average"][1]) == row.average(SPLITS, median_ssim)
        assert float(cells["fit s"][1]) == row.average(SPLITS, lambda record: record.fit_seconds)
        assert cells["average"][0].startswith(f"{row.average(SPLITS, median_ssim):.4f}")
        assert cells["seeds"][0] == str(len(row.by_split[SPLITS[0]]))


def test_the_best_trivial_row_is_marked_and_no_other(html: str, results: Path) -> None:
    board = next(board for board in boards(stored(results)) if board.protocol == "lofo")
    best = max((row for row in board.rows if row.is_trivial), key=lambda row: row.average(SPLITS, median_ssim))
    marked = [a["data-label"] for tag, a in Tables(html).tags if tag == "tr" and a.get("class") == "best-trivial"]
    assert marked[0] == best.label
    assert len(marked) == 2  # one a table


def test_a_learned_method_of_one_seed_has_no_rank(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        _append(tmp_path, "thrice", seed)
    _append(tmp_path, "once", 0)
    rows = Tables(write_page(tmp_path, tmp_path / "page.html").read_text()).rows()
    assert rows["once"]["rank"] == ("–", "")
    assert rows["thrice"]["rank"] == ("1", "1.0001")


def _append(folder: Path, method: str, seed: int) -> None:
    record = make_record(method, id=f"{method}-{seed}", ssim_by_tx=[[0.9], [0.8], [0.7]])
    job = record.job.__class__(**{**vars(record.job), "seed": seed})
    append(folder / "records.jsonl", record.model_copy(update={"job": job}))


def test_a_hostile_method_name_is_text_and_ends_no_script(html: str) -> None:
    assert HOSTILE not in html and "<img src=x" not in html
    assert Tables(html).rows()[HOSTILE]["seeds"][0] == "3"
    assert HOSTILE in content_of(html)["boards"][0]["rows"]
    assert [tag for tag, _ in Tables(html).tags].count("script") == 2


def test_the_page_loads_nothing(html: str) -> None:
    assert set(re.findall(r"https?://[^\"'\s<)]+", html)) == {"http://www.w3.org/2000/svg"}  # a namespace
    sources = [a[key] for _, a in Tables(html).tags for key in ("src", "href") if a.get(key)]
    assert sources and all(source.startswith("#board=") for source in sources)
    assert "default-src 'none'" in html and "@import" not in html and "url(" not in html


def test_papers_and_programs_of_others_are_linked_and_not_loaded(tmp_path: Path) -> None:
    for method in ("gsrf", "nearest"):
        append(tmp_path / "records.jsonl", make_record(method))
    parsed = Tables(write_page(tmp_path, tmp_path / "page.html").read_text("utf-8"))
    addressed = [(tag, value) for tag, told in parsed.tags for value in told.values() if "://" in str(value)]
    assert {tag for tag, _ in addressed} == {"a"}
    assert ("a", "https://github.com/nesl/GSRF") in addressed


def test_the_tables_stand_beside_the_page_for_any_reader(html: str, results: Path) -> None:
    path = results.parent / "page.csv"
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    frame = pyarrow.parquet.read_table(path.with_suffix(".parquet")).to_pylist()
    shown = Tables(html).rows()
    of_board = {row["method"]: row for row in rows if row["protocol"] == "lofo"}
    assert {name: float(row["SSIM"]) for name, row in of_board.items()} == {
        name: float(cells["average"][1]) for name, cells in shown.items()
    }
    assert [row["method"] for row in frame] == [row["method"] for row in rows]
    assert frame[0]["SSIM"] == float(rows[0]["SSIM"]) and frame[0]["splits"] == " ".join(SPLITS)
    assert all("tested transmitters" in row["trained on"] for row in of_board.values())
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(OutputExistsError, match=r"page\.csv"):
        write_page(results, results.parent / "page.html")


def test_a_board_is_at_an_address_or_a_frozen_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    append(tmp_path / "records.jsonl", make_record("theirs"))
    with served((tmp_path / "records.jsonl").read_bytes()) as server:
        assert "theirs" in str(xb.leaderboard(server.url))
        append(tmp_path / "records.jsonl", make_record("later"))
        server.content = (tmp_path / "records.jsonl").read_bytes()
        assert "later" in str(xb.leaderboard(server.url))  # a board grows: it is asked for anew
    frozen = results_at("v1")
    assert frozen.name == "v1.jsonl" and results_at(tmp_path / "v1") == tmp_path / "v1"
    (tmp_path / VERSIONS).write_text(f"v1.jsonl {pooch.file_hash(frozen)}")
    (tmp_path / "v1.jsonl").write_text("")
    monkeypatch.setattr("xfreqbench.report.leaderboard.results.files", lambda package: tmp_path)
    with pytest.raises(DataError, match="not the frozen version 'v1'"):
        results_at("v1")


def test_the_same_records_give_the_same_bytes(html: str, results: Path, tmp_path: Path) -> None:
    assert write_page(results, tmp_path / "other.html").read_text() == html


def test_what_is_not_finite_is_null_and_sorts_as_infinity(tmp_path: Path) -> None:
    perfect = make_record("perfect", 0.9)
    infinite = perfect.scores["psnr"].model_copy(update={"median": np.inf, "quantiles": [np.inf] * 101})
    scores = perfect.scores | {"psnr": infinite}
    append(tmp_path / "records.jsonl", perfect.model_copy(update={"scores": scores}))
    html = write_page(tmp_path, tmp_path / "page.html").read_text()
    assert Tables(html).rows()["perfect"]["PSNR (dB)"] == ("∞", "inf")
    assert content_of(html)["boards"][0]["rows"]["perfect"]["splits"]["lofo-24.25GHz"]["cdf"]["psnr"] == [None] * 101


def test_the_gallery_shows_the_samples_that_the_scores_choose(html: str, results: Path) -> None:
    gallery = content_of(html)["boards"][0]["gallery"]
    assert gallery["split"] == "24.25GHz"
    assert set(gallery["cases"]) == set(METHODS)
    record = next(r for r in stored(results) if (r.job.method, r.job.split) == ("nearest", "lofo-24.25GHz"))
    scores = sorted((score for each in record.ssim_by_tx for score in each), reverse=True)
    shown = {case["place"]: case["ssim"] for case in gallery["cases"]["nearest"]}
    expected = {"best": scores[0], "median": scores[len(scores) // 2], "worst": scores[-1]}
    assert shown == pytest.approx(expected, abs=1e-4)  # both are rounded to four decimals


def test_pictures_show_the_maps_that_were_scored(html: str, results: Path) -> None:
    gallery = content_of(html)["boards"][0]["gallery"]
    truth, predicted = (picture_of(gallery, name) for name in ("truth", "predicted"))
    dataset = open_dataset(results.parent / "data.h5")
    case = gallery["cases"]["nearest"][0]
    row = np.flatnonzero(
        (np.abs(dataset.tx_position_m - case["tx_position_m"]).max(axis=1) < 0.01) & (dataset.carrier_hz == 24.25e9)
    )
    level = 1 + np.log10(np.maximum(dataset.pas(row)[0], 1e-3)) / 3
    shown = level[::-1][::4, ::4]
    assert np.abs(truth - shown).max() < 0.6 / 63 + 0.6 / 255  # half a step of the palette, and of the levels
    assert ssim(predicted[None], truth[None], AngularGrid.hemisphere(*shown.shape))[0] < 1


def picture_of(gallery, name: str) -> np.ndarray:
    png = b64decode(gallery["pictures"][gallery["cases"]["nearest"][0][name]])
    return np.asarray(Image.open(BytesIO(png)), dtype=np.float32) / 63


def test_a_picture_is_small_and_a_palette_of_its_colours() -> None:
    azimuth, elevation = np.meshgrid(np.linspace(0, 4 * np.pi, 180), np.linspace(0, np.pi, 45))
    png = map_png(np.float32(0.5 + 0.5 * np.sin(azimuth) * np.sin(elevation)), "magma")
    picture = Image.open(BytesIO(png))
    assert picture.mode == "P" and picture.size == (180, 45)
    assert len(png) < 12_000
    assert {len(map_png(np.full((4, 4), value, np.float32), "magma")) for value in (-1.0, 0.0)} == {
        len(map_png(np.zeros((4, 4), np.float32), "magma"))
    }


def test_a_page_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds no records"):
        write_page(tmp_path, tmp_path / "page.html")


def test_an_external_row_is_a_family_of_its_own_whose_unknown_costs_are_no_numbers(tmp_path: Path) -> None:
    address = {"external": {"sha256": "b" * 64, "url": "https://a.org/<b>"}}
    for record in (make_record(), external("lofo-24.25GHz", **address)):
        append(tmp_path / "records.jsonl", record)
    html = write_page(tmp_path, tmp_path / "page.html").read_text()
    families = {a["data-label"]: a["data-family"] for tag, a in Tables(html).tags if tag == "tr" and "data-label" in a}
    assert families == {"nearest": "trivial", "theirs (external)": "external"}
    assert Tables(html).rows()["theirs (external)"]["fit s"] == ("–", "")
    standing = content_of(html)["boards"][0]["sets"][0]["rows"]["theirs (external)"]
    assert [standing[cost] for cost in ("seconds", "milliseconds", "parameters")] == [None] * 3
    assert "theirs (external): https://a.org/&lt;b&gt;." in html
