# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The console has one line for each change of a state, and none for a number that runs."""

from io import StringIO
from types import SimpleNamespace

import pytest

from trackslip_common.nodes.health import ERROR, OK, STALE, WARN, Health, StateLog, to_console


class Console:
    """What is logged, at times of the test's own."""

    def __init__(self) -> None:
        self.lines: list[tuple[bytes, str]] = []
        self.time_s = 0.0
        self._states = StateLog(lambda level, text: self.lines.append((level, text)), lambda: self.time_s)

    def see(self, *entries: Health, after_s: float = 1.0) -> None:
        self.time_s += after_s
        self._states.see(entries)


def test_each_change_is_one_line_and_running_numbers_are_none() -> None:
    console = Console()
    console.see(Health(OK, "running"))
    for k in range(5):
        console.see(Health(ERROR, f"sprockets silent for {k}.5 s"))
    console.see(Health(OK, "running"))
    console.see(Health(OK, "running"))
    assert console.lines == [(OK, "running"), (ERROR, "sprockets silent for 0.5 s"), (OK, "running")]


def test_a_part_that_is_reported_no_more_is_over() -> None:
    console = Console()
    running = Health(OK, "running")
    console.see(running)
    console.see(running, Health(WARN, "front window is dirty", part="pollution"))
    console.see(running, Health(WARN, "front window is dirty", part="pollution"))
    console.see(running)
    console.see(running)
    assert console.lines[1:] == [(WARN, "pollution: front window is dirty"), (OK, "pollution: is over")]


def test_what_comes_and_goes_is_logged_once_in_a_while_and_its_end_is_not_lost() -> None:
    console = Console()
    console.see(Health(OK, "running"))
    for k in range(20):
        console.see(Health(*((STALE, "no bytes") if k % 2 else (OK, "running"))), after_s=0.1)
    assert len(console.lines) <= 4
    console.see(Health(STALE, "no bytes"), after_s=2.0)
    assert console.lines[-1] == (STALE, "no bytes")


@pytest.mark.parametrize(("terminal", "before"), [(True, "\r\x1b[K"), (False, "")])
def test_a_line_of_the_log_went_behind_the_bar_on_the_same_line(
    terminal: bool, before: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stderr = StringIO()
    monkeypatch.setattr(stderr, "isatty", lambda: terminal)
    monkeypatch.setattr("sys.stderr", stderr)
    logger = SimpleNamespace(warning=stderr.write)
    to_console(logger)(WARN, "nobody subscribes")
    assert stderr.getvalue() == before + "nobody subscribes"
