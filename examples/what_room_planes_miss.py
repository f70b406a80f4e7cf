"""Prints what `room-planes` would gain if parts of what it finds were true: ten minutes on a core, after the fit.

`python examples/what_room_planes_miss.py rooms method 40` takes the first 40 validation rooms of collection `rooms`,
with 64 transmitters heard. `method` is the folder of a fitted `room-planes`, which has a file `slabs.json`, as in
`results/methods/0123456789abcdef/1/method`. A row has the mean over rooms of SSIM (mean of the medians at 2.4, 24.25
and 77 GHz), and how much higher it is than that of `room-lags`, with the 95 % interval when rooms are resampled.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from xfreqbench.baselines.room_planes.method import RoomPlanes, WithPlanes
from xfreqbench.baselines.room_planes.search import FoundPlane
from xfreqbench.baselines.room_planes.shares import HeardShares

import xfreqbench as xb
from xfreqbench.data.collection import open_collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.unseen_rooms import ASKED_GHZ, room_question
from xfreqbench.maps.metrics import score_all
from xfreqbench.scene.imported import Slab
from xfreqbench.types import FloatArray
from xfreqbench.units import ghz_to_hz

LEAST_AREA_M2, NEAR_M = 5.0, 0.008
SHELL = ("wall", "partition", "floor", "ceiling")


def true_planes(room: PasDataset) -> list[FoundPlane]:
    """The planes across the axes that have surfaces of 5 m² or more, each with the slab of the largest."""
    planes = dict[tuple[float, ...], tuple[float, FoundPlane]]()
    for surface in room.scene.surface:
        corners_m = surface.corners_m - np.asarray(room.header.receiver.position_m)
        span_m, axis = np.ptp(corners_m, axis=0), int(np.ptp(corners_m, axis=0).argmin())
        area_m2, at_m = float(np.delete(span_m, axis).prod()), float(corners_m[0, axis])
        if surface.mirrors is False or span_m[axis] > 1e-6 or area_m2 < LEAST_AREA_M2:
            continue
        normal = np.eye(3)[axis] * np.sign(at_m)
        key, plane = (*normal, round(abs(at_m), 3)), FoundPlane(normal, abs(at_m), room.scene.slab_of(surface), 1.0)
        planes[key] = max(planes.get(key, (0.0, plane)), (area_m2, plane), key=lambda each: each[0])
    return [plane for _, plane in planes.values()]


class Everywhere(HeardShares):
    """Seven tenths of every plane at every place."""

    def at(self, place_m: FloatArray) -> FloatArray:
        """The shares at some places."""
        return np.full((len(place_m), self.product.shape[1]), 0.7)


def ssim_of_parts(room: PasDataset, seed: int, method: RoomPlanes) -> Iterator[tuple[str, float]]:
    """Rows of the table for one room, of that seed: words and SSIM."""
    question, true = room_question(room, seed, 64), true_planes(room)
    asked_hz = [ghz_to_hz(each) for each in ASKED_GHZ]
    asked = question.asked[np.flatnonzero(np.isin(question.asked.carrier_hz, asked_hz))]
    other, search = method.heard(question.heard)
    found = search.planes() if search else []
    right = [
        each
        for each in found
        if any(each.normal @ one.normal > 0.5 and abs(each.distance_m - one.distance_m) < NEAR_M for one in true)
    ]

    def ssim(maps: FloatArray) -> float:
        scores = score_all(maps, asked.pas(), asked.grid, asked.header.pas_kind)["ssim"]
        return float(np.mean([np.median(scores[asked.carrier_hz == carrier]) for carrier in asked_hz]))

    def predicted(planes: list[FoundPlane], is_everywhere: bool = False) -> float:
        predictor = WithPlanes(other, search, planes) if search and planes else other
        if is_everywhere and isinstance(predictor, WithPlanes):
            predictor.shares = Everywhere(**vars(predictor.shares))
        return ssim(predictor.predict(asked.tx_position_m, asked.carrier_hz))

    yield "room-lags", predicted([])
    yield "room-planes", predicted(found)
    yield "planes found, 0.7 of each everywhere", predicted(found, is_everywhere=True)
    yield "planes found, those that are large and true", predicted(right)
    yield "true planes, of concrete", predicted([replace(plane, slab=Slab("concrete", 0.2)) for plane in true])
    yield "true planes with their slabs", predicted(true)
    yield "true planes with their slabs, 0.7 of each everywhere", predicted(true, is_everywhere=True)
    tx_m, row = np.unique(asked.tx_position_m, axis=0, return_inverse=True)
    column = np.searchsorted(asked_hz, asked.carrier_hz)
    shell = tuple(surface for surface in room.scene.surface if surface.name.startswith(SHELL))
    for words, surfaces, depth in (
        ("walls, floor and ceiling traced, 1 interaction", shell, 1),
        ("walls, floor and ceiling traced, 2 interactions", shell, 2),
        ("walls, floor and ceiling traced, 4 interactions", shell, 4),
        ("everything traced, 4 interactions", room.scene.surface, 4),
    ):
        settings = replace(room.trace_settings, max_depth=depth)
        tracer = xb.make_tracer(replace(room.scene, surface=surfaces), ASKED_GHZ, settings)
        cfr = tracer.channel(tx_m).cfr[row.ravel(), column]
        yield words, ssim(asked.beam.maps(cfr, asked.header.pas_kind)[0])


def main(collection: Path, folder: Path, number: int) -> None:
    """Print the table."""
    method, rooms = RoomPlanes.load(folder), open_collection(collection).part("validation")
    found = defaultdict[str, list[float]](list)
    for room, dataset in zip(rooms.rooms[:number], rooms, strict=False):
        for words, value in ssim_of_parts(dataset, room.seed, method):
            found[words].append(value)
    start = np.array(found["room-lags"])
    print(f"{len(start)} rooms\n\n| | SSIM | more than room-lags |\n|---|---:|---|")
    for words, values in found.items():
        more = np.array(values) - start
        low, high = np.quantile(np.random.default_rng(0).choice(more, (10_000, len(more))).mean(axis=1), [0.025, 0.975])
        print(f"| {words} | {np.mean(values):.3f} | {more.mean():+.3f} [{low:+.3f}, {high:+.3f}] |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if sys.argv[3:] else 40)
