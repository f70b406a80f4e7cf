"""The page of `xfreqbench view` in a real browser: headless Chromium, driven by Playwright, without a network."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest

from tests.support.chromium import WIDTHS, check_screen, launched, needs_chromium, opened, set_screen
from xfreqbench.data.dataset import PasDataset
from xfreqbench.report.view.plan import plan_view
from xfreqbench.report.view.write import write_view

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with launched() as browser:
        yield browser


@pytest.fixture(params=["generated", "imported"])
def page(
    browser, folder: Path, imported: PasDataset, tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[object]:
    is_imported = request.param == "imported"
    file = write_view(plan_view(str(imported.path)), tmp_path)[0] if is_imported else folder / "index.html"
    with opened(browser, file) as tab:
        yield tab


def test_nothing_is_wider_than_the_screen_and_all_is_there_without_webgl(page) -> None:
    for device, scheme in product(WIDTHS, ("light", "dark")):
        set_screen(page, device, scheme)
        check_screen(page, device, scheme)
    decode = "async image => { await image.decode(); return [image.naturalWidth, image.alt.length]; }"
    pictures = [picture.evaluate(decode) for picture in page.locator("img").all()]
    assert len(pictures) == 3
    assert all(width > 400 and letters > 20 for width, letters in pictures)
    assert page.locator("#orbit").count() == 1 and not page.locator("#orbit").is_visible()
    link = page.locator("a").evaluate("link => link.href")
    assert Path(link.removeprefix("file://")).read_bytes()[:4] == b"glTF"
    page.set_viewport_size({"width": 703, "height": 1000})  # A4 upright, without its margins
    page.emulate_media(media="print")
    widest = "elements => Math.max(...elements.map(element => element.scrollWidth))"
    assert page.locator("table, img").evaluate_all(widest) <= 703
