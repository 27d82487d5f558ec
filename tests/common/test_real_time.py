# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Warning about missed real time: for machines whose host stalls, not for busy ones."""

import itertools
from types import SimpleNamespace

import pytest
from fixtures import real_time


@pytest.fixture
def watch_of(monkeypatch):
    """A function that returns a watch whose sleeps are late by ``late_s``, repeatedly, for a second."""
    now_s = 0.0

    def make(late_s):
        nonlocal now_s
        late = itertools.cycle(late_s)

        def sleep(duration_s):
            nonlocal now_s
            now_s += duration_s + next(late)

        monkeypatch.setattr("time.monotonic", lambda: now_s)
        monkeypatch.setattr("time.sleep", sleep)
        watch = real_time.Watch()
        while watch.turn() < 1.0:
            pass
        monkeypatch.undo()
        return watch

    return make


@pytest.mark.parametrize(
    ("late_s", "stalls"),
    [((0.0,), False), ((0.0, 0.0, 0.03), False), ((*[0.0] * 20, 0.2), True), ((*[0.0] * 150, 0.32), True)],
)
def test_a_stalled_computer_is_distinguished_from_a_busy_one(watch_of, late_s, stalls):
    assert bool(watch_of(late_s).complaint()) == stalls


@pytest.mark.parametrize(
    ("late_s", "when", "failed", "outcome"),
    [
        (0.4, "call", True, "skipped"),
        (0.4, "call", False, "passed"),
        (0.0, "call", True, "failed"),
        (None, "call", True, "failed"),  # a test that does not ask for real time
        (0.4, "teardown", True, "failed"),
    ],
)
def test_only_failed_tests_on_a_stalled_machine_are_skipped(watch_of, late_s, when, failed, outcome):
    stash = {} if late_s is None else {real_time._WATCH: watch_of((late_s,))}
    item = SimpleNamespace(stash=stash, location=("test_it.py", 7, "test_it"))
    call = SimpleNamespace(excinfo=SimpleNamespace(exconly=lambda: "AssertionError: 49 Hz"), when=when)
    report = SimpleNamespace(outcome="failed" if failed else "passed", failed=failed, longrepr=None)
    hook = real_time.pytest_runtest_makereport(item, call)
    next(hook)
    with pytest.raises(StopIteration) as stop:
        hook.send(report)
    assert stop.value.value.outcome == outcome
    assert ("49 Hz" in str(report.longrepr)) == (outcome == "skipped")
