"""Whether a large change of the code left every computed number as it was, byte for byte.

Before the change, store what the toolkit computes, and after it, store and compare:

    python tests/support/unchanged.py before
    python tests/support/unchanged.py after
    python tests/support/unchanged.py before after

With one folder it runs the command line in processes of its own, on one thread: both solvers on 48 office transmitters
at ten carriers, every installed method for 40 steps with seed 0, and BENCHMARK.md from the stored records, in some ten
minutes. The toolkit that is measured is the one that its Python imports. With two it prints a line for each thing, and
ends with code 1 where one differs.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import h5py

ROOT = Path(__file__).parents[2]
SOLVERS = ("image", "sionna")
ONE_THREAD = dict.fromkeys(["OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"], "1")
REPORT = f"report {ROOT}/baselines/reference_results.parquet -o BENCHMARK.md"


def store(folder: Path) -> None:
    """Compute everything into a new folder; `digests.json` holds a digest of each thing by name."""
    folder.mkdir(parents=True)
    traced = [f"generate office --tx 48 --solver {solver} -o {solver}.h5" for solver in SOLVERS]
    fitted = "run --data image.h5 --results results --method all --targets 24.25 --budget 40steps --seed 0"
    for line in (*traced, fitted, REPORT):
        command = [sys.executable, "-m", "xfreqbench.cli", *line.split(), "--quiet"]
        subprocess.run(command, cwd=folder, env={**os.environ, **ONE_THREAD}, check=True)
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in _computed(folder)}
    (folder / "digests.json").write_text(json.dumps(digests, indent=2, sort_keys=True), encoding="utf-8")


def compare(before: Path, after: Path) -> bool:
    """Print what is equal and what is not; whether everything is."""
    one, other = (json.loads((folder / "digests.json").read_text("utf-8")) for folder in (before, after))
    names = sorted(one.keys() | other.keys())
    differing = [name for name in names if one.get(name) != other.get(name)]
    for name in names:
        print(f"{'DIFFERS' if name in differing else 'same':8} {name}")
    print(f"{len(names) - len(differing)} of {len(names)} are the same")
    return not differing


def _computed(folder: Path) -> Iterator[tuple[str, bytes]]:
    for solver in SOLVERS:
        with h5py.File(folder / f"{solver}.h5") as file:
            for name, variable in file.items():
                yield f"{solver}: {name}", variable[...].tobytes()
    for record in map(json.loads, (folder / "results" / "records.jsonl").read_text("utf-8").splitlines()):
        with h5py.File(folder / "results" / "predictions" / f"{record['id']}.h5") as file:
            yield f"prediction of {record['job']['method']}", file["pas"][...].tobytes()
    # the numbers of all tables, so that wording between them may change and no number can
    rows = re.findall(r"^\|.*\|$", (folder / "BENCHMARK.md").read_text("utf-8"), re.MULTILINE)
    numbers = ["|".join(re.findall(r"(?<![\w.-])-?\d[\d.,]*", row)) for row in rows]
    yield "BENCHMARK.md", "\n".join(numbers).encode()


if __name__ == "__main__":
    folders = [Path(word) for word in sys.argv[1:]]
    if len(folders) == 2:
        sys.exit(not compare(*folders))
    (folder,) = folders
    store(folder)
