"""The options of runs: one class for the command and for `run`.

NumPy is not imported here: the command line shows these options in its help.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator
from typing_extensions import Doc

from xfreqbench.system.arguments import FilePath, ScoredOn, TargetsGhz, Texts, WholeNumbers, Word, listed
from xfreqbench.system.bars import Shown

if TYPE_CHECKING:
    from xfreqbench.methods.contract import Budget
else:
    Budget = Any

MethodOptions = Texts | Mapping[str, Any]  # texts `key=value`, or values by key
Methods = Annotated[Sequence[str | type], BeforeValidator(listed)] | Mapping[str | type, MethodOptions]


@dataclass(frozen=True)
class RunOptions:
    """What is asked of runs. Each `Doc` is the help of the command, whose lists have commas."""

    protocol: Annotated[
        str,
        Doc(
            "lofo: leave one frequency out; sparse: the paper's three training sets; held-out-tx: unseen "
            "transmitters; held-out-block: unseen regions of the room; lofo-unseen-tx: unseen carriers and "
            "transmitters; random-samples: a fifth of all samples, which leaks both; held-out-receiver: a receiver of "
            "several, each in turn; unseen-rooms: rooms of a collection that were never trained on, and "
            "unseen-rooms-plan, which tells their plans."
        ),
    ] = "lofo"
    results: Annotated[FilePath, Doc("Folder for records, predictions and checkpoints.")] = "results"
    _: KW_ONLY
    targets_ghz: Annotated[
        TargetsGhz,
        Doc("Held-out carriers of lofo and lofo-unseen-tx in GHz, comma-separated, or `all`; by default 2.4,24.25,77."),
    ] = None
    on: ScoredOn = "test"
    seeds: Annotated[WholeNumbers, Doc("Seeds of the methods, comma-separated: one run each.")] = (0,)
    budget: Annotated[
        str | Budget | None,
        Doc(
            "Fitting budget of every run: 300s, 5m, 2h, 2000steps, 64000maps, or a lane of the leaderboard: quick "
            "(64000maps), minutes (5m), converged (200000maps)."
        ),
    ] = "quick"
    device: Annotated[Literal["cpu", "cuda"], Doc("Where methods that have the choice compute.")] = "cpu"
    receiver: Annotated[str | None, Doc("Receiver that methods hear, of data with several; the first if absent.")] = (
        None
    )
    polarization: Annotated[
        str | None, Doc("Pair of polarizations, of data with several, as in VH; the first if absent.")
    ] = None
    executor: Annotated[
        Word,
        Doc(
            "serial: in this process; 4: as many processes here, a new one for each run; dask://host:8786: "
            "workers of a cluster; serial if absent; in the command, 1 if a method is of another package."
        ),
    ] = "serial"
    progress: Annotated[
        Shown,
        Doc(
            "Show on stderr how far it is, and first what runs of more than ten minutes may take: `auto` on a terminal "
            "and in a notebook alone."
        ),
    ] = "auto"
