"""The page of `xfreqbench view` in a real browser: headless Chromium, driven by Playwright, without a network."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.chromium import WIDTHS, check_screen, launched, needs_chromium, opened, set_screen
from tests.support.synthetic import make_header, transmitters, write_dataset
from xfreqbench.data.generate import generate_planned
from xfreqbench.data.plan import plan_generation
from xfreqbench.data.writer import PasWriter, SampleBlock
from xfreqbench.report.view.plan import plan_view
from xfreqbench.report.view.write import write_view
from xfreqbench.scene.model import load_scene
from xfreqbench.tracing.tracer import TraceSettings

KINDS = ("generated", "imported")

pytestmark = needs_chromium


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("view")
    settings = TraceSettings(interactions=("specular", "refraction"), rays=20_000, max_depth=2)
    plan = plan_generation(load_scene("two_rooms"), [2.4e9, 10e9, 77e9], settings, num_transmitters=12)
    data = {"generated": generate_planned(plan, folder / "rooms.h5"), "imported": _imported(folder)}
    return {kind: write_view(plan_view(str(data[kind])).with_rays(), folder / kind)[0] for kind in KINDS}


def _imported(folder: Path) -> Path:
    told = {"imported_from": "somebody", "convention": {"rows": "polar angle 0 to 90 degrees, " * 6}}
    header = replace(make_header(num_tx=3, pas_kind="amplitude"), channels=False, settings=told)
    maps = write_dataset(folder / "channels.h5", num_tx=3).pas()
    with PasWriter(folder / "maps.h5", header) as writer:
        samples = SampleBlock.of_maps(maps.reshape(3, 3, *maps.shape[1:]))
        writer.append(transmitters(3), np.ones(3, bool), samples)
    return folder / "maps.h5"


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with launched() as browser:
        yield browser


@pytest.fixture(params=KINDS)
def page(browser, pages: dict[str, Path], request: pytest.FixtureRequest) -> Iterator[object]:
    with opened(browser, pages[request.param]) as tab:
        yield tab


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("device", WIDTHS)
def test_nothing_is_wider_than_the_screen(page, device: str, scheme: str) -> None:
    set_screen(page, device, scheme)
    check_screen(page, device, scheme)


def test_every_picture_is_loaded_and_described(page) -> None:
    decode = "async image => { await image.decode(); return [image.naturalWidth, image.alt.length]; }"
    pictures = [picture.evaluate(decode) for picture in page.locator("img").all()]
    assert len(pictures) == 3
    assert all(width > 400 and letters > 20 for width, letters in pictures)


def test_without_webgl_there_is_no_viewer_and_the_picture_stays(page) -> None:
    assert page.locator("#orbit").count() == 1 and not page.locator("#orbit").is_visible()
    assert page.locator("img").first.is_visible()


def test_the_model_is_linked_and_there(page) -> None:
    link = page.locator("a").evaluate("link => link.href")
    assert Path(link.removeprefix("file://")).read_bytes()[:4] == b"glTF"


def test_on_paper_no_figure_is_cut_and_no_table_wider_than_the_sheet(page) -> None:
    page.set_viewport_size({"width": 703, "height": 1000})  # A4 upright, without its margins
    page.emulate_media(media="print")
    widest = "elements => Math.max(...elements.map(element => element.scrollWidth))"
    assert page.locator("table, img").evaluate_all(widest) <= 703


def test_headings_say_what_the_page_holds(page) -> None:
    titles = page.locator("h2").all_inner_texts()
    assert titles[0] == "Scene" and titles[1].startswith("Maps of transmitter ")
    assert titles[2:] == [
        "From carrier to carrier",
        "Protocols it can serve",
        "Load it",
        "Where it comes from",
    ]
