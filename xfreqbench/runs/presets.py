"""Presets of the benchmark: which methods run on which scenes and protocols, with which seeds and budgets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from xfreqbench.methods.trivial import EVERY_TRIVIAL

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
    runs, named as the keys of `xfreqbench.runs.benchmark.BENCH_COMMANDS`. `num_rooms` has the number of rooms that are
    drawn from each family of rooms, with `num_tx` transmitters each; a block names the family as its scene.
    """

    description: str
    blocks: tuple[Block, ...]
    left_out: str
    num_tx: Mapping[str, int] = field(default_factory=dict)
    benches: tuple[str, ...] = ()
    num_rooms: Mapping[str, int] = field(default_factory=dict)


SEEDS = (0, 1, 2)
TRIVIAL_SETTINGS = tuple(map(Setting, EVERY_TRIVIAL))
LEARNED = tuple(map(Setting, ("aperture-gs", "fixed-frequency-gs", "frequency-embedded-gs", "xfreq-gs")))
# published systems, reduced and re-implemented: those of the paper of XFreq-GS, and one more
_SYSTEMS_OF_THE_PAPER = tuple(map(Setting, ("gsrf", "wrf-gs-plus", "wideband-3dgs")))
SWIFT_WRF = Setting("swift-wrf")
NAMED = (*_SYSTEMS_OF_THE_PAPER, SWIFT_WRF)
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
        "render=learned",
        "render=traced",
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
    Setting("xfreq-gs", ("latent=0",)),
    Setting("xfreq-gs", ("blend=none",)),
)
BENCHES = ("generate", "plain", "render", "savings", "stress", "scale-out", "peers")
_SCENES = ("office", "two_rooms")
_ALL_SCENES = (*_SCENES, "corridor")
_PROTOCOLS = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx")


def _trivial(protocol: str, scene: str) -> Block:
    """Runs of the predictors that learn nothing, on every split, with one seed."""
    return Block(scene, protocol, TRIVIAL_SETTINGS, None, targets_ghz="all" if protocol == "lofo" else None)


_TRIVIAL_BLOCKS = tuple(_trivial(protocol, scene) for scene in _SCENES for protocol in _PROTOCOLS)

QUICK = Preset(
    description="a look at our methods and the reduced baselines on 240 office transmitters, one seed, 64,000 maps "
    "a fit",
    blocks=(
        *(Block("office", protocol, TRIVIAL_SETTINGS, None) for protocol in ("lofo", "held-out-tx", "lofo-unseen-tx")),
        *(Block("office", protocol, LEARNED, "quick") for protocol in ("lofo", "held-out-tx")),
        Block("office", "lofo", (VIRTUAL_SOURCE,), "quick"),
        Block("office", "lofo-unseen-tx", LEARNED, "quick", targets_ghz=(24.25,)),
    ),
    left_out="two_rooms and corridor; sparse, held-out-block and random-samples; the named systems and xfreq-gs-paper; "
    "virtual-source but on lofo; ablations, other lanes, more than one seed (so nothing learned is ranked), and the "
    "measurements of generator, renderer and stability",
    num_tx={"office": 240},
)
_OURS = (Setting("xfreq-gs"), Setting("aperture-gs"), VIRTUAL_SOURCE)
_REDUCED = (Setting("fixed-frequency-gs"), Setting("frequency-embedded-gs"))
STANDARD = Preset(
    description="the lane quick, 64,000 maps a fit, with three seeds: the paper's three, our two and swift-wrf on lofo "
    "in the office, the first five in two_rooms, and xfreq-gs and our two on the other protocols and in the corridor; "
    "in the lane minutes xfreq-gs and virtual-source at 24.25 GHz in the office",
    blocks=(
        *_TRIVIAL_BLOCKS,
        Block("corridor", "lofo", TRIVIAL_SETTINGS, None),
        _trivial("held-out-block", "office"),
        Block("office", "lofo", (*_OURS, *_REDUCED, SWIFT_WRF), "quick", SEEDS),
        *(Block("office", protocol, _OURS, "quick", SEEDS) for protocol in (*_PROTOCOLS[1:], "held-out-block")),
        Block("two_rooms", "lofo", (*_OURS, *_REDUCED), "quick", SEEDS),
        Block("corridor", "lofo", _OURS, "quick", SEEDS),
        Block("two_rooms", "held-out-tx", _OURS, "quick", SEEDS),
        *(Block("two_rooms", protocol, _OURS[:2], "quick", SEEDS) for protocol in ("sparse", "lofo-unseen-tx")),
        Block("office", "lofo", (VIRTUAL_SOURCE, Setting("xfreq-gs")), "minutes", SEEDS, targets_ghz=(24.25,)),
    ),
    left_out="gsrf, wrf-gs-plus and wideband-3dgs (preset paper); ablations (presets ablations and paper); the lane "
    "converged (preset converged), and the lane minutes for other methods, carriers, protocols and scenes (preset "
    "full); the reduced baselines and swift-wrf where they are not named above; but for trivial predictors, the "
    "carriers that the paper does not test; virtual-source on sparse and lofo-unseen-tx in two_rooms; in the corridor "
    "all but lofo, and held-out-block but in the office; random-samples (preset paper), and xfreq-gs-paper (preset "
    "paper-size)",
    benches=BENCHES,
)
ABLATED = Preset(
    description="every ablation of xfreq-gs, aperture-gs and virtual-source, in the lane quick, on lofo at 24.25 GHz "
    "in the office; three seeds, of virtual-source one",
    blocks=(
        Block("office", "lofo", TRIVIAL_SETTINGS, None, targets_ghz=(24.25,)),
        Block(
            "office",
            "lofo",
            (Setting("xfreq-gs"), *ABLATIONS, Setting("aperture-gs"), BLIND_APERTURE),
            "quick",
            SEEDS,
            targets_ghz=(24.25,),
        ),
        Block("office", "lofo", (VIRTUAL_SOURCE, *VIRTUAL_SOURCE_ABLATIONS), "quick", targets_ghz=(24.25,)),
    ),
    left_out="every other scene, protocol, carrier and budget",
)
CONVERGED = Preset(
    description="every method on lofo at 24.25 GHz in the office with 200,000 maps a fit, as many as the paper's fits "
    "have iterations, three seeds",
    blocks=(
        Block("office", "lofo", TRIVIAL_SETTINGS, None, targets_ghz=(24.25,)),
        Block("office", "lofo", (*_OURS, *_REDUCED, *NAMED), "converged", SEEDS, targets_ghz=(24.25,)),
    ),
    left_out="other carriers, scenes and protocols, and xfreq-gs-paper (preset paper-size)",
)
FULL = Preset(
    description="every method and the ablations of xfreq-gs and aperture-gs on most protocols and every carrier, three "
    "seeds, in the lane minutes",
    blocks=(
        *_TRIVIAL_BLOCKS,
        *(
            Block(
                scene,
                protocol,
                (VIRTUAL_SOURCE, *LEARNED, *NAMED, *ABLATIONS, BLIND_APERTURE),
                "minutes",
                SEEDS,
                _trivial(protocol, scene).targets_ghz,
            )
            for scene in _SCENES
            for protocol in _PROTOCOLS
        ),
    ),
    left_out="the scene corridor; held-out-block and random-samples; on lofo-unseen-tx the carriers that the paper "
    "does not test; xfreq-gs-paper, and the ablations of virtual-source",
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
    "carriers of three scenes; and other trends and blurred carriers in the office, three seeds",
    blocks=(
        *(_trivial("lofo", scene) for scene in _ALL_SCENES),
        *(Block(scene, "lofo", (_TOLD, _BLIND), "300steps", (*SEEDS, 3, 4), "all") for scene in _ALL_SCENES),
        Block("office", "lofo", _TOLD_OTHERWISE, "300steps", SEEDS, "all"),
    ),
    left_out="other methods and protocols, two thirds of the transmitters, and the other trends outside of the office",
    num_tx=dict.fromkeys(_ALL_SCENES, 480),
)
_PAPERS = (Setting("xfreq-gs"), *_SYSTEMS_OF_THE_PAPER)
_PAPERS_LOFO = Block("office", "lofo", _PAPERS, "quick", SEEDS)
_PAPERS_SPARSE = Block("office", "sparse", _PAPERS[:1], "quick", SEEDS)
_PAPERS_ABLATION = Block("office", "lofo", (_PAPERS[0], *PAPER_ABLATIONS), "quick", SEEDS, targets_ghz=(24.25,))
PAPER = Preset(
    description="the experiments of the paper of XFreq-GS on our data, in the lane quick: its four methods on lofo in "
    "the office, xfreq-gs on sparse, its ablations at 24.25 GHz, its methods on random samples, which its released "
    "code draws, and xfreq-gs at two more carriers, of which maps are shown",
    blocks=(
        *(_trivial(protocol, "office") for protocol in ("lofo", "sparse", "random-samples")),
        _PAPERS_LOFO,
        _PAPERS_SPARSE,
        _PAPERS_ABLATION,
        Block("office", "random-samples", _PAPERS, "quick", SEEDS),
        Block("office", "lofo", _PAPERS[:1], "quick", targets_ghz=(10.0, 60.0)),
    ),
    left_out="the sizes of the paper (preset paper-size), other budgets, scenes and methods",
)
PARTS_OF_PAPER = {
    f"paper-{part}": Preset(
        description=f"{what}: a part of preset paper",
        blocks=(Block("office", block.protocol, TRIVIAL_SETTINGS, None, targets_ghz=block.targets_ghz), block),
        left_out="the other parts of preset paper",
    )
    for part, what, block in (
        ("lofo", "the paper's four methods on lofo in the office, three seeds", _PAPERS_LOFO),
        ("sparse", "xfreq-gs on sparse in the office, three seeds", _PAPERS_SPARSE),
        ("ablation", "xfreq-gs and the paper's ablations at 24.25 GHz, three seeds", _PAPERS_ABLATION),
        (
            "maps",
            "xfreq-gs at the five carriers of which maps are shown, one seed",
            Block("office", "lofo", _PAPERS[:1], "quick", targets_ghz=(2.4, 10.0, 24.25, 60.0, 77.0)),
        ),
    )
}
_AT_PAPER_SIZE = Setting("xfreq-gs-paper")
PAPER_SIZE = Preset(
    description="xfreq-gs-paper, XFreq-GS with nothing that its paper does not have, 200,000 maps a fit, three seeds: "
    "lofo and sparse in the office, and its ablations at 24.25 GHz; an hour of a core a fit, half a minute of a GPU",
    blocks=(
        *(Block("office", protocol, TRIVIAL_SETTINGS, None) for protocol in ("lofo", "sparse")),
        *(Block("office", protocol, (_AT_PAPER_SIZE,), "converged", SEEDS) for protocol in ("lofo", "sparse")),
        Block(
            "office",
            "lofo",
            tuple(Setting("xfreq-gs-paper", each.overrides) for each in PAPER_ABLATIONS),
            "converged",
            SEEDS,
            targets_ghz=(24.25,),
        ),
    ),
    left_out="every other method, scene and protocol, and one map a step",
)
_EQUAL = tuple(
    Setting(method, (f"aided={aided}",))
    for method in ("xfreq-gs", "fixed-frequency-gs", "frequency-embedded-gs")
    for aided in ("true", "false")
)
EQUAL_TERMS = Preset(
    description="xfreq-gs and its two reductions, each with and without the aids that no paper has, on lofo and sparse "
    "in the office, in the lane quick, three seeds: what the paper's own idea adds",
    blocks=tuple(
        block
        for protocol in ("lofo", "sparse")
        for block in (
            Block("office", protocol, TRIVIAL_SETTINGS, None),
            Block("office", protocol, _EQUAL, "quick", SEEDS),
        )
    ),
    left_out="every other method, scene and protocol",
)
CLUTTER = Preset(
    description="whether methods rank in a room full of things as in the bare ones: xfreq-gs and our two on every "
    "protocol but random-samples in office_cluttered, in the lane quick, three seeds",
    blocks=tuple(
        block
        for protocol in (*_PROTOCOLS, "held-out-block")
        for block in (
            Block("office_cluttered", protocol, TRIVIAL_SETTINGS, None),
            Block("office_cluttered", protocol, _OURS, "quick", SEEDS),
        )
    ),
    left_out="every other scene, method and budget, random-samples, and the carriers that the paper does not test",
)
_ROOM_TRIVIAL = tuple(map(Setting, ("line-of-sight", "nearest", "k-nearest")))
_ROOM_LAGS = tuple(
    Setting("room-lags", overrides)
    for overrides in ((), ("trained_on=10",), ("trained_on=100",), ("hears=false",), ("images=false",))
)
ROOMS = Preset(
    description="unseen rooms: 1,000 rooms of the family rooms; predictors that learn nothing; room-lags after an hour "
    "of learning across rooms; our methods of one room fitted anew to what is heard, 2,000 maps a room; room-lags "
    "after 600,000 maps of 10, 100 and all training rooms, and without its parts; and a tracer that is told the plan "
    "but not the materials",
    blocks=(
        Block("rooms", "unseen-rooms", _ROOM_TRIVIAL, None),
        Block("rooms", "unseen-rooms", _ROOM_LAGS[:1], "1h"),
        Block("rooms", "unseen-rooms", _OURS, "2000maps"),
        Block("rooms", "unseen-rooms", _ROOM_LAGS, "600000maps"),
        Block("rooms", "unseen-rooms-plan", _ROOM_TRIVIAL[:1], None),
        Block("rooms", "unseen-rooms-plan", (Setting("plan-tracer"),), None),
    ),
    left_out="trivial predictors that need the room's own carriers or spectra, other families and numbers of rooms, "
    "more than one seed, and longer fits",
    num_tx={"rooms": 88},
    num_rooms={"rooms": 1000},
)
PRESETS: Mapping[str, Preset] = {
    "quick": QUICK,
    "standard": STANDARD,
    "ablations": ABLATED,
    "converged": CONVERGED,
    "full": FULL,
    "carrier": CARRIER,
    "clutter": CLUTTER,
    "rooms": ROOMS,
    "paper": PAPER,
    **PARTS_OF_PAPER,
    "paper-size": PAPER_SIZE,
    "equal-terms": EQUAL_TERMS,
}
