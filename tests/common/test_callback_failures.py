# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions of callbacks are counted, reported and logged without a flood; the node ends only after many."""

import functools
import inspect

import pytest

from trackslip_common.nodes.failures import (
    LOG_PERIOD_S,
    MIN_STREAK,
    PAUSE_S,
    RECENT_S,
    STREAK_S,
    CallbackFailures,
    describe_exception,
)
from trackslip_common.nodes.health import ERROR, OK


class Clock:
    """A clock in seconds, set by the test."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def log():
    return []


@pytest.fixture
def failures(clock, log):
    return CallbackFailures(log.append, clock)


def fail(number=0):
    if number >= 0:
        raise ValueError(f"bad\nvalue {number}")
    return "done"


def test_exception_in_a_callback_is_counted_and_reported(failures, clock):
    guarded = failures.guard(fail, "scan")
    assert failures.health() == []
    assert guarded(-1) == "done"
    assert failures.health() == []
    for _ in range(3):
        assert guarded(7) is None
    clock.now += 2.0
    (entry,) = failures.health()
    assert (entry.level, entry.part) == (ERROR, "callbacks")
    assert entry.message.startswith("3 callbacks failed; the last: scan: ValueError: bad value 7 (")
    assert entry.values["failed: scan"] == 3
    assert entry.values["age of the last failure (s)"] == "2.0"
    clock.now += RECENT_S
    (entry,) = failures.health()
    assert (entry.level, entry.values["failed: scan"]) == (OK, 3)


def test_the_same_cause_is_logged_again_only_after_a_while(failures, clock, log):
    guarded = failures.guard(fail, "scan")
    for number in range(100):  # with a text of its own each
        guarded(number)
    assert len(log) == 1
    assert "scan: ValueError: bad value 0 (test_callback_failures.py:" in log[0]
    failures.guard(int, "scan")("x")
    failures.guard(fail, "imu")()
    assert len(log) == 3
    clock.now += LOG_PERIOD_S
    guarded()
    assert len(log) == 4


def repeat(guarded, clock, seconds, step=0.5):
    for _ in range(round(seconds / step)):
        guarded()
        clock.now += step


@pytest.mark.parametrize(
    ("duration", "step", "is_long"),
    [
        (STREAK_S, 0.5, False),
        (STREAK_S + 0.5, 0.5, True),
        (10.0 * STREAK_S, PAUSE_S + 0.1, False),  # rare
        (STREAK_S + PAUSE_S, PAUSE_S, False),  # few
    ],
)
def test_many_uninterrupted_failures_are_a_long_streak(failures, clock, duration, step, is_long):
    repeat(failures.guard(fail, "scan", handles_data=True), clock, duration, step)
    assert failures.has_long_streak == is_long


@pytest.mark.parametrize("handles_data", [False, True], ids=["timer", "message"])
def test_only_a_message_handled_well_ends_the_streak(failures, clock, handles_data):
    guarded = failures.guard(fail, "scan", handles_data=True)
    other = failures.guard(lambda: None, "other", handles_data=handles_data)
    for _ in range(MIN_STREAK + 1):
        repeat(guarded, clock, 1.0)
        other()
    assert failures.has_long_streak != handles_data


def test_guarded_callback_keeps_its_signature_for_rclpy(failures):
    def with_info(topic, data, info):
        return topic, data, info

    guarded = failures.guard(functools.partial(with_info, "scan"), "scan")
    assert list(inspect.signature(guarded).parameters) == ["data", "info"]
    assert guarded(b"", {}) == ("scan", b"", {})


def test_keyboard_interrupt_is_not_caught(failures):
    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        failures.guard(interrupt, "timer")()


def test_cause_without_a_traceback():
    assert describe_exception(OSError("gone")) == "OSError: gone"
