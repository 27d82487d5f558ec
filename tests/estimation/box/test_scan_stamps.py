# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Scans with bad stamps or geometry are rejected, and the localizer recovers afterwards."""

import dataclasses

import numpy as np
import pytest
from fixtures.box_site import (
    BARE,
    BOX,
    PARAMETERS,
    PERIOD,
    SITE,
    assert_near,
    drive,
    locate,
    scan_of,
    standing,
    turning,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.search import Reason
from trackslip_sim.machine.scan_model import SiteScanner

HOUR = 3600.0
SCANS = 60
CONFIRMATIONS = PARAMETERS.jump_confirmations
ORIGIN = standing(0.0, 0.0, 0.0)


def reasons(outcomes):
    return [outcome for outcome in outcomes if isinstance(outcome, Reason)]


def scan(stamp, pose_at=ORIGIN, seed=12, **changes):
    """One scan of the bare site, with some of its fields replaced."""
    ranges = SiteScanner(BARE, BOX, seed).scan(stamp, pose_at)
    return dataclasses.replace(scan_of(stamp, ranges), **changes)


@pytest.mark.parametrize("stamps", [(1.0, 1.0), (1.0, 0.5)])
def test_scan_not_later_than_the_one_before_is_refused(stamps):
    localizer = BoxLocalizer(PARAMETERS, BOX)
    outcomes = [localizer.locate(scan(stamp)) for stamp in stamps]
    assert isinstance(outcomes[0], BoxFix)
    assert outcomes[1] is Reason.NOT_LATER
    localizer.reset()
    assert isinstance(localizer.locate(scan(0.5)), BoxFix)


def test_stamps_that_go_back_begin_another_run():
    """A bag in a loop: the same scans again, with the same stamps."""
    localizer = BoxLocalizer(PARAMETERS, BOX)
    for _ in range(3):
        outcomes = drive(localizer, SiteScanner(SITE, BOX, seed=1), turning, SCANS)
        for outcome in outcomes[CONFIRMATIONS:]:
            assert_near(outcome, turning)
    assert localizer.restarts == 2
    assert localizer.tally.by_source()["scan"] == {Reason.NOT_LATER.value: 2 * (CONFIRMATIONS - 1)}


def test_new_run_finds_the_box_at_its_initial_pose():
    localizer = BoxLocalizer(dataclasses.replace(PARAMETERS, initial_reach=0.5), BOX)
    drive(localizer, SiteScanner(SITE, BOX, seed=1), turning, SCANS)
    outcomes = drive(localizer, SiteScanner(SITE, BOX, seed=2), turning, CONFIRMATIONS)
    assert_near(outcomes[-1], turning)


def test_clock_set_back_during_a_run_keeps_the_pose_of_the_box():
    """By then the initial pose is far away, and the heading has changed."""
    localizer = BoxLocalizer(dataclasses.replace(PARAMETERS, initial_reach=0.5), BOX)
    scanner = SiteScanner(SITE, BOX, seed=1)
    drive(localizer, scanner, turning, SCANS)
    at = turning(np.array([1.0 + SCANS * PERIOD]))
    there = standing(*(float(value[0]) for value in at))
    back = [locate(localizer, 8.0 + k * PERIOD, scanner.scan(8.0 + k * PERIOD, there)) for k in range(6)]
    assert reasons(back) == [Reason.NOT_LATER] * (CONFIRMATIONS - 1)
    for fix in back[CONFIRMATIONS:]:
        assert_near(fix, there)
    assert localizer.restarts == 1


def test_one_scan_stamped_an_hour_ahead_is_refused_without_effect():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner = SiteScanner(SITE, BOX, seed=1)
    drive(localizer, scanner, turning, 20)
    stamp = 1.0 + 20 * PERIOD
    assert locate(localizer, stamp + HOUR, scanner.scan(stamp, turning)) is Reason.AHEAD
    for outcome in drive(localizer, scanner, turning, 20, first=20):
        assert_near(outcome, turning)


def test_localizer_recovers_from_a_first_scan_stamped_an_hour_ahead():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner = SiteScanner(SITE, BOX, seed=1)
    locate(localizer, 1.0 + HOUR, scanner.scan(1.0, turning))
    outcomes = drive(localizer, scanner, turning, 20)
    assert reasons(outcomes) == [Reason.NOT_LATER] * (CONFIRMATIONS - 1)
    for outcome in outcomes[CONFIRMATIONS:]:
        assert_near(outcome, turning)


def test_stamps_ahead_that_confirm_each_other_are_another_time():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    drive(localizer, SiteScanner(BARE, BOX, seed=1), ORIGIN, 5)
    late = [localizer.locate(scan(HOUR + k * PERIOD, seed=20 + k)) for k in range(CONFIRMATIONS + 2)]
    assert reasons(late) == [Reason.AHEAD] * (CONFIRMATIONS - 1)
    assert all(isinstance(outcome, BoxFix) for outcome in late[CONFIRMATIONS:])


def test_scans_further_apart_than_the_gap_give_fixes_once_their_pace_is_confirmed():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    outcomes = [localizer.locate(scan(1.0 + 10.0 * k, seed=k)) for k in range(8)]
    assert [isinstance(outcome, BoxFix) for outcome in outcomes] == [True, False, False] + [True] * 5
    for outcome in outcomes[3:]:
        assert_near(outcome, ORIGIN)


@pytest.mark.parametrize("ranges", [np.zeros(0), np.zeros(1), np.zeros((2, 2)), np.full(20_001, 5.0)])
def test_malformed_scan_is_refused(ranges):
    assert locate(BoxLocalizer(PARAMETERS, BOX), 1.0, ranges) is Reason.MALFORMED


@pytest.mark.parametrize(
    "changes",
    [
        *({"angle_min": value} for value in (np.nan, np.inf, -np.inf, 7.0)),
        *({"angle_increment": value} for value in (np.nan, np.inf, 0.0, -1.0, 1e-30, 1.0)),
        *({"time_increment": value} for value in (np.nan, np.inf, -np.inf, 1e20, -1e20, 0.1)),
        *({"stamp_ns": value} for value in (-1, 2**31 * 1_000_000_000, 2**31 * 1_000_000_000 - 1)),
    ],
    ids=str,
)
def test_next_scan_after_one_of_impossible_geometry_gives_a_fix(changes):
    localizer = BoxLocalizer(PARAMETERS, BOX)
    for stamp in (1.0, 2.0):
        assert localizer.locate(scan(stamp, **changes)) is Reason.MALFORMED
        assert_near(localizer.locate(scan(stamp + 0.5)), ORIGIN)
    assert localizer.tally.by_source()["scan"] == {Reason.MALFORMED.value: 2}


def test_scan_of_clockwise_beams_gives_the_same_fix():
    there = standing(1.0, 0.5, 0.4)
    usual = scan(1.0, there)
    turned = dataclasses.replace(
        usual,
        stamp_ns=usual.beam_stamp_ns(usual.ranges.size - 1),
        ranges=usual.ranges[::-1],
        angle_min=-usual.angle_min,
        angle_increment=-usual.angle_increment,
        time_increment=-usual.time_increment,
    )
    one, other = (BoxLocalizer(PARAMETERS, BOX).locate(s) for s in (usual, turned))
    assert_near(other, there)
    assert other.stamp_ns == pytest.approx(one.stamp_ns, abs=2)
    assert (other.x, other.y, other.yaw) == pytest.approx((one.x, one.y, one.yaw), abs=1e-9)


@pytest.mark.parametrize(
    "ranges",
    [[0.0, 0.0, 0.0, 0.0078125, 0.0078125, 0.0, 0.0078125, 2.0], [0.0, 1.0, *[0.001953125] * 4]],
    ids=len,
)
def test_object_that_touches_the_laser_is_not_the_box(ranges):
    """The laser would be inside the box."""
    parameters = dataclasses.replace(PARAMETERS, initial_x=8.0, initial_reach=50.0)
    outcome = locate(BoxLocalizer(parameters, BOX), 1.0, np.array(ranges))
    assert outcome is Reason.TOO_NEAR


anything = st.one_of(st.floats(width=32), st.floats(-0.125, 0.125), st.sampled_from([-np.pi / 2, 0.0]))


@pytest.mark.slow
@settings(max_examples=60)
@given(
    st.lists(
        st.tuples(st.integers(-(2**31), 2**32), anything, anything, anything, st.integers(0, 400)), max_size=8
    )
)
def test_localizer_recovers_after_any_scans(given_scans):
    localizer = BoxLocalizer(dataclasses.replace(PARAMETERS, initial_reach=20.0), BOX)
    for stamp, angle_min, angle_increment, time_increment, beams in given_scans:
        geometry = {"angle_min": angle_min, "angle_increment": angle_increment}
        ranges = SiteScanner(BARE, BOX, seed=3).scan(1.0, ORIGIN)[:beams]
        bad = scan(stamp, ranges=ranges, time_increment=time_increment, **geometry)
        outcome = localizer.locate(bad)
        if isinstance(outcome, BoxFix):
            assert np.all(np.isfinite([outcome.x, outcome.y, outcome.yaw]))
            assert np.all(np.linalg.eigvalsh(outcome.covariance) > 0.0)
    stamps = 1e6 + PERIOD * np.arange(3 * CONFIRMATIONS)
    outcomes = [localizer.locate(scan(stamp, seed=k)) for k, stamp in enumerate(stamps)]
    assert isinstance(outcomes[-1], BoxFix)
