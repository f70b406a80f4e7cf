from __future__ import annotations

import numpy as np
import pytest

from tests.support.stored_records import make_record, make_summary
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.comparison import Comparison, medians_of, resampled_medians
from xfreqbench.runs.records import Job, RunRecord

SPLIT = "lofo-24.25GHz"
NUM_TX = 60


def samples(shift: float = 0.0, noise_seed: int = 0, num_tx: int = NUM_TX, split: str = SPLIT):
    """SSIM of a transmitter: what its place makes of it, the same for all methods, and a little noise."""
    place = np.random.default_rng(len(split)).normal(0.85, 0.05, num_tx)
    noise = np.random.default_rng(noise_seed).normal(0, 0.01, num_tx)
    return [(float(value),) for value in np.round(place + noise + shift, 4)]


def scored(method: str, ssim_by_tx, seed: int = 0, split: str = SPLIT) -> RunRecord:
    median = float(np.median([value for each in ssim_by_tx for value in each]))
    job = Job("data.h5", method, "lofo", split, seed=seed)
    return make_record(method, median, split, job=job, ssim_by_tx=ssim_by_tx, scores={"ssim": make_summary(median)})


def seeds_of(method: str, shift: float, first_noise: int, num_seeds: int = 3, **where) -> list[RunRecord]:
    return [
        scored(method, samples(shift, first_noise + seed, **where), seed, where.get("split", SPLIT))
        for seed in range(num_seeds)
    ]


def compared(*records: RunRecord, splits=(SPLIT,)):
    (board,) = boards(records)
    comparison = Comparison(board, tuple(splits))
    return comparison, {row.label: row for row in comparison.rows}


def test_a_method_better_by_two_hundredths_on_every_transmitter_beats_the_other() -> None:
    comparison, row = compared(*seeds_of("better", 0.02, 10), *seeds_of("worse", 0.0, 20))
    assert comparison.beats(row["better"], row["worse"])
    assert not comparison.beats(row["worse"], row["better"])
    assert (comparison.ranks(row["better"]), comparison.ranks(row["worse"])) == ((1, 1), (2, 2))
    low, high = comparison.difference(row["better"], row["worse"])
    assert low < 0.02 < high


def test_two_draws_of_the_same_distribution_are_level() -> None:
    comparison, row = compared(*seeds_of("one", 0.0, 10), *seeds_of("other", 0.0, 20))
    low, high = comparison.difference(row["one"], row["other"])
    assert low < 0 < high
    assert comparison.ranks(row["one"]) == comparison.ranks(row["other"]) == (1, 2)


def test_a_difference_and_its_opposite_have_mirrored_intervals() -> None:
    comparison, row = compared(*seeds_of("one", 0.005, 10), *seeds_of("other", 0.0, 20))
    there, back = (comparison.difference(row["one"], row["other"]), comparison.difference(row["other"], row["one"]))
    assert there == pytest.approx((-back[1], -back[0]), abs=1e-3)  # quantiles are values: one of 1,000 further


def test_paired_differences_are_narrower_than_unpaired_ones() -> None:
    comparison, row = compared(*seeds_of("one", 0.0, 10), *seeds_of("other", 0.0, 20))
    low, high = comparison.difference(row["one"], row["other"])
    medians = [medians_of(comparison.board, row[name], [SPLIT])[0] for name in ("one", "other")]
    shuffled = np.random.default_rng(0).permutation(medians[1])
    unpaired = np.quantile(medians[0] - shuffled, [0.025, 0.975])
    assert high - low < 0.6 * (unpaired[1] - unpaired[0])  # noise is a fifth of what the places make


def test_a_method_of_one_seed_is_not_ranked_and_a_trivial_predictor_is() -> None:
    comparison, row = compared(scored("ours", samples(0.1)), scored("nearest", samples()))
    assert comparison.ranks(row["ours"]) is None
    assert comparison.ranks(row["nearest"]) == (1, 1)
    low, high = comparison.interval(row["ours"])  # its transmitters still say something
    assert low < comparison.rows[0].average([SPLIT]) < high


def test_a_method_with_a_seed_less_on_one_split_is_not_ranked_over_both() -> None:
    other = "lofo-2.4GHz"
    records = [*seeds_of("ours", 0.0, 10), *seeds_of("ours", 0.0, 20, num_seeds=2, split=other)]
    comparison, row = compared(*records, splits=(SPLIT, other))
    assert comparison.ranks(row["ours"]) is None


def test_without_samples_or_trivial_predictors_intervals_are_unknown() -> None:
    comparison, row = compared(make_record("nearest"), make_record("ours"))
    assert comparison.ranks(row["nearest"]) is None
    for interval in (comparison.interval(row["ours"]), comparison.skill_interval(row["ours"])):
        assert np.isnan(interval).all()
    comparison, row = compared(*seeds_of("ours", 0.0, 10))
    assert np.isnan(comparison.skill_interval(row["ours"])).all()


def test_the_skill_of_the_best_trivial_predictor_may_be_zero_and_never_more() -> None:
    level = [scored(name, samples(0.0, seed)) for seed, name in enumerate(NEEDED_TRIVIAL, start=1)]
    comparison, row = compared(*level, *seeds_of("ours", 0.05, 10))
    low, high = comparison.skill_interval(comparison.rows[1])
    assert comparison.rows[1].is_trivial
    assert low < 0 == high
    assert comparison.skill_interval(row["ours"])[0] > 0.2  # a third of the 0.15 left open is closed


def _literally(ssim_by_tx):
    """Resample, list every sample of every drawn transmitter, take the median."""
    number = len(ssim_by_tx)
    drawn = np.random.default_rng(number).integers(number, size=(1000, number))
    return np.array([np.median(np.concatenate([ssim_by_tx[index] for index in each])) for each in drawn])


@pytest.mark.parametrize("lengths", [[1] * 7, [3] * 6, [1, 4, 2, 10, 3, 1], [60] * 10, [1] * 30 + [200]])
def test_resampled_medians_are_those_of_a_literal_loop(lengths: list[int]) -> None:
    generator = np.random.default_rng(0)
    ssim_by_tx = [tuple(map(float, generator.integers(0, 30, length) / 30)) for length in lengths]  # with ties
    np.testing.assert_array_equal(resampled_medians([ssim_by_tx])[0], _literally(ssim_by_tx))


def in_cells(records, num_cells: int):
    cell_of_tx = tuple(range(num_cells)) * (NUM_TX // num_cells)
    return [record.model_copy(update={"cell_of_tx": cell_of_tx}) for record in records]


def test_an_interval_is_that_of_whole_cells_and_not_of_their_transmitters() -> None:
    """A transmitter whose score is that of its cell adds nothing, however many stand there."""
    of_cells = samples(num_tx=12)
    few, many = (scored("ours", of_cells * number) for number in (1, NUM_TX // 12))
    intervals = [compared(*each)[0] for each in ([few], [many], in_cells([many], 12))]
    alone, as_if_independent, by_cell = (each.interval(each.rows[0]) for each in intervals)
    assert by_cell == alone
    assert np.ptp(as_if_independent) < 0.7 * np.ptp(alone)


def test_records_that_do_not_say_their_cells_are_drawn_by_those_of_the_others() -> None:
    told, untold = in_cells(seeds_of("told", 0.0, 10), 12), seeds_of("untold", 0.0, 20)
    comparison, row = compared(*told, *untold)
    every, of_every = compared(*told, *in_cells(untold, 12))
    assert comparison.difference(*row.values()) == every.difference(*of_every.values())


def test_splits_of_different_length_are_averaged() -> None:
    other = "lofo-2.4GHz"
    records = [
        record
        for split, num_tx in ((SPLIT, 60), (other, 35))
        for record in (
            *seeds_of("better", 0.02, 10, split=split, num_tx=num_tx),
            *seeds_of("worse", 0.0, 20, split=split, num_tx=num_tx),
        )
    ]
    comparison, row = compared(*records, splits=(SPLIT, other))
    single, _ = compared(*records, splits=(SPLIT,))
    assert comparison.beats(row["better"], row["worse"])
    widths = [high - low for low, high in (each.interval(row["worse"]) for each in (comparison, single))]
    assert widths[0] < widths[1]  # an average of two is steadier than one of them


def test_seeds_that_scatter_widen_the_interval() -> None:
    scattered = [scored("scattered", samples(shift, 10 + seed), seed) for seed, shift in enumerate((-0.03, 0, 0.03))]
    comparison, row = compared(*scattered, *seeds_of("steady", 0.0, 10))
    widths = {name: np.ptp(comparison.interval(each)) for name, each in row.items()}
    assert widths["scattered"] > 1.3 * widths["steady"]  # seeds scatter by 0.03, the median of places by 0.01


def level_methods(number: int, trial: int) -> list[RunRecord]:
    """Three seeds each of methods that are equally good, and scatter."""
    shifts = np.random.default_rng(trial).normal(0, 0.03, (number, 3))
    return [
        scored(f"method {which}", samples(float(shift), 1000 * trial + 10 * which + seed), seed)
        for which, of_method in enumerate(shifts)
        for seed, shift in enumerate(of_method)
    ]


def test_methods_that_are_level_are_seldom_told_apart_by_three_seeds_that_scatter() -> None:
    num_told_apart, num_trials = 0, 50
    for trial in range(num_trials):
        comparison, row = compared(*level_methods(2, trial))
        num_told_apart += sum(comparison.beats(one, other) for one in row.values() for other in row.values())
    assert num_told_apart / num_trials < 0.12  # nominally 0.05; 0.14 where deviations are not widened


def test_among_many_equal_methods_few_pairs_are_told_apart() -> None:
    """Of 45 pairs two would be, if each were looked at alone."""
    num_told_apart, num_alone, num_trials = 0, 0, 20
    for trial in range(num_trials):
        comparison, row = compared(*level_methods(10, trial))
        pairs = [(one, other) for one in row.values() for other in row.values() if one is not other]
        num_told_apart += any(comparison.beats(*pair) for pair in pairs)
        num_alone += any(comparison.difference(*pair)[0] > 0 for pair in pairs)
    assert num_alone / num_trials > 0.5
    assert num_told_apart / num_trials < 0.3  # three seeds that scatter have heavier tails than a normal distribution
