# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the driver nodes: one link to a sensor, stamps on the host's clock, and health."""

import errno
import math
import os
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Generic, NamedTuple, Protocol, TypeVar

from rclpy.clock import Clock, ClockType

from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.failures import utc_date
from trackslip_common.nodes.health import ERROR, OK, STALE, WARN, Health
from trackslip_common.parameters import Parameters
from trackslip_drivers.frequent_reason import STAMP_EVENTS, FrequentReason
from trackslip_drivers.serial_parameters import SerialParameters
from trackslip_drivers.stamping import MonotonicStamps, StampEvent
from trackslip_drivers.transports.host_clock import HostClock
from trackslip_drivers.transports.link import Handlers, Link, Port
from trackslip_drivers.transports.serial_port import BUSY, SerialPort

P = TypeVar("P", bound=Parameters)
L = TypeVar("L", bound=SerialParameters)
D = TypeVar("D")  # data of the port: bytes, or a frame
S = TypeVar("S", bound="Sample")

_STALE_PERIODS = 10
_CHECK_PERIOD = 0.1  # s between checks for a change of the link's condition
_OPENING_TIME = 2.0  # s after opening in which a port need not deliver
REPORT_TIME = 5.0  # s for which a rejection is reported
_SILENCE_LIMIT = 5.0  # s without data, after which ``unusable_data_message`` is not reported
_SLOW_SHARE = 0.8  # of the limit of silence: messages that come at longer intervals come too slowly
_LONGEST_INTERVAL = 10.0  # s between messages of a device that sends at all
_SETTLING_TIME = 1.0  # s beyond the limit in which unusable data are only a warning
_PATIENCE = 5.0  # s of messages, in which each kind of sample should have come
_RATE_INTERVAL = 0.5  # s, shortest interval of a measured rate
_HOST_CLOCK = "host clock"
PORT_REMEDY = "check serial_baud, parity, and that the device is on this port (/dev/serial/by-id)"
_REMEDIES = {  # text of an error of the port → remedy
    os.strerror(errno.EACCES): "add this user to the group of the port (dialout)",
    os.strerror(errno.ENOENT): "check power and cable, and name the port as in /dev/serial/by-id",
    BUSY: "end that program",
}


class Sample(Protocol):
    """Any record of ``records``."""

    @property
    def stamp_ns(self) -> int:
        """Time of the measurement."""

    def _replace(self: S, *, stamp_ns: int) -> S: ...


class _Rejected(NamedTuple):
    """The latest rejection or event that is reported."""

    text: str = ""
    reason: str = ""
    is_event: bool = False
    time_s: float = -math.inf  # steady
    date: str = ""


class DriverNode(TrackslipNode[P], Generic[P, D]):
    """Opens its link while active.

    Subclasses override ``open_port``, ``restart_decoding``, ``receive`` and ``on_silence``, all called in
    the link's thread. Health reports whether data arrive, their rate and rejections: at 1 Hz, and when data
    begin or cease.
    """

    device = "sensor"  # name for users
    data_name = "bytes"
    advice = "check power and port"  # if no data arrive
    slow_advice = "set the rate of the device and of its driver alike"  # if data arrive slowly
    format_advice = "check rate and format"  # if no data are usable
    remedies: Mapping[str, str] = MappingProxyType({})  # by reason of a rejection
    transient_reasons: frozenset[str] = frozenset()  # no faults of the link
    events: frozenset[str] = STAMP_EVENTS  # reasons that reject nothing
    period = 1.0  # s between messages in normal operation
    silence = math.inf  # s without a byte or frame after which the port is reopened

    def configure(self) -> None:
        """Reset the counters, and start the check of the link's condition."""
        self._published = 0
        self._published_at: dict[type, int] = {}  # ``_published`` at the last sample of each kind
        self._rate = 0.0
        self._rate_start = (time.monotonic(), 0)
        self._last_s = -math.inf
        self._intervals = (math.inf, math.inf)  # s, between the latest three messages
        self._link: Link[D] | None = None
        self._reported: bytes | None = None  # level
        self._reasons = FrequentReason(self.events)
        self._rejected = _Rejected()
        self.create_timer(
            _CHECK_PERIOD, self._publish_health_on_change, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def open_port(self) -> Port[D]:
        """Open the port to the sensor, or raise."""
        raise NotImplementedError

    def restart_decoding(self) -> None:
        """Drop half-received data, after a port was opened or decoding failed."""

    def receive(self, data: D, steady_ns: int) -> None:
        """Decode what the port received by this steady time, and publish."""
        raise NotImplementedError

    def on_silence(self, steady_ns: int) -> None:
        """React to a read that found no data until this steady time."""

    def activate(self) -> None:
        """Set the clocks, and open the link."""
        self._host = HostClock()
        self._order: defaultdict[type, MonotonicStamps] = defaultdict(MonotonicStamps)
        guard = self.callback_failures.guard
        receive = guard(self._on_data, "received data", handles_data=True, recover=self.restart_decoding)
        on_silence = guard(lambda: self.on_silence(time.monotonic_ns()), "silence")
        handlers = Handlers(receive, self.restart_decoding, on_silence)
        self._link = Link(self.get_name(), self.open_port, handlers, self.silence)
        self._link.start()

    def deactivate(self) -> None:
        """Close the link."""
        if self._link is not None:
            self._link.stop()

    @property
    def link(self) -> Link[D]:
        """The link, from the first activation on."""
        assert self._link is not None
        return self._link

    def _on_data(self, data: D, host_ns: int) -> None:
        """Pass on data with the steady time of their arrival; counts jumps of the host's clock."""
        steady_ns, has_jumped = self._host.arrival(host_ns, self.link.read_monitor.emptied_ns)
        if has_jumped:
            self.tally.add(_HOST_CLOCK, StampEvent.CLOCK_JUMPED)
        self.receive(data, steady_ns)

    def can_be_delayed(self, steady_ns: int) -> bool:
        """Whether data that seem to have arrived just now may be delayed, as the host was suspended."""
        return self.link.read_monitor.can_be_delayed(steady_ns, time.monotonic_ns())

    def restamp(self, sample: S) -> S:
        """Stamp a sample for publishing: on the host's clock, later than the previous one."""
        self.note_kind(type(sample))
        host_ns = self._host.stamp(sample.stamp_ns)
        stamp_ns = self._order[type(sample)].next_stamp(host_ns)
        if stamp_ns != host_ns:
            self.tally.add(type(sample).__name__, StampEvent.SHIFTED)
        return sample._replace(stamp_ns=stamp_ns)

    def count_message(self) -> None:
        """Count a published message."""
        self._published += 1
        before_s, self._last_s = self._last_s, time.monotonic()
        self._intervals = self._intervals[1], self._last_s - before_s

    def note_kind(self, kind: type) -> None:
        """Note that a sample of this kind, or one that has this property, has come."""
        self._published_at[kind] = self._published

    def missing_kinds(self, kinds: Iterable[type]) -> list[type]:
        """Those kinds of samples of which none has come recently, while messages have."""
        return [
            kind
            for kind in kinds
            if (self._published - self._published_at.get(kind, 0)) * self.period >= _PATIENCE
        ]

    def health(self) -> list[Health]:
        """Connection, rate, age, rejections."""
        state, now_s = self.link.state(), time.monotonic()
        if counts := self.tally.new_counts():
            key = self._reasons.update(counts, now_s)
            is_event = key[1] in self.events
            text = ": ".join(key) if is_event else self.tally.detail_or_reason(key)
            self._rejected = _Rejected(text, key[1], is_event, now_s, utc_date(time.time()))
        start_s, start_count = self._rate_start
        if now_s - start_s >= _RATE_INTERVAL:
            self._rate = (self._published - start_count) / (now_s - start_s)
            self._rate_start = (now_s, self._published)
        values: dict[str, object] = {
            "published": self._published,
            "rate (Hz)": f"{self._rate:.1f}",
            "age (s)": f"{now_s - self._last_s:.2f}",
            "reconnects": max(state.openings - 1, 0),
            "errors": state.errors,
            "last error": state.last_error,
            "last error at": utc_date(state.last_error_s) if state.last_error_s else "",
            "last rejected": self._rejected.text,
            "last rejected at": self._rejected.date,
            "note": state.note,
            "stamps ahead of the host's clock (s)": f"{self._host.lead_ns * 1e-9:.3f}",
        }
        values |= self.tally.values()
        level, message = self._condition()
        self._reported = level
        return [Health(level, message, values)]

    def link_name(self) -> str:
        """Device and port, for messages."""
        return f"{self.device} on {self.hardware()}"

    def dialogue_state(self) -> str:
        """State of the device or of the dialogue with it while no data come; empty if unknown."""
        return ""

    def port_remedy(self, error: str = "") -> str:
        """Remedy for a port that failed with this text, or that delivers nothing."""
        return _REMEDIES.get(error, self.advice)

    def unusable_data_message(self) -> str:
        """Message about valid data that cannot be used, with the remedy; empty if there are none."""
        return ""

    def _condition(self) -> tuple[bytes, str]:
        """(level, message): whether data arrive, or the reason and remedy; without numbers that change."""
        state, where, now_s = self.link.state(), self.link_name(), time.monotonic()
        is_new, silent_s = now_s - state.changed_s < _OPENING_TIME, now_s - state.received_s
        if not state.openings and not state.errors:
            return WARN, f"{where}: opening"
        if not state.connected and not state.was_silent:
            remedy = self.port_remedy(state.last_error)
            return ERROR, f"{where}: not connected ({state.last_error}); {remedy}"
        limit_s = _STALE_PERIODS * self.period
        text, reason, is_event, rejected_s, _ = self._rejected
        interval_s = min(self._intervals)  # one long interval may be a gap
        if _SLOW_SHARE * limit_s < interval_s < _LONGEST_INTERVAL and now_s - self._last_s < 2.0 * interval_s:
            return WARN, f"{where}: {self.data_name} come too seldom; {self.slow_advice}"
        is_recent = now_s - rejected_s < REPORT_TIME
        if now_s - self._last_s <= limit_s:
            remedy = f"; {self.remedies[reason]}" if reason in self.remedies else ""
            fault = f"{'' if is_event else 'some is rejected: '}{text}{remedy}"
            return (WARN, f"running; {fault}") if is_recent else (OK, "running")
        if not self._published and state.connected and state.openings == 1 and is_new:
            return WARN, f"{where}: opened, no data yet"
        dialogue = f" ({self.dialogue_state()})" if self.dialogue_state() else ""
        if silent_s < _SILENCE_LIMIT and (problem := self.unusable_data_message()):
            return ERROR, f"{where}: {problem}"
        if silent_s > 0.5 * limit_s or not state.has_received:
            return STALE, f"{where}: no {self.data_name}{dialogue}; {self.port_remedy()}"
        if is_event or not is_recent:
            text = reason = "no complete message"
        if reason in self.transient_reasons:
            return WARN, f"{where}: {reason}{dialogue}; {self.remedies[reason]}"
        message = f"{where}: {self.data_name} arrive, but none is usable: {text}{dialogue}"
        if now_s - self._last_s < limit_s + _SETTLING_TIME:
            return WARN, message
        return ERROR, f"{message}; {self.remedies.get(reason, self.format_advice)}"

    def _publish_health_on_change(self) -> None:
        """Publish health at once if its level has changed."""
        if self.active and self._link is not None and self._reported != self._condition()[0]:
            self.publish_health()


class SerialDriverNode(DriverNode[L, bytes]):
    """Base of the drivers of devices on a serial line, or behind another URL of pyserial."""

    format_advice = PORT_REMEDY

    def hardware(self) -> str:
        """The serial port."""
        return self.settings.serial_port

    def open_port(self) -> SerialPort:
        """Open the serial port or socket."""
        return SerialPort(self.settings.serial_port, self.settings.serial_baud, self.settings.parity)

    def on_silence(self, steady_ns: int) -> None:
        """Pass the empty read on: it ends an incomplete message, and shows a prompt host."""
        self.receive(b"", steady_ns)
