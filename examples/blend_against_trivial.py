"""Prints the difference of `xfreq-gs` with its blend from the best baseline, with few data: minutes on a core.

`python examples/blend_against_trivial.py 0` takes transmitters of shipped scenes and of two random rooms at the paper's
carriers. It compares medians of SSIM after a training of 64,000 maps: first at a carrier, after a training at other
carriers of the same transmitters, 60 at most; then in a region of the floor, after a training at other places. For
several seeds, as in `0 1 2`, it takes the mean of the medians. Weights for far carriers and transmitters were chosen on
such rooms too.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from xfreqbench.baselines.trivial import TRIVIAL
from xfreqbench.baselines.xfreq_gs import XFreqGS

import xfreqbench as xb
from xfreqbench.data.dataset import isolated
from xfreqbench.methods.fitting import fit_within

BUDGET = xb.Budget(max_maps=64_000)
SCENES = ("office", "two_rooms", "corridor")
CASES = (  # trained on (None: the nine others), tested at, in GHz, and transmitters
    ((1, 2.4, 10, 24.25), 77, 60),
    (None, 94, 60),
    (None, 1, 60),
    ((2.4, 10, 24.25, 77), 1, 24),
    ((10, 24.25, 77), 2.4, 60),
    ((1, 2.4, 5, 24.25), 10, 60),
    ((1, 10, 77), 24.25, 60),
    (None, 2.4, 60),
    (None, 24.25, 24),
    ((10,), 24.25, 60),
)
REGIONS = ("below the array", "lowest x", "highest x", "lowest y", "highest y")  # a sixth of the transmitters each
MARGIN_M = 0.5  # around a region, without training transmitters


def random_room(seed: int) -> xb.Scene:
    """A room of four upright walls at random angles and of random materials, with an array below its ceiling."""
    generator = np.random.default_rng(seed)
    corners = np.array([[0, 0], [6, 0], [6, 4], [0, 4]]) + generator.uniform(-0.8, 0.8, (4, 2))
    height = float(generator.uniform(2.4, 3.2))
    level = [[(x, y, z) for x, y in corners.tolist()] for z in (0.0, height)]
    upright = [
        [(*a, 0.0), (*b, 0.0), (*b, height), (*a, height)]
        for a, b in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist(), strict=True)
    ]
    materials = generator.choice(["concrete", "chipboard", "plasterboard", "glass", "wood"], 6)
    walls = [
        xb.Surface(f"wall {number}", str(material), 0.05, vertices_m=tuple(map(tuple, corners_m)))
        for number, (material, corners_m) in enumerate(zip(materials, [*level, *upright], strict=True))
    ]
    x, y = generator.uniform((2, 1.5), (4, 2.5)).tolist()
    grid = xb.TransmitterGrid((1.0, 1.0, 0.8), (5.0, 3.0, 1.6), (0.4, 0.4, 0.4))
    return xb.Scene(f"random room {seed}", xb.ReceiverArray((x, y, height - 0.2)), grid, surface=tuple(walls))


def ssim(method: xb.Method, tested: xb.PasDataset) -> float:
    """The median over the tested samples."""
    predicted = method.predict(tested.tx_position_m, tested.carrier_hz)
    return float(np.median(xb.metrics.ssim(predicted, tested.pas(), tested.grid)))


def difference(train: xb.PasDataset, tested: xb.PasDataset, seeds: list[int]) -> float:
    """`xfreq-gs` minus the best trivial predictor, in SSIM."""
    train, scores = isolated(train), []
    for make, budget, seed in [*((each, xb.Budget(), 0) for each in TRIVIAL), *((XFreqGS, BUDGET, s) for s in seeds)]:
        method = make()
        fit_within(method, train, budget, seed)
        scores.append(ssim(method, tested))
    return float(np.mean(scores[len(TRIVIAL) :])) - max(scores[: len(TRIVIAL)])


def at_carriers(data: xb.PasDataset, seeds: list[int]) -> Iterator[float]:
    """The difference in each of `CASES`."""
    ghz = (data.carrier_hz / 1e9).round(6)
    for trained, target, num_tx in CASES:
        is_known = (data.tx_index < num_tx) & data.has_path
        is_trained = np.isin(ghz, trained) if trained else ghz != target
        yield difference(data[is_known & is_trained], data[is_known & (ghz == target)], seeds)


def in_regions(data: xb.PasDataset, seeds: list[int]) -> Iterator[float]:
    """The difference in each of `REGIONS`."""
    place_m = data.tx_position_m[:, :2]
    from_array_m = np.linalg.norm(place_m - data.header.receiver.position_m[:2], axis=1)
    for along in (from_array_m, place_m[:, 0], -place_m[:, 0], place_m[:, 1], -place_m[:, 1]):
        is_tested = along <= np.quantile(along, 1 / 6)
        is_near = KDTree(place_m[is_tested]).query(place_m)[0] < MARGIN_M
        yield difference(data[~is_near & data.has_path], data[is_tested & data.has_path], seeds)


def main(seeds: list[int]) -> None:
    """Print both tables."""
    carriers, regions = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for number, scene in enumerate([*SCENES, random_room(1), random_room(2)]):
            for columns, compared, num_tx in ((carriers, at_carriers, 60), (regions, in_regions, 180)):
                data = xb.generate(scene, Path(folder) / f"{number}-{num_tx}.h5", tx=num_tx, maps=False)
                columns[data.header.scene_name] = list(compared(data, seeds))
    print(f"| trained on (GHz) | tested at | transmitters | {' | '.join(carriers)} |")
    print(f"{'| --- ' * 3}{'| ---: ' * len(carriers)}|")
    for (trained, target, num_tx), *cells in zip(CASES, *carriers.values(), strict=True):
        words = ", ".join(f"{each:g}" for each in trained) if trained else "nine carriers"
        print(f"| {words} | {target:g} | {num_tx} | {' | '.join(f'{cell:+.3f}' for cell in cells)} |")
    print(f"\n| tested region | {' | '.join(regions)} |\n| --- {'| ---: ' * len(regions)}|")
    for region, *cells in zip(REGIONS, *regions.values(), strict=True):
        print(f"| {region} | {' | '.join(f'{cell:+.3f}' for cell in cells)} |")


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or [0])
