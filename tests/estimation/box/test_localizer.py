# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tracking of the box from scan to scan, through clutter, occlusion and ambiguity."""

import dataclasses

import numpy as np
import pytest
from fixtures.box_site import (
    AT_ORIGIN,
    BARE,
    BARE_AT_ORIGIN,
    BOX,
    CEILING,
    PARAMETERS,
    PERIOD,
    SITE,
    Scored,
    assert_near,
    drive,
    error,
    hidden,
    locate,
    standing,
    turning,
)

from trackslip_estimation.box.localizer import BoxFix, BoxLocalizer
from trackslip_estimation.box.search import Reason
from trackslip_sim.machine.scan_model import TIME_INCREMENT, SiteScanner


def test_follows_a_turn_among_clutter():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    outcomes = drive(localizer, SiteScanner(SITE, BOX, seed=1), turning, 180)
    fixes = [outcome for outcome in outcomes if isinstance(outcome, BoxFix)]
    assert len(fixes) >= 177
    errors = np.array([error(fix, turning) for fix in fixes])
    assert np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) < 0.015
    assert np.sqrt((errors[:, 2] ** 2).mean()) < 0.04
    rejected = sum(localizer.tally.by_source().get("scan", {}).values())
    assert rejected == len(outcomes) - len(fixes)


def test_stamp_is_when_the_beams_hit_the_box():
    ranges = SiteScanner(BARE, BOX, seed=1).scan(1.0, standing(5.0, 0.0, 0.0))
    fix = locate(BoxLocalizer(dataclasses.replace(PARAMETERS, initial_x=5.0), BOX), 1.0, ranges)
    assert fix.stamp_ns == pytest.approx(1.0e9 + 180 * TIME_INCREMENT * 1e9, abs=TIME_INCREMENT * 1e9)


def test_offset_of_the_box_is_applied_with_its_covariance():
    vehicle = dataclasses.replace(BOX, x=-0.4, y=0.3)
    pose_at = standing(1.0, 0.5, 0.4)
    ranges = SiteScanner(BARE, vehicle, seed=3).scan(1.0, pose_at)
    fix = locate(BoxLocalizer(PARAMETERS, vehicle), 1.0, ranges)
    plain = locate(BoxLocalizer(PARAMETERS, BOX), 1.0, ranges)
    assert_near(fix, pose_at)
    assert fix.yaw == plain.yaw
    assert fix.covariance[:2, :2].trace() > plain.covariance[:2, :2].trace()


@pytest.mark.parametrize("initial_yaw", [-2.0, -0.3, 0.0, 0.3, 2.8])
def test_front_of_the_box_follows_the_initial_heading(initial_yaw):
    parameters = dataclasses.replace(PARAMETERS, initial_yaw=initial_yaw)
    ranges = SiteScanner(BARE, BOX, seed=4).scan(1.0, standing(0.0, 0.0, initial_yaw + 0.2))
    fix = locate(BoxLocalizer(parameters, BOX), 1.0, ranges)
    assert_near(fix, standing(0.0, 0.0, initial_yaw + 0.2))


def test_finds_the_box_away_from_the_initial_place():
    pose_at = standing(2.5, -3.0, 0.2)
    ranges = SiteScanner(SITE, BOX, seed=5).scan(1.0, pose_at)
    assert_near(locate(BoxLocalizer(PARAMETERS, BOX), 1.0, ranges), pose_at)


@pytest.mark.parametrize(
    ("posts", "walls", "reason"),
    [
        ((), (), Reason.NOTHING_NEAR),
        ((0.0, 0.0, 0.22), (), Reason.SHAPE),  # a person
        ((0.0, 0.0, 0.22), (-4.0, 1.2, 4.0, 1.2), Reason.SHAPE),  # a person before a wall
        ((0.0, 0.0, 0.05), (), Reason.FEW_BEAMS),
        ((), (-1.0, 0.0, 1.0, 0.0), Reason.SIZE),
    ],
)
def test_clutter_is_not_the_box(posts, walls, reason):
    site = dataclasses.replace(BARE, posts=posts, walls=walls, laser_y=-6.0)
    localizer = BoxLocalizer(dataclasses.replace(PARAMETERS, laser_y=-6.0, initial_reach=1.5), BOX)
    scanner = SiteScanner(site, BOX, seed=6)
    outcomes = drive(localizer, scanner, standing(100.0, 100.0, 0.0), 20)
    rejections = [outcome for outcome in outcomes if isinstance(outcome, Reason)]
    assert len(rejections) == 20
    assert sum(outcome is reason for outcome in rejections) >= 18
    assert localizer.tally.by_source()["scan"][reason.value] >= 18


def test_box_before_a_wall_is_found():
    site = dataclasses.replace(BARE, walls=(-6.0, 1.2, 6.0, 1.2))
    outcomes = drive(BoxLocalizer(PARAMETERS, BOX), SiteScanner(site, BOX, seed=7), turning, 20)
    assert sum(isinstance(outcome, BoxFix) for outcome in outcomes) >= 19


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_post_that_touches_the_box_is_not_taken_for_a_part_of_it(side):
    def past(times):
        return times * 0.1 - 1.5, np.zeros_like(times), np.zeros_like(times)

    site = dataclasses.replace(BARE, posts=(0.0, side * 0.42, 0.15))
    parameters = dataclasses.replace(PARAMETERS, initial_x=-1.4)
    outcomes = drive(BoxLocalizer(parameters, BOX), SiteScanner(site, BOX, seed=9), past, 120)
    fixes = [fix for fix in outcomes if isinstance(fix, BoxFix)]
    assert len(fixes) >= 110
    errors = np.array([error(fix, past) for fix in fixes])
    nees = [e[:2] @ np.linalg.solve(f.covariance[:2, :2], e[:2]) for e, f in zip(errors, fixes, strict=True)]
    assert np.mean(nees) < 3.0
    assert np.max(nees) < 25.0


def test_jump_of_the_box_is_gated():
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner = SiteScanner(BARE, BOX, seed=8)
    drive(localizer, scanner, standing(0.0, 0.0, 0.0), 3)
    outcome = locate(localizer, 1.0 + 3 * PERIOD, scanner.scan(0.0, standing(0.7, 0.0, 0.0)))
    assert outcome is Reason.GATE


def test_coasts_through_a_short_occlusion():
    localizer = BoxLocalizer(PARAMETERS, BOX)

    def someone_passes(index, ranges):
        return hidden(ranges, 0, 361) if 20 <= index < 28 else ranges

    scanner = SiteScanner(SITE, BOX, seed=9)
    outcomes = drive(localizer, scanner, turning, 60, change=someone_passes)
    assert all(isinstance(outcome, Reason) for outcome in outcomes[20:28])
    for outcome in outcomes[28:]:
        assert_near(outcome, turning)


def test_partly_hidden_box_is_located_with_larger_covariance():
    scanner = SiteScanner(BARE, BOX, seed=10)
    pose_at = standing(3.0, -4.0, 0.1)
    parameters = dataclasses.replace(PARAMETERS, initial_x=3.0, initial_y=-4.0)
    ranges = scanner.scan(1.0, pose_at)
    on_box = np.flatnonzero(np.isfinite(ranges))
    whole = locate(BoxLocalizer(parameters, BOX), 1.0, ranges)
    half = locate(BoxLocalizer(parameters, BOX), 1.0, hidden(ranges, on_box[6], on_box[-1] + 3))
    split = locate(BoxLocalizer(parameters, BOX), 1.0, hidden(ranges, on_box[5], on_box[8]))
    for fix in (whole, half, split):
        assert_near(fix, pose_at)
    assert half.covariance[:2, :2].trace() > 2.0 * whole.covariance[:2, :2].trace()
    assert split.covariance[:2, :2].trace() < half.covariance[:2, :2].trace()


def seen_again(pose_at, scans, hidden_for):
    """Outcomes after the box is followed for 10 scans and hidden for ``hidden_for``."""
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner = SiteScanner(BARE, BOX, seed=11)
    drive(localizer, scanner, pose_at, 10)
    change = {"change": lambda _, ranges: hidden(ranges, 0, 361)}
    blind = drive(localizer, scanner, pose_at, hidden_for, first=10, **change)
    assert blind == [Reason.NOTHING_NEAR] * hidden_for
    return drive(localizer, scanner, pose_at, scans, first=10 + hidden_for)


def test_box_hidden_for_two_seconds_is_found_with_its_heading():
    outcomes = seen_again(turning, scans=60, hidden_for=10)
    assert_near(outcomes[0], turning)
    for outcome in outcomes[-20:]:
        assert_near(outcome, turning)
        assert outcome.covariance[2, 2] < 0.01


def test_sides_are_uncertain_when_the_box_is_back_in_sight():
    """The box turns unseen, by a quarter, half a turn or between; its earlier orientation is void."""
    for turned, seed in ((np.pi / 2.0, 3), (-np.pi / 2.0, 4), (np.pi, 5), (2.3, 14)):
        localizer = BoxLocalizer(PARAMETERS, BOX)
        scanner = SiteScanner(BARE, BOX, seed=seed)
        drive(localizer, scanner, standing(0.0, 0.0, 0.1), 10)
        after = standing(0.2, -0.1, 0.1 + turned)
        for outcome in drive(localizer, scanner, after, 80, first=32):
            assert isinstance(outcome, BoxFix)
            assert outcome.covariance[2, 2] > CEILING**2  # half a turn stays ambiguous
            deviation = error(outcome, after)
            assert np.all(np.abs(deviation) < (4.0, 4.0, 3.0) * np.sqrt(np.diag(outcome.covariance)))
        assert abs(np.sin(deviation[2])) < 0.2  # a quarter turn does not


def test_one_edge_near_the_edge_of_view_does_not_settle_the_sides():
    """The box comes into view at −90° beam by beam: its far end and its centre are unknown."""
    parameters = dataclasses.replace(AT_ORIGIN, initial_y=-3.0, initial_yaw=-1.1)
    pose_at = standing(-0.33, -2.6, -1.1)
    ranges = SiteScanner(BARE_AT_ORIGIN, BOX, seed=3).scan(1.0, pose_at)
    fix = locate(BoxLocalizer(parameters, BOX), 1.0, ranges)
    deviation = error(fix, pose_at)
    assert deviation @ np.linalg.solve(fix.covariance, deviation) < 16.0
    assert np.linalg.eigvalsh(fix.covariance[:2, :2])[1] > 0.05**2


def test_object_of_the_background_is_not_the_box():
    """A second box belongs to the site. It is not taken for ours, which is hidden for long."""
    twin = dataclasses.replace(
        BARE, walls=(-3.35, -0.3, -2.65, -0.3, -3.35, -0.3, -3.35, 0.3, -2.65, -0.3, -2.65, 0.3)
    )
    localizer = BoxLocalizer(PARAMETERS, BOX)
    scanner = SiteScanner(twin, BOX, seed=15)
    drive(localizer, scanner, turning, 10)
    outcomes = drive(localizer, scanner, standing(100.0, 100.0, 0.0), 60, first=10)
    assert all(isinstance(outcome, Reason) for outcome in outcomes)
    assert outcomes[-1] is Reason.BACKGROUND


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0, 0.01])
def test_scan_with_all_ranges_equal_gives_no_fix(value):
    outcome = locate(BoxLocalizer(PARAMETERS, BOX), 1.0, np.full(361, value))
    assert isinstance(outcome, Reason)


@pytest.mark.parametrize(("scale", "misfits"), [(1.0, False), (0.9, True), (1.1, True)])
def test_box_of_another_size_than_stated_is_noticed(scale, misfits):
    box = dataclasses.replace(BOX, length=scale * BOX.length, width=scale * BOX.width)
    localizer = BoxLocalizer(PARAMETERS, BOX)
    drive(localizer, SiteScanner(SITE, box, 3), turning, 120)
    assert (localizer.misfit > PARAMETERS.largest_misfit) == misfits


def test_single_beams_without_return_neither_hide_nor_move_the_box():
    random = np.random.default_rng(4)

    def drop(_, ranges):
        return np.where(random.random(ranges.shape) < 0.03, np.inf, ranges)

    outcomes = drive(BoxLocalizer(PARAMETERS, BOX), SiteScanner(SITE, BOX, 3), turning, 80, change=drop)
    fixes = [Scored.from_fix(fix, turning) for fix in outcomes if isinstance(fix, BoxFix)]
    assert len(fixes) >= 76
    assert np.mean([fix.position for fix in fixes]) < 6.0  # 16 where a single one cut the box


def test_same_scans_same_fixes():
    runs = [
        drive(BoxLocalizer(PARAMETERS, BOX), SiteScanner(SITE, BOX, seed=13), turning, 15) for _ in range(2)
    ]
    for one, other in zip(*runs, strict=True):
        assert (one.stamp_ns, one.x, one.y, one.yaw) == (other.stamp_ns, other.x, other.y, other.yaw)
        assert np.array_equal(one.covariance, other.covariance)
