"""The leaderboard as text: what `xfreqbench run` prints, for Python."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from xfreqbench.report.leaderboard.report import leaderboard_summary
from xfreqbench.report.leaderboard.results import read_results
from xfreqbench.runs.records import RunRecord


@dataclass(frozen=True, repr=False)
class Leaderboard:
    """Records of runs that print as tables: one for each data set, protocol and kind of maps."""

    records: tuple[RunRecord, ...]

    def __str__(self) -> str:
        return leaderboard_summary(self.records)

    __repr__ = __str__


def leaderboard(results: str | Path = "results") -> Leaderboard:
    """The leaderboard of a results folder, or of one file of records, to be printed.

    Raises `DataError` where there are no records, or one cannot be read.
    """
    return Leaderboard(read_results(Path(results)).records)
