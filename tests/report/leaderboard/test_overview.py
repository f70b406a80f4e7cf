"""A short report answers the first questions, and links to pages that hold the rest."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.leaderboard_records import make_bench, make_followed, make_records, of_three_seeds, rows_of, with_job
from tests.support.stored_records import make_record, store
from xfreqbench.methods.contract import BUDGETS
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.report import report_text, write_report
from xfreqbench.report.leaderboard.side_by_side import got_worse
from xfreqbench.runs.records import RunRecord

ABLATION = "ours (rank=2)"


def records_of(scene: str) -> list[RunRecord]:
    """Records on a data set of its own."""
    found = [*make_records(), make_followed(), with_job(make_record("ours", 0.99), overrides=("rank=2",))]
    return [record.model_copy(update={"scene": scene, "dataset_sha256": f"{len(scene):064x}"}) for record in found]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    stress = make_bench(
        "stress",
        "Numerical stability",
        columns=("area", "case", "error", "limit", "unit", ""),
        rows=[("phase", f"case {n}", "1", "2", "rad", "ok" if n else "FAILED") for n in range(9)],
        figure=None,
    )
    return store(folder, *records_of("office"), *records_of("corridor")[:4], make_bench(), stress)


@pytest.fixture(scope="module")
def written(results: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """The pages of a short report, `B.md` the first."""
    folder = tmp_path_factory.mktemp("report")
    paths = write_report(results, folder / "B.md", folder / "docs" / "all")
    return tuple(path for path in paths if path.suffix == ".md")


def test_a_short_report_leaves_ablations_to_the_pages_of_scenes(written: tuple[Path, ...]) -> None:
    texts = {page.stem: page.read_text("utf-8") for page in written}
    assert list(texts) == ["B", "corridor", "office", "measurements"]
    assert rows_of(texts["office"], ABLATION)
    assert not rows_of(texts["B"], ABLATION)
    assert len(texts["B"].splitlines()) < len(texts["office"].splitlines())
    assert "Error against run time" in texts["measurements"]


def test_without_a_file_the_short_report_is_a_text_and_the_pages_are_written_alone(
    results: Path, written: tuple[Path, ...], tmp_path: Path
) -> None:
    pages = [path for path in write_report(results, None, tmp_path / "all") if path.suffix == ".md"]
    assert [path.read_bytes() for path in pages] == [path.read_bytes() for path in written[1:]]
    assert report_text(results, written[1].parent).partition("\n## Findings")[0] in written[0].read_text("utf-8")


def test_every_link_of_a_short_report_leads_to_a_file(written: tuple[Path, ...]) -> None:
    for page in written:
        links = re.findall(r"\]\(([^)]+)\)", page.read_text("utf-8"))
        assert links or page.stem == "corridor"
        assert all((page.parent / link).is_file() for link in links), links


def test_the_main_board_has_columns_of_another_scene_where_methods_ran_too(tmp_path: Path, results: Path) -> None:
    assert "corridor: " not in report_text(results, tmp_path)  # where baselines ran alone
    records = [*records_of("office"), *(each for each in records_of("corridor") if each.job.method != "nearest")]
    records = [record.model_copy(update={"id": f"run {number}"}) for number, record in enumerate(records)]
    text = report_text(store(tmp_path, *records), tmp_path)
    assert "Columns of corridor are of the board there at " in text
    ours, nearest = (rows_of(text, method)[0] for method in ("ours", "nearest"))
    assert ours["corridor: average"] == ours["average"]
    assert nearest["corridor: average"] == "–" != nearest["average"]


def test_the_matrix_of_skill_has_the_skill_of_each_board(written: tuple[Path, ...]) -> None:
    matrix = rows_of(written[0].read_text("utf-8"), "office, lofo")[-1]
    assert matrix == {"board": "office, lofo", "ours": "0.500"}


def test_the_matrix_of_skill_leaves_out_methods_that_few_boards_have(tmp_path: Path) -> None:
    records = [record for scene in ("office", "corridor", "hall") for record in records_of(scene)]
    records += [with_job(record, method="rare") for record in records_of("office") if record.job.method == "ours"]
    records = [record.model_copy(update={"id": f"run {number}"}) for number, record in enumerate(records)]
    text = report_text(store(tmp_path, *records), tmp_path)
    assert "\n| board" in text and "Left out, since on fewer than half of the boards: `rare`." in text
    matrix = [row for scene in ("office", "corridor", "hall") for row in rows_of(text, f"{scene}, lofo")]
    assert matrix and all(row.keys() == {"board", "ours"} for row in matrix)


def test_findings_name_the_best_method_and_what_each_part_of_the_papers_idea_adds(tmp_path: Path) -> None:
    def stored(method: str, shift: float, *overrides: str) -> list[RunRecord]:
        return [
            with_job(record, overrides=overrides, budget=BUDGETS["quick"])
            for record in of_three_seeds(method, shift, len(method))
        ]

    idea = [("xfreq-gs", 0.04), ("fixed-frequency-gs", 0.03)]
    records = [record for method, shift in idea for record in stored(method, shift)]
    records += [record for method, shift in idea for record in stored(method, 3 * shift, "aided=false")]
    records += stored("fixed-frequency-gs", 0.0, "aided=true")  # as it is by itself it has no blend
    records += [record for name in NEEDED_TRIVIAL for record in of_three_seeds(name, 0.0, 40)[:1]]

    def findings(*records: RunRecord) -> list[str]:
        write_report(store(tmp_path, *records), tmp_path / "B.md", tmp_path / "all")
        return re.findall(r"^\d\. (.*)$", (tmp_path / "B.md").read_text("utf-8"), re.MULTILINE)

    (best,) = findings(*records)  # no part was run alone
    assert "`xfreq-gs` is best" in best and "The next, `fixed-frequency-gs`" in best and "1 of the 1 boards" in best
    for change, shift in (("sees_carrier=false", 0.122), ("latent=0", 0.09), ("max_spread=1", 0.12)):
        records += stored("xfreq-gs", shift, "aided=false", change)  # with the carrier it has 0.12

    def adds(*records: RunRecord) -> dict[str, list[float]]:
        idea = findings(*records)[-1]
        assert re.search(
            r"learned codes of Gaussians 0\.0(29|30)\d \[0\..* in 0, 1, 0, [12] of them, in the order", idea
        ), idea
        text = (tmp_path / "all/paper.md").read_text("utf-8").partition("What each part of the paper's idea adds")[2]
        cells = [line.strip("| ").split(" | ") for line in text.splitlines() if "aids, `" in line]
        return {where.strip(): [float(cell.split()[0]) for cell in row if "[" in cell] for where, *row in cells}

    unaided, aided = "without our aids, `lofo` at 24.25GHz", "with our aids, `lofo` at 24.25GHz"
    expected = {unaided: [-0.002, 0.03, 0.0, 0.03], aided: [0.04]}
    assert adds(*records) == {where: pytest.approx(values, abs=2e-3) for where, values in expected.items()}
    elsewhere = [
        with_job(record, split="lofo-1GHz")
        for method in ("xfreq-gs", "fixed-frequency-gs")
        for record in stored(method, -0.2)
    ]
    assert adds(*records, *elsewhere).keys() == expected.keys(), "a carrier that not all were run on counts for none"
    few = [
        with_job(record, protocol="sparse", split="sparse-24.25GHz-from-10-37GHz")
        for change, shift in (((), 0.0), (("sees_carrier=false",), 0.1))
        for record in stored("xfreq-gs", shift, "aided=false", *change)
    ]
    few_carriers = adds(*records, *few)["without our aids, `sparse` at 24.25GHz-from-10-37GHz"]
    assert few_carriers == pytest.approx([-0.1], abs=2e-3)


def test_rooms_traced_by_several_programs_and_measured_maps_stand_beside_each_other(tmp_path: Path) -> None:
    def stored(scene: str, protocol: str, recipe: str, settings: dict[str, str], ours: float) -> list[RunRecord]:
        shifts = {"mine": ours, "weak": -0.1} | dict.fromkeys(NEEDED_TRIVIAL, 0.0)
        known = {"scene": scene, "recipe": f"1-{recipe * 64}", "dataset_sha256": recipe * 64, "settings": settings}
        return [
            with_job(record.model_copy(update={**known, "id": recipe + record.id}), protocol=protocol, split=protocol)
            for method, shift in shifts.items()
            for record in of_three_seeds(method, shift, len(method))
        ]

    traced = [
        record
        for solver, recipe, ours in (("image", "a", 0.1), ("sionna", "b", 0.04))
        for record in stored("room", "held-out-tx", recipe, {"solver": solver}, ours)
    ]
    other = stored("hall", "held-out-tx", "c", {"solver": "image"}, 0.1)
    measured = stored("tags", "held-out-tx", "d", {"imported_from": "PNG layout"}, -0.02)
    text = report_text(store(tmp_path, *traced, *other, *measured), tmp_path / "all")
    (mine,) = (row for row in rows_of(text, "mine") if "tags, held-out-tx" in row)
    assert mine.keys() == {"", "room, held-out-tx, image", "room, held-out-tx, sionna", "tags, held-out-tx"}
    by_ours, by_sionna, on_tags = (
        [float(number) for number in re.findall(r"-?[\d.]+", cell)] for cell in list(mine.values())[1:]
    )
    assert by_ours[0] == by_sionna[0] == 1 and by_ours[1] == pytest.approx(0.5, abs=0.02)  # of an error of .2
    assert by_sionna[1] == pytest.approx(0.2, abs=0.02) and on_tags[1] == pytest.approx(-0.1, abs=0.02)
    assert re.search(r"On measured maps, .* \(`held-out-tx`\) `mine` has a skill of -0\..*; 0 of 2 methods are", text)
    alone = report_text(store(tmp_path / "alone", *traced[: len(traced) // 2], *other), tmp_path / "all")
    assert "Other truth" not in alone


IMPORTED = {"settings": {"imported_from": "PNG layout"}}
BASELINES = [make_record(method, 0.8, "held-out-tx", "held-out-tx", **IMPORTED) for method in NEEDED_TRIVIAL]
FITTED = make_record("ours", 0.9, "held-out-tx", "held-out-tx", **IMPORTED)


@pytest.mark.parametrize(
    ("records", "said"),
    [
        ([make_bench()], "[measurements]"),
        (BASELINES, "best baseline"),
        ([FITTED], "On measured maps, at transmitters never heard (`held-out-tx`) `ours` has a skill of –"),
        ([with_job(FITTED, overrides=("rank=2",))], "ours"),
    ],
    ids=["measurements alone", "baselines alone", "no baseline", "an ablation alone"],
)
def test_a_short_report_is_made_of_whatever_was_run(tmp_path: Path, records: list, said: str) -> None:
    text = report_text(store(tmp_path, *records), tmp_path / "all")
    written = (page.read_text("utf-8") for page in (tmp_path / "all").glob("*.md"))
    assert said in "\n".join([text, *written])


def test_a_warning_and_boards_that_others_win_are_said_in_the_same_sentence_as_the_praise(tmp_path: Path) -> None:
    records = [*of_three_seeds("virtual-source", 0.1, 1), *of_three_seeds("xfreq-gs", 0.0, 20)]
    lost = [*of_three_seeds("virtual-source", 0.0, 1), *of_three_seeds("xfreq-gs", 0.1, 20)]
    hall = {"scene": "hall", "dataset_sha256": "4" * 64, "recipe": f"1-{'4' * 64}"}
    records += [record.model_copy(update={**hall, "id": f"4{record.id}"}) for record in lost]
    write_report(store(tmp_path, *records), tmp_path / "B.md", tmp_path / "all")
    (best,) = re.findall(r"^1\. (.*)$", (tmp_path / "B.md").read_text("utf-8"), re.MULTILINE)
    assert "`virtual-source` is best" in best and "inverts what the tracer makes" in best
    assert "first on 1 of the 2 boards of known rooms on which it was run (else `xfreq-gs` on hall, lofo)." in best


def test_what_got_worse_since_earlier_results_is_told_with_what_is_different(tmp_path: Path) -> None:
    earlier = [*of_three_seeds("ours", 0.02, 10), *of_three_seeds("same", 0.0, 20)]
    worse = [record.model_copy(update={"code_sha256": "f" * 64}) for record in of_three_seeds("ours", 0.0, 10)]
    before, after = store(tmp_path / "before", *earlier), store(tmp_path / "after", *worse, *earlier[3:])
    write_report(after, tmp_path / "B.md", tmp_path / "all", before)
    ((board, method, *_, difference, why),) = got_worse(earlier, [*worse, *earlier[3:]])
    assert (board, method) == ("office, lofo", "ours") and difference.startswith("-0.02") and "code" in why
    assert why in (tmp_path / "B.md").read_text("utf-8")
    assert f"<td>{why}</td>" in write_page(after, tmp_path / "p.html", before).read_text("utf-8")
    assert got_worse(earlier, earlier) == []
