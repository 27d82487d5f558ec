# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``replay``: publishes the messages of a bag unchanged, and ``/clock``, to a live graph."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool

from trackslip_bags.playback import Playback
from trackslip_common.errors import ExitCode
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, Health
from trackslip_common.nodes.messages import message_class
from trackslip_common.nodes.qos import publisher_qos, reliable_qos
from trackslip_common.nodes.run import run
from trackslip_common.parameters import Parameters
from trackslip_common.topics import TOPICS
from trackslip_common.units import NS_PER_S

_TICK = 0.002  # s, largest delay of a message
_LONGEST_TICK = 0.05  # s of publishing before the executor continues
_CLOCK_PERIOD = 0.01  # s of wall time
_SETTLING_TIME = 1.0  # s without a new subscriber, after which discovery counts as complete
_SUBSCRIBER_TIMEOUT = 4.0  # s without a subscriber, after which discovery ends; it may take some seconds
_ACK_TIMEOUT = 2.0  # s, for acknowledgement of the last messages
_PAUSE_KEY = " "


@dataclass(frozen=True, kw_only=True)
class PlayerParameters(Parameters):
    """No parameters: all options are on the command line."""


class PlayerNode(TrackslipNode[PlayerParameters]):
    """Publishes due messages until the bag ends; the space bar and ``~/pause`` pause it.

    Args:
        playback: the messages and their times.
        topics: name → type of the messages.
        keys: returns the keys typed since its last call.
        show: called regularly with the playback.
    """

    def __init__(
        self,
        playback: Playback,
        topics: Mapping[str, str],
        keys: Callable[[], str],
        show: Callable[[Playback], None],
    ) -> None:
        self._playback, self._topics = playback, topics
        self._keys, self._show = keys, show
        super().__init__("replay", PlayerParameters)
        self.create_service(SetBool, "~/pause", self._on_pause)

    def configure(self) -> None:
        """Create all publishers, so that subscribers discover them."""
        self._topic_publishers = {
            topic: self.count_send_failures(self.create_publisher(message_class(kind), topic, _qos_of(topic)))
            for topic, kind in self._topics.items()
        }
        self._time = self.count_send_failures(self.create_publisher(ClockMessage, "/clock", 10))
        self._matched, self._quiet_since = 0, time.monotonic()
        self._has_begun = False  # whether playback has begun
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_TICK, self._play, clock=steady)
        self.create_timer(_CLOCK_PERIOD, self._publish_time, clock=steady)

    def deactivate(self) -> None:
        """Pause, as ``~/pause`` does."""
        self._playback.paused = True

    def health(self) -> list[Health]:
        """State and message counts of the playback."""
        word = "paused" if self._playback.paused else "playing"
        return [Health(OK, word, dict(self._playback.counts))]

    def _play(self) -> None:
        now_s = time.monotonic()
        if not self.active or not (self._has_begun or self._is_discovery_complete(now_s)):
            return
        for message in self._playback.due_messages(now_s):
            self._topic_publishers[message.topic].publish(message.raw)
            if time.monotonic() > now_s + _LONGEST_TICK:
                break
        if self._playback.is_finished:
            self._finish()

    def _is_discovery_complete(self, now_s: float) -> bool:
        """Whether discovery is complete: subscribers lose messages published before they are matched."""
        matched = sum(publisher.get_subscription_count() for publisher in self._topic_publishers.values())
        if matched != self._matched:
            self._matched, self._quiet_since = matched, now_s
        self._has_begun = now_s - self._quiet_since >= (_SETTLING_TIME if matched else _SUBSCRIBER_TIMEOUT)
        if self._has_begun:
            self._warn_of_other_publishers()
        return self._has_begun

    def _warn_of_other_publishers(self) -> None:
        """Warn if nothing subscribes, and of topics with other publishers, such as running drivers."""
        if not self._matched:
            self.get_logger().warning("no node subscribes to the played topics")
        for topic in self._topic_publishers:
            others = {info.node_name for info in self.get_publishers_info_by_topic(topic)} - {self.get_name()}
            if others:
                self.get_logger().warning(f"{topic} is published by {', '.join(sorted(others))} too")

    def _publish_time(self) -> None:
        sec, nanosec = divmod(self._playback.bag_ns, NS_PER_S)
        self._time.publish(ClockMessage(clock=Time(sec=sec, nanosec=nanosec)))
        if self._keys().count(_PAUSE_KEY) % 2 == 1:
            self._playback.paused = not self._playback.paused
        self._show(self._playback)

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._playback.paused = request.data
        response.success, response.message = True, "paused" if request.data else "playing"
        return response

    def _finish(self) -> None:
        """Wait for acknowledgement of all messages; then end the node."""
        deadline_s = time.monotonic() + _ACK_TIMEOUT
        for publisher in self._topic_publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=max(deadline_s - time.monotonic(), 0.0)))
        rclpy.try_shutdown()


def _qos_of(topic: str) -> Any:
    name = topic.removeprefix("/")
    return publisher_qos(name) if name in TOPICS else reliable_qos()


def can_publish(type_name: str) -> bool:
    """Whether the package of a message type is installed."""
    try:
        message_class(type_name)
    except (ImportError, AttributeError, ValueError):
        return False
    return True


def play(
    playback: Playback,
    topics: Mapping[str, str],
    keys: Callable[[], str],
    show: Callable[[Playback], None],
) -> int:
    """Play to the end or until Ctrl-C; returns the exit code."""
    return run(lambda: PlayerNode(playback, topics, keys, show), argv=[], interrupt_code=ExitCode.INTERRUPTED)
