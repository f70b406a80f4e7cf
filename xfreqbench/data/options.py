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
    """What is asked of a generation. Each `Doc` is the help of the command, whose lists have commas.

    Options that are None have the default of what is generated: a scene, or rooms of a family.
    """

    freqs_ghz: Annotated[CarriersGhz, Doc("Carriers in GHz.")] = PAPER_CARRIERS_GHZ
    _: KW_ONLY
    rooms: Annotated[
        int | None, Doc("Of a family: how many rooms to draw, by seeds from --seed on; -o is a folder.")
    ] = None
    tx: Annotated[
        int | None, Doc("Number of transmitters, chosen by the seed; all of a scene, or 120 in a room, if absent.")
    ] = None
    tx_positions: Annotated[
        Positions | None,
        Doc(
            "Instead of the scene's grid, if it has one: a CSV of x,y,z in metres, one transmitter a line, its "
            "columns three or named in the first line; or a data set (.h5), whose transmitters are taken."
        ),
    ] = None
    solver: Annotated[
        Literal["auto", "image", "sionna"],
        Doc(
            "image: the exact image method, for up to 1,000 mirrors; sionna: Sionna RT, for every scene; auto: image "
            "where it can trace the scene, else sionna."
        ),
    ] = "auto"
    interactions: Annotated[
        Texts | None,
        Doc(
            "Comma-separated, of: specular, refraction, diffraction, diffuse. If absent: the first three where solver "
            "image traces them, else the first two."
        ),
    ] = None
    rays: Annotated[
        int | None,
        Doc("Rays that look for paths, 10,000,000 at most; if absent 500,000, or 50,000 in each room of a family."),
    ] = None
    max_depth: Annotated[
        int | None,
        Doc(
            "Most interactions of a path, reflections and transmissions together; up to 16. If absent 6, or 4 in "
            "each room of a family."
        ),
    ] = None
    seed: Annotated[int, Doc("Seed of the rays and of the choice of transmitters, or of the first room.")] = 1
    pas_kind: Annotated[str, Doc("What maps show: power, amplitude (its root) or phase-only.")] = "power"
    materials: Annotated[Literal["error", "extrapolate"], Doc("What to do outside a material's P.2040 band.")] = "error"
    maps: Annotated[
        bool | None, Doc("Store the maps beside the channels they derive from. If absent: of a scene, not of rooms.")
    ] = None
    paths: Annotated[bool, Doc("Store the paths: gains, delays, directions, and what surfaces they meet where.")] = (
        False
    )
    receiver: Annotated[
        Texts | None,
        Doc("Receivers of a scene with several, comma-separated, or `all`: one file holds them; the first if absent."),
    ] = None
    polarization: Annotated[
        Texts | None,
        Doc(
            "V or H, for transmitters and receivers; V,H: all four pairs, VV, VH (sent in V, heard in H), HV and "
            "HH, in one file; or some of these pairs. As the scene says if absent."
        ),
    ] = None
    executor: Annotated[
        Word, Doc("serial: in this process; 4: as many processes here; dask://host:8786: workers of a cluster.")
    ] = "serial"
    progress: Annotated[Shown, Doc("Show on stderr how far it is: `auto` on a terminal and in a notebook alone.")] = (
        "auto"
    )
    tell: Annotated[
        Callable[[str], None] | None, Doc("Is given what a command says, in a few lines, before the first ray.")
    ] = None

    @property
    def settings(self) -> TraceSettings:
        """What is asked of the rays; raises `UnknownNameError` for an interaction that there is not."""
        from xfreqbench.tracing.solvers import interactions_named
        from xfreqbench.tracing.tracer import TraceSettings

        asked = TraceSettings(
            self.solver, interactions_named(self.interactions), seed=self.seed, materials=self.materials
        )
        limits: dict[str, Any] = {"rays": self.rays, "max_depth": self.max_depth}
        return replace(asked, **{name: limit for name, limit in limits.items() if limit is not None})
