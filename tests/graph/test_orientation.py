# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Orientations of an IMU in the live node: one sets the attitude; one without a covariance is counted."""

import math

import numpy as np
import pytest
from fixtures.sensor_messages import pose, sprockets, stamped
from sensor_msgs.msg import Imu

pytestmark = pytest.mark.xdist_group("graph")

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
