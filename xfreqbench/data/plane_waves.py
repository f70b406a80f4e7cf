"""Small data sets of a few plane waves, for checks that need no scene."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from jaxtyping import Complex, Float

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.maps.bartlett import BartlettBeam, cfr_of_plane_waves
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.types import FloatArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

RECEIVER = ReceiverArray(position_m=(4.0, 3.0, 2.6))


def plane_wave_data(path: Path, carrier_hz: Float[FloatArray, "F"], num_tx: int) -> PasDataset:
    """A data set of random transmitters in an empty room with one wall: two plane waves each, no rays traced."""
    return stored_channels(path, RECEIVER, carrier_hz, *plane_waves(carrier_hz, num_tx), maps=True)


def plane_waves(
    carrier_hz: Float[FloatArray, "F"], num_tx: int, seed: int = 0
) -> tuple[Float[FloatArray, "T 3"], Complex[NDArray[np.complex128], "T F M"]]:
    """Positions of random transmitters in metres, and their channels."""
    tx_position_m = np.random.default_rng(seed).uniform((0.5, 0.5, 0.9), (7.5, 5.5, 1.7), size=(num_tx, 3))
    cfr = np.array([[_channel(place, float(carrier)) for carrier in carrier_hz] for place in tx_position_m])
    return tx_position_m, cfr


def stored_channels(
    path: Path,
    receiver: ReceiverArray,
    carrier_hz: Float[FloatArray, "F"],
    tx_position_m: Float[FloatArray, "T 3"],
    cfr: Complex[NDArray[np.complex128], "T F M"],
    *,
    maps: bool,
) -> PasDataset:
    """Write channels as a data set without a scene, and open it; without `maps` these are derived when read."""
    header = DatasetHeader(
        scene_name="plane waves",
        scene_json="{}",
        scene_sha256="0" * 64,
        receiver=receiver,
        carrier_hz=carrier_hz,
        num_tx=len(tx_position_m),
        pas_kind="power",
        maps=maps,
        settings={},
        software={},
        rejected={},
    )
    beam = BartlettBeam(receiver.element_position_wavelengths, AngularGrid.hemisphere())
    with PasWriter(path, header) as writer:
        for start in range(0, len(cfr), 64):  # transmitters whose maps are derived at once
            channels = cfr[start : start + 64]
            num_paths = np.full(channels.shape[:2], 2)
            samples = SampleBlock.of_channels(channels, num_paths, beam, header.pas_kind)
            positions = tx_position_m[start : start + 64]
            writer.append(positions, np.ones(len(positions), bool), samples)
    return open_dataset(path)


def _channel(tx_position_m: Float[FloatArray, "3"], carrier_hz: float) -> Complex[NDArray[np.complex128], "M"]:
    """Channel of the direct wave and of the one reflected by the wall x = 0, by 0.4."""
    offset_m = np.array([tx_position_m, tx_position_m * (-1, 1, 1)]) - np.asarray(RECEIVER.position_m)
    arrival = offset_m @ RECEIVER.rotation
    length_m = np.linalg.norm(arrival, axis=1)
    wavelength_m = SPEED_OF_LIGHT_M_S / carrier_hz
    return cfr_of_plane_waves(
        np.array([1, 0.4]) * wavelength_m / (4 * math.pi * length_m) + 0j,
        length_m / SPEED_OF_LIGHT_M_S,
        arrival / length_m[:, None],
        RECEIVER.element_position_wavelengths * wavelength_m,
        carrier_hz,
    )
