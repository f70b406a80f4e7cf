"""Calls as somebody would try them: each gives an answer, or an error that says what was wrong with it.

They are made in an interpreter of their own, because under pytest a type checker would answer first.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.synthetic import write_dataset
from xfreqbench.errors import ArgumentError, XFreqBenchError

ANSWERED = {  # call: what is asked of its answer
    "iter(data)": "next(answer).map.shape == (90, 360)",
    "data.pas(0)": "answer.shape == (1, 90, 360)",
    "data.pas(np.int64(-1))": "(answer[0] == data[-1].map).all()",
    "data[[True] + [False] * 11]": "len(answer) == 1",
    "tracer.paths([2, 1, 1])": "len(answer.delay_s) > 0",
    "tracer.paths([[2, 1, 1]])": "len(answer.delay_s) > 0",
    "tracer.channel([2, 1, 1])": "answer.cfr.shape == (1, 1, 16)",
    "tracer.channel([[2, 1, 1], [3, 2, 1]])": "answer.cfr.shape == (2, 1, 16)",
    "xb.make_tracer(scene, 24.25)": "answer.channel([2, 1, 1]).cfr.shape == (1, 1, 16)",
    "xb.make_tracer(scene, np.array([1, 2]))": "answer.channel([2, 1, 1]).cfr.shape == (1, 2, 16)",
    "xb.make_splits(data, 'lofo', 10)": "len(answer) == 1",
    "xb.make_splits(data, 'lofo', np.array([10.0]))": "len(answer) == 1",
    "xb.generate(scene, 'one.h5', 2.4, tx=2)": "len(answer) == 2",
    "xb.generate('empty', 'two.h5', ['2.4'], tx='2', executor=1)": "len(answer) == 2",
    "xb.generate('empty', 'three.h5', [2.4], tx_positions=[[2, 1, 1]])": "len(answer) == 1",
    "xb.generate('empty', 'four.h5', np.array([2.4]), tx_positions=[2, 1, 1])": "len(answer) == 1",
    "xb.run(data, 'nearest', targets_ghz=10, seeds=3, budget='1steps')": "answer[0].job.seed == 3",
    "xb.leaderboard(xb.run(data, ['nearest'], targets_ghz='all'))": "'nearest' in str(answer)",
    "xb.metrics.ssim(maps.tolist(), maps, data.grid)": "(answer == 1).all()",
    "xb.score(data.pas(split.test).tolist(), split, data)['ssim']": "(answer == 1).all()",
    "xb.run(data, Mine, targets_ghz=10)": "answer[0].job.method == '__main__:Mine' and len(repr(answer)) < 200",
    "xb.run(data, {Nearest: {}}, targets_ghz=10)": "answer[0].job.method == 'nearest'",
    "repr(split)": "answer == \"<Split 'lofo-10GHz': 8 samples to train on, 4 to test on>\"",
    "xb.plot(data, np.int64(-1))": "len(answer.axes) == 2",
    "xb.to_xarray(data[3:]).sel(sample=4).pas": "(answer == data.pas(4)[0]).all() and answer.tx == data.tx_index[4]",
    "xb.to_xarray(bare).pas": "np.allclose(answer, data.pas(), atol=1e-4) and answer.units == '1'",
    "xb.to_xarray(data).tx_position_m": "answer.units == 'm' and answer.dims == ('sample', 'axis')",
    "beam.maps(data.cfr[:2].tolist())": "answer[0].shape == (2, 90, 360)",
    "xb.AngularGrid([0, 1], [0, 1, 2]).directions": "answer.shape == (2, 3, 3)",
}
REFUSED = {  # call: what the error says
    "tracer.paths([2, 1])": "positions are finite numbers in metres, of shape (3,)",
    "tracer.channel([])": "of shape (T, 3)",
    "tracer.channel([[2, 1, float('nan')]])": "finite",
    "xb.make_tracer('empty', [24.25])": "scene='empty': Input should be an instance of Scene",
    "xb.make_tracer(scene, [24.25e9])": "Was that hertz?",
    "xb.make_tracer(scene, [])": "freqs_ghz=[]: Value should have at least 1 item",
    "xb.make_tracer(scene, [1], xb.TraceSettings(solver='imag'))": "Did you mean 'image'",
    "xb.generate('empty', 'x.h5', [2.4], interactions=['reflection'])": "Did you mean 'specular'?",
    "xb.load_scene(3)": "name_or_path=3",
    "xb.load_scene(Path('x.toml'))": "cannot be read",
    "xb.parse_scene(Path('x.toml'))": "Input should be a valid string",
    "xb.open_dataset(None)": "path=None: Input should be the path of a file or folder",
    "xb.open_dataset(data)": "the path of a file",
    "xb.generate('empty')": "generate needs output. It takes scene, output, freqs_ghz",
    "xb.generate('empty', [2.4], 'x.h5')": "output=[2.4]: Input should be the path",
    "xb.generate('empty', 'x.h5', 'paper')": "'paper' in freqs_ghz",
    "xb.generate('empty', 'x.h5', [2.4], 8)": "generate takes tx only by its name: write tx=8",
    "xb.generate('empty', 'x.h5', [2.4], tx=2.5)": "a valid integer",
    "xb.generate('empty', 'x.h5', [2.4], num_transmitters=8)": "takes no 'num_transmitters'. It takes scene, ",
    "xb.generate('empty', 'x.h5', [2.4], tx_positions=[1, 2])": "finite numbers in metres",
    "xb.generate('empty', 'x.h5', [2.4], solver='imag')": "'auto', 'image' or 'sionna'",
    "xb.make_splits(data)": "make_splits needs protocol",
    "xb.make_splits('data.h5', 'lofo')": "an instance of PasDataset",
    "xb.run(None, 'nearest')": "data=None",
    "xb.run(data)": "run needs methods",
    "xb.run(data, 3)": "3 in methods",
    "xb.run(data, 'nearest', targets_ghz=10e9)": "Was that hertz? Then it is 10 GHz",
    "xb.run(data, xb.Budget, targets_ghz=10)": "contract:Budget' lacks fit, predict, save, load",
    "xb.run(data, type('Lost', (), {}))": "Define it at the top level of a module",
    "xb.run(data, Mine, targets_ghz=10, executor=2)": "Put the class into a module",
    "xb.run(data, method='nearest')": "run takes no 'method'. Did you mean methods?",
    "xb.run(data, 'nearest', seed=1)": "run takes no 'seed'. Did you mean seeds?",
    "xb.generate('empty', 'x.h5', freqs=[2.4])": "generate takes no 'freqs'. Did you mean freqs_ghz?",
    "xb.run(data, 'nearest', on='valid')": "'test' or 'validation'",
    "xb.run(data, 'nearest', targets_ghz=10, on='validation')": "so it needs 3 of them or more",
    "xb.run(data, 'nearest', seeds=[-1])": "-1 in seeds: Input should be greater than or equal to 0",
    "xb.run(data, 'nearest', seeds=[])": "at least 1 item",
    "xb.run(data, 'nearest', budget=10)": "or is one of quick, minutes, converged, but 10 was given",
    "xb.run(data, 'nearest', device='gpu')": "'cpu' or 'cuda'",
    "xb.score(maps, None, data)": "split=None",
    "xb.score([[1], []], split, data)": "one array of numbers (N, E, A)",
    "xb.score([[1]], split, data)": "numbers of shape",
    "xb.load_method(None, 'x')": "results=None",
    "xb.load_method('nowhere', 3)": "run=3",
    "xb.load_method('nowhere', 'x')": "has no run 'x'",
    "xb.permittivity('concrete', 2.4e9)": "Was that hertz? Then it is 2.4 GHz",
    "xb.permittivity('concret', 2.4)": "Did you mean 'concrete'",
    "xb.read_records(None)": "results=None",
    "xb.leaderboard([])": "none are given",
    "xb.leaderboard(3)": "results=3",
    "xb.check_method(3)": "method=3: Input should be a valid string",
    "xb.Budget('5m')": "'5m' in place of a budget",
    "xb.Budget(max_steps=0)": "a number above 0",
    "xb.metrics.ssim(maps[0], maps[0], data.grid)": "(N, 90, 360) on this grid, but predicted has shape (90, 360)",
    "xb.metrics.ssim(255 * maps, maps, data.grid)": "values from 0 to 1 and peak 1, but those of predicted run from",
    "xb.metrics.psnr(maps[:1], maps, data.grid)": "has shape (1, 90, 360) and truth (2, 90, 360)",
    "beam.maps(data.cfr[0])": "shape (B, 4) become maps, but these have shape (4,)",
    "beam.maps(data.cfr, 'Power')": "Did you mean 'power'",
    "xb.AngularGrid(1, [0])": "elevation_rad is a list of angles, but got 1",
    "data.paths('a')": "sample='a'",
    "data.paths(1)": "holds no paths",
}
INDEXED = (
    "data['pas']",
    "data[1.5]",
    "data[None]",
    "data.pas('a')",
    "xb.plot(data, 'a')",
    "data[xb]",
    "xb.to_torch(data)[99]",
)
PROGRAM = """
import json, sys
from pathlib import Path
import numpy as np
import xfreqbench as xb
from xfreqbench.baselines.nearest import Nearest

class Mine(Nearest):
    pass

bare = xb.open_dataset("bare.h5")  # stores no maps
data, scene = xb.open_dataset("data.h5"), xb.load_scene("empty")
tracer, maps = xb.make_tracer(scene, [24.25]), data.pas([0, 1])
(split,) = xb.make_splits(data, "lofo", [10])
beam = xb.BartlettBeam(data.header.receiver.element_position_wavelengths, data.grid)
told = {}
for call, asked in json.load(sys.stdin).items():
    try:
        answer = eval(call)
        told[call] = ["answer", bool(eval(asked))]
    except Exception as error:
        kinds = [kind.__name__ for kind in type(error).__mro__]
        told[call] = [kinds, str(error)]
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list]:
    """For each call, that it was answered and how, or the kinds of its error and what that says."""
    folder = tmp_path_factory.mktemp("calls")
    write_dataset(folder / "data.h5")
    write_dataset(folder / "bare.h5", maps=False)
    calls = {**ANSWERED, **dict.fromkeys((*REFUSED, *INDEXED), "True")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], input=json.dumps(calls), capture_output=True, text=True, cwd=folder
    )
    assert done.returncode == 0, done.stderr
    assert not {path.name for path in Path(folder).iterdir()} & {"x.h5", "x.h5.parts"}
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("call", ANSWERED)
def test_what_can_be_meant_is_answered(told: dict[str, list], call: str) -> None:
    assert told[call] == ["answer", True]


@pytest.mark.parametrize("call", REFUSED)
def test_what_cannot_be_used_is_told_in_a_line(told: dict[str, list], call: str) -> None:
    kinds, message = told[call]
    assert XFreqBenchError.__name__ in kinds
    assert REFUSED[call] in message
    assert "\n" not in message


@pytest.mark.parametrize("call", INDEXED)
def test_samples_that_cannot_be_chosen_are_index_errors(told: dict[str, list], call: str) -> None:
    kinds, message = told[call]
    assert "IndexError" in kinds
    assert "whole numbers" in message or "There are samples" in message


def test_an_error_about_an_argument_is_what_python_calls_one() -> None:
    assert issubclass(ArgumentError, TypeError)
