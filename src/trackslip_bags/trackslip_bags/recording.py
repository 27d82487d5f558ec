# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bag of a recorder: its path, disk space and lost messages."""

import math
import shutil
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from trackslip_bags.disk import (
    LIBRARY,
    DiskWatch,
    files_over_budget,
    is_recording,
    recorded_files,
    remove_recorded,
    sync_file,
)
from trackslip_bags.progress import RecordProgress
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter
from trackslip_drivers.transports.host_clock import HostClock

_MAX_REPAIR_NS = 5_000_000_000  # heartbeats repair losses every 3 s
_TRIM_PERIOD = 5.0  # s


class LogTimes:
    """Log times that increase in the order of delivery, by the steady clock; see ``HostTime``.

    A reliable publisher resends lost messages. Messages sent later are held back until then, so messages are
    delivered in order, but their reception times are not in order.
    """

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}
        self._clock = HostClock()

    @property
    def lead_ns(self) -> int:
        """Lead of log times over the host's clock since that was set back, ns."""
        return self._clock.lead_ns

    def log_time_ns(self, topic: str, received_ns: int) -> tuple[int, bool]:
        """Log time of a message delivered now and received at ``received_ns``; whether the clock was set."""
        earliest_ns = time.monotonic_ns() - _MAX_REPAIR_NS
        steady_ns, was_set = self._clock.arrival(received_ns, earliest_ns)
        newest_ns = max(self._clock.stamp(steady_ns), self._newest_ns.get(topic, 0))
        self._newest_ns[topic] = newest_ns
        return newest_ns, was_set


class Losses:
    """Counts of lost messages per topic, from gaps in the sequence numbers of publishers.

    The first message received may have any number, since the publisher may be older.
    """

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._next: dict[tuple[str, bytes], int] = {}
        self._new: Counter[str] = Counter()

    def count_gap(self, topic: str, publisher: bytes, number: int) -> None:
        """Account for a message with its publisher's sequence number."""
        gap = number - self._next.get((topic, publisher), number)
        self._next[topic, publisher] = number + 1
        self.add(topic, gap)

    def add(self, topic: str, count: int) -> None:
        """Count lost messages; a ``count`` of 0 or less (messages resent to late subscribers) is ignored."""
        if count > 0:
            self.total[topic] += count
            self._new[topic] += count

    def new_losses_text(self) -> str:
        """Text on the messages lost since the last call; empty without losses."""
        text = ", ".join(f"{count} messages of {topic}" for topic, count in sorted(self._new.items()))
        self._new.clear()
        return text


@dataclass(frozen=True, kw_only=True)
class RecordParameters(Parameters):
    """Parameters of the recorder."""

    output: str = parameter("directory of the bag; empty: trackslip_<date>_<time>")
    more_topics: str = parameter("regular expression for further topics; empty: none")
    split_size: int = parameter("size at which the next file begins; 0: unlimited", unit="B", ge=0)
    split_duration: float = parameter("time after which the next file begins; 0: never", unit="s", ge=0.0)
    max_disk: int = parameter(
        "limit of all recordings beside the bag; the oldest files are removed first; 0: unlimited",
        unit="B",
        ge=0,
    )


class Log(Protocol):
    """A logger, of a node or of Python."""

    def info(self, message: str, /) -> object: ...
    def warning(self, message: str, /) -> object: ...
    def error(self, message: str, /) -> object: ...


class Recording:
    """A bag being recorded, from its first message to its metadata.

    After the first disk error nothing more is written; the file stays readable, ``disk_error`` is the reason.

    Args:
        settings: of the recorder.
        log: logger.
        losses: those of the bag before, which this one continues.

    Raises:
        InputError: the requested name is in use by other files, or the directory cannot be created.
    """

    def __init__(self, settings: RecordParameters, log: Log, losses: Losses | None = None) -> None:
        self._settings, self._log = settings, log
        self.bag = _next_bag(settings)
        self.losses, self.disk_error = losses or Losses(), ""
        self._log_times, self._disk_watch = LogTimes(), DiskWatch()
        self._progress = RecordProgress(self.bag, log.info)
        self._disk, self._saving = ThreadPoolExecutor(1), _finished_future()
        self._trimmed_s = 0.0

    @property
    def minutes_left(self) -> float | None:
        """Minutes until the disk is full; None if unknown."""
        return self._disk_watch.minutes_left

    def write(self, topic: str, type_name: str, data: bytes, received_ns: int, sent_ns: int | None) -> None:
        """Write one serialized message; it counts as lost if the disk fails."""
        log_time_ns, was_set = self._log_times.log_time_ns(topic, received_ns)
        if was_set:
            self._log.warning(f"the host's clock was set: {self._clock_effect()}")
        if not self._try_on_disk(partial(self.bag.write, topic, type_name, data, log_time_ns, sent_ns)):
            self.losses.add(topic, 1)

    @property
    def lead_s(self) -> float:
        """Lead of log times over the host's clock since that was set back, s."""
        return self._log_times.lead_ns * 1e-9

    def _clock_effect(self) -> str:
        if self.lead_s:
            return f"log times stay {self.lead_s:.1f} s ahead of it until the recorder is started again"
        return "log times follow it; set it before the drive, or report each part with --start and --stop"

    def save(self) -> None:
        """Flush to the disk, keep to the budget, show progress and losses."""
        if self._try_on_disk(self.bag.flush) and self._saving.done():
            self._try_on_disk(self._saving.result)
            self._saving = self._disk.submit(sync_file, self.bag.file)
        self._try_on_disk(self._keep_to_budget)
        self._try_on_disk(self._watch_disk)
        self._progress.show(self.minutes_left)
        if (lost := self.losses.new_losses_text()) and not self.disk_error:  # else stated once, and counted
            self._log.error(f"lost {lost}")

    def close(self) -> None:
        """Finish the bag."""
        self._try_on_disk(self._saving.result)
        self._try_on_disk(self.bag.close)
        self._disk.shutdown()
        lost = f"{self.losses.total.total()} messages were lost" if self.losses.total else ""
        if self.disk_error:
            self._log.error(f"{self.disk_error}: {self.bag.path} is incomplete{lost and f', {lost}'}")
            return
        self._log.info(f"{sum(self.bag.counts.values())} messages in {self.bag.path}")
        if lost:
            self._log.error(lost)

    def _keep_to_budget(self) -> None:
        """Remove the oldest files of recordings beside the bag while they exceed ``max_disk``."""
        bag, max_disk, now_s = self.bag, self._settings.max_disk, time.monotonic()
        if not max_disk or now_s - self._trimmed_s < _TRIM_PERIOD:
            return
        self._trimmed_s = now_s
        for file in files_over_budget(
            list(recorded_files(bag.path.parent)), max_disk, bag.path, bag.file, time.time()
        ):
            self._log.warning(f"max_disk: {file} is removed")
            bag.remove_file(file.name) if file.parent == bag.path else remove_recorded(file)

    def _watch_disk(self) -> None:
        self._disk_watch.add(shutil.disk_usage(self.bag.path).free, time.monotonic())

    def _try_on_disk(self, work: Callable[[], None]) -> bool:
        """Do ``work`` unless the disk has failed; returns whether it succeeded."""
        if self.disk_error:
            return False
        try:
            work()
        except OSError as error:
            self.disk_error = f"cannot write ({error.strerror})"
            self._log.error(f"{self.disk_error}: further messages are lost until another bag can be written")
            for topic, count in self.bag.unsaved.items():
                self.losses.add(topic, count)
            self.bag.abandon()
        return not self.disk_error


def _next_bag(settings: RecordParameters) -> BagWriter:
    """The requested bag, with _2, _3, … appended if a recorder has used the name before."""
    path = Path(settings.output or time.strftime("trackslip_%Y%m%d_%H%M%S"))
    number, candidate = 1, path
    while True:
        try:
            return BagWriter(
                candidate,
                split_size=settings.split_size or math.inf,
                split_duration=settings.split_duration or math.inf,
                library=LIBRARY,
            )
        except InputError:
            is_requested = candidate == path and settings.output
            if not candidate.exists() or (is_requested and not is_recording(candidate)):
                raise
        number += 1
        candidate = path.with_name(f"{path.name}_{number}")


def _finished_future() -> Future[None]:
    future: Future[None] = Future()
    future.set_result(None)
    return future
