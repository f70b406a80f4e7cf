from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import pytest
from pydantic import Field
from typing_extensions import Doc
from xfreqbench.baselines.xfreq_gs import XFreqGSConfig

from xfreqbench.cli.runs import run
from xfreqbench.errors import MethodError, UnknownNameError
from xfreqbench.methods.config import as_json, option_rows, override
from xfreqbench.methods.lookup import NoOptions
from xfreqbench.methods.registry import build_method


@dataclass(frozen=True)
class Config:
    hidden: int = 256
    rate: float = 1e-3
    spread: bool = True
    scale: Literal["log", "linear"] = "log"
    carriers: tuple[float, ...] = (1.0,)
    limit: int | None = None
    depth: Annotated[int, Field(ge=1)] = 6


class Opaque: ...


@dataclass(frozen=True)
class Weights:
    path: Path = Path("weights.pt")
    sizes: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class OfAClass:
    part: Opaque = Opaque()  # noqa: RUF009


@dataclass(frozen=True)
class OfAnything:
    part: Any = Opaque()  # noqa: RUF009


@dataclass(frozen=True)
class Explained(Config):
    hidden: Annotated[int, Doc("features")] = 64
    kernel: Annotated[Path, Field(description="where it is")] = Path("k.pt")
    share: Annotated[float, Field(gt=0, le=1)] = 0.5


@dataclass(frozen=True)
class Narrower(Explained):
    hidden: Annotated[int, Field(ge=2, lt=9)] = 8


def test_options_say_what_they_take_and_mean() -> None:
    rows = {row.name: row[1:] for row in option_rows(Explained())}
    assert rows == {
        "hidden": ("64", "whole number", "features"),
        "rate": ("0.001", "number", ""),
        "spread": ("true", "true, false", ""),
        "scale": ("log", "log, linear", ""),
        "carriers": ("(1.0,)", "list", ""),
        "limit": ("None", "whole number or nothing", ""),
        "depth": ("6", "whole number from 1", ""),
        "kernel": ("k.pt", "path", "where it is"),
        "share": ("0.5", "number above 0 to 1", ""),
    }


def test_an_option_that_is_changed_in_a_subclass_keeps_its_meaning() -> None:
    assert option_rows(Narrower())[0] == ("hidden", "8", "whole number from 2 to below 9", "features")


def test_an_option_that_no_text_can_give_says_so() -> None:
    assert option_rows(OfAClass())[0].allowed == "what no text can give"


def test_values_are_typed_from_the_fields_and_the_later_wins() -> None:
    texts = "hidden=1", "hidden=128", "rate=2e-4", "spread=false", "scale=linear", "carriers=[1, 2.5]", "limit=7"
    assert override(Config(), [*texts, "depth=1"]) == Config(128, 2e-4, False, "linear", (1.0, 2.5), 7, 1)


@pytest.mark.parametrize(
    ("config", "assignment", "words"),
    [
        *(
            (Config(), text, "takes")
            for text in ("hidden=many", "hidden=1.5", "rate=2_4", "scale=cubic", "carriers=[1", "spread=2")
        ),
        (Config(), "depth=0", "Option 'depth' of Config takes int, but '0' was given: .*greater"),
        (Config(), "hidden", "key=value"),
        (Config(), "hiden=128", "Did you mean 'hidden'"),
        (NoOptions(), "hidden=1", "Option 'hidden' is given, but this method has no options"),
    ],
    ids=str,
)
def test_what_sets_no_option_says_what_would(config: object, assignment: str, words: str) -> None:
    with pytest.raises((MethodError, UnknownNameError), match=words):
        override(config, [assignment])


def test_aided_sets_all_aids_that_a_method_has_and_no_others() -> None:
    without = override(XFreqGSConfig(), ["aided=false"])
    assert (without.direct_wave, without.tx_levels, without.band, without.blend) == (False, 0, False, "none")
    assert override(without, ["aided=true"]) == XFreqGSConfig()
    assert override(XFreqGSConfig(), ["aided=false", "band=true"]).band
    assert [row.default for row in option_rows(XFreqGSConfig()) if row.name == "aided"] == ["true"]
    with pytest.raises(MethodError, match="takes true or false, but 'all' was given"):
        override(XFreqGSConfig(), ["aided=all"])
    with pytest.raises(UnknownNameError, match="aided"):
        override(Config(), ["aided=false"])


def test_the_option_that_help_names_is_one_of_a_built_in_method() -> None:
    (option,) = re.findall(r"as in (\w+=\w+)", str(get_type_hints(run, include_extras=True)["set_"]))
    assert override(build_method("xfreq-gs").config, [option])


def test_a_configuration_with_a_path_has_a_form_in_json() -> None:
    changed = override(Weights(), ["path=models/a.pt"])
    assert as_json(changed) == {"path": "models/a.pt", "sizes": [1, 2]}


@pytest.mark.parametrize("config", [OfAClass(), OfAnything()])
def test_a_configuration_that_json_cannot_hold_is_told_so(config: object) -> None:
    with pytest.raises(MethodError, match=type(config).__name__):
        as_json(config)
