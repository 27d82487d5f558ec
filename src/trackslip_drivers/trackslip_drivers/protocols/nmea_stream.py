# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decodes the bytes of a GNSS receiver to positions, velocities and headings with stamps and variances.

A receiver sends the sentences of one epoch in a burst. GGA, GST, RMC and PASHR contain the time of the epoch;
VTG, HDT and THS do not, and get the epoch of their burst. A fix waits for its GST if the previous GST came
after its fix. It is released by the next sentence of another epoch, or by silence. UBX messages may come
between sentences, or alone. A NAV-PVT waits for NAV-HPPOSLLH and NAV-COV of its epoch, if the previous one
had them. Of several messages with the same measurement of an epoch, one is used.
"""

import math
from collections.abc import Callable
from enum import Enum

from trackslip_common.tally import Tally
from trackslip_drivers.nmea_parameters import NmeaParameters
from trackslip_drivers.protocols import ubx
from trackslip_drivers.protocols.epoch_sources import EpochSource
from trackslip_drivers.protocols.gnss_frames import Frame, FrameSplitter, Kind
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
    read_sentence,
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
POSITIONS = frozenset(("GGA", "GNS", "NAV-PVT"))  # kinds of messages with a position
NO_POSITION = "switch GGA on at the receiver (UBX: NAV-PVT)"
RECEIVER_CLOCK = "receiver's clock"

_CLOCK_TOLERANCE = 5e-5  # relative, of a host's quartz
_PATIENCE = 300  # fixes
_BURST_GAP_NS = 10_000_000  # silence that ends a burst
_LONGEST_EPOCH_NS = 2_000_000_000  # for which a time may be stated: in a leap second, over a slow line
_GST_AGE_NS = 1_500_000_000  # greatest age of a GST used for a fix of the same quality
_DAY_NS = 86_400_000_000_000
_MIN_AGE_NS, _MAX_AGE_NS = -50_000_000, 1_000_000_000  # bounds on a sentence's age, if both clocks are on UTC

_MAX_KINDS = 64  # kinds of sentences that are distinguished
_ACCURACY_RANK = 2  # rank of a position that states its accuracy
_RECENT_NS = 2_000_000_000  # or two periods
_HEADINGS = ("HDT", "THS", "PASHR", "PTNL,AVR", "PSSN,HRP", "PSAT,HPR", "KSXT")
_TOPICS = {**dict.fromkeys(_HEADINGS, HEADING), "VTG": VELOCITY}

Sample = FixSample | HeadingSample | VelocitySample


class ClockEvent(Enum):
    """Fault of a time that the receiver states."""

    NOT_UTC = "not the host's UTC: latency assumed"
    UNCHANGED = "time of fixes does not advance"
    REPEATED = "several readings of one time"


class NmeaStream:
    """Decodes bytes to samples; counts everything else.

    Args:
        p: line rate, latency, and variances where the receiver states none.
        tally: counts rejections, and events of the receiver's clock.
        utc: time on the host's clock of a steady time, if the host's clock is kept on UTC.
    """

    def __init__(self, p: NmeaParameters, tally: Tally, utc: Callable[[int], int] | None = None) -> None:
        self.tally = tally
        self.unused_sentences = 0  # of unused kinds
        self.bytes_between_sentences = 0
        self.latency_ns = 0  # from the latest epoch to the first byte of its sentence
        self._p = p
        self._latency_ns = round(p.latency * 1e9)
        self._recent_ns = max(_RECENT_NS, round(2e9 / p.rate))
        self._gst_quality: int | None = None  # of the fix of the latest GST
        self._utc = utc
        self._frames = FrameSplitter(0 if "://" in p.serial_port else p.serial_baud)
        self._clock = SenderClock(_CLOCK_TOLERANCE, _PATIENCE)
        self._position, self._direction, self._speed = EpochSource(), EpochSource(), EpochSource()
        self._sources = (self._position, self._direction, self._speed)
        self._kinds: dict[str, int] = {}  # kind of sentence → end of the latest one
        self.reset()

    @property
    def bytes_held(self) -> int:
        """Number of bytes of the incomplete message."""
        return self._frames.bytes_held

    @property
    def duplicates(self) -> int:
        """Measurements dropped as duplicates of an epoch."""
        return sum(source.duplicates for source in self._sources)

    @property
    def duplicates_of_same_kind(self) -> int:
        """Duplicates from the same kind of message."""
        return sum(source.duplicates_of_same_kind for source in self._sources)

    @property
    def all_kinds(self) -> list[str]:
        """Kinds of complete sentences received."""
        return sorted(self._kinds)

    @property
    def kinds(self) -> list[str]:
        """Those of them received recently."""
        latest_ns = self._burst_end_ns or 0
        return [kind for kind in self.all_kinds if latest_ns - self._kinds[kind] <= self._recent_ns]

    def reset(self) -> None:
        """Drop incomplete messages and all memory of earlier ones: the port was reopened."""
        self._frames.reset()
        self._clock.restart()
        for source in self._sources:
            source.reset()
        self._kinds.clear()
        self._burst_ns: int | None = None  # epoch of the present burst
        self._burst_begun_ns = 0
        self._burst_end_ns: int | None = None
        self._latest_position: tuple[Gga, int] | None = None  # latest position, and its stamp
        self._has_fix = True  # until a sentence states otherwise
        self._gst: tuple[Gst, int] | None = None
        self._gst_follows = False
        self._is_waiting = False  # whether the latest position waits for its GST
        self._pvt: tuple[ubx.Pvt, int, int] | None = None  # UBX position, its stamp, its arrival
        self._pvt_parts: set[str] = set()  # messages received for it
        self._pvt_follow: set[str] = set()  # messages received for the previous one
        self._pvt_out_ns = -1  # time of the latest one released

    def feed(self, data: bytes, arrival_ns: int) -> list[Sample]:
        """The samples completed by one read, whose last byte arrived by ``arrival_ns``."""
        return [
            sample for frame in self._frames.feed(data, arrival_ns) for sample in self._decode_frame(frame)
        ]

    def _decode_frame(self, frame: Frame) -> list[Sample]:
        if self._burst_end_ns is None or frame.begun_ns - self._burst_end_ns > _BURST_GAP_NS:
            self._burst_ns, self._burst_begun_ns = None, frame.begun_ns
        self._burst_end_ns = frame.ended_ns
        if frame.kind is Kind.SENTENCE:
            return self._on_sentence(read_sentence(frame.content), frame)
        if frame.kind is Kind.UBX:
            self._note_kind(ubx.name_of(frame.content), frame.ended_ns)
        if frame.kind is Kind.UBX and (kind := ubx.kind_of(frame.content)):
            return self._on_ubx(ubx.decode(frame.content), kind, frame.begun_ns)
        if frame.kind is Kind.OVERLONG:
            self.tally.add(FIX, Rejection.OVERLONG)
        else:
            self.bytes_between_sentences += len(frame.content)
            self.tally.add(FIX, Rejection.CHECKSUM, ubx.count_damaged(frame.content))
        return []

    def _note_kind(self, kind: str, ended_ns: int) -> None:
        if len(self._kinds) < _MAX_KINDS or kind in self._kinds:
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
            samples, stamp_ns = self._release_pvt(), self._stamp(reading.time_ns, begun_ns)
            if self._is_old(reading.time_ns):
                return samples
            samples += self._on_velocity(reading.velocity, "UBX", begun_ns)
            self._pvt = reading, stamp_ns, begun_ns
            self._pvt_parts = set()
        elif self._pvt is None or self._pvt[0].time_ns != reading.time_ns:
            if reading.time_ns == self._pvt_out_ns:  # too late for its position; the next one waits
                self._pvt_follow.add(kind)
            return []
        else:
            samples, (pvt, stamp_ns, arrival_ns) = [], self._pvt
            fields = reading._asdict()
            if isinstance(reading, ubx.FinePosition) and "NAV-COV" in self._pvt_parts:
                del fields["stddevs"]
            self._pvt = pvt._replace(**fields), stamp_ns, arrival_ns
            self._pvt_parts.add(kind)
        return samples + (self._pvt_samples() if self._pvt_follow <= self._pvt_parts else [])

    def _release_pvt(self) -> list[Sample]:
        """The UBX position that waits for other messages, which have not come."""
        if self._pvt is None:
            return []
        self._pvt_follow = set(self._pvt_parts)
        return self._pvt_samples()

    def _pvt_samples(self) -> list[Sample]:
        assert self._pvt is not None
        (self._pvt_out_ns, *place, quality, stddevs, _), stamp_ns, begun_ns = self._pvt
        self._pvt = None
        if not self._is_first(FIX, self._position, "UBX", _ACCURACY_RANK, stamp_ns, begun_ns):
            return []
        variances, kind = _stated_variances(stddevs)
        latitude, longitude, altitude = place
        return [
            FixSample(stamp_ns, latitude, longitude, altitude, STATUS_OF_QUALITY[quality], variances, kind)
        ]

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
            self.unused_sentences += 1
            return []
        return self._on_reading(reading, talker + kind, frame.begun_ns)

    def flush(self) -> list[Sample]:
        """The samples that still wait, after the line fell silent; an incomplete message ends."""
        samples = [sample for frame in self._frames.split_pending() for sample in self._decode_frame(frame)]
        return samples + self._release_position() + self._release_pvt()

    def _release_position(self) -> list[Sample]:
        """The position whose GST has not come: the line is silent, or another epoch has begun."""
        if not self._is_waiting:
            return []
        self._gst_follows = False
        return self._position_samples()

    def _on_reading(self, reading: Reading, source: str, begun_ns: int) -> list[Sample]:
        if isinstance(reading, Velocity):
            return self._on_velocity(reading, source, begun_ns)
        stamp_ns = self._stamp(reading.time_ns, begun_ns)
        if self._is_old(reading.time_ns):
            return []
        if isinstance(reading, Heading):
            if not self._is_first(HEADING, self._direction, source, reading.stddev > 0.0, stamp_ns, begun_ns):
                return []
            return [HeadingSample(stamp_ns, reading.yaw, reading.stddev or self._p.heading_stddev)]
        if isinstance(reading, Gga) and not self._is_first(
            FIX, self._position, source, 0, stamp_ns, begun_ns
        ):
            return []
        if isinstance(reading, Gst):
            return self._on_gst(reading, stamp_ns)
        is_next = self._latest_position is None or reading.time_ns != self._latest_position[0].time_ns
        samples = self._release_position() if is_next or isinstance(reading, Gga) else []
        if isinstance(reading, Gga):
            self._latest_position, self._is_waiting = (reading, stamp_ns), True
            if not self._gst_follows or reading.time_ns is None or self._has_gst(reading):
                samples += self._position_samples()
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
        if not self._is_first(VELOCITY, self._speed, source, rank, stamp_ns, begun_ns):
            return []
        stddev = reading.stddev or self._p.velocity_stddev
        return [
            VelocitySample(
                stamp_ns, reading.east, reading.north, math.hypot(stddev, reading.speed_without_course)
            )
        ]

    def _on_gst(self, gst: Gst, stamp_ns: int) -> list[Sample]:
        self._gst = gst, stamp_ns
        if self._latest_position is None or gst.time_ns != self._latest_position[0].time_ns:
            return self._release_position()
        self._gst_follows, self._gst_quality = True, self._latest_position[0].quality
        return self._position_samples() if self._is_waiting else []

    def _has_gst(self, gga: Gga) -> bool:
        """Whether the GST of the same epoch has come."""
        return self._gst is not None and self._gst[0].time_ns == gga.time_ns is not None

    def _position_samples(self) -> list[Sample]:
        """The latest position with its variances."""
        assert self._latest_position is not None
        gga, stamp_ns = self._latest_position
        self._is_waiting = False
        if self._has_gst(gga):
            self._gst_quality = gga.quality
        variances, kind = self._variances(gga, stamp_ns)
        return [FixSample(stamp_ns, *gga[1:4], gga.status, variances, kind)]

    def _variances(self, gga: Gga, stamp_ns: int) -> tuple[Vector, CovarianceType]:
        """(variances east, north, up in m², their origin)."""
        if self._gst is not None and gga.quality == self._gst_quality:
            gst, gst_ns = self._gst
            variances, kind = _stated_variances(gst[1:])
            if kind is CovarianceType.DIAGONAL_KNOWN and abs(stamp_ns - gst_ns) <= _GST_AGE_NS:
                return variances, kind
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
        """The stamp of a reading on the steady clock, ns."""
        if stated_ns is not None:
            self._burst_ns = self._epoch(stated_ns, begun_ns)
            self.latency_ns = begun_ns - self._burst_ns
        moment_ns = begun_ns - self._latency_ns if self._burst_ns is None else self._burst_ns
        return moment_ns + round(self._p.time_offset * 1e9)

    def _is_first(
        self, topic: str, of: EpochSource, name: str, rank: int, stamp_ns: int, begun_ns: int
    ) -> bool:
        """Whether a reading is the used one of its epoch; a repetition in a later burst is counted."""
        before, last_ns = of.duplicates_of_same_kind, of.arrival_ns
        is_first = of.accept(name, rank, stamp_ns, begun_ns)
        if of.duplicates_of_same_kind > before and last_ns < self._burst_begun_ns:
            self.tally.add(topic, ClockEvent.REPEATED)
        return is_first

    def _is_old(self, stated_ns: int | None) -> bool:
        """Whether the receiver repeats a reading of this time, which is counted."""
        is_old = stated_ns is not None and self._clock.unchanged_ns > _LONGEST_EPOCH_NS
        self.tally.add(RECEIVER_CLOCK, ClockEvent.UNCHANGED, int(is_old))
        return is_old

    def _epoch(self, stated_ns: int, begun_ns: int) -> int:
        """Steady time of the epoch that the receiver states, ns."""
        first_byte_ns = self._clock.filter(begun_ns, stated_ns)
        if self._utc is not None:
            late_ns = (self._utc(begun_ns) - stated_ns + _DAY_NS // 2) % _DAY_NS - _DAY_NS // 2
            if _MIN_AGE_NS <= late_ns <= _MAX_AGE_NS:
                return begun_ns - late_ns
            self.tally.add(RECEIVER_CLOCK, ClockEvent.NOT_UTC)
        return first_byte_ns - self._latency_ns


def _stated_variances(stddevs: ubx.Stddevs) -> tuple[Vector, CovarianceType]:
    """Variances of a receiver's standard deviations; a height without one is twice as uncertain."""
    east, north, up = stddevs
    if math.isnan(east) or math.isnan(north):
        return (0.0, 0.0, 0.0), CovarianceType.UNKNOWN
    up = 2.0 * max(east, north) if math.isnan(up) else up
    return (east**2, north**2, up**2), CovarianceType.DIAGONAL_KNOWN
