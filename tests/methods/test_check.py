from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.forked import command_line
from xfreqbench.errors import UnknownNameError
from xfreqbench.methods.check import check_method
from xfreqbench.methods.trivial import EVERY_TRIVIAL

SOUND = '''
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from xfreqbench.data.dataset import open_dataset
from xfreqbench.methods.contract import Progress

@dataclass(frozen=True)
class Config:
    level: float = 0.5

class Sound:
    """Learns the mean training map, step by step, and breaks no rule."""

    num_parameters = 32400

    def __init__(self, config=Config()):
        self.config = config

    def fit(self, train, budget, seed):
        random = np.random.default_rng(seed)
        self.maps, self.mean = train.pas(), np.full((90, 360), 1.0, np.float32)
        for step in range(1, 6):
            self.step(random)
            yield Progress(step, float(step), {"maps": step})

    def step(self, random):
        self.mean = 0.5 * self.mean + 0.5 * self.maps[random.integers(len(self.maps))]

    def predict(self, tx_position_m, carrier_hz):
        scale = 1 + 0.01 * tx_position_m[:, 0] + 1e-12 * carrier_hz
        maps = self.mean ** scale[:, None, None]
        return (maps / maps.max(axis=(1, 2), keepdims=True)).astype(np.float32)

    def save(self, directory):
        np.save(directory / "mean.npy", self.mean)
        (directory / "config.json").write_text(json.dumps(asdict(self.config)))

    @classmethod
    def load(cls, directory):
        method = cls(Config(**json.loads((directory / "config.json").read_text())))
        method.mean = np.load(directory / "mean.npy")
        return method
'''

PREDICT = """
class Method(Sound):
    def predict(self, tx_position_m, carrier_hz):
        maps = super().predict(tx_position_m, carrier_hz)
"""

FIT = """
class Method(Sound):
    def fit(self, train, budget, seed):
"""

BROKEN = {
    "lacks a part": (
        "class Method:\n    def __init__(self, config=None): ...\n",
        "it can be constructed",
        "lacks fit, predict, save, load",
    ),
    "takes no config": (
        "class Method(Sound):\n    def __init__(self):\n        self.config = Config()\n",
        "it can be constructed",
        "TypeError",
    ),
    "config can be changed": (
        "@dataclass\nclass Loose:\n    level: float = 0.5\n"
        "class Method(Sound):\n    def __init__(self, config=Loose()):\n        self.config = config\n",
        "its config is a frozen dataclass",
        r"frozen=True",
    ),
    "fit forgets to yield": (FIT + "        self.mean = train.pas().mean(axis=0)\n", "fit is a generator", "None"),
    "fit raises": (FIT + "        yield Progress(1, 1 / 0)\n", "fit is a generator", "ZeroDivisionError"),
    "first yield comes too early": (
        FIT + "        yield Progress(0, 0.0)\n        yield from super().fit(train, budget, seed)\n",
        "predict is valid at fit's first yield",
        "AttributeError",
    ),
    "fit cannot be closed": (
        FIT + "        try:\n            yield from super().fit(train, budget, seed)\n"
        "        except GeneratorExit:\n            yield Progress(9, 0.0)\n",
        "fit can be closed",
        "ignored GeneratorExit",
    ),
    "steps stand still": (
        FIT + "        for progress in super().fit(train, budget, seed):\n            yield Progress(1, 0.0)\n",
        "its steps ascending",
        "yielded step 1 after 1. .* a fit that stops early returns",
    ),
    "maps are not counted": (
        FIT
        + "        for progress in super().fit(train, budget, seed):\n            yield Progress(progress.step, 0.0)\n",
        "fit takes a budget in maps",
        "does not tell how many its steps have shown",
    ),
    "findings are arrays": (
        "class Method(Sound):\n    def findings(self):\n        return {'mean': self.mean}\n",
        "findings, if it has them",
        "ndarray is not JSON",
    ),
    "a GPU is the default": (
        "@dataclass(frozen=True)\nclass Fast(Config):\n    device: str = 'cuda'\n"
        "class Method(Sound):\n    def __init__(self, config=Fast()):\n        self.config = config\n",
        "the device that it is told",
        "'cuda' by default",
    ),
    "the best weights come after the last yield": (
        FIT + "        yield from super().fit(train, budget, seed)\n        self.mean = self.maps[0]\n",
        "closed at its last yield",
        "restore the best weights before it",
    ),
    "parameters are not counted": (
        "class Method(Sound):\n    num_parameters = 0.5\n",
        "num_parameters is an integer",
        "0.5, a float",
    ),
    "maps are decibels": (PREDICT + "        return maps * 30\n", "returns float32 maps", "0, 1"),
    "unseen carrier is refused": (
        PREDICT + "        return [maps[float(carrier == 2.4e9):] for carrier in carrier_hz]\n",
        "at a carrier it was not trained on",
        "TypeError",
    ),
    "unseen transmitter is refused": (
        "class Method(Sound):\n"
        "    def fit(self, train, budget, seed):\n"
        "        self.known = {tuple(place) for place in train.tx_position_m.tolist()}\n"
        "        yield from super().fit(train, budget, seed)\n"
        "    def predict(self, tx_position_m, carrier_hz):\n"
        "        if not {tuple(place) for place in tx_position_m.tolist()} <= self.known:\n"
        "            raise KeyError('who is that')\n"
        "        return super().predict(tx_position_m, carrier_hz)\n",
        "for a transmitter that it was not trained on",
        "who is that",
    ),
    "maps are not normalised": (PREDICT + "        return maps * np.float32(0.5)\n", "peak 1", "from 0.5 to 0.5"),
    "predict draws at random": (
        PREDICT + "        maps[:, 0, 0] = np.random.default_rng().random(len(maps))\n        return maps\n",
        "the same when asked twice",
        "differ by up to",
    ),
    "rows are averaged": (
        PREDICT
        + "        maps = 0.5 * maps + 0.5 * maps[:1]\n        return maps / maps.max(axis=(1, 2), keepdims=True)\n",
        "does not depend on the other rows",
        "no mean over the batch",
    ),
    "a lone row is squeezed": (PREDICT + "        return maps.squeeze()\n", "asked for alone", r"shape \(90, 360\)"),
    "save forgets": (
        "class Method(Sound):\n    def save(self, directory):\n        super().save(directory)\n"
        "        np.save(directory / 'mean.npy', self.mean.round(1))\n",
        "saved and loaded",
        "Save everything that predict uses",
    ),
    "save loses the config": (
        "class Method(Sound):\n    @classmethod\n    def load(cls, directory):\n"
        "        method = super().load(directory)\n        method.config = Config(level=0.25)\n        return method\n",
        "saved and loaded",
        r"level=0\.25",
    ),
    "predict disturbs training": (
        "class Method(Sound):\n"
        "    def step(self, random):\n"
        "        self.random = random\n        super().step(random)\n"
        "    def predict(self, tx_position_m, carrier_hz):\n"
        "        getattr(self, 'random', np.random.default_rng()).random()\n"
        "        return super().predict(tx_position_m, carrier_hz)\n",
        "do not change how training goes on",
        "differ by up to",
    ),
    "test rows are read": (
        FIT + "        whole = open_dataset(train.path)\n        yield from super().fit(whole, budget, seed)\n",
        "only training rows are used",
        "never its file",
    ),
    "a file is left behind": (
        FIT + "        Path('notes.txt').write_text('here')\n        yield from super().fit(train, budget, seed)\n",
        "nothing is written into the working folder",
        r"notes\.txt",
    ),
}


@pytest.fixture
def own_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    monkeypatch.syspath_prepend(tmp_path)
    number = iter(range(100))

    def write(text: str, name: str = "Method") -> str:
        module = f"{tmp_path.name}_{next(number)}"  # a name of its own: modules stay imported
        (tmp_path / f"{module}.py").write_text(SOUND + text)
        return f"{module}:{name}"

    return write


@pytest.mark.parametrize("name", EVERY_TRIVIAL)
def test_every_trivial_predictor_keeps_the_contract(name: str) -> None:
    findings = check_method(name)
    assert len(findings) == 20
    assert [str(finding) for finding in findings if finding.fault] == []


@pytest.mark.parametrize("kind", BROKEN)
def test_every_broken_rule_is_found_and_named(own_method, kind: str) -> None:
    text, requirement, words = BROKEN[kind]
    faults = [finding for finding in check_method(own_method(text)) if finding.is_fault]
    named = [finding for finding in faults if requirement in finding.requirement]
    assert named, [str(finding) for finding in faults]
    assert re.search(words, str(named[0].fault)), named[0].fault


def test_all_faults_are_found_at_once(own_method) -> None:
    text = PREDICT + "        return maps * np.float32(0.5)\n    num_parameters = -1\n"
    faults = {finding.requirement for finding in check_method(own_method(text)) if finding.is_fault}
    assert faults == {"num_parameters is an integer of 0 or more", "every map has peak 1"}


def test_a_method_that_ignores_its_seed_is_warned_and_not_refused(own_method) -> None:
    text = FIT + "        yield from super().fit(train, budget, np.random.default_rng().integers(10**9))\n"
    finding, *not_checked = [finding for finding in check_method(own_method(text)) if finding.fault]
    assert finding.is_warning
    assert str(finding).startswith("warn ")
    assert "same seed" in finding.requirement
    assert ["not checked, because" in str(result.fault) for result in not_checked] == [True] * 3
    assert not any(result.is_fault for result in not_checked)


def test_options_reach_the_method(own_method) -> None:
    text = PREDICT + "        return maps * np.float32(2 * self.config.level)\n"
    method = own_method(text)
    assert not any(finding.fault for finding in check_method(method))
    faults = [finding.requirement for finding in check_method(method, ["level=0.25"]) if finding.is_fault]
    assert faults == ["every map has peak 1"]


def test_an_unknown_name_is_an_error_and_no_result(own_method) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'nearest'"):
        check_method("nearst")
    with pytest.raises(UnknownNameError, match="level"):
        check_method(own_method("", "Sound"), ["levle=1"])


def test_the_command_prints_every_rule_and_ends_with_code_2_where_one_is_broken(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(SOUND + PREDICT + "        return maps * np.float32(0.5)\n")
    command = [command_line(), "check-method"]
    broken = subprocess.run([*command, "mine:Method"], capture_output=True, text=True, cwd=tmp_path)
    assert broken.returncode == 2
    assert "FAULT  every map has peak 1" in broken.stdout
    assert "breaks its contract in 1" in broken.stderr
    sound = subprocess.run([*command, "mine:Sound"], capture_output=True, text=True, cwd=tmp_path)
    assert sound.returncode == 0
    assert sound.stdout.count("ok  ") == 20
