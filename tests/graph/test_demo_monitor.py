# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions for starting the demo's drive: nodes must be connected, not only visible."""

import threading
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from fixtures.patience import PATIENCE
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor

from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos
from trackslip_sim.nodes import remote_lifecycle
from trackslip_sim.nodes.demo_monitor import DemoMonitor, join_graph, leave_graph

pytestmark = pytest.mark.xdist_group("graph")


def missing_of_sprockets(monitor, until):
    """Missing connections of the sprockets topic, once ``until`` holds for them."""
    give_up = time.monotonic() + PATIENCE
    while True:
        monitor.spin_for(0.05)
        missing = {
            end for end in monitor.missing_endpoints({"can_driver", "slip_estimator"}) if "sprockets" in end
        }
        if until(missing):
            return missing
        assert time.monotonic() < give_up, missing


def test_demo_waits_until_the_recorder_receives(domain, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    join_graph()
    try:
        monitor, kind = DemoMonitor(), topic_class("sprockets")
        nodes = [rclpy.create_node(name) for name in ("can_driver", "slip_estimator", "record")]
        nodes[0].create_publisher(kind, "sprockets", publisher_qos("sprockets"))
        for node in nodes[1:]:
            node.create_subscription(kind, "sprockets", print, subscriber_qos("sprockets"))
        only = {"sprockets: record"}
        assert missing_of_sprockets(monitor, lambda missing: missing == only) == only
        health = nodes[2].create_publisher(DiagnosticArray, "/diagnostics", 10)

        def report(publishers):
            pair = KeyValue(key="/sprockets", value=publishers)
            status = DiagnosticStatus(name="record: publishers", values=[pair])
            health.publish(DiagnosticArray(status=[status]))

        while not health.get_subscription_count():
            monitor.spin_for(0.05)
        report("0")
        monitor.spin_for(0.3)
        assert missing_of_sprockets(monitor, bool) == only
        report("1")
        assert missing_of_sprockets(monitor, lambda missing: not missing) == set()
        for node in (*nodes, monitor):
            node.destroy_node()
    finally:
        leave_graph()


class ForgetfulEmulator:
    """A node whose answer to the first request is lost, with or without that request being executed."""

    def __init__(self, executes_first):
        self.requests = []
        self._needed, self._state = (1 if executes_first else 2), State(id=State.PRIMARY_STATE_UNCONFIGURED)
        self.node = rclpy.create_node("emulator")
        self.node.create_service(GetState, "emulator/get_state", self._on_state)
        service = self.node.create_service(ChangeState, "emulator/change_state", self._on_change)
        send = service.send_response
        service.send_response = lambda *answer: send(*answer) if len(self.requests) > 1 else None

    def _on_state(self, _, response):
        response.current_state = self._state
        return response

    def _on_change(self, request, response):
        self.requests.append(request.transition.id)
        if len(self.requests) >= self._needed:
            self._state = State(id=State.PRIMARY_STATE_INACTIVE)
        response.success = True
        return response


@pytest.mark.parametrize("executes_first", [True, False], ids=["done", "not done"])
def test_lost_answer_of_a_lifecycle_node_is_requested_again(domain, monkeypatch, executes_first):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setattr(remote_lifecycle, "_ANSWER_TIMEOUT", 0.5)
    join_graph()
    executor = SingleThreadedExecutor()
    spinning = threading.Thread(target=executor.spin)
    try:
        monitor, emulator = DemoMonitor(), ForgetfulEmulator(executes_first)
        executor.add_node(emulator.node)
        spinning.start()
        give_up = time.monotonic() + PATIENCE
        while not monitor.configure_emulator(0.1):
            assert time.monotonic() < give_up, emulator.requests
        assert emulator.requests == [Transition.TRANSITION_CONFIGURE] * (1 if executes_first else 2)
    finally:
        executor.shutdown()
        spinning.join()
        monitor.close()
        leave_graph()
