"""A sound folder of PNG maps and strategies that spoil its files."""

from __future__ import annotations

import functools
import io

import numpy as np
from hypothesis import strategies as st
from PIL import Image

from tests.support.fuzzing.common import cut_or_flipped
from tests.support.fuzzing.scenes import edited


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


def png_folders() -> st.SearchStrategy[tuple[dict[str, bytes | None], list[str]]]:
    """Files that differ from those of a sound folder, and options of the command."""
    texts = st.sampled_from(sorted(PNG_FOLDER)).flatmap(
        lambda name: st.tuples(st.just(name), spoilt_text(PNG_FOLDER[name]) | st.none())
    )
    images = st.tuples(
        st.sampled_from(["spectrum/00001.png", "spectrum/00002.png", "spectrum/00003.png"]),
        cut_or_flipped(png())
        | cut_or_flipped(png()[:60]).map(lambda head: head + png()[60:])
        | odd_images()
        | st.none(),
    )
    options = st.sampled_from(
        [
            [],
            [],
            [],
            ["--convention", "mine"],
            ["--set", "plane=zz"],
            ["--set", "x"],
            ["--set", "rows="],
            ["--set", "=1"],
            ["--freq", "nan"],
            ["--freq", "-1"],
            ["--freq", "1e300"],
            ["--freq", "x"],
            ["--freq", "5"],
        ]
    )
    return st.tuples(st.lists(texts | images, min_size=1, max_size=2).map(dict), options)


def spoilt_text(text: bytes) -> st.SearchStrategy[bytes]:
    return edited(text.decode()).map(lambda changed: changed.encode("utf-8", "surrogateescape"))


def odd_images() -> st.SearchStrategy[bytes]:
    def image(mode: str, size: tuple[int, int]) -> bytes:
        buffer = io.BytesIO()
        Image.new(mode, size).save(buffer, "png")
        return buffer.getvalue()

    modes, sides = st.sampled_from(["1", "L", "LA", "P", "RGB", "I;16"]), st.sampled_from([1, 2, 91, 361])
    bomb = png()[:16] + (60000).to_bytes(4, "big") * 2 + png()[24:]
    return st.builds(image, modes, st.tuples(sides, sides)) | st.sampled_from([b"", b"GIF89a", bomb])
