"""What a user's rerun, budget or broken method does to results."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.stub_methods import run_job
from tests.support.synthetic import paper_dataset
from xfreqbench.data.dataset import PasDataset
from xfreqbench.runs.records import Job

METHOD = """
from dataclasses import dataclass, field
from pathlib import Path
import numpy as np
from xfreqbench.methods.contract import Progress

@dataclass(frozen=True)
class Config:
    folder: Path = Path("weights")

class Flat:
    num_parameters = 0
    def __init__(self, config=Config()):
        self.config = config
    def fit(self, train, budget, seed):
        assert not train.tables["cfr"][:, 4].any()  # 24.25 GHz is tested: none of it may be here
        yield Progress(1, 0.0)
    def predict(self, tx_position_m, carrier_hz):
        maps = np.full((len(carrier_hz), 90, 360), LEVEL, np.float32)
        maps[:, 0, 0] = 1
        return maps
    def save(self, directory): ...
    @classmethod
    def load(cls, directory): return cls()
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> PasDataset:
    return paper_dataset(tmp_path_factory.mktemp("data") / "data.h5", num_tx=5)


def own_method(folder: Path, name: str, text: str, monkeypatch: pytest.MonkeyPatch) -> str:
    (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
    return f"{name}:Flat"


def test_an_edited_method_is_run_again_and_sees_no_test_channel(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = []
    for name, level in (("flat_one", "0.25"), ("flat_two", "0.5")):
        method = own_method(tmp_path, name, METHOD.replace("LEVEL", level), monkeypatch)
        records.append(run_job(Job(str(dataset.path), method, "lofo", "lofo-24.25GHz"), tmp_path / "results"))
    assert records[0].id != records[1].id
    method_file = tmp_path / "flat_one.py"
    method_file.write_text(method_file.read_text().replace("0.25", "0.75"))
    job = Job(str(dataset.path), "flat_one:Flat", "lofo", "lofo-24.25GHz")
    assert run_job(job, tmp_path / "results").id != records[0].id
