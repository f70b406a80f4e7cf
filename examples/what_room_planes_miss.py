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


def true_planes(room: PasDataset) -> list[tuple[float, FoundPlane]]:
    """The planes across the axes that have surfaces of 5 m² or more: area in m², and plane with the largest's slab."""
    planes = dict[tuple[float, ...], list[tuple[float, FoundPlane]]]()
    for surface in room.scene.surface:
        corners_m = surface.corners_m - np.asarray(room.header.receiver.position_m)
        span_m, axis = np.ptp(corners_m, axis=0), int(np.ptp(corners_m, axis=0).argmin())
        area_m2, at_m = float(np.delete(span_m, axis).prod()), float(corners_m[0, axis])
        if surface.mirrors is False or span_m[axis] > 1e-6 or area_m2 < LEAST_AREA_M2:
            continue
        normal = np.eye(3)[axis] * np.sign(at_m)
        plane = FoundPlane(normal, abs(at_m), room.scene.slab_of(surface), 1.0)
        planes.setdefault((*normal, round(abs(at_m), 3)), []).append((area_m2, plane))
    largest = (max(found, key=lambda each: each[0])[1] for found in planes.values())
    return [(sum(area for area, _ in found), plane) for found, plane in zip(planes.values(), largest, strict=True)]


class Everywhere(HeardShares):
    """Seven tenths of every plane at every place."""

    def at(self, place_m: FloatArray) -> FloatArray:
        """The shares at some places."""
        return np.full((len(place_m), self.product.shape[1]), 0.7)


def _off_m(plane: FoundPlane, other: FoundPlane) -> float:
    return abs(plane.distance_m - other.distance_m) if plane.normal @ other.normal > 0.5 else np.inf


def parts_of(room: PasDataset, seed: int, method: RoomPlanes) -> Iterator[tuple[str, float]]:
    """What is printed of one room, of that seed: words with a number, and words with SSIM, which begin with a dash."""
    question, (area_m2, true) = room_question(room, seed, 64), zip(*true_planes(room), strict=True)
    asked_hz = [ghz_to_hz(each) for each in ASKED_GHZ]
    asked = question.asked[np.flatnonzero(np.isin(question.asked.carrier_hz, asked_hz))]
    other, search = method.heard(question.heard)
    found = search.planes() if search else []
    off_m = np.array([[_off_m(each, one) for one in true] for each in found]).reshape(-1, len(true))
    right = [each for each, row in zip(found, off_m < NEAR_M, strict=True) if row.any()]
    is_found = (off_m < NEAR_M).any(axis=0)
    yield "large planes", len(true)
    yield "of these found", is_found.sum()
    yield "their area, m²", sum(area_m2)
    yield "of this found", np.array(area_m2)[is_found].sum()
    yield "found planes that are none of these", len(found) - len(right)
    for off in off_m[off_m < NEAR_M]:
        yield "off, mm", 1e3 * off

    def ssim(maps: FloatArray) -> float:
        scores = score_all(maps, asked.pas(), asked.grid, asked.header.pas_kind)["ssim"]
        return float(np.mean([np.median(scores[asked.carrier_hz == carrier]) for carrier in asked_hz]))

    def predicted(planes: list[FoundPlane], is_everywhere: bool = False) -> float:
        predictor = WithPlanes(other, search, planes) if search and planes else other
        if is_everywhere and isinstance(predictor, WithPlanes):
            predictor.shares = Everywhere(**vars(predictor.shares))
        return ssim(predictor.predict(asked.tx_position_m, asked.carrier_hz))

    yield "- room-lags", predicted([])
    yield "- room-planes", predicted(found)
    yield "- planes found, 0.7 of each everywhere", predicted(found, is_everywhere=True)
    yield "- planes found, those that are large and true", predicted(right)
    yield "- true planes, of concrete", predicted([replace(plane, slab=Slab("concrete", 0.2)) for plane in true])
    yield "- true planes with their slabs", predicted([*true])
    yield "- true planes with their slabs, 0.7 of each everywhere", predicted([*true], is_everywhere=True)
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
        yield f"- {words}", ssim(asked.beam.maps(cfr, asked.header.pas_kind)[0])


def main(collection: Path, folder: Path, number: int) -> None:
    """Print the table."""
    method, rooms = RoomPlanes.load(folder), open_collection(collection).part("validation")
    found = defaultdict[str, list[float]](list)
    for room, dataset in zip(rooms.rooms[:number], rooms, strict=False):
        for words, value in parts_of(dataset, room.seed, method):
            found[words].append(float(value))
    off_mm = np.median(found.pop("off, mm"))
    print("; ".join(f"{words}: {sum(found[words]):.0f}" for words in found if not words.startswith("- ")), end="; ")
    print(f"off in the median: {off_mm:.1f} mm\n\n| {number} rooms | SSIM | more than room-lags |\n|---|---:|---|")
    start = np.array(found["- room-lags"])
    for words in [words for words in found if words.startswith("- ")]:
        more = np.array(found[words]) - start
        low, high = np.quantile(np.random.default_rng(0).choice(more, (10_000, len(more))).mean(axis=1), [0.025, 0.975])
        print(f"| {words[2:]} | {np.mean(found[words]):.3f} | {more.mean():+.3f} [{low:+.3f}, {high:+.3f}] |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if sys.argv[3:] else 40)
