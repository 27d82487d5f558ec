# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The bag of a recorder: where it goes, how long the disk takes it, and what was lost."""

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
    is_recording,
    recorded_files,
    remove_recorded,
    sync_file,
    too_many,
)
from trackslip_bags.progress import RecordProgress
from trackslip_bags.writer import BagWriter
from trackslip_common.errors import InputError
from trackslip_common.parameters import Parameters, parameter

_LONGEST_REPAIR_NS = 5_000_000_000  # a heartbeat asks every 3 s what is missing; more is a clock that was set
_TRIM_PERIOD = 5.0  # s


class DeliveryOrder:
    """Log times that, topic by topic, do not run back over a repair.

    A reliable publisher sends again what was lost on the way. It comes late, and what was sent after it waits
    for it: messages are delivered in order, while their times of reception are not.
    """

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}

    def after_all_before(self, topic: str, came_ns: int) -> int:
        """Log time of a message that is delivered now and was received at ``came_ns``."""
        newest_ns = self._newest_ns.get(topic, came_ns)
        if 0 < newest_ns - came_ns < _LONGEST_REPAIR_NS:
            return newest_ns
        self._newest_ns[topic] = came_ns
        return came_ns


class Losses:
    """Lost messages of each topic, by the gaps in their publishers' numbers.

    A publisher's first message may have any number: it is older than we.
    """

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._next: dict[tuple[str, bytes], int] = {}
        self._new: Counter[str] = Counter()

    def see(self, topic: str, publisher: bytes, number: int) -> None:
        """A message came, with the running number that its publisher gave it."""
        gap = number - self._next.get((topic, publisher), number)
        self._next[topic, publisher] = number + 1
        self.add(topic, gap)

    def add(self, topic: str, count: int) -> None:
        """So many are lost; a publisher may also send again what it keeps for late comers."""
        if count > 0:
            self.total[topic] += count
            self._new[topic] += count

    def news(self) -> str:
        """What was lost since this was last asked, in words; empty where nothing was."""
        text = ", ".join(f"{count} messages of {topic}" for topic, count in sorted(self._new.items()))
        self._new.clear()
        return text


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


class Log(Protocol):
    """A logger, of a node or of Python."""

    def info(self, message: str, /) -> object: ...
    def warning(self, message: str, /) -> object: ...
    def error(self, message: str, /) -> object: ...


class Recording:
    """One bag, from its first message to its metadata.

    A disk that refuses once is left alone; what it has stays readable, and ``disk_error`` says why.

    Raises:
        InputError: something else has the name that was asked for, or the directory cannot be made.
    """

    def __init__(self, settings: RecordParameters, log: Log) -> None:
        self._settings, self._log = settings, log
        self.bag = _next_bag(settings)
        self.losses, self.disk_error = Losses(), ""
        self._order, self._space = DeliveryOrder(), DiskWatch()
        self._progress = RecordProgress(self.bag, log.info)
        self._disk, self._saving = ThreadPoolExecutor(1), _nothing_to_save()
        self._trimmed_s = 0.0

    @property
    def minutes_left(self) -> float | None:
        """Until the disk is full; None where nobody knows."""
        return self._space.minutes_left

    def write(self, topic: str, type_name: str, data: bytes, came_ns: int, sent_ns: int | None) -> None:
        """One serialized message; it is lost where the disk does not take it."""
        came_ns = self._order.after_all_before(topic, came_ns)
        if not self._try_on_disk(partial(self.bag.write, topic, type_name, data, came_ns, sent_ns)):
            self.losses.add(topic, 1)

    def save(self) -> None:
        """Hand what was written to the disk, keep to the budget, and tell how far it has come."""
        if self._try_on_disk(self.bag.flush) and self._saving.done():
            self._try_on_disk(self._saving.result)
            self._saving = self._disk.submit(sync_file, self.bag.file)
        if not self.disk_error:
            self._try_on_disk(self._keep_to_budget)
            self._space.add(shutil.disk_usage(self.bag.path).free)
        self._progress.show(self.minutes_left)
        if lost := self.losses.news():
            self._log.error(f"lost {lost}")

    def close(self) -> None:
        """Finish the bag."""
        self._try_on_disk(self._saving.result)
        self._try_on_disk(self.bag.close)
        self._disk.shutdown()
        self._log.info(f"{sum(self.bag.counts.values())} messages in {self.bag.path}")
        if self.losses.total:
            self._log.error(f"{self.losses.total.total()} messages were lost")

    def _keep_to_budget(self) -> None:
        """Remove the oldest files of recordings beside the bag where they take more than ``max_disk``."""
        bag, most, now_s = self.bag, self._settings.max_disk, time.monotonic()
        if not most or now_s - self._trimmed_s < _TRIM_PERIOD:
            return
        self._trimmed_s = now_s
        for file in too_many(list(recorded_files(bag.path.parent)), most, bag.path, bag.file, time.time()):
            self._log.warning(f"max_disk: {file} is removed")
            bag.remove_file(file.name) if file.parent == bag.path else remove_recorded(file)

    def _try_on_disk(self, work: Callable[[], None]) -> bool:
        """Whether it went well."""
        if self.disk_error:
            return False
        try:
            work()
        except OSError as error:
            self.disk_error = f"cannot write ({error.strerror})"
            self._log.error(f"{self.disk_error}: what comes from now on is lost")
            for topic, count in self.bag.unsaved.items():
                self.losses.add(topic, count)
            self.bag.abandon()
        return not self.disk_error


def _next_bag(settings: RecordParameters) -> BagWriter:
    """The bag asked for; with _2, _3, … where a recorder, this one or one before it, has used that name."""
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
            asked_for = candidate == path and settings.output
            if not candidate.exists() or (asked_for and not is_recording(candidate)):
                raise
        number += 1
        candidate = path.with_name(f"{path.name}_{number}")


def _nothing_to_save() -> Future[None]:
    done: Future[None] = Future()
    done.set_result(None)
    return done
