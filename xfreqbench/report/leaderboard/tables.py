"""The tables of boards: rankings as Markdown, every number as rows of CSV and Parquet, and both for Python."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import isnan
from pathlib import Path
from typing import Any

from pydantic import InstanceOf

from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.report.drawing.markdown import paragraph, table
from xfreqbench.report.drawing.templates import SOFTWARE
from xfreqbench.report.leaderboard.boards import Board, boards, comparable, short_name
from xfreqbench.report.leaderboard.captions import leak_statement, notes
from xfreqbench.report.leaderboard.columns import BRIEF, COSTS, OTHER_METRICS, Column, columns
from xfreqbench.report.leaderboard.comparison import Comparison, comparisons_of
from xfreqbench.report.leaderboard.figures import learning_curves
from xfreqbench.report.leaderboard.results import read_results, results_at
from xfreqbench.report.leaderboard.unseen_rooms import is_of_rooms
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.records import RunRecord
from xfreqbench.system.arguments import FilePath, checked
from xfreqbench.system.files import atomic_path, require_own, storage_errors, write_columns
from xfreqbench.units import format_ghz

_PARQUET_MARK = f"{SOFTWARE} leaderboard"


@dataclass(frozen=True, repr=False)
class Leaderboard:
    """Records of runs that are shown as tables: one for each data set, protocol and set of splits."""

    records: tuple[RunRecord, ...]

    @classmethod
    def beside(cls, results: Path, records: Iterable[RunRecord]) -> Leaderboard:
        """The records of a results folder that are ranked on the same boards as `records`, and `records` themselves.

        Those of other versions of protocol or metrics, which cannot be ranked with them, are left out.
        """
        keys = {comparable(record) for record in records}
        return cls(tuple(record for record in ResultsFolder(results).records if comparable(record) in keys))

    def __str__(self) -> str:
        """The ranking of every data set and protocol in a few columns, to be read in a terminal; raises as `boards`."""
        return "\n\n".join(
            f"{paragraph(board.title)}. {leak_statement(board)}\n\n{ranking_table(comparison, BRIEF)}"
            for board in boards(self.records)
            for comparison in comparisons_of(board)
        )

    __repr__ = _repr_markdown_ = __str__

    def to_pandas(self) -> Any:
        """All tables as one `pandas.DataFrame`, a row for each method on each set of splits.

        The first columns say which table it is: scene, protocol, kind of maps, name of the data, budget, and the splits
        as a tuple. The others have the titles of the reports, numbers as numbers, nan where they are unknown; where an
        interval of 95 % is known, its ends are in two more columns, `skill low` and `skill high`. Raises
        `XFreqBenchError` where pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise XFreqBenchError(
                'A data frame needs the extra "notebooks". Run: pip install "xfreqbench[notebooks]"'
            ) from error
        return pandas.DataFrame(_rows(each for board in boards(self.records) for each in comparisons_of(board)))


@checked
def leaderboard(results: FilePath | Sequence[InstanceOf[RunRecord]] | Sequence[FilePath] = "results") -> Leaderboard:
    """The leaderboard of results folders, of files of records, or of records that `run` returned, to be shown.

    A file may be at an address (https), and may be a frozen version of the reference board by its name, `v2`. The
    records of several paths are ranked together. Raises `DataError` where there are no records, or one cannot be read.
    """
    given = [results] if isinstance(results, str | Path) else results
    if not given:
        raise DataError("A leaderboard has records, but none are given.")
    records = [item for item in given if isinstance(item, RunRecord)]
    paths = [results_at(item) for item in given if not isinstance(item, RunRecord)]
    found = tuple(records) or read_results(paths).records
    if all(map(is_of_rooms, found)):
        raise DataError("All records are of unseen rooms, which have no leaderboard; `xfreqbench report` has tables.")
    return Leaderboard(found)


def ranking_table(
    comparison: Comparison, names: Sequence[str] = (), has_others: bool = False, more: Sequence[Column] = ()
) -> str:
    """The rows of a comparison, the best average of median SSIM first, with a caption above and notes below.

    `names` are those of columns, such as `BRIEF`; `more` columns follow. An interval is in the cell of its number. If
    it `has_others`, another table has the scores that this one does not have.
    """
    num_splits = len(comparison.splits)
    where = f" on {num_splits} splits, best average first" if num_splits > 1 else ", best first"
    others = "seed spread", "skill", "beam_loss", "aoa_error", "seeds"
    names = names or (*BRIEF[:2], "whose", *BRIEF[2:5], *others, *COSTS)
    parts = [
        f"Median SSIM{where}; order within overlapping ranks means nothing:",
        _table(comparison, names, more),
        *map(paragraph, notes(comparison)),
    ]
    if has_others:
        parts += [
            "Mean and 10th percentile of SSIM, and medians of the other metrics:",
            _table(comparison, ("method", "mean", "p10", *OTHER_METRICS)),
        ]
    return "\n\n".join(parts)


def _table(comparison: Comparison, names: Sequence[str], more: Sequence[Column] = ()) -> str:
    shown = [*columns(comparison, names), *more]
    return table([each.title for each in shown], [[each.cell(row) for each in shown] for row in comparison.rows])


def csv_tables(ranked: Sequence[Board]) -> dict[str, list[dict[str, Any]]]:
    """The rows of files beside the pages of boards, by the endings of their names; tables without rows are left out.

    `scores` has every metric and cost on every set of splits and every split alone, `pairs` which ranked row beats
    which, and `curves` the learning curves.
    """
    found = {
        "scores": [row for board in ranked for row in _scores(board)],
        "pairs": [row for board in ranked for compared in comparisons_of(board) for row in _pairs(compared)],
        "curves": [
            _place(board, (short_name(point["split"]),))
            | {
                "method": point["method"],
                "share": point["share"],
                "seconds": round(point["seconds"], 3),
                "SSIM": round(point["ssim"], 5),
                "best trivial reached after s": point["reached_s"],
            }
            for board in ranked
            for point in learning_curves(board, board.splits)
        ],
    }
    return {name: rows for name, rows in found.items() if rows}


def write_csv(rows: Sequence[dict[str, Any]], output_csv: Path) -> list[str]:
    """Write rows as CSV, splits joined by blanks; returns the names of the columns, which are those of all rows.

    Raises `OutputExistsError` where the file is another one, and `StorageError`.
    """
    require_own_table(output_csv)
    names = list(dict.fromkeys(name for row in rows for name in row))
    told = [row | ({"splits": " ".join(row["splits"])} if "splits" in row else {}) for row in rows]
    with atomic_path(output_csv) as temporary, storage_errors(output_csv):
        write_columns(temporary, {name: [row.get(name) for row in told] for name in names})
    return names


def require_own_table(path: Path) -> None:
    """Raise `OutputExistsError` where a file of CSV or Parquet exists and is not a table of ours."""

    def fault_of(file: Path) -> str | None:
        content = file.read_bytes()
        is_ours = content.startswith((b"scene,protocol,maps,data,", b"measurement,"))  # the first columns
        if path.suffix == ".parquet":
            is_ours = _PARQUET_MARK.encode() in content
        return None if is_ours else "is no table of ours"

    require_own(path, fault_of)


def write_tables(comparisons: Iterable[Comparison], output_csv: Path) -> None:
    """Write the table of `to_pandas` as CSV and, beside it, as Parquet, splits joined by blanks.

    Raises `OutputExistsError` where one is another file, and `StorageError`.
    """
    import pyarrow
    import pyarrow.parquet

    output = output_csv.with_suffix(".parquet")
    for path in (output_csv, output):
        require_own_table(path)
    rows = _rows(comparisons)
    names = write_csv(rows, output_csv)
    whole = [dict.fromkeys(names) | row | {"splits": " ".join(row["splits"])} for row in rows]
    content = pyarrow.Table.from_pylist(whole).replace_schema_metadata({_PARQUET_MARK: "1"})
    with atomic_path(output) as temporary, storage_errors(output):
        pyarrow.parquet.write_table(content, temporary)


def _rows(comparisons: Iterable[Comparison]) -> list[dict[str, Any]]:
    """The rows of comparisons, each with its numbers and words by the titles of their columns."""
    names = (
        *("best rank", "worst rank", "method", "origin", "ssim", "mean", "p10", *OTHER_METRICS),
        *("skill", "seed spread", "seeds", *COSTS, "trained on"),
    )
    rows = []
    for comparison in comparisons:
        shown = columns(comparison, names)
        for row in comparison.rows:
            cells = _place(comparison.board, comparison.splits)
            for column in shown:
                cells[column.title] = column.value(row) if column.value else column.text(row)
                low, high = column.bounds(row)
                if not isnan(low):
                    cells |= {f"{column.title} low": low, f"{column.title} high": high}
            rows.append(cells)
    return rows


def _place(board: Board, splits: Sequence[str]) -> dict[str, Any]:
    """The columns that say what a row is of."""
    return {
        "scene": board.scene,
        "protocol": board.protocol,
        "maps": board.pas_kind,
        "data": board.data_name,
        "budget": board.lane_title,
        "splits": tuple(splits),
    }


def _scores(board: Board) -> Iterator[dict[str, Any]]:
    """The rows on every set of splits, and on every split alone, there with the median SSIM at each tested carrier."""
    yield from _rows(Comparison(board, splits) for splits in board.split_sets() if len(splits) > 1)
    for split in board.splits:
        comparison = Comparison(board, (split,))
        for row, cells in zip(comparison.rows, _rows([comparison]), strict=True):
            medians = [record.scores["ssim"].median_by_carrier_hz for record in row.by_split[split]]
            carriers = sorted(set.intersection(*map(set, medians)), key=float) if len(medians[0]) > 1 else ()
            yield cells | {
                f"SSIM at {format_ghz(float(carrier))}": sum(by_hz[carrier] for by_hz in medians) / len(medians)
                for carrier in carriers
            }


def _pairs(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """Each ranked row beside every one behind it; trivial predictors behind the best are left out beside others."""
    ranked = comparison.ranked_rows
    trivial = [row for row in ranked if row.is_trivial]
    rows = [row for row in ranked if len(trivial) == len(ranked) or row not in trivial[1:]]
    for row, other in combinations(rows, 2):
        low, high = comparison.difference(row, other)
        yield _place(comparison.board, comparison.splits) | {
            "method": row.label,
            "other": other.label,
            "difference": round(row.average(comparison.splits) - other.average(comparison.splits), 6),
            "low": round(low, 6),
            "high": round(high, 6),
        }
