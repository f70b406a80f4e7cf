"""What training sees of maps: a view of the angular grid, beams towards its directions, and training targets.

The map of a small array is smooth: with 16 elements it has 49 real degrees of freedom. A few rows and columns,
chosen anew at each step, therefore teach almost as much as all of them at a fraction of the cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor

from xfreqbench.data.dataset import PasDataset
from xfreqbench.maps.bartlett import BartlettBeam, PasKind
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.types import FloatArray

_RIDGE = 1e-6  # of the largest mean square of a lag function
_MIN_PEAK = 1e-30  # so that the gradient of a square root at zero, divided by the peak, is a finite float32


@dataclass(frozen=True)
class GridView:
    """A part of a map: every `stride`-th row and column, beginning at `row` and `column`."""

    stride: int = 1
    row: int = 0
    column: int = 0

    def of_grid(self, grid: AngularGrid) -> AngularGrid:
        """The grid of directions in view."""
        azimuth_rad = grid.azimuth_rad[self.column :: self.stride]
        return AngularGrid(grid.elevation_rad[self.row :: self.stride], azimuth_rad)

    def of_maps(self, maps: Tensor) -> Tensor:
        """The values in view of maps (..., E, A)."""
        return maps[..., self.row :: self.stride, self.column :: self.stride]

    @classmethod
    def draw(cls, stride: int, generator: torch.Generator) -> GridView:
        """A view that begins at a random row and column below `stride`."""
        row, column = torch.randint(stride, (2,), generator=generator).tolist()
        return cls(stride, row, column)


class Beams:
    """Bartlett beams towards the directions in view (Eqs. 2–3), on a device.

    Power is computed from the channel's sums over pairs of elements with the same lag: see `LagFunctions`.
    """

    def __init__(self, beam: BartlettBeam, device: torch.device) -> None:
        self.grid, self.device = beam.grid, device
        self.element_position_wavelengths = beam.element_position_wavelengths
        lags = LagFunctions(beam)
        self._pairs = torch.as_tensor(lags.pairs, device=device)
        self._lag_of_pair = torch.as_tensor(lags.of_pair, device=device)
        self._waves = torch.as_tensor(lags.waves, dtype=torch.float32, device=device)
        self._num_lags = len(lags.lag)
        self._in_view: dict[GridView, Tensor] = {}
        self._projections: dict[GridView, Tensor] = {}
        self._angles: dict[GridView, tuple[Tensor, Tensor]] = {}
        self.element = torch.as_tensor(beam.element_position_wavelengths, device=device)  # positions in wavelengths

    def power(self, cfr: Complex[Tensor, "... B M"], view: GridView) -> Float[Tensor, "B E A"]:
        """Power `|a(d)ᴴ h|² / M²` in view, summed over the leading axes of `cfr`: channels that do not interfere."""
        return self.power_of_lags(self.lags_of_channels(cfr), view)

    def lags_of_channels(self, cfr: Complex[Tensor, "... B M"]) -> Float[Tensor, "B L"]:
        """Sums over lags of channels, real parts first, added up over the leading axes of `cfr`."""
        channels = cfr.reshape(-1, *cfr.shape[-2:])
        covariance = torch.einsum("qbm,qbn->bmn", channels, channels.conj()).flatten(1)
        lags = covariance.new_zeros(len(covariance), self._num_lags)
        lags = lags.index_add(1, self._lag_of_pair, covariance.index_select(1, self._pairs))
        return torch.cat([lags.real, lags.imag], dim=1)

    def power_of_lags(self, lags: Float[Tensor, "B L"], view: GridView) -> Float[Tensor, "B E A"]:
        """Power in view of maps that are given by their sums over lags, real parts first; never below 0."""
        waves = self._waves_in(view)
        return (lags @ waves.flatten(1)).clamp_min(0).reshape(-1, *waves.shape[1:])

    def peak_of_lags(self, lags: Float[Tensor, "B L"], *views: GridView) -> Float[Tensor, "B 1"]:
        """The highest power in any of the views, above 0; its slope is that of the power in that direction."""
        waves = [self._waves_in(view).flatten(1) for view in views]
        with torch.no_grad():
            power, direction = zip(*((lags @ wave).max(dim=1) for wave in waves), strict=True)
        highest = torch.stack(power).argmax(dim=0)
        there = torch.stack([wave.T[nth] for wave, nth in zip(waves, direction, strict=True)])
        at_peak = there[highest, torch.arange(len(lags), device=self.device)]
        return (lags * at_peak).sum(dim=1, keepdim=True).clamp_min(_MIN_PEAK)

    def lags_of(self, power: Float[Tensor, "B E A"], view: GridView) -> Float[Tensor, "B L"]:
        """The sums over lags of the map that the array can give nearest to the power in view, by least squares.

        Its sums are those of `power_of_lags`. Some lag functions almost vanish on the visible half of the sphere, and
        a ridge of `_RIDGE` holds their sums down.
        """
        if view not in self._projections:
            waves = self._waves_in(view).flatten(1).double()
            gram = waves @ waves.T
            gram += _RIDGE * gram.diagonal().max() * torch.eye(len(gram)).to(gram)
            self._projections[view] = torch.linalg.solve(gram, waves).T.float().contiguous()
        return power.flatten(1) @ self._projections[view]

    def coarse_view(self, stride: int) -> GridView:
        """Every `stride`-th row and column, or more of them, so that directions are four times as many as lags."""
        rows, columns = self.grid.shape
        enough = 4 * len(self._waves)
        return GridView(next((n for n in range(stride, 1, -1) if -(-rows // n) * -(-columns // n) >= enough), 1))

    def angles_in(self, view: GridView) -> tuple[Float[Tensor, "A"], Float[Tensor, "E"]]:
        """Azimuths and elevations in view, rad, on the device."""
        if view not in self._angles:
            grid = view.of_grid(self.grid)
            angles = torch.as_tensor(grid.azimuth_rad), torch.as_tensor(grid.elevation_rad)
            self._angles[view] = angles[0].float().to(self.device), angles[1].float().to(self.device)
        return self._angles[view]

    def _waves_in(self, view: GridView) -> Float[Tensor, "L E A"]:
        """The real functions of the lags in view."""
        if view not in self._in_view:
            self._in_view[view] = view.of_maps(self._waves).contiguous()
        return self._in_view[view]


class Targets:
    """Training maps in view, for the rows that have a path.

    They are `derived` from the channels where the data set stores them, and read from disk otherwise or where
    `from_channels` is false.
    """

    def __init__(self, train: PasDataset, beams: Beams, from_channels: bool = True) -> None:
        self.rows = np.flatnonzero(train.has_path)
        self._train, self._beams = train, beams
        self._device = beams.device
        self.derived = train.header.channels and from_channels

    def __len__(self) -> int:
        return len(self.rows)

    def queries(
        self, nth: Int[Tensor, "B"], blur: float, generator: torch.Generator
    ) -> tuple[Float[Tensor, "B 3"], Float[Tensor, "B"]]:
        """Transmitters in metres (float32) and carriers in Hz (float64) of the `nth` rows that have a path.

        Carriers are moved at random on a logarithmic axis, with a standard deviation of `blur` half bands, but not out
        of the band.
        """
        rows = self.rows[nth.numpy()]
        position_m = torch.as_tensor(self._train.tx_position_m[rows], dtype=torch.float32)
        carrier_hz = torch.as_tensor(self._train.carrier_hz[rows])
        shift = torch.randn(len(nth), generator=generator, dtype=torch.float64) * blur * self._half_band
        moved_hz = (carrier_hz * shift.exp()).clamp(*self._band_hz)
        return position_m.to(self._device), moved_hz.to(self._device)

    @property
    def positions_and_carriers(self) -> tuple[Float[FloatArray, "n 3"], Float[FloatArray, "n"]]:
        """Transmitters in metres and carriers in Hz of all rows that have a path, float64."""
        return self._train.tx_position_m[self.rows], self._train.carrier_hz[self.rows]

    @cached_property
    def _half_band(self) -> float:
        """Half the range of the logarithms of the training carriers."""
        return float(np.ptp(np.log(self._train.carrier_hz))) / 2

    @cached_property
    def _band_hz(self) -> tuple[float, float]:
        return float(self._train.carrier_hz.min()), float(self._train.carrier_hz.max())

    def maps(self, nth: Int[Tensor, "B"], view: GridView) -> Float[Tensor, "B E A"]:
        """Maps in view of the `nth` rows that have a path, scaled so that the peak of the whole map is 1."""
        if not self.derived:
            maps = self._train.pas(self.rows[nth.numpy()])
            return view.of_maps(torch.from_numpy(maps)).to(self._device)
        power = self._beams.power_of_lags(self._lags[nth.to(self._device)], view)
        return power.sqrt() if self._train.header.pas_kind == "amplitude" else power

    @cached_property
    def _lags(self) -> Float[Tensor, "n L"]:
        """Sums over lags of the channels, scaled so that their power maps have peak 1."""
        cfr = self._train.cfr[self.rows].astype(np.complex128)
        if self._train.header.pas_kind == "phase-only":
            cfr = cfr / np.where(cfr == 0, 1, np.abs(cfr))
        scaled = cfr / np.sqrt(self._train.tables["peak_power"].flat[self._train.rows[self.rows]])[:, None]
        channels = torch.as_tensor(scaled.astype(np.complex64)).to(self._device)
        # of so many at a time, all products of pairs of elements are in memory
        return torch.cat([self._beams.lags_of_channels(part) for part in channels.split(4096)])


def of_peak(power: Float[Tensor, "B E A"]) -> Float[Tensor, "B E A"]:
    """Power of any scale, divided by its peak; a zero map remains zero."""
    return power / power.amax(dim=(1, 2), keepdim=True).clamp_min(_MIN_PEAK)


def in_kind(unit_power: Float[Tensor, "B E A"], kind: PasKind) -> Float[Tensor, "B E A"]:
    """Maps of a kind from power of peak 1; a zero map remains zero."""
    if kind != "amplitude":
        return unit_power
    return (unit_power + 1e-12).sqrt() * (unit_power.amax(dim=(1, 2), keepdim=True) > 0)


def as_kind(power: Float[Tensor, "B E A"], kind: PasKind) -> Float[Tensor, "B E A"]:
    """Maps of a kind, scaled to peak 1, from power of any scale."""
    return in_kind(of_peak(power), kind)
