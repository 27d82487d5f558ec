# SPDX-License-Identifier: Apache-2.0
"""``record``: writes the serialized messages of all project topics, as they come, to an MCAP bag."""

import math
import re
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from trackslip_bags.delivery import DeliveryOrder
from trackslip_bags.disk import (
    LIBRARY,
    DiskWatch,
    is_recording,
    recorded_files,
    remove_recorded,
    sync_file,
    too_many,
)
from trackslip_bags.losses import Losses
from trackslip_bags.nodes.record_progress import RecordProgress
from trackslip_bags.qos import offered_qos
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import ERROR, OK, WARN, Health
from trackslip_common.nodes.messages import message_class, type_name_of
from trackslip_common.nodes.qos import best_effort, latched, reliable
from trackslip_common.nodes.run import run
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.topics import TOPICS, Flow

_SAVE_PERIOD = 0.5  # s
_TRIM_PERIOD = 5.0  # s
_SHORT_MINUTES = 60.0  # until the disk is full: time for somebody to come
_GATHER = 0.05  # s from a message until all that came meanwhile are taken
_BURST = 100  # messages of one topic, before the others have their turn
_LATCHED_DEPTH = 100  # several publishers of one topic keep one message each, such as /tf_static has
_LONGEST_DRAIN = 1.0  # s
_IDLE_SPINS = 4  # without a message: a timer may take one of them


@dataclass(frozen=True, kw_only=True)
class RecordParameters(Parameters):
    """What to record, and where to."""

    output: str = parameter("directory of the bag; empty: trackslip_<date>_<time>")
    more_topics: str = parameter("regular expression over further topics; empty: none")
    split_size: int = parameter("size of a file from which on the next is begun; 0: any", unit="B", ge=0)
    split_duration: float = parameter("time after which the next file is begun; 0: never", unit="s", ge=0.0)
    max_disk: int = parameter(
        "that the files of all recordings beside the bag may take; the oldest go first; 0: any",
        unit="B",
        ge=0,
    )


class RecordNode(TrackslipNode[RecordParameters]):
    """Subscribes without decoding; counts what it writes, and what was lost on the way or on the disk."""

    def __init__(self) -> None:
        super().__init__("record", RecordParameters, "record.yaml")
        self._disk = ThreadPoolExecutor(1)
        self._saving: Future[None] | None = None

    def configure(self) -> None:
        """Compile the expression, so that a bad one is refused at the start.

        Raises:
            InputError: ``more_topics`` is not a regular expression.
        """
        self._losses, self._order = Losses(), DeliveryOrder()
        self._subscribed: set[str] = set()
        self._taps: dict[str, Any] = {}  # subscription of each topic
        self._choices: dict[str, tuple[str, ...]] = {}  # types of a topic that has no publisher yet
        self._reliable: set[str] = set()
        self._alone: set[str] = set()  # topics that have one publisher
        self._not_recorded: dict[str, str] = {}  # why
        self._disk_error = ""
        self._bag: BagWriter | None = None
        try:
            self._more = re.compile(self.settings.more_topics or r"(?!)")
        except re.error as error:
            text = f"'{self.settings.more_topics}' is refused ({error}); accepted: a regular expression"
            raise InputError(f"record: more_topics: {text}") from error
        self.create_timer(_SAVE_PERIOD, self._save, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def activate(self) -> None:
        """Open the bag and subscribe."""
        self._bag, self._space, self._trimmed_s = self._next_bag(), DiskWatch(), 0.0
        self._progress = RecordProgress(self._bag, self.get_logger().info)
        for name, topic in TOPICS.items():
            full = f"/{name}" if name in ("tf", "diagnostics") else self.resolve_topic_name(name)
            if topic.others:
                self._choices[full] = (topic.type_name, *topic.others)
            self._record(full, topic.type_name, topic.flow is Flow.LATCHED)

    def deactivate(self) -> None:
        """Finish the bag; the next activation begins another."""
        self.drop_subscriptions()
        kept = (self._subscribed, self._taps, self._choices, self._reliable, self._alone)
        for known in (*kept, self._not_recorded):
            known.clear()
        if self._bag is not None:
            if self._saving is not None:
                self._try_on_disk(self._saving.result)
            self._try_on_disk(self._bag.close)
            self.get_logger().info(f"{sum(self._bag.counts.values())} messages in {self._bag.path}")
            if self._losses.total:
                self.get_logger().error(f"{self._losses.total.total()} messages were lost")
        self._bag, self._saving, self._disk_error = None, None, ""
        self._losses, self._order = Losses(), DeliveryOrder()

    def _next_bag(self) -> BagWriter:
        """The bag asked for; with _2, _3, … where a recorder, this one or one before it, has used that name.

        Raises:
            InputError: something else has the name that was asked for.
        """
        path = Path(self.settings.output or time.strftime("trackslip_%Y%m%d_%H%M%S"))
        number, candidate = 1, path
        while True:
            try:
                return BagWriter(
                    candidate,
                    split_size=self.settings.split_size or math.inf,
                    split_duration=self.settings.split_duration or math.inf,
                    library=LIBRARY,
                )
            except InputError:
                asked_for = candidate == path and self.settings.output
                if not candidate.exists() or (asked_for and not is_recording(candidate)):
                    raise
            number += 1
            candidate = path.with_name(f"{path.name}_{number}")

    def _keep_to_budget(self) -> None:
        """Remove the oldest files of recordings beside the bag where they take more than ``max_disk``."""
        bag, most, now_s = self._bag, self.settings.max_disk, time.monotonic()
        if bag is None or not most or now_s - self._trimmed_s < _TRIM_PERIOD:
            return
        self._trimmed_s = now_s
        for file in too_many(list(recorded_files(bag.path.parent)), most, bag.path, bag.file, time.time()):
            self.get_logger().warning(f"max_disk: {file} is removed")
            bag.remove_file(file.name) if file.parent == bag.path else remove_recorded(file)

    def drain(self, spin_once: Callable[[], None]) -> None:
        """What was received is written, also what came just before the end."""
        give_up_s = time.monotonic() + _LONGEST_DRAIN
        idle = 0
        while self._bag is not None and idle < _IDLE_SPINS and time.monotonic() < give_up_s:
            before = sum(self._bag.counts.values())
            spin_once()
            idle = idle + 1 if sum(self._bag.counts.values()) == before else 0

    def health(self) -> list[Health]:
        """Counts per topic; an error if anything was lost: the bag stays incomplete."""
        assert self._bag is not None
        level, word = OK, "recording"
        if self._not_recorded:
            level, word = WARN, "some topics cannot be recorded"
        if self._losses.total:
            level, word = ERROR, "messages were lost"
        minutes = self._space.minutes_left
        if minutes is not None and minutes < _SHORT_MINUTES and level == OK:
            level, word = WARN, f"the disk is full in {minutes:.0f} min"
        if self._disk_error:
            level, word = ERROR, self._disk_error
        counts: dict[str, Any] = dict(self._bag.counts)
        lost = {f"{topic} lost": n for topic, n in self._losses.total.items()}
        space = {} if minutes is None else {"disk full in (min)": round(minutes)}
        matched: dict[str, Any] = {topic: tap.get_publisher_count() for topic, tap in self._taps.items()}
        return [
            Health(level, f"{word}: {self._bag.path}", counts | lost | self._not_recorded | space),
            Health(OK, f"{sum(matched.values())} publishers found", matched, part="publishers"),
        ]

    def _record(self, topic: str, type_name: str, is_latched: bool) -> None:
        self._subscribed.add(topic)
        assert self._bag is not None
        try:
            kind = message_class(type_name)
            if topic not in self._choices:
                self._bag.add_topic(topic, type_name, offered_qos(is_latched))
        except (ImportError, AttributeError, InputError) as error:
            if topic != "/tf":  # its package is optional
                self._not_recorded[topic] = f"not recorded: {error}"
                self.get_logger().warning(f"cannot record {topic} ({type_name}): {error}")
            return
        self._reliable.add(topic)
        self._tap(kind, topic, latched(_LATCHED_DEPTH) if is_latched else reliable())

    def _tap(self, kind: type, topic: str, qos: QoSProfile) -> None:
        take = partial(self._take, topic, type_name_of(kind))
        self._taps[topic] = self.create_subscription(kind, topic, take, qos, raw=True)

    def _take(self, topic: str, type_name: str, data: bytes, info: Any) -> None:
        """A message, and all that come in the moment after it, on any topic.

        One by one, the executor takes three times the CPU, just when others work on the same messages, and
        loses three times sooner.
        """
        self._write(topic, type_name, data, info)
        time.sleep(_GATHER)
        for name, tap in self._taps.items():
            kind = type_name_of(tap.msg_type)
            for _ in range(_BURST):
                with tap.handle:
                    taken = tap.handle.take_message(tap.msg_type, True)
                if taken is None:
                    break
                self._write(name, kind, *taken)

    def _write(self, topic: str, type_name: str, data: bytes, info: Any) -> None:
        """One message; ``info`` has when it was sent, and as which one, and when it came."""
        if not self.active or self._bag is None:
            return
        publisher, number = info.get("publisher_gid"), info.get("publication_sequence_number")
        if number is not None and (publisher or topic in self._alone):  # Jazzy: no publisher_gid
            self._losses.see(topic, publisher["data"] if publisher else b"", number)
        came_ns, sent_ns = info["received_timestamp"] or time.time_ns(), info["source_timestamp"] or None
        came_ns = self._order.after_all_before(topic, came_ns)
        if not self._try_on_disk(partial(self._bag.write, topic, type_name, data, came_ns, sent_ns)):
            self._losses.add(topic, 1)

    def _save(self) -> None:
        """Twice a second: what was received goes to the disk; new topics are found; losses are reported."""
        if not self.active or self._bag is None:
            return
        self._discover()
        if self._try_on_disk(self._bag.flush) and (self._saving is None or self._saving.done()):
            if self._saving is not None:
                self._try_on_disk(self._saving.result)
            self._saving = self._disk.submit(sync_file, self._bag.file)
        if not self._disk_error:
            self._try_on_disk(self._keep_to_budget)
            self._space.add(shutil.disk_usage(self._bag.path).free)
        self._progress.show(self._space.minutes_left)
        lost = self._losses.news()
        if lost:
            self.get_logger().error(f"lost {lost}")

    def _try_on_disk(self, work: Callable[[], None]) -> bool:
        """Whether it went well. A disk that refuses once is left alone, and what it has stays readable."""
        if self._disk_error:
            return False
        try:
            work()
        except OSError as error:
            self._disk_error = f"cannot write ({error.strerror})"
            self.get_logger().error(f"{self._disk_error}: what comes from now on is lost")
            assert self._bag is not None
            for topic, count in self._bag.unsaved.items():
                self._losses.add(topic, count)
            self._bag.abandon()
        return not self._disk_error

    def _choose(self) -> None:
        """Record topics that may be of several types by the one that is published."""
        assert self._bag is not None
        for topic, types in list(self._choices.items()):
            offered = [info.topic_type for info in self.get_publishers_info_by_topic(topic)]
            published = next((name for name in offered if name in types), None)
            if published is None:
                continue
            del self._choices[topic]
            if published == type_name_of(self._taps[topic].msg_type):
                self._bag.add_topic(topic, published, offered_qos(False))
            else:
                self.destroy_subscription(self._taps.pop(topic))
                self._record(topic, published, is_latched=False)

    def _discover(self) -> None:
        """Subscribe to new topics that the expression matches; ask for no more than publishers offer."""
        for topic, types in self.get_topic_names_and_types():
            if topic not in self._subscribed and self._more.fullmatch(topic):
                offers = [info.qos_profile.durability for info in self.get_publishers_info_by_topic(topic)]
                is_latched = bool(offers) and set(offers) == {DurabilityPolicy.TRANSIENT_LOCAL}
                self._record(topic, types[0], is_latched)
        self._choose()
        for topic in list(self._reliable):
            offers = [info.qos_profile.reliability for info in self.get_publishers_info_by_topic(topic)]
            if ReliabilityPolicy.BEST_EFFORT in offers:
                self._reliable.remove(topic)
                kind = self._taps[topic].msg_type
                self.destroy_subscription(self._taps[topic])
                self._tap(kind, topic, best_effort())
        self._alone = {topic for topic, tap in self._taps.items() if tap.get_publisher_count() == 1}


def record(argv: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM; returns the exit code."""
    # The events executor of rclpy 9.1 fails on callbacks that ask for a message's number and time.
    return run(RecordNode, argv, make_executor=SingleThreadedExecutor)


def main() -> None:
    """Entry point."""
    sys.exit(record())
