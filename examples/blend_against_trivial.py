"""Prints how far `xfreq-gs` with its blend is from the best trivial predictor, where data are few: minutes on a core.

`python examples/blend_against_trivial.py 0` takes up to 60 transmitters of shipped scenes, and of two random rooms that
chose no setting, at the paper's carriers. It compares medians of SSIM at a carrier, after a training of 64,000 maps at
other carriers of the same transmitters; of several seeds, as in `0 1 2`, the mean of their medians.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from xfreqbench.baselines.trivial import TRIVIAL
from xfreqbench.baselines.xfreq_gs import XFreqGS

import xfreqbench as xb
from xfreqbench.methods.fitting import fit_within

NUM_TX, BUDGET = 60, xb.Budget(max_maps=64_000)
SCENES = ("office", "two_rooms", "corridor")
CASES = (  # trained on (None: the nine others), tested at, in GHz, and transmitters
    ((1, 2.4, 10, 24.25), 77, 60),
    (None, 94, 60),
    (None, 1, 60),
    ((2.4, 10, 24.25, 77), 1, 24),
    ((1, 10, 77), 24.25, 60),
    (None, 2.4, 60),
    (None, 24.25, 24),
    ((10,), 24.25, 60),
)


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


def differences(data: xb.PasDataset, seeds: list[int]) -> Iterator[float]:
    """In each case, `xfreq-gs` minus the best trivial predictor, in SSIM."""
    ghz = (data.carrier_hz / 1e9).round(6)
    for trained, target, num_tx in CASES:
        is_known = data.tx_index < num_tx
        is_trained = np.isin(ghz, trained) if trained else ghz != target
        train, tested = (data[is_known & part & data.has_path] for part in (is_trained, ghz == target))
        train = train.isolated()
        scores = []
        for make, budget, seed in [
            *((each, xb.Budget(), 0) for each in TRIVIAL),
            *((XFreqGS, BUDGET, s) for s in seeds),
        ]:
            method = make()
            fit_within(method, train, budget, seed)
            scores.append(ssim(method, tested))
        yield float(np.mean(scores[len(TRIVIAL) :])) - max(scores[: len(TRIVIAL)])


def main(seeds: list[int]) -> None:
    """Print the table."""
    columns = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, scene in enumerate([*SCENES, random_room(1), random_room(2)]):
            data = xb.generate(scene, Path(folder) / f"{number}.h5", tx=NUM_TX, maps=False)
            columns[data.header.scene_name] = list(differences(data, seeds))
    print(f"| trained on (GHz) | tested at | transmitters | {' | '.join(columns)} |")
    print(f"{'| --- ' * 3}{'| ---: ' * len(columns)}|")
    for (trained, target, num_tx), *cells in zip(CASES, *columns.values(), strict=True):
        words = ", ".join(f"{each:g}" for each in trained) if trained else "nine carriers"
        print(f"| {words} | {target:g} | {num_tx} | {' | '.join(f'{cell:+.3f}' for cell in cells)} |")


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or [0])
