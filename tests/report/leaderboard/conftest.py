"""Results of real runs and the page that is made from them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.page_results import store_results
from xfreqbench.report.leaderboard.page import write_page


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return store_results(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="session")
def file(results: Path) -> Path:
    return write_page(results, results.parent / "page.html")
