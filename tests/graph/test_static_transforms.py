# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""With tf2_msgs: an IMU's mounting is read from /tf_static; /tf is map → odom → base_link."""

from pathlib import Path

import pytest
from fixtures.driven_estimator import DrivenEstimator
from fixtures.sensor_messages import pose, sprockets, stamped
from sensor_msgs.msg import Imu
from trackslip_msgs.msg import MeasurementReport

PEER = Path(__file__).with_name("tf_peer.py")
REFUSED = "imu/data_raw: of a frame without a transform to base_link in /tf_static"
STEP_MS, RATE = 20, 0.4  # yaw rate, rad/s
SPEED = RATE * 0.73 / 2.0 / 0.159  # sprocket speed of the PC05 in a pivot turn, rad/s


class Turning(DrivenEstimator):
    """A machine in a left pivot turn; its IMU is mounted upside down."""

    def __init__(self, programs, observer):
        super().__init__(programs, observer, dict.fromkeys(("sprockets", "box_pose", "imu/data_raw")))
        self._step = 0

    def drive(self, steps):
        """Publish the messages of each step after the reports of the previous one."""
        for _ in range(steps):
            at_ms = self._step * STEP_MS
            imu = stamped(Imu, at_ms, "imu_link")
            imu.angular_velocity.z = -RATE
            self.feed("box_pose", pose(at_ms, yaw=RATE * at_ms * 1e-3))
            self.publish("imu/data_raw", imu)
            self.feed("sprockets", sprockets(at_ms, -SPEED, SPEED))
            self._step += 1

    def gyro(self):
        """Outcomes of the gyro's measurements."""
        return [r.outcome for r in self.reports if r.source == "imu/data_raw"]


@pytest.fixture
def with_tf2(programs, tf2_environment):
    programs.environment = {**programs.environment, **tf2_environment}
    return programs


def test_an_imu_is_mounted_as_tf_static_states(with_tf2, observer):
    turning, parameters = Turning(with_tf2, observer), observer.subscribe("slip_estimator/parameters")
    turning.begin(sources__imu_data_raw__mounting_from_tf=True)
    turning.drive(20)

    def counted():
        counts = [pair.value for h in turning.healths for pair in h.values if pair.key == REFUSED]
        return counts and counts[-1] == "20"

    observer.wait(counted, "twenty readings without a transform")
    assert turning.gyro() == []

    peer = with_tf2.python(str(PEER))
    observer.wait_for_ends("/tf_static", "tf_peer", "slip_estimator")
    observer.wait_for_ends("/tf", "tf_peer", "slip_estimator")

    def mounted():
        turning.drive(1)
        return turning.gyro()

    observer.wait(mounted, "the first reading that is used")
    turning.drive(50)
    assert set(turning.gyro()) == {MeasurementReport.ACCEPTED}
    assert turning.odometry[-1].twist.twist.angular.z == pytest.approx(RATE, abs=0.02)
    assert "mounting_yaw: 1.57" in parameters[-1].data

    def chain():
        lines = [line.split() for line in peer.stdout.splitlines()]
        return {(parent, child) for parent, child, _ in lines} == {("map", "odom"), ("odom", "base_link")}

    peer.until(chain, "map → odom → base_link on /tf")
