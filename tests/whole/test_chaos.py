"""Whatever happens to a command, the next one leaves the bytes of an undisturbed run or refuses in words."""

from __future__ import annotations

import pytest

from tests.support import chaotic
from xfreqbench.bench.chaos import run as chaos
from xfreqbench.bench.chaos.commands import COMMANDS
from xfreqbench.bench.chaos.disturbances import DISTURBANCES
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
def test_the_next_run_leaves_the_same_predictions_and_records_or_refuses(
    rounds: chaos.Chaos, disturbance: str
) -> None:
    verdict = rounds.round(BY_NAME["run"], disturbance, seed=1)
    assert not verdict.faults, str(verdict)


def test_the_other_commands_are_disturbed_too(rounds: chaos.Chaos) -> None:
    others = [BY_NAME[name] for name in ("report", "export", "score")]
    verdicts = [rounds.round(command, "killed", seed=2) for command in others]
    assert not any(verdict.faults for verdict in verdicts), list(map(str, verdicts))
    assert chaos.table_rows(verdicts)[0] == ("report", "1", "1", "0", "0")


@pytest.mark.parametrize(
    ("command_line", "fault"),
    [
        (chaotic.writing_elsewhere, "the folder outside was touched"),
        (chaotic.taking_others_data, "out.h5 is another"),
        (chaotic.speaking_in_tracebacks, "no words for a user"),
        (chaotic.littering, "rest.tmp is left over"),
    ],
)
def test_what_is_wrong_is_found(rounds: chaos.Chaos, command_line: chaos.CommandLine, fault: str) -> None:
    assert rounds.round(IMPORT, "killed", seed=3).faults == ()
    rounds._command_line = command_line
    try:
        assert any(fault in found for found in rounds.round(IMPORT, "killed", seed=3).faults)
    finally:
        rounds._command_line = main
