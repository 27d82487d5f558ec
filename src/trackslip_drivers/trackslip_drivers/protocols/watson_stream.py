# SPDX-License-Identifier: Apache-2.0
"""Cuts the byte stream of a Watson unit into lines or frames, stamps and decodes them."""

import math

from trackslip_common.tally import Tally
from trackslip_drivers.protocols.watson import (
    BITS_PER_CHAR,
    TERMINATOR,
    Layout,
    Reading,
    Rejection,
    decode_frame,
    decode_line,
    to_sample,
)
from trackslip_drivers.records import ImuSample
from trackslip_drivers.stamping import PeriodicStamps

IMU = "imu/data_raw"
FIELD = "imu/mag"

_NS_PER_S = 1_000_000_000
_BIT_7 = 0x80
_LINE_PERIOD_NS = 6 * _NS_PER_S / 71.11  # of decimal lines: every sixth tick of the unit
_CLOCK_TOLERANCE = 0.01  # its manuals state "about"
_PATIENCE = 24  # lines


class WatsonStream:
    """Bytes in, samples out; everything else is counted.

    Holds at most one line's worth of bytes (``limit``), so no stream can make it grow.

    Args:
        layout: channels of the unit.
        baud: line rate; a line was measured when its first character left, so the transfer time of what
            has come is subtracted from its arrival.
        time_offset_ns: added to each stamp.
        tally: counts what was rejected.
    """

    def __init__(self, layout: Layout, baud: int, time_offset_ns: int, tally: Tally) -> None:
        self.tally = tally
        self.limit = 4 * layout.line_length  # a banner's line may be longer than a line of data
        self._layout = layout
        self._baud = baud
        self._time_offset_ns = time_offset_ns
        self._pending = bytearray()
        self._begun_ns = math.inf  # the line that is pending began no later
        self._overlong = False
        self._stamps = PeriodicStamps(_LINE_PERIOD_NS, _CLOCK_TOLERANCE, _PATIENCE)

    @property
    def bytes_held(self) -> int:
        """How many bytes wait for the rest of their line."""
        return len(self._pending)

    def feed(self, data: bytes, arrival_ns: int) -> list[ImuSample]:
        """What one read returned, and when: its last byte was there by ``arrival_ns``.

        A line began no later than any of its reads leaves time for, at the line's rate. One prompt read
        among them is enough.
        """
        samples = []
        *ended, rest = data.split(TERMINATOR)
        left = len(data)
        for part in ended:
            left -= len(part) + 1
            self._hold(part)
            self._bound(arrival_ns - self._transfer_ns(left + 1))
            sample = self._finish()
            if sample is not None:
                samples.append(sample)
        self._hold(rest)
        if self._pending:
            self._bound(arrival_ns)
        return samples

    def reset(self) -> None:
        """Drop a half-received line: the port was reopened."""
        self._clear()
        self._stamps.restart()

    def _clear(self) -> None:
        self._pending.clear()
        self._begun_ns = math.inf
        self._overlong = False

    def _bound(self, arrived_ns: int) -> None:
        """What is pending had come by then."""
        self._begun_ns = min(self._begun_ns, arrived_ns - self._transfer_ns(len(self._pending)))

    def _hold(self, part: bytes) -> None:
        """Keep bytes of an unfinished line, unless it has grown past any line's length.

        White space before it is not part of it: it may have come long before.
        """
        part = part if self._pending else part.lstrip()
        if self._overlong or len(self._pending) + len(part) > self.limit:
            self._overlong = True
            self._pending.clear()
        else:
            self._pending += part

    def _finish(self) -> ImuSample | None:
        """A CR has arrived: decode what it ends."""
        line, overlong, stamp_ns = bytes(self._pending), self._overlong, round(self._begun_ns)
        self._clear()
        if overlong:
            self.tally.add(IMU, Rejection.OVERLONG)
            return None
        stamp_ns += self._time_offset_ns
        if not line:
            return None
        reading = self._decode(line)
        if isinstance(reading, Reading) and line[0] < _BIT_7:  # frames come as fast as the line allows
            stamp_ns = self._stamps.filter(stamp_ns)
        result = reading if isinstance(reading, Rejection) else to_sample(reading, stamp_ns)
        if isinstance(result, Rejection):
            self.tally.add(IMU, result)
            return None
        if result.magnetic_field is None and self._layout.has_field:
            self.tally.add(FIELD, Rejection.INVALID)
        return result

    def _decode(self, line: bytes) -> Reading | Rejection:
        """By the format that the bytes show."""
        marked = sum(byte >= _BIT_7 for byte in line)
        if marked == 0:
            return decode_line(line, self._layout)
        return decode_frame(line, self._layout) if marked == len(line) else Rejection.GARBLED

    def _transfer_ns(self, count: int) -> int:
        """How long ``count`` characters occupy the line."""
        return count * BITS_PER_CHAR * _NS_PER_S // self._baud
