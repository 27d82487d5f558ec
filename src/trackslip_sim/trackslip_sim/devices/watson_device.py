# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A Watson inertial unit on a serial line: banner, then decimal lines or binary frames at its own rate.

The unit works in ticks of 1/71.11 s. It sends a decimal line every sixth tick (11.85 lines/s) or a binary
frame every tick; a slow line reduces this rate. A line is measured when its first character is sent.
"""

from collections import deque
from collections.abc import Callable

from trackslip_drivers.protocols.watson import (
    BINARY,
    COMMAND_MODE,
    DECIMAL,
    REFERENCE,
    REINITIALISE,
    Layout,
    encode_frame,
    encode_line,
    from_sample,
)
from trackslip_drivers.records import ImuSample
from trackslip_sim.devices.line import BaudLine

TICK_NS = 14_062_500  # 71.11 Hz
INITIALISATION_NS = 5_000_000_000
BANNER = (b"WATSON INDUSTRIES, INC.\r", b"ATTITUDE AND HEADING REFERENCE SYSTEM (EMULATED)\r")

_TICKS_PER_LINE = 6
_SPACE_WINDOW_NS = 2_500_000_000  # after a reinitialise command
_NORTH = ord("N")
_INERTIAL_LABEL = "I"
_REFERENCE_LABEL = "R"
_MAX_STAMPS = 10_000


class WatsonDevice:
    """The emulated unit, powered from ``start_ns`` on.

    Args:
        layout: channels and formats of its output.
        line: its transmitter.
        measure: true motion at a stamp, in the axes of records; ``over_range`` makes the label lower case.
        reference: whether its memory holds the reference mode, as in the thesis.
        start_ns: power-on.

    Attributes:
        lines_emitted: number of lines or frames begun.
        stamps: stamps of the latest of these, ns.
    """

    def __init__(
        self,
        layout: Layout,
        line: BaudLine,
        measure: Callable[[int], ImuSample],
        reference: bool,
        start_ns: int,
    ) -> None:
        self.lines_emitted = 0
        self.stamps: deque[int] = deque(maxlen=_MAX_STAMPS)
        self.north_offset_stored = False  # must stay False: no driver may store an offset
        self._layout = layout
        self._line = line
        self._measure = measure
        self._stored_label = _REFERENCE_LABEL if reference else _INERTIAL_LABEL
        self._start_initialisation(start_ns, INITIALISATION_NS)

    def power_cycle(self, now_ns: int) -> None:
        """Lose and regain power: bytes on the line are lost, and the unit initialises."""
        self._line.discard_unread(now_ns)
        self._start_initialisation(now_ns, INITIALISATION_NS)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Process bytes from the host: commands of one character each."""
        for byte in data:
            self._process_command(byte, now_ns)

    def step(self, now_ns: int) -> bytes:
        """The bytes that have left the line by now."""
        while self._next_ns <= now_ns:
            sent = self._encode_sample(self._next_ns)
            self._line.send(sent, self._next_ns)
            self.lines_emitted += 1
            self.stamps.append(self._next_ns)
            ticks = 1 if self._binary else _TICKS_PER_LINE
            self._next_ns += TICK_NS * max(ticks, -(-self._line.transfer_ns(len(sent)) // TICK_NS))
        return self._line.read(now_ns)

    def next_ns(self, now_ns: int, tick_ns: int) -> int:
        """Next time to call ``step``, whole ticks from now; see ``BaudLine.next_read_ns``."""
        return min(self._next_ns, self._line.next_read_ns(now_ns, tick_ns))

    def _start_initialisation(self, now_ns: int, space_window_ns: int) -> None:
        """Send the banner and wait for the two spaces of command mode."""
        self._label = self._stored_label
        self._binary = False
        self._next_ns = now_ns + INITIALISATION_NS
        self._spaces_until_ns = now_ns + space_window_ns
        self._spaces = 0
        self._north_armed = False
        for text in BANNER:
            self._line.send(text, now_ns)

    def _encode_sample(self, stamp_ns: int) -> bytes:
        """The line or frame measured at ``stamp_ns``."""
        sample = self._measure(stamp_ns)
        values = from_sample(sample)
        if self._binary:
            return encode_frame(values, self._layout)
        is_over_range = any(
            abs(values[c.name]) > c.max_value for c in self._layout.channels if c.name in values
        )
        label = self._label.lower() if sample.over_range or is_over_range else self._label
        return encode_line(label, values, self._layout)

    def _process_command(self, byte: int, now_ns: int) -> None:
        """Process one character; all commands but reinitialise require the two spaces before."""
        command = bytes([byte])
        if command == REINITIALISE:
            self._start_initialisation(now_ns, _SPACE_WINDOW_NS)
        elif self._spaces < len(COMMAND_MODE):
            in_time = now_ns <= self._spaces_until_ns
            self._spaces = self._spaces + 1 if command in COMMAND_MODE and in_time else 0
        else:
            self._set_output(command)
            self.north_offset_stored |= self._north_armed and byte == _NORTH
            self._north_armed = command == REFERENCE

    def _set_output(self, command: bytes) -> None:
        """Change output format or mode."""
        if command in (DECIMAL, BINARY):
            self._binary = command == BINARY
        elif command == REFERENCE:
            self._label = _REFERENCE_LABEL
