# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Selects and times the messages of a bag that are played to a live graph."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from trackslip_bags.input_filters import InputFilters, relative_name
from trackslip_bags.manual_poses import input_names
from trackslip_bags.reader import Bag, absolute_name
from trackslip_common.topics import TOPICS

_ESTIMATORS = ("slip_estimator", "soil_estimator")
# Outputs of the estimators of the live graph, and topics that belong to the graph, not to the bag.
OWN_OUTPUTS = frozenset(name for name, topic in TOPICS.items() if topic.publisher.startswith(_ESTIMATORS)) | {
    "diagnostics",
    "rosout",
    "parameter_events",
}
CLOCK = "clock"  # published by the player
_CLOCK_SET_NS = 3_600_000_000_000  # ns without a message, of a recorder whose clock was set: not waited for


class PlayedMessage(NamedTuple):
    """One message to publish; ``raw`` is its CDR form."""

    topic: str
    log_time_ns: int
    raw: bytes


def played_topics(bag: Bag, filters: InputFilters, also: Collection[str]) -> dict[str, str]:
    """Name to publish under → type: topics of the bag without ``OWN_OUTPUTS``, except those in ``also``."""
    barred = (OWN_OUTPUTS - {relative_name(topic) for topic in also}) | {CLOCK}
    return {
        _published_name(name, filters): bag.topics[topic].type_name
        for topic, name in input_names(bag).items()
        if name not in barred
    }


def played_messages(bag: Bag, filters: InputFilters, topics: Collection[str]) -> Iterator[PlayedMessage]:
    """The messages to publish under these names, in log order, without withheld ones."""
    names = {topic: _published_name(name, filters) for topic, name in input_names(bag).items()}
    requested = [topic for topic, name in names.items() if name in topics]
    start_ns = bag.start_ns + round(filters.start_s * 1e9)
    stop_ns = bag.start_ns + round(filters.stop_s * 1e9) if math.isfinite(filters.stop_s) else None
    for message in bag.messages(requested, start_ns, stop_ns):
        name = names[message.topic]
        if not filters.is_withheld(relative_name(name), (message.log_time_ns - bag.start_ns) * 1e-9):
            yield PlayedMessage(name, message.log_time_ns, message.raw)


class Playback:
    """Playback of a bag. Wall times are seconds of any monotonic clock."""

    def __init__(
        self,
        messages: Callable[[], Iterator[PlayedMessage]],
        rate: float,
        paused: bool = False,
        loop: bool = False,
    ) -> None:
        self.paused = paused
        self.counts: Counter[str] = Counter()  # messages played, by topic
        self._due_ns = self._played_ns = 0  # log times: the current one; that of the last message played
        self._begin = messages
        self._rate = rate
        self._loop = loop
        self._now_s: float | None = None
        self._messages: Iterator[PlayedMessage] = iter(())
        self._next: PlayedMessage | None = None
        self._rewind()

    @property
    def is_finished(self) -> bool:
        """Whether all messages are played."""
        return self._next is None

    @property
    def bag_ns(self) -> int:
        """Current log time, at most that of the next message or of the end."""
        return self._played_ns if self._next is None else min(self._due_ns, self._next.log_time_ns)

    def due_messages(self, now_s: float) -> Iterator[PlayedMessage]:
        """Advance to now; yield the messages that are due. Messages not consumed stay due."""
        if self._now_s is not None and not self.paused:
            self._due_ns += round((now_s - self._now_s) * self._rate * 1e9)
        self._now_s = now_s
        if self._next is not None and self._next.log_time_ns - self._due_ns > _CLOCK_SET_NS:
            self._due_ns = self._next.log_time_ns
        while self._next is not None and self._next.log_time_ns <= self._due_ns and not self.paused:
            message, self._next = self._next, next(self._messages, None)
            self._played_ns = message.log_time_ns
            self.counts[message.topic] += 1
            if self._next is None and self._loop:
                self._rewind()
            yield message

    def _rewind(self) -> None:
        self._messages = self._begin()
        self._next = next(self._messages, None)
        if self._next is not None:
            self._due_ns = self._next.log_time_ns


def _published_name(name: str, filters: InputFilters) -> str:
    return absolute_name(filters.remap.get(name, name))
