"""A sound folder of PNG maps and strategies that spoil its files."""

from __future__ import annotations

import functools
import io
import json
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from PIL import Image

from tests.support.fuzzing.common import WORDS, cut_or_flipped, spoilt_json
from tests.support.fuzzing.scenes import edited_bytes


@functools.cache
def png() -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.arange(91 * 361, dtype=np.uint32).reshape(91, 361).astype(np.uint8)).save(buffer, "png")
    return buffer.getvalue()


PNG_FOLDER = {
    "tx_pos.csv": b"x,y,z\n1.0,2.0,3.0\n-1.0,0.0,0.5\n",
    "freq.txt": b"24.25\n24.25\n",
    "gateway_info.yml": b"gateway1:\n  position: [2,1,-0.5]\n  orientation:  [ 0.0, 0.0, 0.0,  1.0]\n",
}


ODD_YAML = [
    *("010", "1:30", "1_0", "0x10", ".inf", ".nan", "~", "yes", "2001-01-01", "=", "<<", "1e1", "٣", "9" * 5000),
    *("*a", "&a", "&a [*a]", "!!python/object/apply:os.abort []", "!!binary 'x'", "!x", "|", ">", "? ", "- ", "{"),
    *("[" * 3000, "%YAML 9.9\n---\n", "---\n", "...\n", "\t", "@", "`", "\0", "\ud800", "\u2028", "#", "'"),
    *('"\\x', "&a {<<: *a}: "),
]


def write_png_folder(folder: Path, **changed: bytes | None) -> None:
    """A sound folder of two maps, but for the files in `changed`; None for one that is not there."""
    (folder / "spectrum").mkdir(parents=True)
    maps = {f"spectrum/0000{number}.png": png() for number in (1, 2)}
    for name, content in {**PNG_FOLDER, **maps, **changed}.items():
        if content is not None:
            (folder / name).write_bytes(content)


def png_folders() -> st.SearchStrategy[dict[str, bytes | None]]:
    """Files that differ from those of a sound folder `maps`, by their paths."""
    texts = st.sampled_from(sorted(PNG_FOLDER)).flatmap(
        lambda name: st.tuples(st.just(name), edited_bytes(PNG_FOLDER[name].decode()) | st.none())
    )
    head = cut_or_flipped(png()[:60]).map(lambda head: head + png()[60:])
    images = st.tuples(
        st.sampled_from([f"spectrum/0000{number}.png" for number in (1, 2, 3)]),
        cut_or_flipped(png()) | head | odd_images() | st.none(),
    )
    files = st.lists(texts | images, min_size=1, max_size=2).map(dict)
    return files.map(lambda found: {f"maps/{name}": content for name, content in found.items()})


def receivers() -> st.SearchStrategy[bytes]:
    """Texts of `gateway_info.yml` with parts that are of another type, gone or added, and with odd texts of YAML."""
    gateway = {"position": [2, 1, -0.5], "orientation": [0.0, 0.0, 0.0, 1.0]}
    spoilt = spoilt_json({"convention": {"rows": "polar", "first_row_deg": 0}, "gateway1": gateway}).map(json.dumps)
    sound = PNG_FOLDER["gateway_info.yml"].decode()
    places = ["2", "[2,1,-0.5]", "gateway1", "gateway1:", "1.0]", "  position", "\n"]
    replaced = st.tuples(st.sampled_from(places), st.sampled_from(ODD_YAML) | WORDS).map(
        lambda change: sound.replace(*change, 1)
    )
    return (spoilt | replaced | replaced).map(lambda text: text.encode("utf-8", "surrogatepass"))


def odd_images() -> st.SearchStrategy[bytes]:
    def image(mode: str, size: tuple[int, int]) -> bytes:
        buffer = io.BytesIO()
        Image.new(mode, size).save(buffer, "png")
        return buffer.getvalue()

    modes, sides = st.sampled_from(["1", "L", "LA", "P", "RGB", "I;16"]), st.sampled_from([1, 2, 91, 361])
    bomb = png()[:16] + (60000).to_bytes(4, "big") * 2 + png()[24:]
    return st.builds(image, modes, st.tuples(sides, sides)) | st.sampled_from([b"", b"GIF89a", bomb])
