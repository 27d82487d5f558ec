# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Further sources of the live slip estimator: slip seeds, orientations of an IMU, odometry of a camera."""

import math

import numpy as np
import pytest
from fixtures.sensor_messages import pose, sprockets, stamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from trackslip_msgs.msg import MeasurementReport, TrackSlip

pytestmark = pytest.mark.xdist_group("graph")

SEED_SPEED = 2.0  # rad/s


def seed(at_ms, slip):
    message = stamped(TrackSlip, at_ms)
    message.left_slip = message.right_slip = slip
    message.covariance = np.array((1e-5, 9e-6, 0.0, 9e-6, 1e-5, 0.0, 0.0, 0.0, 1e6))
    return message


def test_node_accepts_seeds_and_reports_their_outcome(programs, observer):
    topics = {topic: observer.publisher(topic) for topic in ("sprockets", "box_pose", "slip_seed")}
    reports, slips = observer.subscribe("measurement_reports"), observer.subscribe("track_slip")
    programs.node("slip_estimator", slip_sources=["slip_seed"], model="free_slips")  # slips are its states
    for topic in (*topics, "measurement_reports", "track_slip"):
        observer.wait_for_ends(topic, "slip_estimator")
    observer.wait_until_active("slip_estimator")

    def send(topic, message):
        expected = len(reports) + 1
        topics[topic].publish(message)
        observer.wait(lambda: len(reports) >= expected, f"a report on {topic}")
        return reports[-1]

    send("box_pose", pose(0))
    for at_ms in range(20, 1000, 20):
        send("sprockets", sprockets(at_ms, SEED_SPEED))
    late = send("slip_seed", seed(500, 0.04))
    assert (late.source, late.outcome, late.dof) == ("slip_seed", MeasurementReport.ACCEPTED, 2)
    assert late.header.stamp.nanosec == 500_000_000
    bad = send("slip_seed", seed(600, float("nan")))
    assert (bad.source, bad.outcome) == ("slip_seed", MeasurementReport.INVALID)
    reported = len(slips)
    send("sprockets", sprockets(1000, SEED_SPEED))
    observer.wait(lambda: len(slips) > reported, "slips")
    assert slips[-1].left_slip == pytest.approx(0.04, abs=0.02)
    assert slips[-1].right_slip == pytest.approx(slips[-1].left_slip, abs=1e-3)


PITCH = 0.2  # rad


@pytest.mark.slow
def test_orientation_is_used_and_one_without_a_covariance_is_counted(programs, observer):
    publishers = {t: observer.publisher(t) for t in ("sprockets", "box_pose", "imu/data_raw")}
    reports, attitudes = observer.subscribe("measurement_reports"), observer.subscribe("attitude")
    healths = observer.healths()
    settings = {"use_orientation": True, "use_acceleration": False}
    programs.node("slip_estimator", **{f"sources__imu_data_raw__{name}": v for name, v in settings.items()})
    for topic in publishers:
        observer.wait_for_ends(topic, "observer", "slip_estimator")

    def feed(topic, message):
        expected = len(reports) + 1
        publishers[topic].publish(message)
        observer.wait(lambda: len(reports) >= expected, f"a report on {topic}")

    for at_ms in range(0, 400, 20):
        imu = stamped(Imu, at_ms)
        imu.orientation.y, imu.orientation.w = math.sin(PITCH / 2.0), math.cos(PITCH / 2.0)
        if at_ms >= 200:
            imu.orientation_covariance = np.diag([1e-5, 1e-5, 1e-2]).flatten()
        feed("box_pose", pose(at_ms))
        feed("sprockets", sprockets(at_ms))
        feed("imu/data_raw", imu)

    def counted():
        counts = [pair for h in healths for pair in h.values if pair.key == "imu/data_raw: no_covariance"]
        return counts and counts[-1].value == "10"

    observer.wait(counted, "ten that have no covariance")
    turn = attitudes[-1].orientation
    assert 2.0 * (turn.w * turn.y - turn.z * turn.x) == pytest.approx(math.sin(PITCH), abs=1e-3)


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
