"""The sentences around a board's tables: its data, its machines, what training and test share, what columns say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from xfreqbench.data.splits import HELD_OUT_RECEIVER, VALIDATIONS
from xfreqbench.maps.metrics import METRICS, NUM_RESAMPLES
from xfreqbench.methods.trivial import EVERY_TRIVIAL, NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.boards import (
    Board,
    BoardRow,
    machine_name,
    published,
    record_key,
    short_commit,
    short_name,
)
from xfreqbench.report.leaderboard.columns import COSTS, metric_title
from xfreqbench.report.leaderboard.comparison import MIN_SEEDS, Comparison
from xfreqbench.runs.records import LEAST_CORE_SHARE, RunRecord


def leak_statement(board: Board) -> str:
    """Whether tested transmitters are also trained on and, if not, how far away the nearest trained one is.

    Of a board of validation rows it first says what they are.
    """
    if board.protocol not in VALIDATIONS:
        return _shared_with_training(board)
    return (
        f"Validation rows: some of the training rows of the {VALIDATIONS[board.protocol]} split that a column is named "
        f"for. They choose settings, and are no result of a test. {_shared_with_training(board)}"
    )


def _shared_with_training(board: Board) -> str:
    if VALIDATIONS.get(board.protocol, board.protocol) == "random-samples":
        return (
            "Samples were drawn at random: tested transmitters are trained on at other carriers, and tested carriers "
            "at other transmitters, so that these scores say nothing about unseen places or unseen carriers."
        )
    if board.protocol == HELD_OUT_RECEIVER:
        return (
            "Nothing heard at the tested receiver is trained on; the tested transmitters and carriers are, at the "
            "other receivers of the file."
        )
    if any(record.shares_transmitters for record in board.records):
        return "Tested transmitters are trained on at other carriers: these scores say nothing about unseen places."
    known_m = [record.nearest_trained_m for record in board.records if record.nearest_trained_m is not None]
    nearest = ""
    if known_m:
        distances = dict.fromkeys(f"{distance_m:.2f} m" for distance_m in (min(known_m), max(known_m)))
        nearest = f"; the nearest trained one is {' to '.join(distances)} away (median)"
    return f"No tested transmitter is trained on at any carrier{nearest}."


def data_statement(board: Board) -> str:
    """The data set, the kind of its maps, as far as it is known how they were traced, and how many are tested."""
    settings = board.settings
    parts = [f"{board.pas_kind} maps"]
    if "solver" in settings:
        solvers = {str(record.settings.get("solver")) for record in board.records}
        parts.append(f"{' and '.join(sorted(solvers))} solver")
    if isinstance(settings.get("interactions"), list):
        parts.append(" and ".join(map(str, settings["interactions"])) or "no interactions")
    if "max_depth" in settings:
        parts.append(f"depth {settings['max_depth']}")
    # backticks are ours
    name, words = (text.replace("`", "'") for text in (board.data_name, ", ".join(parts)))
    tested, left_out = (
        " or ".join(f"{number:,}" for number in sorted(numbers))
        for numbers in (
            {record.num_test for record in board.records},
            {record.num_without_path for record in board.records if record.num_without_path},
        )
    )
    without = f"; {left_out} without any path are left out" if left_out else ""
    return f"Data set `{name}`: {words}; {tested} test maps a split{without}"


def origin_statement(board: Board) -> str:
    """The machines on which the times were taken, the commits of the code, and the seeds."""
    machines = machine_names(board.records)
    commits = sorted({short_commit(record.git_commit) for record in board.records})
    seeds = sorted({str(record.job.seed) for record in board.records}, key=int)
    counted = [
        f"{name}{'s' * (len(all_) > 1)} {', '.join(all_)}" for name, all_ in (("Commit", commits), ("seed", seeds))
    ]
    return (f"Times were taken on {'; '.join(machines)}. " if machines else "") + f"{'; '.join(counted)}."


def facts(ranked: Sequence[Board]) -> dict[str, list[str]]:
    """Data sets, machines, commits and dates of all records, each fact with its lines."""
    records = list({record_key(record): record for board in ranked for record in board.records}.values())
    days = sorted({record.time_utc[:10] for record in records})
    return {
        "Data": sorted({f"{board.scene}, {board.pas_kind} maps, {board.data_name}" for board in ranked}),
        "Machines": machine_names(records) or ["none: every row is external"],
        "Commits": [", ".join(sorted({short_commit(record.git_commit) for record in records}))],
        "Runs": [f"{len(records):,}, {' to '.join(dict.fromkeys((days[0], days[-1])))}"],
    }


def machine_names(records: Sequence[RunRecord]) -> list[str]:
    """The machines on which records were made, each once, sorted; external records have none."""
    return sorted({machine_name(record.hardware) for record in records if record.external is None})


def notes(comparison: Comparison) -> list[str]:
    """Notes below a table of a comparison.

    They say why a rank or a skill is missing; at which carriers methods extrapolate; where the rows come from, if the
    board has several origins; who declares the times of rows that were predicted elsewhere; what reduced
    re-implementations leave out; and which fits ran on a busy machine.
    """
    board, rows, splits = comparison.board, comparison.rows, comparison.splits
    few = [row.short_label for row in rows if not row.is_trivial and row.num_seeds(splits)[0] < MIN_SEEDS]
    seeds = f"Without a rank, which takes {MIN_SEEDS} seeds (--seeds 0,1,2): {', '.join(few)}." if few else ""
    elsewhere = [row.short_label for row in rows if not comparison.is_timed_alike(row)]
    machine = (
        f"Without a rank, as most fits had their seconds on {comparison.timed_on}, and seconds of another machine "
        f"hold more or fewer steps: {', '.join(elsewhere)}."
    )
    run = [{row.job.method for row in board.rows if split in row.by_split} for split in splits]
    needed = [method for method in NEEDED_TRIVIAL if not all(method in methods for methods in run)]
    skill = f"No skill is known, because these were not run on the same splits: {', '.join(needed)}."
    outside = dict.fromkeys(
        f"{short_name(split)} (trained on {band})"
        for split in splits
        for record in rows[0].by_split[split]
        if (band := record.extrapolated_from)
    )
    every = [
        " ".join(filter(None, [seeds, machine if elsewhere else ""])),
        skill if needed else "",
        f"Extrapolated: {', '.join(outside)}." if outside else "",
        _origins_note(board, rows),
        _external_note(rows),
        reduced_statement(rows),
        _busy_note(rows),
    ]
    return [note for note in every if note]


def _origins_note(board: Board, rows: Sequence[BoardRow]) -> str:
    """What the labels of origins mean, and that times do not compare; empty if there is one origin."""
    shown = {board.origin(record) for row in rows for record in row.records}
    by_place: dict[str, list[str]] = {}
    for (place, commit), label in board.origins.items():
        if (place, commit) in shown:
            by_place.setdefault(place, []).append(f"{label} (commit {commit})")
    places = "; ".join(f"{place}: {', '.join(labels)}" for place, labels in by_place.items())
    return f"Origins: {places}. Times compare on one machine alone." if places else ""


def _external_note(rows: Sequence[BoardRow]) -> str:
    """Who declares the times of external rows; empty where there are no such rows."""
    declared = []
    for row in rows:
        if row.is_external:
            sources = [(each.external.hardware, each.external.url) for each in row.records if each.external]
            texts = dict.fromkeys(text for source in sources for text in source if text)
            declared.append(f"{row.label}: {', '.join(texts) or 'hardware not declared'}")
    said = (
        "External rows were predicted elsewhere and are scored here like every other; their times and "
        f"parameters are declared by their authors, or absent (–). {'; '.join(declared)}."
    )
    return said if declared else ""


def _busy_note(rows: Sequence[BoardRow]) -> str:
    """Which rows have fits that got too little of a core; empty where none has."""
    busy = []
    for row in rows:
        shares = [record.core_share for record in row.records if record.core_share < LEAST_CORE_SHARE]
        busy += [f"{row.short_label} ({min(shares):.0%})"] if shares else []
    said = (
        f"Fitted beside busy programs, under {LEAST_CORE_SHARE:.0%} of a core, so that seconds say little: "
        f"{', '.join(busy)}."
    )
    return said if busy else ""


def reduced_statement(rows: Sequence[BoardRow]) -> str:
    """What reduced re-implementations among the rows leave out of the systems they are named for; empty without any."""
    noted = published()["reduced"]
    named = dict.fromkeys(row.job.method for row in rows if not row.is_external and row.job.method in noted)
    reduced = "; ".join(f"{method} for {noted[method]}" for method in named)
    return f"These are reduced re-implementations, not the authors' programs: {reduced}." if named else ""


def sources_of(rows: Sequence[BoardRow]) -> list[dict[str, Any]]:
    """Whose papers and programs methods among the rows are named after: `name`, and addresses `paper` and `program`."""
    methods = {row.job.method for row in rows if not row.is_external}
    return [source for source in published()["source"] if methods & set(source["methods"])]


def legend(is_short: bool = False) -> str:
    """The section that explains every column of a report, or those of a short leaderboard."""
    shown = ["beam_loss"] if is_short else METRICS
    terms = {metric_title(name): METRICS[name].description for name in shown}
    terms["whose"] = (
        "*ours*: of this project; *reduced*: our small version of a published system; *authors' code*: their program, "
        "run here; *self-reported*: run by others; *verified*: run by others, and repeated here"
    )
    if not is_short:
        terms["mean**, **10th pct."] = "mean SSIM of the test maps, and the SSIM that a tenth of them lies below"
    terms |= {
        "skill": "the share of the best baseline's error, 1 − SSIM, that a method removes: 0 is as good, 1 is perfect, "
        f"below 0 is worse. Baselines are {', '.join(EVERY_TRIVIAL)}, on the same split. A dash: one of the first "
        f"{len(NEEDED_TRIVIAL)} was not run. In every resample the best is found again",
        "[low, high]": f"95 % interval, from {NUM_RESAMPLES:,} bootstrap resamples. A resample draws squares of the "
        "floor with all transmitters there, the same ones for every method (paired), and seeds; as seeds are few, "
        "their spread is widened by Student's t. Squares of 1 m, or of a fifth of a floor below 5 m, because scores of "
        "near transmitters are alike: 1 m apart, their correlation is half of that of neighbours. Five of a hundred "
        "intervals miss the true value",
        "rank": "the best and the worst place that the differences allow, in a table that is sorted by averages. Two "
        "methods are told apart at 5 %, corrected for the number of all pairs (Holm). Words say why there is no rank: "
        f"fewer than {MIN_SEEDS} seeds (a baseline needs one), or a budget in seconds on another machine than most",
    }
    if not is_short:
        terms["seeds**, **± seeds"] = (
            "fits of each split, over which every number is a mean, and the standard deviation of the average over them"
        )
        costs = [COSTS[name] for name in ("seconds", "milliseconds", "memory", "parameters")]
        terms |= {title: f"{hint}, mean over splits and seeds" for title, hint, *_ in costs}
    return "\n".join(["## What the columns say", "", *(f"* **{name}**: {words}" for name, words in terms.items())])
