"""What a user's rerun, budget or broken method does to results."""

from __future__ import annotations

from pathlib import Path

import pytest
from leaderboard_records import leaderboard_markdown
from stored_records import make_record
from stub_methods import run_job, run_jobs
from synthetic import paper_dataset

from xfreqbench.data.dataset import PasDataset
from xfreqbench.errors import MethodError, StorageError
from xfreqbench.methods.contract import Budget
from xfreqbench.methods.trivial import NEEDED_TRIVIAL
from xfreqbench.report.leaderboard.boards import boards
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


def test_a_method_that_fails_is_named_with_what_it_raised(
    dataset: PasDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = own_method(tmp_path, "broken", METHOD, monkeypatch)  # LEVEL is not defined
    with pytest.raises(MethodError, match=r"broken:Flat.*NameError"):
        run_job(Job(str(dataset.path), method, "lofo", "lofo-24.25GHz"), tmp_path / "results")


def test_a_results_folder_that_cannot_be_is_refused_before_the_fit(
    dataset: PasDataset, tmp_path: Path
) -> None:
    (tmp_path / "results").write_text("a file")
    with pytest.raises(StorageError):
        run_jobs([Job(str(dataset.path), "nearest", "lofo", "lofo-24.25GHz")], tmp_path / "results")
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_skill_and_labels_of_trivial_predictors_ignore_budget_and_seed() -> None:
    hurried = [
        make_record(name, 0.8, "lofo-2.4GHz").model_copy(
            update={
                "job": Job("data.h5", name, "lofo", "lofo-2.4GHz", seed=3, budget=Budget(max_seconds=300))
            }
        )
        for name in NEEDED_TRIVIAL
    ]
    (board,) = boards(hurried)
    assert [row.label for row in board.rows] == sorted(NEEDED_TRIVIAL)
    assert board.skill(make_record("ours", 0.9, "lofo-2.4GHz")) == pytest.approx(0.5)


def test_every_board_says_kind_settings_and_machine() -> None:
    markdown = leaderboard_markdown([make_record("nearest", 0.8, "lofo-2.4GHz")])
    for word in ("power", "image", "specular"):
        assert word in markdown
    other = make_record("nearest", 0.8, "lofo-2.4GHz").model_copy(
        update={"pas_kind": "amplitude", "dataset_sha256": "b" * 64}
    )
    assert "amplitude" in leaderboard_markdown([other])
