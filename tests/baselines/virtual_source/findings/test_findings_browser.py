"""The page of findings in headless Chromium: it fits screens, draws true and learned surfaces, and hides either."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from xfreqbench.baselines.virtual_source.commands import compare_findings as findings_command

from tests.support.chromium import WIDTHS, canvas_pixels, check_screen, launched, needs_chromium, opened, set_screen
from tests.support.found_box import found_room
from tests.support.stored_records import make_record
from xfreqbench.data.dataset import PasDataset
from xfreqbench.runs.records import append

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with launched(webgl=True) as browser:
        yield browser


@pytest.fixture(scope="module", params=[False, True], ids=["found", "room"])
def file(request: pytest.FixtureRequest, box: PasDataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("findings")
    findings = {**found_room(error_m=0.02), "images": [{"planes": [0], "power": 0.1}]}
    append(folder / "records.jsonl", make_record("virtual-source", dataset_sha256=box.sha256, findings=findings))
    room = folder / "room" if request.param else None
    findings_command(folder, data=box.path, output=folder / "out", room=room, refine=False, quiet=True)
    return folder / "out" / "index.html"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("device", WIDTHS)
def test_the_page_fits_the_screen_with_its_figures(browser, file: Path, device: str, scheme: str) -> None:
    with opened(browser, file) as page:
        set_screen(page, device, scheme)
        check_screen(page, device, scheme)
        sizes = page.evaluate("[...document.images].map((each) => [each.naturalWidth, each.width])")
        assert len(sizes) == 2 and all(natural > 0 and width > 300 for natural, width in sizes)
        if device == "desktop":  # letters are as large as they were drawn
            assert all(width >= 800 for _, width in sizes)


def test_each_layer_is_drawn_and_hidden_by_its_box(browser, file: Path) -> None:
    with opened(browser, file) as page:
        before = canvas_pixels(page)
        for box in page.locator("#orbit input").all():
            box.uncheck()
            hidden = canvas_pixels(page)
            assert (hidden != before).any(axis=-1).sum() > 20, box.get_attribute("name")
            box.check()
            assert (canvas_pixels(page) == before).all()


def test_planes_materials_and_the_traced_room_are_told(browser, file: Path) -> None:
    with opened(browser, file) as page:
        text = page.locator("body").inner_text()
        for said in ("7 of 7 planes that were found are the scene's", "plasterboard 20 mm", "glass 10 mm", "20.00"):
            assert said in text
        has_room = (file.parent.parent / "room").exists()
        assert ("traced in the room, as found" in text) == has_room
