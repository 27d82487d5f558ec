# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The slip estimator accepts slip seeds where it is configured to, and reports on each."""

import numpy as np
import pytest
from fixtures.sensor_messages import pose, sprockets, stamped
from trackslip_msgs.msg import MeasurementReport, TrackSlip

SPEED = 2.0  # rad/s


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
        send("sprockets", sprockets(at_ms, SPEED))
    late = send("slip_seed", seed(500, 0.04))
    assert (late.source, late.outcome, late.dof) == ("slip_seed", MeasurementReport.ACCEPTED, 2)
    assert late.header.stamp.nanosec == 500_000_000
    bad = send("slip_seed", seed(600, float("nan")))
    assert (bad.source, bad.outcome) == ("slip_seed", MeasurementReport.INVALID)
    reported = len(slips)
    send("sprockets", sprockets(1000, SPEED))
    observer.wait(lambda: len(slips) > reported, "slips")
    assert slips[-1].left_slip == pytest.approx(0.04, abs=0.02)
    assert slips[-1].right_slip == pytest.approx(slips[-1].left_slip, abs=1e-3)
