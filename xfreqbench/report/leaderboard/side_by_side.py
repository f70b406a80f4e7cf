"""Two sets of results side by side: the same rows of both, paired by transmitters, with intervals of the difference.

A pair is the comparison of a board whose two rows are one of A and one of B.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import isnan
from pathlib import Path

from xfreqbench.data.recipe import recipe_name
from xfreqbench.errors import DataError
from xfreqbench.report.drawing.markdown import ABSENT, number, paragraph, table
from xfreqbench.report.leaderboard.boards import (
    Board,
    BoardRow,
    boards,
    comparable,
    record_key,
    require_same_samples,
    short_commit,
    short_name,
    version_of,
)
from xfreqbench.report.leaderboard.captions import leak_statement
from xfreqbench.report.leaderboard.columns import COSTS, OTHER_METRICS, columns
from xfreqbench.report.leaderboard.comparison import MIN_SEEDS, Comparison
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import RunRecord

NOTHING_WORSE = "Nothing: no interval of a difference lies below zero (rooms that were never seen are not compared)."
WORSE_HEADER = ("board", "method", "before", "now", "difference, 95 % interval", "what is different")


def compare_results(a: Path, b: Path) -> str:
    """Tables, as Markdown, of what two sets of results have in common, and how B differs from A.

    A set is a results folder, a file of records, the records of one method, such as `results/mine`, those of one
    version of it, such as `results/mine@3fa9c1`, or one record by its id or the first digits of it, such as
    `results/0123456789abcdef`. Rows with the same label (method, options and budget) are paired. Then the rows of a
    method that has one unpaired row in each set, the only unpaired row of each set, and at last every unpaired row of A
    with the newest row of its method in B. If A has one row, it is the reference of all rows of B. No record is
    compared with itself. Raises `DataError` where there are no records, or none that may be compared.
    """
    of_a, of_b = (
        {comparable(board.records[0]): board for board in boards(_records_at(path), by_budget=False)} for path in (a, b)
    )
    sections = [section for key in of_a if key in of_b and (section := _section(of_a[key], of_b[key]))]
    if not sections:
        content = _content_of(of_a) or "no board", _content_of(of_b) or "no board"
        raise DataError(
            f"Nothing in {a} and {b} can be compared: {'; and '.join(content)}. Records are not compared with "
            "themselves; name two methods, as in results/nearest, or two versions of one, as in results/mine@3fa9c1. "
            "Runs in rooms that were never seen are compared by `xfreqbench report` alone."
        )
    return "\n\n".join([f"A: {a}, B: {b}", *sections])


def got_worse(before: Sequence[RunRecord], after: Sequence[RunRecord]) -> list[list[str]]:
    """Cells under `WORSE_HEADER` for every learned row whose average median SSIM fell, with the whole interval below 0.

    Rows of the same scene, protocol and label are compared on the splits of both, on other data too: what is
    different of data, code, options and machine is told, as the reason. The largest loss comes first.
    """
    old, new = map(_boards_by_place, (before, after))
    found = []
    for place in new.keys() & old.keys():
        known = {row.label: row for row in old[place].rows}
        for row in new[place].rows:
            if row.is_trivial or row.label not in known:
                continue
            pair = _pair(old[place], known[row.label], row)
            a, b = pair.board.rows
            if pair.splits and b.average(pair.splits) < a.average(pair.splits) and pair.difference(b, a)[1] < 0:
                cells = [", ".join(place[:2]), row.label, *_ssim_cells(pair)[3:6], _what_is_different(pair)]
                found.append((float(cells[4].split()[0]), cells))
    return [cells for _, cells in sorted(found)]


def _records_at(path: Path) -> Sequence[RunRecord]:
    """The records of a results folder or a file; of `FOLDER/NAME`, those in the folder with this method or id.

    `FOLDER/METHOD@DIGITS` are those of the version of a method whose code's hash begins so.
    """
    beside = ResultsFolder(path.parent).records if not path.exists() else ()
    if not beside:
        return read_results(path).records
    of_method = [record for record in beside if record.job.method == path.name]
    if of_method:
        return of_method
    method, _, digits = path.name.rpartition("@")
    if of_method := [record for record in beside if record.job.method == method]:
        of_version = [record for record in of_method if version_of(record)[0].startswith(digits)]
        if digits and of_version:
            return of_version
        newest_first = sorted(of_method, key=lambda record: record.time_utc, reverse=True)
        versions = {f"{method}@{version[:6]}": time for version, time in map(version_of, newest_first)}
        listed = ", ".join(f"{name} ({time})" for name, time in versions.items())
        raise DataError(f"{path.parent} has no version {path.name} of the method; newest first, it has {listed}.")
    chosen = {record.id: record for record in beside if record.id.startswith(path.name)}
    if len(chosen) != 1:
        known = sorted(chosen or {record.id for record in beside})
        more = f" and {len(known) - 6} more" if len(known) > 6 else ""
        raise DataError(
            f"{path} is no results folder, names none of the methods of {path.parent}, which are "
            f"{', '.join(sorted({record.job.method for record in beside}))}, and begins the ids of {len(chosen)} "
            f"records there, where one is needed; there are {', '.join(known[:6])}{more}."
        )
    return list(chosen.values())


def _pair(board: Board, a: BoardRow, b: BoardRow) -> Comparison:
    """The pair on the splits of both. The labels of its rows begin with A and B, because they have to differ."""
    splits = Comparison.of(board, a, b).splits
    rows = replace(a, label=f"A {a.label}"), replace(b, label=f"B {b.label}")
    return Comparison(replace(board, splits=splits, rows=rows), splits)


def _label(pair: Comparison) -> str:
    """The names of the rows, or one name if both have the same."""
    return " and ".join(dict.fromkeys(row.label.partition(" ")[2] for row in pair.board.rows))


def _boards_by_place(records: Sequence[RunRecord]) -> dict[tuple[str, ...], Board]:
    """The board with most runs of each scene and protocol, and versions of protocol and metrics."""
    ordered = sorted(boards(records, by_budget=False), key=lambda board: len(board.records))
    return {
        (board.scene, board.protocol, board.records[0].protocol_version, board.records[0].metrics_version): board
        for board in ordered
    }


def _what_is_different(pair: Comparison) -> str:
    a, b = (row.by_split[pair.splits[0]][0] for row in pair.board.rows)
    commits = f" (commit {short_commit(a.git_commit)}, now {short_commit(b.git_commit)})"
    different = {
        f"the data ({recipe_name('', a.recipe)}, now {recipe_name('', b.recipe)})": a.recipe != b.recipe,
        "its options' defaults": a.config != b.config,
        f"its code{commits}": a.code_sha256 != b.code_sha256,
        "the machine": a.hardware != b.hardware,
    }
    return ", ".join(words for words, is_so in different.items() if is_so) or f"nothing of it{commits}"


def _section(a: Board, b: Board) -> str:
    """The tables of two boards of the same data set and protocol; empty where they have no rows in common.

    Raises `DataError` where they test other samples.
    """
    require_same_samples(a.scene, a.data, [*a.records, *b.records])
    pairs = [pair for rows in _paired_rows(a, b) if (pair := _pair(a, *rows)).splits]
    if not pairs:
        return ""
    header = ("method", "splits", "seeds", "A", "B", "B − A, 95 % interval", "B is")
    parts = [
        f"{paragraph(a.title)}. {leak_statement(a)}",
        "Median SSIM, mean over splits and seeds; the difference is paired by transmitters:",
        table(header, map(_ssim_cells, pairs)),
        "Medians of the other scores, and costs, A → B:",
        _other_table(pairs),
        *map(paragraph, _notes(a, b, pairs)),
    ]
    return "\n\n".join(parts)


def _paired_rows(a: Board, b: Board) -> Iterator[tuple[BoardRow, BoardRow]]:
    """Rows with the same label; then the only row of a method in A and in B; then the only row of A and of B.

    Rows that are already paired do not count. What is left of A is paired with the newest row of its method in B. A
    lone row of A is a reference, with which every row of B is paired. No row is paired with its own records.
    """
    if len(a.rows) == 1 < len(b.rows):
        yield from ((a.rows[0], row) for row in b.rows if not _share_records(a.rows[0], row))
        return
    names: list[Callable[[BoardRow], str]] = [lambda row: row.label, lambda row: row.job.method, lambda row: ""]
    left_a, left_b = list(a.rows), list(b.rows)
    for name in names:
        for row in tuple(left_a):
            in_a, in_b = ([other for other in left if name(other) == name(row)] for left in (left_a, left_b))
            if len(in_a) == len(in_b) == 1 and not _share_records(row, in_b[0]):
                yield row, in_b[0]
                left_a.remove(row)
                left_b.remove(in_b[0])
    for row in left_a:
        of_method = [other for other in b.rows if other.job.method == row.job.method]
        newest = max(of_method, key=lambda other: other.time_utc, default=row)
        if not _share_records(row, newest):
            yield row, newest


def _share_records(row: BoardRow, other: BoardRow) -> bool:
    known = {record_key(record): record for record in row.records}
    return any(known.get(record_key(record)) == record for record in other.records)


def _ssim_cells(pair: Comparison) -> list[str]:
    a, b = pair.board.rows
    before, after = a.average(pair.splits), b.average(pair.splits)
    low, high = pair.difference(b, a)
    interval = "" if isnan(low) else f" [{low:+.4f}, {high:+.4f}]"
    verdict = ABSENT if isnan(low) else "better" if low > 0 else "worse" if high < 0 else "="
    seeds = " and ".join(str(row.num_seeds(pair.splits)[0]) for row in (a, b))
    shown = ", ".join(map(short_name, pair.splits))
    difference = f"{after - before:+.4f}{interval}"
    return [_label(pair), shown, seeds, number(before, 4), number(after, 4), difference, verdict]


def _other_table(pairs: Sequence[Comparison]) -> str:
    found = []
    for pair in pairs:
        a, b = pair.board.rows
        shown = columns(pair, (*OTHER_METRICS, *COSTS))
        found.append({column.title: f"{column.text(a)} → {column.text(b)}" for column in shown})
    titles = list(dict.fromkeys(title for cells in found for title in cells))
    rows = [
        [_label(pair), *(cells.get(title, ABSENT) for title in titles)]
        for pair, cells in zip(pairs, found, strict=True)
    ]
    return table(["method", *titles], rows)


def _notes(a: Board, b: Board, pairs: Sequence[Comparison]) -> list[str]:
    """What the intervals do not say, and what the tables leave out."""
    few = [
        _label(pair)
        for pair in pairs
        if not isnan(pair.difference(*pair.board.rows[::-1])[0])
        and not all(map(pair.has_enough_seeds, pair.board.rows))
    ]
    said = [
        f"Of fewer than {MIN_SEEDS} seeds: {', '.join(few)}. Another seed may change the difference by more than the "
        "interval says."
    ] * bool(few)
    shown = {row.label for pair in pairs for row in pair.board.rows}
    for side, board, other in (("A", a, b), ("B", b, a)):
        alone = [
            row.label
            for row in board.rows
            if f"{side} {row.label}" not in shown and not any(_share_records(row, each) for each in other.rows)
        ]
        said += [f"Only in {side}: {', '.join(alone)}."] if alone else []
    return said


def _content_of(found: Mapping[tuple[object, ...], Board]) -> str:
    """Data sets, protocols and methods of a set of results, the first of each."""

    def first(texts: Sequence[str], number: int) -> str:
        more = len(texts) - number
        return ", ".join(texts[:number]) + (f" and {more} more" if more > 0 else "")

    told = []
    for board in found.values():
        versions = f"{board.records[0].protocol_version} and {board.records[0].metrics_version} of protocol and metrics"
        rows = first([row.label for row in board.rows], 8)
        told.append(f"{board.title} of data {board.data_name}, versions {versions} ({rows})")
    return first(told, 2)
