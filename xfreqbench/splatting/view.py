"""Part of an angular grid, and the beams and training targets on it.

A map of a small array is smooth (PAS of 16 elements: 49 real degrees of freedom), so that some rows
and columns, others at each step, teach almost as much as all of them at a fraction of the cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from xfreqbench.angles import AngularGrid, FloatArray
from xfreqbench.dataset import PasDataset
from xfreqbench.pas import BartlettBeam, PasKind

_MIN_PEAK = 1e-30  # its inverse times the derivative of a root at zero is still a float32


@dataclass(frozen=True)
class View:
    """Every `stride`-th row and column of maps, from an offset on."""

    stride: int = 1
    row: int = 0
    column: int = 0

    def of_grid(self, grid: AngularGrid) -> AngularGrid:
        """The directions in view."""
        azimuth_rad = grid.azimuth_rad[self.column :: self.stride]
        return AngularGrid(grid.elevation_rad[self.row :: self.stride], azimuth_rad)

    def of_maps(self, maps: Tensor) -> Tensor:
        """The values in view of (..., E, A)."""
        return maps[..., self.row :: self.stride, self.column :: self.stride]

    @classmethod
    def draw(cls, stride: int, generator: torch.Generator) -> View:
        """A view with a random offset."""
        row, column = torch.randint(stride, (2,), generator=generator).tolist()
        return cls(stride, row, column)


class Beams:
    """Bartlett beams towards the directions in view (Eqs. 2–3), on a device.

    A beam's power aᴴ C a / M² depends on the channel's covariance C = h hᴴ by its sums over pairs of
    elements that lie equally far apart: 49 real numbers for a 4×4 array, whatever the number of directions
    or of channels added up in C.
    """

    def __init__(self, beam: BartlettBeam, device: torch.device) -> None:
        self.grid, self.device = beam.grid, device
        self.element_position_wavelengths = beam.element_position_wavelengths
        element = self.element_position_wavelengths
        lag = (element[:, None] - element[None]).reshape(-1, 3).round(6)
        pairs = np.flatnonzero(_is_forward(lag))
        unique, of_pair = np.unique(lag[pairs], axis=0, return_inverse=True)
        phase = 2 * np.pi * beam.grid.directions @ unique.T
        weight = np.where((unique == 0).all(axis=1), 1.0, 2.0) / len(element) ** 2
        waves = weight * np.stack([np.cos(phase), np.sin(phase)])
        self._pairs = torch.as_tensor(pairs, device=device)
        self._lag_of_pair = torch.as_tensor(of_pair.reshape(-1), device=device)
        self._waves = torch.as_tensor(waves, dtype=torch.float32, device=device).movedim(-1, 1).flatten(0, 1)
        self._num_lags = len(unique)
        self._in_view: dict[View, Tensor] = {}

    def power(self, cfr: Complex[Tensor, "... B M"], view: View) -> Float[Tensor, "B E A"]:
        """|a(d)ᴴ h|² / M², summed over leading axes: channels that don't interfere."""
        if view not in self._in_view:
            self._in_view[view] = view.of_maps(self._waves).contiguous()
        waves = self._in_view[view]
        channels = cfr.reshape(-1, *cfr.shape[-2:])
        covariance = torch.einsum("qbm,qbn->bmn", channels, channels.conj()).flatten(1)
        lags = covariance.new_zeros(len(covariance), self._num_lags)
        lags = lags.index_add(1, self._lag_of_pair, covariance.index_select(1, self._pairs))
        power = torch.cat([lags.real, lags.imag], dim=1) @ waves.flatten(1)
        return power.clamp_min(0).reshape(-1, *waves.shape[1:])


def _is_forward(lag: Float[FloatArray, "P 3"]) -> Bool[NDArray[np.bool_], "P"]:
    """One of each lag and its opposite, whose sums are conjugates: where the first coordinate but zero is positive."""
    x, y, z = lag.T
    return (x > 0) | ((x == 0) & ((y > 0) | ((y == 0) & (z >= 0))))


class Targets:
    """Training maps in view: derived from the channels where the data hold them, read from disk otherwise."""

    def __init__(self, train: PasDataset, beams: Beams, from_channels: bool = True) -> None:
        self.rows = np.flatnonzero(train.has_path)
        self._train, self._beams = train, beams
        self._device = beams.device
        self._derived = train.header.channels and from_channels

    def __len__(self) -> int:
        return len(self.rows)

    def queries(
        self, nth: Int[Tensor, "B"], blur: float, generator: torch.Generator
    ) -> tuple[Float[Tensor, "B 3"], Float[Tensor, "B"]]:
        """Transmitters (float32) and carriers (float64) of the `nth` rows that have a path.

        Carriers are moved by a deviation of `blur` half bands on a logarithmic axis.
        """
        rows = self.rows[nth.numpy()]
        position_m = torch.as_tensor(self._train.tx_position_m[rows], dtype=torch.float32)
        carrier_hz = torch.as_tensor(self._train.carrier_hz[rows])
        shift = torch.randn(len(nth), generator=generator, dtype=torch.float64) * blur * self._half_band
        return position_m.to(self._device), (carrier_hz * shift.exp()).to(self._device)

    @property
    def positions_and_carriers(self) -> tuple[Float[FloatArray, "n 3"], Float[FloatArray, "n"]]:
        """Of all rows that have a path, float64."""
        return self._train.tx_position_m[self.rows], self._train.carrier_hz[self.rows]

    @cached_property
    def _half_band(self) -> float:
        """Of the logarithm of the training carriers."""
        return float(np.ptp(np.log(self._train.carrier_hz))) / 2

    def maps(self, nth: Int[Tensor, "B"], view: View) -> Float[Tensor, "B E A"]:
        """Maps of the `nth` of those rows, their peak over the whole grid 1 wherever the view looks."""
        if not self._derived:
            maps = self._train.pas(self.rows[nth.numpy()])
            return view.of_maps(torch.from_numpy(maps)).to(self._device)
        power = self._beams.power(self._unit_channels[nth.to(self._device)], view)
        return power.sqrt() if self._train.header.pas_kind == "amplitude" else power

    @cached_property
    def _unit_channels(self) -> Complex[Tensor, "n M"]:
        """Channels whose power maps have peak 1."""
        cfr = self._train.cfr[self.rows].astype(np.complex128)
        if self._train.header.pas_kind == "phase-only":
            cfr = cfr / np.where(cfr == 0, 1, np.abs(cfr))
        scaled = cfr / np.sqrt(self._train.peak_power[self.rows])[:, None]
        return torch.as_tensor(scaled.astype(np.complex64)).to(self._device)


def as_kind(power: Float[Tensor, "B E A"], kind: PasKind) -> Float[Tensor, "B E A"]:
    """Maps of a kind with peak 1, from power of any scale; a map of zeros stays one, but for 1e-6."""
    peak = power.amax(dim=(1, 2), keepdim=True).clamp_min(_MIN_PEAK)
    unit = power / peak
    return (unit + 1e-12).sqrt() if kind == "amplitude" else unit
