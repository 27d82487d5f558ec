# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live node keeps learned states over a restart; a replay of the second run reproduces it."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.commands import json_of
from fixtures.drawn_machine import Machine, drive
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


class Graph:
    """Successive runs of estimator and recorder."""

    def __init__(self, programs, observer):
        self.programs, self.observer = programs, observer
        self.topics = {t: observer.publisher(t) for t in ("sprockets", "imu/data_raw", "box_pose")}
        self.reports = observer.subscribe("measurement_reports")
        self.healths = observer.healths()

    def begin(self, bag, **changes):
        self.healths.clear()  # reports of the previous recorder
        for topic, publisher in self.topics.items():  # endpoints of the previous nodes
            self.observer.wait(lambda p=publisher: p.get_subscription_count() == 0, f"no ends of {topic}")
        self.recorder = self.programs.node("record", output=bag)
        self.estimator = self.programs.node("slip_estimator", **{**PARAMETERS, **changes})
        for topic in self.topics:
            self.observer.wait_for_ends(topic, "record", "slip_estimator")
        self.observer.wait_until_active("record", "slip_estimator")
        outputs = ("odometry", "track_slip", "measurement_reports", "slip_estimator/parameters")
        self.observer.wait_for_recorder(self.healths, *outputs, *self.topics)

    def feed(self, measurements):
        """Publish one message at a time, so that none is lost on a busy machine."""
        self.reports.clear()
        for count, m in enumerate(measurements, 1):
            self.topics[m.source].publish(message_of(m))
            self.observer.wait(lambda n=count: len(self.reports) >= n, f"{count} reports")

    def status(self, name):
        """The next diagnostics entry of this name, and its values."""
        self.healths.clear()

        def matching():
            return [h for h in self.healths if h.name == name]

        self.observer.wait(matching, name)
        entry = matching()[-1]
        return entry, values_of(entry)

    def ask(self, service):
        return self.observer.ask(Trigger, f"slip_estimator/{service}", Trigger.Request())

    def end(self, bag):
        """End both nodes; the summary of a replay of the run."""
        assert self.recorder.end(signal.SIGINT)[0] == 0
        assert self.estimator.end()[0] == 0
        return json_of(self.programs.folder, "replay", self.programs.folder / bag)


def later(measurements, by_ns):
    return [type(m)(**{**vars(m), "stamp_ns": m.stamp_ns + by_ns}) for m in measurements]


@pytest.mark.slow
def test_restart_keeps_learned_states(programs, observer, capsys):
    graph = Graph(programs, observer)
    machine = drive(Machine(gyro_scale=0.97, duration=20.0)).measurements
    graph.begin("first")
    entry, _ = graph.status("slip_estimator: state file")
    assert "no learned values" in entry.message
    assert graph.status("slip_estimator")[1]["gyro scale"] == "not observed yet"
    graph.feed(machine)
    first = graph.end("first")
    assert first["replay_matches"] is True
    assert first["learned"]["gyro_scale"]["observed"] is True

    graph.begin("second")
    entry, _ = graph.status("slip_estimator: state file")
    assert "starts from values learned" in entry.message
    assert "gyro reads" in graph.status("slip_estimator")[1]["gyro scale"]
    graph.feed(later(machine[: len(machine) // 4], 10**12))
    assert graph.ask("reset").success
    graph.feed(later(machine[: len(machine) // 4], 10**12 + 5_050_000_000))
    capsys.readouterr()
    second = graph.end("second")
    assert second["replay_matches"] is True
    before, after = (run["learned"]["gyro_scale"] for run in (first, second))
    assert after["stddev"] <= before["stddev"] * 1.01
    assert after["value"] == pytest.approx(before["value"], abs=2.0 * before["stddev"])
    assert "starts from values learned before" in capsys.readouterr().out

    graph.begin("third", vehicle__kinematics__tread=0.8)
    entry, _ = graph.status("slip_estimator: state file")
    assert entry.level == DiagnosticStatus.WARN
    assert "is not used: it is of another vehicle" in entry.message
    state_file = programs.folder / "kept" / "slip_estimator.yaml"
    graph.feed(later(machine[: len(machine) // 4], 2 * 10**12))
    assert graph.ask("forget").success
    assert not state_file.exists()
    assert graph.status("slip_estimator")[1]["gyro scale"] == "not observed yet"
    graph.feed(later(machine[: len(machine) // 4], 2 * 10**12 + 5_050_000_000))
    assert graph.end("third")["replay_matches"] is True
    assert state_file.exists()
