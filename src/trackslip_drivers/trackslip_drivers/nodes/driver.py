# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the drivers share: one link to a sensor, stamps on the host's clock, and its health."""

import math
import time
from collections import defaultdict
from collections.abc import Mapping
from datetime import datetime, timezone
from types import MappingProxyType
from typing import Generic, TypeVar

from rclpy.clock import Clock, ClockType

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import ERROR, OK, STALE, WARN, Health
from trackslip_common.parameters import Parameters
from trackslip_drivers.records import (
    FixSample,
    HeadingSample,
    HydraulicsSample,
    ImuSample,
    ScanSample,
    SprocketSample,
    SwingSample,
    VelocitySample,
)
from trackslip_drivers.stamping import InOrder, StampEvent
from trackslip_drivers.transports.host_clock import HostClock
from trackslip_drivers.transports.link import Handlers, Link, Port

P = TypeVar("P", bound=Parameters)
D = TypeVar("D")  # what the port gives: bytes, or a frame
S = TypeVar(
    "S",
    SprocketSample,
    HydraulicsSample,
    SwingSample,
    ImuSample,
    ScanSample,
    FixSample,
    HeadingSample,
    VelocitySample,
)

_STALE_PERIODS = 10
_LOOK = 0.1  # s between looks at whether the link's condition has changed
_OPENING = 2.0  # s, for which a port that was opened need not deliver
RECENT = 5.0  # s for which a rejection shows
_PAUSE = 5.0  # s without data after which nothing is said of what they lacked
_SETTLING = 1.0  # s for which what is of no use may be what a pause left behind
_RATE_OVER = 0.5  # s, the least that a rate is counted over
_HOST_CLOCK = "host clock"


def _date(seconds: float) -> str:
    """Of a system time, s since 1970; empty for 0."""
    return f"{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC" if seconds else ""


class DriverNode(TrackslipNode[P], Generic[P, D]):
    """Opens its link while active; subclasses override ``open_port``, ``begin``, ``receive``, ``on_silence``.

    Reports whether data come, how fast, and what was rejected: at 1 Hz, and at once when data begin or cease.
    """

    device = "sensor"  # what the crew calls it
    carries = "bytes"
    advice = "check power and port"  # where nothing comes
    passing: Mapping[str, str] = MappingProxyType({})  # reasons that are no fault of the link → what to do
    period = 1.0  # s between messages when all is well
    silence = math.inf  # s without a byte or frame after which the port is reopened

    def configure(self) -> None:
        """Start counting."""
        self._published = 0
        self._rate = 0.0
        self._looked_at = (time.monotonic(), 0)
        self._last_s = -math.inf
        self._link: Link[D] | None = None
        self._reported: bytes | None = None  # level
        self._rejected = ("", -math.inf, "")  # why most were, when (steady, s), and its date
        self.create_timer(_LOOK, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def hardware(self) -> str:
        """The serial port, where it has one."""
        return str(getattr(self.settings, "serial_port", self.full_name))

    def open_port(self) -> Port[D]:
        """Open the port to the sensor, or raise; in the link's thread, as all that follow."""
        raise NotImplementedError

    def begin(self) -> None:
        """A port was opened, or decoding failed: what was half received is not continued."""

    def receive(self, data: D, arrival_ns: int) -> None:
        """Decode what the port received, and publish."""
        raise NotImplementedError

    def on_silence(self) -> None:
        """A read has found nothing."""

    def activate(self) -> None:
        """Set the clocks, and open the link."""
        self._host = HostClock()
        self._order: defaultdict[type, InOrder] = defaultdict(InOrder)
        guard = self.callback_failures.guard
        receive = guard(self.receive, "received data", handles_data=True, recover=self.begin)
        handlers = Handlers(receive, self.begin, guard(self.on_silence, "silence"))
        self._link = Link(self.get_name(), self.open_port, handlers, self.silence)
        self._link.start()

    def deactivate(self) -> None:
        """Close the link."""
        if self._link is not None:
            self._link.stop()

    def arrived(self, host_ns: int) -> int:
        """Steady time of what a port has just received; notes whether somebody set the host's clock."""
        assert self._link is not None
        steady_ns, has_jumped = self._host.arrival(host_ns, self._link.look.emptied_ns)
        if has_jumped:
            self.tally.add(_HOST_CLOCK, StampEvent.CLOCK_JUMPED)
        return steady_ns

    def waited(self, steady_ns: int) -> bool:
        """Whether what seems to have arrived just then may have waited for a host that was held up."""
        assert self._link is not None
        return self._link.look.waited(steady_ns, time.monotonic_ns())

    def stamped(self, sample: S) -> S:
        """The sample as it is published: on the host's clock, later than the one before it."""
        host_ns = self._host.stamp(sample.stamp_ns)
        stamp_ns = self._order[type(sample)].next(host_ns)
        if stamp_ns != host_ns:
            self.tally.add(type(sample).__name__, StampEvent.MOVED)
        return sample._replace(stamp_ns=stamp_ns)

    def count(self) -> None:
        """One more message published."""
        self._published += 1
        self._last_s = time.monotonic()

    def health(self) -> list[Health]:
        """Connection, rate, age, rejections."""
        assert self._link is not None
        state, now_s = self._link.state(), time.monotonic()
        if news := self.tally.since_last_look():
            often = max(news, key=lambda key: news[key])  # the latest would change from look to look
            self._rejected = (self.tally.words(often), now_s, _date(time.time()))
        then_s, then = self._looked_at
        if now_s - then_s >= _RATE_OVER:
            self._rate = (self._published - then) / (now_s - then_s)
            self._looked_at = (now_s, self._published)
        values: dict[str, object] = {
            "published": self._published,
            "rate (Hz)": f"{self._rate:.1f}",
            "age (s)": f"{now_s - self._last_s:.2f}",
            "reconnects": max(state.openings - 1, 0),
            "errors": state.errors,
            "last error": state.last_error,
            "last error at": _date(state.last_error_s),
            "last rejected": self._rejected[0],
            "last rejected at": self._rejected[2],
            "note": state.note,
            "stamps ahead of the host's clock (s)": f"{self._host.lead_ns * 1e-9:.3f}",
        }
        values |= {f"{source}: {reason}": n for (source, reason), n in sorted(self.tally.total.items())}
        level, message = self._condition(self._link)
        self._reported = level
        return [Health(level, message, values)]

    def where(self) -> str:
        """The device as the crew calls it, and its port."""
        return f"{self.device} on {self.hardware()}"

    def talk(self) -> str:
        """Where the talk with the device has got to, while no data come; empty where there is none."""
        return ""

    def lack(self) -> str:
        """What comes whole but is of no use, and what to do; empty where nothing does."""
        return ""

    def _condition(self, link: Link[D]) -> tuple[bytes, str]:
        """Whether data come, or why not and what to do; numbers that change are in the values."""
        state, where = link.state(), self.where()
        if not state.openings and not state.errors:
            return WARN, f"{where}: opening"
        if not state.connected and not state.was_silent:
            return ERROR, f"{where}: not connected ({state.last_error}); {self.advice}"
        limit_s = _STALE_PERIODS * self.period
        if time.monotonic() - self._last_s <= limit_s:
            latest, then_s, _ = self._rejected
            is_recent = time.monotonic() - then_s < RECENT
            return (WARN, f"running; some is rejected: {latest}") if is_recent else (OK, "running")
        if not self._published and state.connected and state.openings == 1 and state.since_s < _OPENING:
            return WARN, f"{where}: opened, nothing yet"
        talk = f" ({self.talk()})" if self.talk() else ""
        if state.silent_s < _PAUSE and (lack := self.lack()):
            return ERROR, f"{where}: {lack}"
        if state.silent_s > 0.5 * limit_s or not state.has_received:
            return STALE, f"{where}: no {self.carries}{talk}; {self.advice}"
        reason = self._rejected[0] or "nothing whole yet"
        if reason in self.passing:
            return WARN, f"{where}: {reason}{talk}; {self.passing[reason]}"
        what = f"{where}: {self.carries} come, but nothing of use: {reason}{talk}"
        if time.monotonic() - self._last_s < limit_s + _SETTLING:
            return WARN, what
        return ERROR, f"{what}; check rate and format"

    def _look(self) -> None:
        """What has changed is reported at once."""
        if self.active and self._link is not None and self._reported != self._condition(self._link)[0]:
            self.publish_health()
