"""A method that learns from many rooms how far the direct wave's map has to be flattened, and uses it in new ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import xfreqbench as xb


@dataclass(frozen=True)
class SoftDirectWaveConfig:
    """Options that `--set` takes."""

    powers: tuple[float, ...] = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)


class SoftDirectWave:
    """Raises the map of the direct wave to the power that suits most of the training rooms."""

    num_parameters = 1

    def __init__(self, config: SoftDirectWaveConfig = SoftDirectWaveConfig()) -> None:
        self.config, self.power = config, 1.0

    def fit(self, rooms: xb.Collection, budget: xb.Budget, seed: int) -> Iterator[xb.Progress]:
        """Try each power on some maps of every room; `adapt` is valid at every yield."""
        best = -1.0
        for step, power in enumerate(self.config.powers, start=1):
            score = float(np.median([self._score(room[::97], power) for room in rooms]))
            if score > best:
                best, self.power = score, power
            yield xb.Progress(step, 1 - best, {"maps": step * len(rooms), "rooms": len(rooms)})

    def _score(self, room: xb.PasDataset, power: float) -> float:
        maps = SoftDirectWaveRoom(room, power).predict(room.tx_position_m, room.carrier_hz)
        return float(np.median(xb.metrics.ssim(maps, room.pas(), room.grid)))

    def adapt(self, heard: xb.PasDataset, budget: xb.Budget) -> SoftDirectWaveRoom:
        """The predictor for a new room; `heard` has the samples that are given of it, possibly none."""
        return SoftDirectWaveRoom(heard, self.power)

    def save(self, directory: Path) -> None:
        """Store what `load` needs in an existing folder."""
        (directory / "state.json").write_text(json.dumps({"powers": self.config.powers, "power": self.power}))

    @classmethod
    def load(cls, directory: Path) -> SoftDirectWave:
        """The method as `save` stored it."""
        state = json.loads((directory / "state.json").read_text())
        method = cls(SoftDirectWaveConfig(tuple(state["powers"])))
        method.power = state["power"]
        return method


@dataclass(frozen=True)
class SoftDirectWaveRoom:
    """Predicts the maps of one room, with the array of `heard`."""

    heard: xb.PasDataset
    power: float

    def predict(self, tx_position_m: Any, carrier_hz: Any) -> Any:
        """Maps (B, E, A), float32 with peak 1, of transmitters (B, 3) in metres at carriers (B,) in hertz."""
        direct = xb.PerRoom("line-of-sight").adapt(self.heard, xb.Budget())
        maps = direct.predict(tx_position_m, carrier_hz) ** self.power
        return (maps / maps.max(axis=(1, 2), keepdims=True)).astype(np.float32)
