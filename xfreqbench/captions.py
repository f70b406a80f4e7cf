"""What stands around a board's tables in words: its data, its machines, and what training and test share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xfreqbench.boards import Board, Row
from xfreqbench.records import RunRecord


def leak_statement(board: Board) -> str:
    """Whether tested transmitters are trained on, and how far the nearest trained one is."""
    if any(record.shares_transmitters for record in board.records):
        return "Tested transmitters are trained on at other carriers: these scores say nothing about unseen places."
    known_m = [record.nearest_trained_m for record in board.records if record.nearest_trained_m is not None]
    nearest = f"; the nearest trained one is {_distance(known_m)} away (median)" if known_m else ""
    return f"No tested transmitter is trained on at any carrier{nearest}."


def tracing(board: Board) -> str:
    """The kind of map and what was asked of the rays, as far as the data set says it."""
    settings = board.settings
    parts = [f"{board.pas_kind} maps"]
    if "solver" in settings:
        parts.append(f"{settings['solver']} solver")
    if "interactions" in settings:
        parts.append(" and ".join(settings["interactions"]) or "no interactions")
    if "max_depth" in settings:
        parts.append(f"depth {settings['max_depth']}")
    return ", ".join(parts)


def external_statement(rows: Sequence[Row]) -> str:
    """Whose word stands for the times of predictions that were made elsewhere; empty without any such row."""
    external = [row for row in rows if row.is_external]
    if not external:
        return ""
    sources = "; ".join(f"{row.label}: {_source(row)}" for row in external)
    return (
        "External rows were predicted elsewhere and are scored here like every other; their times and "
        f"parameters are declared by their authors, or absent (–). {sources}."
    )


def machine_names(records: Sequence[RunRecord]) -> list[str]:
    """Machines on which anything was timed here, each once, sorted."""
    return sorted({machine_name(record.hardware) for record in records if record.external is None})


def machine_name(hardware: Mapping[str, str]) -> str:
    """Processor, cores, system and GPUs in one line."""
    return ", ".join(_cores(value) if name == "cores" else value for name, value in hardware.items())


def span(numbers: tuple[int, int]) -> str:
    """`2–4`, or the one number that both are."""
    low, high = numbers
    return str(low) if low == high else f"{low}–{high}"


def _source(row: Row) -> str:
    """Hardware and address, as far as they are declared."""
    told = [(each.external.hardware, each.external.url) for each in row.records if each.external]
    texts = dict.fromkeys(text for pair in told for text in pair if text)
    return ", ".join(texts) or "hardware not declared"


def _distance(distances_m: Sequence[float]) -> str:
    low, high = f"{min(distances_m):.2f} m", f"{max(distances_m):.2f} m"
    return low if low == high else f"{low} to {high}"


def _cores(number: str) -> str:
    return "1 core" if number == "1" else f"{number} cores"
