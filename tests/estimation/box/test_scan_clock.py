# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of scans that come at any pace."""

from fixtures.box_site import BARE, BOX, PARAMETERS, assert_near, scan_of, standing

from trackslip_common.clock_monitor import StampStatus
from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.scan_clock import ScanClock
from trackslip_sim.machine.scan_model import SiteScanner

SECOND = 1_000_000_000
GAP, CONFIRMATIONS = 5 * SECOND, 3


def statuses(stamps_s):
    clock = ScanClock(GAP, CONFIRMATIONS)
    return [clock.check(round(stamp * SECOND)).name for stamp in stamps_s]


def test_scans_further_apart_than_the_gap_were_refused_for_good():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner, there = SiteScanner(BARE, BOX, seed=1), standing(0.0, 0.0, 0.0)
    outcomes = [localizer.locate(scan_of(1.0 + 10.0 * k, scanner.scan(0.0, there))) for k in range(8)]
    assert [isinstance(outcome, BoxFix) for outcome in outcomes] == [True, False, False] + [True] * 5
    for outcome in outcomes[3:]:
        assert_near(outcome, there)


def test_slow_scans_are_taken_once_they_agree_and_a_jump_among_them_is_not():
    assert statuses([0.2, 10, 20, 30, 40, 47, 61]) == ["IN_LINE"] + ["AHEAD"] * 2 + ["IN_LINE"] * 4
    slow = [0, 10, 20, 30, 40]
    assert statuses([*slow, 4000, 50])[-2:] == ["AHEAD", "IN_LINE"]


def test_steps_that_do_not_agree_confirm_nothing():
    assert set(statuses([0.2, 10, 40, 140, 560])[1:]) == {StampStatus.AHEAD.name}


def test_gap_is_as_before_when_scans_come_fast_again():
    fast = [40.2, 40.4, 40.6]
    assert statuses([0.2, 10, 20, 30, 40, *fast, 49, 40.8])[-2:] == ["AHEAD", "IN_LINE"]
