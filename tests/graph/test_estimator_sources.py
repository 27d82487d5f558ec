# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Further sources of the live slip estimator: slip seeds, orientations of an IMU, odometry of a camera."""

import numpy as np
import pytest
from fixtures.driven_estimator import DrivenEstimator
from fixtures.sensor_messages import pose, sprockets, stamped
from nav_msgs.msg import Odometry
from trackslip_msgs.msg import MeasurementReport, TrackSlip

pytestmark = pytest.mark.xdist_group("graph")

SEED_SPEED = 2.0  # rad/s


def seed(at_ms, slip):
    message = stamped(TrackSlip, at_ms)
    message.left_slip = message.right_slip = slip
    message.covariance = np.array((1e-5, 9e-6, 0.0, 9e-6, 1e-5, 0.0, 0.0, 0.0, 1e6))
    return message


def test_node_accepts_seeds_and_reports_their_outcome(programs, observer):
    driven = DrivenEstimator(programs, observer, dict.fromkeys(("sprockets", "box_pose", "slip_seed")))
    slips = observer.subscribe("track_slip")
    driven.begin(slip_sources=["slip_seed"], model="free_slips")  # slips are its states
    observer.wait_for_ends("track_slip", "slip_estimator")
    driven.feed("box_pose", pose(0))
    for at_ms in range(20, 1000, 20):
        driven.feed("sprockets", sprockets(at_ms, SEED_SPEED))
    late = driven.feed("slip_seed", seed(500, 0.04))
    assert (late.source, late.outcome, late.dof) == ("slip_seed", MeasurementReport.ACCEPTED, 2)
    assert late.header.stamp.nanosec == 500_000_000
    bad = driven.feed("slip_seed", seed(600, float("nan")))
    assert (bad.source, bad.outcome) == ("slip_seed", MeasurementReport.INVALID)
    reported = len(slips)
    driven.feed("sprockets", sprockets(1000, SEED_SPEED))
    observer.wait(lambda: len(slips) > reported, "slips")
    assert slips[-1].left_slip == pytest.approx(0.04, abs=0.02)
    assert slips[-1].right_slip == pytest.approx(slips[-1].left_slip, abs=1e-3)


STEP_MS, STEPS, EVERY = 20, 100, 5
SPEED, RADIUS = 1.5, 0.159  # rad/s, m
LOST = -1.0  # first element of the covariance of a missing velocity


@pytest.mark.slow
def test_odometry_of_a_camera_is_a_source_like_the_others(programs, observer):
    driven = DrivenEstimator(
        programs, observer, {"sprockets": None, "box_pose": None, "camera/odom": "odometry"}
    )
    driven.begin("bag", ["-p", "more_topics:=/camera/odom"], odometry_sources=["camera/odom"])
    for step in range(STEPS):
        driven.feed("sprockets", sprockets(step * STEP_MS, SPEED))
        if step == 0:
            driven.feed("box_pose", pose(0))
        if step % EVERY == 2:
            odom = stamped(Odometry, step * STEP_MS - 7)
            odom.header.frame_id, odom.pose.pose.orientation.w = "camera_odom", 1.0
            odom.pose.pose.position.y = 0.9 * RADIUS * SPEED * (step * STEP_MS - 7) * 1e-3  # it faces left
            odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = np.sin(np.pi / 4), np.cos(np.pi / 4)
            odom.twist.covariance[0] = LOST if step == 52 else 0.0
            (driven.publish if step == 52 else driven.feed)("camera/odom", odom)
    outcomes = [report.outcome for report in driven.reports if report.source == "camera/odom"]
    assert outcomes[:2] == [10, 0]  # begun, accepted
    assert set(outcomes[2:]) == {0}
    assert driven.odometry[-1].twist.twist.linear.x < 0.97 * RADIUS * SPEED  # track slip is 10 %
    key = "camera/odom: whose covariance marks the velocity as absent"
    observer.wait(lambda: any(key in {v.key for v in s.values} for s in driven.healths), "its count")
    summary = driven.end()
    assert summary["replay_matches"] is True
    assert summary["rejected"]["camera/odom"] == {
        "begun": 1,
        "whose covariance marks the velocity as absent": 1,
    }
