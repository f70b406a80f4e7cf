"""Makes BENCHMARK.md, docs/results and the table of README.md again, from the records that lie in `baselines/`.

    python docs/remake.py [--page page.html] [--add] [RESULTS FOLDER …]

With results folders, as `xfreqbench benchmark` leaves them, their records first replace those of
`baselines/reference_results.parquet`, and their maps those that are shipped beside them. Run it then where the
benchmark was run: maps are shipped with the truth, which is read from the data sets where they lay. With `--add`, the
records are added to those that are there, and maps stay as they are. What methods say that they have learned
(`findings`) is on no page, and is left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from xfreqbench.report.drawing.markdown import ABSENT, prose, table
from xfreqbench.report.leaderboard.boards import Board
from xfreqbench.report.leaderboard.captions import reduced_statement
from xfreqbench.report.leaderboard.columns import columns
from xfreqbench.report.leaderboard.comparison import Comparison
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.report.leaderboard.paper import ship_maps
from xfreqbench.report.leaderboard.report import BEGIN, END, write_report
from xfreqbench.report.leaderboard.results import read_results, results_at
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.record_table import write_table
from xfreqbench.runs.records import BenchRecord, StoredRecords

ROOT = Path(__file__).resolve().parents[1]
RECORDS = [ROOT / "baselines" / f"{name}_results.parquet" for name in ("reference", "paper_size", "unseen_rooms")]
BY_HAND = "paper-size.md"  # among the pages of results
# What is generated in BENCHMARK.md has marks of its own, so that no other `xfreqbench report` replaces it.
MARKS = {BEGIN: "<!-- docs/remake.py: begin -->", END: "<!-- docs/remake.py: end -->"}


def take(folders: list[Path], add: bool = False) -> None:
    """Replace the reference records by those of results folders, and the maps beside them; or add the records."""
    if not add:
        ship_maps(folders, RECORDS[0].with_name("reference_results_maps.jsonl"))
    found = [ResultsFolder.holding(path).stored for path in (RECORDS[:1] if add else []) + folders]
    runs = [record.model_copy(update={"findings": {}}) for stored in found for record in stored.records]
    benches = [bench for stored in found for bench in stored.benches]
    write_table(RECORDS[0], StoredRecords(tuple(runs), tuple(benches)))


def readme_table(boards: Sequence[Board]) -> str:
    """Five rows of the office, at the carriers at which `xfreq-gs-paper` was tested, and their scores in `open_office`.

    They are `virtual-source`, `xfreq-gs`, `xfreq-gs-paper`, the best small version of another published system, and the
    best baseline that is not trained, with their ranks among all methods.
    """
    office, beside = (
        next(board for board in boards if board.title.startswith(f"{scene} · lofo · power maps · quick"))
        for scene in ("office", "open_office")
    )
    plain = office.without_ablations
    here = Comparison.of(plain, next(row for row in plain.rows if row.job.method == "xfreq-gs-paper"))
    there = Comparison(beside, here.splits)
    shown = {"virtual-source", "xfreq-gs", "xfreq-gs-paper"}
    shown.add(next(row.job.method for row in here.rows if reduced_statement([row])))
    shown.add(next(row.job.method for row in here.rows if row.is_trivial))
    every = columns(here, ("rank", "method", "average", "skill", "beam_loss"))
    every += [column.elsewhere(beside.scene, there.rows) for column in columns(there, ("average", "skill"))]
    body = [[column.cell(row) for column in every] for row in here.rows if row.job.method in shown]
    here_heads = ["rank", "method", "median SSIM", "skill", "beam loss (dB)"]
    return table([*here_heads, "SSIM, open_office", "skill, open_office"], body)


def speed_table(benches: Sequence[BenchRecord]) -> str:
    """What the measurements say of generator, renderer, savings and stability, a line each, with their commands."""

    by_title = {bench.title: bench for bench in benches}

    def row(title: str, *start: str) -> dict[str, str]:
        bench = by_title[title]
        found = next(cells for cells in bench.rows if cells[: len(start)] == start)
        return dict(zip(bench.columns, found, strict=True)) | {"command": f"`{bench.command}`"}

    def accuracy(scene: str) -> str:
        traced = row(f"The plain way, {scene}", "image, defaults, tracing alone")
        return f"{traced['1 GHz']} at 1 GHz, {traced['94 GHz']} at 94 GHz; bar {traced['bar']}"

    diffracted = row("Error of the generated maps against run time, office", "image, diffraction on")
    office, bedroom = (row(f"The full pipeline, {scene}", "image") for scene in ("office", "bedroom.toml"))
    paths, other = (row("Time of the solvers", "3", solver) for solver in ("image", "PathSolver"))
    saved = row("Savings, each off and on", "image: these three together")
    splat, fit = row("Splatting alone", "16000", "32"), row("Training steps of methods", "xfreq-gs")
    stress = by_title["Numerical stability"]
    is_kept = [case[-1].startswith("ok") for case in stress.rows]
    body = [
        (
            "the office, from scene to finished file",
            f"{office['ms a sample']} ms a map; traced with diffraction {diffracted['ms a sample']}",
            f"{office['rate / the cheapest plain that meets the bar']} × the cheapest `PathSolver` that meets the bar",
            accuracy("office"),
            office["command"],
        ),
        (
            "a bedroom of meshes, likewise",
            f"{bedroom['ms a sample']} ms a map",
            f"{bedroom['rate / the plain way']} × `PathSolver`, which never meets the bar",
            accuracy("bedroom"),
            bedroom["command"],
        ),
        (
            "channels of three reflections among 40 triangles, one core",
            f"{paths['ms a transmitter']} ms a transmitter",
            f"{float(other['time : image']):,.0f} × `PathSolver`",
            f"{paths['dB']} dB; `PathSolver` {other['dB']} dB",
            paths["command"],
        ),
        (
            "three savings of `image` together",
            f"{saved['on, ms']} ms a map",
            f"{saved['off / on']} × without them",
            saved["change in the answer"],
            saved["command"],
        ),
        (
            "splatting of 16,000 Gaussians, forward and backward, 32 maps a step",
            f"{splat['numba ms']} ms a map; `xfreq-gs` learns from {fit['maps/s']} a second",
            f"{splat['dense / numba']} × every Gaussian on every direction",
            f"{splat['error of values']} of values, {splat['of gradients']} of gradients",
            splat["command"],
        ),
        (
            "numerical stability",
            ABSENT,
            ABSENT,
            f"{sum(is_kept)} of {len(is_kept)} cases within their limits",
            f"`{stress.command}`",
        ),
    ]
    return table(["what", "time", "faster than", "error", "command"], body, prose)


def remake(root: Path, page: Path | None = None) -> list[Path]:
    """Make the pages below `root`, and the web page; pages of results that are made no more are removed."""
    found, details = read_results(RECORDS), root / "docs" / "results"
    page_md = root / "BENCHMARK.md"
    _replace(page_md, {ours: theirs for theirs, ours in MARKS.items()})
    try:
        written = write_report(found, page_md, details, results_at("v2"))
    finally:
        _replace(page_md, MARKS)
    for path in set(details.rglob("*.*")) - set(written):
        if path.name != BY_HAND:
            path.unlink()
    _fill(root / "README.md", "leaderboard", readme_table(found.boards))
    _fill(page_md, "speed", speed_table(found.benches))
    if page is not None:
        write_page(found, page, results_at("v2"))
    return written


def _fill(path: Path, name: str, text: str) -> None:
    """Put a text between the two marks of a name in a page."""
    before, begin, rest = path.read_text("utf-8").partition(f"<!-- {name} -->\n")
    _, end, after = rest.partition(f"\n<!-- /{name} -->")
    assert begin and end, f"{path} has no place for {name}"
    path.write_text(before + begin + text + end + after, "utf-8")


def _replace(path: Path, texts: dict[str, str]) -> None:
    content = path.read_text("utf-8")
    for before, after in texts.items():
        content = content.replace(before, after)
    path.write_text(content, "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--add", action="store_true")
    given = parser.parse_args()
    if given.folders:
        take(given.folders, given.add)
    remake(ROOT, given.page)
