"""The leaderboard for Python: as text, as a table of a notebook, and as a data frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pydantic import InstanceOf

from xfreqbench.errors import DataError, XFreqBenchError
from xfreqbench.report.drawing.templates import SOFTWARE
from xfreqbench.report.leaderboard.boards import boards
from xfreqbench.report.leaderboard.comparison import Comparison, comparisons_of
from xfreqbench.report.leaderboard.report import leaderboard_summary
from xfreqbench.report.leaderboard.results import read_results, results_at
from xfreqbench.report.leaderboard.tables import require_own_csv, table_rows, write_csv
from xfreqbench.report.leaderboard.unseen_rooms import is_of_rooms
from xfreqbench.runs.records import RunRecord
from xfreqbench.system.arguments import FilePath, checked
from xfreqbench.system.files import atomic_path, require_own, storage_errors

_PARQUET_MARK = f"{SOFTWARE} leaderboard"


@dataclass(frozen=True, repr=False)
class Leaderboard:
    """Records of runs that are shown as tables: one for each data set, protocol and set of splits."""

    records: tuple[RunRecord, ...]

    def __str__(self) -> str:
        return leaderboard_summary(self.records)

    __repr__ = __str__

    def _repr_markdown_(self) -> str:
        return str(self)

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
        shown = [comparison for board in boards(self.records) for comparison in comparisons_of(board)]
        return pandas.DataFrame(table_rows(shown))


@checked
def leaderboard(results: FilePath | Sequence[InstanceOf[RunRecord]] | Sequence[FilePath] = "results") -> Leaderboard:
    """The leaderboard of results folders, of files of records, or of records that `run` returned, to be shown.

    A file may be at an address (https), and may be a frozen version of the reference board by its name, `v1`. The
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


def require_own_tables(output_csv: Path) -> None:
    """Raise `OutputExistsError` where one of the files of `write_tables` exists and was not written by it."""
    require_own_csv(output_csv)
    if find_spec("pyarrow") is not None:
        require_own(
            output_csv.with_suffix(".parquet"),
            lambda path: None if _PARQUET_MARK.encode() in path.read_bytes() else "is no table of ours",
        )


def write_tables(comparisons: Iterable[Comparison], output_csv: Path) -> None:
    """Write the table of `to_pandas` as CSV and, where pyarrow is installed, beside it as Parquet.

    Splits are joined by blanks. Raises `OutputExistsError` where either is another file, and `StorageError`.
    """
    require_own_tables(output_csv)
    rows = table_rows(comparisons)
    names = write_csv(rows, output_csv)
    if find_spec("pyarrow") is None:
        return
    import pyarrow
    import pyarrow.parquet

    output = output_csv.with_suffix(".parquet")
    table = pyarrow.Table.from_pylist(
        [dict.fromkeys(names) | row | {"splits": " ".join(row["splits"])} for row in rows]
    )
    with atomic_path(output) as temporary, storage_errors(output):
        pyarrow.parquet.write_table(table.replace_schema_metadata({_PARQUET_MARK: "1"}), temporary)
