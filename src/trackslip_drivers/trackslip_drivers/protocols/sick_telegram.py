# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Telegrams of SICK scanners, both directions: ``02 | address | length LE16 | payload | CRC LE16``.

Single bytes ACK and NAK come between telegrams. All other bytes are garbage, and are counted.
"""

from dataclasses import dataclass
from enum import Enum

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.sick_crc import sick_crc
from trackslip_drivers.protocols.timed_bytes import TimedBytes

STX = 0x02
TO_SENSOR = 0x00
FROM_SENSOR = 0x80
MAX_PAYLOAD = 812  # longest one of the scanners; all 361 values take 726
_HEADER = 4
_OVERHEAD = _HEADER + 2
MAX_TELEGRAM = MAX_PAYLOAD + _OVERHEAD

# A telegram has no gaps, but a busy host may read late. After this time, the rest is lost.
SILENCE_NS = 400_000_000


class Control(Enum):
    """Single bytes that precede a reply."""

    ACK = 0x06
    NAK = 0x15


_CONTROLS = {control.value: control for control in Control}


class TelegramFault(Enum):
    """Reason for discarding bytes."""

    GARBAGE = "bytes between telegrams"  # that follow no other fault
    BAD_LENGTH = "bad length"
    BAD_CRC = "bad CRC"
    TRUNCATED = "truncated telegram"


@dataclass(frozen=True)
class Telegram:
    """A complete telegram, and its time on the line."""

    payload: bytes
    start_ns: int  # when its first byte (STX) began to arrive
    end_ns: int  # when its last byte had arrived


def make_telegram(payload: bytes, address: int) -> bytes:
    """Wrap a payload into a telegram.

    Raises:
        ValueError: the payload is empty or longer than ``MAX_PAYLOAD``.
    """
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"payload of {len(payload)} bytes; accepted: 1 to {MAX_PAYLOAD}")
    body = bytes((STX, address)) + len(payload).to_bytes(2, "little") + payload
    return body + sick_crc(body).to_bytes(2, "little")


class TelegramParser:
    """Splits a stream of bytes into telegrams, ACKs and NAKs; holds less than one telegram's bytes.

    A false telegram costs its first byte only: the search continues after it, so garbage never hides a
    telegram. Within garbage, ACK and NAK are not accepted. They are accepted after a telegram, after another
    ACK or NAK, or after a silence.

    Args:
        address: of the telegrams to accept (``FROM_SENSOR`` on the host's side).
        baud: rate of the line.
        bits_per_char: 11 for 8E1, 10 for 8N1.
        tally: counts rejections, under ``source``: each fault once, not its bytes.

    Attributes:
        discarded_bytes: number of bytes that belong to no telegram and no control.
    """

    def __init__(self, address: int, baud: int, bits_per_char: int, tally: Tally, source: str) -> None:
        self._address = address
        self._tally = tally
        self._source = source
        self._received = TimedBytes(bits_per_char, baud)
        self._buffer = self._received.data
        self._in_garbage = False
        self._uncounted = 0  # bytes discarded since the latest fault that was counted
        self.discarded_bytes = 0
        self._last_arrival_ns: int | None = None

    @property
    def bytes_held(self) -> int:
        """Number of bytes of the incomplete telegram."""
        return len(self._buffer)

    def set_baud(self, baud: int) -> None:
        """Change the line's rate; drops the bytes held, which came at the old one."""
        self.discard_pending()
        self._received.set_baud(baud)
        self._in_garbage = False

    def discard_pending(self) -> None:
        """After a loss of bytes: drop the incomplete telegram, and treat the next bytes as garbage."""
        self.discarded_bytes += len(self._buffer)
        self._received.clear()
        self._in_garbage = True

    def feed(self, data: bytes, arrival_ns: int) -> list[Telegram | Control]:
        """The telegrams and controls completed by one read, which returned at ``arrival_ns``.

        Empty data mean that a poll found none; after a silence this ends an incomplete telegram.
        """
        events: list[Telegram | Control] = []
        was_silent = self._last_arrival_ns is None or arrival_ns - self._last_arrival_ns >= SILENCE_NS
        if data:
            self._in_garbage &= not was_silent
            self._last_arrival_ns = arrival_ns
            self._received.append(data, arrival_ns)
            self._parse_buffer(events)
        elif was_silent:
            while self._buffer:
                self._discard_byte(TelegramFault.TRUNCATED)
                self._received.discard(1)
                self._parse_buffer(events)
        return events

    def _parse_buffer(self, events: list[Telegram | Control]) -> None:
        """Move all complete items from the buffer to the events."""
        at = 0
        while at < len(self._buffer):
            item = self._parse_item(at)
            if item is None:
                break
            if isinstance(item, TelegramFault):
                self._discard_byte(item)
                at += 1
            else:
                events.append(item)
                self._in_garbage = False
                at += len(item.payload) + _OVERHEAD if isinstance(item, Telegram) else 1
        self._received.discard(at)

    def _parse_item(self, at: int) -> Telegram | Control | TelegramFault | None:
        """The item at an index of the buffer; None: it is incomplete."""
        buffer, available = self._buffer, len(self._buffer) - at
        if buffer[at] != STX:
            control = _CONTROLS.get(buffer[at])
            return control if control and not self._in_garbage else TelegramFault.GARBAGE
        if available >= 2 and buffer[at + 1] != self._address:
            return TelegramFault.GARBAGE
        if available < _HEADER:
            return None
        length = int.from_bytes(buffer[at + 2 : at + _HEADER], "little")
        if not 0 < length <= MAX_PAYLOAD:
            return TelegramFault.BAD_LENGTH
        size = length + _OVERHEAD
        if available < size:
            return None
        telegram = bytes(buffer[at : at + size])
        if sick_crc(telegram[:-2]) != int.from_bytes(telegram[-2:], "little"):
            return TelegramFault.BAD_CRC
        start_ns = self._received.begun_ns(at)
        return Telegram(telegram[_HEADER:-2], start_ns, start_ns + self._received.transfer_ns(size))

    def _discard_byte(self, fault: TelegramFault) -> None:
        """Discard a byte. Within garbage, only whole false telegrams and long garbage count as faults."""
        self.discarded_bytes += 1
        self._uncounted += 1
        is_fault = fault in (TelegramFault.BAD_CRC, TelegramFault.TRUNCATED)
        if is_fault or not self._in_garbage or self._uncounted > MAX_TELEGRAM:
            self._tally.add(self._source, fault)
            self._uncounted = 0
        self._in_garbage = True
