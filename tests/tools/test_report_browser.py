# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A report in a real browser: it draws, zooms, scrolls by touch, and makes no network request."""

import dataclasses
import io
from pathlib import Path
from typing import Any

import pytest
from fixtures.browser import EVIL, OpenPage, scroll_with_a_finger
from PIL import Image

from trackslip_tools.report.events import Event
from trackslip_tools.report.lights import Level
from trackslip_tools.report.page import render
from trackslip_tools.report.recording import Recording
from trackslip_tools.report.run import Run
from trackslip_tools.report.state_intervals import StateInterval
from trackslip_tools.report.verdict import load_limits

DRAWN = "document.documentElement.dataset.drawn === 'all' && Bokeh.documents[0].is_idle"
CURSORS = "[...Bokeh.documents[0].all_models].filter(m => m.dimension == 'height')"
CURSOR = f"{CURSORS}.some(m => m.visible)"
MATHS = "$$\\href{javascript:alert(1)}{x}$$"
ENDING = "</script><script>alert(1)</script>"
DESK, TABLET = 1500, 1024
LEAST_COLOURS = 100  # of a plot with curves; a plot without has fewer shades of grey


@pytest.fixture(scope="module")
def one_run(emulated_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of one run."""
    file = tmp_path_factory.mktemp("report") / "one.html"
    file.write_text(render([emulated_run], load_limits()), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def comparison(emulated_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two runs with markup in names and reasons, which must remain text."""
    file = tmp_path_factory.mktemp("report") / "two.html"
    recording = hostile(emulated_run.recording)
    runs = [
        dataclasses.replace(emulated_run, label=f"{EVIL}{MATHS}{k}", recording=recording) for k in range(2)
    ]
    file.write_text(render(runs, load_limits()), encoding="utf-8")
    return file


def hostile(recording: Recording) -> Recording:
    """A recording with markup and scripts in topics, lights and reasons."""
    (timing, *_) = recording.timings.values()
    names = (EVIL, MATHS, ENDING)
    return dataclasses.replace(
        recording,
        path=f"{EVIL}{ENDING}",
        timings={**recording.timings, **dict.fromkeys(names, timing)},
        lights={name: [StateInterval(1.0, 40.0, int(Level.ERROR), f"{EVIL}{MATHS}")] for name in names},
        events=[Event(0, 2000.0, Level.ERROR, f"{EVIL}{ENDING}")],
    )


@pytest.fixture(scope="module")
def opened_on_desk(open_shared: OpenPage, one_run: Path) -> Any:
    return show(open_shared(DESK, "file:"), one_run)


@pytest.fixture(scope="module")
def opened_on_tablet(open_shared: OpenPage, one_run: Path) -> Any:
    return show(open_shared(TABLET, "file:"), one_run)


@pytest.fixture
def page(opened_on_desk: Any) -> Any:
    """The shared report of one run: scrolled to the top, no time selected, the mouse off the plots."""
    opened_on_desk.mouse.move(0.0, 0.0)
    opened_on_desk.evaluate(f"scrollTo(0, 0); {CURSORS}.forEach(m => {{m.visible = false}})")
    return opened_on_desk


def show(page: Any, file: Path) -> Any:
    """Open the file; the page once it is drawn completely."""
    page.goto(file.as_uri())
    page.wait_for_function(DRAWN)
    return page


def shown_range(page: Any, name: str) -> tuple[float, float]:
    """Range of the x axis of a plot."""
    script = "name => {const {x_range} = Bokeh.documents[0].get_model_by_name(name); "
    start, end = page.evaluate(f"{script} return [x_range.start, x_range.end]}}", name)
    return start, end


def middle(page: Any, index: int) -> tuple[float, float, float]:
    """x and y of a point in the index-th time plot, and the plot's width, on the screen."""
    plot = page.locator(".plot").nth(1 + index)
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    return box["x"] + box["width"] / 2.0, box["y"] + 0.6 * box["height"], box["width"]


def test_every_plot_is_drawn_without_a_complaint(opened_on_tablet: Any, complaints: list[str]) -> None:
    page = opened_on_tablet
    plots = page.locator(".plot")
    roots = page.evaluate("Bokeh.documents[0].roots().length")
    assert plots.count() == roots > 10
    boxes = plots.evaluate_all(
        """elements => elements.map(element => {
               const {left, top, right, bottom} = element.getBoundingClientRect()
               return [left, top + scrollY, right, bottom + scrollY]
           })"""
    )
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
    for index, box in enumerate(boxes):
        assert len(picture.crop(box).getcolors(1_000_000)) > LEAST_COLOURS, page.evaluate(
            "index => Bokeh.documents[0].roots()[index].title.text", index
        )
    assert page.locator("#verdicts tr").count() >= 10
    assert complaints == []


@pytest.mark.slow
def test_a_zoom_in_one_plot_zooms_all_and_a_double_click_ends_it(page: Any, complaints: list[str]) -> None:
    whole = shown_range(page, "time-0")
    for _ in range(5):  # on a busy machine the layout may still move the plot
        x, y, width = middle(page, 2)
        page.mouse.move(x - 0.1 * width, y)
        page.mouse.down()
        page.mouse.move(x + 0.1 * width, y, steps=5)
        page.mouse.up()
        page.wait_for_timeout(300)
        start, end = shown_range(page, "time-0")
        if (start, end) != whole:
            break
    assert whole[0] < start < end < whole[1]
    assert end - start == pytest.approx(0.22 * (whole[1] - whole[0]), rel=0.2)
    assert shown_range(page, "time-5") == (start, end)
    for _ in range(20):  # on a busy machine two clicks may be too far apart for a double click
        page.mouse.dblclick(x, y)
        page.wait_for_timeout(500)
        if shown_range(page, "time-5") == whole:
            break
    assert shown_range(page, "time-0") == whole
    assert complaints == []


@pytest.mark.slow
def test_the_cursor_is_the_same_moment_in_all_plots_and_on_the_path(page: Any, complaints: list[str]) -> None:
    x, y, _ = middle(page, 3)
    page.mouse.move(x, y, steps=3)
    page.wait_for_function(CURSOR)
    moments = page.evaluate(
        """[...Bokeh.documents[0].all_models]
               .filter(m => m.type == "Span" && m.dimension == "height").map(m => m.location)"""
    )
    assert len(moments) == page.locator(".plot").count() - 1
    assert len(set(moments)) == 1
    start, end = shown_range(page, "time-0")
    assert moments[0] == pytest.approx((start + end) / 2.0, rel=0.2)  # the left margin is wider
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
    assert x_there > 0.5  # away from the start
    assert nearest == 0.0
    assert complaints == []


@pytest.mark.slow
def test_light_and_dark(page: Any, complaints: list[str]) -> None:
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


@pytest.mark.slow
def test_names_and_reasons_that_look_like_html_are_text_even_at_the_cursor(
    open_page: OpenPage, comparison: Path, complaints: list[str]
) -> None:
    page = show(open_page(DESK, "file:"), comparison)
    x, y, width = middle(page, 3)
    for share in (-0.1, 0.0, 0.1):
        page.mouse.move(x + share * width, y, steps=3)
    page.locator(".bk-Tooltip", has_text=EVIL).first.wait_for()
    strip = page.locator('[data-plot="time-2"]')  # the lights
    strip.scroll_into_view_if_needed()
    box = strip.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2.0, box["y"] + 0.45 * box["height"], steps=3)
    page.locator(".bk-Tooltip", has_text=f"error {EVIL}").first.wait_for()
    assert EVIL in page.locator("#verdicts").inner_text()
    assert f"{EVIL}{ENDING}" in page.locator("#events").inner_text()
    assert page.locator("img").count() == 0
    assert page.evaluate("typeof MathJax") == "undefined"
    assert complaints == []


def test_one_finger_scrolls_a_button_zooms_and_a_tap_chooses_the_moment(
    opened_on_tablet: Any, complaints: list[str]
) -> None:
    page = opened_on_tablet
    whole, path = shown_range(page, "time-0"), shown_range(page, "path")
    for plot in ('[data-plot="path"]', '[data-plot="time-3"]'):
        scroll_with_a_finger(page, plot)
    assert (shown_range(page, "time-0"), shown_range(page, "path")) == (whole, path)
    x, y, _ = middle(page, 3)
    page.touchscreen.tap(x, y)
    page.wait_for_function(CURSOR)
    page.locator("#time-zoom [data-zoom='0.5']").tap()
    start, end = shown_range(page, "time-5")
    assert end - start == pytest.approx(0.5 * (whole[1] - whole[0]))
    page.locator("#time-zoom [data-shift='0.5']").tap()
    assert shown_range(page, "time-0")[0] == pytest.approx((start + end) / 2.0)
    page.locator("#time-zoom [data-zoom='0']").tap()
    assert shown_range(page, "time-0") == whole
    page.locator("#path-zoom [data-zoom='0.625']").tap()
    start, end = shown_range(page, "path")
    assert end - start == pytest.approx(0.625 * (path[1] - path[0]), rel=1e-3)
    assert complaints == []


@pytest.mark.slow
def test_the_first_swipe_after_a_mouse_scrolls_too(opened_on_tablet: Any, complaints: list[str]) -> None:
    """The tools of the mouse do not capture the first swipe."""
    page = opened_on_tablet
    whole = shown_range(page, "time-0")
    x, y, _ = middle(page, 3)
    page.mouse.move(x, y, steps=3)
    page.wait_for_function(
        "[...Bokeh.documents[0].all_models].some(m => m.type == 'BoxZoomTool' && m.active)"
    )
    scroll_with_a_finger(page, '[data-plot="time-3"]')
    assert shown_range(page, "time-0") == whole
    assert complaints == []


@pytest.mark.slow
def test_on_a_wide_screen_the_path_stays_beside_the_plots_over_time(page: Any, complaints: list[str]) -> None:
    later = page.locator('[data-plot="time-8"]')
    later.scroll_into_view_if_needed()
    path, beside = page.locator('[data-plot="path"]').bounding_box(), later.bounding_box()
    assert path["y"] >= 0.0
    assert path["y"] + path["height"] <= page.viewport_size["height"]
    assert path["x"] + path["width"] <= beside["x"]
    assert complaints == []
