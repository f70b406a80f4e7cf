"""Traces the plan of a room that it is told, with the slabs that best explain what is heard there.

Fitting across rooms learns what is made of what: of which slabs the surfaces of each kind are, a kind being a name
without numbers (`wall door`), by what shapes kinds are told apart, since a plan has no names, and of which kinds all
surfaces of a room are alike. In a new room, surfaces are sorted into kinds and groups of one slab, at first the most
frequent one of their kind. Then each group in turn, the one of the strongest paths first, takes the slab with which
the maps are nearest to those that are heard. Paths do not depend on slabs, so they are traced once.

Where the maps are not explained so, each group tries materials of other kinds, and random ones about the best of them,
in steps that become smaller. These are kept if they save much of the error, and with few maps they hardly are.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, groupby
from math import nan
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from pydantic import TypeAdapter
from scipy.spatial import KDTree

from xfreqbench.data.collection import Collection
from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError
from xfreqbench.methods.contract import Budget, Progress
from xfreqbench.methods.lookup import NoOptions
from xfreqbench.scene.facets import Geometry
from xfreqbench.scene.imported import Slab
from xfreqbench.scene.materials import ConstantMaterial, LayeredMaterial, complex_permittivity, conductivity_s_m
from xfreqbench.scene.model import Scene
from xfreqbench.types import FloatArray, IntArray

from .heard_paths import HeardPaths, slab_coefficients
from .plan_tracer import PlanTracer, TracedPlan

_ROUGH_TX = 16  # of the heard transmitters, by which slabs are chosen before all of them refine thicknesses
_SWEEPS = 2  # over all groups
_STEP_M, _MOST_STEPS, _MOST_FINE_STEPS = 1e-4, 400, 21  # of thicknesses
_NOTICED = 0.2  # rms difference between the coefficients of two thicknesses that are both tried
_SLOPES = np.linspace(-1, -0.1, 7)  # cosines of the incidence, at which it is taken
_SPREADS, _DRAWS, _MIDDLE_HZ = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01), 40, 1e10  # of other materials
_FEW = 10  # thicknesses of each material of other kinds
# The least share of the loss that another material has to save, and all of them together, times the number of maps.
_ONE_SAVES, _ALL_SAVE = 1.5, 8.0
_ALIKE = 0.9  # share of the training rooms whose surfaces of one kind have one slab
_SLABS: TypeAdapter[dict[str, list[Slab]]] = TypeAdapter(dict[str, list[Slab]])


class PlanSlabs(PlanTracer):
    """Knows a room's plan, by protocol `unseen-rooms-plan`, and finds of which slabs it is."""

    def __init__(self, config: NoOptions | None = None) -> None:
        super().__init__(config)
        self._kinds: Kinds | None = None

    def fit(self, rooms: Collection, budget: Budget, seed: int) -> Iterator[Progress]:
        """Read what the rooms are made of, in one step."""
        self._know(Kinds.of(dataset.scene for dataset in rooms))
        yield Progress(step=1, loss=nan)

    def adapt(self, heard: PasDataset, budget: Budget) -> TracedPlan:
        """The plan, prepared for tracing, of the slabs that explain best what is heard, or of the usual ones.

        Raises `MethodError` where no plan is told, before anything is learned, and for turned or directive antennas.
        """
        plan, kinds = super().adapt(heard, budget), self._learned()
        group, kind_of = kinds.grouped(heard.scene)
        slabs, tx = [kinds.usual(kind) for kind in kind_of], np.unique(heard.tx_index)
        if len(tx):
            carrier_hz = np.unique(heard.carrier_hz)
            tried = [kinds.tried(kind, carrier_hz) for kind in kind_of]
            some = tx[np.linspace(0, len(tx) - 1, min(_ROUGH_TX, len(tx))).round().astype(int)]
            paths = HeardPaths(heard[np.flatnonzero(np.isin(heard.tx_index, some))], plan.geometry, group, slabs)
            for number in paths.strongest * _SWEEPS:
                paths.improve(number, chain(*tried[number]))
            usual, at_first, num_maps = list(paths.slabs), paths.loss, min(_ROUGH_TX, len(tx)) * len(carrier_hz)
            random, others = np.random.default_rng(0), [plan.geometry.meshes[0].slab, *kinds.others(carrier_hz)]
            for number in paths.strongest * _SWEEPS:
                known, before = paths.slabs[number], paths.loss
                paths.improve(number, others)
                for spread in _SPREADS:
                    paths.improve(number, _varied(paths.slabs[number], spread, random))
                if paths.loss > (1 - _ONE_SAVES / num_maps) * before:
                    paths.take(number, known)
            slabs = usual if paths.loss > (1 - _ALL_SAVE / num_maps) * at_first else paths.slabs
            paths = HeardPaths(heard, plan.geometry, group, slabs)
            for number in paths.strongest:
                paths.improve(number, _finer(paths.slabs[number], tried[number]))
            slabs = paths.slabs
        told = plan.geometry.meshes
        made = [replace(mesh, **slabs[number]._asdict()) for mesh, number in zip(told, group, strict=False)]
        plan.geometry = Geometry([*made, *told[len(made) :]])  # those of a mesh file have no group
        return plan

    def save(self, directory: Path) -> None:
        """Store what rooms are made of; loading runs no stored code."""
        kinds = self._learned()
        (directory / "slabs.json").write_bytes(_SLABS.dump_json(kinds.slabs))
        np.savez(directory / "shapes.npz", shape=kinds.shape, kind=kinds.kind, alike=sorted(kinds.alike))

    @classmethod
    def load(cls, directory: Path) -> PlanSlabs:
        """The method as it was saved."""
        method = cls()
        with np.load(directory / "shapes.npz") as file:
            shape, kind, alike = file["shape"], file["kind"].tolist(), frozenset(file["alike"].tolist())
        method._know(Kinds(_SLABS.validate_json((directory / "slabs.json").read_bytes()), alike, shape, kind))
        return method

    def _know(self, kinds: Kinds) -> None:
        self._kinds, self.num_parameters = kinds, sum(map(len, kinds.slabs.values()))

    def _learned(self) -> Kinds:
        if self._kinds is None:
            raise MethodError("PlanSlabs knows nothing yet; fit or load it first.")
        return self._kinds


@dataclass(frozen=True, eq=False)
class Kinds:
    """What is made of what: `slabs` of each kind, as often as rooms have them, and the names of kinds that are `alike`.

    `shape` (K, 7) are shapes of surfaces, and `kind` says of which kind each is.
    """

    slabs: dict[str, list[Slab]]
    alike: frozenset[str]
    shape: Float[FloatArray, "K 7"]
    kind: Sequence[str]
    _tried: dict[tuple[str | float, ...], list[list[Slab]]] = field(default_factory=dict)

    @classmethod
    def of(cls, scenes: Iterable[Scene]) -> Kinds:
        """Those of some rooms."""
        slabs, are_alike, shape, kind = defaultdict[str, list[Slab]](list), defaultdict[str, list[bool]](list), [], []
        for scene in scenes:
            names = [" ".join(re.sub(r"[\d.]+", " ", surface.name).split()) for surface in scene.surface]
            runs, own = Counter(name for name, _ in groupby(names)), defaultdict[str, dict[Slab, None]](dict)
            for name, surface in zip(names, scene.surface, strict=True):
                own[name][scene.slab_of(surface)] = None
            for name, distinct in own.items():
                slabs[name] += distinct
                are_alike[name] += [len(distinct) == 1] * (runs[name] > 1)
            shape.append(_shapes(scene))
            kind += names
        alike = frozenset(name for name in slabs if np.mean(are_alike[name] or 1) > _ALIKE)
        return cls(dict(slabs), alike, np.concatenate(shape), kind)

    def grouped(self, scene: Scene) -> tuple[Int[IntArray, "S"], list[str]]:
        """The group of each surface of a plan, and the kind of each group.

        A group has all surfaces of a kind that are alike, or those that follow one another in the plan.
        """
        scale = self.shape.std(axis=0) + 1e-9
        nearest = KDTree(self.shape / scale).query(_shapes(scene) / scale)[1]
        kinds, group = list[str](), list[int]()
        for kind, run in groupby(self.kind[row] for row in nearest):
            if kind not in self.alike or kind not in kinds:
                kinds.append(kind)
            number = kinds.index(kind) if kind in self.alike else len(kinds) - 1
            group += [number for _ in run]
        return np.array(group), kinds

    def usual(self, kind: str) -> Slab:
        """The most frequent material of a kind, with its median thickness."""
        (material, _), *_ = Counter(slab.material for slab in self.slabs[kind]).most_common(1)
        slabs = [slab for slab in self.slabs[kind] if slab.material == material]
        return slabs[0]._replace(thickness_m=float(np.median([slab.thickness_m for slab in slabs])))

    def tried(self, kind: str, carrier_hz: Float[FloatArray, "F"]) -> list[list[Slab]]:
        """All materials of a kind, each with thicknesses between the least and the greatest that make a difference."""
        if (key := (kind, *carrier_hz.tolist())) not in self._tried:
            self._tried[key] = list(self._tried_at(kind, carrier_hz))
        return self._tried[key]

    def others(self, carrier_hz: Float[FloatArray, "F"]) -> Iterator[Slab]:
        """Some thicknesses of all materials of all kinds."""
        by_material = defaultdict[object, list[Slab]](list)
        for kind in self.slabs:
            for slabs in self.tried(kind, carrier_hz):
                by_material[slabs[0].material] += slabs
        for slabs in by_material.values():
            slabs.sort(key=lambda slab: slab.thickness_m)
            yield from (slabs[at] for at in np.unique(np.linspace(0, len(slabs) - 1, _FEW).astype(int)))

    def _tried_at(self, kind: str, carrier_hz: Float[FloatArray, "F"]) -> Iterator[list[Slab]]:
        by_material = defaultdict[object, list[Slab]](list)
        for slab in self.slabs[kind]:
            by_material[slab.material].append(slab)
        for slabs in by_material.values():
            low_m, high_m = (pick(slab.thickness_m for slab in slabs) for pick in (min, max))
            kept, last = list[Slab](), None
            for slab in _between(slabs[0], low_m, high_m, _MOST_STEPS):
                own = np.concatenate(slab_coefficients(slab, carrier_hz, _SLOPES))
                if last is None or np.sqrt((np.abs(own - last) ** 2).mean()) > _NOTICED:
                    kept, last = [*kept, slab], own
            yield [*kept, slabs[0]._replace(thickness_m=high_m)]


def _varied(slab: Slab, spread: float, random: np.random.Generator) -> list[Slab]:
    """Slabs of permittivities, conductivities and thicknesses about those of one; none for layers."""
    if isinstance(slab.material, LayeredMaterial):
        return []
    eta = complex_permittivity(slab.material, _MIDDLE_HZ, "extrapolate")
    at = max(eta.real - 1, 0.05), max(conductivity_s_m(eta, _MIDDLE_HZ), 1e-3), slab.thickness_m
    drawn = (np.array(at) * np.exp(spread * random.standard_normal((_DRAWS, 3)))).tolist()
    return [Slab(ConstantMaterial("found", 1 + a, sigma), thickness_m) for a, sigma, thickness_m in drawn]


def _finer(slab: Slab, tried: Iterable[list[Slab]]) -> list[Slab]:
    """A slab with the thicknesses around its own that were left out of those that were tried."""
    of_material = (slabs for slabs in tried if slabs[0].material == slab.material)
    thickness_m = [each.thickness_m for each in next(of_material, [slab])]
    nearest = int(np.abs(np.subtract(thickness_m, slab.thickness_m)).argmin())
    around_m = thickness_m[max(nearest - 1, 0) : nearest + 2]
    return _between(slab, around_m[0], around_m[-1], _MOST_FINE_STEPS)


def _between(slab: Slab, low_m: float, high_m: float, most: int) -> list[Slab]:
    """A slab with evenly spread thicknesses."""
    number = min(round((high_m - low_m) / _STEP_M) + 1, most)
    return [slab._replace(thickness_m=float(thickness_m)) for thickness_m in np.linspace(low_m, high_m, number)]


def _shapes(scene: Scene) -> Float[FloatArray, "S 7"]:
    """Of each surface: whether it is a box, whether it mirrors, number of corners, width, heights, and how far inside.

    That is its distance from the outline of the largest surface as seen from above, which is floor or ceiling.
    """
    corners_m = [surface.corners_m for surface in scene.surface]
    span_m = np.array([np.ptp(corners, axis=0) for corners in corners_m])
    start = corners_m[int((span_m[:, 0] * span_m[:, 1]).argmax())][:, :2]
    side, rows = np.roll(start, -1, axis=0) - start, []
    for surface, corners, span in zip(scene.surface, corners_m, span_m, strict=True):
        low, high = corners.min(axis=0), corners.max(axis=0)
        off = (low + high)[:2] / 2 - start
        share = np.clip((off * side).sum(axis=1) / (side**2).sum(axis=1), 0, 1)
        inside = np.linalg.norm(off - share[:, None] * side, axis=1).min()
        form = surface.vertices_m is None, surface.mirrors is None, len(corners)
        rows.append((*form, np.hypot(*span[:2]), low[2], high[2], inside))
    return np.array(rows, float)
