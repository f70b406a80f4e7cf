"""The page of `xfreqbench view` in headless Chromium, with its viewer, drawn on the processor, and without."""

from __future__ import annotations

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
from xfreqbench.report.view.plan import ViewPlan, plan_view
from xfreqbench.report.view.room import RAY_RANGE_DB
from xfreqbench.report.view.write import write_view

pytestmark = needs_chromium

BACKGROUND = (20, 22, 28)
DRAWN = {"scene.png": Picture("scene.png", "what is drawn", b"")}
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
            for colour in (ray_colour(0.0), (255, 255, 255), (213, 94, 0)):  # strongest ray, transmitter, receiver
                assert num_near(drawn, colour) > 10


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
        drawn.write_text(view_page(shown, None, DRAWN, "scene.glb"), "utf-8")
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
