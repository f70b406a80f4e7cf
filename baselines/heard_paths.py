"""The paths that are heard in a room whose plan is known, and how well slabs explain the maps that they make.

Which paths there are does not depend on slabs, so a plan is traced once, and then only the field along its paths is
computed for other slabs. What the corners of the array decide differently from its centre is left out, and the field
along a path is that at the centre, which costs .02 to .1 of SSIM at 1 GHz and hardly anything at 10 and 60 GHz.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Complex, Float, Int

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError
from xfreqbench.maps.lags import LagFunctions
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import complex_permittivity
from xfreqbench.tracing.image.tracer import ImageTracer
from xfreqbench.tracing.paths import SPECULAR, element_delays_s
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION
from xfreqbench.types import FloatArray, IntArray, NDArray
from xfreqbench.units import SPEED_OF_LIGHT_M_S

from .virtual_source.field.images import antenna_field

Waves = NDArray[np.complex128]


def slab_coefficients(
    slab: Slab, carrier_hz: Float[FloatArray, "F"], slope: Float[FloatArray, "n"]
) -> tuple[Complex[Waves, "n 2 F"], Complex[Waves, "n 2 F"]]:
    """Reflection and transmission, TE and TM (ITU-R P.2040, Eqs. 37, 38, 43 and 44), for many directions k at once.

    `slope` is k·n with the normal n to the slab's front; waves with a positive one come from behind. Echoes between
    layers are summed by Redheffer's star product.
    """
    cosine, is_behind = np.maximum(np.abs(slope), 1e-6)[:, None, None], (slope > 0)[:, None, None]
    of_layer = []
    for material, thickness_m in slab.layers:
        eta = np.array([complex_permittivity(material, float(carrier), "extrapolate") for carrier in carrier_hz])
        root = np.sqrt(eta - 1 + cosine**2)
        face = np.concatenate([(cosine - root) / (cosine + root), (eta * cosine - root) / (eta * cosine + root)], 1)
        once = np.exp(-2j * np.pi * carrier_hz / SPEED_OF_LIGHT_M_S * thickness_m * root)
        echoes = 1 / (1 - (face * once) ** 2)
        of_layer.append((face * (1 - once**2) * echoes, (1 - face**2) * once * echoes))
    (front, through), back = of_layer[0], of_layer[0][0]
    if len(of_layer) > 1:
        met = [np.where(is_behind, late, early) for early, late in zip(of_layer, of_layer[::-1], strict=True)]
        (front, through), back = met[0], met[0][0]
        for reflected, passed in met[1:]:
            echoes = 1 / (1 - back * reflected)
            front = front + through**2 * reflected * echoes
            back, through = reflected + passed**2 * back * echoes, through * passed * echoes
    return front, through


class HeardPaths:
    """The N paths of heard transmitters in a plan, whose surfaces are in groups, each of one of the `slabs`.

    At each of at most D interactions the field has parts TE and TM, along w = k×n and w×k: `_factor` (N, D, 2, F) is
    what the slab that is met does to them, and `_turn` takes them from one interaction to the next.
    """

    def __init__(self, heard: PasDataset, geometry: Geometry, group: Int[IntArray, "S"], slabs: Sequence[Slab]) -> None:
        self.slabs, receiver = list(slabs), heard.header.receiver
        pattern, polarization, turned_deg = receiver.antenna
        if pattern == "tr38901" or any(turned_deg) or heard.scene.transmitter_antenna != receiver.antenna:
            raise MethodError(
                "plan-slabs knows antennas of pattern iso or dipole, not turned, the same at both ends, but in "
                f"{heard.path.name} the receiver's are of {receiver.antenna}, and the transmitters' of "
                f"{heard.scene.transmitter_antenna}. Take plan-tracer."
            )
        tx_m, row = np.unique(heard.tx_position_m, axis=0, return_inverse=True)
        self._carrier_hz, column = np.unique(heard.carrier_hz, return_inverse=True)
        self._sample, centre_m = (row.ravel(), column.ravel()), np.asarray(receiver.position_m)
        settings = replace(heard.trace_settings, solver="image", interactions=WITHOUT_DIFFRACTION)
        tracer = ImageTracer(heard.scene, self._carrier_hz, settings, geometry=geometry)
        found = [tracer.paths(place_m) for place_m in tx_m]
        names = "surfaces", "interactions", "vertices_m", "delay_s", "arrival"
        mesh, code, vertex_m, delay_s, arrival = (
            np.concatenate([getattr(paths, name) for paths in found]) for name in names
        )
        self._tx, self._num_tx = np.repeat(np.arange(len(tx_m)), [len(paths.delay_s) for paths in found]), len(tx_m)
        self._reflects = code == SPECULAR

        point_m = np.concatenate([tx_m[self._tx, None], vertex_m, np.full((len(mesh), 1, 3), np.nan)], axis=1)
        way = np.diff(np.where(np.isnan(point_m), centre_m, point_m), axis=1)  # (N, D + 1, 3)
        for step in range(mesh.shape[1]):  # behind the array the last direction goes on, and nothing is met
            way[:, step + 1] = np.where(mesh[:, step, None] < 0, way[:, step], way[:, step + 1])
        way /= np.linalg.norm(way, axis=2, keepdims=True)
        before, after = way[:, :-1], way[:, 1:]
        normal = _normals(geometry, mesh, vertex_m)
        self._slope = (before * normal).sum(axis=2)
        across = np.cross(before, normal + 1e-9 * np.roll(before, 1, axis=2))  # any direction where k is along n
        across /= np.linalg.norm(across, axis=2, keepdims=True)
        entering, leaving = (np.stack([across, np.cross(across, k)], axis=2) for k in (before, after))
        sent, taken = (
            antenna_field(torch.as_tensor(k), (pattern, polarization)).numpy() for k in (way[:, 0], -way[:, -1])
        )
        self._sent = np.einsum("npc,nc->np", entering[:, 0], sent)
        self._taken = np.einsum("npc,nc->np", leaving[:, -1], taken)
        self._turn = np.einsum("ndpc,ndqc->ndpq", entering[:, 1:], leaving[:, :-1])
        waves = []
        for carrier_hz in self._carrier_hz:
            element_m = receiver.element_position_m(SPEED_OF_LIGHT_M_S / carrier_hz) - centre_m
            turns = carrier_hz * element_delays_s(delay_s, arrival, element_m)
            waves.append(np.exp(-2j * np.pi * turns) / delay_s[:, None])
        self._waves = np.stack(waves, axis=1)  # (N, F, M)

        self._lags = lags = LagFunctions(heard.beam)
        functions = lags.waves.reshape(len(lags.waves), -1)
        # Sums times this are as far apart as their maps; some lag functions almost vanish on the visible hemisphere.
        self._root = np.linalg.cholesky(functions @ functions.T + 1e-9 * np.eye(len(functions)))
        self._of_lag = np.equal.outer(lags.of_pair, np.arange(len(lags.lag))).astype(np.complex128)
        self._kind = heard.header.pas_kind
        self._heard = self._direction(lags.of_maps(heard.pas(), self._kind).astype(np.float64))

        of_group = [np.isin(mesh, np.flatnonzero(group == number)) for number in range(len(slabs))]
        self._rows = [np.flatnonzero(at.any(axis=1)) for at in of_group]
        self._at = [at[rows] for at, rows in zip(of_group, self._rows, strict=True)]
        self._factor = np.ones((*mesh.shape, 2, len(self._carrier_hz)), np.complex128)
        for number, slab in enumerate(slabs):
            self._factor[self._rows[number]] = self._factors(number, slab)
        everything = np.arange(len(mesh))
        self._gain = self._gains(everything, self._factor)
        self._cfr = self._channels(everything, self._gain)

    @property
    def strongest(self) -> list[int]:
        """The groups that paths meet, the one first whose paths have the most amplitude together."""
        amplitude = [np.abs(self._gain[rows]).sum() for rows in self._rows]
        return [int(number) for number in np.argsort(amplitude)[::-1] if len(self._rows[number])]

    def improve(self, number: int, slabs: Iterable[Slab]) -> None:
        """Give a group that of its own slab and these with which the maps are nearest to those that are heard."""
        rows = self._rows[number]
        rest = self._cfr - self._channels(rows, self._gain[rows])

        def loss(slab: Slab) -> float:
            return self._loss(rest + self._channels(rows, self._gains(rows, self._factors(number, slab))))

        self.take(number, min([self.slabs[number], *slabs], key=loss))

    def take(self, number: int, slab: Slab) -> None:
        """Give a group this slab."""
        rows = self._rows[number]
        rest = self._cfr - self._channels(rows, self._gain[rows])
        self.slabs[number], self._factor[rows] = slab, self._factors(number, slab)
        self._gain[rows] = self._gains(rows, self._factor[rows])
        self._cfr = rest + self._channels(rows, self._gain[rows])

    @property
    def loss(self) -> float:
        """How far the maps are from those that are heard, as `improve` compares slabs: 0 to 1."""
        return self._loss(self._cfr)

    def _factors(self, number: int, slab: Slab) -> Complex[Waves, "n D 2 F"]:
        """Those of the paths that a group is met by, if it has this slab."""
        rows, at = self._rows[number], self._at[number]
        reflected, passed = slab_coefficients(slab, self._carrier_hz, self._slope[rows][at])
        factor = self._factor[rows]
        factor[at] = np.where(self._reflects[rows][at][:, None, None], reflected, passed)
        return factor

    def _gains(self, rows: Int[IntArray, "n"], factor: Complex[Waves, "n D 2 F"]) -> Complex[Waves, "n F"]:
        """Gains of some paths without spreading."""
        field = self._sent[rows][:, :, None] * factor[:, 0]
        for step in range(1, factor.shape[1]):
            field = self._turn[rows, step - 1] @ field * factor[:, step]
        return np.einsum("np,npf->nf", self._taken[rows], field)

    def _channels(self, rows: Int[IntArray, "n"], gain: Complex[Waves, "n F"]) -> Complex[Waves, "T F M"]:
        """What some paths, in ascending order, add to the channels."""
        sums = np.zeros((self._num_tx, *self._waves.shape[1:]), np.complex128)
        if len(rows):
            tx, first = np.unique(self._tx[rows], return_index=True)
            sums[tx] = np.add.reduceat(gain[:, :, None] * self._waves[rows], first, axis=0)
        return sums

    def _loss(self, cfr: Complex[Waves, "T F M"]) -> float:
        """Mean over the maps of the sine of the angle between map and heard map as vectors, which no power changes."""
        own = cfr[self._sample]
        if self._kind == "phase-only":
            own = own / np.maximum(np.abs(own), 1e-300)
        first, second = np.divmod(self._lags.pairs, own.shape[1])
        sums = (own[:, first] * own[:, second].conj()) @ self._of_lag
        cosine = (self._direction(np.hstack([sums.real, sums.imag])) * self._heard).sum(axis=1)
        return float(np.sqrt(np.maximum(1 - cosine**2, 0)).mean())

    def _direction(self, sums: Float[FloatArray, "B L"]) -> Float[FloatArray, "B L"]:
        """Maps of some lag sums as vectors of length 1."""
        maps = sums @ self._root
        return maps / np.maximum(np.linalg.norm(maps, axis=1, keepdims=True), 1e-30)


def _normals(
    geometry: Geometry, mesh: Int[IntArray, "N D"], vertex_m: Float[FloatArray, "N D 3"]
) -> Float[FloatArray, "N D 3"]:
    """Unit normals to the front of the facet that is met, of its mesh the one in whose plane the point is."""
    normal = np.full(vertex_m.shape, 3**-0.5)
    for number in np.unique(mesh[mesh >= 0]):
        corner_m, front = (np.array(values) for values in zip(*geometry.meshes[number].outlines_m, strict=True))
        corner_m, front = corner_m[:, 0], front / np.linalg.norm(front, axis=1, keepdims=True)
        at = mesh == number
        off_m = np.einsum("nqc,qc->nq", vertex_m[at][:, None] - corner_m, front)
        normal[at] = front[np.abs(off_m).argmin(axis=1)]
    return normal
