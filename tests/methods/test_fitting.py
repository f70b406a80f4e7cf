"""What an edit of a method does to results."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.stub_methods import lofo_job, run_job
from tests.support.synthetic import paper_dataset

METHOD = """
from xfreqbench.baselines.nearest import Nearest

class Own(Nearest):
    def fit(self, train, budget, seed):
        assert not train.tables["cfr"][:, 4].any()  # 24.25 GHz is tested: none of it may be here
        yield from super().fit(train, budget, seed)
"""


def test_an_edited_method_is_run_again_and_sees_no_test_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    job = lofo_job(paper_dataset(tmp_path / "data.h5"), "edited_method:Own")
    ids = []
    for text in (METHOD, METHOD, METHOD + "# edited\n"):
        (tmp_path / "edited_method.py").write_text(text)
        ids.append(run_job(job, tmp_path / "results").id)
    assert ids[0] == ids[1] != ids[2]
