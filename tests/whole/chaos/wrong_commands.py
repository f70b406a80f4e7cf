"""Command lines that do wrong after the right one has ended, for the tests of what finds them out."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from xfreqbench.cli.main import main


def _given() -> None:
    with suppress(SystemExit):
        main()


def writing_elsewhere() -> None:
    _given()
    thesis = Path("../outside/thesis.tex")
    if thesis.parent.exists():
        thesis.write_text("gone", encoding="utf-8")


def taking_others_data() -> None:
    _given()
    if Path("../outside").exists():
        Path("out.h5").write_bytes(Path("inputs/data.h5").read_bytes())


def speaking_in_tracebacks() -> None:
    _given()
    if Path("../outside").exists():
        raise RuntimeError("nobody's words")


def littering() -> None:
    _given()
    Path("rest.tmp").touch()
    if not Path("../outside").exists():
        Path("rest.tmp").unlink()
