"""The commands that are disturbed, the small data that they work on, and a command line that does wrong."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.support.prediction_files import hand_out, write_predictions
from xfreqbench.cli.main import main
from xfreqbench.data.dataset import open_dataset

_TRACE = "generate two_rooms --solver image --rays 20000 --max-depth 3 -q"
_LOFO = "run --data inputs/data.h5 --protocol lofo --targets 24.25 -q --budget"


@dataclass(frozen=True)
class Command:
    """A command line, given in a folder that has `inputs`; it writes nothing but `output` and `others`.

    `rival` writes something else to the same place.
    """

    line: str
    output: str
    rival: str
    others: tuple[str, ...] = ()


_IMPORT = "import inputs/maps -o out.h5 --convention xfreq-gs --set plane=xy -q"
_SCORE = "score inputs/predictions.h5 --data inputs/data.h5 --results results -q"
COMMANDS = {
    "generate": Command(
        f"{_TRACE} --freqs 1,24.25 --tx 80 -o out.h5", "out.h5", f"{_TRACE} --freqs 2.4,60 --tx 80 -o out.h5"
    ),
    "run": Command(
        f"{_LOFO} 6steps --method nearest,aperture-gs --results results",
        "results",
        f"{_LOFO} 6steps --method mean-over-frequency --results results",
    ),
    "report": Command(
        "report inputs/results -o board.md --html board.html -q",
        "board.md",
        "report inputs/fewer -o board.md --html board.html -q",
        ("board.html", "figures"),
    ),
    "import": Command(_IMPORT, "out.h5", f"{_IMPORT} --set rows=ascending"),
    "export": Command(
        "export inputs/small.h5 -o out --convention xfreq-gs --set plane=xy -q",
        "out",
        "export inputs/small.h5 -o out --convention wrf-gs --set plane=xy -q",
    ),
    "score": Command(_SCORE, "results", f"{_SCORE} --method other"),
    "view": Command("view inputs/small.h5 -o seen -q", "seen", "view inputs/data.h5 -o seen -q"),
    "findings": Command(
        "findings inputs/results --data inputs/data.h5 -o found -q", "found", "view inputs/small.h5 -o found -q"
    ),
}


def prepare(folder: Path, give: Callable[[str], None]) -> None:
    """Make `folder/inputs`; `give` gives a command line in `folder`, and raises where it fails."""
    (folder / "inputs").mkdir(parents=True)
    for name, num_tx in (("data", 20), ("small", 4)):
        give(f"{_TRACE} --freqs 2.4,24.25,77 --tx {num_tx} -o inputs/{name}.h5")
    give("export inputs/small.h5 -o inputs/maps --convention xfreq-gs --set plane=xy -q")
    give(f"{_LOFO} 3steps --method mean-over-frequency --results inputs/fewer")
    give(f"{_LOFO} 3steps --method nearest --results inputs/results")
    give(f"{_LOFO} 3steps --method virtual-source --set render=learned --results inputs/results")
    split = hand_out(open_dataset(folder / "inputs" / "data.h5"), folder.with_name("split.h5"), targets=[24.25])
    write_predictions(folder / "inputs" / "predictions.h5", split, method="noise")


def do_wrong(how: str) -> None:
    """The command, and something that it must not do."""
    with suppress(SystemExit):
        main()
    if how == "elsewhere":
        Path("../outside/thesis.tex").write_text("gone", encoding="utf-8")
    elif how == "others":
        Path("out.h5").write_bytes(Path("inputs/data.h5").read_bytes())
    elif how == "traceback":
        raise RuntimeError("nobody's words")
    else:
        Path("rest.tmp").touch()
