# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that the middleware fails to send, as to a stalled subscriber, are counted and reported."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.observer import values_of
from fixtures.own_node import NoParameters, started
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.messages import topic_class

DROPPED = "failed to send response (timeout): client will not receive response"  # text of rclpy
SCAN, STATUS = "/scan", "/diagnostics"


class Speaker(TrackslipNode[NoParameters]):
    """A node that publishes when the test requests it."""

    def __init__(self) -> None:
        super().__init__("speaker", NoParameters)

    def configure(self) -> None:
        self.scans = self.advertise(topic_class("scan"), "scan")


@pytest.fixture
def stalled(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Set of topics on which the middleware refuses to send."""
    topics: set[str] = set()
    send = Publisher.publish

    def publish(self: Any, message: Any) -> None:
        if self.topic_name in topics:
            raise rclpy_implementation.RCLError("Failed to publish: cannot publish data,\n at line 1")
        send(self, message)

    monkeypatch.setattr(Publisher, "publish", publish)
    return topics


@pytest.fixture
def speaker(domain: int, stalled: set[str]) -> Iterator[Speaker]:
    with started(Speaker, domain) as node:
        yield node


def test_unsent_messages_are_counted_and_the_node_continues(speaker, stalled, observer):
    healths, scans = observer.healths(), observer.subscribe("scan")
    observer.wait_for_ends("scan", "speaker", "observer")
    message = topic_class("scan")()
    stalled.add(SCAN)
    for _ in range(3):
        speaker.scans.publish(message)
    stalled.clear()
    speaker.scans.publish(message)
    observer.wait(lambda: scans, "the message after those not sent")

    def outputs() -> list[tuple[bytes, str, dict[str, str]]]:
        reported = [health for health in healths if health.name == "speaker: outputs"]
        return [(h.level, h.message, values_of(h)) for h in reported]

    speaker.publish_health()
    speaker.publish_health()
    observer.wait(lambda: len(outputs()) == 2, "both reports")
    counts = {"not sent: /scan": "3"}
    assert outputs() == [
        (DiagnosticStatus.WARN, "3 messages could not be sent", counts),
        (DiagnosticStatus.OK, "running", counts),
    ]
    assert len(scans) == 1


def test_diagnostics_that_cannot_be_sent_do_not_end_the_node(speaker, stalled, observer):
    healths = observer.healths()
    observer.wait_for_ends("/diagnostics", "speaker", "observer")
    stalled.add(STATUS)
    executor = SingleThreadedExecutor()
    executor.add_node(speaker)
    observer.wait(
        lambda: executor.spin_once(timeout_sec=0.1) or speaker.send_failures.counts[STATUS],
        "a report in vain",
    )
    stalled.clear()
    observer.wait(
        lambda: executor.spin_once(timeout_sec=0.1) or "speaker: outputs" in [h.name for h in healths],
        "a report that comes",
    )
    executor.shutdown()


def test_rclpy_still_reports_dropped_answers_in_these_words():
    assert DROPPED.partition(":")[0].encode() in Path(rclpy_implementation.__file__).read_bytes()


def test_answers_dropped_by_the_middleware_are_counted(speaker):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore", RuntimeWarning)  # rcl's other warnings are ignored as well
        speaker.send_failures.count_lost_responses()
        for text in (DROPPED, DROPPED, "something else"):
            warnings.warn(text, RuntimeWarning if text == DROPPED else UserWarning, stacklevel=1)
    assert [str(warning.message) for warning in caught] == ["something else"]
    (health,) = speaker.send_failures.health()
    assert health.values == {"not sent: answers": 2}


def test_all_sent_is_not_reported(speaker, observer):
    healths = observer.healths()
    observer.wait_for_ends("/diagnostics", "speaker", "observer")
    speaker.publish_health()
    observer.wait(lambda: healths, "diagnostics")
    assert {health.name for health in healths} == {"speaker"}
