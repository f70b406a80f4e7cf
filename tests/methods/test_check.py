from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent, indent

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


def method(text: str) -> str:
    return f"class Method(Sound):\n{indent(dedent(text), '    ')}\n"


def predicting(text: str) -> str:
    """A method whose `predict` begins with sound `maps`."""
    maps = "def predict(self, tx_position_m, carrier_hz):\n    maps = super().predict(tx_position_m, carrier_hz)\n"
    return method(maps + indent(dedent(text), "    "))


def fitting(text: str) -> str:
    """A method whose `fit` may go on with the sound `fit`."""
    sound = "def fit(self, train, budget, seed):\n    fit = super().fit\n"
    return method(sound + indent(dedent(text), "    "))


HALVED = predicting("return maps * np.float32(0.5)")
CONFIGURED = "class Method(Sound):\n    def __init__(self, config=Own()):\n        self.config = config\n"
BROKEN = {  # by the requirement that is not met, and words of the fault
    (
        "it can be constructed",
        "lacks fit, predict, save, load",
    ): "class Method:\n    def __init__(self, config=None): ...\n",
    ("it can be constructed", "TypeError"): method("def __init__(self):\n    self.config = Config()"),
    (
        "its config is a frozen dataclass",
        "frozen=True",
    ): f"@dataclass\nclass Own:\n    level: float = 0.5\n{CONFIGURED}",
    ("fit is a generator", "None"): fitting("self.mean = train.pas().mean(axis=0)"),
    ("fit is a generator", "ZeroDivisionError"): fitting("yield Progress(1, 1 / 0)"),
    ("predict is valid at fit's first yield", "AttributeError"): fitting(
        "yield Progress(0, 0.0)\nyield from fit(train, budget, seed)"
    ),
    ("fit can be closed", "ignored GeneratorExit"): fitting("""
            try:
                yield from fit(train, budget, seed)
            except GeneratorExit:
                yield Progress(9, 0.0)"""),
    ("its steps ascending", "yielded step 1 after 1. .* a fit that stops early returns"): fitting(
        "for progress in fit(train, budget, seed):\n    yield Progress(1, 0.0)"
    ),
    ("fit takes a budget in maps", "does not tell how many its steps have shown"): fitting(
        "for progress in fit(train, budget, seed):\n    yield Progress(progress.step, 0.0)"
    ),
    ("findings, if it has them", "ndarray is not JSON"): method("def findings(self):\n    return {'mean': self.mean}"),
    (
        "the device that it is told",
        "'cuda' by default",
    ): f"@dataclass(frozen=True)\nclass Own(Config):\n    device: str = 'cuda'\n{CONFIGURED}",
    ("closed at its last yield", "restore the best weights before it"): fitting(
        "yield from fit(train, budget, seed)\nself.mean = self.maps[0]"
    ),
    ("num_parameters is an integer", "0.5, a float"): method("num_parameters = 0.5"),
    ("returns float32 maps", "0, 1"): predicting("return maps * 30"),
    ("at a carrier it was not trained on", "TypeError"): predicting(
        "return [maps[float(carrier == 2.4e9):] for carrier in carrier_hz]"
    ),
    ("for a transmitter that it was not trained on", "who is that"): fitting(
        "self.known = train.tx_position_m\nyield from fit(train, budget, seed)"
    )
    + """
    def predict(self, tx_position_m, carrier_hz):
        if not all((self.known == place).all(axis=1).any() for place in tx_position_m):
            raise KeyError('who is that')
        return super().predict(tx_position_m, carrier_hz)
""",
    ("peak 1", "from 0.5 to 0.5"): HALVED,
    ("the same when asked twice", "differ by up to"): predicting(
        "maps[:, 0, 0] = np.random.default_rng().random(len(maps))\nreturn maps"
    ),
    ("does not depend on the other rows", "no mean over the batch"): predicting(
        "maps = maps + maps[:1]\nreturn maps / maps.max(axis=(1, 2), keepdims=True)"
    ),
    ("asked for alone", r"shape \(90, 360\)"): predicting("return maps.squeeze()"),
    ("uses nothing of an earlier one", "not in a module or a class"): "SEEN = {}\n"
    + fitting("""
        for map, place, carrier in zip(train.pas(), train.tx_position_m, train.carrier_hz):
            SEEN[*place, carrier] = map
        yield from fit(train, budget, seed)""")
    + """
    def predict(self, tx_position_m, carrier_hz):
        maps = super().predict(tx_position_m, carrier_hz)
        asked = zip(tx_position_m, carrier_hz, maps)
        return np.stack([SEEN.get((*place, carrier), map) for place, carrier, map in asked])
""",
    ("saved and loaded", "Save everything that predict uses"): method("""
            def save(self, directory):
                super().save(directory)
                np.save(directory / 'mean.npy', self.mean.round(1))"""),
    ("saved and loaded", r"level=0\.25"): method("""
            @classmethod
            def load(cls, directory):
                method = super().load(directory)
                method.config = Config(level=0.25)
                return method"""),
    ("do not change how training goes on", "differ by up to"): method("""
            def step(self, random):
                self.random = random
                super().step(random)
            def predict(self, tx_position_m, carrier_hz):
                getattr(self, 'random', np.random.default_rng()).random()
                return super().predict(tx_position_m, carrier_hz)"""),
    ("only training rows are used", "never its file"): fitting(
        "yield from fit(open_dataset(train.path), budget, seed)"
    ),
    ("nothing is written into the working folder", r"notes\.txt"): fitting(
        "Path('notes.txt').write_text('here')\nyield from fit(train, budget, seed)"
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
    assert len(findings) == 22
    assert [str(finding) for finding in findings if finding.fault] == []


@pytest.mark.parametrize(("requirement", "words"), BROKEN)
def test_every_broken_rule_is_found_and_named(own_method, requirement: str, words: str) -> None:
    text = BROKEN[requirement, words]
    faults = [finding for finding in check_method(own_method(text)) if finding.is_fault]
    named = [finding for finding in faults if requirement in finding.requirement]
    assert named, [str(finding) for finding in faults]
    assert re.search(words, str(named[0].fault)), named[0].fault


def test_a_fault_hides_only_what_cannot_be_tried_after_it(own_method) -> None:
    refuses = "        raise NotImplementedError\n"
    wrong_maps = predicting("return maps * 30") + f"    def save(self, directory):\n{refuses}"
    found = check_method(own_method(f"{wrong_maps}    num_parameters = -1\n"))
    assert len(found) == 22
    faults = [finding.requirement.partition(",")[0].partition(" maps")[0] for finding in found if finding.is_fault]
    assert faults == [
        "predict is valid at fit's first yield",
        "num_parameters is an integer of 0 or more",
        "predict returns float32",
        "predict returns",
        "a method that was saved and loaded predicts the same",
    ]
    untried = [str(finding) for finding in found if finding.is_untried]
    assert all(
        line.startswith("skip ") and "not tried, because of the fault in 'predict ret" in line for line in untried
    )
    assert len(untried) == 9

    on_gpu = f"@dataclass(frozen=True)\nclass Own(Config):\n    device: str = 'cuda'\n{CONFIGURED}"
    broken_fit = f"{on_gpu}    def fit(self, train, budget, seed):\n{refuses}"
    found = check_method(own_method(broken_fit))
    assert len(found) == 22
    faults = [finding.requirement.partition(",")[0] for finding in found if finding.is_fault]
    assert faults == ["fit is a generator that yields Progress", "it computes on the device that it is told"]


def test_a_method_that_ignores_its_seed_is_warned_and_not_refused(own_method) -> None:
    text = fitting("yield from fit(train, budget, np.random.default_rng().integers(10**9))")
    finding, *not_checked = [finding for finding in check_method(own_method(text)) if finding.fault]
    assert finding.is_warning
    assert str(finding).startswith("warn ")
    assert "same seed" in finding.requirement
    assert ["not checked, because" in str(result.fault) for result in not_checked] == [True] * 4
    assert not any(result.is_fault for result in not_checked)


def test_a_fit_that_changes_its_training_data_is_warned_and_changes_nothing_else(own_method) -> None:
    text = fitting("""
        train.tables["tx_position_m"][:] -= 1
        train.header.carrier_hz[:] = train.header.carrier_hz[0]
        train.grid.azimuth_rad[:] = 0
        yield from fit(train, budget, seed)""")
    (finding,) = [finding for finding in check_method(own_method(text)) if finding.fault]
    assert finding.is_warning
    assert "it changed tx_position_m, header.carrier_hz, grid.azimuth_rad" in finding.fault


def test_options_reach_the_method(own_method) -> None:
    name = own_method(predicting("return maps * np.float32(2 * self.config.level)"))
    assert not any(finding.fault for finding in check_method(name))
    faults = [finding.requirement for finding in check_method(name, ["level=0.25"]) if finding.is_fault]
    assert faults == ["every map has peak 1"]


def test_an_unknown_name_is_an_error_and_no_result(own_method) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'nearest'"):
        check_method("nearst")
    with pytest.raises(UnknownNameError, match="level"):
        check_method(own_method("", "Sound"), ["levle=1"])


def test_the_command_prints_every_rule_and_ends_with_code_2_where_one_is_broken(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(SOUND + HALVED)
    command = [command_line(), "check-method"]
    broken = subprocess.run([*command, "mine:Method"], capture_output=True, text=True, cwd=tmp_path)
    assert broken.returncode == 2
    assert "FAULT  every map has peak 1" in broken.stdout
    assert "breaks its contract in 1" in broken.stderr
    (tmp_path / "ends.py").write_text(SOUND + fitting("yield from fit(train, budget, seed)\n__import__('os')._exit(0)"))
    ended = subprocess.run([*command, "ends:Method"], capture_output=True, text=True, cwd=tmp_path)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "ended itself with exit status 0" in ended.stderr
    sound = subprocess.run([*command, "mine:Sound"], capture_output=True, text=True, cwd=tmp_path)
    assert sound.returncode == 0
    assert sound.stdout.count("ok  ") == 22
