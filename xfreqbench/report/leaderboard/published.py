"""Numbers that others published for other data. They are shown beside ours and never ranked with them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from xfreqbench.report.leaderboard.rows import BoardRow


def reduced_statement(rows: Sequence[BoardRow]) -> str:
    """What reduced re-implementations among the rows leave out of the systems they are named for; empty without any."""
    notes = {
        counterpart["method"]: counterpart
        for counterpart in published_content()["counterpart"]
        if "note" in counterpart
    }
    named = dict.fromkeys(row.job.method for row in rows if not row.is_external and row.job.method in notes)
    if not named:
        return ""
    reduced = "; ".join(f"{method} for {notes[method]['name']}: {notes[method]['note']}" for method in named)
    return f"Reduced re-implementations on one renderer, not the authors' programs, stand here: {reduced}."


def sources_of(rows: Sequence[BoardRow]) -> list[dict[str, Any]]:
    """Whose papers and programs methods among the rows are named after: `name`, and addresses `paper` and `program`."""
    methods = {row.job.method for row in rows if not row.is_external}
    return [source for source in published_content()["source"] if methods & set(source["methods"])]


@cache
def published_content() -> dict[str, Any]:
    """The published numbers, and which of our rows stand for which, as `paper_results.toml` holds them."""
    return tomllib.loads((files("xfreqbench.baselines") / "paper_results.toml").read_text("utf-8"))


def stands_for(counterpart: Mapping[str, Any], row: BoardRow) -> bool:
    """Whether a row has the protocol, the method and the options that a counterpart names."""
    if row.is_external:
        return False
    config = row.records[0].config
    return (row.job.protocol, row.job.method) == (counterpart["protocol"], counterpart["method"]) and all(
        config.get(name) == value for name, value in counterpart.get("config", {}).items()
    )
