# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Splits the byte stream of a Watson unit into lines or frames, stamps and decodes them."""

from collections.abc import Iterator
from typing import NamedTuple

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.timed_bytes import TimedBytes
from trackslip_drivers.protocols.watson import (
    BITS_PER_CHAR,
    TERMINATOR,
    Layout,
    Reading,
    Rejection,
    count_mismatch,
    decode_frame,
    decode_line,
    to_sample,
)
from trackslip_drivers.records import ImuSample
from trackslip_drivers.stamping import BacklogDetector, StampEvent

IMU = "imu/data_raw"
FIELD = "imu/mag"

_BIT_7 = 0x80


class _Line(NamedTuple):
    """One line, without its terminator; None if it exceeded the limit."""

    text: bytes | None
    begun_ns: int  # latest time at which its first character left the sender


class WatsonStream:
    """Decodes bytes to samples; counts everything else.

    Args:
        layout: channels of the unit.
        baud: line rate; a line is measured when its first character leaves, so the transfer time of the
            received bytes is subtracted from their arrival.
        time_offset_ns: added to each stamp.
        tally: counts rejections.

    Attributes:
        limit: largest number of bytes held, so its memory is bounded.
    """

    def __init__(self, layout: Layout, baud: int, time_offset_ns: int, tally: Tally) -> None:
        self.tally = tally
        self.limit = 4 * layout.line_length  # a banner's line may be longer than a line of data
        self._layout = layout
        self._time_offset_ns = time_offset_ns
        self._received = TimedBytes(BITS_PER_CHAR, baud)
        self.reset()

    @property
    def bytes_held(self) -> int:
        """Number of bytes of the incomplete line, at most ``limit``."""
        return len(self._received.data)

    def feed(self, data: bytes, arrival_ns: int) -> list[ImuSample]:
        """The samples completed by one read (which may be empty); its last byte arrived by ``arrival_ns``."""
        if self._backlog.is_backlog(self._received.transfer_ns(len(data)), arrival_ns):
            self.tally.add(IMU, StampEvent.DELAYED, data.count(TERMINATOR))
            self._drop_line()
            return []
        self._received.append(data, arrival_ns)
        decoded = [self._decode_sample(line) for line in self._split_lines()]
        return [sample for sample in decoded if sample is not None]

    def reset(self) -> None:
        """Drop an incomplete line: the port was reopened."""
        self._backlog = BacklogDetector()
        self._drop_line()

    def _drop_line(self) -> None:
        self._received.clear()
        self._is_overlong = False

    def _split_lines(self) -> Iterator[_Line]:
        """The complete lines, without empty ones; and one for each ``limit`` of bytes without a line end.

        White space before a line is dropped: it may have come long before.
        """
        received, data = self._received, self._received.data
        while True:
            if not self._is_overlong:
                received.discard(len(data) - len(data.lstrip()))
            size = data.find(TERMINATOR, 0, self.limit + 1)
            if size >= 0:
                if not self._is_overlong:
                    yield _Line(bytes(data[:size]), received.begun_ns())
                self._is_overlong = False
                received.discard(size + 1)
            elif len(data) > self.limit:
                yield _Line(None, received.begun_ns())
                self._is_overlong = True
                received.discard(self.limit)
            else:
                return

    def _decode_sample(self, line: _Line) -> ImuSample | None:
        """The sample of a complete line; None if it is rejected, which is counted."""
        if line.text is None:
            self.tally.add(IMU, Rejection.OVERLONG)
            return None
        reading, stamp_ns = self._decode(line.text), line.begun_ns + self._time_offset_ns
        result = reading if isinstance(reading, Rejection) else to_sample(reading, stamp_ns)
        if isinstance(result, Rejection):
            detail = count_mismatch(line.text, self._layout) if result is Rejection.WRONG_COUNT else ""
            self.tally.add(IMU, result, detail=detail)
            return None
        if result.magnetic_field is None and self._layout.has_field:
            self.tally.add(FIELD, Rejection.INVALID)
        return result

    def _decode(self, line: bytes) -> Reading | Rejection:
        """Decode a line or frame, whichever the bytes show."""
        if line.isascii():
            return decode_line(line, self._layout)
        is_marked = min(line) >= _BIT_7
        return decode_frame(line, self._layout) if is_marked else Rejection.GARBLED
