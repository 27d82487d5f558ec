# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``nmea_gnss``: a GNSS receiver with NMEA 0183 or UBX, on a serial line or a network."""

import math
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from trackslip_common.nodes.health import OK, WARN, Health
from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.run import run
from trackslip_drivers import conversions
from trackslip_drivers.frequent_reason import STAMP_EVENTS
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.nodes.driver import SerialDriverNode
from trackslip_drivers.protocols.nmea import BITS_PER_CHAR, Rejection
from trackslip_drivers.protocols.nmea_sentences import Position, gga
from trackslip_drivers.protocols.nmea_stream import (
    FIX,
    HEADING,
    NO_POSITION,
    POSITIONS,
    VELOCITY,
    ClockEvent,
    NmeaStream,
    Sample,
)
from trackslip_drivers.records import CovarianceType, FixSample, FixStatus, HeadingSample, VelocitySample
from trackslip_drivers.transports.ntrip import MAX_RATE, STALL_S, NtripClient, read_credentials

_TRANSIENT = [
    reason.value
    for reason in (Rejection.NO_FIX, Rejection.WARNING, Rejection.DEAD_RECKONING, Rejection.NOT_MEASURED)
]
_QUALITY = {FixStatus.SINGLE: 1, FixStatus.DIFFERENTIAL: 2, FixStatus.RTK: 4}
_MISSING: dict[type, str] = {
    CovarianceType: f"{FIX} has no accuracy of the receiver any more, but HDOP times range_errors; "
    "check that it sends GST",
    HeadingSample: f"no {HEADING} any more; check the second antenna, and the receiver's HDT, THS or PASHR",
    VelocitySample: f"no {VELOCITY} any more; check that the receiver sends RMC, VTG or NAV-PVT",
}
_POSITION_AGE = 10.0  # s, of a fix whose position is sent to the caster


class NmeaNode(SerialDriverNode[NmeaParameters]):
    """Receives bytes; publishes ``fix``, ``fix_velocity`` and ``heading``."""

    device = "GNSS receiver"
    slow_advice = "set the receiver to rate, or rate to that of the receiver"
    transient_reasons = frozenset(_TRANSIENT)
    remedies = MappingProxyType(
        {
            **dict.fromkeys(_TRANSIENT, "check that the antenna sees the sky"),
            Rejection.NOT_MEASURED.value: "let the receiver measure its position",
            Rejection.NO_CHECKSUM.value: "switch checksums on at the receiver",
            Rejection.CHECKSUM.value: "check the cable and serial_baud",
            Rejection.NO_PAIR.value: "set up the base as a moving base",
            ClockEvent.NOT_UTC.value: "keep this computer on UTC, or set host_clock_is_utc: false",
            ClockEvent.UNCHANGED.value: "restart the receiver",
            ClockEvent.REPEATED.value: "let the receiver send fractions of seconds, and each sentence once",
        }
    )
    events = STAMP_EVENTS | {ClockEvent.NOT_UTC.value}
    silence = 10.0  # a cold start takes longer, but the receiver then reports no fix

    def __init__(self) -> None:
        super().__init__("nmea_gnss", NmeaParameters, "nmea_gnss.yaml")

    def configure(self) -> None:
        """Create publishers and decoder, and read the caster's credentials."""
        super().configure()
        self.period = 1.0 / self.settings.rate
        self._fixes = self.advertise(topic_class(FIX), FIX)
        self._headings = self.advertise(topic_class(HEADING), HEADING)
        self._velocities = self.advertise(topic_class(VELOCITY), VELOCITY)
        self._stream = self._make_stream()
        self._latest_fix: tuple[FixSample, float] | None = None  # and the steady time of its arrival, s
        file = self.settings.ntrip.credentials_file
        self._credentials = read_credentials(Path(file)) if self.settings.ntrip.host and file else None
        self._caster: NtripClient | None = None

    def activate(self) -> None:
        """Open the link, and connect to the caster if there is one."""
        super().activate()
        p = self.settings
        if p.ntrip.host:
            max_rate = MAX_RATE if "://" in p.serial_port else min(p.serial_baud // BITS_PER_CHAR, MAX_RATE)
            self._caster = NtripClient(
                p.ntrip, self._credentials, max_rate, self.link.write, self._present_gga
            )
            self._caster.start()

    def deactivate(self) -> None:
        """Close the link and the connection to the caster."""
        if self._caster is not None:
            self._caster.stop()
            self._caster = None
        super().deactivate()

    def restart_decoding(self) -> None:
        """Drop half-received messages."""
        self._stream.reset()

    def receive(self, data: bytes, steady_ns: int) -> None:
        """Decode received bytes, and publish."""
        self._publish(self._stream.feed(data, steady_ns))

    def on_silence(self, steady_ns: int) -> None:
        """Publish a fix that waits for further sentences."""
        self._publish(self._stream.flush())

    def health(self) -> list[Health]:
        """The driver's health, with latency and counters of the stream; and that of the corrections."""
        (entry, *others) = super().health()
        missing = [_MISSING[kind] for kind in self.missing_kinds(_MISSING.keys() & self._published_at.keys())]
        if missing and entry.level in (OK, WARN):
            entry = replace(entry, level=WARN, message="; ".join([entry.message, *sorted(missing)]))
        entry.values["latency (s)"] = f"{self._stream.latency_ns * 1e-9:.3f}"
        entry.values["unused sentences"] = self._stream.unused_sentences
        entry.values["duplicate measurements"] = self._stream.duplicates
        entry.values["bytes between sentences"] = self._stream.bytes_between_sentences
        return [entry, *others, *self._health_of_corrections()]

    def _health_of_corrections(self) -> list[Health]:
        if self._caster is None:
            return []
        state, where = self._caster.state(), self._caster.where
        values = {
            "age of corrections (s)": f"{state.age_s:.1f}" if math.isfinite(state.age_s) else "none yet",
            "messages": state.messages,
            "bytes": state.bytes,
            "left out": state.left_out,
            "connections": state.connections,
        }
        if not state.fault and state.age_s <= STALL_S:
            return [Health(OK, f"{where}: corrections come", values, part="corrections")]
        fault = state.fault or "sends no more corrections"
        message = f"{where}: {fault}; the receiver goes on without corrections"
        return [Health(WARN, message, values, part="corrections")]

    def unusable_data_message(self) -> str:
        """Message if valid sentences come, but none with a position."""
        kinds = self._stream.kinds
        if not kinds or POSITIONS & set(kinds):
            return ""
        return f"complete messages arrive ({', '.join(kinds)}), but no GGA, GNS or NAV-PVT; {NO_POSITION}"

    def _make_stream(self) -> NmeaStream:
        utc = (lambda steady_ns: self._host.stamp(steady_ns)) if self.settings.host_clock_is_utc else None
        return NmeaStream(self.settings, self.tally, utc)

    def _publish(self, samples: Iterable[Sample]) -> None:
        for decoded in samples:
            if isinstance(decoded, FixSample):
                fix = self.restamp(decoded)
                if fix.covariance_type is CovarianceType.DIAGONAL_KNOWN:
                    self.note_kind(CovarianceType)
                self._fixes.publish(conversions.nav_sat_fix(make, fix, self.settings.frame_id))
                self._latest_fix = fix, time.monotonic()
                self.count_message()
            elif isinstance(decoded, VelocitySample):
                velocity = self.restamp(decoded)
                self._velocities.publish(conversions.velocity(make, velocity, self.settings.frame_id))
            else:
                heading = self.restamp(decoded)
                self._headings.publish(conversions.heading(make, heading, self.settings.heading_frame_id))

    def _present_gga(self) -> bytes | None:
        """GGA sentence of the latest fix, for a caster; None if that is old."""
        if self._latest_fix is None or time.monotonic() - self._latest_fix[1] > _POSITION_AGE:
            return None
        fix, _ = self._latest_fix
        altitude = fix.altitude if math.isfinite(fix.altitude) else 0.0
        return gga(Position(fix.stamp_ns, fix.latitude, fix.longitude, altitude, _QUALITY[fix.status]))


def main() -> None:
    """Entry point."""
    sys.exit(run(NmeaNode))
