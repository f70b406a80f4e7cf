"""The options of a generation: one class for the command, for `generate` and `generate_rooms`, and for their plans.

NumPy is not imported here: the command line shows these options in its help.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typing_extensions import Doc

from xfreqbench.system.arguments import CarriersGhz, Positions, Texts, Word
from xfreqbench.system.bars import Shown
from xfreqbench.units import PAPER_CARRIERS_GHZ

if TYPE_CHECKING:
    from xfreqbench.tracing.tracer import TraceSettings


@dataclass(frozen=True, eq=False)
class GenerateOptions:
    """The options of a generation. Each `Doc` is the help of the command, whose lists have commas.

    Options that are None have different defaults for a scene and for rooms of a family.
    """

    freqs_ghz: Annotated[CarriersGhz, Doc("Carriers in GHz.")] = PAPER_CARRIERS_GHZ
    _: KW_ONLY
    rooms: Annotated[
        int | None, Doc("For a family: number of rooms to draw, with the seeds from --seed on; -o is a folder.")
    ] = None
    tx: Annotated[
        int | None, Doc("Number of transmitters, chosen by the seed; default: all of a scene, or 120 in each room.")
    ] = None
    tx_positions: Annotated[
        Positions | None,
        Doc(
            "Positions instead of the scene's grid: a CSV of x,y,z in metres, one transmitter a line, with three "
            "columns or with names in the first line; or a data set (.h5), whose transmitters are taken."
        ),
    ] = None
    solver: Annotated[
        Literal["auto", "image", "sionna"],
        Doc(
            "image: the exact image method, for up to 1,000 mirrors; sionna: Sionna RT, for every scene; auto: image "
            "if it can trace the scene, otherwise sionna."
        ),
    ] = "auto"
    interactions: Annotated[
        Texts | None,
        Doc(
            "Comma-separated, of: specular, refraction, diffraction, diffuse. Default: the first three if solver "
            "image traces them, otherwise the first two."
        ),
    ] = None
    rays: Annotated[
        int | None,
        Doc("Rays that search for paths, at most 10,000,000; default 500,000, or 50,000 in each room of a family."),
    ] = None
    max_depth: Annotated[
        int | None,
        Doc(
            "Maximum number of interactions of a path, reflections and transmissions together; up to 16. Default 6, "
            "or 4 in each room of a family."
        ),
    ] = None
    seed: Annotated[int, Doc("Seed of the rays and of the choice of transmitters, or of the first room.")] = 1
    pas_kind: Annotated[str, Doc("Kind of map: power, amplitude (its root) or phase-only.")] = "power"
    materials: Annotated[Literal["error", "extrapolate"], Doc("What to do outside a material's P.2040 band.")] = "error"
    maps: Annotated[
        bool | None, Doc("Store the maps too, which derive from the channels. Default: for a scene, not for rooms.")
    ] = None
    paths: Annotated[bool, Doc("Store the paths: gains, delays, directions, surfaces and points of interaction.")] = (
        False
    )
    receiver: Annotated[
        Texts | None,
        Doc("For a scene with several receivers: names, comma-separated, or `all`, in one file; default the first."),
    ] = None
    polarization: Annotated[
        Texts | None,
        Doc(
            "V or H, for transmitters and receivers; V,H: all four pairs, VV, VH (sent in V, received in H), HV and "
            "HH, in one file; or some of these pairs. Default: as in the scene."
        ),
    ] = None
    executor: Annotated[
        Word, Doc("serial: in this process; 4: in four processes here; dask://host:8786: workers of a cluster.")
    ] = "serial"
    progress: Annotated[Shown, Doc("Show the progress on stderr: `auto` only on a terminal and in a notebook.")] = (
        "auto"
    )
    tell: Annotated[
        Callable[[str], None] | None, Doc("Function that gets the plan's summary, a few lines, before the first ray.")
    ] = None

    @property
    def settings(self) -> TraceSettings:
        """The settings of the rays; raises `UnknownNameError` for an unknown interaction."""
        from xfreqbench.tracing.solvers import interactions_named
        from xfreqbench.tracing.tracer import TraceSettings

        asked = TraceSettings(
            self.solver, interactions_named(self.interactions), seed=self.seed, materials=self.materials
        )
        limits: dict[str, Any] = {"rays": self.rays, "max_depth": self.max_depth}
        return replace(asked, **{name: limit for name, limit in limits.items() if limit is not None})
