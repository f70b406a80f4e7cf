"""Maps of five transmitters at five carriers beside the truth, as in the paper, and the file of maps to be shipped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError
from xfreqbench.report.leaderboard.boards import Board, short_name
from xfreqbench.report.leaderboard.figures import FIGURES_FOLDER
from xfreqbench.report.leaderboard.gallery import dozen_of, open_data, stored_maps
from xfreqbench.report.leaderboard.overview import main_scene
from xfreqbench.report.leaderboard.paper_figures import published_rows
from xfreqbench.report.leaderboard.results import RankedResults, read_results
from xfreqbench.report.leaderboard.shown_maps import Levels, Position, ShownMaps, write_maps
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.types import IntArray

NUM_CARRIERS, NUM_TX = 5, 5
_PAPERS = "XFreq-GS"
_SAME_M = 1e-3  # positions are rounded

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class MapGrid:
    """Levels of the maps of T transmitters, true and predicted, and the SSIM of the latter, for each split by its name.

    `tx_position_m` are the positions of the transmitters, `method` is the label of what predicted the maps.
    """

    method: str
    budget: str
    tx_position_m: Sequence[Position]
    columns: Mapping[str, tuple[Levels, Levels, Sequence[float]]]


def ship_maps(results: Path | Sequence[Path], path: Path) -> Path:
    """Write the maps of a dozen samples of every board of the main scene to a file, and return it.

    They are the maps that the page shows, of all rows but ablations, and those of the paper's method at further
    carriers. Raises `DataError` where no predictions or no data set are found, `OutputExistsError` and `StorageError`.
    """
    found = read_results(results)
    main, shown, known = main_scene(found.boards), [], set[str]()
    for board in found.boards:
        dataset = open_data(board) if board.scene == main else None
        for each in _maps_of(board, dataset, found.folders) if dataset else ():
            new = {key: run for key, run in each.predicted.items() if key not in known}
            known |= new.keys()
            shown += [each.model_copy(update={"predicted": new})] if new else []
    if not shown:
        raise DataError(
            "No predictions of a data set that is here lie beside these records. Give a results folder that "
            "`xfreqbench run` or `xfreqbench benchmark` wrote, and leave its data set where it was."
        )
    write_maps(path, shown)
    return path


def paper_maps(ranked: Sequence[Board], found: RankedResults) -> dict[str, MapGrid]:
    """By the links to their figures, the paper's maps of every board whose maps are stored or shipped."""
    grids = {f"{FIGURES_FOLDER}/paper-{board.slug}-maps.png": _grid(board, found) for board in ranked}
    return {link: grid for link, grid in grids.items() if grid}


def _maps_of(board: Board, dataset: PasDataset, folders: Sequence[ResultsFolder]) -> list[ShownMaps]:
    """The maps of the shown split, and those of the paper's method and the same transmitters on other splits."""
    dozen = dozen_of(board, dataset, folders)
    papers = published_rows(board).get(_PAPERS)
    if dozen is None or papers is None:
        return [dozen] if dozen else []
    distance_m = np.abs(dataset.tx_position_m[:, None] - np.asarray(dozen.tx_position_m)).max(axis=2)
    is_shown = distance_m.min(axis=1) < _SAME_M

    def choose(rows: IntArray) -> IntArray:
        return rows[is_shown[rows]]

    others = [
        stored_maps(dataset, records[:1], folders, choose)
        for split, records in papers.by_split.items()
        if split != dozen.split
    ]
    return [dozen, *(each for each in others if each)]


def _grid(board: Board, found: RankedResults) -> MapGrid | None:
    row = published_rows(board).get(_PAPERS)
    if row is None:
        return None
    dataset = open_data(board)
    stored = _maps_of(board, dataset, found.folders) if dataset else []
    known = found.maps | {key: each for each in stored for key in each.predicted}
    ids = {split: row.by_split[split][0].id for split in board.splits if split in row.by_split}
    of_split = {split: known[key] for split, key in ids.items() if key in known}
    if not of_split:
        return None
    splits = _spread(list(of_split), NUM_CARRIERS)
    first, *others = (of_split[split] for split in splits)
    common = [each for each in first.tx_position_m if all(each in other.tx_position_m for other in others)]
    shown = _spread(common, NUM_TX)
    columns = {short_name(split): _column(of_split[split], ids[split], shown) for split in splits}
    return MapGrid(row.short_label, board.lane_title or "no budget", shown, columns) if shown else None


def _column(
    maps: ShownMaps, record_id: str, shown: Sequence[Position]
) -> tuple[Levels, Levels, Sequence[float]]:
    """The levels of true and of predicted maps at some transmitters, and the SSIM of the latter."""
    places = [maps.tx_position_m.index(each) for each in shown]
    ssim = [maps.predicted[record_id].ssim[place] for place in places]
    return maps.true_levels()[places], maps.levels_of(record_id)[places], ssim


def _spread(values: Sequence[Value], most: int) -> list[Value]:
    """At most so many of some values, equally far apart in their order."""
    places = np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int)
    return [values[place] for place in places]
