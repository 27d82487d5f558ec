# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A localizer that is restarted during a drive takes no other object for the box."""

import dataclasses

import numpy as np
import pytest
from fixtures.box_restarts import DOWN, DRIVES, longest_wrong
from fixtures.box_site import BOX, PARAMETERS, scan_of

from trackslip_common.tally import Tally
from trackslip_estimation.box.background import Background
from trackslip_estimation.box.localizer import BoxLocalizer
from trackslip_estimation.box.odometry import Odometry, OdometryBuffer
from trackslip_estimation.box.search import Reason

MANY = 30  # fixes, after which a restart has no effect
LONGEST = 1.0  # s of wrong fixes at most
HIDDEN = {"round_the_laser": 60, "behind_a_container": 55, "far_off": 120}  # s: the box is out of view
BACK = {"round_the_laser": 93.4, "behind_a_container": 70.9, "far_off": 174.2}  # s: the box is in view again
SITE_DRIVE = DRIVES["behind_a_container"]
KILLED, SEEN_AGAIN = HIDDEN["behind_a_container"], BACK["behind_a_container"]


def restarted(drive, second, **options):
    """The restarted localizer, and its fixes."""
    localizer = BoxLocalizer(PARAMETERS, BOX, drive.saved_state(second))
    return localizer, drive.scored(localizer, second + DOWN, **options)


def first_fixes(localizer, odometry=None):
    """Fixes of a localizer that begins while the box is out of view."""
    return SITE_DRIVE.scored(localizer, KILLED + DOWN, MANY, odometry)


def without_background():
    """A localizer with the track only."""
    state = dataclasses.replace(SITE_DRIVE.saved_state(KILLED), background=Background.empty())
    return BoxLocalizer(PARAMETERS, BOX, state)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_restart_while_the_box_is_out_of_sight_follows_no_other_thing(name):
    localizer, scored = restarted(DRIVES[name], HIDDEN[name], fixes=MANY)
    assert localizer.resumed
    assert longest_wrong(scored) <= LONGEST
    assert scored[0].stamp == pytest.approx(BACK[name], abs=1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_restart_at_any_second_tracks_only_the_box_without_delay(name):
    """The localizer finds the box within a scan or two of one that is not restarted."""
    drive = DRIVES[name]
    stamps = np.array([fix.stamp for fix in drive.scored(BoxLocalizer(PARAMETERS, BOX), 0.0)])
    wrong, late = {}, {}
    for second in drive.seconds:
        scored = restarted(drive, second, fixes=MANY)[1]
        wrong[second] = longest_wrong(scored)
        due = stamps[stamps >= second + DOWN]
        late[second] = scored[0].stamp - due[0] if due.size else 0.0
    assert {second: time for second, time in wrong.items() if time > LONGEST} == {}
    assert {second: time for second, time in late.items() if time > LONGEST} == {}


def test_background_survives_several_restarts_without_a_fix():
    state = SITE_DRIVE.saved_state(50)
    for second in (52, 55, 58):
        localizer = BoxLocalizer(PARAMETERS, BOX, state)
        for stamp, ranges in SITE_DRIVE.scans:
            if second <= stamp < second + 2.0:
                assert isinstance(localizer.locate(scan_of(stamp, ranges)), Reason)
        state = localizer.saved_state
    localizer = BoxLocalizer(PARAMETERS, BOX, state)
    assert longest_wrong(SITE_DRIVE.scored(localizer, 60.0, MANY)) <= LONGEST


@pytest.mark.parametrize("change", ["laser", "beams"])
def test_background_of_another_place_or_other_beams_is_not_used(change):
    state = SITE_DRIVE.saved_state(KILLED)
    if change == "laser":
        state = dataclasses.replace(state, laser=(state.laser[0], state.laser[1], state.laser[2] + 0.01))
    else:
        background = dataclasses.replace(state.background, angle_min=state.background.angle_min + 0.002)
        state = dataclasses.replace(state, background=background)
    localizer = BoxLocalizer(PARAMETERS, BOX, state)
    scored = first_fixes(localizer)
    assert longest_wrong(scored) <= LONGEST
    assert localizer.tally.by_source()["scan"][Reason.UNCERTAIN.value] > 50


def test_localizer_without_background_gives_no_fix_until_the_box_drives():
    localizer = without_background()
    scored = first_fixes(localizer)
    assert longest_wrong(scored) <= LONGEST
    assert scored[0].stamp > SEEN_AGAIN + 2.0
    driven = PARAMETERS.confirmation_distance / SITE_DRIVE.speed
    assert scored[0].stamp < SEEN_AGAIN + driven + 8.0  # in which time it turns


def test_certain_odometry_finds_the_box_without_background():
    localizer = without_background()
    odometry = SITE_DRIVE.odometry(0.1, off=(0.1, -0.1))
    scored = first_fixes(localizer, odometry)
    assert longest_wrong(scored) <= LONGEST
    assert scored[0].stamp == pytest.approx(SEEN_AGAIN, abs=1.0)


def test_object_placed_between_runs_is_rejected_by_the_odometry():
    """A crate stands in front of the whole background; by scans alone it is as likely as the box."""
    drive, second = SITE_DRIVE, 47
    bare = drive.saved_state(second)
    empty = np.full_like(bare.background.ranges, np.inf)
    cleared = dataclasses.replace(
        bare, background=dataclasses.replace(bare.background, ranges=empty, free=empty)
    )
    for stddev in (0.1, 0.5):
        localizer = BoxLocalizer(PARAMETERS, BOX, cleared)
        scored = drive.scored(localizer, second + DOWN, MANY, drive.odometry(stddev, off=(stddev, 0.0)))
        assert longest_wrong(scored) <= LONGEST
        assert scored[0].stamp == pytest.approx(SEEN_AGAIN, abs=1.0)


def test_wrong_odometry_delays_fixes_only_until_the_machine_drives():
    localizer = BoxLocalizer(PARAMETERS, BOX, SITE_DRIVE.saved_state(KILLED))
    wrong = SITE_DRIVE.odometry(0.05, off=(6.0, 3.0))
    scored = first_fixes(localizer, wrong)
    assert longest_wrong(scored) <= LONGEST
    assert SEEN_AGAIN + 2.0 < scored[0].stamp < SEEN_AGAIN + 15.0


def test_start_without_a_track_rejects_positions_that_contradict_the_odometry():
    """The file is lost: a crate stands at the start of the drive, and the machine is out of view."""
    localizer = BoxLocalizer(dataclasses.replace(PARAMETERS, initial_x=6.0, initial_reach=2.0), BOX)
    scored = SITE_DRIVE.scored(localizer, 50.0, odometry=SITE_DRIVE.odometry(0.1))
    assert scored == []
    assert len(localizer.ambiguous_positions) == 1
    assert localizer.ambiguous_positions[0] == pytest.approx((6.0, 0.0), abs=0.3)


def test_malformed_odometry_is_counted_and_not_used():
    tally = Tally()
    buffer = OdometryBuffer(tally)
    zero, eye = np.zeros(2), np.eye(2)
    buffer.add(Odometry(10**9, zero, eye))
    for place, covariance in (
        (np.array((np.nan, 0.0)), eye),
        (zero, np.full((2, 2), np.inf)),
        (zero, -eye),
        (zero, np.array(((1.0, 2.0), (2.0, 1.0)))),
    ):
        buffer.add(Odometry(2 * 10**9, place, covariance))
    assert tally.by_source()["odometry"]["malformed"] == 4
    assert buffer.find_nearest(2 * 10**9).stamp_ns == 10**9
    assert buffer.find_nearest(2 * 10**9 + 1) is None
    buffer.add(Odometry(5 * 10**8, zero, eye))  # not later: dropped
    assert buffer.find_nearest(10**9).stamp_ns == 10**9
