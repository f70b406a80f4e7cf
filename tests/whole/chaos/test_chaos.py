"""Whatever happens to a command, the next one leaves the bytes of an undisturbed run or refuses in words."""

from __future__ import annotations

import pytest

from tests.whole.chaos import run as chaos
from tests.whole.chaos import wrong_commands
from tests.whole.chaos.commands import COMMANDS
from tests.whole.chaos.disturbances import DISTURBANCES
from xfreqbench.cli.main import main

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
BY_NAME = {command.name: command for command in COMMANDS}
IMPORT, GENERATE = BY_NAME["import"], BY_NAME["generate, image"]


@pytest.fixture(scope="module")
def rounds(tmp_path_factory: pytest.TempPathFactory) -> chaos.Chaos:
    return chaos.Chaos(main, tmp_path_factory.mktemp("chaos"))


@pytest.mark.parametrize("disturbance", DISTURBANCES)
def test_the_next_generation_leaves_the_same_bytes_or_refuses(rounds: chaos.Chaos, disturbance: str) -> None:
    verdict = rounds.round(GENERATE, disturbance, seed=1)
    assert not verdict.faults, str(verdict)


@pytest.mark.parametrize("disturbance", ["killed", "doubled", "damaged", "foreign"])
def test_the_next_run_leaves_the_same_predictions_and_records_or_refuses(rounds: chaos.Chaos, disturbance: str) -> None:
    verdict = rounds.round(BY_NAME["run"], disturbance, seed=1)
    assert not verdict.faults, str(verdict)


@pytest.mark.parametrize(
    ("name", "disturbance"),
    [("report", "killed"), ("export", "killed"), ("score", "killed"), ("view", "linked"), ("findings", "foreign")],
)
def test_the_other_commands_are_disturbed_too(rounds: chaos.Chaos, name: str, disturbance: str) -> None:
    verdict = rounds.round(BY_NAME[name], disturbance, seed=2)
    assert not verdict.faults, str(verdict)


@pytest.mark.parametrize(
    ("command_line", "fault"),
    [
        (main, ""),
        (wrong_commands.writing_elsewhere, "the folder outside was touched"),
        (wrong_commands.taking_others_data, "out.h5 is another"),
        (wrong_commands.speaking_in_tracebacks, "no words for a user"),
        (wrong_commands.littering, "rest.tmp is left over"),
    ],
)
def test_what_is_wrong_is_found(
    rounds: chaos.Chaos, command_line: chaos.CommandLine, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds._reference(IMPORT)  # of the right command
    monkeypatch.setattr(rounds, "_command_line", command_line)
    faults = rounds.round(IMPORT, "killed", seed=3).faults
    assert any(fault in found for found in faults) if fault else not faults
