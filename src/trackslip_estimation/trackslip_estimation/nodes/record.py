# SPDX-License-Identifier: Apache-2.0
"""``record``: writes the serialized messages of all project topics, as they come, to an MCAP bag."""

import re
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy

from trackslip_common.errors import InputError
from trackslip_common.nodes.base import OK, WARN, Health, TrackslipNode
from trackslip_common.nodes.messages import message_class, type_name_of
from trackslip_common.nodes.qos import best_effort, reliable, wanted
from trackslip_common.nodes.run import run
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.topics import TOPICS, Flow
from trackslip_estimation.bags.qos import offered_qos
from trackslip_estimation.bags.writer import BagWriter

_DISCOVERY_PERIOD = 0.5  # s
_LONGEST_DRAIN = 1.0  # s
_IDLE_SPINS = 4  # without a message: a timer may take one of them


@dataclass(frozen=True, kw_only=True)
class RecordParameters(Parameters):
    """What to record, and where to."""

    output: str = parameter("directory of the bag; empty: trackslip_<date>_<time>")
    more_topics: str = parameter("regular expression over further topics; empty: none")


class RecordNode(TrackslipNode[RecordParameters]):
    """Subscribes without decoding; counts what it writes and what the middleware says was lost."""

    def __init__(self) -> None:
        super().__init__("record", RecordParameters, "record.yaml")

    def configure(self) -> None:
        """Compile the expression, so that a bad one is refused at the start.

        Raises:
            InputError: ``more_topics`` is not a regular expression.
        """
        self._lost: Counter[str] = Counter()
        self._subscribed: set[str] = set()
        self._taps: dict[str, Any] = {}  # subscription of each topic
        self._reliable: set[str] = set()
        self._bag: BagWriter | None = None
        try:
            self._more = re.compile(self.settings.more_topics or r"(?!)")
        except re.error as error:
            text = f"'{self.settings.more_topics}' is refused ({error}); accepted: a regular expression"
            raise InputError(f"record: more_topics: {text}") from error
        self.create_timer(_DISCOVERY_PERIOD, self._discover)

    def activate(self) -> None:
        """Open the bag and subscribe."""
        self._bag = BagWriter(self.settings.output or time.strftime("trackslip_%Y%m%d_%H%M%S"))
        for name, topic in TOPICS.items():
            full = f"/{name}" if name in ("tf", "diagnostics") else self.resolve_topic_name(name)
            self._record(full, topic.type_name, name)

    def deactivate(self) -> None:
        """Finish the bag; the next activation begins another."""
        self.drop_subscriptions()
        self._subscribed.clear()
        self._taps.clear()
        self._reliable.clear()
        if self._bag is not None:
            self._bag.close()
            self.get_logger().info(f"{sum(self._bag.counts.values())} messages in {self._bag.path}")
            self._bag = None

    def drain(self, spin_once: Callable[[], None]) -> None:
        """What was received is written, also what came just before the end."""
        give_up_s = time.monotonic() + _LONGEST_DRAIN
        idle = 0
        while self._bag is not None and idle < _IDLE_SPINS and time.monotonic() < give_up_s:
            before = sum(self._bag.counts.values())
            spin_once()
            idle = idle + 1 if sum(self._bag.counts.values()) == before else 0

    def health(self) -> list[Health]:
        """Counts per topic; a warning if anything was lost."""
        assert self._bag is not None
        counts: dict[str, Any] = dict(self._bag.counts)
        lost = {f"{topic} lost": n for topic, n in self._lost.items()}
        level, word = (WARN, "messages were lost") if lost else (OK, "recording")
        matched: dict[str, Any] = {topic: tap.get_publisher_count() for topic, tap in self._taps.items()}
        return [
            Health(level, f"{word}: {self._bag.path}", counts | lost),
            Health(OK, f"{sum(matched.values())} publishers found", matched, part="publishers"),
        ]

    def _record(self, full_name: str, type_name: str, name: str) -> None:
        self._subscribed.add(full_name)
        try:
            kind = message_class(type_name)
        except ModuleNotFoundError:  # an optional package, such as tf2_msgs
            return
        assert self._bag is not None
        latched = name in TOPICS and TOPICS[name].flow is Flow.LATCHED
        self._bag.add_topic(full_name, type_name, offered_qos(latched))
        qos = wanted(name) if latched else reliable()
        self._reliable.add(full_name)
        self._tap(kind, full_name, type_name, qos)

    def _tap(self, kind: type, topic: str, type_name: str, qos: QoSProfile) -> None:
        self._taps[topic] = self.create_subscription(
            kind,
            topic,
            partial(self._write, topic, type_name),
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=partial(self._on_lost, topic)),
        )

    def _yield_to_best_effort(self) -> None:
        """Ask for no more than a topic's publishers offer, or nothing would come at all."""
        for topic in list(self._reliable):
            offers = [info.qos_profile.reliability for info in self.get_publishers_info_by_topic(topic)]
            if ReliabilityPolicy.BEST_EFFORT in offers:
                self._reliable.remove(topic)
                kind = self._taps[topic].msg_type
                self.destroy_subscription(self._taps[topic])
                self._tap(kind, topic, type_name_of(kind), best_effort())

    def _write(self, topic: str, type_name: str, data: bytes) -> None:
        if self.active and self._bag is not None:
            self._bag.write(topic, type_name, data, time.time_ns())

    def _on_lost(self, topic: str, event: Any) -> None:
        self._lost[topic] += event.total_count_change
        self.get_logger().warning(f"lost {event.total_count_change} messages of {topic}")

    def _discover(self) -> None:
        """Subscribe to new topics that the expression matches; flush what silent topics left."""
        if not self.active or self._bag is None:
            return
        for name, types in self.get_topic_names_and_types():
            if name not in self._subscribed and self._more.fullmatch(name):
                self._record(name, types[0], name)
        self._yield_to_best_effort()
        self._bag.flush()


def main() -> None:
    """Entry point."""
    sys.exit(run(RecordNode))
