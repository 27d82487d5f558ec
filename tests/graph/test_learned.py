# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live node keeps learned states over a restart; a replay of the second run reproduces it."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.drawn_machine import Machine, drive
from fixtures.driven_estimator import DrivenEstimator
from fixtures.observer import values_of
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from trackslip_common.make import set_stamp
from trackslip_estimation.slip.measurements import Sprockets, YawRate

EPOCH_NS = 1_700_000_000_000_000_000
PARAMETERS = {
    "sources__box_pose__use_heading": False,
    "initial_yaw_stddev": 0.02,
    "state_file": "kept/slip_estimator.yaml",
}


def message_of(m):
    kind = {Sprockets: JointState, YawRate: Imu}.get(type(m), PoseWithCovarianceStamped)
    message = kind()
    set_stamp(message, EPOCH_NS + m.stamp_ns)
    if isinstance(m, Sprockets):
        message.name = ["left_sprocket", "right_sprocket"]
        message.velocity = [m.left_speed, m.right_speed]
    elif isinstance(m, YawRate):
        message.angular_velocity.z = m.rate
        message.angular_velocity_covariance[8] = m.variance
    else:
        message.pose.pose.position.x, message.pose.pose.position.y = m.pose[:2].tolist()
        message.pose.pose.orientation.w = 1.0
        message.pose.covariance = np.diag([4e-4, 4e-4, 1.0, 1.0, 1.0, 100.0]).flatten()
    return message


def feed(driven, measurements):
    for m in measurements:
        driven.feed(m.source, message_of(m))


def later(measurements, by_ns):
    return [type(m)(**{**vars(m), "stamp_ns": m.stamp_ns + by_ns}) for m in measurements]


@pytest.mark.slow
def test_restart_keeps_learned_states(programs, observer):
    graph = DrivenEstimator(programs, observer, dict.fromkeys(("sprockets", "imu/data_raw", "box_pose")))
    machine = drive(Machine(gyro_scale=0.97, duration=20.0)).measurements
    graph.begin("first", **PARAMETERS)
    entry = graph.health(part="state file")
    assert "no learned values" in entry.message
    assert values_of(graph.health())["gyro scale"] == "not observed yet"
    feed(graph, machine)
    first = graph.end()
    assert first["replay_matches"] is True
    assert first["learned"]["gyro_scale"]["observed"] is True

    graph.begin("second", **PARAMETERS)
    entry = graph.health(part="state file")
    assert "starts from values learned" in entry.message
    assert "gyro reads" in values_of(graph.health())["gyro scale"]
    feed(graph, later(machine[: len(machine) // 4], 10**12))
    assert graph.ask(Trigger, "reset", Trigger.Request()).success
    feed(graph, later(machine[: len(machine) // 4], 10**12 + 5_050_000_000))
    second = graph.end()
    assert second["replay_matches"] is True
    before, after = (run["learned"]["gyro_scale"] for run in (first, second))
    assert after["stddev"] <= before["stddev"] * 1.01
    assert after["value"] == pytest.approx(before["value"], abs=2.0 * before["stddev"])

    graph.begin("third", **PARAMETERS, vehicle__kinematics__tread=0.8)
    entry = graph.health(part="state file")
    assert entry.level == DiagnosticStatus.WARN
    assert "is not used: it is of another vehicle" in entry.message
    state_file = programs.folder / "kept" / "slip_estimator.yaml"
    feed(graph, later(machine[: len(machine) // 4], 2 * 10**12))
    assert graph.ask(Trigger, "forget", Trigger.Request()).success
    assert not state_file.exists()
    assert values_of(graph.health())["gyro scale"] == "not observed yet"
    feed(graph, later(machine[: len(machine) // 4], 2 * 10**12 + 5_050_000_000))
    assert graph.end()["replay_matches"] is True
    assert state_file.exists()
