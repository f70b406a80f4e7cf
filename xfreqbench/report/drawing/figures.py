"""What all figures share: writing them to files, labels of logarithmic axes, and pictures of maps."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from PIL import Image

from xfreqbench.errors import XFreqBenchError
from xfreqbench.maps.drawing import DISPLAY_RANGE_DB, draw_disc
from xfreqbench.maps.grid import AngularGrid
from xfreqbench.report.drawing.markdown import plain
from xfreqbench.report.drawing.templates import SOFTWARE
from xfreqbench.system.files import atomic_path, require_own, storage_errors
from xfreqbench.types import NDArray

FIGURE_KINDS = ("png", "svg", "pdf")


@contextmanager
def plain_style() -> Iterator[None]:
    """A block, or a function, that draws the same whatever settings, style or `matplotlibrc` the user has."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams["text.parse_math"] = False  # a dollar in a method's name begins no formula
        yield


def panels(figure: Any, number: int, columns: int, **more: Any) -> list[Any]:
    """So many axes of a figure in rows of `columns`; `more` goes to `Figure.subplots`."""
    axes = figure.subplots(-(-number // columns), columns, squeeze=False, **more).ravel()
    for axis in axes[number:]:
        axis.set_visible(False)
    return list(axes[:number])


@plain_style()
def plot_pas_maps(
    maps: Float[NDArray[np.float32], "N E A"],
    grid: AngularGrid,
    titles: Sequence[str],
    path: Path,
    title: str = "",
    range_db: float = DISPLAY_RANGE_DB,
) -> None:
    """Draw N maps of the hemisphere as discs seen from the pole, as `draw_disc` does, into one figure.

    Each disc has a title, and all of them have `title`. The suffix of `path` says which of `FIGURE_KINDS` is written.
    Raises `StorageError`.
    """
    columns = min(5, len(maps))
    rows = -(-len(maps) // columns)
    figure = Figure(figsize=(max(2.4 * columns + 0.9, 4.5), 2.7 * rows + 0.6), layout="constrained")
    axes = panels(figure, len(maps), columns, subplot_kw={"projection": "polar"})
    for axis, pas_map, name in zip(axes, maps, titles, strict=True):
        image = draw_disc(axis, pas_map, grid, range_db)
        axis.set_title(shown(name), fontsize="medium")
    figure.colorbar(image, ax=axes, label="dB below the peak", shrink=0.8)
    if title:
        figure.suptitle(title, fontsize="medium")
    save_figure(figure, path, figure_kind(path))


def figure_kind(path: Path) -> str:
    """Which of `FIGURE_KINDS` the name of a file asks for; raises `XFreqBenchError` for another suffix."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FIGURE_KINDS:
        raise XFreqBenchError(
            f"A figure is written as PNG, SVG or PDF, but {path} is asked for; end its name in .png, .svg or .pdf."
        )
    return kind


def map_png(values: Float[NDArray[np.floating], "E A"], colormap: str) -> bytes:
    """The bytes of a PNG with a palette: one pixel for each value, clipped to 0 to 1, the first row at the top."""
    number = 64  # of colours: more are not visible, and with 256 the file is twice as large
    levels = np.round(np.clip(values, 0, 1) * (number - 1)).astype(np.uint8)
    colours = mpl.colormaps[colormap](np.linspace(0, 1, number), bytes=True)[:, :3]
    picture = Image.fromarray(levels)
    picture.putpalette(colours.tobytes())
    return _png_bytes(picture)


def grey_png(levels: UInt8[NDArray[np.uint8], "R C"]) -> bytes:
    """The bytes of a PNG of grey levels; `grey_levels` is the inverse."""
    return _png_bytes(Image.fromarray(levels))


def _png_bytes(picture: Image.Image) -> bytes:
    buffer = BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def grey_levels(png: bytes) -> UInt8[NDArray[np.uint8], "R C"]:
    """The levels of a PNG of 8-bit grey; raises `ValueError` where the bytes are none, or too many pixels."""
    try:
        with Image.open(BytesIO(png), formats=["PNG"]) as picture:
            if picture.mode != "L" or picture.width * picture.height > 10**7:
                raise ValueError(f"mode {picture.mode}, {picture.width} × {picture.height} pixels")
            return np.array(picture)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("the bytes are no PNG") from error


def shown(text: str) -> str:
    """A text from outside as a figure shows it: one line, not too long, and in the legend whatever it begins with."""
    line = plain(text)
    cut = line if len(line) <= 80 else f"{line[:79]}…"
    return f" {cut}" if cut.startswith("_") else cut  # Matplotlib hides labels that begin with an underscore


@contextmanager
def any_letters() -> Iterator[None]:
    """A block in which letters that the font lacks are drawn as boxes; whoever shows an SVG may know the letters."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph|Matplotlib currently does not support")
        yield


def label_decades(axis: Any) -> None:
    """Label a logarithmic x axis with plain numbers at 1, 2 and 5 of each decade; only at 1 with over three decades."""
    low, high = axis.get_xlim()
    is_wide = np.log10(high / low) > 3
    axis.xaxis.set_major_locator(LogLocator(subs=(1,) if is_wide else (1, 2, 5)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def require_own_figure(path: Path) -> None:
    """Raise `OutputExistsError` where `path` holds anything but a figure that `save_figure` wrote."""
    require_own(path, lambda file: None if is_own_drawing(file) else "is no figure of xfreqbench")


def is_own_drawing(path: Path) -> bool:
    """Whether a figure that `save_figure` wrote is at `path`, or a model that `GlbModel` wrote, by the mark in it."""
    if path.suffix == ".glb":
        from xfreqbench.scene.glb_writer import is_own_model

        return is_own_model(path)
    with path.open("rb") as file:
        head = file.read(1024)  # which holds the metadata, after the image's size
        file.seek(max(0, path.stat().st_size - 4096))
        tail = file.read()
    if head.startswith(b"%PDF"):
        return b"/Creator (" + SOFTWARE.encode() in tail
    if path.suffix.lower() == ".svg":
        return f"<dc:title>{SOFTWARE}</dc:title>".encode() in head
    return head.startswith(b"\x89PNG") and b"Software\0" + SOFTWARE.encode() in head


def save_figure(figure: Figure, path: Path, kind: str) -> None:
    """Write a figure as one of `FIGURE_KINDS`; equal figures give equal bytes. Raises `StorageError`."""
    metadata = {
        "png": {"Software": SOFTWARE},
        "svg": {"Date": None, "Creator": SOFTWARE},
        "pdf": {"CreationDate": None, "Creator": SOFTWARE},
    }[kind]
    fixed: Any = {"svg.hashsalt": "xfreqbench", "svg.fonttype": "none", "pdf.fonttype": 42}
    with mpl.rc_context(fixed), any_letters(), atomic_path(path) as temporary, storage_errors(path):
        figure.savefig(temporary, format=kind, metadata=metadata, dpi=150)
        if kind == "svg":
            # where the reader's colours are dark, paper, ink and greys change, and the colours of lines stay
            greys = {"#ffffff": "#14171b", "#000000": "#e6e9ed", "#333333": "#c6cbd1", "#666666": "#a3adb8"}
            rules = "".join(
                f'[style*="{part}: {light}"] {{{part}: {dark} !important}}'
                for part in ("fill", "stroke")
                for light, dark in greys.items()
            )
            dark = f"@media (prefers-color-scheme: dark) {{text {{fill: #e6e9ed}}{rules}}}"
            text = temporary.read_text("utf-8").replace("</style>", f"{dark}</style>", 1)
            temporary.write_text(text, "utf-8")
