# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps out of line: a single one is wrong, many that agree are a new time of the clock."""

import pytest

from trackslip_common.clock_monitor import ClockMonitor, StampStatus

S = 1_000_000_000
GAP_NS, CONFIRMATIONS = 5 * S, 4
HOUR_NS = 3600 * S
IN_LINE, AHEAD, BEHIND, BACK = StampStatus


def statuses(stamps: list[float], oldest: float | None = None) -> list[StampStatus]:
    monitor = ClockMonitor(GAP_NS, CONFIRMATIONS)
    return [monitor.check_sample(round(s * S), None if oldest is None else round(oldest * S)) for s in stamps]


def test_one_sample_far_ahead_is_refused_and_the_head_stays() -> None:
    assert statuses([1.0, 100.0, 1.1, 6.1]) == [IN_LINE, AHEAD, IN_LINE, IN_LINE]


def test_samples_ahead_that_agree_are_accepted() -> None:
    results = statuses([1.0, 100.0, 100.1, 100.2, 100.3, 100.4])
    assert results == [IN_LINE, *[AHEAD] * (CONFIRMATIONS - 1), *[IN_LINE] * 2]


@pytest.mark.parametrize("stamps", [[100.0, 300.0, 900.0, 2200.0, 5000.0], [100.0, 99.9, 99.8, 99.7, 99.6]])
def test_samples_ahead_that_do_not_agree_are_not(stamps: list[float]) -> None:
    assert set(statuses([1.0, *stamps])[1:]) == {AHEAD}


SLOW = [1.0, 11.0, 21.0, 31.0, 41.0]


def test_samples_at_a_slow_pace_are_in_line_once_it_is_confirmed() -> None:
    assert statuses([*SLOW, 51.0, 58.0, 77.0]) == [IN_LINE, *[AHEAD] * (CONFIRMATIONS - 1), *[IN_LINE] * 4]


def test_jump_among_samples_at_a_slow_pace_is_ahead() -> None:
    assert statuses([*SLOW, 4000.0, 51.0])[-2:] == [AHEAD, IN_LINE]


def test_gap_limit_applies_again_once_samples_are_faster() -> None:
    assert statuses([*SLOW, 41.2, 41.4, 50.0, 41.6])[-2:] == [AHEAD, IN_LINE]


def test_slow_samples_confirm_a_clock_set_back() -> None:
    monitor = ClockMonitor(GAP_NS, CONFIRMATIONS)
    assert monitor.check_increasing_sample(1000 * S) is IN_LINE
    steps = [monitor.check_increasing_sample(round((1000.0 + s) * S)) for s in SLOW[1:]]
    assert steps[-1] is IN_LINE
    back = [monitor.check_increasing_sample(round((s + 1.0) * S)) for s in SLOW[:CONFIRMATIONS]]
    assert back == [*[BEHIND] * (CONFIRMATIONS - 1), BACK]


def test_a_sample_in_line_ends_the_streak() -> None:
    results = statuses([1.0, 100.0, 100.1, 100.2, 1.1, 100.3])
    assert results[-2:] == [IN_LINE, AHEAD]
    results = statuses([9.0, 1.0, 1.1, 1.2, 9.1, 1.3], oldest=7.0)
    assert results[1:] == [*[BEHIND] * 3, IN_LINE, BEHIND]


def test_consistent_samples_behind_confirm_a_clock_set_back() -> None:
    assert statuses([9.0, 1.0, 1.1, 1.2, 1.3], oldest=7.0) == [
        IN_LINE,
        *[BEHIND] * (CONFIRMATIONS - 1),
        BACK,
    ]


def late(monitor: ClockMonitor, stamps: list[float], contradicts: bool) -> list[StampStatus]:
    return [monitor.check_sample(round(s * S), 0, contradicts=contradicts) for s in stamps]


def test_contradicting_late_samples_confirm_a_clock_set_back() -> None:
    monitor = ClockMonitor(GAP_NS, CONFIRMATIONS)
    monitor.check_sample(9 * S, 0)
    assert late(monitor, [8.1, 8.2], contradicts=True) == [IN_LINE] * 2
    assert late(monitor, [8.3, 8.4], contradicts=False) == [IN_LINE] * 2  # by chance: neither counted
    assert late(monitor, [8.5, 8.6], contradicts=True) == [IN_LINE, BACK]  # nor a reset of the count


def test_consistent_late_samples_show_no_clock_jump() -> None:
    monitor = ClockMonitor(GAP_NS, CONFIRMATIONS)
    monitor.check_sample(9 * S, 0)
    assert set(late(monitor, [7.0 + k / 100.0 for k in range(3 * CONFIRMATIONS)], contradicts=False)) == {
        IN_LINE
    }


@pytest.mark.parametrize("interruption", [[9.1], [8.0]])
def test_a_new_head_or_a_step_down_ends_the_late_streak(interruption: list[float]) -> None:
    monitor = ClockMonitor(GAP_NS, CONFIRMATIONS)
    monitor.check_sample(9 * S, 0)
    streak = late(monitor, [8.1, 8.2, 8.3], contradicts=True)
    assert set(streak + late(monitor, [*interruption, 8.4, 8.5], contradicts=True)) == {IN_LINE}


def test_other_sources_confirm_nothing() -> None:
    monitor = ClockMonitor(GAP_NS, CONFIRMATIONS)
    assert monitor.check_other(HOUR_NS) is IN_LINE  # no clock for comparison yet
    monitor.check_sample(S)
    assert {monitor.check_other(HOUR_NS + k) for k in range(3 * CONFIRMATIONS)} == {AHEAD}
    assert monitor.check_other(S + GAP_NS) is IN_LINE
