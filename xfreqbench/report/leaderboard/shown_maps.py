"""Maps of a dozen test samples, true and predicted, small enough to be shipped in one file beside the records.

Each line of the file is a `ShownMaps` as JSON. Maps are levels of 8 bits on every fourth row and column: 0 is 30 dB
below the peak or less, 255 the peak. The array's beam is 26° wide, so that four degrees show it.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int, UInt8
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import DataError
from xfreqbench.maps.bartlett import power_of
from xfreqbench.maps.metrics import score_all
from xfreqbench.runs.predictions import Predictions
from xfreqbench.runs.records import FiniteScore, RunRecord, fault_of_fields
from xfreqbench.runs.scoring import BATCH_SIZE
from xfreqbench.runs.sealed import SealedModel
from xfreqbench.system.files import read_bytes, require_own, write_text
from xfreqbench.types import IntArray, Maps, NDArray

NUM_SHOWN = 12  # samples of a split
RANGE_DB = 30.0
_STRIDE = 4
_DECIMALS = 4

Levels = UInt8[NDArray[np.uint8], "n R C"]
Position = tuple[FiniteScore, FiniteScore, FiniteScore]


class PredictedMaps(BaseModel):
    """What one run predicts for the samples: scores of the whole maps, and their levels as a PNG in base64."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    ssim: tuple[FiniteScore, ...]
    psnr: tuple[float, ...]
    maps: str


class ShownMaps(SealedModel):
    """Samples of one split with their true maps, and what several runs predict, by the ids of their records.

    The maps of all samples stand one below the other in a picture, the pole at the upper edge of each.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    split: str
    tx_position_m: Annotated[tuple[Position, ...], Field(min_length=1, max_length=NUM_SHOWN)]
    carrier_hz: tuple[FiniteScore, ...]
    truth: str
    predicted: dict[str, PredictedMaps]

    @model_validator(mode="after")
    def _require_equal_lengths(self) -> ShownMaps:
        counted = [self.carrier_hz, *(scores for run in self.predicted.values() for scores in (run.ssim, run.psnr))]
        if any(len(values) != len(self.tx_position_m) for values in counted):
            raise ValueError(f"not all of its lists have {len(self.tx_position_m)} samples")
        return self

    def true_levels(self) -> Levels:
        """The levels of the true maps, a byte each; raises `DataError`."""
        return _levels_of(self.truth, len(self.carrier_hz))

    def levels_of(self, record_id: str) -> Levels:
        """The levels of the maps of a run; raises `DataError`."""
        return _levels_of(self.predicted[record_id].maps, len(self.carrier_hz))


def power_levels(maps: Float[Maps, "n E A"], dataset: PasDataset) -> Levels:
    """The levels of maps on every fourth row and column, the row next to the pole first."""
    power = power_of(maps, dataset.header.pas_kind)
    level = 1 + 10 * np.log10(np.maximum(power, np.float32(10 ** (-RANGE_DB / 10)))) / np.float32(RANGE_DB)
    upwards = np.argsort(-dataset.grid.elevation_rad)[::_STRIDE]
    return np.round(np.clip(level, 0, 1) * 255).astype(np.uint8)[:, upwards, ::_STRIDE]


def chosen_samples(records: Iterable[RunRecord], num_test: int) -> Int[IntArray, "n"]:
    """Positions of a dozen among the tested samples, from the easiest to the hardest by the records' mean SSIM.

    They are equally far apart in that order, and include its ends. All of fewer than a dozen are chosen.
    """
    ssim = [np.concatenate([np.asarray(values) for values in record.ssim_by_tx]) for record in records]
    mean = np.mean([values for values in ssim if len(values) == num_test] or [np.zeros(num_test)], axis=0)
    order = np.argsort(-mean, kind="stable")
    return order[np.unique(np.linspace(0, num_test - 1, min(NUM_SHOWN, num_test)).round().astype(np.int64))]


def shown_maps(
    dataset: PasDataset, split: str, rows: Int[IntArray, "n"], predictions: Mapping[str, Predictions]
) -> ShownMaps:
    """The maps at some rows of a data set, true and as stored, `predictions` by the ids of their records.

    Raises `DataError` as reading the predictions does.
    """
    samples, truth = dataset[rows], dataset.pas(rows)
    found = {}
    for record_id, stored in predictions.items():
        maps = stored.maps_of(rows, BATCH_SIZE)
        scores = score_all(maps, truth, dataset.grid, dataset.header.pas_kind)
        ssim, psnr = (tuple(scores[name].round(_DECIMALS).tolist()) for name in ("ssim", "psnr"))
        found[record_id] = PredictedMaps(ssim=ssim, psnr=psnr, maps=_png(power_levels(maps, dataset)))
    return ShownMaps(
        split=split,
        tx_position_m=tuple(map(tuple, samples.tx_position_m.round(_DECIMALS).tolist())),
        carrier_hz=tuple(samples.carrier_hz.tolist()),
        truth=_png(power_levels(truth, dataset)),
        predicted=found,
    )


def _png(levels: Levels) -> str:
    """A picture of maps, one below the other, in base64."""
    from xfreqbench.report.drawing.figures import grey_png

    return b64encode(grey_png(levels.reshape(-1, levels.shape[-1]))).decode()


def _levels_of(png: str, number: int) -> Levels:
    """The levels of so many maps in a picture; raises `DataError`."""
    from xfreqbench.report.drawing.figures import grey_levels

    try:
        levels = grey_levels(b64decode(png, validate=True))
        return levels.reshape(number, -1, levels.shape[1])
    except ValueError as error:
        raise DataError(f"Maps to be shown are no picture of {number} maps: {error}. Write them again.") from error


def write_maps(path: Path, shown: Sequence[ShownMaps]) -> None:
    """Write maps as lines of JSON; raises `StorageError`, and `OutputExistsError` where another file lies."""
    require_own_maps(path)
    write_text(path, "".join(maps.sealed_json().decode() + "\n" for maps in shown))


def require_own_maps(path: Path) -> None:
    """Raise `OutputExistsError` where a file exists that `write_maps` did not write."""

    def fault_of(file: Path) -> str | None:
        try:
            read_maps(file)
        except DataError:
            return "holds no maps to be shown"
        return None

    require_own(path, fault_of)


def read_maps(path: Path) -> dict[str, ShownMaps]:
    """The maps of a file, by the ids of the records whose predictions are in them; none if there is no such file.

    Raises `DataError` that names file and line.
    """
    if not path.exists():
        return {}
    found: dict[str, ShownMaps] = {}
    try:
        lines = read_bytes(path).splitlines()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}.") from error
    for number, line in enumerate(lines, start=1):
        try:
            shown = ShownMaps.model_validate_json(line)
        except ValidationError as error:
            raise DataError(
                f"{path}, line {number}, holds no maps to be shown: {fault_of_fields(error)}. Delete the file, or "
                "write it again: xfreqbench report RESULTS --maps FILE"
            ) from error
        found |= dict.fromkeys(shown.predicted, shown)
    return found
