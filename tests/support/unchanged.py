"""Whether a large change of the code left every computed number as it was, byte for byte.

Before the change, store what the toolkit computes, and after it, store and compare:

    python tests/support/unchanged.py store before
    python tests/support/unchanged.py store after
    python tests/support/unchanged.py compare before after

`store` runs the command line in processes of its own, on one thread: both solvers on 48 office transmitters at
ten carriers, every installed method for 40 steps with seed 0, and BENCHMARK.md from the stored records. It
takes some ten minutes. It uses the command line alone, so that it runs before and after modules have moved;
the toolkit that is measured is the one that its Python imports. `compare` prints a line for each thing and ends
with code 1 where one differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py

ROOT = Path(__file__).parents[2]
SOLVERS = ("image", "sionna")
NUM_TRANSMITTERS = 48
NUM_STEPS = 40
TARGET_GHZ = 24.25
ONE_THREAD = dict.fromkeys(["OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"], "1")
PROGRAM = """try:
    from xfreqbench.cli.main import main
except ImportError:  # as it was before the command line was a folder
    from xfreqbench.cli import main
main()"""


def store(folder: Path) -> None:
    """Compute everything into a new folder; `digests.json` holds a digest of each thing by name."""
    folder.mkdir(parents=True)
    for solver in SOLVERS:
        options = ["--tx", str(NUM_TRANSMITTERS), "--solver", solver]
        _xfreqbench("generate", "office", *options, "-o", str(folder / f"{solver}.h5"))
    options = ["--method", "all", "--targets", str(TARGET_GHZ), "--budget", f"{NUM_STEPS}steps", "--seed", "0"]
    _xfreqbench("run", "--data", str(folder / "image.h5"), "--results", str(folder / "results"), *options)
    _xfreqbench("report", str(ROOT / "baselines" / "reference_results.jsonl"), "-o", str(folder / "BENCHMARK.md"))
    digests = {**_data_digests(folder), **_prediction_digests(folder), **_report_digests(folder)}
    (folder / "digests.json").write_text(json.dumps(digests, indent=2, sort_keys=True), encoding="utf-8")


def compare(before: Path, after: Path) -> bool:
    """Print what is equal and what is not; whether everything is."""
    stored = [json.loads((folder / "digests.json").read_text("utf-8")) for folder in (before, after)]
    names = sorted(stored[0].keys() | stored[1].keys())
    differing = [name for name in names if stored[0].get(name) != stored[1].get(name)]
    for name in names:
        print(f"{'DIFFERS' if name in differing else 'same':8} {name}")
    print(f"{len(names) - len(differing)} of {len(names)} are the same")
    return not differing


def _xfreqbench(*arguments: str) -> None:
    subprocess.run([sys.executable, "-c", PROGRAM, *arguments, "--quiet"], env={**os.environ, **ONE_THREAD}, check=True)


def _data_digests(folder: Path) -> dict[str, str]:
    return {
        f"{solver}: {name}": digest
        for solver in SOLVERS
        for name, digest in _variable_digests(folder / f"{solver}.h5").items()
    }


def _prediction_digests(folder: Path) -> dict[str, str]:
    lines = (folder / "results" / "records.jsonl").read_text("utf-8").splitlines()
    names = {record["id"]: record["job"]["method"] for record in map(json.loads, lines)}
    return {
        f"prediction of {name}": _variable_digests(folder / "results" / "predictions" / f"{job}.h5")["pas"]
        for job, name in names.items()
    }


def _variable_digests(path: Path) -> dict[str, str]:
    with h5py.File(path) as file:
        return {name: hashlib.sha256(variable[...].tobytes()).hexdigest() for name, variable in file.items()}


def _report_digests(folder: Path) -> dict[str, str]:
    """One digest a table row, so that wording between the tables may change and no number can."""
    rows = re.findall(r"^\|.*\|$", (folder / "BENCHMARK.md").read_text("utf-8"), re.MULTILINE)
    numbers = ["|".join(re.findall(r"(?<![\w.-])-?\d[\d.,]*", row)) for row in rows]
    return {"BENCHMARK.md: numbers of all tables": hashlib.sha256("\n".join(numbers).encode()).hexdigest()}


def main() -> int:
    """Run one of the two commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("store").add_argument("folder", type=Path)
    for_two = commands.add_parser("compare")
    for_two.add_argument("before", type=Path)
    for_two.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.command == "store":
        store(given.folder)
        return 0
    return 0 if compare(given.before, given.after) else 1


if __name__ == "__main__":
    sys.exit(main())
