"""What all commands share: the two apps, common options, comma-separated carriers and printing."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_type_hints

import cyclopts
from cyclopts import App, CycloptsError, CycloptsPanel, Group, MissingArgumentError, Parameter, UnusedCliTokensError
from typing_extensions import Doc

from xfreqbench.errors import XFreqBenchError
from xfreqbench.system.arguments import CarriersGhz, ScoredOn
from xfreqbench.units import PAPER_CARRIERS_GHZ, ghz_to_hz, parse_number

if TYPE_CHECKING:
    from rich.console import Group as RichGroup


def _refusal(error: CycloptsError) -> RichGroup:
    """The error of a command line, in a panel, and below it the example of its command."""
    from rich.console import Group as RichGroup
    from rich.text import Text

    chain = tuple(error.command_chain or ())
    shown: CycloptsError | str = error
    if isinstance(error, MissingArgumentError) and error.argument is not None and error.keyword is None:
        names = error.argument.names
        needed = names[0].lstrip("-").upper() if error.argument.field_info.is_positional else " or ".join(names)
        shown = f"xfreqbench {' '.join(chain)} needs {needed}."
    if isinstance(error, UnusedCliTokensError) and error.unused_tokens:
        words = " ".join(error.unused_tokens)
        shown = f"xfreqbench {' '.join(chain)} does not take {words!r}. A list has commas and no spaces, as in 1,2.4."
    panel, command = CycloptsPanel(shown), app
    for name in chain:
        command = command[name]
    return RichGroup(panel, Text(command.help_epilogue)) if command.help_epilogue else RichGroup(panel)


def _typed(kind: Any, tokens: Any) -> Any:
    """The values of an option, with the numbers of `parse_number`: Cyclopts also takes 1_0, and 1.5 for an integer.

    Names of a `Sequence` are separated by commas.
    """
    convert = cyclopts.convert
    if Sequence[str] in (kind, *get_args(kind)):
        return [name for name in map(str.strip, _joined(tokens).split(",")) if name]
    return convert(kind, tokens, lambda of, text: parse_number(text, of) if of in (int, float) else convert(of, [text]))


def _joined(tokens: Any) -> str:
    """The text of an option, with commas between the values of one that was given several times."""
    return ",".join(token.value for token in tokens)


app = App(
    name="xfreqbench",
    error_formatter=_refusal,
    help="How well does a radiance-field method predict channels at carriers it was never trained on?"
    + (" PYTHONOPTIMIZE=2 (python -OO) leaves out the help of the commands." if sys.flags.optimize > 1 else ""),
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative_iterable=(), converter=_typed),  # no --empty-set for --set
)
_STEERING = re.compile(r"[\0-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
# Groups of the commands in --help, in this order.
GROUPS = DATA, RUN, RESULTS, EXCHANGE, ADVANCED, PLUGINS, _OTHERS = tuple(
    Group(name, sort_key=place)
    for place, name in enumerate(
        ("Data", "Run methods", "Results", "Exchange with others", "Advanced", "Plug-ins", "Options")
    )
)
bench = App(name="bench", help="Measure accuracy against time; every table names its machine.", group=ADVANCED)
app.command(bench)
for name in ("--help", "--version"):
    app[name].group = _OTHERS
app.register_install_completion_command(
    group=_OTHERS, help="Let bash, zsh or fish complete commands and options; prints which files it writes."
)


def output_option(text: str) -> Parameter:
    """The option `--output`, or `-o`, with its help."""
    return Parameter(name=["--output", "-o"], help=text)


def flag(text: str) -> Parameter:
    """An option without a value, and without a `--no-` form, with its help."""
    return Parameter(negative="", help=text)


FREQS, TARGETS, SEEDS = ("--freqs-ghz", "--freqs"), ("--targets-ghz", "--targets"), ("--seeds", "--seed")
Freqs = Annotated[
    CarriersGhz,
    Parameter(
        name=FREQS,
        help="Carriers in GHz, comma-separated, as in 1,2.4,24.25; or `paper`, the paper's ten.",
        converter=lambda kind, tokens: parse_carriers_ghz(_joined(tokens)),
        show_default=lambda default: "paper",
    ),
]
Flag = Annotated[bool, Parameter(negative="")]
Hidden = Annotated[Any, Parameter(parse=False)]
Quiet = Annotated[bool, Parameter(name=["--quiet", "-q"], negative="", help="Print only errors.")]
Output = Annotated[Path, output_option("File to write.")]
ScoredOnOption = Annotated[ScoredOn, Parameter(help=get_args(ScoredOn)[1].documentation)]


def example(words: str) -> str:
    """The end of a command's help: a complete command line, `xfreqbench` with these words."""
    return f"Example: xfreqbench {words}"


def with_help(options: Any) -> Any:
    """The dataclass of a command's options, with the `Doc` of each field of its base as the help of the option."""
    hints = get_type_hints(options.__base__, include_extras=True)
    for each in fields(options):
        docs = [part.documentation for part in get_args(hints[each.name])[1:] if isinstance(part, Doc)]
        each.metadata = MappingProxyType({"help": docs[0]})
    # Cyclopts would look for the names of the base's types in the module of this class.
    options.__init__.__annotations__ = get_type_hints(options, include_extras=True)
    return options


def as_typed(names: tuple[str, ...]) -> str:
    """The name by which the command line gives an option; the first one if the option is absent."""
    typed = {word.partition("=")[0] for word in sys.argv}
    return next((name for name in names if name in typed), names[0])


def parse_whole_numbers(option: str, text: str, least: int, most: int) -> list[int]:
    """Distinct whole numbers from text such as `1,8,32`; raises an `XFreqBenchError` that names the option."""
    try:
        numbers = [parse_number(part, int) for part in text.split(",")]
    except ValueError:
        numbers = [least - 1]
    if not all(least <= number <= most for number in numbers):
        raise XFreqBenchError(f"{option} takes whole numbers from {least} to {most}, as in 1,8,32, but got {text!r}.")
    return list(dict.fromkeys(numbers))


def parse_carriers_ghz(freqs: str, names: tuple[str, ...] = FREQS) -> list[float]:
    """Carriers in GHz from text such as `1,2.4`, or `paper`; raises an `XFreqBenchError` that names the option."""
    option = as_typed(names)
    if freqs.strip() == "paper":
        return list(PAPER_CARRIERS_GHZ)
    try:
        carriers_ghz: list[float] = [parse_number(part) for part in freqs.split(",")]
        for carrier_ghz in carriers_ghz:
            ghz_to_hz(carrier_ghz)
    except ValueError as error:
        raise XFreqBenchError(
            f"{option} takes carriers in GHz, comma-separated, as in 1,2.4,24.25, and cannot use {freqs!r}: {error}."
        ) from error
    return carriers_ghz


def parse_carriers_hz(freqs: str, names: tuple[str, ...] = FREQS) -> list[float]:
    """Carriers in hertz from text such as `1,2.4`, in GHz, or `paper`; raises as `parse_carriers_ghz` does."""
    return [ghz_to_hz(carrier_ghz) for carrier_ghz in parse_carriers_ghz(freqs, names)]


def parse_targets_ghz(targets: str | None) -> list[float] | Literal["all"] | None:
    """Held-out carriers in GHz from text such as `2.4,77`; `all` and None are kept. Raises `XFreqBenchError`."""
    if targets is None:
        return None
    return "all" if targets == "all" else parse_carriers_ghz(targets, TARGETS)


def plain(text: object) -> str:
    """A text with escapes, such as `\\x1b`, for characters that control a terminal or reverse the order of letters."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))


def say(text: object, quiet: bool = False) -> None:
    """Print a text of `plain` at once, unless `quiet`."""
    if not quiet:
        print(plain(text), flush=True)


def say_written(output: Path, is_new: bool, quiet: bool) -> None:
    """Say that a data set was written, with its size, or that it was there already."""
    size = f"{output.stat().st_size / 1e6:.1f} MB"
    say(f"wrote {output} ({size})" if is_new else f"{output} already holds this data set", quiet)


def print_table(title: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table as wide as the terminal."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for name in header:
        table.add_column(Text(name))
    for row in rows:
        table.add_row(*map(Text, map(plain, row)))
    Console(width=None if sys.stdout.isatty() else 160).print(table)
