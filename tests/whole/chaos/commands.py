"""The commands that are disturbed, and the small data that they work on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.hdf5 import Variable, create_sealed
from xfreqbench.data.splits import make_splits

_TRACE = "--rays 20000 --max-depth 3 -q"
_LOFO = "--data inputs/data.h5 --protocol lofo --targets 24.25"


@dataclass(frozen=True)
class Command:
    """A command line, given in a folder that has `inputs`; it writes nothing but the paths in `outputs`.

    `rival` writes something else to the same place.
    """

    name: str
    line: str
    outputs: tuple[str, ...]
    rival: str

    @property
    def words(self) -> list[str]:
        """The words of the command line."""
        return self.line.split()


def _run(methods: str) -> str:
    return f"run {_LOFO} --method {methods} --budget 6steps -q --results results"


COMMANDS = (
    Command(
        "generate, image",
        f"generate two_rooms --solver image --freqs 1,24.25 --tx 80 {_TRACE} -o out.h5",
        ("out.h5",),
        f"generate two_rooms --solver image --freqs 2.4,60 --tx 80 {_TRACE} -o out.h5",
    ),
    Command("run", _run("nearest,aperture-gs"), ("results",), _run("mean-over-frequency")),
    Command(
        "report",
        "report inputs/results -o board.md --html board.html -q",
        ("board.md", "board.html", "figures"),
        "report inputs/fewer -o board.md --html board.html -q",
    ),
    Command(
        "import",
        "import inputs/maps -o out.h5 --convention xfreq-gs --set plane=xy -q",
        ("out.h5",),
        "import inputs/maps -o out.h5 --convention xfreq-gs --set plane=xy --set rows=ascending -q",
    ),
    Command(
        "export",
        "export inputs/small.h5 -o out --convention xfreq-gs --set plane=xy -q",
        ("out",),
        "export inputs/small.h5 -o out --convention wrf-gs --set plane=xy -q",
    ),
    Command(
        "score",
        "score inputs/predictions.h5 --data inputs/data.h5 --results results -q",
        ("results",),
        "score inputs/predictions.h5 --data inputs/data.h5 --results results --method other -q",
    ),
    Command("view", "view inputs/small.h5 -o seen -q", ("seen",), "view inputs/data.h5 -o seen -q"),
    Command(
        "findings",
        "findings inputs/results --data inputs/data.h5 -o found -q",
        ("found",),
        "view inputs/small.h5 -o found -q",
    ),
)


def prepare(folder: Path, give: Callable[[str], None]) -> None:
    """Make `folder/inputs`; `give` gives a command line in `folder`, and raises where it fails."""
    (folder / "inputs").mkdir(parents=True)
    generated = "--freqs 2.4,24.25,77 --solver image"
    give(f"generate two_rooms {generated} --tx 40 {_TRACE} -o inputs/data.h5")
    give(f"generate two_rooms {generated} --tx 4 {_TRACE} -o inputs/small.h5")
    give("export inputs/small.h5 -o inputs/maps --convention xfreq-gs --set plane=xy -q")
    run = f"run {_LOFO} --budget 3steps -q"
    give(f"{run} --method mean-over-frequency --results inputs/fewer")
    give(f"{run} --method nearest --results inputs/results")
    give(f"{run} --method virtual-source --set render=learned --results inputs/results")
    _write_predictions(folder / "inputs" / "data.h5", folder / "inputs" / "predictions.h5")


def _write_predictions(data: Path, path: Path) -> None:
    """Predictions of one split as other programs hand them in: noise, for nobody looks at its scores."""
    dataset = open_dataset(data)
    (split,) = make_splits(dataset, "lofo", [24.25])
    shape = (len(split.test), *dataset.grid.shape)
    maps = np.random.default_rng(0).random(shape, np.float32)
    told = {"split_sha256": split.sha256, "method": "noise"}
    pas = Variable(f"{split.name}/pas", "<f4", shape, (), "1", "predicted map")
    with create_sealed(path, [pas], {}, {split.name: told}) as writer:
        writer.append(pas.name, maps / maps.max(axis=(1, 2), keepdims=True))
