"""Presets of the benchmark: which methods run on which scenes and protocols, with which seeds and budgets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from xfreqbench.data.splits import LOFO_TARGETS_GHZ, TargetsGhz
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.units import PAPER_CARRIERS_GHZ


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
NAMED = (*_SYSTEMS_OF_THE_PAPER, Setting("swift-wrf"))
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
    Setting("xfreq-gs", ("latent=0",)),
    Setting("xfreq-gs", ("blend=none",)),
)
BENCHES = ("generate", "plain", "render", "savings", "stress", "scale-out", "peers")
_SCENES = ("office", "two_rooms", "corridor", "lounge", "office_cluttered")
_PROTOCOLS = ("lofo", "sparse", "held-out-tx", "lofo-unseen-tx", "held-out-block", "random-samples")
_OTHER_CARRIERS_GHZ = tuple(carrier for carrier in PAPER_CARRIERS_GHZ if carrier not in LOFO_TARGETS_GHZ)


def _trivial(scene: str, protocol: str, targets_ghz: TargetsGhz = None) -> Block:
    """Runs of the predictors that learn nothing, with one seed."""
    return Block(scene, protocol, TRIVIAL_SETTINGS, None, targets_ghz=targets_ghz)


QUICK = Preset(
    description="a look at our methods and the reduced baselines on 240 office transmitters, one seed, 64,000 maps "
    "a fit",
    blocks=(
        *(_trivial("office", protocol) for protocol in ("lofo", "held-out-tx", "lofo-unseen-tx")),
        *(Block("office", protocol, LEARNED, "quick") for protocol in ("lofo", "held-out-tx")),
        Block("office", "lofo", (VIRTUAL_SOURCE,), "quick"),
        Block("office", "lofo-unseen-tx", LEARNED, "quick", targets_ghz=(24.25,)),
    ),
    left_out="every other scene; sparse, held-out-block and random-samples; the named systems and xfreq-gs-paper; "
    "virtual-source but on lofo; ablations, other lanes, more than one seed (so nothing learned is ranked), and the "
    "measurements of generator, renderer and stability",
    num_tx={"office": 240},
)
_OURS = (*LEARNED, VIRTUAL_SOURCE)
_EVERY = (*_OURS, *NAMED)


def _boards(places: Sequence[tuple[str, str]], targets_ghz: TargetsGhz = None) -> Iterator[Block]:
    """For each scene and protocol the trivial predictors, then every method with three seeds."""
    for scene, protocol in places:
        yield _trivial(scene, protocol, targets_ghz)
        yield Block(scene, protocol, _EVERY, "quick", SEEDS, targets_ghz)


STANDARD = Preset(
    description="every method with three seeds in the lane quick, 64,000 maps a fit, in five scenes on six protocols, "
    "on lofo in the office at all ten carriers; what says most runs first: the office, then lofo in the other scenes",
    blocks=(
        *_boards([("office", protocol) for protocol in _PROTOCOLS]),
        *_boards([(scene, "lofo") for scene in _SCENES[1:]]),
        *_boards([(scene, protocol) for scene in _SCENES[1:] for protocol in _PROTOCOLS[1:]]),
        *_boards([("office", "lofo")], _OTHER_CARRIERS_GHZ),
    ),
    left_out="xfreq-gs-paper (preset paper-size), ablations (preset ablations), the lane converged (preset converged), "
    "on lofo-unseen-tx and outside of the office the carriers that the paper does not test, and unseen rooms (preset "
    "rooms)",
    benches=BENCHES,
)
ABLATED = Preset(
    description="every ablation of xfreq-gs, aperture-gs and virtual-source, in the lane quick, on lofo at 24.25 GHz "
    "in the office; three seeds, of virtual-source one",
    blocks=(
        _trivial("office", "lofo", (24.25,)),
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
        _trivial("office", "lofo", (24.25,)),
        Block("office", "lofo", _EVERY, "converged", SEEDS, targets_ghz=(24.25,)),
    ),
    left_out="other carriers, scenes and protocols, and xfreq-gs-paper (preset paper-size)",
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
        *(_trivial(scene, "lofo", "all") for scene in _SCENES[:3]),
        *(Block(scene, "lofo", (_TOLD, _BLIND), "300steps", (*SEEDS, 3, 4), "all") for scene in _SCENES[:3]),
        Block("office", "lofo", _TOLD_OTHERWISE, "300steps", SEEDS, "all"),
    ),
    left_out="other methods and protocols, two thirds of the transmitters, and the other trends outside of the office",
    num_tx=dict.fromkeys(_SCENES[:3], 480),
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
        _trivial("office", "lofo", "all"),
        *(_trivial("office", protocol) for protocol in ("sparse", "random-samples")),
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
        blocks=(_trivial("office", block.protocol, block.targets_ghz), block),
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
        *(_trivial("office", protocol) for protocol in ("lofo", "sparse")),
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
        for block in (_trivial("office", protocol), Block("office", protocol, _EQUAL, "quick", SEEDS))
    ),
    left_out="every other method, scene and protocol",
)
_OF_ONE_ROOM = tuple(map(Setting, ("xfreq-gs", "aperture-gs", "virtual-source")))
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
        Block("rooms", "unseen-rooms", _OF_ONE_ROOM, "2000maps"),
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
    "carrier": CARRIER,
    "rooms": ROOMS,
    "paper": PAPER,
    **PARTS_OF_PAPER,
    "paper-size": PAPER_SIZE,
    "equal-terms": EQUAL_TERMS,
}
