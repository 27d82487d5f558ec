# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Host side of the dialogue with a SICK scanner, from any state of the scanner to streaming scans.

    stop (0x25) at each rate until it answers → installation mode → set the rate → switch the host
    → pause → stop → stream all values (0x24); repeated from the start if the scanner falls silent, and
    a while after it refused the password.

The owner has the port and the clock. It passes the bytes of each read to ``receive``, then calls ``step`` and
carries out the returned action, at least every 20 ms. Empty bytes mean that a read timed out:

    scans = session.receive(port.read(), now_ns)
    action = session.step(now_ns)
    if action.baud is not None: set the port's rate
    write action.write
"""

import math
from collections import deque
from collections.abc import Generator
from dataclasses import replace
from enum import Enum
from typing import NamedTuple, TypeVar

from trackslip_common.tally import Tally
from trackslip_common.units import NS_PER_S
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_commands import (
    CommandRefused,
    ModeChanged,
    ModeResult,
    PowerOn,
    Reply,
    ReplyCode,
    ReplyFault,
    ResetDone,
)
from trackslip_drivers.protocols.sick_scan import Scan, ScanFault, decode_scan
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    MAX_TELEGRAM,
    TO_SENSOR,
    Control,
    Telegram,
    TelegramParser,
    make_telegram,
)
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_drivers.stamping import BacklogDetector, PeriodicStamps, StampEvent

T = TypeVar("T")
Script = Generator[None, None, T]  # resumed by each step; returns its result
Answer = Reply | Control | None  # ACK: acknowledged, but no reply came; None: no answer

_SOURCE = "scan"
_OK = ModeChanged(ModeResult.OK)
_INBOX_SIZE = 16
_FULL_SCAN_SIZE = 732  # bytes of a telegram with 361 values
_MIRROR_TOLERANCE = 0.01  # relative, of the time of one turn
_PATIENCE = 50  # scans
_MAX_REFUSALS = 2  # of a rate; one of them may be a wrong byte
_PASSWORD_PAUSE = 10.0  # s from a refusal (by a wrong scanner, or a wrong byte) to the next attempt


class Phase(Enum):
    """State of the dialogue."""

    PROBING = "looking for the scanner's rate"
    INSTALLING = "entering installation mode"
    CHANGING_RATE = "changing the rate"
    STARTING = "starting to stream"
    STREAMING = "streaming"
    STOPPING = "stopping"
    STOPPED = "stopped"
    FAILED = "password refused, to be tried again"


class SessionFault(Enum):
    """Reason for a restart of the dialogue."""

    NO_ANSWER = "no answer at any rate"
    REFUSED = "start-up refused or not answered"
    BAUD = "rate refused or not answered"
    PASSWORD = "password refused"
    SILENT = "scans stopped coming"
    RESTARTED = "scanner restarted"


class Action(NamedTuple):
    """Action for the port: first change its rate if one is given, then write."""

    baud: int | None
    write: bytes


def scan_period(parameters: SickParameters, baud: int) -> float:
    """Time between scans of all values, s: the whole turns of the mirror that one telegram takes."""
    transfer = _FULL_SCAN_SIZE * parameters.bits_per_char / baud
    return math.ceil(transfer / parameters.scan_time) * parameters.scan_time


class SickSession:
    """Brings a scanner to streaming and keeps it there.

    ``baud`` is the rate that the port must have, also at its opening. After two refusals of a rate the next
    lower one is used, until the scanner falls silent. Nothing more happens once ``phase`` is STOPPED.
    ``tally`` counts rejections and restarts.
    """

    def __init__(self, parameters: SickParameters, tally: Tally) -> None:
        self.tally = tally
        self.phase = Phase.PROBING
        self.baud = parameters.serial_baud
        self._parameters = parameters
        self._parser = TelegramParser(FROM_SENSOR, self.baud, parameters.bits_per_char, self.tally, _SOURCE)
        self._backlog = BacklogDetector()
        self._start_filter: PeriodicStamps | None = None
        self._requested_baud = parameters.serial_baud  # or lower, if the scanner refuses it
        self._refusals = 0  # consecutive, of that rate
        self._inbox: deque[Reply | Control] = deque(maxlen=_INBOX_SIZE)
        self._now_ns = 0
        self._last_byte_ns = 0
        self._last_scan_ns = 0
        self._new_baud: int | None = None
        self._write = b""
        self._script: Script[None] = self._run()

    @property
    def discarded_bytes(self) -> int:
        """Number of bytes that belong to no telegram."""
        return self._parser.discarded_bytes

    def receive(self, data: bytes, arrival_ns: int) -> list[Scan]:
        """The scans completed by one read (which may be empty) at ``arrival_ns``."""
        if data:
            self._last_byte_ns = arrival_ns
        if self._backlog.is_backlog(self._transfer_ns(len(data)), arrival_ns):
            self.tally.add(_SOURCE, StampEvent.DELAYED, bool(data))
            self._parser.discard_pending()
            self._last_scan_ns = arrival_ns  # the host was suspended, the scanner was not silent
            return []
        scans: list[Scan] = []
        for event in self._parser.feed(data, arrival_ns):
            result = event if isinstance(event, Control) else self._decode_telegram(event)
            if isinstance(result, Scan):
                scans.append(result)
            elif isinstance(result, (ScanFault, ReplyFault)):
                self.tally.add(_SOURCE, result)
            else:
                self._inbox.append(result)
        return scans

    def step(self, now_ns: int) -> Action:
        """Advance the dialogue to ``now_ns``; returns the action for the port."""
        self._now_ns = now_ns
        next(self._script, None)
        action = Action(self._new_baud, self._write)
        self._new_baud, self._write = None, b""
        return action

    def stop(self) -> None:
        """Begin to stop the stream; continue to step until ``phase`` is STOPPED, then close the port."""
        self._script = self._shut_down()

    def _decode_telegram(self, telegram: Telegram) -> Scan | ScanFault | Reply | ReplyFault:
        if telegram.payload[0] != ReplyCode.SCAN:
            return commands.parse_reply(telegram.payload)
        if self.phase is not Phase.STREAMING:
            return ScanFault.NOT_STREAMING
        self._last_scan_ns = telegram.end_ns
        if self._start_filter is not None:
            telegram = replace(telegram, start_ns=self._start_filter.filter(telegram.start_ns))
        return decode_scan(telegram, self._parameters)

    def _run(self) -> Script[None]:
        while True:
            fault = yield from self._start_up()
            if fault is None:
                fault = yield from self._watch_stream()
                self._requested_baud, self._refusals = self._parameters.serial_baud, 0
            self.tally.add(_SOURCE, fault)
            if fault is SessionFault.PASSWORD:
                self.phase = Phase.FAILED
                yield from self._pause(_PASSWORD_PAUSE)

    def _start_up(self) -> Script[SessionFault | None]:
        """From any state to streaming; returns the fault, or None on success."""
        self.phase = Phase.PROBING
        if not (yield from self._find_baud()):
            return SessionFault.NO_ANSWER
        if self.baud != self._requested_baud:
            old_baud = self.baud
            fault = yield from self._change_baud()
            if fault is SessionFault.BAUD:
                self._count_rate_refusal(old_baud)
            if fault is not None:
                return fault
        self._start_filter = self._make_start_filter()
        self.phase = Phase.STARTING
        if (yield from self._request(commands.STREAM_ALL)) != _OK:
            return SessionFault.REFUSED
        self.phase = Phase.STREAMING
        return None

    def _find_baud(self) -> Script[bool]:
        """Send stop at each rate until one is answered; returns whether one was.

        The present rate comes first, then alternately another one and that of power-on. A scanner that has
        just started is thus found soon.
        """
        power_on = commands.POWER_ON_BAUD
        rates = [power_on] if self.baud == power_on else [self.baud, power_on]
        for baud in dict.fromkeys((self._parameters.serial_baud, *commands.BAUD_CODES)):
            rates += [] if baud in rates else [baud, power_on]
        for baud in rates:
            self._set_host_baud(baud)
            answer = yield from self._request(commands.STOP)
            if isinstance(answer, PowerOn):
                answer = yield from self._request(commands.STOP)
            if answer == _OK:
                return True
        return False

    def _change_baud(self) -> Script[SessionFault | None]:
        """Set scanner and host to the requested rate; the scanner acknowledges at the old one."""
        if self._parameters.model == "pls":
            self.phase = Phase.INSTALLING
            password = commands.PASSWORDS[self._parameters.model]
            answer = yield from self._request(commands.installation_mode(password))
            if answer == ModeChanged(ModeResult.WRONG_PASSWORD):
                return SessionFault.PASSWORD
            if answer != _OK:
                return SessionFault.REFUSED
        self.phase = Phase.CHANGING_RATE
        command = commands.set_baud(self._requested_baud)
        # The reply, too, may come at the old rate: wait for it no longer than the pause.
        answer = yield from self._request(command, self._parameters.baud_pause)
        if answer not in (_OK, Control.ACK):
            return SessionFault.BAUD
        self._set_host_baud(self._requested_baud)
        yield from self._pause(self._parameters.baud_pause)
        return None if (yield from self._request(commands.STOP)) == _OK else SessionFault.BAUD

    def _count_rate_refusal(self, old_baud: int) -> None:
        """Count a refusal of the rate; after ``_MAX_REFUSALS``, request the next lower, or ``old_baud``."""
        self._refusals += 1
        if self._refusals >= _MAX_REFUSALS:
            lower = [baud for baud in commands.BAUD_CODES if baud < self._requested_baud]
            self._requested_baud, self._refusals = max(lower, default=old_baud), 0

    def _make_start_filter(self) -> PeriodicStamps | None:
        """Filter of the telegrams' starts, a turn apart, if the line keeps up with the mirror; else None.

        Without the filter, a telegram takes many reads, one of which is prompt.
        """
        turn = self._parameters.scan_time
        if scan_period(self._parameters, self.baud) > turn:
            return None
        return PeriodicStamps(turn * NS_PER_S, _MIRROR_TOLERANCE, _PATIENCE)

    def _watch_stream(self) -> Script[SessionFault]:
        """Wait while scans arrive; returns the fault that ends the stream."""
        self._last_scan_ns = self._last_byte_ns = self._now_ns
        while (
            self._now_ns - self._last_scan_ns < self._parameters.telegram_timeout * NS_PER_S
            and self._now_ns - self._last_byte_ns < self._parameters.silence_timeout * NS_PER_S
        ):
            yield
            while self._inbox:
                if isinstance(self._inbox.popleft(), (PowerOn, ResetDone)):
                    return SessionFault.RESTARTED
        return SessionFault.SILENT

    def _shut_down(self) -> Script[None]:
        self.phase = Phase.STOPPING
        yield from self._request(commands.STOP)
        self.phase = Phase.STOPPED

    def _request(self, command: bytes, reply_timeout: float | None = None) -> Script[Answer]:
        """Send a command, wait for its acknowledgement, then for its reply; returns the answer."""
        self._inbox.clear()
        self._write = make_telegram(command, TO_SENSOR)
        ack_ns = round(self._parameters.ack_timeout * NS_PER_S)
        reply_s = self._parameters.mode_timeout if reply_timeout is None else reply_timeout
        reply_ns = round(reply_s * NS_PER_S)
        answer: Answer = None
        deadline_ns = self._now_ns + self._transfer_ns(len(self._write)) + ack_ns
        # A streaming scanner acknowledges after the end of its present telegram.
        latest_ns = deadline_ns + self._transfer_ns(MAX_TELEGRAM)
        while True:
            yield
            while self._inbox:
                event = self._inbox.popleft()
                if event is Control.ACK:
                    answer, deadline_ns = event, self._now_ns + reply_ns
                elif event is Control.NAK or isinstance(event, (ModeChanged, CommandRefused, PowerOn)):
                    return event
            busy_until_ns = 0 if answer else min(self._last_byte_ns + ack_ns, latest_ns)
            if self._now_ns >= max(deadline_ns, busy_until_ns):
                return answer

    def _pause(self, duration: float) -> Script[None]:
        end_ns = self._now_ns + round(duration * NS_PER_S)
        while self._now_ns < end_ns:
            yield

    def _set_host_baud(self, baud: int) -> None:
        if baud != self.baud:
            self.baud = self._new_baud = baud
            self._parser.set_baud(baud)

    def _transfer_ns(self, count: int) -> int:
        return count * self._parameters.bits_per_char * NS_PER_S // self.baud
