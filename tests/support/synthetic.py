"""A small data set of plane waves: the direct path and two mirror images, no rays traced."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.schema import DatasetHeader
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.maps.bartlett import BartlettBeam, PasKind, cfr_of_plane_waves
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.scene.model import ReceiverArray
from xfreqbench.units import PAPER_CARRIERS_GHZ, SPEED_OF_LIGHT_M_S, ghz_to_hz

RECEIVER = ReceiverArray(position_m=(4.0, 3.0, 2.6), rows=2, cols=2)
MIRROR_PLANES = ((0, 0.0, 0.5), (1, 6.0, 0.3))  # axis, offset in metres, reflection coefficient


def make_header(
    num_tx: int = 4, carriers_ghz: tuple[float, ...] = (1.0, 10.0, 37.0), maps: bool = True, pas_kind: PasKind = "power"
) -> DatasetHeader:
    return DatasetHeader(
        scene_name="synthetic",
        scene_json='{"name": "synthetic"}',
        scene_sha256="0" * 64,
        receiver=RECEIVER,
        carrier_hz=np.array([ghz_to_hz(carrier) for carrier in carriers_ghz]),
        num_tx=num_tx,
        pas_kind=pas_kind,
        maps=maps,
        settings={"max_depth": 1},
        software={"numpy": "2"},
        rejected={"inside an object": 1},
    )


def transmitters(num_tx: int) -> np.ndarray:
    return np.random.default_rng(3).uniform((0.5, 0.5, 0.9), (7.5, 5.5, 1.7), size=(num_tx, 3))


def channel(tx_position_m: np.ndarray, carrier_hz: float) -> np.ndarray:
    images = [tx_position_m, *(_mirror(tx_position_m, axis, offset) for axis, offset, _ in MIRROR_PLANES)]
    offset_m = (np.array(images) - np.array(RECEIVER.position_m)) @ RECEIVER.rotation
    length_m = np.linalg.norm(offset_m, axis=1)
    wavelength_m = SPEED_OF_LIGHT_M_S / carrier_hz
    coefficient = np.array([1.0, *(strength for *_, strength in MIRROR_PLANES)])
    return cfr_of_plane_waves(
        (coefficient * wavelength_m / (4 * np.pi * length_m)).astype(complex),
        length_m / SPEED_OF_LIGHT_M_S,
        offset_m / length_m[:, None],
        RECEIVER.element_position_wavelengths * wavelength_m,
        carrier_hz,
    )


def append_all(
    writer: PasWriter, header: DatasetHeader, silent: tuple[tuple[int, int], ...] = (), batch: int = 3
) -> None:
    """Feed every transmitter; the channel is zero at the `silent` pairs (transmitter, carrier)."""
    tx_position_m = transmitters(header.num_tx)
    cfr = np.array([[channel(position, carrier) for carrier in header.carrier_hz] for position in tx_position_m])
    num_paths = np.full(cfr.shape[:2], 1 + len(MIRROR_PLANES), dtype=np.int32)
    for pair in silent:
        cfr[pair], num_paths[pair] = 0, 0
    line_of_sight = np.arange(header.num_tx) % 2 == 0
    beam = BartlettBeam(header.receiver.element_position_wavelengths, AngularGrid.hemisphere())
    for start in range(0, header.num_tx, batch):
        part = slice(start, start + batch)
        samples = SampleBlock.of_channels(cfr[part], num_paths[part], beam, header.pas_kind)
        writer.append(tx_position_m[part], line_of_sight[part], samples)


def write_dataset(
    path: Path,
    num_tx: int = 4,
    carriers_ghz: tuple[float, ...] = (1.0, 10.0, 37.0),
    maps: bool = True,
    silent: tuple[tuple[int, int], ...] = (),
) -> PasDataset:
    header = make_header(num_tx, carriers_ghz, maps)
    with PasWriter(path, header) as writer:
        append_all(writer, header, silent)
    return open_dataset(path)


def paper_dataset(path: Path, num_tx: int = 3) -> PasDataset:
    return write_dataset(path, num_tx, PAPER_CARRIERS_GHZ)


def _mirror(point_m: np.ndarray, axis: int, offset_m: float) -> np.ndarray:
    image = point_m.copy()
    image[axis] = 2 * offset_m - image[axis]
    return image
