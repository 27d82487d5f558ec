# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Telegrams of SICK scanners, both directions: ``02 | address | length LE16 | payload | CRC LE16``.

Between telegrams stand the bare bytes ACK and NAK. Whatever else comes is garbage, and counted.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.sick_crc import sick_crc

STX = 0x02
TO_SENSOR = 0x00
FROM_SENSOR = 0x80
MAX_PAYLOAD = 812  # the scanners send nothing longer; all 361 values take 726
_HEADER = 4
_OVERHEAD = _HEADER + 2
MAX_TELEGRAM = MAX_PAYLOAD + _OVERHEAD

# A telegram comes without gaps, but a busy host may pause in reading. After this long its rest is lost.
SILENCE_NS = 400_000_000
_NS_PER_S = 1_000_000_000


class Control(Enum):
    """The bare bytes that precede a reply."""

    ACK = 0x06
    NAK = 0x15


_CONTROLS = {control.value: control for control in Control}


class TelegramFault(Enum):
    """Why bytes were thrown away."""

    GARBAGE_BYTE = "garbage byte"  # every discarded byte, also those of the telegrams below
    BAD_LENGTH = "bad length"
    BAD_CRC = "bad CRC"
    TRUNCATED = "truncated telegram"


@dataclass(frozen=True)
class Telegram:
    """One whole telegram, and when it was on the line."""

    payload: bytes
    start_ns: int  # when its first byte (STX) began to arrive
    end_ns: int  # when its last byte had arrived


def frame(payload: bytes, address: int) -> bytes:
    """Wrap a payload into a telegram.

    Raises:
        ValueError: the payload is empty or longer than ``MAX_PAYLOAD``.
    """
    if not 0 < len(payload) <= MAX_PAYLOAD:
        raise ValueError(f"payload of {len(payload)} bytes; accepted: 1 to {MAX_PAYLOAD}")
    body = bytes((STX, address)) + len(payload).to_bytes(2, "little") + payload
    return body + sick_crc(body).to_bytes(2, "little")


class TelegramParser:
    """Cuts a stream of bytes into telegrams, ACKs and NAKs; holds less than one telegram's bytes.

    A telegram that turns out to be none costs its first byte only: the search goes on behind it, so no
    whole telegram is lost to the garbage before it. Within garbage an ACK or NAK is not accepted: it
    counts behind a telegram, behind another ACK or NAK, or after a silence.

    Args:
        address: that of the telegrams to accept (``FROM_SENSOR`` on the host's side).
        baud: rate of the line.
        bits_per_char: 11 for 8E1, 10 for 8N1.
        tally: where rejections are counted, under ``source``.
    """

    def __init__(self, address: int, baud: int, bits_per_char: int, tally: Tally, source: str) -> None:
        self._address = address
        self._bits_per_char = bits_per_char
        self._tally = tally
        self._source = source
        self._char_ns = bits_per_char * _NS_PER_S / baud
        self._buffer = bytearray()
        self._consumed = 0  # bytes of the stream before buffer[0]
        self._reads: deque[tuple[int, int]] = deque()  # (bytes of the stream up to its end, arrival_ns)
        self._hunting = False  # in garbage
        self._last_arrival_ns: int | None = None

    @property
    def bytes_held(self) -> int:
        """How many bytes wait for the rest of their telegram."""
        return len(self._buffer)

    def set_baud(self, baud: int) -> None:
        """Follow a change of the line's rate: what is held came at the old one and is dropped."""
        self._char_ns = self._bits_per_char * _NS_PER_S / baud
        self.cut()
        self._hunting = False

    def cut(self) -> None:
        """Bytes were left out: what is held has no rest, and what comes may be the rest of another."""
        self._reject(TelegramFault.GARBAGE_BYTE, len(self._buffer))
        self._drop(len(self._buffer))
        self._hunting = True

    def feed(self, data: bytes, arrival_ns: int) -> list[Telegram | Control]:
        """Parse the bytes that one read returned, and the time at which it returned.

        Feeding no bytes means that a poll found none: that ends a telegram whose rest does not come.
        """
        events: list[Telegram | Control] = []
        silent = self._last_arrival_ns is None or arrival_ns - self._last_arrival_ns >= SILENCE_NS
        if data:
            self._hunting &= not silent
            self._last_arrival_ns = arrival_ns
            self._buffer += data
            self._reads.append((self._consumed + len(self._buffer), arrival_ns))
            self._scan(events)
        elif silent:
            while self._buffer:
                self._reject(TelegramFault.TRUNCATED)
                self._reject(TelegramFault.GARBAGE_BYTE)
                self._hunting = True
                self._drop(1)
                self._scan(events)
        return events

    def _scan(self, events: list[Telegram | Control]) -> None:
        """Move everything that is complete from the buffer to the events."""
        at = 0
        while at < len(self._buffer):
            found = self._next_at(at)
            if found is None:
                break
            if isinstance(found, TelegramFault):
                if found is not TelegramFault.GARBAGE_BYTE:
                    self._reject(found)
                self._reject(TelegramFault.GARBAGE_BYTE)
                self._hunting = True
                at += 1
            else:
                events.append(found)
                self._hunting = False
                at += len(found.payload) + _OVERHEAD if isinstance(found, Telegram) else 1
        self._drop(at)

    def _next_at(self, at: int) -> Telegram | Control | TelegramFault | None:
        """What begins at an index of the buffer; None: its rest has not come yet."""
        buffer, held = self._buffer, len(self._buffer) - at
        if buffer[at] != STX:
            control = _CONTROLS.get(buffer[at])
            return control if control and not self._hunting else TelegramFault.GARBAGE_BYTE
        if held >= 2 and buffer[at + 1] != self._address:
            return TelegramFault.GARBAGE_BYTE
        if held < _HEADER:
            return None
        length = int.from_bytes(buffer[at + 2 : at + _HEADER], "little")
        if not 0 < length <= MAX_PAYLOAD:
            return TelegramFault.BAD_LENGTH
        size = length + _OVERHEAD
        if held < size:
            return None
        telegram = bytes(buffer[at : at + size])
        if sick_crc(telegram[:-2]) != int.from_bytes(telegram[-2:], "little"):
            return TelegramFault.BAD_CRC
        start_ns = self._start_ns(self._consumed + at)
        return Telegram(telegram[_HEADER:-2], start_ns, start_ns + round(size * self._char_ns))

    def _start_ns(self, index: int) -> int:
        """When a byte of the stream began to arrive: the latest time that no read contradicts.

        A read proves that all it ended with had come by then, and the line is no faster than its rate.
        So late reads do no harm while one of the reads of a telegram was prompt.
        """
        bounds = (arrival - (end - index) * self._char_ns for end, arrival in self._reads if end > index)
        return round(min(bounds))

    def _drop(self, count: int) -> None:
        """Drop bytes at the front of the buffer, and the reads that ended within them."""
        del self._buffer[:count]
        self._consumed += count
        while self._reads and self._reads[0][0] <= self._consumed:
            self._reads.popleft()

    def _reject(self, fault: TelegramFault, count: int = 1) -> None:
        if count:
            self._tally.add(self._source, fault, count)
