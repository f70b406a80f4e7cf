"""Maps of a dozen samples in a file beside the records: they are those of the predictions, and shown in their place."""

from __future__ import annotations

import fcntl
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import xfreqbench as xb
from tests.support.leaderboard_records import with_job
from tests.support.page_results import METHODS
from tests.support.stored_records import store
from tests.support.synthetic import paper_dataset
from xfreqbench.cli.main import app
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.maps import NUM_SHOWN, gallery, read_maps
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.paper import ship_maps
from xfreqbench.report.leaderboard.report import write_report
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import RunRecord, append
from xfreqbench.runs.sealed import SEAL

TARGETS_GHZ = (2.4, 24.25, 77.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=14)


@pytest.fixture(scope="module")
def results(dataset: PasDataset) -> Path:
    """Two trivial predictors at three carriers; the maps of one of them stand for those of the paper's method too."""
    folder = dataset.path.parent / "results"
    for record in xb.run(dataset, METHODS, results=folder, targets_ghz=TARGETS_GHZ):
        if record.job.method == "nearest":
            told = with_job(record, method="xfreq-gs")
            papers = told.model_copy(update={"id": f"x{record.id}", "config": {}})
            stored = ResultsFolder(folder)
            stored.predictions_path(papers.id).write_bytes(stored.predictions_path(record.id).read_bytes())
            stored.append(papers)
    return folder


@pytest.fixture(scope="module")
def shipped(results: Path) -> Path:
    """Records that know of no data set that is there, and the file of maps beside them."""
    path = results.parent / "shipped" / "reference.jsonl"
    path.parent.mkdir()
    for record in ResultsFolder(results).records:
        append(path, with_job(record, dataset="elsewhere.h5"))
    ship_maps(results, path.with_name("reference_maps.jsonl"))
    return path


def gallery_of(page: Path) -> dict:
    content = page.read_text("utf-8").partition(' id="content">')[2].partition("</script>")[0]
    return json.loads(content)["boards"][0]["gallery"]


def test_the_page_shows_the_same_maps_without_predictions_and_data(
    results: Path, shipped: Path, tmp_path: Path
) -> None:
    whole, apart = (gallery_of(write_page(each, tmp_path / f"{each.stem}.html")) for each in (results, shipped))
    assert whole == apart
    assert {label.split()[0] for label in apart["cases"]} == {*METHODS, "xfreq-gs"} and not apart["missing"]
    for cases in apart["cases"].values():
        assert [case["place"] for case in cases] == ["best", "median", "worst"]
        scores = [case["ssim"] for case in cases]
        assert scores == sorted(scores, reverse=True)


def test_a_dozen_samples_are_shipped_with_the_levels_and_scores_of_what_was_stored(
    dataset: PasDataset, results: Path, shipped: Path
) -> None:
    folder = ResultsFolder(results)
    maps = read_maps(shipped.with_name("reference_maps.jsonl"))
    by_trivial: list[np.ndarray] = []
    for record in folder.records:
        if record.job.split != "lofo-24.25GHz":
            continue
        shown = maps[record.id]
        assert len(shown.tx_position_m) == NUM_SHOWN and set(shown.carrier_hz) == {24.25e9}
        at = np.argmin(
            np.linalg.norm(dataset.tx_position_m[:, None] - np.asarray(shown.tx_position_m), axis=2)
            + 1e3 * (dataset.carrier_hz != 24.25e9)[:, None],
            axis=0,
        )
        predictions = folder.predictions(record)
        for levels, power in (
            (shown.levels(record.id), predictions.maps_of(at, 32)),
            (shown.levels(), dataset.pas(at)),
        ):
            share = 1 + np.log10(np.maximum(power, 1e-3))[:, ::-1][:, ::4, ::4] / 3  # 30 dB, the pole first
            assert np.abs(levels - 255 * share).max() < 0.51
        scores = np.concatenate([np.asarray(each) for each in record.ssim_by_tx])
        assert max(shown.predicted[record.id].ssim) <= scores.max() + 1e-4
        by_trivial += [scores] if record.job.method in METHODS else []
    order = np.argsort(-np.mean(by_trivial, axis=0))
    assert at[[0, -1]].tolist() == predictions.rows[order[[0, -1]]].tolist()  # the easiest and the hardest


def test_the_papers_maps_are_drawn_alike_from_predictions_and_from_the_file_beside_the_records(
    results: Path, shipped: Path, tmp_path: Path
) -> None:
    drawn = []
    for source in (results, shipped):
        folder = tmp_path / source.stem
        paths = write_report(source, folder / "B.md", folder / "all")
        (picture,) = [path for path in paths if path.suffix == ".png"]
        text = (folder / "all" / "paper.md").read_text("utf-8")
        assert "maps of 5 transmitters" in text and "at 3 carriers" in text
        assert f"](figures/{picture.name})" in text
        drawn.append(picture.read_bytes())
    assert drawn[0] == drawn[1]


def test_two_methods_of_the_paper_on_one_board_have_figures_of_their_own(results: Path, tmp_path: Path) -> None:
    folder = ResultsFolder(Path(shutil.copytree(results, tmp_path / "both")))
    other = next(name for name in METHODS if name != "nearest")
    for record in [record for record in folder.records if record.job.method == other]:
        papers = with_job(record, method="xfreq-gs-paper").model_copy(update={"id": f"p{record.id}", "config": {}})
        folder.predictions_path(papers.id).write_bytes(folder.predictions_path(record.id).read_bytes())
        folder.append(papers)
    paths = write_report(folder.path, tmp_path / "B.md", tmp_path / "all")
    first, second = (path for path in paths if path.suffix == ".png")
    assert first.read_bytes() != second.read_bytes()
    ours = {record.id for record in folder.records if record.job.method in ("xfreq-gs", "xfreq-gs-paper")}
    assert ours == read_maps(ship_maps(folder.path, tmp_path / "maps.jsonl")).keys() & ours


def test_records_without_predictions_have_no_maps_to_ship_and_no_figure(results: Path, tmp_path: Path) -> None:
    store(tmp_path, *(with_job(record, dataset="elsewhere.h5") for record in ResultsFolder(results).records))
    with pytest.raises(DataError, match="No predictions of a data set"):
        ship_maps(tmp_path, tmp_path / "maps.jsonl")
    write_report(tmp_path, tmp_path / "B.md", tmp_path / "all")
    assert "## Maps" not in (tmp_path / "all" / "paper.md").read_text("utf-8")


def test_a_file_of_maps_is_written_over_and_no_other(results: Path, shipped: Path, tmp_path: Path) -> None:
    own = tmp_path / "maps.jsonl"
    own.write_bytes(shipped.with_name("reference_maps.jsonl").read_bytes())
    before = own.read_bytes()
    ship_maps(results, own)
    assert own.read_bytes() == before
    with pytest.raises(OutputExistsError, match="holds no maps to be shown"):
        ship_maps(results, results / "records.jsonl")


@pytest.mark.parametrize("damage", ["changed", "torn", "no picture"])
def test_a_damaged_file_of_maps_is_refused_with_its_name(shipped: Path, tmp_path: Path, damage: str) -> None:
    line = shipped.with_name("reference_maps.jsonl").read_text("utf-8").splitlines()[0]
    content = json.loads(line)
    if damage == "changed":
        line = line.replace("lofo-24.25GHz", "lofo-77GHz")
    elif damage == "torn":
        line = line[:1000]
    else:
        line = json.dumps({name: part for name, part in content.items() if name != SEAL} | {"truth": "AAAA"})
    copied = tmp_path / "reference.jsonl"
    copied.write_bytes(shipped.read_bytes())
    (tmp_path / "reference_maps.jsonl").write_text(line + "\n", "utf-8")
    with pytest.raises(DataError, match=r"reference_maps\.jsonl, line 1|are no picture"):
        write_page(copied, tmp_path / "page.html")


def test_a_record_of_another_run_has_no_shipped_maps(shipped: Path, tmp_path: Path) -> None:
    copied = tmp_path / "reference.jsonl"
    (tmp_path / "reference_maps.jsonl").write_bytes(shipped.with_name("reference_maps.jsonl").read_bytes())
    for record in ResultsFolder.holding(shipped).records:
        append(copied, RunRecord.model_validate({**dict(record), "id": record.id[::-1] + "0"}))
    gallery = gallery_of(write_page(copied, tmp_path / "page.html"))
    assert not gallery["cases"] and "No pictures" in gallery["missing"]


@pytest.mark.parametrize("on", ["test", "validation"])
def test_the_command_that_stores_missing_predictions_makes_the_same_records(tmp_path: Path, on: str) -> None:
    data = paper_dataset(tmp_path / "data.h5")
    asked = {"results": tmp_path / "results", "targets_ghz": [24.25], "on": on}
    (record,) = xb.run(data, "nearest", **asked)  # type: ignore[arg-type]
    (board,) = boards([record])
    command = gallery(board, [])["missing"].split("`")[1].split()
    assert command[:1] == ["xfreqbench"]
    _, given, _ = app.parse_args(command[1:], exit_on_error=False, print_error=False, help_on_error=False)
    again = given.arguments["options"]
    (split,) = xb.make_splits(data, again.protocol, [24.25], again.on)
    assert split.sha256 == record.split_sha256


def test_data_that_another_program_holds_open_are_passed_over(tmp_path: Path) -> None:
    data = paper_dataset(tmp_path / "data.h5")
    (board,) = boards(xb.run(data, "nearest", results=tmp_path / "results", targets_ghz=[24.25]))
    assert "Without stored predictions" in gallery(board, [])["missing"]
    with data.path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as HDF5 does to write
        assert "is not here" in gallery(board, [])["missing"]
