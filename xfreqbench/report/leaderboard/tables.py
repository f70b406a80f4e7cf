"""The tables of boards: the ranking as Markdown, and everything else as rows of CSV. Numbers are means over seeds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import isnan
from pathlib import Path
from typing import Any

from xfreqbench.report.drawing.markdown import paragraph, table
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.captions import notes
from xfreqbench.report.leaderboard.columns import OTHER_SCORES, RANKING, TABLE, LeaderboardColumn, leaderboard_columns
from xfreqbench.report.leaderboard.comparison import Comparison, comparisons_of
from xfreqbench.report.leaderboard.learning_curves import learning_curves
from xfreqbench.report.leaderboard.rows import BoardRow, median_ssim
from xfreqbench.runs.records import CURVE_SHARES
from xfreqbench.system.files import atomic_path, require_own, storage_errors, write_columns
from xfreqbench.units import format_ghz

CsvRow = dict[str, Any]
_FIRST = b"scene,protocol,maps,data,", b"measurement,"  # what begins so was written by us, and may be replaced


def ranking_tables(board: Board) -> list[str]:
    """The ranking for every set of splits that rows share, and for the lone splits."""
    return list(map(ranking_table, comparisons_of(board)))


def ranking_table(comparison: Comparison, columns: Sequence[str] = RANKING) -> str:
    """The rows of a comparison, the best average of median SSIM first, with a caption above and notes below.

    `columns` are names that `leaderboard_columns` knows, such as `BRIEF`. An interval stands in the cell of its number.
    """
    num_splits = len(comparison.splits)
    where = f" on {num_splits} splits, best average first" if num_splits > 1 else ", best first"
    caption = f"Median SSIM{where}; order within overlapping ranks means nothing:"
    shown = leaderboard_columns(comparison, columns)
    rows = [[column.cell(row) for column in shown] for row in comparison.rows]
    below = map(paragraph, notes(comparison))
    return "\n\n".join([caption, table([column.title for column in shown], rows), *below])


def other_scores_table(comparison: Comparison) -> str:
    """The scores of the rows of a comparison that `ranking_table` does not have, in the same order."""
    shown = leaderboard_columns(comparison, OTHER_SCORES)
    rows = [[column.text(row) for column in shown] for row in comparison.rows]
    caption = "Mean and 10th percentile of SSIM, and medians of the other metrics:"
    return f"{caption}\n\n{table([column.title for column in shown], rows)}"


def csv_tables(boards: Sequence[Board]) -> dict[str, list[CsvRow]]:
    """What stands in files beside the pages of boards, by the endings of their names; tables without rows are left out.

    `scores` has every metric and cost on every set of splits and every split alone, `pairs` which ranked row beats
    which, and `curves` the learning curves.
    """
    found = {
        "scores": [row for board in boards for row in _scores(board)],
        "pairs": [row for board in boards for compared in comparisons_of(board) for row in _pairs(compared)],
        "curves": [row for board in boards for row in _curves(board)],
    }
    return {name: rows for name, rows in found.items() if rows}


def measurement_rows(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> list[CsvRow]:
    """The rows of a measurement; columns of one name are numbered."""
    names = [f"{name} {place}" if columns.count(name) > 1 else name for place, name in enumerate(columns, 1)]
    return [{"measurement": title, **dict(zip(names, row, strict=True))} for row in rows]


def write_csv(rows: Sequence[CsvRow], output_csv: Path) -> list[str]:
    """Write rows as CSV, splits joined by blanks; returns the names of the columns, which are those of all rows.

    Raises `OutputExistsError` where the file is another one, and `StorageError`.
    """
    require_own_csv(output_csv)
    names = list(dict.fromkeys(name for row in rows for name in row))
    told = [row | ({"splits": " ".join(row["splits"])} if "splits" in row else {}) for row in rows]
    with atomic_path(output_csv) as temporary, storage_errors(output_csv):
        write_columns(temporary, {name: [row.get(name) for row in told] for name in names})
    return names


def require_own_csv(output_csv: Path) -> None:
    """Raise `OutputExistsError` where the file exists and is no table of ours."""
    require_own(output_csv, lambda path: None if path.read_bytes().startswith(_FIRST) else "is no table of ours")


def table_rows(comparisons: Iterable[Comparison]) -> list[CsvRow]:
    """The rows of comparisons, each with its cells by their titles."""
    return [row for comparison in comparisons for row in _table_rows(comparison)]


def _table_rows(comparison: Comparison) -> list[CsvRow]:
    columns = leaderboard_columns(comparison, TABLE)
    return [
        _place(comparison.board, comparison.splits)
        | {name: cell for column in columns for name, cell in _cells(column, row).items()}
        for row in comparison.rows
    ]


def _place(board: Board, splits: Sequence[str]) -> CsvRow:
    """The columns that say what a row is of."""
    return {
        "scene": board.scene,
        "protocol": board.protocol,
        "maps": board.pas_kind,
        "data": board.data_name,
        "budget": board.lane_title,
        "splits": tuple(splits),
    }


def _cells(column: LeaderboardColumn, row: BoardRow) -> CsvRow:
    if column.value is None:
        return {column.title: column.text(row)}
    low, high = column.bounds(row)
    ends = {} if isnan(low) else {f"{column.title} low": low, f"{column.title} high": high}
    return {column.title: column.value(row), **ends}


def _scores(board: Board) -> Iterator[CsvRow]:
    """The rows on every set of splits, and on every split alone, there with the median SSIM at each tested carrier."""
    sets = [splits for splits in board.split_sets() if len(splits) > 1]
    yield from table_rows(Comparison(board, splits) for splits in sets)
    for split in board.splits:
        comparison = Comparison(board, (split,))
        for row, cells in zip(comparison.rows, _table_rows(comparison), strict=True):
            medians = [record.scores["ssim"].median_by_carrier_hz for record in row.by_split[split]]
            carriers = sorted(set.intersection(*map(set, medians)), key=float) if len(medians[0]) > 1 else ()
            yield cells | {
                f"SSIM at {format_ghz(float(carrier))}": sum(by_hz[carrier] for by_hz in medians) / len(medians)
                for carrier in carriers
            }


def _pairs(comparison: Comparison) -> Iterator[CsvRow]:
    """Each ranked row beside every one behind it; trivial predictors behind the best are left out beside others."""
    ranked = comparison.ranked_rows
    trivial = [row for row in ranked if row.is_trivial]
    rows = [row for row in ranked if len(trivial) == len(ranked) or row not in trivial[1:]]
    for place, row in enumerate(rows):
        for other in rows[place + 1 :]:
            low, high = comparison.difference(row, other)
            averages = [each.average(comparison.splits, median_ssim) for each in (row, other)]
            yield _place(comparison.board, comparison.splits) | {
                "method": row.label,
                "other": other.label,
                "difference": round(averages[0] - averages[1], 6),
                "low": round(low, 6),
                "high": round(high, 6),
            }


def _curves(board: Board) -> Iterator[CsvRow]:
    """The points of learning curves: by share of the budget, seconds of fitting and median SSIM on a sample of maps."""
    for curve in learning_curves(board, board.splits):
        for share, point in zip((*CURVE_SHARES, 1.0), curve.points, strict=True):
            if point:
                yield _place(board, (short_name(curve.split),)) | {
                    "method": curve.row.label,
                    "share": share,
                    "seconds": round(point.seconds, 3),
                    "SSIM": round(point.ssim, 5),
                    "best trivial reached after s": curve.seconds_to_beat_trivial,
                }
