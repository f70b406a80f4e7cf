"""Data sets are compared with the fingerprint of their recipe, whoever traced them, on whatever machine."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.fuzzing.common import xfreqbench
from tests.support.places import fingerprint_path
from tests.support.plans import rewritten, wall_moved
from xfreqbench.bench.fingerprints import NUM_TRANSMITTERS, make_fingerprint
from xfreqbench.data.dataset import PasDataset, open_dataset
from xfreqbench.data.fingerprint import (
    MIN_TRANSMITTERS,
    TOLERANCE,
    compare_fingerprint,
    field_differences,
    read_fingerprint,
    require_fingerprint,
)
from xfreqbench.data.generate import generate
from xfreqbench.errors import DataError, OutputExistsError
from xfreqbench.scene.model import Scene, load_scene
from xfreqbench.scene.toml_files import shipped_scenes
from xfreqbench.tracing.solvers import tracer_of
from xfreqbench.tracing.tracer import WITHOUT_DIFFRACTION, TraceSettings
from xfreqbench.types import ignore_progress
from xfreqbench.units import PAPER_CARRIERS_GHZ

ROOMS = load_scene("two_rooms")
CARRIERS_GHZ = [1.0, 10.0, 94.0]
TRANSMITTERS_M = read_fingerprint(fingerprint_path("two_rooms")).tx_position_m[: MIN_TRANSMITTERS + 1]


def rooms(path: Path, scene: Scene = ROOMS, **changes: Any) -> PasDataset:
    asked = {"tx_positions": TRANSMITTERS_M, "maps": False, **changes}
    return generate(scene, path, CARRIERS_GHZ, **asked)


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return rooms(tmp_path_factory.mktemp("usual") / "rooms.h5")


def apart(one: PasDataset, other: PasDataset) -> float:
    """The greatest relative field error of any transmitter at any carrier."""
    off, length = (
        np.linalg.norm(vector, axis=2) for vector in (one.tables["cfr"] - other.tables["cfr"], other.tables["cfr"])
    )
    return float((off / length).max())


QUICK = {"corridor", "empty", "office", "two_rooms"}  # the others take ten seconds each


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in shipped_scenes()]
)
def test_the_channels_of_today_are_those_of_the_fingerprint(name: str) -> None:
    """Where this fails by more than digits, `PHYSICS_VERSION` has to be raised, and the fingerprints made anew."""
    scene = load_scene(name)
    for diffraction, interactions in ((False, WITHOUT_DIFFRACTION), (True, None)):
        path = fingerprint_path(name, diffraction=diffraction)
        known = read_fingerprint(path)
        assert known.cfr.shape == (NUM_TRANSMITTERS, len(PAPER_CARRIERS_GHZ), 16)
        assert path.stat().st_size < 1e6
        tracer = tracer_of(scene, known.carrier_hz.tolist(), TraceSettings(interactions=interactions))
        cfr = tracer.channel(known.tx_position_m[::16]).cfr
        assert field_differences(cfr, known.cfr[::16]).max() < 1e-4  # complex64 has 6e-8; rays at edges may differ


def test_a_traced_file_has_the_recipe_of_the_fingerprint(usual: PasDataset) -> None:
    match = require_fingerprint(usual)
    assert (match.num_tx, match.num_carriers) == (len(TRANSMITTERS_M), len(CARRIERS_GHZ))
    assert match.difference is not None
    assert match.difference < TOLERANCE
    assert re.search(r"^fingerprint of two_rooms@3-\w+: matches the reference, ", match.verdict)
    assert replace(match, difference=1e-3).difference_db == pytest.approx(-60)
    assert replace(match, difference=0.0).difference_db == -np.inf


@pytest.mark.slow
def test_without_a_compiler_or_with_one_thread_only_digits_change(tmp_path: Path) -> None:
    """Kernels that Python runs itself have no instructions of a processor, and no sums in another order."""
    np.savetxt(tmp_path / "tx.csv", TRANSMITTERS_M, fmt="%.17g", delimiter=",")
    words = "generate two_rooms --tx-positions tx.csv --freqs 1,10,94 --rays 2000 --max-depth 3 --no-maps -o rooms.h5"
    words += " --interactions specular,refraction"  # diffraction leaves out what is below a threshold: 1e-5
    command, alone = [sys.executable, "-m", "xfreqbench.cli", *words.split()], {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, cwd=tmp_path, env=os.environ | alone, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "fingerprint of two_rooms@3-" in done.stdout
    usual = rooms(tmp_path / "usual.h5", rays=2000, max_depth=3, interactions=WITHOUT_DIFFRACTION)
    other = open_dataset(tmp_path / "rooms.h5")
    assert other.recipe == usual.recipe
    assert apart(other, usual) < 1e-6  # stored in complex64


@pytest.mark.sionna
def test_where_no_path_can_be_missed_the_solvers_differ_by_digits(tmp_path: Path) -> None:
    known = read_fingerprint(fingerprint_path("empty"))
    asked = {"tx_positions": known.tx_position_m[:MIN_TRANSMITTERS], "interactions": WITHOUT_DIFFRACTION}
    of_image, of_sionna = (
        rooms(tmp_path / f"{solver}.h5", load_scene("empty"), solver=solver, **asked) for solver in ("image", "sionna")
    )
    assert of_image.recipe == of_sionna.recipe
    assert apart(of_sionna, of_image) < 1e-5  # Sionna RT has 32 bits: measured 3e-7
    require_fingerprint(of_sionna)


@pytest.mark.slow
@pytest.mark.sionna
def test_in_the_office_the_other_solver_shares_the_recipe_and_is_as_far_off_as_documented(tmp_path: Path) -> None:
    """0.012 at 2.4 GHz, more than solver `image` is allowed: its rays miss some of the weak paths."""
    known = read_fingerprint(fingerprint_path("office", diffraction=False))
    asked: Any = {"tx_positions": known.tx_position_m[:16], "solver": "sionna", "maps": False}
    of_sionna = generate(load_scene("office"), tmp_path / "sionna.h5", [2.4], **asked)
    assert of_sionna.recipe.physics_sha256 == known.physics_sha256
    match = require_fingerprint(of_sionna)
    assert match.difference is not None
    assert TOLERANCE < match.difference < 0.02


def test_a_wall_that_is_moved_by_a_millimetre_is_found_out(usual: PasDataset, tmp_path: Path) -> None:
    other = rooms(tmp_path / "moved.h5", wall_moved(ROOMS, 1e-3))
    assert other.recipe.physics_sha256 != usual.recipe.physics_sha256
    assert "ships no reference of this scene" in str(require_fingerprint(other))
    assert field_differences(other.tables["cfr"], usual.tables["cfr"]).max() > 1e-1  # as documented

    forged = rewritten(usual, tmp_path / "forged.h5", cfr=other.tables["cfr"])
    assert forged.recipe == usual.recipe
    with pytest.raises(DataError, match=r"says that it is two_rooms@3-.* a median relative field error of 2\.\de-01"):
        require_fingerprint(forged)
    told = xfreqbench("info", forged.path)
    assert told.code == 0
    assert ": differs from the reference, " in told.stdout and "run and score refuse more than 0.001" in told.stdout
    words = f"run --data {forged.path} --method nearest --protocol held-out-tx --results {tmp_path / 'results'}"
    refused = xfreqbench(*words.split())
    assert refused.code == 2
    assert "; 0.001 is allowed" in refused.message and "Generate them again" in refused.message


def test_at_every_carrier_the_wall_is_found_out_and_a_single_lost_path_is_none(
    usual: PasDataset, tmp_path: Path
) -> None:
    cfr = usual.tables["cfr"].copy()
    cfr[0] *= 1.01  # as one transmitter whose weak path was missed
    require_fingerprint(rewritten(usual, tmp_path / "missed.h5", cfr=cfr))
    cfr[1:, 0] *= 1.002
    with pytest.raises(DataError, match=r"at 1 GHz"):
        require_fingerprint(rewritten(usual, tmp_path / "louder.h5", cfr=cfr))


def test_what_has_little_in_common_is_not_compared_and_says_so(usual: PasDataset) -> None:
    few = {name: table[: MIN_TRANSMITTERS - 1] for name, table in usual.tables.items()}
    match = compare_fingerprint(replace(usual, tables=few))
    assert "nothing to compare with, as the data share 3 of the reference's 64 transmitters and 3" in match.verdict
    assert not match.is_off
    with pytest.raises(ValueError, match="64 transmitters"):
        _ = match.difference_db
    shallow = replace(usual.header, settings={**usual.header.settings, "max_depth": 5})
    assert "xfreqbench ships no reference of this scene" in str(compare_fingerprint(replace(usual, header=shallow)))


def test_silence_is_compared_too() -> None:
    silent, loud = np.zeros((1, 1, 2), complex), np.ones((1, 1, 2), complex)
    assert field_differences(silent, silent).tolist() == [0]
    assert field_differences(loud, silent).tolist() == [np.inf]
    assert field_differences(silent, loud).tolist() == [1]


def test_anyone_can_make_a_fingerprint_and_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "empty_fingerprint.npz"
    assert xfreqbench("bench", "fingerprint", "empty", "-o", path, "-q").code == 0
    made, shipped = read_fingerprint(path), read_fingerprint(fingerprint_path("empty"))
    assert made.physics_sha256 == shipped.physics_sha256
    np.testing.assert_array_equal(made.tx_position_m, shipped.tx_position_m)
    assert field_differences(made.cfr, shipped.cfr).max() < 1e-5
    before = path.read_bytes()
    assert "already holds this fingerprint" in xfreqbench("bench", "fingerprint", "empty", "-o", path).stdout
    with pytest.raises(OutputExistsError, match="of another scene"):
        make_fingerprint(ROOMS, path, ignore_progress)
    assert path.read_bytes() == before
    path.write_bytes(before[:1000])
    with pytest.raises(DataError, match="is damaged"):
        read_fingerprint(path)
