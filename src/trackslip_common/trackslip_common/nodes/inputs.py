# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks the inputs of a node: publishers, their number, type and quality of service, and the rate."""

import time
from typing import Any

from trackslip_common.nodes.health import ERROR, Health
from trackslip_common.nodes.messages import type_name_of
from trackslip_common.rate_limiter import RateLimiter

_MATCHING_TIME = 1.0  # s from the discovery of a publisher until it has matched
_ONE_PUBLISHER = "end all but one, or set a namespace for each machine"


class Inputs:
    """The topics that a node subscribes to; each should have one publisher, with the rate of a sensor."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._subscriptions: dict[str, Any] = {}  # of topics that should have one publisher
        self._unmatched: dict[str, float] = {}  # topic with a publisher that does not match → since, s
        self._rate_limiter = RateLimiter()

    def add(self, topic: str, subscription: Any) -> None:
        """Add the subscription of a topic that should have one publisher."""
        self._subscriptions[topic] = subscription

    def clear(self) -> None:
        """Remove all topics."""
        self._subscriptions.clear()

    def accept_message(self, topic: str) -> bool:
        """Whether the rate limit of the topic allows one more message."""
        return self._rate_limiter.accept_message(topic)

    def health(self) -> list[Health]:
        """An error if an input floods, or has a publisher whose messages do not arrive.

        Of several publishers the messages look like one sensor's, which is an error too.
        """
        counts = {topic: one.get_publisher_count() for topic, one in sorted(self._subscriptions.items())}
        several = {topic: count for topic, count in counts.items() if count > 1}
        now_s, before = time.monotonic(), self._unmatched
        self._unmatched = {t: before.get(t, now_s) for t in counts if self._published(t) > counts[t]}
        unmatched = [topic for topic, since_s in self._unmatched.items() if now_s - since_s >= _MATCHING_TIME]
        new_drops = self._rate_limiter.new_drops()
        findings = [f"several publishers of {', '.join(several)} ({_ONE_PUBLISHER})"] if several else []
        findings += map(self._mismatch, unmatched)
        findings += [f"{count} messages of {topic} were too many" for topic, count in new_drops.items()]
        if not findings:
            return []
        values: dict[str, Any] = dict(several)
        values |= {f"{topic} dropped": count for topic, count in self._rate_limiter.dropped.items()}
        topics = dict.fromkeys((*several, *unmatched, *new_drops))
        values |= {f"publishers of {topic}": self._publishers(topic) for topic in topics if topic in counts}
        return [Health(ERROR, "; ".join(findings), values, part="inputs")]

    def _published(self, topic: str) -> int:
        """Number of a topic's publishers, whether their messages arrive or not."""
        count: int = self._node.count_publishers(self._subscriptions[topic].topic_name)
        return count

    def _mismatch(self, topic: str) -> str:
        """Why the messages of a publisher do not arrive."""
        accepted = type_name_of(self._subscriptions[topic].msg_type)
        types = {info.topic_type for info in self._infos(topic)} - {accepted}
        if types:
            return f"{topic} is published as {', '.join(sorted(types))}; accepted: {accepted}"
        return f"{topic} is published with another quality of service (reliability, durability)"

    def _infos(self, topic: str) -> list[Any]:
        infos: list[Any] = self._node.get_publishers_info_by_topic(self._subscriptions[topic].topic_name)
        return infos

    def _publishers(self, topic: str) -> str:
        """Names of a topic's publishers, with namespaces."""
        infos = self._infos(topic)
        return ", ".join(sorted(f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in infos))
