# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reset, freeze, a set pose, new gates and a clock jump on the live node; replay reproduces all of them."""

import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.observer import values_of
from fixtures.sensor_messages import pose, sprockets
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from trackslip_msgs.msg import MeasurementReport as R

from trackslip_common.make import stamp_ns_of

SPEED, RADIUS = 1.5, 0.159  # rad/s, m
SET_POSE = "slip_estimator/set_pose"


def driven_pose(at_ms):
    return pose(at_ms, SPEED * RADIUS * at_ms * 1e-3)


def pose_now(x):
    """A pose without a stamp, as a user sends it."""
    message = pose(0, x)
    message.header = Header()
    return message


class Graph:
    """Estimator and recorder, driven by the test."""

    def __init__(self, programs, observer, *recorder_options):
        self._programs, self._observer = programs, observer
        self._topics = {
            "sprockets": observer.publisher("sprockets"),
            "box_pose": observer.publisher("box_pose"),
            SET_POSE: observer.publisher(SET_POSE),
        }
        self.reports = observer.subscribe("measurement_reports")
        self.odometry = observer.subscribe("odometry")
        self.healths = observer.healths()
        self._recorder = programs.node("record", *recorder_options, output="bag")
        self._estimator = programs.node("slip_estimator", jump_confirmations=5)
        received = ("sprockets", "box_pose") if recorder_options else self._topics
        for topic in self._topics:
            observer.wait_for_ends(topic, "slip_estimator", *(["record"] if topic in received else []))
        observer.wait_for_ends("slip_estimator/parameters", "slip_estimator", "record")
        observer.wait_for_ends("measurement_reports", "slip_estimator", "record")
        observer.wait_until_active("record", "slip_estimator")
        outputs = ("odometry", "track_slip", "measurement_reports", "slip_estimator/pose_set")
        observer.wait_for_recorder(self.healths, *outputs, *received)

    def feed(self, topic, message):
        """Publish a message and wait for its report; the reported outcome."""
        expected = len(self.reports) + 1
        self._topics[topic].publish(message)
        self._observer.wait(lambda: len(self.reports) >= expected, f"a report on {topic}")
        return self.reports[-1].outcome

    def drive(self, start_ms, stop_ms):
        for at_ms in range(start_ms, stop_ms, 20):
            self.feed("sprockets", sprockets(at_ms, SPEED))
            if at_ms % 200 == 0:
                self.feed("box_pose", driven_pose(at_ms))

    def ask(self, service, name, request):
        return self._observer.ask(service, f"slip_estimator/{name}", request)

    def health(self, text):
        """The next diagnostics entry whose message contains the text."""
        self.healths.clear()

        def matching():
            return [h for h in self.healths if h.name == "slip_estimator" and text in h.message]

        self._observer.wait(matching, text)
        return matching()[0]

    def end(self):
        """End both nodes; the summary of a replay of the bag."""
        assert self._recorder.end(signal.SIGINT)[0] == 0
        assert self._estimator.end()[0] == 0
        return self._programs.replay("bag")


def test_every_user_command_is_executed_reported_and_answered(programs, observer):
    graph = Graph(programs, observer)
    assert graph.health("waiting for sprockets").level == DiagnosticStatus.WARN
    graph.drive(200, 1000)
    at_ms = 1000

    answer = graph.ask(SetBool, "freeze", SetBool.Request(data=True))
    assert answer.success
    assert graph.feed("box_pose", driven_pose(at_ms)) == R.FROZEN
    assert graph.feed("sprockets", sprockets(at_ms, SPEED)) == R.ACCEPTED
    assert graph.ask(SetBool, "freeze", SetBool.Request(data=False)).success
    graph.drive(at_ms + 20, 1400)

    assert graph.feed(SET_POSE, pose_now(20.0)) == R.ACCEPTED
    graph.feed("sprockets", sprockets(1400, SPEED))
    observer.wait(lambda: abs(graph.odometry[-1].pose.pose.position.x - 20.0) < 0.01, "the given pose")
    assert graph.feed("box_pose", driven_pose(1400)) == R.GATED

    for name, value, successful in (
        ("gate_probability", 0.5, True),
        ("sources.box_pose.timeout", 3.0, True),
        ("vehicle.kinematics.tread", 0.7, False),
        ("gate_probability", 2.0, False),
    ):
        (result,) = observer.set_parameters("slip_estimator", **{name: value})
        assert result.successful is successful, result.reason
    graph.feed("box_pose", driven_pose(1410))
    assert graph.reports[-1].gate < 12.0  # four times the quantile

    assert graph.ask(Trigger, "reset", Trigger.Request()).success
    assert graph.feed("sprockets", sprockets(1420, SPEED)) == R.WAITING
    graph.drive(1600, 4000)
    outcomes = [
        graph.feed("sprockets", sprockets(at, SPEED)) for at in range(100, 200, 20)
    ]  # the stamps start again, as in a repeated bag
    assert outcomes == [R.TOO_LATE] * 4 + [R.RESTARTED]
    graph.drive(200, 1500)

    silent = graph.health("sprockets silent")
    assert silent.level == DiagnosticStatus.ERROR
    values = values_of(silent)
    assert values["restarts"] == "1"
    assert int(values["sprockets: too_late"]) == 4
    assert "if consistent" in values["box_pose nis"]

    reported = [r.source for r in graph.reports if r.source.startswith("slip_estimator/")]
    names = ("freeze", "unfreeze", "set_pose", "parameters", "parameters", "reset")
    assert reported == [f"slip_estimator/{name}" for name in names]
    stamps_ns = [stamp_ns_of(m) for m in graph.odometry]
    assert np.count_nonzero(np.diff(stamps_ns) <= 0) == 1
    summary = graph.end()
    assert summary["replay_matches"] is True
    assert summary["rejected"]["box_pose"]["frozen"] == 1


@pytest.mark.slow
def test_pose_of_undiscovered_publisher_is_replayed(programs, observer):
    """The recorder may miss a program that sets a pose and ends immediately."""
    graph = Graph(programs, observer, "-r", f"{SET_POSE}:=unrecorded")
    graph.drive(200, 600)
    assert graph.feed(SET_POSE, pose_now(20.0)) == R.ACCEPTED
    graph.drive(600, 1000)
    assert abs(graph.odometry[-1].pose.pose.position.x - 20.0) < 0.5
    summary = graph.end()
    assert summary["messages"][SET_POSE] == 1
    assert summary["replay_matches"] is True
    assert abs(summary["final"]["x"] - 20.1) < 0.02
