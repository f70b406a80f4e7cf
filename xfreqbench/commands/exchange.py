"""Commands that take in what others made, and hand out what others ask for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from xfreqbench.commands import Output, Quiet, app, say


@app.command(name="import")
def import_(
    folder: Path,
    *,
    output: Output,
    convention: Annotated[
        Literal["wideband3dgs"], Parameter(help="Whose angles, array and file names the folder follows.")
    ] = "wideband3dgs",
    quiet: Quiet = False,
) -> None:
    """Read a folder of PNG maps, as other groups publish theirs, into an HDF5 file without channels.

    Parameters
    ----------
    folder
        Holds spectrum/00001.png, …, tx_pos.csv, freq.txt and gateway_info.yml.
    """
    from xfreqbench.interchange import import_png_folder, read_png_folder

    source = read_png_folder(folder)
    if source.ignored:
        say(f"{' and '.join(source.ignored)} ignored: protocols make the splits", quiet)
    is_new = import_png_folder(source, output)
    size = f"{output.stat().st_size / 1e6:.1f} MB"
    say(f"wrote {output} ({size})" if is_new else f"{output} already holds this data set", quiet)
