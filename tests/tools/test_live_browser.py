# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page in a real browser with touch: it follows, scrolls, reconnects, and runs no foreign code."""

import itertools
import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from fixtures import live_messages as messages
from fixtures.browser import EVIL, WIDTHS, OpenPage, scroll_with_a_finger

from trackslip_common.vehicle_files import load_vehicle
from trackslip_tools.live.page import ServedFile, page_files
from trackslip_tools.live.parameters import LiveParameters
from trackslip_tools.live.server import PageServer
from trackslip_tools.live.state import PERIOD, LiveState

ROWS = "rows => Bokeh.documents[0].get_model_by_name('line-0').data.value.length > rows"
FOLLOWS = "frames => Number(document.documentElement.dataset.frames) > frames"


COLOURS = """() => {
  const found = []
  const look = (selector, property) =>
    document.querySelectorAll(selector).forEach(element => found.push(getComputedStyle(element)[property]))
  for (const part of ["[data-fact]", "#clock", ".number", "#lights .name", "#lights .state", "#lights small",
                      "#classes span", "#events li", "#events time"]) look(part, "color")
  for (const part of ["#lights .light", "#events li"]) look(part, "borderLeftColor")
  for (const part of [".gauge .fill", ".gauge .interval"]) look(part, "backgroundColor")
  return found
}"""
SINCE = r"no data since \d\d:\d\d:\d\d \(\d+ s\)"


class Machine:
    """A driving machine with a page server; nodes in ``quiet`` send no diagnostics."""

    def __init__(self, pages: dict[str, ServedFile], port: int = 0, name: str = "can_driver") -> None:
        self.state = LiveState(f"a test of {EVIL}", load_vehicle())
        self.quiet: set[str] = set()
        self.sent: Callable[[dict[str, Any]], dict[str, Any]] = lambda frame: frame  # may replace a frame
        self.name = name
        self.server = PageServer(
            pages, self.state.full_state, LiveParameters(host="127.0.0.1", port=port, origins=())
        )
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._drive, daemon=True)
        self.server.start()
        self._thread.start()

    def stop(self) -> None:
        if not self._over.is_set():
            self._over.set()
            self._thread.join()
            self.server.stop()

    def _drive(self) -> None:
        began = time.monotonic()
        while not self._over.wait(PERIOD):
            now_s = time.monotonic() - began
            self.state.process("odometry", messages.odometry(0.4 * now_s, 0.02 * now_s**2), now_s)
            self.state.process("track_slip", messages.track_slip(0.2, -0.02, 3), now_s)
            self.state.process("soil", messages.soil(**{EVIL: 0.7, "clay": 0.3}), now_s)
            self.state.process("box_pose", messages.fix(0.4 * now_s, 0.0), now_s)
            for node, level in ((self.name, 0), (f"sick {EVIL}", 2)):
                if node not in self.quiet:
                    status = messages.diagnostics(node, level, f"reason {EVIL}", **{"rate (Hz)": "100.0"})
                    self.state.process("diagnostics", status, now_s)
            if frame := self.sent(self.state.next_frame(now_s, 1e3 * time.time())):
                self.server.push(frame)


@pytest.fixture(scope="module")
def pages() -> dict[str, ServedFile]:
    return page_files(f"Trackslip: {EVIL}")


@pytest.fixture(scope="module")
def machine(pages: dict[str, ServedFile]) -> Iterator[Machine]:
    """A machine for all tests, which leave it as it was."""
    running = Machine(pages)
    yield running
    running.stop()


@pytest.fixture(scope="module")
def phone(open_shared: OpenPage, machine: Machine) -> Any:
    return opened(open_shared, machine, WIDTHS[0])


def opened(opens: OpenPage, machine: Machine, width: int) -> Any:
    """The page at a width, once it follows."""
    page = opens(width, machine.server.address)
    page.goto(machine.server.address)
    follows(page, 2)
    return page


def follows(page: Any, frames: int) -> None:
    """Wait until so many more frames are shown."""
    before = page.evaluate("Number(document.documentElement.dataset.frames ?? 0)")
    page.wait_for_function(FOLLOWS, arg=before + frames)


def is_grey(page: Any) -> bool:
    """Whether all values and lights are grey, and none is black."""
    shades = [re.findall(r"\d+", colour)[:3] for colour in page.evaluate(COLOURS)]
    return all(red == green == blue != "0" for red, green, blue in shades)


@pytest.mark.slow
def test_three_pages_follow_the_machine_at_the_same_time(
    open_page: OpenPage, machine: Machine, complaints: list[str]
) -> None:
    shown = [opened(open_page, machine, width) for width in WIDTHS]
    places = [page.locator('[data-fact="position"]').inner_text() for page in shown]
    for page, width in zip(shown, WIDTHS, strict=True):
        follows(page, 5)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        trail = page.evaluate("Bokeh.documents[0].get_model_by_name('trail').data.x.length")
        assert trail > 1
        page.locator("#strip-0").scroll_into_view_if_needed()
        page.wait_for_function(ROWS, arg=15)
    for page in shown:
        page.wait_for_selector("#link >> text=live")
    assert [page.locator('[data-fact="position"]').inner_text() for page in shown] != places
    assert shown[0].locator('.gauge[data-line="0"] .number').inner_text() == "20.0 ± 2.0 %"
    assert complaints == []


def test_fingers_scroll_and_buttons_zoom_and_choose_the_time(phone: Any, complaints: list[str]) -> None:
    page = phone
    for plot in ("#path", "#strip-0"):
        scroll_with_a_finger(page, plot)
    path = "(({start, end}) => end - start)(Bokeh.documents[0].get_model_by_name('path').x_range)"
    page.locator("#wider").tap()
    page.locator("#wider").tap()
    wide = page.evaluate(path)
    page.locator("#closer").tap()
    assert page.evaluate(path) < wide
    page.locator("#all").tap()
    times = "(({start, end}) => end - start)(Bokeh.documents[0].get_model_by_name('time-0'))"
    page.locator('[data-seconds="240"]').tap()
    page.locator("#strip-0").scroll_into_view_if_needed()
    follows(page, 10)
    assert page.evaluate(times) == 240_000
    assert complaints == []


def test_a_silent_light_turns_and_names_that_look_like_html_are_text(
    phone: Any, machine: Machine, complaints: list[str]
) -> None:
    page = phone
    page.wait_for_selector(".light.ok >> text=can_driver")
    machine.quiet.add("can_driver")
    page.wait_for_selector(".light.silent >> text=can_driver")
    page.wait_for_selector("#events .silent >> text=can_driver")
    machine.quiet.clear()
    page.wait_for_selector(".light.ok >> text=can_driver")
    assert EVIL in page.locator("#lights").inner_text()
    assert EVIL in page.locator("#events").inner_text()
    assert EVIL in page.locator("#classes").inner_text()
    assert EVIL in page.locator("#source").inner_text()
    assert page.title() == f"Trackslip: {EVIL}"
    assert page.locator("img").count() == 0
    assert complaints == []


def test_page_is_grey_without_its_server_and_reconnects(
    open_page: OpenPage, pages: dict[str, ServedFile]
) -> None:
    machine = Machine(pages)
    page = opened(open_page, machine, WIDTHS[0])
    coloured = set(page.evaluate(COLOURS))
    assert not is_grey(page)
    machine.stop()
    page.wait_for_selector("#link.silent >> text=no data")
    assert is_grey(page)
    assert re.fullmatch(SINCE, page.locator("#link").inner_text())
    frozen = page.locator("#lights").inner_text(), page.locator("#link").inner_text()[:22]
    assert "s ago" in frozen[0]
    page.wait_for_timeout(1500)
    assert (page.locator("#lights").inner_text(), page.locator("#link").inner_text()[:22]) == frozen
    again = Machine(pages, machine.server.port, name="another_driver")
    page.wait_for_selector(".light.ok >> text=another_driver")
    page.wait_for_selector("#link.ok")
    follows(page, 3)
    assert set(page.evaluate(COLOURS)) == coloured
    again.stop()


@pytest.mark.slow
@pytest.mark.parametrize("sent", [{}, {"number": 1e9}], ids=["nothing", "frames that cannot be shown"])
def test_page_is_grey_while_its_server_sends_nothing_that_is_shown(
    sent: dict[str, Any], phone: Any, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = phone
    monkeypatch.setattr(machine, "sent", lambda _: sent)
    page.wait_for_selector("#link.silent >> text=no data")
    assert is_grey(page)
    monkeypatch.undo()
    page.wait_for_selector("#link.ok")
    assert not is_grey(page)


@pytest.mark.slow
def test_last_values_stay_at_the_end_of_a_bag(
    open_page: OpenPage, pages: dict[str, ServedFile], complaints: list[str]
) -> None:
    machine = Machine(pages)
    page = opened(open_page, machine, WIDTHS[0])
    follows(page, 20)
    ended = machine.state.final_frame("end of the bag")
    numbers = itertools.count(ended["number"] + 1000)
    machine.sent = lambda _: ended | {"number": next(numbers)}
    page.wait_for_selector("#link >> text=end of the bag")
    texts = [
        page.locator(part).inner_text() for part in ("#clock", "#lights", "dl >> nth=0", ".gauge >> nth=0")
    ]
    points = page.evaluate("Bokeh.documents[0].get_model_by_name('line-0').data.value.length")
    follows(page, 30)  # four seconds
    assert texts == [
        page.locator(part).inner_text() for part in ("#clock", "#lights", "dl >> nth=0", ".gauge >> nth=0")
    ]
    assert "20.0 ± 2.0 %" in texts[-1]
    assert page.evaluate("Bokeh.documents[0].get_model_by_name('line-0').data.value.length") == points
    assert page.locator("#link.ended").inner_text() == "end of the bag"
    assert not is_grey(page)
    assert complaints == []
    machine.stop()


@pytest.mark.slow
def test_page_that_found_no_description_asks_again(open_page: OpenPage, machine: Machine) -> None:
    page = open_page(390, machine.server.address)
    page.route("**/page.json", lambda route: route.abort(), times=2)
    page.goto(machine.server.address)
    follows(page, 2)
