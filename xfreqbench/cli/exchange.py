"""Commands that read the files of other groups, and write files for them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from xfreqbench.cli.options import (
    EXCHANGE,
    TARGETS,
    Output,
    Quiet,
    ScoredOnOption,
    app,
    example,
    flag,
    output_option,
    parse_targets_ghz,
    print_table,
    say,
    say_written,
)
from xfreqbench.errors import XFreqBenchError
from xfreqbench.system.bars import progress_bars

Convention = Annotated[
    str, Parameter(help="Convention of angles, values and array: a name from `xfreqbench import --conventions`.")
]
Changed = Annotated[tuple[str, ...], Parameter(name="--set", help="Change a field of the convention, as in plane=yz.")]


@app.command(
    name="import",
    group=EXCHANGE,
    help_epilogue=example("import wideband-example1 --convention wideband3dgs -o other.h5"),
)
def import_(
    folder: Path,
    *,
    output: Output,
    from_: Annotated[
        Literal["png", "deepmimo"],
        Parameter(name="--from", help="png: maps of other groups; deepmimo: paths of DeepMIMO v4."),
    ] = "png",
    convention: Convention = "wideband3dgs",
    set_: Changed = (),
    freq: Annotated[
        float | None, Parameter(help="Carrier in GHz of all samples, for a folder without freq.txt.")
    ] = None,
    pair: Annotated[
        str | None, Parameter(help="For DeepMIMO: station and users, as in t001_tx000_r000, if there are several.")
    ] = None,
    elevations: Annotated[
        Literal["zenith", "horizon"],
        Parameter(help="For DeepMIMO: origin of its elevations; those of AODT may be counted from the horizon."),
    ] = "zenith",
    quiet: Quiet = False,
) -> None:
    """Convert a folder of PNG maps, or scenarios of DeepMIMO, as other groups publish them, to an HDF5 file.

    Parameters
    ----------
    folder
        A folder with spectrum/00001.png, … of up to 1,000,000 pixels each, tx_pos.csv, gateway_info.yml and usually
        freq.txt; or a scenario of DeepMIMO v4, or a folder of scenarios at several carriers.
    """
    if from_ == "deepmimo":
        if freq is not None or set_ or convention != "wideband3dgs":
            raise XFreqBenchError("--convention, --set and --freq are for PNG maps; leave them out for DeepMIMO.")
        from xfreqbench.exchange.deepmimo_import import import_deepmimo

        with progress_bars("users", ["importing"], quiet) as (progress,):
            is_new = import_deepmimo(folder, output, pair, elevations, progress)
        say_written(output, is_new, quiet)
        return
    if pair is not None or elevations != "zenith":
        raise XFreqBenchError("--pair and --elevations are for scenarios of DeepMIMO; give --from deepmimo too.")
    from xfreqbench.exchange.conventions import convention_named
    from xfreqbench.exchange.png_dataset import import_png_folder
    from xfreqbench.exchange.png_folder import read_png_folder

    source = read_png_folder(folder, convention_named(convention, set_), freq)
    if source.convention.caveat:
        say(source.convention.caveat, quiet)
    if source.ignored:
        say(f"{' and '.join(source.ignored)} ignored: protocols make the splits", quiet)
    with progress_bars("transmitters", ["importing"], quiet) as (progress,):
        is_new = import_png_folder(source, output, progress)
    say_written(output, is_new, quiet)


@app["import"].command(name="--conventions", group="Parameters")
def conventions() -> None:
    """Print the convention of each publisher of PNG maps: the fields that --set of import and export changes."""
    from xfreqbench.exchange.conventions import CONVENTIONS, NO_CONVENTIONS, convention_rows

    print_table("", ("field", *CONVENTIONS), convention_rows())
    for name, convention in CONVENTIONS.items():
        print(f"{name}: {convention.read_in}. {convention.caveat}".rstrip())
    for name, reason in NO_CONVENTIONS.items():
        print(f"{name}: none. {reason}")


@app.command(group=EXCHANGE, help_epilogue=example("card office.h5 --license CC-BY-4.0 -o office_card"))
def card(
    data: Path,
    *,
    license_: Annotated[
        str, Parameter(name="--license", help="Licence of the data, as SPDX names it: CC-BY-4.0, CC0-1.0, ….")
    ],
    output: Annotated[Path, output_option("Folder to write, new or empty.")],
    quiet: Quiet = False,
) -> None:
    """Write a folder to publish: the data, a README card, Croissant metadata, checksums, a sample, its recipe.

    Parameters
    ----------
    data
        A data set, or a collection: a folder of rooms.
    """
    from xfreqbench.report.view.card import write_card

    write_card(data, output, license_, partial(say, quiet=quiet))
    say(f"wrote {output}", quiet)


@app.command(group=EXCHANGE, help_epilogue=example("export office.h5 --convention nerf2 -o office_png"))
def export(
    data: Path,
    *,
    output: Annotated[Path, output_option("Folder to write, new or empty; for a table, a file.")],
    to: Annotated[
        Literal["png", "deepmimo", "sionna-npz", "table", "datasets", "webdataset"],
        Parameter(
            help="png: maps, drawn by --convention; deepmimo: paths, as scenarios of DeepMIMO v4; sionna-npz: paths, "
            "in arrays named as in Sionna RT; table: powers, K and spreads of every sample, as CSV, or as Parquet if "
            "the name ends in .parquet; datasets: maps and channels as Parquet, for Hugging Face's datasets; "
            "webdataset: maps and channels as tar shards."
        ),
    ] = "png",
    convention: Annotated[
        str | None,
        Parameter(help="For PNG maps: convention of angles and values, a name from `xfreqbench import --conventions`."),
    ] = None,
    set_: Changed = (),
    power_dbm: Annotated[
        float | None,
        Parameter(help="For a table: transmit power in dBm, instead of power_dbm in the scene's [transmitters]."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write a data set in the format of another program: maps as PNGs or shards, paths, or a table of links.

    Parameters
    ----------
    data
        A data set, generated or imported; for paths, one that was generated with --paths; for datasets and webdataset
        also a folder of rooms.
    """
    if (to == "png") != (convention is not None):
        raise XFreqBenchError(
            "PNG maps are drawn by a convention; give --convention, a name from `xfreqbench import --conventions`."
            if to == "png"
            else f"--to {to} does not use a convention of maps; leave out --convention."
        )
    if power_dbm is not None and to != "table":
        raise XFreqBenchError("--power-dbm is for a table of powers; give --to table too, or leave it out.")
    if set_ and to != "png":
        raise XFreqBenchError(f"--set changes a convention of maps, and --to {to} has none; leave it out.")

    counted = {"table": "links", "deepmimo": "carriers", "sionna-npz": "carriers"}.get(to, "maps")
    with progress_bars(counted, ["exporting"], quiet) as (progress,):
        if to == "png":
            from xfreqbench.exchange.conventions import convention_named
            from xfreqbench.exchange.png_dataset import export_png_folder

            dataset = export_png_folder(data, output, convention_named(str(convention), set_), progress)
            what = f" ({len(dataset)} maps)"
        elif to == "datasets" or to == "webdataset":
            from xfreqbench.exchange.shards import export_shards

            what = f" ({export_shards(data, output, to, progress)} maps)"
        elif to == "table":
            from xfreqbench.exchange.link_table import export_link_table

            dataset, what = export_link_table(data, output, power_dbm, progress), ""
            if not dataset.header.paths:
                say(f"{data} has no paths, which local means, K and spreads need: generate it with --paths", quiet)
        else:
            from xfreqbench.exchange.deepmimo import export_deepmimo
            from xfreqbench.exchange.path_arrays import export_sionna_npz

            dataset = (export_deepmimo if to == "deepmimo" else export_sionna_npz)(data, output, progress)
            what = f" (paths of {dataset.header.num_tx} transmitters at {dataset.header.num_carriers} carriers)"
    say(f"wrote {output}{what}", quiet)


@app.command(group=EXCHANGE, help_epilogue=example("split --data office.h5 --targets 24.25 --maps -o split.h5"))
def split(
    *,
    data: Annotated[Path, Parameter(help="Data set written by `generate` or `import`.")],
    output: Output,
    protocol: Annotated[
        str, Parameter(help="lofo, sparse, held-out-tx, lofo-unseen-tx, held-out-block or random-samples; see `run`.")
    ] = "lofo",
    targets: Annotated[
        str | None,
        Parameter(name=TARGETS, help="Held-out carriers in GHz, comma-separated, or `all`; default 2.4,24.25,77."),
    ] = None,
    on: ScoredOnOption = "test",
    maps: Annotated[bool, flag("Include the training maps, so that the method does not need the data set.")] = False,
    quiet: Quiet = False,
) -> None:
    """Write a split file for a method that runs elsewhere: all that it may know of each split, and no tested map."""
    from xfreqbench.data.dataset import open_dataset
    from xfreqbench.data.splits import make_splits
    from xfreqbench.exchange.split_file import write_splits

    targets_ghz, dataset = parse_targets_ghz(targets), open_dataset(data)
    splits = make_splits(dataset, protocol, targets_ghz, on)
    with progress_bars("maps", ["writing"] if maps else [], quiet) as bars:
        is_new = write_splits(dataset, splits, output, maps, *bars)
    names = ", ".join(split.name for split in splits)
    size = f"{output.stat().st_size / 1e6:.1f} MB"
    say(f"wrote {output} ({size}): {names}" if is_new else f"{output} already holds these splits", quiet)


@app.command(group=EXCHANGE, help_epilogue=example("score predictions.h5 --data office.h5 --results results"))
def score(
    predictions: Path,
    *,
    data: Annotated[Path, Parameter(help="Data set that the splits were made from.")],
    results: Annotated[Path, Parameter(help="Folder for the record and a copy of the predictions.")],
    method: Annotated[str | None, Parameter(help="Name on the leaderboard, instead of the one in the file.")] = None,
    quiet: Quiet = False,
) -> None:
    """Score maps that were predicted elsewhere, in the same way as those of a run, and record them as external.

    Parameters
    ----------
    predictions
        HDF5 file with a group for each split: a dataset `pas` in the order of `test_row`, the attributes of the split
        file, and `method`.
    """
    from xfreqbench.exchange.score_file import score_file
    from xfreqbench.report.leaderboard.tables import Leaderboard

    with progress_bars("maps", ["checking", "scoring"], quiet) as (checking, scoring):
        scored = score_file(predictions, data, results, method, checking, scoring)
    if scored.missing:
        say(f"{predictions} has no predictions for {', '.join(scored.missing)}, which its protocol tests too", quiet)
    for silent in scored.silent:
        say(f"every map of {silent} in {predictions} is zero. Was each divided by its maximum before it was rounded?")
    if not scored.is_data_known:
        say(f"{predictions} has no dataset_sha256, so it is assumed to be of {data}", quiet)
    say(f"{Leaderboard.beside(results, scored.records)}\n\nEvery metric: xfreqbench report {results}", quiet)
