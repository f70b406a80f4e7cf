"""Presets of the benchmark: which methods run on which scenes and protocols, with which seeds and budgets."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.runs.options import RunOptions


@dataclass(frozen=True)
class Setting:
    """A method, with the options that differ from its defaults as texts `key=value`."""

    method: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Block(RunOptions):
    """Runs of every setting on a scene, or on a family of rooms, on every split of a protocol with every seed."""

    scene: str
    settings: tuple[Setting, ...]


@dataclass(frozen=True)
class Preset:
    """A benchmark: its blocks, in the order in which they run, and what it leaves out, in words.

    `num_tx` limits the number of transmitters of a scene's data set. `benches` are the measurements that follow the
    runs, named as the keys of `BENCHES`. `num_rooms` has the number of rooms that are
    drawn from each family of rooms, with `num_tx` transmitters each; a block names the family as its scene.
    """

    description: str
    blocks: tuple[Block, ...]
    left_out: str
    num_tx: Mapping[str, int] = field(default_factory=dict)
    benches: tuple[str, ...] = ()
    num_rooms: Mapping[str, int] = field(default_factory=dict)


def _presets(stored: dict[str, Any]) -> dict[str, Preset]:
    """The presets of `presets.toml`, by name."""
    groups = {"trivial": [*EVERY_TRIVIAL], **stored.pop("methods")}

    def blocks(
        methods: Sequence[str],
        scenes: Sequence[str] = ("office",),
        protocols: Sequence[str] = ("lofo",),
        budget: str | None = None,
        seeds: int = 1,
        targets_ghz: Any = None,
        trivial: bool = False,
    ) -> Iterator[Block]:
        settings = tuple(_settings(methods, groups))
        targets = tuple(targets_ghz) if isinstance(targets_ghz, list) else targets_ghz
        for scene in scenes:
            for protocol in protocols:
                asked: dict[str, Any] = {"scene": scene, "protocol": protocol, "targets_ghz": targets}
                if trivial:
                    yield Block(settings=tuple(_settings(["trivial"], groups)), budget=None, **asked)
                yield Block(settings=settings, budget=budget, seeds=range(seeds), **asked)

    presets = {}
    for name, preset in stored.items():
        made = tuple(block for each in preset.pop("blocks") for block in blocks(**each))
        presets[name] = Preset(blocks=made, **{**preset, "benches": tuple(preset.get("benches", ()))})
    return presets


def _settings(methods: Sequence[str], groups: Mapping[str, Sequence[str]]) -> Iterator[Setting]:
    """The methods that texts name, those of groups among them."""
    for text in methods:
        name, *overrides = text.split()
        if name in groups and not overrides:
            yield from _settings(groups[name], groups)
        else:
            yield Setting(name, tuple(overrides))


_STORED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
BENCHES: dict[str, dict[str, Any]] = _STORED.pop("benches")
COSTS: dict[str, Any] = _STORED.pop("costs")
PRESETS: Mapping[str, Preset] = _presets(_STORED)
