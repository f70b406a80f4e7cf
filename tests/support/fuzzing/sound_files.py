"""A small sound set of every kind of file that a command reads, made once by the commands themselves."""

from __future__ import annotations

import contextlib
import functools
import json
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from unittest import mock

import h5py
import numpy as np
import scipy.io

from tests.support.found_box import ALL_PLANES, SCENE
from tests.support.fuzzing.common import xfreqbench
from tests.support.fuzzing.png import write_png_folder
from tests.support.fuzzing.scenes import ASCII_PLY, REFERRING_SCENE, SMALL_SCENE, XML, toml_file
from xfreqbench.data.collection import room_of, write_collection
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.options import GenerateOptions
from xfreqbench.methods.fitting import Fit
from xfreqbench.runs import benchmark, checkpoints
from xfreqbench.runs.folder import ResultsFolder
from xfreqbench.runs.jobs import tasks_of
from xfreqbench.runs.options import RunOptions
from xfreqbench.runs.presets import PRESETS, Block, Preset, Setting
from xfreqbench.runs.records import Job
from xfreqbench.runs.run import run_jobs
from xfreqbench.system.workers import HERE

DATA, RECORDS, SPLIT = "data/room.toml.h5", "results/records.jsonl", "lofo-10GHz"
MAPS, FINGERPRINT = "results/records_maps.jsonl", "room_fingerprint.npz"
FITTED = ("num_gaussians=4", "width=4", "layers=2")
METHODS = (Setting("nearest"), Setting("aperture-gs", FITTED))
BLOCK = Block(scene="room.toml", settings=METHODS, budget="3steps", targets_ghz=(10.0,))
PRESET = Preset("a small one", (BLOCK,), "the rest")
_SLAB = {"share": 1.0, "permittivity": 5.0, "conductivity_s_m": 0.03, "conductivity_power": 0.8, "thickness_m": 0.2}
ROOM = {
    **SMALL_SCENE,
    "receiver": {**SMALL_SCENE["receiver"], "position_m": [2.1, 1.6, 2.3], "rows": 4, "cols": 4},
    "transmitters": {"min_m": [0.5, 0.5, 0.8], "max_m": [4.6, 3.5, 1.4], "step_m": [4.0, 3.0, 1.0]},
    "surface": [json.loads(json.dumps(asdict(surface))) for surface in SCENE.surface],
}


@contextlib.contextmanager
def small_benchmark() -> Iterator[None]:
    """`benchmark` knows a preset `fuzz` of two carriers, and runs it in this process."""
    with (
        mock.patch.dict(PRESETS, fuzz=PRESET),
        mock.patch.object(benchmark, "GenerateOptions", functools.partial(GenerateOptions, (1.0, 10.0))),
        mock.patch.object(benchmark, "run_workers", lambda *_: contextlib.nullcontext(HERE)),
    ):
        yield


@functools.cache
def sound_files() -> dict[str, bytes]:
    """The content of every file of the set, by its path in the folder in which the commands are given."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        folder = Path(name)
        _write_scenes()
        for line in (
            f"generate room.toml -o {DATA} --freqs 1,10 -q",
            "generate mesh.toml -o mesh.h5 --freqs 1,10 --solver image --tx 2 --paths -q",
            "export mesh.h5 -o scenarios --to deepmimo -q",
            f"bench fingerprint ./room.toml -o {FINGERPRINT} --interactions specular,refraction -q",
            f"split --data {DATA} -o split.h5 --targets 10 --maps -q",
            f"run --data {DATA} --results results --method nearest --targets 10 --budget 3steps -q",
            f"report results -o board.md --maps {MAPS} -q",
        ):
            outcome = xfreqbench(*line.split(), is_bounded=False)
            assert outcome.code == 0, outcome
        _collect(Path("rooms"))
        _tell_findings(ResultsFolder(Path("results")))
        _kill_a_fit()
        _write_predictions(Path("split.h5"), Path("theirs.h5"))
        write_png_folder(Path("maps"))
        _write_mats(Path("scenarios"), Path("mats"))
        found = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.suffix != ".lock")
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def _write_scenes() -> None:
    Path("data").mkdir()
    Path("room.toml").write_text(toml_file(ROOM), "utf-8")
    Path("mesh.toml").write_text(REFERRING_SCENE, "utf-8")
    Path("room.xml").write_text(XML, "utf-8")
    Path("wall.ply").write_text(ASCII_PLY, "utf-8")
    rows = (f"{0.7 + 0.05 * n},{1.1 + n % 3},1.2,{-40 - n % 7}" for n in range(40))
    Path("measured.csv").write_text("\n".join(["x,y,z,power", *rows]), "utf-8")


def _collect(folder: Path) -> None:
    """A collection of the data set alone."""
    folder.mkdir()
    shutil.copy(DATA, folder / "one.h5")
    rooms = [room_of(folder, "one.h5", 1, "office")]
    write_collection(folder, rooms, name="rooms", family={}, options={}, carrier_hz=(1e9, 10e9))


def _tell_findings(folder: ResultsFolder) -> None:
    """A second record that has the findings of a search, and the predictions of the first."""
    (record,) = folder.records
    planes = [{**plane, "slabs": [_SLAB]} for plane in ALL_PLANES["planes"]]
    images = [{"planes": [0], "power": 0.5}, {"planes": [2, 3], "power": 0.1}]
    told = {
        "id": "f" * 16,
        "job": Job(DATA, "virtual-source", "lofo", SPLIT),
        "findings": {**ALL_PLANES, "planes": planes, "images": images},
    }
    content = folder.predictions_path(record.id).read_bytes()
    folder.predictions_path(told["id"]).write_bytes(content)
    folder.append(record.model_copy(update=told))


def _kill_a_fit() -> None:
    """Leave the checkpoint of a fit that was interrupted at its second step of three."""

    def kill(job: Job, fit: Fit) -> None:
        if fit.step == 2:
            raise KeyboardInterrupt

    asked = RunOptions("lofo", targets_ghz=[10.0], budget="3steps")
    tasks = tasks_of(DATA, open_dataset(DATA), [("aperture-gs", FITTED)], asked)
    with mock.patch.object(checkpoints, "CHECKPOINT_SECONDS", 0.0), contextlib.suppress(KeyboardInterrupt):
        run_jobs(tasks, Path("results"), fitting=kill)


def _write_predictions(split: Path, path: Path) -> None:
    """Predictions as somebody else would write them: the attributes of the split file, coordinates, maps of ones."""
    with h5py.File(split, "r") as known, h5py.File(path, "w", libver="latest") as file:
        group = file.create_group(SPLIT)
        group.attrs.update(known[SPLIT].attrs)
        group.attrs["method"] = "mine"
        group["pas"] = np.ones((len(known[f"{SPLIT}/test_row"]), 90, 360), "f4")
        for name in ("test_row", "test_tx_position_m", "azimuth_deg"):
            group[name] = known[f"{SPLIT}/{name}"][...]


def _write_mats(scenarios: Path, folder: Path) -> None:
    """The scenarios with their arrays in files of MATLAB, with sums."""
    shutil.copytree(scenarios, folder)
    for path in folder.glob("*/*_t000_*.npz"):
        with np.load(path) as stored:
            scipy.io.savemat(path.with_suffix(".mat"), dict(stored), do_compression=True)
        path.unlink()
