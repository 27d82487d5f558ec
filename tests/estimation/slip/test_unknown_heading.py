# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A start with one antenna: an unknown heading at rest, and how it is found while the machine moves off."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest
from fixtures.imu_samples import imu_sample
from fixtures.pose_errors import THREE_SIGMA, position_nees

from trackslip_common.errors import InputError
from trackslip_common.units import GRAVITY
from trackslip_estimation.slip.estimator import Estimate, SlipEstimator
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, VelocityFix
from trackslip_estimation.slip.parameters import load_slip_parameters

RADIUS, TRACK_SPEED = 0.159, 0.55  # m, m/s
LEVER = (-1.2, 0.6, 3.0)  # m, of the antenna on the roof of a cab
HEADING = 2.0  # rad
REST = 10.0  # s, before the tracks run
FIX, FIX_VELOCITY = 0.02, 0.02  # m, m/s: standard deviations
COVARIANCE = np.diag((FIX**2, FIX**2, 1e6))
PARAMETERS = {
    "pose_sources": ["gnss_pose"],
    "sources.gnss_pose.use_heading": False,
    "sources.gnss_pose.lever_arm_x": LEVER[0],
    "sources.gnss_pose.lever_arm_y": LEVER[1],
    "sources.gnss_pose.lever_arm_z": LEVER[2],
}


class Moment(NamedTuple):
    """Time since the first sample, s; measurements with this stamp; and the truth."""

    t: float
    measurements: list[Measurement]
    position: tuple[float, float]


def start(seed: int, speed: Callable[[float], float], seconds: float) -> Iterator[Moment]:
    """Rest on level ground, then straight on at ``speed`` of the time since then; tracks at TRACK_SPEED."""
    rng, c, s = np.random.default_rng(seed), math.cos(HEADING), math.sin(HEADING)
    antenna, distance = np.array((c * LEVER[0] - s * LEVER[1], s * LEVER[0] + c * LEVER[1])), 0.0
    for k in range(round((REST + seconds) * 50)):
        t, stamp_ns = k * 0.02, (k + 1) * 20_000_000
        turns = TRACK_SPEED / RADIUS if t >= REST else 0.0
        found: list[Measurement] = [Sprockets("sprockets", stamp_ns, turns, turns)]
        found.append(imu_sample(stamp_ns, np.array((0.0, 0.0, GRAVITY)), 0.0, rng))
        if k % 5 == 0:
            east, north = rng.normal(antenna + np.array((c, s)) * distance, FIX)
            found.append(PoseFix("gnss_pose", stamp_ns, np.array((east, north, 0.0)), COVARIANCE))
            velocity = rng.normal(np.array((c, s)) * (speed(t - REST) if t >= REST else 0.0), FIX_VELOCITY)
            found.append(VelocityFix("fix_velocity", stamp_ns, velocity, FIX_VELOCITY**2 * np.eye(2)))
        yield Moment(t, found, (c * distance, s * distance))
        distance += speed(t - REST) * 0.02 if t >= REST else 0.0


def estimates(moments: Iterator[Moment], has_velocities: bool) -> Iterator[tuple[Moment, Estimate]]:
    """Estimates from positions, and from velocities of the antenna if the receiver has them."""
    sources = ["fix_velocity"] if has_velocities else []
    own = SlipEstimator(load_slip_parameters({**PARAMETERS, "velocity_sources": sources}))
    for moment in moments:
        for m in moment.measurements:
            if isinstance(m, VelocityFix) and not has_velocities:
                continue
            estimate = own.process(m)[1]
            if estimate is not None:
                yield moment, estimate


def heading_error(e: Estimate) -> float:
    return abs(math.remainder(e.pose[2] - HEADING, math.tau))


def is_inside(moment: Moment, e: Estimate) -> bool:
    return position_nees(e, np.array(moment.position)) < THREE_SIGMA


@pytest.mark.parametrize("has_velocities", [False, True])
@pytest.mark.parametrize("seed", range(2))
def test_fixes_of_a_high_antenna_do_not_show_the_heading_of_a_machine_at_rest(
    seed: int, has_velocities: bool
) -> None:
    """The tilt is found meanwhile, and the gyro is noisy: both move the antenna's estimate by the heading."""
    for moment, e in estimates(start(seed, lambda _: 0.0, 0.0), has_velocities):
        assert math.sqrt(e.pose_covariance[2, 2]) > 1.5
        assert is_inside(moment, e)


@pytest.mark.parametrize("has_velocities", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_heading_is_found_while_the_tracks_grip_slowly(seed: int, has_velocities: bool) -> None:
    """A slip of 100 % that vanishes is, at the reversed heading, one of more than 100 %."""
    *_, (moment, e) = estimates(start(seed, lambda t: min(0.14 * t, 0.5), 6.0), has_velocities)
    assert heading_error(e) < 0.1
    assert math.sqrt(e.pose_covariance[2, 2]) < 0.1
    assert is_inside(moment, e)


@pytest.mark.parametrize("has_velocities", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_start_with_spinning_tracks_never_ends_with_a_certain_wrong_heading(
    seed: int, has_velocities: bool
) -> None:
    """The slip takes 10 s from 100 % to 10 %: for seconds the machine hardly moves."""
    for moment, e in estimates(start(seed, lambda t: 0.05 * t, 10.0), has_velocities):
        assert heading_error(e) < 1.0 or math.sqrt(e.pose_covariance[2, 2]) > 0.3, moment.t - REST
    assert heading_error(e) < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_a_machine_that_is_stuck_from_its_start_has_an_unknown_heading_until_it_grips(seed: int) -> None:
    stuck = 20.0  # s
    moments = start(seed, lambda t: min(0.3 * max(t - stuck, 0.0), 0.5), stuck + 5.0)
    for moment, e in estimates(moments, has_velocities=False):
        is_stuck = 2.0 < moment.t - REST < stuck
        assert is_inside(moment, e) or not is_stuck
        assert math.sqrt(e.pose_covariance[2, 2]) > 1.0 or not is_stuck
    assert heading_error(e) < 0.1
    assert is_inside(moment, e)


@pytest.mark.parametrize(
    ("changes", "is_refused"),
    [
        ({}, True),
        ({"heading_sources": ["heading"]}, False),
        ({"sources.gnss_pose.use_heading": True}, False),
        ({"pose_sources": [""]}, False),  # nothing contradicts the start
        ({"noise.slip_angle_steady": 0.0, "noise.slip_angle_turning": 0.0}, False),
        ({"model": "turning"}, False),
    ],
    ids=["positions", "compass", "headings", "no fixes", "constant slip angle", "turning"],
)
def test_free_slips_are_refused_where_nothing_measures_the_heading(
    changes: dict[str, object], is_refused: bool
) -> None:
    """Without a fault, positions alone turned the heading of a drive of 4 min by 1.1 rad, claimed to 0.03."""
    given = {**PARAMETERS, "model": "free_slips"}
    if not is_refused:
        load_slip_parameters(given, changes)
        return
    with pytest.raises(InputError, match=r"'free_slips' cannot tell .* heading.*; accepted: turning, icr"):
        load_slip_parameters(given, changes)


@pytest.mark.parametrize("seed", range(3))
def test_sprockets_that_creep_at_rest_do_not_determine_the_heading(seed: int) -> None:
    """Wheel speeds with an offset of 1 mm/s."""
    own, rng, stddev = SlipEstimator(load_slip_parameters(PARAMETERS)), np.random.default_rng(seed), 0.0
    for k in range(2500):
        stamp_ns, creep = (k + 1) * 20_000_000, 1e-3 / RADIUS
        found: list[Measurement] = [Sprockets("sprockets", stamp_ns, creep, creep)]
        found.append(imu_sample(stamp_ns, np.array((0.0, 0.0, GRAVITY)), 0.0, rng))
        if k % 5 == 0:
            found.append(PoseFix("gnss_pose", stamp_ns, np.append(rng.normal(0.0, FIX, 2), 0.0), COVARIANCE))
        for m in found:
            estimate = own.process(m)[1]
            if estimate is not None:
                stddev = math.sqrt(estimate.pose_covariance[2, 2])
    assert stddev > 1.5
