"""Says in words what a data set holds: the text of `xfreqbench info`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.paths import OFFSET
from xfreqbench.data.validation import place_index
from xfreqbench.units import format_ghz


def describe(path: Path) -> str:
    """Summary of a data set: scene, receiver, maps and settings, then a line for each carrier; raises `DataError`."""
    dataset = open_dataset(path)
    header = dataset.header
    receiver = header.receiver
    lit = np.unique(np.flatnonzero(dataset.tables["line_of_sight"]))
    in_sight = str(len(lit)) if header.channels else "unknown number"
    num_places = len(np.unique(place_index(dataset)))
    at_places = f" at {num_places} places" if num_places < header.num_tx else ""
    lines = [
        f"{path}: scene {header.scene_name!r}, {header.num_tx} transmitters{at_places} ({in_sight} in sight of "
        f"the receiver) × {dataset.header.num_carriers} carriers",
        *_links_line(dataset),
        f"receiver   {receiver.rows} × {receiver.cols} elements {receiver.spacing_wavelengths:g} wavelengths "
        f"apart in its {receiver.plane} plane at {receiver.position_m} m, boresight {receiver.boresight}, "
        f"{receiver.antenna}",
        f"maps       {header.pas_kind}, {'stored' if header.maps else 'derived from the channels when read'}, "
        f"{dataset.grid.shape[0]} elevations × {dataset.grid.shape[1]} azimuths"
        f"{'' if receiver.resolves_directions else '; nearly constant, for the array has hardly any extent'}",
        *_paths_line(dataset),
        "settings   " + ", ".join(f"{name} {_in_words(value)}" for name, value in header.settings.items()),
        "software   " + ", ".join(f"{name} {version}" for name, version in header.software.items()),
        *([f"references {header.references}"] if header.references else []),
        "left out   " + (", ".join(f"{count} {why}" for why, count in header.rejected.items()) or "nothing"),
        f"recipe     {dataset.recipe}, sha256 {dataset.recipe.sha256}",
        f"sha256     {dataset.sha256}",
        "",
        "carrier      without path   median paths   peak power median (dB)",
    ]
    return "\n".join(lines + _carrier_lines(dataset))


def _links_line(dataset: PasDataset) -> list[str]:
    """Which links the file holds, where there are several; what is said below is of the first."""
    links = links_in_words(dataset)
    return [f"links      {links}; what follows is of the first of each"] if links else []


def links_in_words(dataset: PasDataset) -> str:
    """Receivers × polarizations of a file of several links; empty where there is one."""
    return " × ".join(", ".join(names) for names in dataset.file_header.link_names if names)


def _in_words(setting: Any) -> str:
    """A setting as text: names of a list as in `specular+refraction`, `none` for an empty one."""
    if isinstance(setting, list | tuple) and all(isinstance(item, str) for item in setting):
        return "+".join(setting) or "none"
    return str(setting)


def _paths_line(dataset: PasDataset) -> list[str]:
    """How many paths are stored; nothing where there are none."""
    if not dataset.header.paths:
        return []
    header = dataset.file_header
    of_each = np.diff(dataset.tables[OFFSET])[header.link(*dataset.link)[0] :: max(1, len(header.receivers))]
    return [f"paths      {of_each.sum():,} to the array's centre, {np.median(of_each):.0f} a transmitter in the median"]


def _carrier_lines(dataset: PasDataset) -> list[str]:
    lines, is_known = [], dataset.header.channels
    for carrier, carrier_hz in enumerate(dataset.header.carrier_hz):
        peak_power = dataset.tables["peak_power"][:, carrier]
        heard = peak_power[peak_power > 0]
        paths = f"{np.median(dataset.tables['num_paths'][:, carrier]):.0f}" if is_known else "unknown"
        median_db = (f"{10 * np.log10(np.median(heard)):.1f}" if len(heard) else "none") if is_known else "unknown"
        lines.append(f"{format_ghz(carrier_hz):12} {len(peak_power) - len(heard):12} {paths:>14}   {median_db:>22}")
    return lines
