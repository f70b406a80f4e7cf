"""The leaderboard for Python: as text, as a table of a notebook, and as a data frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import Any

from pydantic import InstanceOf

from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.report.drawing.templates import render
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.captions import leak_statement, notes
from xfreqbench.report.leaderboard.columns import BRIEF, TABLE, LeaderboardColumn, leaderboard_columns
from xfreqbench.report.leaderboard.comparison import Comparison, comparisons_of
from xfreqbench.report.leaderboard.report import leaderboard_summary
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.report.leaderboard.rows import BoardRow
from xfreqbench.runs.records import RunRecord
from xfreqbench.system.arguments import FilePath, checked


@dataclass(frozen=True, repr=False)
class Leaderboard:
    """Records of runs that are shown as tables: one for each data set, protocol and set of splits."""

    records: tuple[RunRecord, ...]

    def __str__(self) -> str:
        return leaderboard_summary(self.records)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """The tables of `str`, for notebooks."""
        shown = [(comparison, leaderboard_columns(comparison, BRIEF)) for comparison in self._comparisons()]
        return render("leaderboard/notebook.html", shown=shown, leak_statement=leak_statement, notes=notes)

    def to_pandas(self) -> Any:
        """All tables as one `pandas.DataFrame`, a row for each method on each set of splits.

        The first columns say which table it is: scene, protocol, kind of maps, name of the data, and the splits as a
        tuple. The others have the titles of the reports, numbers as numbers, nan where they are unknown; where an
        interval of 95 % is known, its ends are in two more columns, `skill low` and `skill high`. Raises
        `XFreqBenchError` where pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise XFreqBenchError(
                'A data frame needs the extra "notebooks". Run: pip install "xfreqbench[notebooks]"'
            ) from error
        return pandas.DataFrame([row for comparison in self._comparisons() for row in _rows(comparison)])

    def _comparisons(self) -> list[Comparison]:
        return [comparison for board in boards(self.records) for comparison in comparisons_of(board)]


@checked
def leaderboard(
    results: FilePath | Sequence[InstanceOf[RunRecord]] | Sequence[FilePath] = "results",
) -> Leaderboard:
    """The leaderboard of results folders, of files of records, or of records that `run` returned, to be shown.

    The records of several paths are ranked together. Raises `DataError` where there are no records, or one cannot be
    read.
    """
    given = [results] if isinstance(results, str | Path) else results
    if not given:
        raise DataError("A leaderboard has records, but none are given.")
    records = [item for item in given if isinstance(item, RunRecord)]
    paths = [Path(item) for item in given if not isinstance(item, RunRecord)]
    return Leaderboard(tuple(records) or read_results(paths).records)


def _rows(comparison: Comparison) -> list[dict[str, Any]]:
    """The rows of a comparison, each with its cells by their titles."""
    board, columns = comparison.board, leaderboard_columns(comparison, TABLE)
    where = {
        "scene": board.scene,
        "protocol": board.protocol,
        "maps": board.pas_kind,
        "data": board.data_name,
        "splits": comparison.splits,
    }
    return [
        where | {name: cell for column in columns for name, cell in _cells(column, row).items()}
        for row in comparison.rows
    ]


def _cells(column: LeaderboardColumn, row: BoardRow) -> dict[str, Any]:
    if column.value is None:
        return {column.title: column.text(row)}
    low, high = column.bounds(row)
    ends = {} if isnan(low) else {f"{column.title} low": low, f"{column.title} high": high}
    return {column.title: column.value(row), **ends}
