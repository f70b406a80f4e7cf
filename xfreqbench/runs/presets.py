"""Presets of the benchmark: which methods run on which scenes and protocols, with which seeds and budgets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from xfreqbench.methods.contract import TRIVIAL

TargetsGhz = tuple[float, ...] | Literal["all"] | None


@dataclass(frozen=True)
class Setting:
    """A method, with the options that differ from its defaults as texts `key=value`."""

    method: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Block:
    """Runs of every setting on every split of a protocol with every seed; `targets_ghz` is what `--targets` gives."""

    scene: str
    protocol: str
    settings: tuple[Setting, ...]
    budget: str | None
    seeds: tuple[int, ...] = (0,)
    targets_ghz: TargetsGhz = None


@dataclass(frozen=True)
class Preset:
    """A benchmark: its blocks, in the order in which they run, and what it leaves out, in words.

    `num_tx` limits the number of transmitters of a scene's data set. `benches` are the measurements that follow the
    runs, named as the keys of `xfreqbench.runs.benchmark.BENCH_COMMANDS`.
    """

    description: str
    blocks: tuple[Block, ...]
    left_out: str
    num_tx: Mapping[str, int] = field(default_factory=dict)
    benches: tuple[str, ...] = ()


SEEDS = (0, 1, 2)
TRIVIAL_SETTINGS = tuple(map(Setting, TRIVIAL))
LEARNED = tuple(map(Setting, ("aperture-gs", "fixed-frequency-gs", "frequency-embedded-gs", "xfreq-gs")))
NAMED = tuple(
    map(Setting, ("gsrf", "wrf-gs-plus", "wideband-3dgs"))
)  # published systems, reduced and re-implemented
VIRTUAL_SOURCE = Setting("virtual-source")
VIRTUAL_SOURCE_ABLATIONS = tuple(
    Setting("virtual-source", (override,))
    for override in (
        "phase=false",
        "planes=random",
        "looks=0",
        "max_order=0",
        "max_order=1",
        "max_order=2",
        "free_sources=0",
        "lengths=float32",
        "max_gain=0.5",
        "sparsity=0",
    )
)
BLIND_APERTURE = Setting("aperture-gs", ("sees_carrier=false", "latent=0"))
PAPER_ABLATIONS = (  # those that the paper has
    Setting("xfreq-gs", ("sees_carrier=false", "latent=0")),
    Setting("xfreq-gs", ("footprint=circular", "max_spread=1")),
    Setting("xfreq-gs", ("sees_carrier=false", "latent=0", "footprint=circular", "max_spread=1")),
)
ABLATIONS = (
    *PAPER_ABLATIONS,
    Setting("xfreq-gs", ("start=random",)),
    Setting("xfreq-gs", ("network=pairwise", "width=64", "layers=4")),
    Setting("xfreq-gs", ("direct_wave=false",)),
    Setting("xfreq-gs", ("band=false",)),
    Setting("xfreq-gs", ("transmittance=false",)),
    Setting("xfreq-gs", ("max_spread=1",)),
    Setting("xfreq-gs", ("sees_carrier=false",)),
    Setting("xfreq-gs", ("blend=none",)),
)
BENCHES = ("generate", "plain", "render", "savings", "stress")
_SCENES = ("office", "two_rooms")
_ALL_SCENES = (*_SCENES, "corridor")
_PROTOCOLS = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx")
_OTHER_GHZ = (1.0, 5.0, 10.0, 37.0, 47.0, 60.0, 94.0)  # the carriers that the paper does not test
_VALIDATION_GHZ = (5.0, 47.0)  # the choice that aperture-gs is told the carrier was made at these


def _trivial(protocol: str, scene: str) -> Block:
    """Runs of the predictors that learn nothing, on every split, with one seed."""
    return Block(scene, protocol, TRIVIAL_SETTINGS, None, targets_ghz="all" if protocol == "lofo" else None)


_TRIVIAL = tuple(_trivial(protocol, scene) for scene in _SCENES for protocol in _PROTOCOLS)

QUICK = Preset(
    description="a look at everything on 240 office transmitters, one seed, 10 s a fit",
    blocks=(
        *(
            Block("office", protocol, TRIVIAL_SETTINGS, None)
            for protocol in ("lofo", "held-out-tx", "lofo-unseen-tx")
        ),
        *(Block("office", protocol, LEARNED, "10s") for protocol in ("lofo", "held-out-tx")),
        Block("office", "lofo", (VIRTUAL_SOURCE,), "30s"),
        Block("office", "lofo-unseen-tx", LEARNED, "10s", targets_ghz=(24.25,)),
    ),
    left_out="two_rooms, the sparse protocol, ablations, more than one seed (so nothing learned is ranked), "
    "and the measurements of generator, renderer and stability",
    num_tx={"office": 240},
)
STANDARD = Preset(
    description="every method on two scenes, two in a third, half a minute a fit (virtual-source one, and five "
    "for the paper's splits), three seeds where learned methods are ranked",
    blocks=(
        *_TRIVIAL,
        Block("corridor", "lofo", TRIVIAL_SETTINGS, None),
        Block("office", "lofo", (VIRTUAL_SOURCE,), "5m", SEEDS),
        Block("office", "lofo", LEARNED, "30s", SEEDS),
        Block("office", "lofo", NAMED, "30s", SEEDS),
        Block("office", "lofo-unseen-tx", (VIRTUAL_SOURCE,), "1m"),
        Block("office", "lofo-unseen-tx", LEARNED, "30s", SEEDS),
        Block("office", "held-out-tx", (VIRTUAL_SOURCE,), "1m", SEEDS),
        Block("office", "held-out-tx", LEARNED, "30s", SEEDS),
        Block("office", "sparse", (VIRTUAL_SOURCE,), "1m"),
        Block("office", "lofo", (VIRTUAL_SOURCE, *VIRTUAL_SOURCE_ABLATIONS), "1m", targets_ghz=(24.25,)),
        Block("office", "held-out-tx", (Setting("virtual-source", ("sparsity=0",)),), "1m"),
        Block("office", "lofo", (VIRTUAL_SOURCE,), "30s", targets_ghz="all"),
        Block("two_rooms", "lofo", (VIRTUAL_SOURCE,), "1m"),
        Block("two_rooms", "held-out-tx", (VIRTUAL_SOURCE,), "1m"),
        Block("corridor", "lofo", (VIRTUAL_SOURCE,), "30s"),
        Block("corridor", "lofo", (Setting("aperture-gs"),), "30s"),
        Block("office", "lofo", (Setting("xfreq-gs"), *ABLATIONS), "400steps", SEEDS, targets_ghz=(24.25,)),
        Block("office", "lofo", (BLIND_APERTURE,), "30s", SEEDS, targets_ghz=(24.25,)),
        Block("two_rooms", "lofo", LEARNED, "30s", SEEDS),
        Block("office", "lofo", LEARNED, "5m", targets_ghz=(24.25,)),
        Block("office", "sparse", LEARNED, "30s"),
        Block("two_rooms", "held-out-tx", LEARNED, "30s"),
        Block("two_rooms", "lofo-unseen-tx", LEARNED, "30s"),
        Block("two_rooms", "sparse", LEARNED, "30s"),
        Block("office", "lofo", (Setting("aperture-gs"), Setting("xfreq-gs")), "30s", targets_ghz=_OTHER_GHZ),
        Block("office", "lofo", (BLIND_APERTURE,), "30s", targets_ghz=_VALIDATION_GHZ),
    ),
    left_out="fits of five minutes but one a method at 24.25 GHz, and those of virtual-source; more than one seed of "
    "the sparse protocol, of two_rooms but for lofo, and of the seven carriers that the paper does not test, where "
    "the two reduced baselines are left out too; the named systems but for the office's lofo; ablations at other "
    "carriers and scenes; in the corridor all but lofo, one seed",
    benches=BENCHES,
)
FULL = Preset(
    description="every method and ablation on every protocol and carrier, three seeds, five minutes a fit",
    blocks=(
        *_TRIVIAL,
        *(
            Block(
                scene,
                protocol,
                (VIRTUAL_SOURCE, *LEARNED, *NAMED, *ABLATIONS, BLIND_APERTURE),
                "5m",
                SEEDS,
                _trivial(protocol, scene).targets_ghz,
            )
            for scene in _SCENES
            for protocol in _PROTOCOLS
        ),
    ),
    left_out="the scene corridor",
    benches=BENCHES,
)
_TOLD = Setting("xfreq-gs", ("blend=none",))
_BLIND = Setting("xfreq-gs", ("blend=none", "sees_carrier=false"))
_TOLD_OTHERWISE = tuple(
    Setting("xfreq-gs", ("blend=none", *overrides))
    for overrides in (("trend=log",), ("carrier_blur=0.5",), ("trend=log", "carrier_blur=0.5"))
)
CARRIER = Preset(
    description="whether xfreq-gs gains by being told the carrier: told against blind, equal steps, five seeds, all "
    "carriers of three scenes",
    blocks=(
        *(_trivial("lofo", scene) for scene in _ALL_SCENES),
        *(Block(scene, "lofo", (_TOLD, _BLIND), "300steps", (*SEEDS, 3, 4), "all") for scene in _ALL_SCENES),
        Block("office", "lofo", _TOLD_OTHERWISE, "300steps", SEEDS, "all"),
    ),
    left_out="other methods and protocols, two thirds of the transmitters, and the other trends outside of the office",
    num_tx=dict.fromkeys(_ALL_SCENES, 480),
)
PRESETS: Mapping[str, Preset] = {"quick": QUICK, "standard": STANDARD, "full": FULL, "carrier": CARRIER}
