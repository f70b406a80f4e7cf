"""Single pictures of a data set, for papers and talks: one transmitter's maps, or the power of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.errors import DataError, UnknownNameError, XFreqBenchError
from xfreqbench.maps.bartlett import power_of
from xfreqbench.report.drawing.figures import plot_pas_maps, shown
from xfreqbench.report.view.plan import plan_view
from xfreqbench.report.view.power import plot_power, received_power
from xfreqbench.report.view.summary import known_line_of_sight
from xfreqbench.units import format_ghz


def draw_maps(
    file: Path, tx: int, carriers_hz: Sequence[float] | None, range_db: float, output: Path
) -> None:
    """Draw the maps of one transmitter at some carriers, at all if None, with a title that says which one it is.

    Raises `DataError`, `XFreqBenchError` for a transmitter that is not there, `UnknownNameError` for such a carrier,
    and `StorageError`.
    """
    dataset = open_dataset(file)
    if not 0 <= tx < dataset.header.num_tx:
        raise XFreqBenchError(
            f"{file} holds transmitters 0 to {dataset.header.num_tx - 1}, but {tx} is asked for."
        )
    chosen_hz = _chosen_hz(dataset, carriers_hz)
    known_hz = dataset.header.carrier_hz.tolist()
    samples = dataset.subset([tx * len(known_hz) + known_hz.index(carrier) for carrier in chosen_hz])
    titles = [format_ghz(carrier) for carrier in chosen_hz]
    maps = power_of(samples.pas(), dataset.header.pas_kind)
    plot_pas_maps(maps, dataset.grid, titles, output, _title(dataset, tx), range_db)


def draw_power(file: Path, carriers_hz: Sequence[float] | None, range_db: float, output: Path) -> None:
    """Draw the plan of a data set's room with the power received from every transmitter, at all carriers if None.

    Raises as `draw_maps` does, and `DataError` for data that hold maps alone.
    """
    dataset = open_dataset(file)
    chosen_hz = _chosen_hz(dataset, carriers_hz)
    if not dataset.header.channels:
        raise DataError(f"{file} holds maps alone, which say nothing of power; draw --of maps.")
    power = np.stack([received_power(dataset, carrier) for carrier in chosen_hz])
    room = plan_view(str(file)).room
    title = f"{_name(dataset)}\npower received from {dataset.header.num_tx} transmitters"
    plot_power(room, power, chosen_hz, output, title, range_db)


def _chosen_hz(dataset: PasDataset, carriers_hz: Sequence[float] | None) -> list[float]:
    """Each carrier once; raises `UnknownNameError` for one that the data set does not have."""
    known_hz = dataset.header.carrier_hz.tolist()
    chosen_hz = list(dict.fromkeys(known_hz if carriers_hz is None else carriers_hz))
    for carrier in chosen_hz:
        if carrier not in known_hz:
            raise UnknownNameError("carrier", format_ghz(carrier), map(format_ghz, known_hz))
    return chosen_hz


def _title(dataset: PasDataset, tx: int) -> str:
    place = ", ".join(f"{metres:.2f}" for metres in dataset.tables["tx_position_m"][tx])
    in_sight = known_line_of_sight(dataset)
    sight = "" if in_sight is None else (", in sight" if in_sight[tx] else ", in shadow")
    return f"{_name(dataset)}\ntransmitter {tx} at ({place}) m{sight}"


def _name(dataset: PasDataset) -> str:
    return shown(f"{dataset.path.name}, scene {dataset.header.scene_name}")
