"""Data sets for other libraries: figures of Matplotlib and data sets of xarray."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.schema import AXIS, AZIMUTH, CARRIER, ELEMENT, ELEVATION, TX, variables
from xfreqbench.errors import XFreqBenchError
from xfreqbench.maps.bartlett import power_of
from xfreqbench.maps.drawing import map_figure
from xfreqbench.units import format_ghz


def plot(data: PasDataset, sample: int) -> Any:
    """A Matplotlib figure of the map of a sample, by its number: a disc seen from the pole, in dB below the peak.

    `figure.savefig("map.png")` writes it, and a notebook shows it. Raises as `PasDataset.pas` does.
    """
    one = data[[sample]]
    place = ", ".join(f"{metres:.2f}" for metres in one.tx_position_m[0])
    title = f"{format_ghz(one.carrier_hz[0])}, transmitter at ({place}) m"
    return map_figure(power_of(one.pas(), data.header.pas_kind)[0], data.grid, title)


def to_xarray(data: PasDataset) -> Any:
    """The samples as an `xarray.Dataset` along `sample`, with the names, units and angles of the file.

    Coordinates of a sample are its transmitter `tx`, its position (x, y, z) and its carrier. All maps are read: for
    some, give a subset, as in `to_xarray(data[:50])`. Raises as `PasDataset.pas` does, and `XFreqBenchError` if
    xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise XFreqBenchError("to_xarray needs xarray. Run: pip install xarray") from error
    dims = {"pas": ("sample", ELEVATION, AZIMUTH), "cfr": ("sample", ELEMENT), "tx_position_m": ("sample", AXIS)}
    of_file = {variable.name: variable for variable in variables(replace(data.header, maps=True), data.grid)}
    where = {TX: data.tx_index, CARRIER: data.carrier_hz, "tx_position_m": data.tx_position_m}
    of_samples = where | {"line_of_sight": data.tables["line_of_sight"][data.tx_index]}
    of_samples |= {name: data.tables[name].flat[data.rows] for name in ("peak_power", "num_paths")}
    of_samples |= ({"cfr": data.cfr} if data.header.channels else {}) | {"pas": data.pas()}
    about = {name: {"units": of_file[name].units, "long_name": of_file[name].long_name} for name in of_samples}
    arrays = {name: (dims.get(name, "sample"), values, about[name]) for name, values in of_samples.items()}
    angles = {ELEVATION: np.degrees(data.grid.elevation_rad), AZIMUTH: np.degrees(data.grid.azimuth_rad)}
    axes = {name: (name, values, {"units": of_file[name].units}) for name, values in angles.items()}
    title = {"scene": data.header.scene_name, "recipe": data.recipe.name, "source": str(data.path)}
    shown = xarray.Dataset(arrays, axes | {AXIS: ["x", "y", "z"], "sample": data.rows}, title)
    return shown.set_coords(list(where))
