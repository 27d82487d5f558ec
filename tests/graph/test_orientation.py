# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Orientations of an IMU in the live node: one tells the attitude, another is counted as refused."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Imu, JointState

pytestmark = pytest.mark.xdist_group("graph")

BEGIN_S, PITCH = 1_700_000_000, 0.2


def at(kind, at_ms):
    message = kind()
    message.header.stamp.sec, message.header.stamp.nanosec = BEGIN_S + at_ms // 1000, at_ms % 1000 * 1_000_000
    return message


@pytest.mark.slow
def test_one_is_used_and_one_without_a_covariance_is_counted(programs, observer):
    publishers = {t: observer.publisher(t) for t in ("sprockets", "box_pose", "imu/data_raw")}
    reports, attitudes = observer.subscribe("measurement_reports"), observer.subscribe("attitude")
    healths = observer.healths()
    wanted = {"use_orientation": True, "use_acceleration": False}
    programs.node("slip_estimator", **{f"sources__imu_data_raw__{name}": v for name, v in wanted.items()})
    for topic in publishers:
        observer.wait_for_ends(topic, "observer", "slip_estimator")

    def feed(topic, message):
        expected = len(reports) + 1
        publishers[topic].publish(message)
        observer.wait(lambda: len(reports) >= expected, f"a report on {topic}")

    for at_ms in range(0, 400, 20):
        pose = at(PoseWithCovarianceStamped, at_ms)
        pose.pose.pose.orientation.w = 1.0
        pose.pose.covariance = np.diag([1e-4, 1e-4, 1.0, 1.0, 1.0, 1e-3]).flatten()
        sprockets = at(JointState, at_ms)
        sprockets.name = ["left_sprocket", "right_sprocket"]
        sprockets.position, sprockets.velocity = [0.0, 0.0], [0.0, 0.0]
        imu = at(Imu, at_ms)
        imu.orientation.y, imu.orientation.w = math.sin(PITCH / 2.0), math.cos(PITCH / 2.0)
        if at_ms >= 200:
            imu.orientation_covariance = np.diag([1e-5, 1e-5, 1e-2]).flatten()
        for topic, message in (("box_pose", pose), ("sprockets", sprockets), ("imu/data_raw", imu)):
            feed(topic, message)

    def counted():
        own = [pair for h in healths for pair in h.values if pair.key == "imu/data_raw no_covariance"]
        return own and own[-1].value == "10"

    observer.wait(counted, "ten that have no covariance")
    turn = attitudes[-1].orientation
    assert 2.0 * (turn.w * turn.y - turn.z * turn.x) == pytest.approx(math.sin(PITCH), abs=1e-3)
