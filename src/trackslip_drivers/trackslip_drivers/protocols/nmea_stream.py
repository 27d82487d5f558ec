# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bytes of a GNSS receiver to positions, velocities and headings with stamps and variances.

A receiver states one moment, its epoch, in a burst of sentences. GGA, GST, RMC and PASHR hold the time of
the epoch; VTG, HDT and THS do not, and have that of the burst they come in. A fix waits for its GST where the
one before had its GST behind it; it is out with the next sentence of another epoch, or as the line falls
silent. UBX messages may come between sentences, or alone. A NAV-PVT waits for NAV-HPPOSLLH and NAV-COV of its
epoch, where the one before had them. Of several messages that state one measurement of an epoch, one is used.
"""

import math
from collections.abc import Callable
from enum import Enum

from trackslip_common.tally import Tally
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols import ubx
from trackslip_drivers.protocols.epoch_sources import EpochSource
from trackslip_drivers.protocols.gnss_frames import Frame, FrameCutter, Kind
from trackslip_drivers.protocols.nmea import (
    RTK_FIXED,
    STATUS_OF_QUALITY,
    Gga,
    Gst,
    Heading,
    Reading,
    Rejection,
    Rmc,
    Sentence,
    Velocity,
    read,
)
from trackslip_drivers.records import (
    CovarianceType,
    FixSample,
    FixStatus,
    HeadingSample,
    Vector,
    VelocitySample,
)
from trackslip_drivers.stamping import SenderClock

FIX, HEADING, VELOCITY = "fix", "heading", "fix_velocity"
POSITIONS = frozenset(("GGA", "GNS", "NAV-PVT"))  # kinds of messages that state one
NO_POSITION = "switch GGA on at the receiver (of UBX NAV-PVT)"
RECEIVER_CLOCK = "receiver's clock"

_CLOCK_TOLERANCE = 5e-5  # of a host's quartz
_PATIENCE = 300  # fixes
_BURST_GAP_NS = 10_000_000  # of silence that ends a burst
_GST_AGE_NS = 1_500_000_000  # of the oldest GST that a fix of the same quality may use
_DAY_NS = 86_400_000_000_000
_EARLY_NS, _LATE_NS = -50_000_000, 1_000_000_000  # an answer's age, if both clocks are on UTC

_MOST_KINDS = 64  # of sentences, that are told apart
_BY_ACCURACY = 2  # rank of a position that states its accuracy itself
_RECENT_NS = 10_000_000_000
_HEADINGS = ("HDT", "THS", "PASHR", "PTNL,AVR", "PSSN,HRP", "PSAT,HPR", "KSXT")
_TOPICS = {**dict.fromkeys(_HEADINGS, HEADING), "VTG": VELOCITY}
_REASONS = {Kind.TEXT: Rejection.NOT_NMEA, Kind.OVERLONG: Rejection.OVERLONG}

Sample = FixSample | HeadingSample | VelocitySample


class ClockEvent(Enum):
    """What is wrong with a time that the receiver states."""

    NOT_UTC = "not the host's UTC: latency assumed"


class NmeaStream:
    """Bytes in, samples out; everything else is counted.

    Args:
        p: line rate, latency, variances where the receiver states none.
        tally: counts what was rejected, and what its clock did.
        utc: time on the host's clock of a steady time, where that clock is kept on UTC.
    """

    def __init__(self, p: NmeaParameters, tally: Tally, utc: Callable[[int], int] | None = None) -> None:
        self.tally = tally
        self.others = 0  # sentences of kinds that are not used
        self.binary = 0  # bytes between sentences that are none
        self.latency_ns = 0  # from the latest epoch to the first byte of the sentence that stated it
        self._p = p
        self._latency_ns = round(p.latency * 1e9)
        self._gst_quality: int | None = None  # of the fix that the latest GST belonged to
        self._utc = utc
        self._frames = FrameCutter(0 if "://" in p.serial_port else p.serial_baud)
        self._clock = SenderClock(_CLOCK_TOLERANCE, _PATIENCE)
        self._position, self._direction, self._speed = EpochSource(), EpochSource(), EpochSource()
        self._kinds: dict[str, int] = {}  # kind of sentence → when the latest one ended
        self.reset()

    @property
    def bytes_held(self) -> int:
        """How many bytes wait for the rest of their message."""
        return self._frames.bytes_held

    @property
    def repeated(self) -> int:
        """Measurements that another message of the same epoch had stated."""
        return self._position.repeated + self._direction.repeated + self._speed.repeated

    @property
    def crowded(self) -> int:
        """Those of one kind of message that has come more than once in an epoch."""
        return self._position.crowded + self._direction.crowded + self._speed.crowded

    @property
    def kinds(self) -> list[str]:
        """Kinds of sentences that have come of late, whole."""
        latest_ns = max(self._kinds.values(), default=0)
        return sorted(kind for kind, ended_ns in self._kinds.items() if latest_ns - ended_ns <= _RECENT_NS)

    def reset(self) -> None:
        """Drop what was half received: the port was reopened."""
        self._frames.reset()
        self._clock.restart()
        self._position.reset()
        self._direction.reset()
        self._speed.reset()
        self._kinds.clear()
        self._burst_ns: int | None = None  # the epoch of this burst
        self._burst_end_ns: int | None = None
        self._last: tuple[Gga, int] | None = None  # the latest position, and its moment
        self._has_fix = True  # but for receivers that state otherwise
        self._gst: tuple[Gst, int] | None = None
        self._gst_follows = False
        self._waiting = False  # the latest position for its GST
        self._pvt: tuple[ubx.Pvt, int, int] | None = None  # of UBX: a position, its moment, its arrival
        self._pvt_parts: set[str] = set()  # messages that have come for it
        self._pvt_follow: set[str] = set()  # that came for the one before
        self._pvt_out_ns = -1  # time of the latest that is out

    def feed(self, data: bytes, arrival_ns: int) -> list[Sample]:
        """What one read returned, and when: its last byte was there by ``arrival_ns``."""
        return [sample for frame in self._frames.feed(data, arrival_ns) for sample in self._on_frame(frame)]

    def _on_frame(self, frame: Frame) -> list[Sample]:
        if self._burst_end_ns is None or frame.begun_ns - self._burst_end_ns > _BURST_GAP_NS:
            self._burst_ns = None
        self._burst_end_ns = frame.ended_ns
        if frame.kind is Kind.SENTENCE:
            return self._on_sentence(read(frame.content), frame)
        if frame.kind is Kind.UBX:
            self._note_kind(ubx.name_of(frame.content), frame.ended_ns)
        if frame.kind is Kind.UBX and (kind := ubx.kind_of(frame.content)):
            return self._on_ubx(ubx.decode(frame.content), kind, frame.begun_ns)
        if frame.kind in _REASONS:
            self.tally.add(FIX, _REASONS[frame.kind])
        else:
            self.binary += len(frame.content)
        return []

    def _note_kind(self, kind: str, ended_ns: int) -> None:
        if len(self._kinds) < _MOST_KINDS or kind in self._kinds:
            self._kinds[kind] = ended_ns

    def _on_ubx(self, reading: ubx.Reading | Rejection | None, kind: str, begun_ns: int) -> list[Sample]:
        if reading is None:
            return []
        if isinstance(reading, Rejection):
            self.tally.add(HEADING if kind == "NAV-RELPOSNED" else FIX, reading)
            return []
        if isinstance(reading, Heading):
            return self._on_reading(reading, kind, begun_ns)
        if isinstance(reading, ubx.Pvt):
            samples = self._release_pvt() + self._on_velocity(reading.velocity, "UBX", begun_ns)
            self._pvt = reading, self._stamp(reading.time_ns, begun_ns), begun_ns
            self._pvt_parts = set()
        elif self._pvt is None or self._pvt[0].time_ns != reading.time_ns:
            if reading.time_ns == self._pvt_out_ns:  # too late for it: the next one waits
                self._pvt_follow.add(kind)
            return []
        else:
            samples, (pvt, stamp_ns, arrival_ns) = [], self._pvt
            fields = reading._asdict()
            if isinstance(reading, ubx.FinePosition) and "NAV-COV" in self._pvt_parts:
                del fields["stddevs"]
            self._pvt = pvt._replace(**fields), stamp_ns, arrival_ns
            self._pvt_parts.add(kind)
        return samples + (self._pvt_out() if self._pvt_follow <= self._pvt_parts else [])

    def _release_pvt(self) -> list[Sample]:
        """The position of UBX whose other messages do not come."""
        if self._pvt is None:
            return []
        self._pvt_follow = set(self._pvt_parts)
        return self._pvt_out()

    def _pvt_out(self) -> list[Sample]:
        assert self._pvt is not None
        (self._pvt_out_ns, *place, quality, stddevs, _), stamp_ns, begun_ns = self._pvt
        self._pvt = None
        if not self._position.accept("UBX", _BY_ACCURACY, stamp_ns, begun_ns):
            return []
        east, north, up = stddevs
        kind = CovarianceType.UNKNOWN if math.isnan(east) else CovarianceType.DIAGONAL_KNOWN
        up = 2.0 * max(east, north) if math.isnan(up) else up
        known = (east**2, north**2, up**2) if kind is CovarianceType.DIAGONAL_KNOWN else (0.0, 0.0, 0.0)
        latitude, longitude, altitude = place
        return [FixSample(stamp_ns, latitude, longitude, altitude, STATUS_OF_QUALITY[quality], known, kind)]

    def _on_sentence(self, sentence: Sentence | Rejection, frame: Frame) -> list[Sample]:
        if isinstance(sentence, Rejection):
            self.tally.add(FIX, sentence)
            return []
        talker, kind, reading = sentence
        self._note_kind(kind, frame.ended_ns)
        if kind in ("GGA", "GNS"):
            self._has_fix = reading is not Rejection.NO_FIX
        if isinstance(reading, Heading) and reading.needs_fix and not self._has_fix:
            reading = Rejection.NO_FIX
        if isinstance(reading, Rejection):
            self.tally.add(_TOPICS.get(kind, FIX), reading)
            return []
        if reading is None:
            self.others += 1
            return []
        return self._on_reading(reading, talker + kind, frame.begun_ns)

    def flush(self) -> list[Sample]:
        """The line has fallen silent: what is pending goes on no more, and what still waits is out."""
        samples = [sample for frame in self._frames.resume() for sample in self._on_frame(frame)]
        return samples + self._release() + self._release_pvt()

    def _release(self) -> list[Sample]:
        """The position whose GST does not come: the line is silent, or goes on with another epoch."""
        if not self._waiting:
            return []
        self._gst_follows = False
        return self._out()

    def _on_reading(self, reading: Reading, source: str, begun_ns: int) -> list[Sample]:
        if isinstance(reading, Velocity):
            return self._on_velocity(reading, source, begun_ns)
        stamp_ns = self._stamp(reading.time_ns, begun_ns)
        if isinstance(reading, Heading):
            if not self._direction.accept(source, reading.stddev > 0.0, stamp_ns, begun_ns):
                return []
            return [HeadingSample(stamp_ns, reading.yaw, reading.stddev or self._p.heading_stddev)]
        if isinstance(reading, Gga) and not self._position.accept(source, 0, stamp_ns, begun_ns):
            return []
        if isinstance(reading, Gst):
            return self._on_gst(reading, stamp_ns)
        is_next = self._last is None or reading.time_ns != self._last[0].time_ns
        samples = self._release() if is_next or isinstance(reading, Gga) else []
        if isinstance(reading, Gga):
            self._last, self._waiting = (reading, stamp_ns), True
            if not self._gst_follows or reading.time_ns is None or self._has_gst(reading):
                samples += self._out()
        if isinstance(reading, Rmc):
            samples += self._on_velocity(reading.velocity, source, begun_ns)
        return samples

    def _on_velocity(self, reading: Velocity | Rejection | None, source: str, begun_ns: int) -> list[Sample]:
        if reading is None:
            return []
        if isinstance(reading, Rejection):
            self.tally.add(VELOCITY, reading)
            return []
        stamp_ns, rank = self._stamp(reading.time_ns, begun_ns), int(reading.stddev > 0.0)
        if not self._speed.accept(source, rank, stamp_ns, begun_ns):
            return []
        stddev = reading.stddev or self._p.velocity_stddev
        return [VelocitySample(stamp_ns, reading.east, reading.north, math.hypot(stddev, reading.unseen))]

    def _on_gst(self, gst: Gst, stamp_ns: int) -> list[Sample]:
        self._gst = gst, stamp_ns
        if self._last is None or gst.time_ns != self._last[0].time_ns:
            return self._release()
        self._gst_follows, self._gst_quality = True, self._last[0].quality
        return self._out() if self._waiting else []

    def _has_gst(self, gga: Gga) -> bool:
        """Whether the GST of its own epoch has come."""
        return self._gst is not None and self._gst[0].time_ns == gga.time_ns is not None

    def _out(self) -> list[Sample]:
        """The latest position, with the variances that are known of it."""
        assert self._last is not None
        gga, stamp_ns = self._last
        self._waiting = False
        if self._has_gst(gga):
            self._gst_quality = gga.quality
        variances, kind = self._variances(gga, stamp_ns)
        return [FixSample(stamp_ns, *gga[1:4], gga.status, variances, kind)]

    def _variances(self, gga: Gga, stamp_ns: int) -> tuple[Vector, CovarianceType]:
        """m², east, north, up, and what they are from."""
        if self._gst is not None and gga.quality == self._gst_quality:
            (_, east, north, up), gst_ns = self._gst
            if abs(stamp_ns - gst_ns) <= _GST_AGE_NS and not (math.isnan(east) or math.isnan(north)):
                up = 2.0 * max(east, north) if math.isnan(up) else up
                return (east**2, north**2, up**2), CovarianceType.DIAGONAL_KNOWN
        if math.isnan(gga.hdop):
            return (0.0, 0.0, 0.0), CovarianceType.UNKNOWN
        variance = (gga.hdop * self._range_error(gga)) ** 2 / 2.0
        return (variance, variance, 4.0 * variance), CovarianceType.APPROXIMATED

    def _range_error(self, gga: Gga) -> float:
        errors = self._p.range_errors
        if gga.status is FixStatus.RTK:
            return errors.rtk_fixed if gga.quality == RTK_FIXED else errors.rtk_float
        return errors.differential if gga.status is FixStatus.DIFFERENTIAL else errors.single

    def _stamp(self, stated_ns: int | None, begun_ns: int) -> int:
        """The moment of a reading, on the steady clock."""
        if stated_ns is not None:
            self._burst_ns = self._epoch(stated_ns, begun_ns)
            self.latency_ns = begun_ns - self._burst_ns
        moment_ns = begun_ns - self._latency_ns if self._burst_ns is None else self._burst_ns
        return moment_ns + round(self._p.time_offset * 1e9)

    def _epoch(self, stated_ns: int, begun_ns: int) -> int:
        """When it was at the receiver what it says it was."""
        first_byte_ns = self._clock.filter(begun_ns, stated_ns)
        if self._utc is not None:
            late_ns = (self._utc(begun_ns) - stated_ns + _DAY_NS // 2) % _DAY_NS - _DAY_NS // 2
            if _EARLY_NS <= late_ns <= _LATE_NS:
                return begun_ns - late_ns
            self.tally.add(RECEIVER_CLOCK, ClockEvent.NOT_UTC)
        return first_byte_ns - self._latency_ns
