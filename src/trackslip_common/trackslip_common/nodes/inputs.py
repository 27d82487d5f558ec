# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Checks the inputs of a node: the number of publishers, and the message rate."""

from typing import Any

from trackslip_common.nodes.health import ERROR, Health
from trackslip_common.rate_limiter import RateLimiter


class Inputs:
    """The topics that a node subscribes to; each should have one publisher, with the rate of a sensor."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._topics: set[str] = set()  # topics that should have one publisher
        self._rate_limiter = RateLimiter()

    def add(self, topic: str) -> None:
        """Add a topic that should have one publisher."""
        self._topics.add(topic)

    def clear(self) -> None:
        """Remove all topics."""
        self._topics.clear()

    def accept_message(self, topic: str) -> bool:
        """Whether the rate limit of the topic allows one more message."""
        return self._rate_limiter.accept_message(topic)

    def health(self) -> list[Health]:
        """An error if an input floods or has several publishers, whose messages look like one sensor's."""
        counts = {topic: self._node.count_publishers(topic) for topic in sorted(self._topics)}
        several = {topic: count for topic, count in counts.items() if count > 1}
        new_drops = self._rate_limiter.new_drops()
        findings = [f"several publishers of {', '.join(several)}"] if several else []
        findings += [f"{count} messages of {topic} were too many" for topic, count in new_drops.items()]
        if not findings:
            return []
        values: dict[str, Any] = dict(several)
        values |= {f"{topic} dropped": count for topic, count in self._rate_limiter.dropped.items()}
        values |= {f"publishers of {topic}": self._publishers(topic) for topic in {**several, **new_drops}}
        return [Health(ERROR, "; ".join(findings), values, part="inputs")]

    def _publishers(self, topic: str) -> str:
        """Names of a topic's publishers, with namespaces."""
        infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return ", ".join(sorted(f"{i.node_namespace.rstrip('/')}/{i.node_name}" for i in infos))
