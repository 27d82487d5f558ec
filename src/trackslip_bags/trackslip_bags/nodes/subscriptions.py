# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of a recorder: serialized messages of known topics, and of topics discovered later."""

import re
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from trackslip_bags.qos import offered_qos
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError
from trackslip_common.nodes.messages import message_class, type_name_of
from trackslip_common.nodes.qos import best_effort_qos, latched_qos, reliable_qos
from trackslip_common.topics import TOPICS, Flow

_GATHERING_TIME = 0.1  # s from a message until all messages received meanwhile are taken
_MAX_BURST = 200  # messages of one topic before the next topic
_LATCHED_DEPTH = 100  # several publishers of one topic, as of /tf_static, keep one message each

Write = Callable[[str, str, bytes, Any], None]  # topic, type, serialized message, info


class RawSubscriptions:
    """Raw subscriptions of a recorder; ``write`` is called with each message.

    Args:
        node: node of the subscriptions.
        bag: bag to which topics are added before their first message.
        more: expression for further topics.
        write: called with topic, type, message and its info (source time, number, reception time).
    """

    def __init__(self, node: Node, bag: BagWriter, more: re.Pattern[str], write: Write) -> None:
        self._node, self._bag, self._more, self._write = node, bag, more, write
        self._known: set[str] = set()
        self._raw_subscriptions: dict[str, Any] = {}  # topic → subscription
        self._choices: dict[str, tuple[str, ...]] = {}  # possible types of topics without a publisher
        self.single_publisher_topics: set[str] = set()  # topics with one publisher
        self.not_recorded: dict[str, str] = {}  # topic → reason
        for name, topic in TOPICS.items():
            full = f"/{name}" if name in ("tf", "diagnostics") else node.resolve_topic_name(name)
            if topic.others:
                self._choices[full] = (topic.type_name, *topic.others)
            self._record_topic(full, topic.type_name, topic.flow is Flow.LATCHED)

    def publishers(self) -> dict[str, int]:
        """Number of publishers per topic."""
        return {
            topic: subscription.get_publisher_count()
            for topic, subscription in self._raw_subscriptions.items()
        }

    def discover(self) -> None:
        """Subscribe to new topics that match the expression; request no more QoS than publishers offer."""
        for topic, types in self._node.get_topic_names_and_types():
            if topic not in self._known and self._more.fullmatch(topic):
                offers = {info.qos_profile.durability for info in self._publisher_infos(topic)}
                self._record_topic(topic, types[0], offers == {DurabilityPolicy.TRANSIENT_LOCAL})
        self._resolve_types()
        for topic, subscription in list(self._raw_subscriptions.items()):
            if subscription.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT:
                continue
            offers = {info.qos_profile.reliability for info in self._publisher_infos(topic)}
            if ReliabilityPolicy.BEST_EFFORT in offers:
                self._node.destroy_subscription(subscription)
                self._subscribe(subscription.msg_type, topic, best_effort_qos())
        self.single_publisher_topics = {topic for topic, count in self.publishers().items() if count == 1}

    def _publisher_infos(self, topic: str) -> list[Any]:
        infos: list[Any] = self._node.get_publishers_info_by_topic(topic)
        return infos

    def _record_topic(self, topic: str, type_name: str, is_latched: bool) -> None:
        self._known.add(topic)
        try:
            kind = message_class(type_name)
            if topic not in self._choices:
                self._bag.add_topic(topic, type_name, offered_qos(is_latched))
        except (ImportError, AttributeError, InputError) as error:
            if topic != "/tf":  # the package of its type is optional
                self.not_recorded[topic] = f"not recorded: {error}"
                self._node.get_logger().warning(f"cannot record {topic} ({type_name}): {error}")
            return
        self._subscribe(kind, topic, latched_qos(_LATCHED_DEPTH) if is_latched else reliable_qos())

    def _subscribe(self, kind: type, topic: str, qos: QoSProfile) -> None:
        callback = partial(self._write_arrived, topic, type_name_of(kind))
        self._raw_subscriptions[topic] = self._node.create_subscription(kind, topic, callback, qos, raw=True)

    def _write_arrived(self, topic: str, type_name: str, data: bytes, info: Any) -> None:
        """Write a message and all that arrive within ``_GATHERING_TIME`` after it, on any topic.

        Message by message, the executor uses three times the CPU, at the moment when other nodes process the
        same messages, and it loses messages three times sooner.
        """
        self._write(topic, type_name, data, info)
        time.sleep(_GATHERING_TIME)
        for name, subscription in self._raw_subscriptions.items():
            kind = type_name_of(subscription.msg_type)
            for _ in range(_MAX_BURST):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    break
                self._write(name, kind, *taken)

    def _resolve_types(self) -> None:
        """Record topics of several possible types with the published type."""
        for topic, types in list(self._choices.items()):
            offered = [info.topic_type for info in self._publisher_infos(topic)]
            published = next((name for name in offered if name in types), None)
            if published is None:
                continue
            del self._choices[topic]
            if published == type_name_of(self._raw_subscriptions[topic].msg_type):
                self._bag.add_topic(topic, published, offered_qos(False))
            else:
                self._node.destroy_subscription(self._raw_subscriptions.pop(topic))
                self._record_topic(topic, published, is_latched=False)
