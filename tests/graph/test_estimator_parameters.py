# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters set while the estimator is configured but inactive take effect, also in a replay."""

import time

import pytest
from fixtures.sensor_messages import pose, sprockets

WIDE, NARROW = 0.9999, 0.5
LOST = 5.0  # s without a report after which a message is sent again


def set_gate_probability(observer, value):
    (result,) = observer.set_parameters("slip_estimator", gate_probability=value)
    assert result.successful, result.reason


@pytest.mark.slow
def test_parameters_set_while_inactive_reach_the_estimator(programs, observer):
    speeds, poses = observer.publisher("sprockets"), observer.publisher("box_pose")
    reports = observer.subscribe("measurement_reports")
    texts = observer.subscribe("slip_estimator/parameters")
    healths = observer.healths()
    recorder = programs.node("record", output="bag")
    estimator = programs.node("slip_estimator", autostart=False)
    assert observer.change("slip_estimator", "configure")
    set_gate_probability(observer, NARROW)
    for topic in ("sprockets", "box_pose"):
        observer.wait_for_ends(topic, "observer", "record", "slip_estimator")
    observer.wait_for_recorder(
        healths, "sprockets", "box_pose", "measurement_reports", "slip_estimator/parameters"
    )

    def gate_after(begin_ms):
        """Gate in the report of the last of ten poses."""
        for at_ms in range(begin_ms, begin_ms + 200, 20):
            feed(speeds, sprockets(at_ms))
            feed(poses, pose(at_ms))
        return reports[-1].gate

    def feed(publisher, message):
        """Publish until a report arrives: sensor data, or a report to an unmatched reader, may be lost."""
        due = 0.0

        def is_reported():
            nonlocal due
            if time.monotonic() >= due:
                publisher.publish(message)
                due = time.monotonic() + LOST
            source = publisher.topic_name.removeprefix("/")
            return any(
                r.source == source and r.header.stamp == message.header.stamp for r in reversed(reports)
            )

        observer.wait(is_reported, f"a report on {publisher.topic_name}")

    assert observer.change("slip_estimator", "activate")
    observer.wait(lambda: texts and f"gate_probability: {NARROW}" in texts[-1].data, "the parameters in use")
    assert gate_after(0) < 3.0  # the quantile

    assert observer.change("slip_estimator", "deactivate")
    set_gate_probability(observer, WIDE)
    assert observer.change("slip_estimator", "activate")
    observer.wait(lambda: f"gate_probability: {WIDE}" in texts[-1].data, "the parameters in use")
    assert gate_after(200) > 10.0

    assert recorder.end()[0] == 0
    assert estimator.end()[0] == 0
    assert programs.replay("bag")["replay_matches"] is True
