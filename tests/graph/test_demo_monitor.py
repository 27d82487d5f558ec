# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""When the demo's key may be turned: connected is more than to have appeared."""

import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from fixtures.patience import PATIENCE

from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos
from trackslip_sim.nodes.demo_monitor import DemoMonitor, join_graph, leave_graph

pytestmark = pytest.mark.xdist_group("graph")


def missing_of_sprockets(monitor, until):
    """What of the topic is missing, once ``until`` holds of it."""
    give_up = time.monotonic() + PATIENCE
    while True:
        monitor.spin_for(0.05)
        found = {end for end in monitor.missing_ends({"can_driver", "slip_estimator"}) if "sprockets" in end}
        if until(found):
            return found
        assert time.monotonic() < give_up, found


def test_the_demo_drove_off_while_the_recorder_had_appeared_and_heard_nothing_yet(domain, monkeypatch):
    """Up to 1.2 s of samples and of the estimator's journal were not in the bag."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    join_graph()
    try:
        monitor, kind = DemoMonitor(), topic_class("sprockets")
        nodes = [rclpy.create_node(name) for name in ("can_driver", "slip_estimator", "record")]
        nodes[0].create_publisher(kind, "sprockets", publisher_qos("sprockets"))
        for node in nodes[1:]:
            node.create_subscription(kind, "sprockets", print, subscriber_qos("sprockets"))
        only = {"sprockets: record"}
        assert missing_of_sprockets(monitor, lambda found: found == only) == only
        health = nodes[2].create_publisher(DiagnosticArray, "/diagnostics", 10)

        def says(publishers):
            pair = KeyValue(key="/sprockets", value=publishers)
            status = DiagnosticStatus(name="record: publishers", values=[pair])
            health.publish(DiagnosticArray(status=[status]))

        while not health.get_subscription_count():
            monitor.spin_for(0.05)
        says("0")
        monitor.spin_for(0.3)
        assert missing_of_sprockets(monitor, bool) == only
        says("1")
        assert missing_of_sprockets(monitor, lambda found: not found) == set()
        for node in (*nodes, monitor):
            node.destroy_node()
    finally:
        leave_graph()
