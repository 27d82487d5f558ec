# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scans at slow rates still give fixes."""

from fixtures.box_site import BARE, BOX, PARAMETERS, assert_near, scan_of, standing

from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_sim.machine.scan_model import SiteScanner


def test_scans_further_apart_than_the_gap_give_fixes_once_their_pace_is_confirmed():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner, there = SiteScanner(BARE, BOX, seed=1), standing(0.0, 0.0, 0.0)
    outcomes = [localizer.locate(scan_of(1.0 + 10.0 * k, scanner.scan(0.0, there))) for k in range(8)]
    assert [isinstance(outcome, BoxFix) for outcome in outcomes] == [True, False, False] + [True] * 5
    for outcome in outcomes[3:]:
        assert_near(outcome, there)
