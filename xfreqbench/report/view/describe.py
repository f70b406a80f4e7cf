"""What a data set holds: in text, and in numbers that say how it changes from carrier to carrier."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.paths import OFFSET
from xfreqbench.data.schema import UNKNOWN_NUM_PATHS
from xfreqbench.data.validation import place_index
from xfreqbench.maps.metrics import ssim
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import format_ghz


def describe(path: Path) -> str:
    """Summary of a data set: scene, receiver, maps and settings, then a line for each carrier; raises `DataError`."""
    dataset = open_dataset(path)
    header = dataset.header
    receiver = header.receiver
    in_sight = str(np.count_nonzero(dataset.tables["line_of_sight"])) if header.channels else "unknown number"
    num_places = len(np.unique(place_index(dataset)))
    at_places = f" at {num_places} places" if num_places < header.num_tx else ""
    links, paths = links_in_words(dataset), []
    if header.paths:
        step = max(1, len(dataset.file_header.receivers))
        of_each = np.diff(dataset.tables[OFFSET])[dataset.file_header.link(*dataset.link)[0] :: step]
        median = f"{np.median(of_each):.0f} a transmitter in the median"
        paths = [f"paths      {of_each.sum():,} to the array's centre, {median}"]
    lines = [
        f"{path}: scene {header.scene_name!r}, {header.num_tx} transmitters{at_places} ({in_sight} in sight of "
        f"the receiver) × {dataset.header.num_carriers} carriers",
        *([f"links      {links}; what follows is of the first of each"] if links else []),
        f"receiver   {receiver.rows} × {receiver.cols} elements {receiver.spacing_wavelengths:g} wavelengths "
        f"apart in its {receiver.plane} plane at {receiver.position_m} m, boresight {receiver.boresight}, "
        f"{receiver.antenna}",
        f"maps       {header.pas_kind}, {'stored' if header.maps else 'derived from the channels when read'}, "
        f"{dataset.grid.shape[0]} elevations × {dataset.grid.shape[1]} azimuths"
        f"{'' if receiver.resolves_directions else '; nearly constant, for the array has hardly any extent'}",
        *paths,
        "settings   " + ", ".join(f"{name} {_in_words(value)}" for name, value in header.settings.items()),
        "software   " + ", ".join(f"{name} {version}" for name, version in header.software.items()),
        *([f"references {header.references}"] if header.references else []),
        "left out   " + (", ".join(f"{count} {why}" for why, count in header.rejected.items()) or "nothing"),
        f"recipe     {dataset.recipe}, sha256 {dataset.recipe.sha256}",
        f"sha256     {dataset.sha256}",
        "",
        "carrier      without path   median paths   peak power median (dB)",
    ]
    for carrier, carrier_hz in enumerate(header.carrier_hz):
        peak_power = dataset.tables["peak_power"][:, carrier]
        heard = peak_power[peak_power > 0]
        num_paths, median_db = "unknown", "unknown"
        if header.channels:
            num_paths = f"{np.median(dataset.tables['num_paths'][:, carrier]):.0f}"
            median_db = f"{10 * np.log10(np.median(heard)):.1f}" if len(heard) else "none"
        silent = len(peak_power) - len(heard)
        lines.append(f"{format_ghz(carrier_hz):12} {silent:12} {num_paths:>14}   {median_db:>22}")
    return "\n".join(lines)


def links_in_words(dataset: PasDataset) -> str:
    """Receivers × polarizations of a file of several links; empty if there is one."""
    return " × ".join(", ".join(names) for names in dataset.file_header.link_names if names)


def _in_words(setting: Any) -> str:
    """A setting as text: names of a list as in `specular+refraction`, `none` for an empty one."""
    if isinstance(setting, list | tuple) and all(isinstance(item, str) for item in setting):
        return "+".join(setting) or "none"
    return str(setting)


@dataclass(frozen=True, eq=False)
class CarrierSummary:
    """T transmitters at F carriers, and the maps of `num_compared` of them, compared at K carriers.

    `peak_db` is the peak of each map in dB before it was divided out, nan without a path; it and
    `num_paths` are None if only maps were published. `in_sight` is None then too. `median_ssim` is the median SSIM
    between the maps of one transmitter at two carriers: symmetric, 1 on the diagonal, nan if no transmitter has a path
    at both carriers.
    """

    carrier_hz: Float[FloatArray, "F"]
    has_path: Bool[NDArray[np.bool_], "T F"]
    in_sight: Bool[NDArray[np.bool_], "T"] | None
    peak_db: Float[FloatArray, "T F"] | None
    num_paths: Int[NDArray[np.integer], "T F"] | None
    compared_hz: Float[FloatArray, "K"]
    median_ssim: Float[FloatArray, "K K"]
    num_compared: int

    def groups(self) -> dict[str, Bool[NDArray[np.bool_], "T"]]:
        """Masks of the transmitters in sight and in shadow, without empty groups; of all where that is not known."""
        if self.in_sight is None:
            return {"all transmitters": np.ones(len(self.has_path), dtype=bool)}
        both = {"in sight": self.in_sight, "in shadow": ~self.in_sight}
        return {name: members for name, members in both.items() if members.any()}


def known_line_of_sight(dataset: PasDataset) -> Bool[NDArray[np.bool_], "T"] | None:
    """Whether nothing is between each transmitter and the array; None if only maps were published."""
    return dataset.tables["line_of_sight"].astype(bool) if dataset.header.channels else None


def summarize(dataset: PasDataset) -> CarrierSummary:
    """Numbers of a whole data set, with maps of evenly spread transmitters compared at evenly spread carriers.

    At most 200 transmitters and 16 carriers are compared, in 2,500 comparisons of some 1.3 ms. Raises `DataError`.
    """
    power, num_paths = dataset.tables["peak_power"], dataset.tables["num_paths"]
    with np.errstate(divide="ignore"):
        peak_db = np.where(power > 0, 10 * np.log10(power), np.nan)
    carriers = _spread(dataset.header.num_carriers, 16)
    pairs = list(combinations(range(len(carriers)), 2))
    transmitters = _spread(dataset.header.num_tx, min(200, 2500 // max(1, len(pairs))))
    scores = np.full((len(transmitters), len(pairs)), np.nan)  # where one of the two maps is empty
    for row, tx in enumerate(transmitters.tolist() if pairs else ()):
        first, second = np.array(pairs).T
        rows = tx * dataset.header.num_carriers + carriers
        maps, heard = dataset.pas(rows), dataset.has_path[rows]
        both = heard[first] & heard[second]
        scores[row, both] = ssim(maps[first[both]], maps[second[both]], dataset.grid)
    median_ssim = np.eye(len(carriers))
    for (first, second), values in zip(pairs, scores.T, strict=True):
        known = values[~np.isnan(values)]
        median_ssim[[first, second], [second, first]] = np.median(known) if len(known) else np.nan
    return CarrierSummary(
        carrier_hz=dataset.header.carrier_hz,
        has_path=power > 0,
        in_sight=known_line_of_sight(dataset),
        peak_db=peak_db if dataset.header.channels else None,
        num_paths=None if (num_paths == UNKNOWN_NUM_PATHS).any() else num_paths,
        compared_hz=dataset.header.carrier_hz[carriers],
        median_ssim=median_ssim,
        num_compared=len(transmitters),
    )


def _spread(count: int, most: int) -> Int[NDArray[np.int64], "k"]:
    """At most `most` of the indices below `count`, evenly spread, both ends included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
