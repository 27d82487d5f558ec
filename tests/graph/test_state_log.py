# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The console has one line for each change of a state, and none for a changed number."""

from io import StringIO
from types import SimpleNamespace

import pytest

from trackslip_common.nodes.health import ERROR, OK, STALE, WARN, Health, StateLog, console_logger


class Console:
    """Logged lines, at times that the test sets."""

    def __init__(self) -> None:
        self.lines: list[tuple[bytes, str]] = []
        self.time_s = 0.0
        self._states = StateLog(lambda level, text: self.lines.append((level, text)), lambda: self.time_s)

    def log_changes(self, *entries: Health, after_s: float = 1.0) -> None:
        self.time_s += after_s
        self._states.log_changes(entries)


def test_each_change_of_state_is_one_line_and_counting_is_no_change() -> None:
    console = Console()
    console.log_changes(Health(OK, "running"))
    for k in range(5):
        console.log_changes(Health(ERROR, f"sprockets silent for {k}.5 s"))
    console.log_changes(Health(OK, "running"))
    console.log_changes(Health(OK, "running"))
    assert console.lines == [(OK, "running"), (ERROR, "sprockets silent for 0.5 s"), (OK, "running")]


def test_part_no_longer_reported_is_logged_as_over() -> None:
    console = Console()
    running = Health(OK, "running")
    console.log_changes(running)
    console.log_changes(running, Health(WARN, "front window is dirty", part="pollution"))
    console.log_changes(running, Health(WARN, "front window is dirty", part="pollution"))
    console.log_changes(running)
    console.log_changes(running)
    assert console.lines[1:] == [(WARN, "pollution: front window is dirty"), (OK, "pollution: is over")]


def test_alternating_state_is_logged_rarely_and_its_last_value_is_kept() -> None:
    console = Console()
    console.log_changes(Health(OK, "running"))
    for k in range(20):
        console.log_changes(Health(*((STALE, "no bytes") if k % 2 else (OK, "running"))), after_s=0.1)
    assert len(console.lines) <= 4
    console.log_changes(Health(STALE, "no bytes"), after_s=2.0)
    assert console.lines[-1] == (STALE, "no bytes")


@pytest.mark.parametrize(("terminal", "before"), [(True, "\r\x1b[K"), (False, "")])
def test_log_line_clears_the_progress_bar_on_a_terminal(
    terminal: bool, before: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stderr = StringIO()
    monkeypatch.setattr(stderr, "isatty", lambda: terminal)
    monkeypatch.setattr("sys.stderr", stderr)
    logger = SimpleNamespace(warning=stderr.write)
    console_logger(logger)(WARN, "nobody subscribes")
    assert stderr.getvalue() == before + "nobody subscribes"
