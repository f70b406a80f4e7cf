from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support.stored_records import SPLITS, external, make_record
from xfreqbench.maps.metrics import quantiles
from xfreqbench.methods.contract import BUDGETS, Budget
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.boards import boards, pooled_quantiles, short_commit, short_name
from xfreqbench.runs.records import Job, RunRecord
from xfreqbench.runs.scoring import summaries


def seeded(ssim: float, seed: int, split: str = SPLITS[0], **changes):
    job = Job("data.h5", "ours", "lofo", split, seed=seed, budget=Budget(max_seconds=300))
    return make_record("ours", ssim, split, job=job, **changes)


def only_row(*records):
    (board,) = boards(records)
    (row,) = board.rows
    return row


def test_seeds_of_a_method_are_one_row_and_count_by_their_mean() -> None:
    row = only_row(*(seeded(ssim, seed) for seed, ssim in enumerate((0.90, 0.92, 0.97))))
    assert row.label == "ours (≤ 300 s)"
    assert [record.job.seed for record in row.by_split[SPLITS[0]]] == [0, 1, 2]
    assert row.average([SPLITS[0]]) == pytest.approx(0.93)
    assert row.num_seeds(SPLITS[:1]) == (3, 3)


def test_the_spread_over_seeds_is_that_of_their_averages() -> None:
    of_first = {SPLITS[0]: 0.90, SPLITS[1]: 0.80}
    of_second = {SPLITS[0]: 0.94, SPLITS[1]: 0.76}  # better here, worse there: the same on average
    records = [
        seeded(ssim, seed, split) for seed, each in enumerate((of_first, of_second)) for split, ssim in each.items()
    ]
    row = only_row(*records)
    assert row.seed_spread(SPLITS[:2]) == pytest.approx(0)
    assert row.seed_spread(SPLITS[:1]) == pytest.approx(0.04 / math.sqrt(2))


def test_a_seed_that_was_not_run_on_every_split_has_no_part_in_the_spread() -> None:
    row = only_row(*(seeded(0.9, seed) for seed in (1, 2)), seeded(0.8, 1, SPLITS[1]))
    assert math.isnan(row.seed_spread(SPLITS[:2]))
    assert row.num_seeds(SPLITS[:2]) == (1, 2)


def test_an_average_over_a_split_that_was_not_run_is_unknown() -> None:
    assert math.isnan(only_row(seeded(0.9, 0)).average(SPLITS[:2]))


def test_sets_of_splits_come_with_that_of_most_runs_first() -> None:
    trivial = [make_record("nearest", 0.8, split) for split in SPLITS]
    some = [make_record(name, 0.9, split) for name in ("ours", "theirs") for split in SPLITS[:2]]
    lone = make_record("lone", 0.9, SPLITS[2])
    (board,) = boards([*trivial, *some, lone])
    assert board.split_sets() == [SPLITS[:2], SPLITS]
    assert [row.label for row in board.rows_on(SPLITS[:2])] == ["ours", "theirs", "nearest"]
    jobs = [Job("data.h5", "whole", "lofo", split, seed=seed) for split in SPLITS for seed in range(4)]
    whole = [make_record("whole", 0.7, job.split, job=job, id=f"{job.split}-{job.seed}") for job in jobs]
    (board,) = boards([*trivial, *some, *whole, lone])
    assert board.split_sets() == [SPLITS, SPLITS[:2]], "two rows that lack a split do not take it from the others"
    (board,) = boards([lone])
    assert board.split_sets() == [SPLITS[2:]]


def test_a_split_is_named_without_its_protocol() -> None:
    names = ["lofo-2.4GHz", "lofo-unseen-tx-2.4GHz", "held-out-tx", "sparse-24.25GHz-from-10-37GHz"]
    assert list(map(short_name, names)) == ["2.4GHz", "2.4GHz", "held-out-tx", "24.25GHz-from-10-37GHz"]


def test_protocols_of_a_data_set_stand_in_their_order() -> None:
    protocols = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx")
    found = boards([make_record(split=f"{name}-x", protocol=name) for name in protocols[::-1]])
    assert [board.protocol for board in found] == list(protocols)


def test_scenes_stand_in_their_order_and_of_each_the_newer_physics_first() -> None:
    at = [("b", "9-cc"), ("a", "2-aa"), ("b", "10-bb"), ("a", "3-dd"), ("a", "3-cc")]
    found = boards([make_record().model_copy(update={"scene": scene, "recipe": data}) for scene, data in at])
    expected = [("a", "3-cc"), ("a", "3-dd"), ("a", "2-aa"), ("b", "10-bb"), ("b", "9-cc")]
    assert [(board.scene, board.data) for board in found] == expected


def test_a_commit_is_cut_and_keeps_that_the_source_was_edited() -> None:
    commits = ["0123456789", "0123456789+changes", None]
    assert list(map(short_commit, commits)) == ["0123456", "0123456+changes", "?"]


def of_options(*options: str, seed: int) -> RunRecord:
    return make_record("ours", 0.9, SPLITS[0], job=Job("data.h5", "ours", "lofo", SPLITS[0], options, seed))


def versions() -> list[RunRecord]:
    """Two seeds of an older version of a method, and one of a newer."""
    newer = seeded(0.8, 8, code_sha256="e0aa12" + "0" * 58, time_utc="2026-11-28T10:02:59+00:00", git_commit="0123456")
    older = {"code_sha256": "3fa9c1" + "0" * 58}
    return [newer, *(seeded(0.9, seed, time_utc=f"2026-11-27T0{seed}:30:00+00:00", **older) for seed in (8, 9))]


def file_of(name: str, splits: tuple[str, ...], day: int) -> list[RunRecord]:
    return [external(split, file=name, time_utc=f"2026-01-0{day}T00:00:00+00:00") for split in splits]


FIRST, SECOND, THIRD = SPLITS


@pytest.mark.parametrize(
    ("records", "rows"),
    [
        (
            versions(),
            {
                "ours (≤ 300 s) (2026-11-27 08:30, code 3fa9c1)": {FIRST: 2},
                "ours (≤ 300 s) (2026-11-28 10:02, code e0aa12)": {FIRST: 1},
            },
        ),
        (
            [seeded(0.9, seed, config={"width": seed}) for seed in range(3)],
            {f"ours (≤ 300 s) (2026-01-01 00:00, code ?){number}": {FIRST: 1} for number in ("", " #2", " #3")},
        ),
        ([of_options("a=1", "b=2", seed=0), of_options("b=2", "a=1", seed=1)], {"ours (a=1, b=2)": {FIRST: 2}}),
        (
            [external(file="a"), external(SECOND, file="b"), external(seed=1, file="c")],
            {"theirs (external)": {FIRST: 2, SECOND: 1}},
        ),
        (
            [*file_of("b", (SECOND, THIRD), 2), *file_of("a", (FIRST, SECOND), 1)],
            {
                "theirs (external) (2026-01-01 00:00, file aaaaaa)": {FIRST: 1, SECOND: 1},
                "theirs (external) (2026-01-02 00:00, file bbbbbb)": {SECOND: 1, THIRD: 1},
            },
        ),
    ],
    ids=["versions", "configurations", "options in another order", "files share no part", "files share a part"],
)
def test_rows_are_named_by_what_tells_them_apart(records: list[RunRecord], rows: dict) -> None:
    (board,) = boards(records)
    assert {row.label: {split: len(of) for split, of in row.by_split.items()} for row in board.rows} == rows


@pytest.mark.parametrize("options", [(), ("a=1", "b=2")])
def test_a_label_without_its_budget_is_that_of_a_run_without_one(options: tuple[str, ...]) -> None:
    plain, limited = (
        only_row(make_record("ours", job=Job("data.h5", "ours", "lofo", SPLITS[1], options, budget=budget)))
        for budget in (Budget(), Budget(max_steps=9, max_seconds=1.5))
    )
    assert limited.short_label == plain.label and limited.budget in limited.label


def test_a_board_has_one_budget_and_trivial_predictors_stand_on_every_one() -> None:
    def fitted(name: str, budget: Budget, ssim: float) -> RunRecord:
        return make_record(name, ssim, SPLITS[0], job=Job("data.h5", name, "lofo", SPLITS[0], budget=budget))

    trivial = [make_record(name, 0.8, SPLITS[0]) for name in NEEDED_TRIVIAL]
    quick, minutes, own = BUDGETS["quick"], BUDGETS["minutes"], Budget(max_steps=9)
    records = [
        *trivial,
        *(fitted("ours", budget, 0.9) for budget in (quick, minutes, own, Budget())),
        fitted("theirs", quick, 0.85),
        external(method="elsewhere"),
    ]
    found = {
        board.lane_title: [row.short_label for row in board.rows if not row.is_trivial] for board in boards(records)
    }
    assert found == {
        "quick (≤ 64,000 maps)": ["ours", "theirs"],
        "": ["elsewhere (external)", "ours"],
        "minutes (≤ 300 s)": ["ours"],
        "≤ 9 steps": ["ours"],
    }
    assert all(board.best_trivial[SPLITS[0]] == 0.8 for board in boards(records))
    assert len({board.slug for board in boards(records)}) == len(found)
    (together,) = boards(records, by_budget=False)
    assert len(together.rows) == len(NEEDED_TRIVIAL) + 6


def test_a_trivial_predictor_that_was_added_later_sets_skill_where_it_was_run() -> None:
    trivial = [make_record(name, 0.8, split) for name in NEEDED_TRIVIAL for split in SPLITS[:2]]
    (board,) = boards([*trivial, make_record("k-nearest", 0.9, SPLITS[0])])
    assert [board.best_trivial[split] for split in SPLITS[:2]] == [0.9, 0.8]
    assert {row.family for row in board.rows} == {"trivial"}
    (alone,) = boards([make_record("k-nearest", 0.9, SPLITS[0])])
    assert not alone.best_trivial


def test_pooled_quantiles_are_those_of_all_samples_together() -> None:
    draws = [np.random.default_rng(seed).beta(9 - 2 * seed, 2, 4001).round(4) for seed in range(3)]
    exact = quantiles(np.concatenate(draws), np.linspace(0, 1, 101).tolist())
    records = []
    for seed, ssim in enumerate(draws):
        scores = summaries({"ssim": ssim}, np.full(len(ssim), 1e9), np.arange(len(ssim)))
        records.append(seeded(float(np.median(ssim)), seed, **scores))
    assert pooled_quantiles(records, "ssim") == exact.tolist()
    without = [record.model_copy(update={"ssim_by_tx": ()}) for record in records]
    pooled = np.array(pooled_quantiles(without, "ssim"))
    assert (pooled[0], pooled[-1]) == (exact[0], exact[-1])
    level = np.searchsorted(np.sort(np.concatenate(draws)), pooled[1:-1]) / 12003
    assert level == pytest.approx(np.arange(1, 100) / 100, abs=0.004)  # some way into a step of 0.01, on no side
    assert np.mean(level - np.arange(1, 100) / 100) == pytest.approx(0, abs=5e-4)
    assert pooled_quantiles(without[:1], "ssim") == records[0].scores["ssim"].quantiles


def test_external_predictions_are_marked_and_a_built_in_name_merges_with_nothing() -> None:
    trivial = [make_record(name, 0.8, SPLITS[0]) for name in NEEDED_TRIVIAL]
    (board,) = boards([*trivial, external(method="nearest")])
    assert [(row.label, row.is_trivial, row.family) for row in board.rows] == [
        ("nearest (external)", False, "external"),
        *((name, True, "trivial") for name in sorted(NEEDED_TRIVIAL)),
    ]
    assert board.best_trivial[SPLITS[0]] == 0.8
