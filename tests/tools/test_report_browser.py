# SPDX-License-Identifier: Apache-2.0
"""A report in a real browser: it draws, it zooms, its cursor is one, and it asks nobody for anything.

Skipped where there is no Chromium; ``.ci/run`` installs one.
"""

import dataclasses
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from trackslip_tools.report.page import render
from trackslip_tools.report.run import Run

sync_api = pytest.importorskip("playwright.sync_api")

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# As root, with no GPU, and without the errands that a browser runs on its own.
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
DRAWN = "Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle"
EVIL = "<img src=x onerror=alert(1)>"
LEAST_COLOURS = 100  # of a plot with curves; one without has fewer shades of grey


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture
def complaints() -> list[str]:
    """What the browser had to complain about, or asked the network for."""
    return []


@pytest.fixture(scope="module")
def one_run(emulated_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of one run."""
    file = tmp_path_factory.mktemp("report") / "one.html"
    file.write_text(render([emulated_run]), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def comparison(emulated_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two runs, with names that must stay text."""
    file = tmp_path_factory.mktemp("report") / "two.html"
    runs = [dataclasses.replace(emulated_run, label=f"{EVIL}{k}") for k in range(2)]
    file.write_text(render(runs), encoding="utf-8")
    return file


@pytest.fixture
def page(browser: Any, complaints: list[str]) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 1500, "height": 900})
    page = context.new_page()
    page.on("console", lambda m: complaints.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("dialog", lambda dialog: complaints.append(dialog.message))
    page.on("request", lambda r: complaints.append(r.url) if not r.url.startswith("file:") else None)
    yield page
    context.close()


def show(page: Any, file: Path) -> None:
    page.goto(file.as_uri())
    page.wait_for_function(DRAWN)


def shown_range(page: Any, name: str) -> tuple[float, float]:
    """Of the x axis of a plot."""
    script = "name => {const {x_range} = Bokeh.documents[0].get_model_by_name(name); "
    start, end = page.evaluate(f"{script} return [x_range.start, x_range.end]}}", name)
    return start, end


def middle(page: Any, index: int) -> tuple[float, float, float]:
    """x, y and width on the screen of the index-th plot over time."""
    plot = page.locator(".plot").nth(1 + index)
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    return box["x"] + box["width"] / 2.0, box["y"] + 0.6 * box["height"], box["width"]


def test_every_plot_is_drawn_without_a_complaint(page: Any, one_run: Path, complaints: list[str]) -> None:
    show(page, one_run)
    plots = page.locator(".plot")
    roots = page.evaluate("Bokeh.documents[0].roots().length")
    assert plots.count() == roots > 10
    for index in range(roots):
        picture = Image.open(io.BytesIO(plots.nth(index).screenshot())).convert("RGB")
        assert len(picture.getcolors(1_000_000)) > LEAST_COLOURS, page.evaluate(
            "index => Bokeh.documents[0].roots()[index].title.text", index
        )
    assert page.locator("#verdicts tr").count() >= 10
    assert complaints == []


def test_a_zoom_in_one_plot_zooms_all_and_a_double_click_ends_it(
    page: Any, one_run: Path, complaints: list[str]
) -> None:
    show(page, one_run)
    whole = shown_range(page, "time-0")
    x, y, width = middle(page, 2)
    page.mouse.move(x - 0.1 * width, y)
    page.mouse.down()
    page.mouse.move(x + 0.1 * width, y, steps=5)
    page.mouse.up()
    page.wait_for_function(f"Bokeh.documents[0].get_model_by_name('time-0').x_range.end < {whole[1]}")
    start, end = shown_range(page, "time-0")
    assert whole[0] < start < end < whole[1]
    assert end - start == pytest.approx(0.22 * (whole[1] - whole[0]), rel=0.2)
    assert shown_range(page, "time-5") == (start, end)
    for _ in range(20):  # on a busy machine two clicks are too far apart to be a double one
        page.mouse.dblclick(x, y)
        page.wait_for_timeout(500)
        if shown_range(page, "time-5") == whole:
            break
    assert shown_range(page, "time-0") == whole
    assert complaints == []


def test_the_cursor_is_the_same_moment_in_all_plots_and_on_the_path(
    page: Any, one_run: Path, complaints: list[str]
) -> None:
    show(page, one_run)
    x, y, _ = middle(page, 3)
    page.mouse.move(x, y, steps=3)
    page.wait_for_function(
        "[...Bokeh.documents[0].all_models].some(m => m.dimension == 'height' && m.visible)"
    )
    moments = page.evaluate(
        """[...Bokeh.documents[0].all_models]
               .filter(m => m.type == "Span" && m.dimension == "height").map(m => m.location)"""
    )
    assert len(moments) == page.locator(".plot").count() - 1
    assert len(set(moments)) == 1
    start, end = shown_range(page, "time-0")
    assert moments[0] == pytest.approx((start + end) / 2.0, rel=0.1)
    x_there, nearest = page.evaluate(
        """moment => {
               const sources = [...Bokeh.documents[0].all_models].filter(m => m.type == "ColumnDataSource")
               const marker = sources.find(s => s.data.heading?.length == 1).data
               const paths = sources.filter(s => s.data.t && s.data.heading?.length > 1)
               const xs = paths.map(({data}) => data.x[data.t.findLastIndex(t => t <= moment)])
               return [marker.x[0], Math.min(...xs.map(x => Math.abs(x - marker.x[0])))]
           }""",
        moments[0],
    )
    assert x_there > 0.5  # it has left the start
    assert nearest == 0.0
    assert complaints == []


def test_light_and_dark(page: Any, one_run: Path, complaints: list[str]) -> None:
    show(page, one_run)
    title = "Bokeh.documents[0].get_model_by_name('path').title.text_color"
    light = page.evaluate(title)
    page.locator("#theme").click()
    dark = page.evaluate(title)
    assert light != dark
    assert page.locator("html").get_attribute("data-theme") == "dark"
    page.emulate_media(media="print")
    style = "selector => getComputedStyle(document.querySelector(selector))"
    assert page.evaluate(f"{style}.backgroundColor", "body") == "rgb(255, 255, 255)"
    assert page.evaluate(f"{style}.filter", ".plot") == "invert(1) hue-rotate(180deg)"
    page.emulate_media(media="screen")
    page.locator("#theme").click()
    assert page.evaluate(title) == light
    assert complaints == []


def test_names_that_look_like_html_are_text_even_at_the_cursor(
    page: Any, comparison: Path, complaints: list[str]
) -> None:
    show(page, comparison)
    x, y, width = middle(page, 3)
    for share in (-0.1, 0.0, 0.1):
        page.mouse.move(x + share * width, y, steps=3)
    tooltip = page.locator(".bk-Tooltip", has_text=EVIL).first
    tooltip.wait_for()
    assert EVIL in page.locator("#verdicts").inner_text()
    assert page.locator("img").count() == 0
    assert complaints == []
