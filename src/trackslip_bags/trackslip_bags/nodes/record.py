# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``record``: writes the serialized messages of all project topics to an MCAP bag."""

import re
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor

from trackslip_bags.nodes.subscriptions import RawSubscriptions
from trackslip_bags.recording import Losses, Recording, RecordParameters
from trackslip_common.errors import InputError
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import ERROR, OK, WARN, Health
from trackslip_common.nodes.run import run

_SAVE_PERIOD = 0.5  # s
_RETRY_PERIOD = 30.0  # s between attempts to begin another bag after a disk error
_RETRY_SPACE = 50_000_000  # B free for another bag: ten minutes of a usual recording, 0.3 GB an hour
_SHORT_MINUTES = 60.0  # until the disk is full, below which a warning is given
_REPAIR = 0.4  # s for the repair of lost messages: twice the heartbeat period in config/fast*.xml
_LONGEST_DRAIN = 1.5  # s
_IDLE_SPINS = 4  # spins without a message; a timer may take one of them


class RecordNode(TrackslipNode[RecordParameters]):
    """Subscribes without decoding; counts messages written, and lost in transport or by the disk."""

    def __init__(self) -> None:
        super().__init__("record", RecordParameters, "record.yaml")
        self._recording: Recording | None = None

    def configure(self) -> None:
        """Compile ``more_topics``, so that a bad expression is refused at the start.

        Raises:
            InputError: ``more_topics`` is not a regular expression.
        """
        try:
            self._more_topics = re.compile(self.settings.more_topics or r"(?!)")
        except re.error as error:
            text = f"'{self.settings.more_topics}' is refused ({error}); accepted: a regular expression"
            raise InputError(f"record: more_topics: {text}") from error
        self.create_timer(_SAVE_PERIOD, self._save, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def activate(self) -> None:
        """Open the bag and subscribe."""
        self._begin_bag(None)

    def _begin_bag(self, losses: Losses | None) -> None:
        """Open a bag and subscribe, in place of the present bag, with the losses before it."""
        recording = Recording(self.settings, self.get_logger(), losses)
        self._begun_s = time.monotonic()
        self.deactivate()
        self._recording = recording
        self._raw_subscriptions = RawSubscriptions(self, self._recording.bag, self._more_topics, self._write)

    def deactivate(self) -> None:
        """Finish the bag; the next activation begins a new one."""
        self.drop_subscriptions()
        if self._recording is not None:
            self._recording.close()
            self.has_failed |= bool(self._recording.disk_error)
        self._recording = None

    def drain(self, spin_once: Callable[[], None]) -> None:
        """Write all messages sent before the end, also those held back by the repair of a lost message."""
        began_s = time.monotonic()
        idle, lasted_s = 0, 0.0
        while self._recording is not None and (idle < _IDLE_SPINS or lasted_s < _REPAIR):
            before = sum(self._recording.bag.counts.values())
            spin_once()
            idle = idle + 1 if sum(self._recording.bag.counts.values()) == before else 0
            lasted_s = time.monotonic() - began_s
            if lasted_s > _LONGEST_DRAIN:
                break

    def health(self) -> list[Health]:
        """Counts per topic; an error after any loss, since the bag stays incomplete."""
        recording, not_recorded = self._recording, self._raw_subscriptions.not_recorded
        assert recording is not None
        level, word = OK, "recording"
        if not_recorded:
            level, word = WARN, "some topics cannot be recorded"
        if recording.losses.total:
            level, word = ERROR, "messages were lost"
        minutes = recording.minutes_left
        if minutes is not None and minutes < _SHORT_MINUTES and level == OK:
            level, word = WARN, f"the disk is full in {minutes:.0f} min"
        if recording.disk_error:
            level, word = ERROR, recording.disk_error
        counts: dict[str, Any] = dict(recording.bag.counts)
        lost = {f"{topic} lost": n for topic, n in recording.losses.total.items()}
        space = {} if minutes is None else {"disk full in (min)": round(minutes)}
        ahead = {"log times ahead of the host's clock (s)": f"{recording.lead_s:.3f}"}
        matched = self._raw_subscriptions.publishers()
        return [
            Health(level, f"{word}: {recording.bag.path}", counts | lost | not_recorded | space | ahead),
            Health(OK, f"{sum(matched.values())} found", dict(matched), part="publishers"),
        ]

    def _write(self, topic: str, type_name: str, data: bytes, info: Any) -> None:
        """Write one message; ``info`` has its source time, sequence number and reception time."""
        if not self.active or self._recording is None:
            return
        publisher, number = info.get("publisher_gid"), info.get("publication_sequence_number")
        if number is not None and (
            publisher or topic in self._raw_subscriptions.single_publisher_topics
        ):  # Jazzy has no publisher_gid
            self._recording.losses.count_gap(topic, publisher["data"] if publisher else b"", number)
        received_ns, sent_ns = info["received_timestamp"] or time.time_ns(), info["source_timestamp"] or None
        self._recording.write(topic, type_name, data, received_ns, sent_ns)

    def _save(self) -> None:
        """Twice a second: find new topics, flush to the disk, report losses."""
        if not self.active or self._recording is None:
            return
        self._raw_subscriptions.discover()
        self._recording.save()
        if self._recording.disk_error and time.monotonic() - self._begun_s > _RETRY_PERIOD:
            self._begun_s = time.monotonic()
            with suppress(InputError, OSError):  # the disk is gone
                if shutil.disk_usage(self._recording.bag.path.parent).free >= _RETRY_SPACE:
                    self._begin_bag(self._recording.losses)


def record(argv: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM; returns the exit code."""
    # The events executor of rclpy 9.1 fails on callbacks with message info.
    return run(RecordNode, argv, make_executor=SingleThreadedExecutor)


def main() -> None:
    """Entry point."""
    sys.exit(record())
