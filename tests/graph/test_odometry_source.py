# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A camera's odometry beside the sprockets, live: accepted, counted, recorded, and replayed bit for bit."""

import numpy as np
import pytest
from fixtures.sensor_messages import pose, sprockets, stamped
from nav_msgs.msg import Odometry

STEP_MS, STEPS, EVERY = 20, 100, 5
SPEED, RADIUS = 1.5, 0.159  # rad/s, m
LOST = -1.0  # first element of the covariance of a missing velocity


@pytest.mark.slow
def test_odometry_of_a_camera_is_a_source_like_the_others(programs, observer):
    healths = observer.healths()
    reports, estimates = observer.subscribe("measurement_reports"), observer.subscribe("odometry")
    speeds, fixes, camera = (
        observer.publisher(topic, kind)
        for topic, kind in (("sprockets", None), ("box_pose", None), ("camera/odom", "odometry"))
    )
    programs.node("slip_estimator", odometry_sources=["camera/odom"])
    recorder = programs.node("record", output="bag", more_topics="/camera/odom")
    for topic in ("sprockets", "box_pose", "camera/odom"):
        observer.wait_for_ends(topic, "slip_estimator", "record")
    observer.wait_for_recorder(healths, "odometry", "measurement_reports", "camera/odom")
    sent = refused = 0
    for step in range(STEPS):
        speeds.publish(sprockets(step * STEP_MS, SPEED))
        sent += 1
        if step == 0:
            observer.wait(lambda: reports, "a report of the sprockets")
            fixes.publish(pose(0))
            sent += 1
        if step % EVERY == 2:
            odom = stamped(Odometry, step * STEP_MS - 7)
            odom.header.frame_id, odom.pose.pose.orientation.w = "camera_odom", 1.0
            odom.pose.pose.position.y = 0.9 * RADIUS * SPEED * (step * STEP_MS - 7) * 1e-3  # it faces left
            odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = np.sin(np.pi / 4), np.cos(np.pi / 4)
            odom.twist.covariance[0] = LOST if step == 52 else 0.0
            camera.publish(odom)
            refused += step == 52
            sent += step != 52
        observer.wait(lambda sent=sent: len(reports) == sent, "all reports")
    assert refused == 1
    outcomes = [report.outcome for report in reports if report.source == "camera/odom"]
    assert outcomes[:2] == [10, 0]  # begun, accepted
    assert set(outcomes[2:]) == {0}
    assert estimates[-1].twist.twist.linear.x < 0.97 * RADIUS * SPEED  # track slip is 10 %
    key = "camera/odom: whose covariance marks the velocity as absent"
    observer.wait(lambda: any(key in {v.key for v in s.values} for s in healths), "its count")
    assert recorder.end()[0] == 0
    summary = programs.replay("bag")
    assert summary["replay_matches"] is True
    assert summary["rejected"]["camera/odom"] == {
        "begun": 1,
        "whose covariance marks the velocity as absent": 1,
    }
