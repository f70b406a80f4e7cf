"""The page in a real browser: headless Chromium, driven by Playwright, with no network asked for."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from io import BytesIO
from itertools import product
from math import inf, isnan
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from tests.support.chromium import WIDTHS, check_screen, launched, needs_chromium, opened, set_screen
from tests.support.leaderboard_records import make_bench, with_job
from tests.support.page_results import HOSTILE, LEARNED, METHODS, SPLITS
from tests.support.stored_records import external, make_record, store
from xfreqbench.methods.trivial import EVERY_TRIVIAL
from xfreqbench.report.drawing.figures import save_figure
from xfreqbench.report.drawing.templates import COLOURS
from xfreqbench.report.leaderboard.page import write_page
from xfreqbench.runs.records import BenchFigure, BenchPoint

pytestmark = needs_chromium

WIDE_BOXES = """async boxes => {
    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));  // a box says it then
    return boxes.map(box => [box.scrollWidth > box.clientWidth, box.matches('.wide')]);
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with launched() as browser:
        yield browser


@pytest.fixture
def page(browser, file: Path) -> Iterator[object]:
    with opened(browser, file) as tab:
        yield tab


def shown_labels(page) -> list[str]:
    rows = page.locator("table.leaderboard:visible tbody tr:visible")
    return rows.evaluate_all("rows => rows.map(row => row.dataset.label)")


def column(page, title: str) -> list[float]:
    """Sorted values of a column from top to bottom; nan where there is none."""
    script = """(table, title) => {
        const heads = [...table.tHead.rows[0].cells];
        const index = heads.findIndex(head => head.textContent.startsWith(title));
        return [...table.tBodies[0].rows].map(row => row.cells[index].dataset.value);
    }"""
    values = page.locator("table.leaderboard:visible").evaluate(script, title)
    return [float(value) if value else float("nan") for value in values]


def head(page, title: str):
    return page.locator("table.leaderboard:visible thead th").filter(has_text=re.compile(f"^{re.escape(title)}"))


def test_clicks_and_keys_sort_by_the_numbers_and_what_is_not_ranked_stays_last(page) -> None:
    head(page, "fit s").locator("button").click()
    seconds = column(page, "fit s")
    assert seconds == sorted(seconds) and seconds[0] != seconds[-1]
    assert head(page, "fit s").get_attribute("aria-sort") == "ascending"
    assert head(page, "average").get_attribute("aria-sort") is None
    head(page, "fit s").locator("button").click()
    assert column(page, "fit s") == seconds[::-1]
    head(page, "method").locator("button").focus()
    page.keyboard.press("Enter")
    assert shown_labels(page) == sorted(shown_labels(page), key=str.lower)
    for direction in ("ascending", "descending"):
        head(page, "rank").locator("button").click()
        *ranks, last = column(page, "rank")
        assert head(page, "rank").get_attribute("aria-sort") == direction
        assert ranks == sorted(ranks, reverse=direction == "descending")
        assert isnan(last) and shown_labels(page)[-1] == "quick"  # it has one seed


def test_names_and_families_filter_table_and_charts_alike(page) -> None:
    page.fill("#filter", "FREQUENCY")
    assert shown_labels(page) == ["mean-over-frequency"]
    assert page.locator("#pareto .point").count() == 1
    page.fill("#filter", "")
    page.uncheck("#families [value=trivial]")
    assert set(shown_labels(page)) == {name for name, *_ in LEARNED}
    page.uncheck("#families [value=learned]")
    assert shown_labels(page) == ["slow (width=9)"]
    assert page.locator("#shown").inner_text() == f"1 of {len(METHODS) + len(LEARNED)} methods shown."
    page.uncheck("#families [value=ablation]")
    assert shown_labels(page) == [] and not page.locator("#charts").is_visible()
    assert page.locator("#none").inner_text().startswith("No row of this table matches the filter.")
    page.locator("#none button").click()
    assert len(shown_labels(page)) == len(METHODS) + len(LEARNED)
    assert page.locator("#charts").is_visible() and not page.locator("#none").is_visible()


def test_another_board_brings_its_own_table_and_charts_and_a_method_keeps_its_colour(page) -> None:
    links, colour = page.locator("#overview a"), "part => part.getAttribute('fill')"
    assert links.count() == page.locator("#board option").count() == 2
    assert "quick: average 0.7500" in links.first.inner_text()  # what is better is an ablation
    before = page.locator('#pareto .point[data-row="nearest"]').evaluate(colour)
    links.filter(has_text="trivial predictors alone").click()
    page.locator("#pareto .point").nth(1).wait_for(state="detached")
    assert shown_labels(page) == ["nearest"]
    assert page.locator("#pareto .point").count() == 1
    assert page.locator('#pareto .point[data-row="nearest"]').evaluate(colour) == before
    assert "One carrier is tested" in page.locator("#carriers").inner_text()
    assert page.locator("#set option").count() == 1
    page.go_back()
    assert len(shown_labels(page)) == len(METHODS) + len(LEARNED)


def test_every_chart_has_a_line_a_method_where_its_numbers_are(page) -> None:
    """Dearer points lie farther right, better ones higher; a free one lies left of all that cost."""
    number = len(METHODS) + len(LEARNED)
    assert page.locator("#pareto .front").count() == 1
    assert page.locator("#cdfs svg").count() == len(SPLITS)
    assert page.locator("#cdfs svg").first.locator(".curve").count() == number
    assert page.locator("#curves svg").first.locator(".curve").count() == len(LEARNED)
    assert page.locator("#curves svg").first.locator(".trivial").count() == 1
    assert page.locator("#legend li").count() == number
    points = page.locator("#pareto .point").all()
    places = {
        point.get_attribute("data-row"): [float(part) for part in re.findall(r"-?[\d.]+", at)]  # right and downwards
        for point in points
        for at in [point.get_attribute("transform")]
    }
    quick, slow = places["quick"], places["slow (width=9)"]
    assert len(places) == number
    assert places["nearest"][0] < quick[0] < places[HOSTILE][0] < slow[0]
    assert slow[1] < quick[1] < places[HOSTILE][1]
    ticks = page.locator("#pareto .tick[text-anchor=middle]").all_text_contents()
    assert ticks == ["1", "10", "100", "1000", "< 0.1"]  # seconds of fitting; some methods need none
    before = page.locator("#cdfs svg").first.inner_html()
    page.select_option("#metric", "aoa_error")
    assert before != page.locator("#cdfs svg").first.inner_html()
    assert "AoA error (°)" in page.locator("#cdfs svg").first.inner_html()


def test_nothing_is_wider_than_the_screen(page) -> None:
    page.locator("#benches summary").click()
    page.wait_for_selector(".bench svg .curve", state="attached")  # measurements are drawn when they are opened
    for device, scheme in product(WIDTHS, ("light", "dark")):
        set_screen(page, device, scheme)
        check_screen(page, device, scheme)
        titles = page.locator("table.leaderboard:visible thead th:visible").all_text_contents()
        assert titles[:4] == ["rank", "method", "average", "skill"]
        for every in (False, True):
            page.locator("#every").set_checked(every)
            told = page.locator(".scroll:visible").evaluate_all(WIDE_BOXES)
            assert all(is_wide == says_so for is_wide, says_so in told)
            assert told[:2] == [[every, every], [False, False]]  # the leaderboard, the overview
        check_screen(page, device, scheme)
        page.locator("#every").uncheck()


def test_a_page_of_real_boards_opens_at_its_top_and_tells_what_competes(browser, tmp_path: Path) -> None:
    """Trivial predictors on two splits, and two methods on one of them; one predictor is far below all others."""
    here, there = {"processor": "here", "cores": "1"}, {"processor": "there", "cores": "1"}
    for split in ("lofo-2.4GHz", "lofo-24.25GHz"):
        for method, ssim in {**dict.fromkeys(EVERY_TRIVIAL, 0.8), "nearest": 0.82, "mean-spectrum": 0.1}.items():
            store(tmp_path, make_record(method, ssim, split, id=method + split, hardware=here))
    for method, ssim in (("ours", 0.9), ("theirs", 0.85), ("ours (a=1)", 0.95)):
        record = make_record(method.partition(" ")[0], ssim, "lofo-24.25GHz", id=method, hardware=there)
        overrides = ("a=1",) if "(" in method else ()
        store(tmp_path, with_job(record, overrides=overrides))
    store(tmp_path, make_record("nearest", 0.8, "sparse-24.25GHz", "sparse"))  # a second board
    with opened(browser, write_page(tmp_path, tmp_path / "page.html")) as page:
        page.wait_for_load_state()
        assert page.evaluate("scrollY") == 0 and "#" not in page.url
        assert "ours: 24.25GHz 0.9000, skill 0.444; best of 2 methods" in page.locator("#overview a").first.inner_text()
        assert shown_labels(page)[:3] == ["ours (a=1)", "ours", "theirs"]
        assert page.locator(".set:visible .badge").count() == 1
        ticks = [float(text) for text in page.locator("#pareto .tick[text-anchor=end]").all_text_contents()]
        assert min(ticks) > 0.7
        assert "mean-spectrum (0.1000)" in page.locator("#off-scale").inner_text()
        assert page.locator('#cdfs [data-row="mean-spectrum"]').count() == 0
        assert page.locator('#pareto .point[data-row="mean-spectrum"]').count() == 1
        paint = "rows => rows.map(row => [row.getAttribute('fill'), row.dataset.row])"
        colour = {row: fill for fill, row in page.locator("#pareto .point").evaluate_all(paint)}
        assert colour["ours"] == colour["ours (a=1)"] and len({*colour.values()}) == len(colour) - 1
        assert {*colour.values()} <= {*COLOURS}
        page.fill("#filter", "spectrum")
        assert page.locator("#off-scale").inner_text() == "" and page.locator("#cdfs .curve").count() == 1


@pytest.mark.parametrize("device", ["desktop", "phone"])
def test_no_name_is_nearer_to_another_mark_unless_a_line_leads_to_its_own(browser, tmp_path: Path, device: str) -> None:
    crowd = {"line-of-sight": (0.868, 0.01), "frequency-embedded-gs": (0.8605, 5.3), "fixed-frequency-gs": (0.858, 5.3)}
    for method, (ssim, seconds) in {**crowd, "xfreq-gs": (0.8625, 7), "ours": (0.906, 14)}.items():
        store(tmp_path, make_record(method, ssim, id=method, fit_seconds=seconds))
    script = """names => names.map(name => {
      const boxOf = part => part.getBoundingClientRect();
      const middles = [...document.querySelectorAll("#pareto .point")].map(mark => [mark.dataset.row, boxOf(mark)])
        .map(([row, box]) => [row, (box.left + box.right) / 2, (box.top + box.bottom) / 2]);
      const box = boxOf(name), beyond = (at, low, high) => Math.max(low - at, at - high, 0);
      const gap = ([row, x, y]) => Math.hypot(beyond(x, box.left, box.right), beyond(y, box.top, box.bottom));
      const least = Math.min(...middles.filter(([row]) => row !== name.dataset.row).map(gap));
      const isLed = name.previousElementSibling.classList.contains("leader");
      return [name.dataset.row, isLed, least - gap(middles.find(([row]) => row === name.dataset.row))];
    })"""
    with opened(browser, write_page(tmp_path, tmp_path / "page.html")) as page:
        set_screen(page, device, "light")
        names = page.locator("#pareto text[data-row]").evaluate_all(script)
    assert len(names) == 5
    assert {name for name, is_led, ahead_px in names if not is_led and ahead_px < -1} == set()


def test_on_paper_and_without_a_script_every_board_has_its_whole_table_and_no_controls(
    browser, page, file: Path
) -> None:
    page.set_viewport_size({"width": 1047, "height": 700})  # A4 across, without its margins
    page.emulate_media(media="print")
    tables = page.locator("table.leaderboard")
    assert tables.evaluate_all("tables => Math.max(...tables.map(table => table.scrollWidth))") <= 1047
    context = browser.new_context(java_script_enabled=False)
    plain = context.new_page()
    plain.goto(file.as_uri())
    for each in (page, plain):
        assert each.locator("table.leaderboard:visible").count() == 2
        assert not each.locator("#board").is_visible()
    context.close()


def test_an_external_row_of_unknown_cost_stands_in_the_table_and_in_no_chart_of_costs(browser, tmp_path: Path) -> None:
    store(tmp_path, make_record("nearest", 0.8), external("lofo-24.25GHz", fit_seconds=3.0))
    with opened(browser, write_page(tmp_path, tmp_path / "page.html")) as page:
        assert shown_labels(page) == ["theirs (external)", "nearest"]
        assert page.locator("#pareto .point").count() == 2
        page.locator("#pareto .point[data-row^=theirs]").hover()
        told = page.locator("#tip").inner_text()
        assert "3 s of fitting" in told and "map" not in told and "parameters" not in told
        page.select_option("#cost", "parameters")
        assert page.locator("#pareto .point").count() == 1
        page.uncheck("#families [value=external]")
        assert shown_labels(page) == ["nearest"]


def test_a_measured_point_that_is_not_finite_is_left_out_of_its_chart(browser, tmp_path: Path) -> None:
    named = ("a", 1.0), ("a", 2.0), ("a", inf), ("b", inf)
    points = [BenchPoint(series=name, label="", x=float(x), y=y) for x, (name, y) in enumerate(named)]
    figure = BenchFigure(x_label="s", y_label="dB", log_x=False, points=tuple(points))
    store(tmp_path, make_record("nearest", 0.8), make_bench(figure=figure))
    with opened(browser, write_page(tmp_path, tmp_path / "page.html")) as page:
        page.locator("#benches summary").click()
        page.locator("#benches path[data-row=a][transform]").first.wait_for()
        assert page.locator("#benches path[data-row=a][transform]").count() == 2
        assert page.locator("#benches path[data-row=b]").count() == 0


def test_what_is_shown_stands_in_the_address_and_an_address_shows_it_again(page) -> None:
    page.uncheck("#families [value=trivial]")
    page.fill("#filter", "s")
    head(page, "fit s").locator("button").click()
    page.select_option("#cost", "parameters")
    page.select_option("#metric", "aoa_error")
    page.check("#every")
    address, labels = page.url, shown_labels(page)
    assert address.partition("#")[2].startswith("board=")
    for said in ("hide=trivial", "filter=s", "sort=fit+s", "cost=parameters", "metric=aoa_error", "columns=all"):
        assert said in address
    page.goto(address.partition("#")[0] + "#nothing")
    assert page.locator("#filter").input_value() == "" and not page.locator("#every").is_checked()
    assert len(shown_labels(page)) == len(METHODS) + len(LEARNED)
    page.goto(address)
    assert shown_labels(page) == labels
    assert head(page, "fit s").get_attribute("aria-sort") == "ascending"
    assert page.locator("#metric").input_value() == "aoa_error"


def test_a_click_on_a_point_opens_its_maps(page) -> None:
    page.locator('#pareto .point[data-row="nearest"]').click()
    assert page.locator("#shown-method").input_value() == "nearest"
    assert "nearest: best, median and worst by SSIM of a dozen" in page.locator("#gallery").inner_text()
    decode = "async image => { image.loading = 'eager'; await image.decode(); return image.naturalWidth; }"
    assert [picture.evaluate(decode) for picture in page.locator(".case .map").all()] == [90] * 9
    page.locator('#pareto .point[data-row="mean-over-frequency"]').focus()
    page.keyboard.press("Enter")
    assert page.locator("#shown-method").input_value() == "mean-over-frequency"


def test_tables_and_charts_can_be_saved(page, tmp_path: Path) -> None:
    page.uncheck("#families [value=learned]")
    with page.expect_download() as download:
        page.locator(".set:visible button.save").click()
    download.value.save_as(tmp_path / "board.csv")
    with (tmp_path / "board.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert download.value.suggested_filename.endswith(".csv")
    assert [row["method"] for row in rows] == shown_labels(page)
    assert [float(row["average"]) for row in rows] == column(page, "average")[: len(rows)]
    head = "const table = document.querySelector('.set table'), text = table.tHead.rows[0].cells[0]; "
    assert page.evaluate(f"() => {{ {head} text.textContent = '=1+1'; return csv(table); }}").startswith("'=1+1,")
    with page.expect_download() as download:
        page.locator("#pareto button.save").click()
    download.value.save_as(tmp_path / "chart.svg")
    drawing = ElementTree.parse(tmp_path / "chart.svg").getroot()
    assert drawing.tag == "{http://www.w3.org/2000/svg}svg"
    painted = [part.get("fill", "") for part in drawing.iter() if part.get("data-row")]
    assert painted and not any("var(" in fill for fill in painted)
    assert page.locator(".panels svg").count() == page.locator(".panels button.save").count()


def test_a_drawn_figure_has_dark_paper_and_light_ink_where_the_reader_has(browser, tmp_path: Path) -> None:
    figure = Figure(figsize=(2, 2))
    figure.text(0.5, 0.5, "█", fontsize=60, ha="center", va="center")
    save_figure(figure, tmp_path / "figure.svg", "svg")
    for scheme, paper, ink in (("light", 255, 0), ("dark", 0x14, 0xE6)):
        tab = browser.new_page(color_scheme=scheme)
        (tmp_path / "page.html").write_text('<meta name="color-scheme" content="light dark"><img src="figure.svg">')
        tab.goto((tmp_path / "page.html").as_uri())
        drawn = np.asarray(Image.open(BytesIO(tab.locator("img").screenshot())).convert("RGB"))[..., 0]
        tab.close()
        assert (drawn[2, 2], drawn[len(drawn) // 2, len(drawn) // 2]) == (paper, ink)
