from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from xfreqbench.baselines.virtual_source.commands import residual as residual_command
from xfreqbench.baselines.virtual_source.findings.compared import ComparedFindings
from xfreqbench.baselines.virtual_source.findings.residual import (
    Residual,
    compute_residual,
    group_rows,
    plan_residual,
    score_rows,
)

from tests.support.found_box import ALL_PLANES, SCENE, SETTINGS, WITHOUT_FLOOR
from tests.support.plans import plan_generation
from tests.support.stored_records import make_record, make_summary
from tests.support.synthetic import append_all, make_header
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.splits import find_split
from xfreqbench.data.writer import PasWriter
from xfreqbench.errors import DataError, OutputExistsError, XFreqBenchError
from xfreqbench.runs.predictions import write_predictions
from xfreqbench.runs.records import RunRecord, append
from xfreqbench.tracing.tracer import TraceSettings

EVERYTHING = "every plane and edge"
BOUNDS = {0: ", no reflections", 1: ", 1 reflection at most", None: ""}
BOUNDS |= {order: f", {order} reflections at most" for order in (2, 3)}


def stored_run(
    box: PasDataset, folder: Path, findings: dict[str, object], method: str = "virtual-source", **changes: object
) -> RunRecord:
    """A record whose predictions are the truth, turned by two degrees for other methods."""
    split = find_split(box, "lofo", "lofo-24.25GHz")
    record = make_record(method, dataset_sha256=box.sha256, split_sha256=split.sha256, findings=findings, **changes)
    maps = np.roll(box.pas(split.test), 0 if findings else 2, axis=2)
    write_predictions(
        folder / "predictions" / f"{record.id}.h5",
        [(split.test, maps)],
        len(split.test),
        box.grid.shape,
        box.sha256,
        split.sha256,
    )
    append(folder / "records.jsonl", record)
    return record


def residual_of(
    box: PasDataset, folder: Path, findings: dict[str, object] = ALL_PLANES, num_tx: int = 1000
) -> Residual:
    compared = ComparedFindings.of(stored_run(box, folder, findings), box)
    return compute_residual(plan_residual(folder, compared, num_tx), *[lambda done, total: None] * 2)


@pytest.fixture(scope="module")
def complete(box: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> Residual:
    return residual_of(box, tmp_path_factory.mktemp("complete"))


@pytest.fixture(scope="module")
def floorless(box: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> Residual:
    return residual_of(box, tmp_path_factory.mktemp("floorless"), WITHOUT_FLOOR)


def ssim_of(residual: Residual, where: str, most: int | None = None, through: str = "") -> np.ndarray:
    return residual.scores[f"true paths, {where}{BOUNDS[most]}{through}"][0]


def test_all_true_paths_give_the_true_map(complete: Residual) -> None:
    assert ssim_of(complete, EVERYTHING).min() > 0.99  # the aperture is 2 cm: a wave's power differs little on it


def test_where_every_plane_was_found_the_found_planes_are_all(complete: Residual) -> None:
    # some processors round the rows of one product apart, by 1e-7 of a map in float32
    np.testing.assert_allclose(ssim_of(complete, "found planes"), ssim_of(complete, EVERYTHING), atol=1e-6)
    for order in (0, 1, 2, 3):
        found, every = ssim_of(complete, "found planes", order), ssim_of(complete, "every plane", order)
        np.testing.assert_allclose(found, every, atol=1e-6)
    assert not complete.share_not_found.any()


def test_a_plane_left_out_is_missed_in_the_found_planes_alone(complete: Residual, floorless: Residual) -> None:
    for order in (1, 2, None):
        lower = ssim_of(floorless, "found planes", order), ssim_of(complete, "found planes", order)
        assert np.median(lower[0]) < np.median(lower[1]) - 0.005  # a floor carries percents of the power
    for order in (0, 1, 2, 3, None):
        same = [ssim_of(residual, "every plane", order) for residual in (floorless, complete)]
        np.testing.assert_array_equal(*same)
    assert floorless.share_not_found.min() > 0


def test_paths_over_edges_are_a_cause_of_their_own(complete: Residual, tmp_path: Path) -> None:
    """Behind the screen there is little else, and with its edges the true paths give the true map again."""
    settings = replace(SETTINGS, interactions=("specular", "refraction", "diffraction"))
    plan = plan_generation(SCENE, [2.4e9, 24.25e9], settings, tx=4)
    diffracted = residual_of(open_dataset(generate_planned(plan, tmp_path / "box.h5")), tmp_path, num_tx=4)
    edges, none = ssim_of(diffracted, EVERYTHING), ssim_of(diffracted, "every plane")
    assert edges.min() > 0.95
    assert np.median(edges) > np.median(none)
    assert diffracted.share_not_found.any()
    np.testing.assert_array_equal(ssim_of(complete, "every plane"), ssim_of(complete, EVERYTHING))


def test_transmissions_are_missed_by_those_behind_the_screen(complete: Residual) -> None:
    shadowed = ~complete.samples.tables["line_of_sight"][complete.samples.tx_index]
    assert 0 < shadowed.sum() < len(shadowed)
    without, direct = ssim_of(complete, "found planes", 0, ", no transmissions"), ssim_of(complete, "found planes", 0)
    assert (without[shadowed] < direct[shadowed]).all()
    np.testing.assert_array_equal(without[~shadowed], direct[~shadowed])


def test_predictions_are_scored_as_stored_and_the_best_trivial_one_beside_them(box: PasDataset, tmp_path: Path) -> None:
    better, worse = ({"ssim": make_summary(median)} for median in (0.8, 0.7))
    stored_run(box, tmp_path, {}, "nearest", scores=better)
    stored_run(box, tmp_path, {}, "line-of-sight", scores=worse)
    stored_run(box, tmp_path, {}, "xfreq-gs", scores={"ssim": make_summary(0.9)})
    scores = residual_of(box, tmp_path, num_tx=3).scores
    predicted, trivial, *_ = scores
    assert predicted == "virtual-source, as predicted"
    assert trivial == "nearest, the best trivial predictor"
    np.testing.assert_allclose(scores[predicted][0], 1, atol=1e-12)  # the same half-precision numbers
    assert (scores[trivial][0] < 0.999).all()


def test_groups_hold_every_transmitter_once(floorless: Residual) -> None:
    _, rows = group_rows(floorless)
    counts = [int(row[1]) for row in rows]
    assert len(rows) == 4 + 2
    assert sum(counts[:4]) == sum(counts[4:]) == len(floorless.samples)
    medians = [float(row[2].split()[0]) for row in rows[:4]]
    assert medians == sorted(medians)
    assert medians[0] < medians[-1]


def test_the_drawn_transmitters_are_some_of_the_tested_and_always_the_same(box: PasDataset, tmp_path: Path) -> None:
    compared = ComparedFindings.of(stored_run(box, tmp_path, ALL_PLANES), box)
    few, again, all_ = (plan_residual(tmp_path, compared, number).samples.rows for number in (4, 4, 1000))
    np.testing.assert_array_equal(few, again)
    assert len(few) == 4
    assert set(few) < set(all_)
    np.testing.assert_array_equal(all_, find_split(box, "lofo", "lofo-24.25GHz").test)


def test_the_command_prints_and_writes_both_tables(
    box: PasDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored_run(box, tmp_path, WITHOUT_FLOOR)
    path = tmp_path / "residual.md"
    residual_command(tmp_path / "records.jsonl", data=box.path, output=path, tx=4)
    text, printed = path.read_text(), capsys.readouterr().out
    for words in ("true paths, found planes, 2 reflections at most", "quarter 4", "4 tested transmitters"):
        assert words in text
        assert words in printed
    residual_command(tmp_path, data=box.path, output=path, tx=4, quiet=True)  # its own file is replaced
    assert path.read_text() == text
    stored_run(box, tmp_path, WITHOUT_FLOOR, id="other", time_utc="2030-01-01T00:00:00+00:00")
    with pytest.raises(OutputExistsError, match="record other"):
        residual_command(tmp_path, data=box.path, output=path, quiet=True)


def test_scores_of_no_map_are_dashes(complete: Residual) -> None:
    tables = dict(complete.samples.tables)
    tables["line_of_sight"] = np.ones_like(tables["line_of_sight"])
    header, rows = score_rows(replace(complete, samples=replace(complete.samples, tables=tables)))
    assert {row[header.index("shadowed")] for row in rows} == {"–"}


def test_mistakes_are_told_before_any_ray(box: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("xfreqbench.baselines.virtual_source.findings.residual.ImageTracer", None)
    output = tmp_path / "residual.md"
    record = stored_run(box, tmp_path, ALL_PLANES)
    with pytest.raises(XFreqBenchError, match="--tx takes a number of transmitters from 1 on, but got 0"):
        residual_command(tmp_path, data=box.path, output=output, tx=0)
    output.write_text("mine\n")
    with pytest.raises(OutputExistsError, match="was not written for record"):
        residual_command(tmp_path, data=box.path, output=output)
    assert output.read_text() == "mine\n"
    (tmp_path / "predictions" / f"{record.id}.h5").unlink()
    with pytest.raises(DataError, match=r"predictions of record .* are not at"):
        residual_command(tmp_path, data=box.path, output=tmp_path / "new" / "residual.md")
    assert not (tmp_path / "new").exists()


def test_predictions_of_another_split_are_refused(box: PasDataset, tmp_path: Path) -> None:
    record = stored_run(box, tmp_path, ALL_PLANES)
    other = record.model_copy(update={"split_sha256": "0" * 64})
    with pytest.raises(DataError, match="holds predictions of another split"):
        plan_residual(tmp_path, ComparedFindings.of(other, box), 1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"interactions": ["specular", "diffuse"]}, "specular, diffuse to depth 6, but exact paths"),
        ({"max_depth": "deep"}, "does not say how it was traced"),
    ],
)
def test_data_that_no_image_method_can_have_traced_are_refused(
    tmp_path: Path, settings: dict[str, object], message: str
) -> None:
    told = {**asdict(TraceSettings(interactions=("specular", "refraction"))), **settings}
    header = replace(make_header(3), scene_json=SCENE.canonical_json, settings=told)
    path = tmp_path / "other.h5"
    with PasWriter(path, header) as writer:
        append_all(writer, header)
    other = open_dataset(path)
    record = make_record("virtual-source", dataset_sha256=other.sha256, findings=ALL_PLANES)
    with pytest.raises(DataError, match=message):
        plan_residual(tmp_path, ComparedFindings.of(record, other), 1)
