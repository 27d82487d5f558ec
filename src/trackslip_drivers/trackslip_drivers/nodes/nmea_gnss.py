# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``nmea_gnss``: a GNSS receiver that speaks NMEA 0183 or UBX, on a serial line or a network."""

import sys
from collections.abc import Iterable
from types import MappingProxyType

from trackslip_common.nodes.health import Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.nodes.driver import DriverNode
from trackslip_drivers.protocols.nmea_stream import FIX, HEADING, NmeaStream, Sample
from trackslip_drivers.records import FixSample
from trackslip_drivers.transports.serial_port import SerialPort


class NmeaNode(DriverNode[NmeaParameters]):
    """Bytes in, ``fix`` and ``heading`` out."""

    device = "GNSS receiver"
    passing = MappingProxyType({"no fix": "give the antenna sight of the sky"})
    silence = 10.0  # a receiver that is told to start cold needs longer, but then speaks of no fix

    def __init__(self) -> None:
        super().__init__("nmea_gnss", NmeaParameters, "nmea_gnss.yaml")

    def configure(self) -> None:
        """Make the publishers."""
        super().configure()
        self.period = 1.0 / self.settings.rate
        self._fixes = self.advertise(topic_class(FIX), FIX)
        self._headings = self.advertise(topic_class(HEADING), HEADING)
        self._stream = self._new_stream()

    def open_port(self) -> SerialPort:
        """The serial port, or a socket."""
        return SerialPort(self.settings.serial_port, self.settings.serial_baud, self.settings.parity)

    def begin(self) -> None:
        """Drop a half-received line."""
        self._stream.reset()

    def receive(self, data: bytes, arrival_ns: int) -> None:
        """Bytes of some lines."""
        self._publish(self._stream.feed(data, self.arrived(arrival_ns)))

    def on_silence(self) -> None:
        """A fix that waits for more waits in vain."""
        self._publish(self._stream.flush())

    def health(self) -> list[Health]:
        """The driver's, with how old answers are."""
        (entry, *others) = super().health()
        entry.values["latency (s)"] = f"{self._stream.latency_ns * 1e-9:.3f}"
        entry.values["sentences of other kinds"] = self._stream.others
        entry.values["measurements stated twice"] = self._stream.repeated
        entry.values["bytes between sentences"] = self._stream.binary
        return [entry, *others]

    def lack(self) -> str:
        """Whole sentences, but none with a position."""
        kinds = self._stream.kinds
        if not kinds or {"GGA", "NAV-PVT"} & set(kinds):
            return ""
        remedy = "but neither GGA nor NAV-PVT; switch GGA on at the receiver"
        return f"whole sentences come ({', '.join(kinds)}), {remedy}"

    def _new_stream(self) -> NmeaStream:
        utc = (lambda steady_ns: self._host.stamp(steady_ns)) if self.settings.host_clock_is_utc else None
        return NmeaStream(self.settings, self.tally, utc)

    def _publish(self, samples: Iterable[Sample]) -> None:
        for decoded in samples:
            if isinstance(decoded, FixSample):
                fix = self.stamped(decoded)
                self._fixes.publish(conversions.nav_sat_fix(make, fix, self.settings.frame_id))
                self.count()
            else:
                heading = self.stamped(decoded)
                self._headings.publish(conversions.heading(make, heading, self.settings.heading_frame_id))


def main() -> None:
    """Entry point."""
    sys.exit(run(NmeaNode))
