"""Commands about scenes and data sets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from xfreqbench.cli.options import (
    DATA,
    Flag,
    Freqs,
    Hidden,
    Output,
    Quiet,
    app,
    example,
    flag,
    output_option,
    parse_carriers_hz,
    say,
    say_written,
    with_help,
)
from xfreqbench.data.options import GenerateOptions
from xfreqbench.errors import XFreqBenchError
from xfreqbench.units import PAPER_CARRIERS_GHZ


@app.command(group=DATA, help_epilogue=example("scenes office --toml"))
def scenes(
    name: str | None = None,
    *,
    toml: Annotated[bool, flag("Print the TOML of the scene or family NAME, as a start for your own.")] = False,
    schema: Annotated[bool, flag("Print the JSON Schema of scene files, for editors.")] = False,
    family_schema: Annotated[bool, flag("Print the JSON Schema of family files.")] = False,
) -> None:
    """List the scenes, and the families of rooms, that ship with the toolkit."""
    import json

    from xfreqbench.scene import families
    from xfreqbench.scene.model import scene_schema
    from xfreqbench.scene.toml_files import shipped_families, shipped_scenes, shipped_toml

    if toml or name is not None:
        if not (toml and name):
            raise XFreqBenchError(
                "A name and --toml need each other: `xfreqbench scenes office --toml` prints the file of the office."
            )
        print(shipped_toml(name), end="")
        return
    if schema or family_schema:
        print(json.dumps(families.family_schema() if family_schema else scene_schema(), indent=2))
        return
    for shipped, description in (shipped_scenes() | shipped_families()).items():
        print(f"{shipped:12} {description}")


@app.command(group=DATA, help_epilogue=example("sealed 0.2 --reveal $RANDOMNESS"))
def sealed(release: str, *, reveal: str, family: str = "rooms") -> None:
    """Print the command that draws the sealed rooms of a release: rooms that nobody could know before a certain day.

    Parameters
    ----------
    reveal
        The public random number of that day, 64 hexadecimal digits; docs/rooms.md says which it is.
    family
        A shipped family's name, or the path of a family's TOML.
    """
    import hashlib
    import re

    from xfreqbench.scene.families import load_family

    if not re.fullmatch("[0-9a-f]{64}", number := reveal.strip().lower()):
        raise XFreqBenchError(f"{reveal!r} is no random number of drand, which has 64 hexadecimal digits.")
    digest = hashlib.sha256(f"{release} {load_family(family).sha256} {number}".encode()).hexdigest()
    print(f"xfreqbench generate {family} --rooms 1000 --seed {int(digest[:6], 16)} --tx 88 -o sealed-{release}")


@with_help
@dataclass(frozen=True, eq=False, kw_only=True)
class GenerateArguments(GenerateOptions):
    """The options of `generate` on the command line."""

    freqs_ghz: Freqs = PAPER_CARRIERS_GHZ
    tx_positions: Path | None = None  # type: ignore[assignment]
    paths: Flag = False
    progress: Hidden = "auto"
    tell: Hidden = None


@app.command(group=DATA, help_epilogue=example("generate office --freqs 2.4,10,24.25 --tx 24 -o office.h5"))
def generate(
    scene: str = "office",
    *,
    output: Output,
    options: Annotated[GenerateArguments, Parameter(name="*")] = GenerateArguments(),
    dry_run: Annotated[bool, flag("Print counts, size and a time estimate; write nothing.")] = False,
    quiet: Quiet = False,
) -> None:
    """Trace a scene, or many drawn rooms, and write channels and power angular spectra to HDF5 files.

    Parameters
    ----------
    scene
        A shipped scene's name, or the path of a scene TOML; with --rooms, a family's name or path.
    """
    from xfreqbench.data import generate as of_scenes
    from xfreqbench.data import rooms as of_rooms
    from xfreqbench.data.fingerprint import compare_fingerprint
    from xfreqbench.data.plan import plan_generation
    from xfreqbench.system.bars import progress_bars
    from xfreqbench.system.processes import require_executor

    require_executor(options.executor)
    asked: dict[str, Any] = vars(options) | {"tx_positions": _read_positions(options.tx_positions)}
    asked |= {"progress": not quiet, "tell": partial(say, quiet=quiet)}
    if options.rooms is not None:
        if asked.pop("tx_positions") is not None or asked.pop("receiver") is not None:
            raise XFreqBenchError(
                "With --rooms the family draws transmitters and array; leave out --tx-positions and --receiver."
            )
        if not dry_run:
            say(f"{of_rooms.generate_rooms(scene, output, **asked)!r}\nwrote {output}", quiet)
            return
        rooms = of_rooms.plan_rooms(scene, GenerateOptions(**asked))
        seconds, num_bytes = of_rooms.estimate_rooms(rooms)
        print(
            f"{options.rooms:,} rooms of {rooms.family.name!r} × {rooms.options.tx} transmitters × "
            f"{len(rooms.carrier_hz)} carriers, about {num_bytes / 1e6:,.0f} MB in as many files\n"
            f"estimated time {seconds:,.0f} s of one core, {seconds / options.rooms:.2f} s a room; nothing was written"
        )
    elif dry_run:
        plan = plan_generation(scene, GenerateOptions(**asked))
        with progress_bars("transmitters", ["estimating"], quiet):
            seconds = of_scenes.estimate_seconds(plan)
        print(f"{plan.summary}\nestimated time {seconds:.0f} s on this machine; nothing was written")
    else:
        del asked["rooms"]
        is_new = not output.exists()
        dataset = of_scenes.generate(scene, output, **asked)
        say_written(output, is_new, quiet)
        say(compare_fingerprint(dataset).verdict, quiet)


def _read_positions(path: Any) -> Any:
    """Positions (T, 3) in metres from a CSV file or a data set; None without a file. Raises `XFreqBenchError`."""
    if path is None:
        return None
    if path.suffix == ".h5":
        from xfreqbench.data.dataset import open_dataset

        return open_dataset(path).tables["tx_position_m"]
    from xfreqbench.scene.tables import read_table

    return read_table(path).position_m()


@app.command(group=DATA, help_epilogue=example("info office.h5 --retrace 4"))
def info(
    file: Path,
    *,
    retrace: Annotated[
        int, Parameter(help="Number of samples to trace again from the scene and settings in the file, and to compare.")
    ] = 0,
    glints: Annotated[
        int,
        Parameter(
            help="Number of transmitters to trace with every facet of the meshes as a mirror, to compare with patches."
        ),
    ] = 0,
    statistics: Annotated[
        bool,
        flag(
            "Print path loss, spreads, K and mechanisms at each carrier, and those of 3GPP TR 38.901 and others. "
            "They are of stored paths, or of 200 transmitters that are traced again."
        ),
    ] = False,
    seed: Annotated[int, Parameter(help="Seed that draws what is traced again.")] = 0,
) -> None:
    """Print the contents of a data set, or of a folder of rooms, and verify every byte against its hashes.

    A data set is also compared with the fingerprint of its scene.
    """
    from xfreqbench.data.collection import open_collection
    from xfreqbench.data.dataset import links, open_dataset, verify
    from xfreqbench.data.fingerprint import compare_fingerprint
    from xfreqbench.data.retrace import drawn_rows, require_origin
    from xfreqbench.report.view.describe import describe

    if min(retrace, seed) < 0:
        raise XFreqBenchError(f"--retrace and --seed take 0 or more, but got {retrace} and {seed}.")
    if glints < 0:
        raise XFreqBenchError(f"--glints takes 0 or more, but got {glints}.")
    if file.is_dir():
        if retrace or glints or statistics:
            raise XFreqBenchError("--retrace, --glints and --statistics are of one data set: give one of its files.")
        collection = open_collection(file)
        say(collection.description)
        collection.verify()
        print("every hash holds")
        return
    say(describe(file))
    verify(file)
    print("every hash holds")
    dataset = open_dataset(file)
    say(compare_fingerprint(dataset).verdict)
    for link in links(dataset) if retrace else ():
        worst = require_origin(link, drawn_rows(link, retrace, seed))
        of = "".join(f" of {name}" for name in link.link if name)
        print(f"{min(retrace, len(link))} samples{of} traced again: {worst}, the others by less")
    if glints:
        from xfreqbench.data.glints import glints as left_out

        print(left_out(dataset, glints, seed))
    if statistics:
        from xfreqbench.data.statistics import statistics as statistics_of

        print(f"\n{statistics_of(dataset, seed=seed)}")


@app.command(group=DATA, help_epilogue=example("plot office.h5 --tx 7 --carriers 2.4,24.25 -o maps.pdf"))
def plot(
    file: Path,
    *,
    output: Annotated[Path, output_option("Figure to write, which ends in .png, .svg or .pdf.")],
    of: Annotated[
        Literal["maps", "power", "statistics"],
        Parameter(
            help="maps: the power from one transmitter, by direction; power: a plan of the room with the power "
            "received from every transmitter; statistics: path loss, spreads and K compared with standards."
        ),
    ] = "maps",
    tx: Annotated[int | None, Parameter(help="Index of the transmitter whose maps are drawn; default 0.")] = None,
    carriers: Annotated[
        str | None, Parameter(help="Carriers in GHz, comma-separated, one panel each; default all.")
    ] = None,
    db_range: Annotated[float, Parameter(help="Range of the colours in dB below the strongest.")] = 30.0,
) -> None:
    """Draw the maps of one transmitter, a plan with the power of all, or statistics, by carrier: PNG, SVG or PDF."""
    from xfreqbench.report.drawing.figures import figure_kind, require_own_figure
    from xfreqbench.report.view.pictures import draw_maps, draw_power, draw_statistics

    figure_kind(output)
    if not 0 < db_range <= 300:
        raise XFreqBenchError(f"--db-range takes dB above 0, at most 300, as in 30, but got {db_range:g}.")
    if of != "maps" and tx is not None:
        raise XFreqBenchError(f"--of {of} shows all transmitters; leave --tx out, or draw --of maps.")
    if of == "statistics" and carriers is not None:
        raise XFreqBenchError("--of statistics shows all carriers; leave --carriers out.")
    carriers_hz = None if carriers is None else parse_carriers_hz(carriers, ("--carriers",))
    require_own_figure(output)
    if of == "maps":
        draw_maps(file, tx or 0, carriers_hz, db_range, output)
    elif of == "statistics":
        draw_statistics(file, output)
    else:
        draw_power(file, carriers_hz, db_range, output)
    say(f"wrote {output}")


@app.command(group=DATA, help_epilogue=example("view office.h5 --tx 7 -o office_view"))
def view(
    data_or_scene: str,
    *,
    output: Annotated[Path, output_option("Folder for page, figures and model.")],
    tx: Annotated[int | None, Parameter(help="Index of the transmitter shown; default: one in the middle.")] = None,
    carrier: Annotated[
        float | None, Parameter(help="Carrier in GHz at which rays are drawn; default: the middle one.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Show a data set or a scene: write a page, figures, and the scene with one transmitter's rays in 3D.

    Parameters
    ----------
    data_or_scene
        The path of a data set, a shipped scene's name, or the path of a scene TOML.
    """
    from xfreqbench.report.view.plan import plan_view

    planned = plan_view(data_or_scene, tx, carrier)
    from xfreqbench.report.view.write import claim, write_view  # after the refusals, which Matplotlib would delay

    claim(planned, output)
    say(planned.missing or "tracing the rays of one transmitter", quiet)
    for path in write_view(planned.with_rays(), output, partial(say, quiet=quiet)):
        say(f"wrote {path}", quiet)
