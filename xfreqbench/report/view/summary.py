"""Numbers that say how a data set changes from carrier to carrier."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.schema import UNKNOWN_NUM_PATHS
from xfreqbench.maps.metrics import ssim
from xfreqbench.types import FloatArray, NDArray

MAX_COMPARED_TX = 200
MAX_COMPARED_CARRIERS = 16
_MAX_COMPARISONS = 2500  # each of two maps, which takes 1.3 ms


@dataclass(frozen=True, eq=False)
class Similarity:
    """Median SSIM between the maps of one transmitter at two carriers, over `num_tx` transmitters.

    `median_ssim` is symmetric, 1 on the diagonal, nan where no transmitter is heard at both carriers.
    """

    carrier_hz: Float[FloatArray, "K"]
    median_ssim: Float[FloatArray, "K K"]
    num_tx: int


@dataclass(frozen=True, eq=False)
class CarrierSummary:
    """T transmitters at F carriers.

    `peak_db` is the peak of each map in dB before it was divided out, nan without a path; it and
    `num_paths` are None where only maps were published. `in_sight` is None then too.
    """

    carrier_hz: Float[FloatArray, "F"]
    has_path: Bool[NDArray[np.bool_], "T F"]
    in_sight: Bool[NDArray[np.bool_], "T"] | None
    peak_db: Float[FloatArray, "T F"] | None
    num_paths: Int[NDArray[np.integer], "T F"] | None
    similarity: Similarity

    def groups(self) -> dict[str, Bool[NDArray[np.bool_], "T"]]:
        """Masks of the transmitters in sight and in shadow, without empty groups; of all where that is not known."""
        if self.in_sight is None:
            return {"all transmitters": np.ones(len(self.has_path), dtype=bool)}
        both = {"in sight": self.in_sight, "in shadow": ~self.in_sight}
        return {name: members for name, members in both.items() if members.any()}


def known_line_of_sight(dataset: PasDataset) -> Bool[NDArray[np.bool_], "T"] | None:
    """Whether nothing stands between each transmitter and the array; None where only maps were published."""
    return dataset.tables["line_of_sight"].astype(bool) if dataset.header.channels else None


def summarize(dataset: PasDataset) -> CarrierSummary:
    """Numbers of a whole data set; raises `DataError`."""
    power = dataset.tables["peak_power"]
    num_paths = dataset.tables["num_paths"]
    with np.errstate(divide="ignore"):
        peak_db = np.where(power > 0, 10 * np.log10(power), np.nan)
    return CarrierSummary(
        carrier_hz=dataset.header.carrier_hz,
        has_path=power > 0,
        in_sight=known_line_of_sight(dataset),
        peak_db=peak_db if dataset.header.channels else None,
        num_paths=None if (num_paths == UNKNOWN_NUM_PATHS).any() else num_paths,
        similarity=similarity(dataset),
    )


def similarity(dataset: PasDataset) -> Similarity:
    """Compare the maps of evenly spread transmitters at evenly spread carriers, all where there are few."""
    carriers = _spread(dataset.header.num_carriers, MAX_COMPARED_CARRIERS)
    pairs = list(combinations(range(len(carriers)), 2))
    transmitters = _spread(dataset.header.num_tx, min(MAX_COMPARED_TX, _MAX_COMPARISONS // max(1, len(pairs))))
    scores = np.full((len(transmitters), len(pairs)), np.nan)  # where one of the two maps is empty
    for row, tx in enumerate(transmitters.tolist() if pairs else ()):
        first, second = np.array(pairs).T
        rows = tx * dataset.header.num_carriers + carriers
        maps, heard = dataset.pas(rows), dataset.has_path[rows]
        both = heard[first] & heard[second]
        scores[row, both] = ssim(maps[first[both]], maps[second[both]], dataset.grid)
    matrix = np.eye(len(carriers))
    for (first, second), values in zip(pairs, scores.T, strict=True):
        known = values[~np.isnan(values)]
        matrix[[first, second], [second, first]] = np.median(known) if len(known) else np.nan
    return Similarity(dataset.header.carrier_hz[carriers], matrix, len(transmitters))


def _spread(count: int, most: int) -> Int[NDArray[np.int64], "k"]:
    """At most `most` of the indices below `count`, evenly spread, both ends included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
