"""The page of `xfreqbench view` in headless Chromium, with its viewer, drawn on the processor, and without."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

from tests.support.chromium import WIDTHS, canvas_pixels, check_screen, launched, needs_chromium, opened, set_screen
from xfreqbench.data.dataset import PasDataset
from xfreqbench.report.drawing.templates import Picture
from xfreqbench.report.view.figures import ray_colour
from xfreqbench.report.view.page import view_page
from xfreqbench.report.view.plan import RAY_RANGE_DB, ViewPlan, plan_view
from xfreqbench.report.view.write import write_view

pytestmark = needs_chromium

BACKGROUND = (20, 22, 28)
DRAWN = {"scene": [Picture("what is drawn", b"")]}
SMOOTHED = 40  # levels by which a pixel at a line's rim may differ from the line's colour


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Iterator[object]:
    with launched(webgl=getattr(request, "param", True)) as browser:
        yield browser


def num_near(drawn: np.ndarray, colour: tuple[int, ...]) -> int:
    return int((abs(drawn.astype(int) - colour[:3]).max(axis=-1) < SMOOTHED).sum())


def test_room_rays_and_both_ends_are_drawn(browser, folder: Path) -> None:
    with opened(browser, folder / "index.html") as page:
        for device, scheme in (("desktop", "light"), ("phone", "dark")):
            set_screen(page, device, scheme)
            drawn = canvas_pixels(page)
            assert page.locator("#orbit canvas").is_visible()
            assert drawn.shape[1] > 0.8 * {"desktop": 1060, "phone": 366}[device]
            assert 0.1 < (abs(drawn.astype(int) - BACKGROUND).max(axis=-1) > 5).mean() < 0.9
            rim = np.concatenate([drawn[0], drawn[-1], drawn[:, 0], drawn[:, -1]])
            assert abs(rim.astype(int) - BACKGROUND).max() < 5  # the whole room is within
            labels = set(page.locator(".stage span:visible").all_text_contents())
            assert labels >= {"receiver", "transmitter 0", "1", "2", "x: 8 m", "y: 6 m", "z: 2.8 m"}
            for colour in (ray_colour(0.0), (255, 255, 255), (213, 94, 0)):  # strongest ray, transmitter, receiver
                assert num_near(drawn, colour) > 10


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_numbers_of_similarity_are_read_on_their_colours(browser, folder: Path, scheme: str) -> None:
    """By WCAG 2: a contrast of 4.5 or more between a number and what lies under it."""
    script = """texts => texts.map(text => {
      const {left, top, width, height} = text.getBoundingClientRect();
      const here = document.elementsFromPoint(left + width / 2, top + height / 2);
      const below = here.find(each => each.tagName !== "text");
      return [text, below].map(each => getComputedStyle(each).fill.match(/[0-9]+/g).map(Number));
    })"""
    tab = browser.new_page(viewport={"width": 1280, "height": 900}, color_scheme=scheme)
    tab.goto((folder / "carriers.svg").as_uri())
    numbers = tab.locator("text").filter(has_text=re.compile(r"^(0|1)\.\d\d$")).filter(visible=True)
    pairs = [pair for pair in numbers.evaluate_all(script) if pair[1] not in ([255] * 3, [20, 23, 27])]
    tab.close()
    assert len(pairs) == 9  # of three carriers; those of the colour bar lie on paper
    for ink, colour in pairs:
        low, high = sorted((luminance(ink), luminance(colour)))
        assert (high + 0.05) / (low + 0.05) >= 4.5, (ink, colour)


def luminance(colour: list[int]) -> float:
    """Relative luminance of an sRGB colour of levels from 0 to 255."""
    share = np.array(colour[:3]) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def test_drag_wheel_and_keys_turn_it_and_home_brings_it_back(browser, folder: Path) -> None:
    with opened(browser, folder / "index.html") as page:
        seen = [canvas_pixels(page)]
        box = page.locator("#orbit canvas").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 100)
        page.mouse.wheel(0, 100)  # which scrolls the page until the viewer is clicked
        page.evaluate("new Promise(done => scrollY > 0 ? done() : addEventListener('scroll', () => done()))")
        page.evaluate("scrollTo(0, 0)")
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] / 2 + 120, box["y"] + 140)
        page.mouse.up()
        seen.append(canvas_pixels(page))
        for key in ("ArrowLeft", "ArrowUp", "+"):
            page.keyboard.press(key)  # the canvas has the focus since it was dragged
            seen.append(canvas_pixels(page))
        page.mouse.wheel(0, 200)
        seen.append(canvas_pixels(page))
        page.keyboard.press("Home")
        back = canvas_pixels(page)
    changed = [(before != after).any(axis=-1).mean() for before, after in pairwise(seen)]
    assert min(changed) > 0.01
    assert (back == seen[0]).all()


@pytest.mark.parametrize("order", [1, -1], ids=["strong first", "weak first"])
def test_a_strong_ray_is_drawn_over_a_weak_one(browser, view: ViewPlan, tmp_path: Path, order: int) -> None:
    """Two rays along one line: where both are, the strong one's colour is seen and nothing of the weak one."""
    strong = replace(view.room.rays[0], level_db=0.0)
    weak = replace(strong, level_db=-RAY_RANGE_DB)
    found = []
    for rays in ([strong, weak], [weak]):
        shown = replace(view, dataset=None, room=replace(view.room, rays=rays[::order]))
        drawn = tmp_path / f"{len(rays)}.html"
        drawn.write_text(view_page(shown, None, DRAWN, "scene.glb", "pas.png"), "utf-8")
        with opened(browser, drawn) as page:
            found.append([num_near(canvas_pixels(page), ray_colour(ray.level_db)) for ray in (strong, weak)])
    assert found[0][0] > 100 and found[0][1] < 0.1 * found[1][1]


@pytest.mark.parametrize("browser", [False], indirect=True, ids=[""])
@pytest.mark.parametrize("is_imported", [False, True])
def test_nothing_is_wider_than_the_screen_and_all_is_there_without_webgl(
    browser, folder: Path, imported: PasDataset, tmp_path: Path, is_imported: bool
) -> None:
    file = write_view(plan_view(str(imported.path)), tmp_path)[0] if is_imported else folder / "index.html"
    with opened(browser, file) as page:
        for device, scheme in product(WIDTHS, ("light", "dark")):
            set_screen(page, device, scheme)
            check_screen(page, device, scheme)
        boxes = page.locator(".scroll").evaluate_all("boxes => boxes.map(box => box.scrollWidth - box.clientWidth)")
        assert max(boxes) <= 0  # tables and code are whole on a phone
        decode = (
            "async image => { await image.decode(); return [image.width, image.alt.length, image.src.slice(0, 18)]; }"
        )
        pictures = [picture.evaluate(decode) for picture in page.locator("img").all()]
        assert len(pictures) == 1 + 3 + (1 if is_imported else 3)  # the room, maps, and how carriers compare
        for width, letters, kind in pictures:
            assert width > 300 and letters > 20 and kind == "data:image/svg+xml"  # whose paper is the page's
        assert page.locator("#orbit").count() == 1 and not page.locator("#orbit").is_visible()
        link = page.locator("a").evaluate("link => link.href")
        assert Path(link.removeprefix("file://")).read_bytes()[:4] == b"glTF"
        page.set_viewport_size({"width": 703, "height": 1000})  # A4 upright, without its margins
        page.emulate_media(media="print")
        widest = "elements => Math.max(...elements.map(element => element.scrollWidth))"
        assert page.locator("table, img").evaluate_all(widest) <= 703
