"""The paper's numbers beside ours, and its claims with a verdict where intervals allow one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.leaderboard_records import make_records, of_three_seeds, rows_of, with_job
from tests.support.stored_records import SPLITS, external, make_record, store
from xfreqbench.methods.contract import BUDGETS
from xfreqbench.report.leaderboard.boards import boards, pooled_quantiles
from xfreqbench.report.leaderboard.captions import sources_of
from xfreqbench.report.leaderboard.paper import paper_page
from xfreqbench.report.leaderboard.report import write_report
from xfreqbench.report.leaderboard.results import RankedResults
from xfreqbench.runs.records import RunRecord

CLAIM = "XFreq-GS is better than GSRF (0.9098 against 0.7235)"
BLIND = ("sees_carrier=false", "latent=0")
CIRCLES = ("footprint=circular", "max_spread=1", "angular_size_deg=16")


def page_of(*records: RunRecord) -> tuple[str, dict]:
    """The page of the paper and what draws its figures."""
    page = paper_page(RankedResults((), records, boards(records), [], 0))
    assert page is not None
    return page[1:]


def claims(*records: RunRecord) -> str:
    """The section on the paper's claims."""
    page = paper_page(RankedResults((), records, boards(records), [], 0))
    return page[0] if page else ""


def below(text: str, row: str, words: str) -> dict[str, str]:
    """The row with words in its second column that comes below a row of the paper, which has its number itself."""
    lines = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in text.splitlines() if line[:1] == "|"]
    start = next(place for place, cells in enumerate(lines) if cells[:2] == [row, "published"])
    found = next(cells for cells in lines[start:] if words in cells[1])
    header = next(cells for cells in reversed(lines[:start]) if cells[1] == "by")
    assert all(not cells[0] or cells is lines[start] for cells in lines[start : lines.index(found, start)])
    return dict(zip(header, found, strict=True))


def fitted(method: str, shift: float, *overrides: str) -> list[RunRecord]:
    """Three seeds in the lane quick, with options, better than others by `shift`."""
    return [
        with_job(record, budget=BUDGETS["quick"], overrides=overrides)
        for record in of_three_seeds(method, shift, len(method))
    ]


AIDED, AS_IT_IS = "xfreq-gs with our aids, 64,000 maps", "xfreq-gs-paper, 64,000 maps"
LONGER = "xfreq-gs-paper, 200,000 maps"


@pytest.mark.parametrize(("shift", "verdict"), [(0.05, "holds"), (-0.05, "does not hold"), (0.0, "open")])
def test_a_claim_holds_only_where_the_whole_interval_says_so(shift: float, verdict: str) -> None:
    (row,) = rows_of(claims(*fitted("xfreq-gs", shift), *fitted("gsrf", 0.0)), CLAIM)
    assert bool(row["why not"]) == (verdict != "holds")
    assert row[AIDED].endswith(f" at 24.25GHz: {verdict}")
    assert row[AS_IT_IS] == "–"


def test_a_claim_of_one_seed_has_no_verdict_and_without_measurements_there_is_no_table() -> None:
    one = claims(fitted("xfreq-gs", 0.0)[0], *fitted("gsrf", 0.0))
    assert rows_of(one, CLAIM)[0][AIDED].endswith("too few seeds")
    assert not claims(*fitted("xfreq-gs", 0.0))


def test_the_method_as_the_paper_has_it_is_judged_beside_the_aided_one() -> None:
    records = [*fitted("xfreq-gs-paper", 0.05), *fitted("xfreq-gs", 0.0), *fitted("gsrf", 0.0)]
    row = rows_of(claims(*records), CLAIM)[0]
    assert row[AS_IT_IS].endswith("GHz: holds") and row[AIDED].endswith("GHz: open")


def test_the_method_as_the_paper_has_it_is_judged_with_the_papers_budget_too() -> None:
    usual = [*fitted("xfreq-gs-paper", -0.05), *fitted("xfreq-gs", 0.0), *fitted("gsrf", 0.0)]
    longer = [with_job(record, budget=BUDGETS["converged"]) for record in usual]
    found = [*usual, *[record for record in longer if record.job.method != "xfreq-gs-paper"]]
    (row,) = rows_of(claims(*found), CLAIM)
    assert row[AS_IT_IS].endswith("24.25GHz: does not hold") and row[LONGER] == "–"
    found += [with_job(record, budget=BUDGETS["converged"]) for record in fitted("xfreq-gs-paper", 0.05)]
    (row,) = rows_of(claims(*found), CLAIM)
    assert row[LONGER].endswith("24.25GHz: holds") and row[AS_IT_IS].endswith("does not hold")
    text, _ = page_of(*found)
    assert len([line for line in text.splitlines() if "| xfreq-gs-paper, ≤ 200,000 maps" in line]) == 1
    assert (
        len([line for line in text.splitlines() if "| xfreq-gs-paper, ≤ 64,000 maps" in line]) == 2
    )  # the distribution


def test_an_ablation_is_compared_with_the_plain_method_and_not_with_another_ablation() -> None:
    records = [*fitted("xfreq-gs", -0.05, *BLIND), *fitted("xfreq-gs", 0.0)]
    text, _ = page_of(*records)
    claim = "XFreq-GS is better with frequency modulation than without (0.9278 against 0.8977)"
    assert rows_of(claims(*records), claim)[0][AIDED].endswith("holds")
    table = [line.split("|")[1:4] for line in text.splitlines() if line.startswith("| full") or "with our aids" in line]
    assert ["full", "published"] in [[cell.strip() for cell in line[:2]] for line in table]
    plain, ablation = (below(text, name, "with our aids") for name in ("full", "without frequency modulation"))
    assert float(plain["SSIM median"].split()[0]) > float(ablation["SSIM median"].split()[0])
    assert below(text, "full", "published")["SSIM median"] == "0.9278"
    assert not rows_of(text, "GSRF")  # none of ours


def test_splatting_is_compared_with_circles_of_the_radius_that_was_looked_for() -> None:
    claim = "XFreq-GS is better with adaptive orthographic splatting than without (0.9278 against 0.8360)"
    records = [*fitted("xfreq-gs", 0.0), *fitted("xfreq-gs", -0.05, *CIRCLES)]
    records += [*fitted("xfreq-gs", -0.1, "aided=false"), *fitted("xfreq-gs", -0.12, *CIRCLES, "aided=false")]
    smaller = fitted("xfreq-gs", -0.3, *CIRCLES[:2], "angular_size_deg=4")
    (row,) = rows_of(claims(*smaller, *records), claim)
    differences = [float(row[column].split()[0]) for column in (AIDED, AIDED.replace("with", "without", 1))]
    assert differences == pytest.approx([50, 20], abs=2) and row[AIDED].endswith(": holds")
    others = rows_of(claims(*smaller, *records[:3], *fitted("gsrf", 0.0)), claim)
    assert others[0][AIDED] == "–", "circles of another radius stand for none"


def test_a_claim_that_was_measured_on_other_data_names_them() -> None:
    here = [*fitted("xfreq-gs", 0.0), *fitted("gsrf", 0.0), *fitted("wrf-gs-plus", 0.0)]
    there = [*fitted("xfreq-gs", 0.0), *fitted("xfreq-gs", -0.05, *CIRCLES)]
    other = [record.model_copy(update={"dataset_sha256": "e" * 64, "recipe": f"3-{'e' * 64}"}) for record in there]
    named = {line.split(" (")[0]: "3-eeeeeeee" in line for line in claims(*here, *other).splitlines()}
    assert named["| XFreq-GS is better with adaptive orthographic splatting than without"]
    assert not named["| XFreq-GS is better than GSRF"]


def test_the_papers_method_is_shown_though_it_ran_on_other_data_which_are_named() -> None:
    other = {"dataset_sha256": "e" * 64, "recipe": f"2-{'e' * 64}"}
    paper = [record.model_copy(update=other) for record in fitted("xfreq-gs-paper", 0.0)]
    text, _ = page_of(*paper, *fitted("xfreq-gs", 0.0), *fitted("gsrf", 0.0))
    assert below(text, "full", "xfreq-gs-paper")["by"].endswith("@2-eeeeeeee")
    assert "@" not in below(text, "full", "with our aids")["by"]


def test_averages_are_of_the_carriers_of_the_paper_and_gains_are_told_along_them() -> None:
    def at(split: str, shift: float, method: str) -> list[RunRecord]:
        return [with_job(record, split=split) for record in fitted(method, shift)]

    shifts = {"lofo-1GHz": 0.1, **dict(zip(SPLITS, (0.01, 0.02, 0.06), strict=True))}
    records = [record for split, shift in shifts.items() for record in at(split, shift, "xfreq-gs")]
    records += [record for split in shifts for record in at(split, 0.0, "wrf-gs-plus")]
    gain = "XFreq-GS is better than WRF-GS+ (0.9098 against 0.8796)"
    assert float(rows_of(claims(*records), gain)[0][AIDED].split()[0]) == pytest.approx(30, abs=2)
    grows = "its gain over WRF-GS+ grows with frequency (1.8, 3.1 and 5.5 % at 2.4, 24.25 and 77 GHz)"
    *steps, growth = rows_of(claims(*records), grows)[0][AIDED].split(" [")[0].replace(":", ",").split(", ")
    assert [*map(float, steps)] == pytest.approx([10, 20, 60], abs=2) and float(growth) == pytest.approx(50, abs=0.1)


def test_the_page_has_the_papers_method_in_every_table_and_says_which_are_reduced() -> None:
    ablations = (BLIND, CIRCLES, BLIND + CIRCLES)
    sparse = [f"sparse-24.25GHz-from-{carriers}GHz" for carriers in ("10-37", "10-37-94", "1-10-37-60-94")]
    plain = [with_job(record, split=split) for split in SPLITS for record in fitted("xfreq-gs-paper", 0)]
    plain += [
        with_job(record, split=split, protocol="sparse") for split in sparse for record in fitted("xfreq-gs-paper", 0)
    ]
    plain += [record for options in ablations for record in fitted("xfreq-gs-paper", 0, *options)]
    text, _ = page_of(*plain, *fitted("gsrf", 0))
    assert "gsrf for GSRF: hundreds of Gaussians" in text and text.count("| gsrf, reduced, ≤ 64,000 maps") == 1
    papers = ("XFreq-GS", "baseline", "without frequency modulation", "without AOS", "full", "10, 37 GHz")
    for name in (*papers, "10, 37, 94 GHz", "1, 10, 37, 60, 94 GHz"):
        assert below(text, name, "xfreq-gs-paper")
    assert rows_of(text, "xfreq-gs-paper, ≤ 64,000 maps")[-1]["theirs"] == "XFreq-GS"


def test_the_level_of_ninety_per_cent_stands_beside_the_papers_and_the_figure_is_drawn(tmp_path: Path) -> None:
    trivial = [record for record in make_records() if record.job.method != "ours"]
    records = [*fitted("xfreq-gs", 0.0), *trivial]
    text, drawn = page_of(*records)
    (row,) = rows_of(text, "xfreq-gs, with our aids, ≤ 64,000 maps")[-1:]
    quantiles = pooled_quantiles([record for record in records if record.job.method == "xfreq-gs"], "ssim")
    assert (row["theirs"], row["published SSIM"], float(row["SSIM"])) == (
        "XFreq-GS",
        "0.97",
        pytest.approx(quantiles[90], abs=5e-5),
    )
    ((link, draw),) = drawn.items()
    assert f"]({link})" in text
    for name in ("first.svg", "second.svg"):
        draw(tmp_path / name)
    drawing = (tmp_path / "first.svg").read_text("utf-8")
    assert drawing == (tmp_path / "second.svg").read_text("utf-8")
    for label in ("SSIM", "PSNR (dB)", "xfreq-gs", "mean-over-frequency"):
        assert label in drawing


def test_methods_of_the_paper_that_share_no_split_have_no_distributions() -> None:
    apart = [make_record("xfreq-gs", 0.7, SPLITS[0]), make_record("wrf-gs-plus", 0.6, SPLITS[1])]
    text, drawn = page_of(*apart)
    assert drawn == {}
    assert not [row for row in rows_of(text, "xfreq-gs") if "theirs" in row]


def test_only_reports_with_methods_of_the_paper_have_the_page(tmp_path: Path) -> None:
    for name, records in (("ours", make_records()), ("theirs", [*make_records(), *fitted("xfreq-gs", 0.0)])):
        folder = store(tmp_path / name, *records)
        written = write_report(folder, folder / "B.md", folder / "all")
        pages = [path.name for path in written if path.suffix == ".md"]
        assert ("paper.md" in pages) == (name == "theirs")
        assert ("all/paper.md" in (folder / "B.md").read_text("utf-8")) == (name == "theirs")


def test_every_method_that_is_named_after_a_system_says_whose_it_is() -> None:
    methods = ("gsrf", "wrf-gs-plus", "wideband-3dgs", "swift-wrf", "xfreq-gs", "nearest")
    (board,) = boards([make_record(method) for method in methods])
    sources = sources_of(board.rows)
    assert {method for source in sources for method in source["methods"]} >= set(methods[:-1])
    assert all(source[kind].startswith("https://") for source in sources for kind in ("paper", "program"))
    assert not sources_of([row for row in board.rows if row.job.method == "nearest"])


def test_an_external_row_has_no_published_counterpart() -> None:
    records = (external(method="gsrf"),)
    assert paper_page(RankedResults((), records, boards(records), [], 0)) is None
    assert page_of(*records, make_record("gsrf"))
