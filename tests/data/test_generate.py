from __future__ import annotations

import itertools
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.damage import flip
from tests.support.forked import command_line
from tests.support.plans import SETTINGS, plan_generation, small_plan
from xfreqbench.data.batches import batch_folder
from xfreqbench.data.dataset import open_dataset, verify
from xfreqbench.data.generate import generate_planned
from xfreqbench.errors import OutputExistsError, StorageError
from xfreqbench.scene.model import ReceiverArray, Scene, Surface


def test_a_data_set_holds_what_was_traced(tmp_path: Path) -> None:
    plan = small_plan()
    progress: list[tuple[int, int]] = []
    path = generate_planned(plan, tmp_path / "rooms.h5", lambda done, total: progress.append((done, total)))
    verify(path)
    dataset = open_dataset(path)
    assert len(dataset) == 80
    np.testing.assert_array_equal(dataset.tx_position_m[::2], plan.tx_position_m)
    assert dataset.pas([0, 5]).max(axis=(1, 2)) == pytest.approx(1)
    assert dataset.header.settings["solver"] == "image"
    assert (progress[0], progress[-1]) == ((0, 40), (40, 40))
    assert not list(tmp_path.glob("*.parts"))


def test_the_same_job_is_not_run_again_and_another_is_refused(tmp_path: Path) -> None:
    path = generate_planned(small_plan(), tmp_path / "rooms.h5")
    before = path.stat().st_mtime_ns
    generate_planned(small_plan(), path)
    assert path.stat().st_mtime_ns == before
    for other, words in (
        (small_plan(num_transmitters=30), "40 transmitters there, 30 here"),
        (small_plan(pas_kind="amplitude"), "pas_kind power there, amplitude here"),
        (small_plan(carriers_hz=[2.4e9]), "2 carriers there, 1 here"),
        (small_plan(carriers_hz=[2.4e9, 60e9]), r"other carriers \(2\)"),
    ):
        with pytest.raises(OutputExistsError, match=f"holds another data set: {words}. Choose"):
            generate_planned(other, path)
    assert path.stat().st_mtime_ns == before


def test_a_damaged_or_foreign_output_is_not_taken_for_the_job(tmp_path: Path) -> None:
    path = generate_planned(small_plan(num_transmitters=2), tmp_path / "rooms.h5")
    flip(path, path.stat().st_size // 2)
    content = path.read_bytes()
    with pytest.raises(OutputExistsError, match="delete this one"):
        generate_planned(small_plan(num_transmitters=2), path)
    assert path.read_bytes() == content
    with pytest.raises(StorageError, match="not a file"):
        generate_planned(small_plan(num_transmitters=2), tmp_path)


def generate_command(path: Path) -> list[str]:
    options = "--freqs 1,10 --tx 320 --rays 20000 --max-depth 3 --paths --interactions specular,refraction"
    return [command_line(), "generate", "two_rooms", *options.split(), "--quiet", "-o", str(path)]


@pytest.mark.slow
def test_a_generation_killed_at_random_moments_ends_in_the_same_bytes(tmp_path: Path) -> None:
    unbroken, broken = tmp_path / "unbroken.h5", tmp_path / "broken.h5"
    subprocess.run(generate_command(unbroken), check=True)
    chance = random.Random(0)
    num_kills = 0
    while not broken.exists():
        process = subprocess.Popen(generate_command(broken), stderr=subprocess.PIPE)
        if num_kills < 3:
            if num_kills < 2:
                wait_for_batches(process, broken, chance.randrange(6))
            else:
                wait_for_writing(process, broken)
            time.sleep(chance.uniform(0, 0.05))
            process.send_signal(signal.SIGKILL)
        process.communicate()
        num_kills += process.returncode == -signal.SIGKILL
        assert process.returncode in (0, -signal.SIGKILL)
    assert num_kills  # mostly three, one of them while the file is written
    assert broken.read_bytes() == unbroken.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.h5", "unbroken.h5"]


def wait_for_writing(process: subprocess.Popen[Any], path: Path) -> None:
    parts = f".{path.name}.*.partial"
    while process.poll() is None and not any(part.stat().st_size > 100_000 for part in path.parent.glob(parts)):
        time.sleep(0.002)


def test_ctrl_c_says_how_to_go_on(tmp_path: Path) -> None:
    path = tmp_path / "rooms.h5"
    process = subprocess.Popen(generate_command(path), stderr=subprocess.PIPE, text=True)
    wait_for_batches(process, path, 2)
    process.send_signal(signal.SIGINT)
    _, message = process.communicate()
    assert process.returncode == 130
    assert "the same command continues" in message
    assert "Traceback" not in message
    assert not path.exists()


def wait_for_batches(process: subprocess.Popen[Any], path: Path, count: int) -> None:
    def num_batches() -> int:
        return len(list(batch_folder(path).glob("*.npz")))

    start = num_batches()
    while process.poll() is None and num_batches() < start + count:
        time.sleep(0.002)


def test_a_full_disk_is_foreseen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    with pytest.raises(StorageError, match="1,000 free"):
        generate_planned(small_plan(), tmp_path / "rooms.h5")
    assert not list(tmp_path.glob("*"))


def test_a_disk_that_fills_up_keeps_the_batches_and_leaves_no_half_file(tmp_path: Path) -> None:
    program = """
import resource, sys
from xfreqbench.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))  # no file may grow beyond 2 MB
sys.argv[1:] = sys.argv[1].split()
main()
"""
    arguments = f"generate two_rooms --freqs 1 --tx 40 --rays 20000 --max-depth 2 -q -o {tmp_path}/rooms.h5"
    done = subprocess.run([sys.executable, "-c", program, arguments], capture_output=True, text=True)
    assert done.returncode == 2
    assert "cannot be written: File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["rooms.h5.parts"]
    subprocess.run([command_line(), *arguments.split()], check=True)
    verify(tmp_path / "rooms.h5")


def test_a_transmitter_without_any_path_is_kept_and_flagged(tmp_path: Path) -> None:
    low, high = np.array([-0.5, -0.5, 1.5]), np.array([0.5, 0.5, 2.5])
    walls = [  # six rectangles: a closed box around the receiver would be refused
        Surface(f"wall {n}", "metal", 0.01, tuple(np.where(flat, end, low)), tuple(np.where(flat, end, high)))
        for n, (flat, end) in enumerate(itertools.product(np.eye(3, dtype=bool), (low, high)))
    ]
    scene = Scene("cage", ReceiverArray(position_m=(0.0, 0.0, 2.0)), surface=tuple(walls))
    plan = plan_generation(scene, [5e9], SETTINGS, tx_positions=np.array([[3.0, 0.3, 1.0]]), paths=True)
    dataset = open_dataset(generate_planned(plan, tmp_path / "cage.h5"))
    assert len(dataset) == 1
    assert not dataset.has_path.any() and not dataset.pas().any()
    assert np.isfinite(dataset.cfr).all()
    paths = dataset.paths(0)
    assert (len(paths), paths.interactions.shape, paths.arrival.shape) == (0, (0, 0), (0, 3))
