# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A GNSS receiver on a serial line: a burst of GGA, GST, RMC and PASHR per epoch, with a latency.

After power-on it sends nothing, then sentences without fix and time. Its position then improves in steps:
code only, carrier phase with float ambiguities, fixed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.units import NS_PER_S
from trackslip_drivers.protocols.nmea_sentences import Position, gga, gst, pashr, rmc
from trackslip_sim.devices.line import NEVER_NS, BaudLine

RECEIVER_RATE = 10.0  # Hz, default rate of a machine with an antenna
SINGLE, FLOAT, FIXED = 1, 5, 4  # quality
# s since power-on at which a state ends; quality in the state
_START_QUALITIES = ((2.0, None), (5.0, 0), (8.0, SINGLE), (12.0, FLOAT))


@dataclass(frozen=True, kw_only=True)
class NmeaDeviceParameters(Parameters):
    """Rate and latency of the emulated receiver."""

    rate: float = parameter(
        "epochs, on whole fractions of a second; 0: there is no receiver", unit="Hz", ge=0.0, le=20.0
    )
    latency: float = parameter("shortest time from an epoch to the first byte", unit="s", ge=0.0, lt=0.5)
    latency_jitter: float = parameter("mean of the additional exponential latency", unit="s", ge=0.0, le=0.1)


class NmeaDevice:
    """The receiver; it has been powered for long when the emulator starts.

    Args:
        p: epochs and latency.
        line: its transmitter.
        measure: position and heading at an epoch, of a quality no better than the second argument.
        start_ns: time of the first epoch or earlier.
        seed: seed of the latency.

    Attributes:
        fixes_emitted, velocities_emitted, headings_emitted: number of each so far.
    """

    def __init__(
        self,
        p: NmeaDeviceParameters,
        line: BaudLine,
        measure: Callable[[int, int], Position],
        start_ns: int,
        seed: int,
    ) -> None:
        self.fixes_emitted = self.velocities_emitted = self.headings_emitted = 0
        self._p = p
        self._line = line
        self._measure = measure
        self._random = np.random.default_rng(seed)
        self._power_on_ns: int | None = None
        self._period_ns = round(NS_PER_S / p.rate) if p.rate > 0.0 else NEVER_NS
        self._epoch_ns = -(-start_ns // self._period_ns) * self._period_ns
        self._schedule_burst()

    def power_cycle(self, now_ns: int) -> None:
        """Lose and regain power: bytes on the line are lost, and the receiver starts cold."""
        self._line.discard_unread(now_ns)
        self._power_on_ns = now_ns
        self._epoch_ns = -(-now_ns // self._period_ns) * self._period_ns
        self._schedule_burst()

    def step(self, now_ns: int) -> bytes:
        """The bytes that have left the line by now."""
        while self._send_ns <= now_ns:
            for sentence in self._epoch_sentences(self._epoch_ns):
                self._line.send(sentence, self._send_ns)
            self._epoch_ns += self._period_ns
            self._schedule_burst()
        return self._line.read(now_ns)

    def next_ns(self, now_ns: int, tick_ns: int) -> int:
        """Next time to call ``step``, whole ticks from now; see ``BaudLine.next_read_ns``."""
        return min(self._send_ns, self._line.next_read_ns(now_ns, tick_ns))

    def _schedule_burst(self) -> None:
        late = self._p.latency + self._p.latency_jitter * self._random.standard_exponential()
        self._send_ns = self._epoch_ns + round(late * 1e9)

    def _epoch_sentences(self, epoch_ns: int) -> tuple[bytes, ...]:
        """The sentences of one epoch."""
        best: int | None = FIXED
        if self._power_on_ns is not None:
            since = (epoch_ns - self._power_on_ns) / NS_PER_S
            best = next((quality for until, quality in _START_QUALITIES if since < until), FIXED)
        if best is None:
            return ()
        at = Position(None) if best == 0 else self._measure(epoch_ns, best)
        self.fixes_emitted += at.quality != 0
        self.velocities_emitted += at.speed is not None
        self.headings_emitted += at.heading is not None
        return gga(at), gst(at), rmc(at), pashr(at)
