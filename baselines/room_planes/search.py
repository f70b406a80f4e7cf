"""Finds large reflecting planes of a room in maps that are heard there, by their cross terms with what is known.

A map of a small array determines the sums of h hᴴ over pairs of elements with the same lag. A reflection shows there
less by its own power than by the cross term with the direct wave, which turns with the plane's distance: by a cycle
for half a wavelength, 2.5 mm at 60 GHz. A plane is supposed at every distance along the room's axes, made of
every slab of a list, and its score says how much better it explains the maps at all of the carriers.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import torch
from jaxtyping import Complex, Float, Int
from scipy.ndimage import maximum_filter1d

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.unseen_rooms import HEARD_GHZ
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.scene.imported import Slab
from xfreqbench.tracing.absorption import slab_response
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S, ghz_to_hz

from ..virtual_source.field.images import Antenna, Mirrors, sequences, trace
from ..virtual_source.search.cross_terms import spherical_waves
from ..virtual_source.search.planes import Vector
from .scan_kernels import gains

Channels = Complex[NDArray[np.complex128], "F T M"]  # of T transmitters at F carriers, in units of the direct wave

_NEAREST_M, _BEHIND_M = 0.05, 1.5  # planes, from the array, and behind the farthest transmitter
_STEP_M, _FINE_STEP_M, _FINE_REACH_M = 2e-3, 2e-4, 1.4e-3  # at the lower carriers, and at all of them
_CELL_M = 0.1  # of a plane's distance, within which angles of incidence are taken to be the same
_APART_M, _ALIASES_M = 0.045, 0.04  # nearer to a plane, its aliases stand; so far others are tried in its place
_STRONG = 0.5  # of the best score of a round: weaker planes wait until stronger ones are known
_WEAK = 0.4  # of the score that a plane needs in the end
_NUM_PEAKS = 30  # of each normal that are looked at with all carriers
_COSINES = np.linspace(0, 1, 129)
_AXES = np.concatenate([np.eye(3), -np.eye(3)])
_LEAST_AREA_M2 = 3.0  # of a surface, for what it is made of to be one of the slabs
_MANY, _FEW = 0.15, 0.4  # least difference of two slabs, of what they reflect, at all carriers and at the lower ones


def slabs_in(rooms: Iterable[PasDataset]) -> list[Slab]:
    """What large surfaces of rooms are made of, none of which reflects nearly as another does."""
    found = set[Slab]()
    for room in rooms:
        if not json.loads(room.header.scene_json).get("surface"):
            continue
        scene = room.scene
        for surface in scene.surface:
            low_m, high_m = surface.corners_m.reshape(-1, 3).min(axis=0), surface.corners_m.reshape(-1, 3).max(axis=0)
            if surface.mirrors is not False and np.prod(np.sort(high_m - low_m)[1:]) > _LEAST_AREA_M2:
                slab = scene.slab_of(surface)._replace(scattering=None)
                found |= {slab, slab.turned}
    return unlike(sorted(found, key=str), _MANY)


def unlike(slabs: Sequence[Slab], least: float) -> list[Slab]:
    """Slabs of which no two reflect alike: at some carrier they differ by more than a share `least`."""
    kept: dict[Slab, Complex[NDArray[np.complex128], "F N"]] = {}
    for slab in slabs:
        own = np.array([_response(slab, ghz_to_hz(carrier))[::16].ravel() for carrier in HEARD_GHZ])
        size = np.linalg.norm(own, axis=1)
        if all((np.linalg.norm(own - other, axis=1) > least * size).any() for other in kept.values()):
            kept[slab] = own
    return list(kept)


@dataclass(frozen=True, eq=False)
class FoundPlane:
    """A plane normal·x = distance, seen from the array, with its slab and its score."""

    normal: Vector
    distance_m: float
    slab: Slab
    score: float


@lru_cache(maxsize=8192)
def _response(slab: Slab, carrier_hz: float) -> Complex[NDArray[np.complex128], "C 2"]:
    """Reflection, TE and TM, at `_COSINES`."""
    return slab_response(slab, carrier_hz, _COSINES, "extrapolate")[:, :2]


def _reflection(
    slab: Slab, carrier_hz: float, cosine: Float[FloatArray, "*N"]
) -> Complex[NDArray[np.complex128], "2 *N"]:
    """Coefficients TE and TM of a slab."""
    return np.stack([np.interp(cosine, _COSINES, each) for each in _response(slab, carrier_hz).T])


@dataclass(frozen=True, eq=False)
class ArrayView:
    """An array's elements in world axes, in wavelengths from its centre, and its antenna, that of transmitters too."""

    element: Float[FloatArray, "M 3"]
    antenna: Antenna

    def channels(
        self,
        planes: Sequence[FoundPlane],
        tx_m: Float[FloatArray, "T 3"],
        carrier_hz: Float[FloatArray, "F"],
        share: Float[FloatArray, "T P"] | float = 1.0,
    ) -> Channels:
        """Channels of direct waves with one and two reflections by planes, in units of the direct wave.

        Transmitters are seen from the array, in world axes. Of each plane's field a share reflects.
        """
        normal = torch.tensor(np.array([plane.normal for plane in planes]).reshape(-1, 3))
        distance_m = torch.tensor([plane.distance_m for plane in planes], dtype=torch.float64)
        order = sequences(len(planes), min(2, len(planes)))
        paths = trace(Mirrors.of_tensors(normal, distance_m), order, torch.as_tensor(tx_m), self.antenna)
        length_m, direct_m = paths.length_m.numpy(), paths.direct_m.numpy()
        spread = paths.is_real.numpy() * direct_m[:, None] / length_m
        bounced, cosine = paths.bounce.plane.numpy(), paths.bounce.cosine.double().numpy()
        shares = np.ones((len(tx_m), len(planes) + 1))  # the last one where nothing is met, of which the number is -1
        shares[:, :-1] = share
        for bounce in range(order.shape[1]):
            spread = spread * np.take_along_axis(shares, bounced[..., bounce], axis=1)
        channels = []
        for carrier in carrier_hz.tolist():
            wavelength_m = SPEED_OF_LIGHT_M_S / carrier
            gain = paths.polarised.numpy().astype(complex)
            for bounce in range(order.shape[1]):
                factor = np.ones((2, *length_m.shape), complex)
                for index, plane in enumerate(planes):
                    here = bounced[..., bounce] == index
                    factor[:, here] = _reflection(plane.slab, carrier, cosine[..., bounce][here])
                first, second = np.split(gain, 2, axis=-1)  # TE and TM of the first bounce that is left
                gain = first * factor[0][..., None] + second * factor[1][..., None]
            turned = gain[..., 0] * spread * np.exp(-2j * np.pi * (length_m - direct_m[:, None]) / wavelength_m)
            source = paths.arrival.double().numpy() * (length_m / wavelength_m)[..., None]
            waves = spherical_waves(source.reshape(-1, 3), self.element).reshape(*length_m.shape, -1)
            channels.append(np.einsum("tk,tkm->tm", turned, waves))
        return np.array(channels)


@dataclass(frozen=True, eq=False)
class PlaneSearch:
    """What is heard: T transmitters at `HEARD_GHZ`, and the sums over lags of their maps, real parts first."""

    carrier_hz = np.array([ghz_to_hz(carrier) for carrier in HEARD_GHZ])

    view: ArrayView
    lags: LagFunctions
    tx_m: Float[FloatArray, "T 3"]
    sums: Float[NDArray[np.float32], "T F L"]
    slabs: Sequence[Slab]
    least: float
    max_planes: int

    @cached_property
    def _data(self) -> Float[FloatArray, "F T U 2"]:
        """The sums, real and imaginary parts, of norm 1."""
        parts = np.stack(np.split(self.sums.astype(float).swapaxes(0, 1), 2, axis=-1), axis=-1)
        norm = np.sqrt(np.einsum("ftup,u->ft", parts**2, self.lags.weight))
        return np.asarray(parts / norm[..., None, None])

    @property
    def num_in_sight(self) -> int:
        """Number of transmitters whose maps are for the most part the direct wave's, at all carriers."""
        h = self.view.channels([], self.tx_m, self.carrier_hz)
        first, second, lag = self._pairs.T
        direct = (h[..., first] * h[..., second].conj()) @ np.eye(len(self.lags.weight))[lag]
        parts = np.stack([direct.real, direct.imag], axis=-1)
        told, power = (np.einsum("ftup,ftup,u->ft", parts, other, self.lags.weight) for other in (self._data, parts))
        return int((told**2 / power > 0.5).all(axis=0).sum())

    @cached_property
    def _pairs(self) -> Int[IntArray, "P 3"]:
        """Both elements, and the lag, of each pair."""
        first, second = np.divmod(self.lags.pairs, len(self.view.element))
        return np.stack([first, second, self.lags.of_pair], axis=1)

    @cached_property
    def _few(self) -> Int[IntArray, "s"]:
        """The slabs that the lower carriers are enough for."""
        return np.array([self.slabs.index(slab) for slab in unlike(self.slabs, _FEW)])

    @cached_property
    def _reflections(self) -> list[Float[FloatArray, "F T Q 2 S"]]:
        """Real and imaginary parts of all slabs' coefficients along each of `_AXES`, for distances `_CELL_M` apart."""
        tables = []
        for axis in _AXES:
            farthest_m = max(0.0, float((self.tx_m @ axis).max())) + _BEHIND_M
            distance_m = torch.arange(_CELL_M / 2, farthest_m + _CELL_M, _CELL_M, dtype=torch.float64)
            mirrors = Mirrors.of_tensors(torch.tensor(axis).expand(len(distance_m), 3), distance_m)
            single = torch.arange(len(distance_m))[:, None]
            paths = trace(mirrors, single, torch.as_tensor(self.tx_m), self.view.antenna)
            cosine, polarised = paths.bounce.cosine[..., 0].double().numpy(), paths.polarised.numpy()
            table = [
                [np.einsum("ptq,tqp->tq", _reflection(slab, carrier, cosine), polarised) for slab in self.slabs]
                for carrier in self.carrier_hz.tolist()
            ]
            coefficients = np.moveaxis(np.array(table), 1, -1)
            tables.append(np.stack([coefficients.real, coefficients.imag], axis=-2))
        return tables

    def planes(self) -> list[FoundPlane]:
        """Planes whose score is `least` or more; weaker ones are sought too, for the sake of what they explain."""
        found: list[FoundPlane] = []
        while len(found) < self.max_planes:
            number, known = len(found), self._known(found)
            candidates = [plane for normal in _AXES for plane in self._candidates(normal, known, found)]
            candidates.sort(key=lambda plane: -plane.score)
            for plane in candidates:
                if plane.score > _STRONG * candidates[0].score and len(found) < self.max_planes:
                    found = self._with(plane, found, _FINE_REACH_M)
            for plane in list(found):  # once more, given the others
                found = self._with(plane, [other for other in found if other is not plane], _ALIASES_M)
            if len(found) <= number:
                break
        return [plane for plane in found if plane.score >= self.least]

    def _with(self, plane: FoundPlane, found: list[FoundPlane], reach_m: float) -> list[FoundPlane]:
        """The planes that are found, and the best within reach of another one, if it is apart and worth enough."""
        if not _is_apart(plane.normal, plane.distance_m, found):
            return found
        best = self._best_near(plane.normal, plane.distance_m, self._known(found), reach_m)
        is_new = best.score >= _WEAK * self.least and _is_apart(best.normal, best.distance_m, found)
        return [*found, best] if is_new else found

    def _known(self, found: Sequence[FoundPlane]) -> Channels:
        return self.view.channels(found, self.tx_m, self.carrier_hz)

    def _candidates(self, normal: Vector, known: Channels, found: Sequence[FoundPlane]) -> list[FoundPlane]:
        """The best planes along one axis, by all carriers."""
        farthest_m = max(0.0, float((self.tx_m @ normal).max())) + _BEHIND_M
        distance_m = np.arange(_NEAREST_M, farthest_m, _STEP_M)
        score = self._scores(normal, distance_m, known, slice(0, 2), self._few).max(axis=1)
        peaks = np.flatnonzero((score == maximum_filter1d(score, 3)) & (score > 0))
        highest_m = distance_m[peaks[np.argsort(-score[peaks])]].tolist()
        apart_m = [here_m for here_m in highest_m if _is_apart(normal, here_m, found)][:_NUM_PEAKS]
        refined = [self._best_near(normal, here_m, known, _FINE_REACH_M) for here_m in apart_m]
        return [plane for plane in refined if plane.score >= _WEAK * self.least]

    def _best_near(self, normal: Vector, distance_m: float, known: Channels, reach_m: float) -> FoundPlane:
        """The best distance and slab within reach, by all carriers."""
        near_m = distance_m + np.arange(-reach_m, reach_m + _FINE_STEP_M / 2, _FINE_STEP_M)
        near_m = near_m[near_m > _NEAREST_M / 2]
        score = self._scores(normal, near_m, known, slice(None))
        place, slab = divmod(int(score.argmax()), len(self.slabs))
        return FoundPlane(normal, float(near_m[place]), self.slabs[slab], float(score.max()))

    def _scores(
        self,
        normal: Vector,
        distance_m: Float[FloatArray, "N"],
        known: Channels,
        carriers: slice,
        slabs: Int[IntArray, "S"] | slice = slice(None),
    ) -> Float[FloatArray, "N S"]:
        """The geometric mean over carriers of `gains`, which are 0 where they are negative."""
        reflection = self._reflections[int(np.argmax(_AXES @ normal))][carriers]
        cell = (distance_m / _CELL_M).astype(int).clip(max=reflection.shape[2] - 1)
        wavelength_m = SPEED_OF_LIGHT_M_S / self.carrier_hz[carriers]
        factor = gains(
            distance_m,
            cell,
            normal,
            self.tx_m,
            self.view.element * wavelength_m[:, None, None],
            1 / wavelength_m,
            np.ascontiguousarray(known[carriers]),
            np.ascontiguousarray(self._data[carriers]),
            self._pairs,
            self.lags.weight,
            np.ascontiguousarray(reflection[..., slabs]),
        )
        gain = np.log(factor).clip(0) / len(self.tx_m)
        return np.asarray(np.prod(gain, axis=1) ** (1 / len(wavelength_m)))


def _is_apart(normal: Vector, distance_m: float, found: Sequence[FoundPlane]) -> bool:
    """Whether a plane is neither one that is found nor an alias of it."""
    near_m = [other.distance_m for other in found if other.normal @ normal > 0.5]
    return all(abs(distance_m - other_m) > _APART_M for other_m in near_m)
