"""Whatever happens to a command, the next one leaves the bytes of an undisturbed run or refuses in words."""

from __future__ import annotations

from functools import partial

import pytest

from tests.whole.chaos.commands import do_wrong
from tests.whole.chaos.disturbances import DISTURBANCES
from tests.whole.chaos.run import Chaos
from xfreqbench.cli.main import main

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
ROUNDS = [
    *(("generate", disturbance) for disturbance in DISTURBANCES),
    *(("run", disturbance) for disturbance in ("killed", "doubled", "damaged", "foreign")),
    *((command, "killed") for command in ("report", "export", "score", "import")),
    *(("view", "linked"), ("findings", "foreign")),
]


@pytest.fixture(scope="module")
def rounds(tmp_path_factory: pytest.TempPathFactory) -> Chaos:
    return Chaos(main, tmp_path_factory.mktemp("chaos"))


@pytest.mark.parametrize(("command", "disturbance"), ROUNDS)
def test_the_next_command_leaves_the_same_bytes_or_refuses(rounds: Chaos, command: str, disturbance: str) -> None:
    assert rounds.faults(command, disturbance, seed=1) == []


@pytest.mark.parametrize(
    ("how", "fault"),
    [
        ("elsewhere", "the folder outside was touched"),
        ("others", "out.h5 is another"),
        ("traceback", "no words for a user"),
        ("litter", "rest.tmp is left over"),
    ],
)
def test_what_is_wrong_is_found(rounds: Chaos, how: str, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds.undisturbed("import")  # of the right command
    monkeypatch.setattr(rounds, "command_line", partial(do_wrong, how))
    assert any(fault in found for found in rounds.faults("import", "interrupted", seed=3))
