# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Failures that a node survives: exceptions of its callbacks, and messages that the middleware does not send.

A failing callback is a defect of ours, or has received an unforeseen message. The failure is counted, logged
with its cause (the same cause again after half a minute), and shown on /diagnostics as an error for ten
seconds; the node continues. The node ends, with exit code 1, after a streak of failures: ten or more over ten
seconds, with gaps below three seconds, and without a message that was handled successfully.
"""

import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from datetime import datetime, timezone
from functools import wraps
from pathlib import Path
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

from trackslip_common.nodes.health import ERROR, OK, WARN, Health

MIN_STREAK = 10  # failures of a streak that ends the node
STREAK_S = 10.0  # s, duration of such a streak
PAUSE_S = 3.0  # s without a failure that end a streak
RECENT_S = 10.0  # s for which a failure is reported as an error
LOG_PERIOD_S = 30.0  # s between lines in the log about the same cause
_LOST_RESPONSE_WARNING = "failed to send response"

Log = Callable[[str], None]


def describe_exception(error: BaseException) -> str:
    """An exception on one line: its type, its text, and where it was raised."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename != __file__]
    ours = [f for f in frames if "trackslip_" in f.filename or "site-packages" not in f.filename]
    place = "".join(f" ({Path(f.filename).name}:{f.lineno})" for f in (ours or frames)[-1:])
    return f"{type(error).__name__}: {' '.join(str(error).split())}{place}"


def utc_date(seconds: float) -> str:
    """Text of a system time, s since 1970."""
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"


class CallbackFailures:
    """Counts exceptions of callbacks; thread-safe."""

    def __init__(self, log: Log, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock = log, clock
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()  # by callback
        self._logged_s: dict[tuple[object, ...], float] = {}  # time of the last log line of each cause
        self._streak, self._began_s, self._last_s = 0, 0.0, 0.0
        self.last = ""

    def guard(
        self,
        callback: Callable[..., Any],
        name: str,
        *,
        handles_data: bool = False,
        recover: Callable[[], None] = lambda: None,
    ) -> Callable[..., Any]:
        """The callback with exceptions counted under ``name``; after one, it recovers and returns None.

        ``handles_data``: a success of this callback ends a streak of failures.
        """

        @wraps(callback)
        def guarded(*args: Any) -> Any:
            try:
                result = callback(*args)
            except Exception as error:  # noqa: BLE001 (whatever it is, the node goes on)
                self.add(name, error)
                return recover()
            if handles_data and self._streak:
                self._streak = 0
            return result

        return guarded

    def add(self, name: str, error: Exception) -> None:
        """Count one failure."""
        now_s, text = self._clock(), f"{name}: {describe_exception(error)}"
        place = traceback.extract_tb(error.__traceback__)[-1:]
        cause = (name, type(error), *((frame.filename, frame.lineno) for frame in place))  # texts may vary
        with self._lock:
            if not self._streak or now_s - self._last_s > PAUSE_S:
                self._streak, self._began_s = 0, now_s
            self._streak += 1
            self._counts[name] += 1
            self._last_s, self.last = now_s, text
            is_logged = now_s - self._logged_s.get(cause, -LOG_PERIOD_S) >= LOG_PERIOD_S
            if is_logged:
                self._logged_s[cause] = now_s
        if is_logged:
            self._log(f"callback failed: {text}")

    @property
    def has_long_streak(self) -> bool:
        """Whether a streak of failures is so long that the node should end."""
        with self._lock:
            return self._streak >= MIN_STREAK and self._last_s - self._began_s >= STREAK_S

    def health(self) -> list[Health]:
        """The failures, and the time since the last; empty if there were none."""
        with self._lock:
            counts, ago_s, last = dict(self._counts), self._clock() - self._last_s, self.last
        if not counts:
            return []
        values: dict[str, Any] = {f"failed: {name}": n for name, n in sorted(counts.items())}
        values |= {
            "last failure": last,
            "age of the last failure (s)": f"{ago_s:.1f}",
            "last failure at": utc_date(time.time() - ago_s),
        }
        failed = f"{sum(counts.values())} callbacks failed; the last: {last}"
        level, message = (ERROR, failed) if ago_s < RECENT_S else (OK, "running")
        return [Health(level, message, values, "callbacks")]


class SendFailures:
    """Counts messages and responses that could not be sent, so that a stalled subscriber ends no node."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._reported = 0
        self._logged_s = -LOG_PERIOD_S
        self.counts: Counter[str] = Counter()  # by topic; all responses together

    def count_send_failures(self, publisher: Any) -> Any:
        """The publisher, with failures to send counted instead of raised."""
        send = publisher.publish

        def publish(message: Any) -> None:
            try:
                send(message)
            except rclpy_implementation.RCLError as error:
                self._count_failure(publisher.topic_name, error)

        publisher.publish = publish
        return publisher

    def count_lost_responses(self) -> None:
        """Start to count the responses that the middleware drops, as Fast DDS may on a busy machine.

        rclpy reports them only by a warning of Python.
        """
        show = warnings.showwarning

        def show_or_count(message: Warning | str, *place: Any, **options: Any) -> None:
            if str(message).startswith(_LOST_RESPONSE_WARNING):
                self._count_failure("answers", message)
            else:
                show(message, *place, **options)

        warnings.filterwarnings("always", _LOST_RESPONSE_WARNING, RuntimeWarning)
        warnings.showwarning = show_or_count

    def health(self) -> list[Health]:
        """Messages that could not be sent, by topic; empty if there were none."""
        counts = dict(self.counts)
        new, self._reported = sum(counts.values()) - self._reported, sum(counts.values())
        if not counts:
            return []
        level, message = (WARN, f"{new} messages could not be sent") if new else (OK, "running")
        return [Health(level, message, {f"not sent: {topic}": n for topic, n in counts.items()}, "outputs")]

    def _count_failure(self, name: str, reason: object) -> None:
        self.counts[name] += 1
        if (now_s := time.monotonic()) - self._logged_s >= LOG_PERIOD_S:
            self._logged_s = now_s
            self._log(f"{name}: not sent: {' '.join(str(reason).split())}")
