# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reset, freeze, a set pose, new gates and a clock jump on the live node; replay reproduces all of them."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.driven_estimator import DrivenEstimator
from fixtures.observer import values_of
from fixtures.own_node import own_node
from fixtures.sensor_messages import pose, sprockets
from rclpy.parameter import Parameter
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger
from trackslip_msgs.msg import MeasurementReport as R

from trackslip_common.errors import ExitCode
from trackslip_common.make import stamp_ns_of
from trackslip_estimation.nodes.slip_estimator import SlipEstimatorNode

SPEED, RADIUS = 1.5, 0.159  # rad/s, m
SET_POSE = "slip_estimator/set_pose"


def driven_pose(at_ms):
    return pose(at_ms, SPEED * RADIUS * at_ms * 1e-3)


def pose_now(x):
    """A pose without a stamp, as a user sends it."""
    message = pose(0, x)
    message.header = Header()
    return message


class Graph(DrivenEstimator):
    """A recorded drive with constant speeds."""

    def __init__(self, programs, observer, *recording):
        super().__init__(programs, observer, dict.fromkeys(("sprockets", "box_pose", SET_POSE)))
        self.begin("bag", recording, SET_POSE if recording else "", jump_confirmations=5)
        observer.wait_for_recorder(self.healths, "slip_estimator/pose_set")

    def outcome(self, topic, message):
        return self.feed(topic, message).outcome

    def drive(self, start_ms, stop_ms):
        for at_ms in range(start_ms, stop_ms, 20):
            self.feed("sprockets", sprockets(at_ms, SPEED))
            if at_ms % 200 == 0:
                self.feed("box_pose", driven_pose(at_ms))


def test_every_user_command_is_executed_reported_and_answered(programs, observer):
    graph = Graph(programs, observer)
    assert graph.health("waiting for sprockets").level == DiagnosticStatus.WARN
    graph.drive(200, 1000)
    at_ms = 1000

    answer = graph.ask(SetBool, "freeze", SetBool.Request(data=True))
    assert answer.success
    assert graph.outcome("box_pose", driven_pose(at_ms)) == R.FROZEN
    assert graph.outcome("sprockets", sprockets(at_ms, SPEED)) == R.ACCEPTED
    assert graph.ask(SetBool, "freeze", SetBool.Request(data=False)).success
    graph.drive(at_ms + 20, 1400)

    assert graph.outcome(SET_POSE, pose_now(20.0)) == R.ACCEPTED
    graph.feed("sprockets", sprockets(1400, SPEED))
    observer.wait(lambda: abs(graph.odometry[-1].pose.pose.position.x - 20.0) < 0.01, "the given pose")
    assert graph.outcome("box_pose", driven_pose(1400)) == R.GATED

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
    assert graph.outcome("sprockets", sprockets(1420, SPEED)) == R.WAITING
    graph.drive(1600, 4000)
    outcomes = [
        graph.outcome("sprockets", sprockets(at, SPEED)) for at in range(100, 200, 20)
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

    assert observer.change("slip_estimator", "deactivate")
    (result,) = observer.set_parameters("slip_estimator", gate_probability=0.9999)
    assert result.successful, result.reason
    assert observer.change("slip_estimator", "activate")
    graph.drive(1600, 2220)
    assert next(r for r in reversed(graph.reports) if r.source == "box_pose").gate > 10.0

    summary = graph.end(ExitCode.FAILED)
    assert [cause["cause"] for cause in summary["setup"]["causes"]] == [
        "clock_set_back"
    ]  # stamps started again
    assert summary["replay_matches"] is True
    assert summary["rejected"]["box_pose"]["frozen"] == 1


def test_parameters_set_before_the_first_run_reach_the_estimator(domain):
    with own_node(SlipEstimatorNode, domain, autostart=False) as node:
        node.trigger_configure()
        (result,) = node.set_parameters([Parameter("gate_probability", value=0.5)])
        assert result.successful, result.reason
        node.trigger_activate()
        assert node._estimator.parameters.gate_probability == 0.5


@pytest.mark.slow
def test_pose_of_undiscovered_publisher_is_replayed(programs, observer):
    """The recorder may miss a program that sets a pose and ends immediately."""
    graph = Graph(programs, observer, "-r", f"{SET_POSE}:=unrecorded")
    graph.drive(200, 600)
    assert graph.outcome(SET_POSE, pose_now(20.0)) == R.ACCEPTED
    graph.drive(600, 1000)
    assert abs(graph.odometry[-1].pose.pose.position.x - 20.0) < 0.5
    summary = graph.end()
    assert summary["messages"][SET_POSE] == 1
    assert summary["replay_matches"] is True
    assert abs(summary["final"]["x"] - 20.1) < 0.02
