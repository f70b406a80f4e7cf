"""Two people on two machines: their data differ in the last digits, and their results make one board."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tests.support.fuzzing.common import xfreqbench
from tests.support.places import fingerprint_path
from tests.support.plans import rewritten
from xfreqbench.data.dataset import open_dataset
from xfreqbench.data.fingerprint import read_fingerprint
from xfreqbench.runs.records import append, read

NUM_TRANSMITTERS = 10
FITS = (
    "--method aperture-gs --set num_gaussians=4 --set width=4 --set layers=2 --protocol held-out-tx --budget 2steps -q",
    "--method nearest --protocol held-out-tx -q",
)
THEIR_MACHINE = {"processor": "RISC-V of the other town", "cores": "64", "system": "Linux riscv64"}


def moved_to_their_machine(results: Path) -> None:
    """Results as that machine would have stored them, a day later: its name in every record, with a hash made anew."""
    path = results / "records.jsonl"
    told = {"hardware": THEIR_MACHINE, "time_utc": "2999-01-01T00:00:00+00:00"}
    records = [record.model_copy(update=told) for record in read(path).records]
    path.unlink()
    for record in records:
        append(path, record)


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
def test_results_of_two_machines_make_one_board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    places = read_fingerprint(fingerprint_path("two_rooms")).tx_position_m[:NUM_TRANSMITTERS]
    np.savetxt("tx.csv", places, fmt="%.17g", delimiter=",")
    traced = xfreqbench(
        *["generate", "two_rooms", "--tx-positions", "tx.csv", "--freqs", "1,10,94", "-o", "ours.h5"], is_bounded=False
    )
    assert traced.code == 0, traced.message
    assert f"({NUM_TRANSMITTERS} transmitters × 3 carriers in common)" in traced.stdout
    ours = open_dataset("ours.h5")
    last_digits = (ours.tables["cfr"] * (1 + 1e-6)).astype(np.complex64)  # as another compiler may round
    theirs = rewritten(ours, Path("theirs.h5"), cfr=last_digits)
    assert ours.sha256 != theirs.sha256
    assert ours.recipe == theirs.recipe

    for name, fit in product(("ours", "theirs"), FITS):
        done = xfreqbench(*f"run --data {name}.h5 --results {name} {fit}".split(), is_bounded=False)
        assert done.code == 0, done.message
    moved_to_their_machine(Path("theirs"))
    done = xfreqbench(*["report", "ours", "theirs", "-o", "board.md", "--html", "board.html", "-q"], is_bounded=False)
    assert done.code == 0, done.message

    board = Path("board.md").read_text("utf-8")
    assert board.count("## two_rooms · held-out-tx") == 1
    assert f"Data set `{ours.recipe.name}`" in board
    rows = {
        cells[2].strip(): cells
        for cells in (line.split("|") for line in board.splitlines() if line.startswith("| "))
        if len(cells) > 10
    }
    (of_ours,) = (cells for label, cells in rows.items() if label.endswith(f"(data {ours.sha256[:7]})"))
    (of_theirs,) = (cells for label, cells in rows.items() if label.endswith(f"(data {theirs.sha256[:7]})"))
    assert (rows["nearest"][4].strip(), of_ours[4].strip(), of_theirs[4].strip()) == ("m1", "m1", "m2")
    assert of_ours[5] == of_theirs[5]  # the scores, to the fourth decimal
    place = f"RISC-V of the other town, 64 cores, Linux riscv64, data {theirs.sha256[:8]}, from theirs: m2 (commit"
    assert place in board
    page = Path("board.html").read_text("utf-8")
    assert "RISC-V of the other town" in page
    assert "No pictures" not in page  # those of ours and theirs are drawn from either data set
