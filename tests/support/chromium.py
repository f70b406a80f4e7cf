"""Headless Chromium, driven by Playwright: what the tests of our pages open them with, without a network."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install '.[dev]'")
_CHROMIUM = shutil.which("chromium")
_FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
_WITHOUT_WEBGL = ("--disable-gpu", "--disable-3d-apis")
_WITH_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")  # on the processor
WIDTHS = {"desktop": (1280, 900), "phone": (390, 844)}
needs_chromium = pytest.mark.skipif(_CHROMIUM is None, reason="there is no chromium (Debian: apt-get install chromium)")


@contextmanager
def launched(webgl: bool = False) -> Iterator[Any]:
    """A browser, closed at the end; with `webgl` it draws in 3D, on the processor."""
    flags = [*_FLAGS, *(_WITH_WEBGL if webgl else _WITHOUT_WEBGL)]
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=flags)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, file: Path) -> Iterator[Any]:
    """A page in a fresh tab; whatever it complains of, or asks for besides itself, fails the test."""
    tab = browser.new_page(viewport=dict(zip(("width", "height"), WIDTHS["desktop"], strict=True)))
    tab.set_default_timeout(20_000)  # milliseconds; a broken page would else take minutes to fail
    complaints: list[str] = []
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("dialog", lambda dialog: complaints.append(f"dialog {dialog.message}") or dialog.dismiss())
    tab.on("request", lambda request: complaints.append(request.url) if _is_foreign(request.url, file) else None)
    tab.goto(file.as_uri())
    yield tab
    tab.close()
    assert complaints == []


def check_screen(page: Any, device: str, scheme: str) -> None:
    """Fails where a page is wider than a device's screen, or not in the colours asked for."""
    width, _ = WIDTHS[device]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    assert dark == (scheme == "dark")


def set_screen(page: Any, device: str, scheme: str) -> None:
    """The screen of a device, and light or dark colours."""
    page.set_viewport_size(dict(zip(("width", "height"), WIDTHS[device], strict=True)))
    page.emulate_media(color_scheme=scheme)


def canvas_pixels(page: Any) -> np.ndarray:
    """What the canvas of the orbit viewer shows within its rim, (rows, columns, 3), once it is drawn and rests."""
    last = b""
    for _ in range(50):
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        shot = page.locator("#orbit canvas").screenshot()
        drawn = np.asarray(Image.open(BytesIO(shot)).convert("RGB"))[5:-5, 5:-5]  # focus is shown around it
        if shot == last and drawn.std() > 1:  # a canvas that is not drawn yet has one colour
            return drawn
        last = shot
    raise AssertionError("the canvas is never drawn, or never rests")


def _is_foreign(url: str, file: Path) -> bool:
    return url != file.as_uri() and not url.startswith("data:")
