# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A SICK scanner on its serial line: boots, answers commands, streams scans.

The mirror turns from the end of the boot on, one scan per turn. A scan is sent when its turn is complete and
the line is free. At 38400 Bd a telegram takes 210 ms, so every sixth scan is sent.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.tally import Tally
from trackslip_common.units import NS_PER_S
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_commands import ModeResult, ReplyCode, Severity
from trackslip_drivers.protocols.sick_scan import RawScan, values_of
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    TO_SENSOR,
    Control,
    Telegram,
    TelegramFault,
    TelegramParser,
    make_telegram,
)
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_sim.devices.line import BaudLine

Measure = Callable[[int], FloatArray]  # stamp of the first ray → (361,) m

_ACK_DELAY_NS = 5_000_000
_REPLY_DELAY_NS = 20_000_000
_RATE_CHANGE_DELAY_NS = 5_000_000  # from the end of the reply to the change of the rate
_RATE_SETTLING_NS = 200_000_000  # after it the device listens again; manuals ask hosts to pause 250 ms
_MAX_STAMPS = 10_000
_IDENTITY = {"pls": b"PLS101-312", "lms": b"LMS200;30106"}
_SOURCE = "host"
_BAUDS = {code: baud for baud, code in commands.BAUD_CODES.items()}


@dataclass(frozen=True, kw_only=True)
class SickDeviceParameters(Parameters):
    """Start of the emulated scanner."""

    boot_delay: float = parameter("from power-on to the first answer; really 15 to 35 s", unit="s", ge=0.0)
    power_on_baud: int = parameter("rate after power-on", unit="Bd", gt=0)


class Mode(Enum):
    """Continuous output of the scanner; the values are the mode codes."""

    ALL = commands.STREAM_ALL[1]
    MINIMA = commands.STREAM_MINIMA[1]
    NOTHING = commands.STOP[1]


class SickDevice:
    """The emulated scanner.

    Attributes:
        baud: current rate, Bd; a host at another rate receives noise.
        status: status byte of its telegrams, set by the caller.
        scans_emitted: scans whose last byte has left.
        stamps: true stamps, ns, of the latest of these scans.
        bytes_ignored: bytes received during boot or a command, or at another rate.
    """

    def __init__(
        self, parameters: SickParameters, start: SickDeviceParameters, measure: Measure, now_ns: int
    ) -> None:
        self.status = 0
        self.scans_emitted = 0
        self.stamps: deque[int] = deque(maxlen=_MAX_STAMPS)
        self.bytes_ignored = 0
        self._parameters = parameters
        self._start = start
        self._measure = measure
        self._turn_ns = round(parameters.scan_time * NS_PER_S)
        self.power_cycle(now_ns)

    def power_cycle(self, now_ns: int) -> None:
        """Lose and regain power: bytes on the line are lost, and the rate is that of power-on."""
        self.baud = self._start.power_on_baud
        bits = self._parameters.bits_per_char
        self._line = BaudLine(self.baud, bits)
        self._tally = Tally()
        self._parser = TelegramParser(TO_SENSOR, self.baud, bits, self._tally, _SOURCE)
        self._scans_in_transit: deque[tuple[int, int]] = deque()  # (time of the last byte, stamp), ns
        self._start_boot(now_ns)

    def receive(self, data: bytes, now_ns: int, host_baud: int | None) -> None:
        """Process bytes from the host at ``host_baud`` Bd; None: the rate is assumed to be right."""
        self._advance(now_ns)
        if not self._is_booted or now_ns < self._busy_until_ns or host_baud not in (None, self.baud):
            self.bytes_ignored += len(data)
            return
        bad_crc = (_SOURCE, TelegramFault.BAD_CRC.value)
        bad_before = self._tally.total[bad_crc]
        for event in self._parser.feed(data, now_ns):
            if isinstance(event, Telegram):
                self._apply_command(event.payload, now_ns)
        if self._tally.total[bad_crc] > bad_before:
            self._line.send(bytes((Control.NAK.value,)), now_ns + _ACK_DELAY_NS)

    def step(self, now_ns: int) -> bytes:
        """Advance to now; return the bytes that have arrived at the host since the last step."""
        self._advance(now_ns)
        arrived = self._line.read(now_ns)
        while self._scans_in_transit and self._scans_in_transit[0][0] <= now_ns:
            self.stamps.append(self._scans_in_transit.popleft()[1])
            self.scans_emitted += 1
        return arrived

    def next_ns(self, now_ns: int, tick_ns: int) -> int:
        """Next time to call ``step``, whole ticks from now; see ``BaudLine.next_read_ns``."""
        if self._mode is Mode.NOTHING:
            return now_ns + tick_ns
        return min(self._complete_ns(), self._line.next_read_ns(now_ns, tick_ns))

    def _start_boot(self, at_ns: int) -> None:
        self._ready_ns = at_ns + round(self._start.boot_delay * NS_PER_S)
        self._is_booted = False
        self._mode = Mode.NOTHING
        self._scan_requested = False
        self._in_installation = False
        self._busy_until_ns = at_ns
        self._next_baud = (at_ns, self._start.power_on_baud)

    def _advance(self, now_ns: int) -> None:
        change_ns, baud = self._next_baud
        if now_ns >= change_ns and baud != self.baud:
            self.baud = self._line.baud = baud
            self._parser.set_baud(baud)
        if not self._is_booted and now_ns >= self._ready_ns:
            self._is_booted = True
            self._send(bytes((ReplyCode.POWER_ON,)) + _IDENTITY[self._parameters.model], self._ready_ns)
        while self._mode is not Mode.NOTHING or self._scan_requested:
            complete_ns = self._complete_ns()
            if complete_ns > now_ns:
                return
            self._send_scan(complete_ns)

    def _complete_ns(self) -> int:
        """Time at which the next scan to be sent is complete, ns."""
        turns = max(1, -((self._ready_ns - self._line.busy_until_ns) // self._turn_ns))
        return self._ready_ns + turns * self._turn_ns

    def _send_scan(self, complete_ns: int) -> None:
        stamp_ns = complete_ns - self._turn_ns
        ranges = self._measure(stamp_ns)
        if self._mode is Mode.MINIMA:
            ranges = np.fmin(ranges[0:-1:2], ranges[1::2])
        scan = RawScan(values_of(ranges, self._parameters), self.status)
        self._line.send(make_telegram(scan.payload(), FROM_SENSOR), complete_ns)
        self._scans_in_transit.append((self._line.busy_until_ns, stamp_ns))
        self._scan_requested = False

    def _apply_command(self, command: bytes, now_ns: int) -> None:
        """Acknowledge a command, carry it out, reply."""
        self._line.send(bytes((Control.ACK.value,)), now_ns + _ACK_DELAY_NS)
        if command in (commands.REQUEST_VALUES_LMS, commands.REQUEST_VALUES_PLS):
            self._scan_requested = True
            return
        self._send(self._reply(command), now_ns + _REPLY_DELAY_NS)
        self._busy_until_ns = self._line.busy_until_ns
        if command == commands.RESET:
            self._start_boot(self._busy_until_ns)
        elif self._is_rate_command(command) and self._can_set_rate():
            self._next_baud = (self._busy_until_ns + _RATE_CHANGE_DELAY_NS, _BAUDS[command[1]])
            self._busy_until_ns += _RATE_SETTLING_NS

    def _reply(self, command: bytes) -> bytes:
        """Carry out a command and return its reply; reset and change of rate take effect after the reply."""
        if command == commands.RESET:
            return bytes((ReplyCode.RESET,))
        if command == commands.STATUS:
            return bytes((ReplyCode.STATUS, self._mode.value))
        if command == commands.ERRORS:
            return bytes((ReplyCode.ERRORS, Severity.NONE, 0))
        if len(command) >= 2 and command[0] == commands.STOP[0]:
            return bytes((ReplyCode.MODE, self._change_mode(command)))
        return bytes((ReplyCode.REFUSED,))

    def _change_mode(self, command: bytes) -> ModeResult:
        password = commands.PASSWORDS[self._parameters.model]
        if self._is_rate_command(command):
            return ModeResult.OK if self._can_set_rate() else ModeResult.FAULT
        if command[1] == commands.installation_mode(b"")[1]:
            if command != commands.installation_mode(password):
                return ModeResult.WRONG_PASSWORD
            self._in_installation = True
            self._mode = Mode.NOTHING
            return ModeResult.OK
        if command not in (commands.STREAM_ALL, commands.STREAM_MINIMA, commands.STOP):
            return ModeResult.FAULT
        self._in_installation = False
        self._mode = Mode(command[1])
        return ModeResult.OK

    def _is_rate_command(self, command: bytes) -> bool:
        return len(command) == 2 and command[0] == commands.STOP[0] and command[1] in _BAUDS

    def _can_set_rate(self) -> bool:
        return self._in_installation or self._parameters.model == "lms"

    def _send(self, payload: bytes, at_ns: int) -> None:
        self._line.send(make_telegram(payload + bytes((self.status,)), FROM_SENSOR), at_ns)
