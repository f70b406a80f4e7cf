"""Small folders of the PNG layout, to be read and imported."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from PIL import Image

from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.exchange.conventions import CONVENTIONS
from xfreqbench.exchange.png_dataset import import_png_folder
from xfreqbench.exchange.png_folder import PngFolder, read_png_folder

TRANSMITTERS = ((1.0, 2.0, 3.0), (-1.0, 0.0, 0.5))
CARRIERS_GHZ = (24.25, 2.4)


def levels(number: int) -> np.ndarray:
    """A map of 91 × 361 pixels whose brightest one tells its sample."""
    image = np.full((91, 361), 10, np.uint8)
    image[0], image[number, 10 * number] = 100, 255
    return image


def write_folder(folder: Path) -> Path:
    """Two transmitters × two carriers; samples run over transmitters first."""
    (folder / "spectrum").mkdir(parents=True)
    samples = list(itertools.product(CARRIERS_GHZ, TRANSMITTERS))
    rows = [",".join(map(str, position)) for _, position in samples]
    (folder / "tx_pos.csv").write_text("\n".join(["x,y,z", *rows]))
    (folder / "freq.txt").write_text("\n".join(str(carrier) for carrier, _ in samples))
    (folder / "gateway_info.yml").write_text(
        "dataset_name: small\ngateway1:\n  position: [2,1,-0.5]\n"
        "  orientation:  [ 0.0, 0.0, 0.0,  1.0]  # quaternion x y z w\n"
    )
    for number in range(1, len(samples) + 1):
        Image.fromarray(levels(number)).save(folder / "spectrum" / f"{number:05d}.png")
    return folder


def read(folder: Path) -> PngFolder:
    return read_png_folder(folder, CONVENTIONS["wideband3dgs"])


def imported(folder: Path, path: Path) -> PasDataset:
    import_png_folder(read(folder), path)
    return open_dataset(path)
