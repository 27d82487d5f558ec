# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Splits the bytes of a GNSS receiver into sentences and binary messages, and determines the time of each.

    $ … LF, or CR before the next message                     a sentence of NMEA 0183, printable
    B5 62 class id length(2, LE) payload checksum(2)          UBX
    D3 length(2, BE, of 10 bits) payload CRC(3)               RTCM 3

A sentence begins with two capitals, and binary messages are recognised by their checksum. A byte that begins
none of the three is noise: another protocol, in text or binary, or damage. The search continues at the byte
after it, so noise never hides a sentence.
"""

import re
from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple

from pyrtcm import calc_crc24q
from pyubx2 import calc_checksum

from trackslip_drivers.protocols.nmea import BITS_PER_CHAR, LONGEST_LINE
from trackslip_drivers.protocols.timed_bytes import TimedBytes

_UBX, _RTCM, _SENTENCE, _LF = b"\xb5\x62", 0xD3, ord("$"), ord("\n")
_LINE_END = re.compile(rb"\n|\r(?=[$\xb5\xd3])")
_NOISE_END = re.compile(rb"[$\xb5\xd3\n]")
_NON_TEXT = re.compile(rb"[^\x20-\x7e\r\t]")
_ADDRESS = re.compile(rb"\$[A-Z]{2}")  # how a sentence begins
_LONGEST_UBX = 4096  # bytes of a payload; raw measurements of a hundred signals take 3.2 kB
LONGEST_MESSAGE = _LONGEST_UBX + 8
_STALL_NS = 300_000_000  # silence after which a pending binary message is abandoned


class Kind(Enum):
    """Type of a piece of the stream."""

    SENTENCE = "NMEA"  # from its $ on, without its line end
    UBX = "UBX"
    RTCM = "RTCM"
    OVERLONG = "overlong"  # text that does not end
    NOISE = "noise"


class Frame(NamedTuple):
    """One piece of the stream."""

    kind: Kind
    content: bytes
    begun_ns: int  # latest time at which the first byte left the sender
    ended_ns: int  # the same for the last byte


class FrameSplitter:
    """Splits the stream; holds at most ``LONGEST_MESSAGE`` bytes between reads, so its memory is bounded.

    Args:
        baud: line rate; 0: a network, without transmission time.
    """

    def __init__(self, baud: int) -> None:
        self._received = TimedBytes(BITS_PER_CHAR, baud)
        self._pending = self._received.data
        self._noise = bytearray()
        self._overlong = False

    @property
    def bytes_held(self) -> int:
        """Number of bytes of the incomplete message."""
        return len(self._pending)

    def reset(self) -> None:
        """Drop an incomplete message."""
        self._received.clear()
        self._noise.clear()
        self._overlong = False

    def feed(self, data: bytes, arrival_ns: int) -> Iterator[Frame]:
        """The pieces completed by one read, whose last byte arrived by ``arrival_ns``."""
        if not data:
            return
        if self._pending and arrival_ns - self._received.latest_ns > _STALL_NS:
            yield from self.split_pending()
        self._received.append(data, arrival_ns)
        yield from self._split()

    def split_pending(self) -> Iterator[Frame]:
        """After silence on the line: abandon a pending binary message, and split its content again."""
        while self._pending and self._pending[0] != _SENTENCE:
            yield from self._skip_noise()
            yield from self._split()

    def _split(self) -> Iterator[Frame]:
        while self._pending:
            size = self._message_size()
            if size is None:
                return
            if size == 0:
                yield from self._skip_noise()
                continue
            kind = {_SENTENCE: Kind.SENTENCE, _RTCM: Kind.RTCM}.get(self._pending[0], Kind.UBX)
            yield from self._flush_noise()
            yield self._extract_message(kind, size)

    def _message_size(self) -> int | None:
        """Size of the message at the start of the pending bytes; 0: none starts there; None: incomplete."""
        first = self._pending[0]
        if first == _SENTENCE:
            return self._sentence_size()
        if first == _UBX[0]:
            return self._ubx_size()
        return self._rtcm_size() if first == _RTCM else 0

    def _sentence_size(self) -> int | None:
        if len(self._pending) > 2 and not _ADDRESS.match(self._pending):
            return 0
        match = _LINE_END.search(self._pending, 1, LONGEST_LINE + 1)
        end = match.start() if match else -1
        length = min(len(self._pending), LONGEST_LINE + 1) if end < 0 else end
        if _NON_TEXT.search(self._pending, 1, length) or self._pending.find(_SENTENCE, 1, length) > 0:
            return 0
        if end > 0:
            return end + 1
        return None if len(self._pending) <= LONGEST_LINE else 0

    def _ubx_size(self) -> int | None:
        pending = self._pending
        if len(pending) > 1 and pending[1] != _UBX[1]:
            return 0
        if len(pending) < 6:
            return None
        size = int.from_bytes(pending[4:6], "little") + 8
        if size > LONGEST_MESSAGE:
            return 0
        if len(pending) < size:
            return None
        return size if calc_checksum(bytes(pending[2 : size - 2])) == pending[size - 2 : size] else 0

    def _rtcm_size(self) -> int | None:
        pending = self._pending
        if len(pending) > 1 and pending[1] & 0xFC:
            return 0
        if len(pending) < 3:
            return None
        size = int.from_bytes(pending[1:3], "big") + 6
        if len(pending) < size:
            return None
        return 0 if calc_crc24q(bytes(pending[:size])) else size

    def _skip_noise(self) -> Iterator[Frame]:
        """Move bytes to the noise, up to the next possible start of a message or end of a line."""
        if self._pending[0] == _SENTENCE:
            yield from self._flush_noise()
        if self._pending[0] == _LF:
            self._received.discard(1)
            yield from self._flush_noise()
            return
        match = _NOISE_END.search(self._pending, 1)
        size = match.start() if match else len(self._pending)
        self._noise += self._pending[:size]
        self._received.discard(size)
        if len(self._noise) > LONGEST_LINE:
            self._overlong |= _NON_TEXT.search(self._noise) is None
            if not self._overlong:
                yield self._noise_frame(Kind.NOISE)
            self._noise.clear()

    def _flush_noise(self) -> Iterator[Frame]:
        """Return the collected noise as a piece; a truncated sentence is marked as overlong."""
        is_cut = _ADDRESS.match(self._noise) and _NON_TEXT.search(self._noise) is None
        if self._overlong or self._noise.strip():
            yield self._noise_frame(Kind.OVERLONG if self._overlong or is_cut else Kind.NOISE)
        self._noise.clear()
        self._overlong = False

    def _noise_frame(self, kind: Kind) -> Frame:
        return Frame(kind, bytes(self._noise), self._received.latest_ns, self._received.latest_ns)

    def _extract_message(self, kind: Kind, size: int) -> Frame:
        """Remove a complete message."""
        begun_ns, ended_ns = self._received.begun_ns(), self._received.ended_ns(size)
        content = bytes(self._pending[:size])
        content = content.rstrip(b"\r\n") if kind is Kind.SENTENCE else content
        self._received.discard(size)
        return Frame(kind, content, begun_ns, ended_ns)
