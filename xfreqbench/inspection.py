"""What a data set holds, in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xfreqbench.dataset import PasDataset, open_dataset
from xfreqbench.units import format_ghz


def describe(path: Path) -> str:
    """Summary and validity report of a data set; raises `DataError`."""
    dataset = open_dataset(path)
    header = dataset.header
    receiver = header.receiver
    lit = np.unique(dataset.tx_index[dataset.line_of_sight])
    lines = [
        f"{path}: scene {header.scene_name!r}, {header.num_tx} transmitters ({len(lit)} in sight of the "
        f"receiver) × {dataset.num_carriers} carriers",
        f"receiver   {receiver.rows} × {receiver.cols} elements {receiver.spacing_wavelengths:g} wavelengths "
        f"apart at {receiver.position_m} m, boresight {receiver.boresight}, {receiver.pattern} pattern, "
        f"polarization {receiver.polarization}",
        f"maps       {header.pas_kind}, {'stored' if header.maps else 'derived from the channels when read'}, "
        f"{dataset.grid.shape[0]} elevations × {dataset.grid.shape[1]} azimuths",
        "settings   " + ", ".join(f"{name} {value}" for name, value in header.settings.items()),
        "software   " + ", ".join(f"{name} {version}" for name, version in header.software.items()),
        "left out   " + (", ".join(f"{count} {why}" for why, count in header.rejected.items()) or "nothing"),
        f"sha256     {dataset.sha256}",
        "",
        "carrier      without path   median paths   peak power median (dB)",
    ]
    return "\n".join(lines + _carrier_lines(dataset))


def _carrier_lines(dataset: PasDataset) -> list[str]:
    lines = []
    for carrier_hz in dataset.header.carrier_hz:
        at_carrier = dataset.subset(np.flatnonzero(dataset.carrier_hz == carrier_hz))
        power = at_carrier.peak_power[at_carrier.has_path]
        median_db = f"{10 * np.log10(np.median(power)):.1f}" if len(power) else "none"
        lines.append(
            f"{format_ghz(carrier_hz):12} {int((~at_carrier.has_path).sum()):12} "
            f"{np.median(at_carrier.num_paths):14.0f}   {median_db:>22}"
        )
    return lines
