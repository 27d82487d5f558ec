# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""NMEA 0183 sentences of GNSS receivers: positions, their accuracy, velocities, headings.

    $GNGGA,101530.20,3352.1234567,S,15112.7654321,E,4,18,0.6,41.20,M,22.10,M,1.0,0021*5C

    u     time of day stated by the receiver, UTC                                       ns
    h     heading of the antenna pair, clockwise from true north                      °
    ψ     the same heading, counter-clockwise from east: ψ = 90° − h                  rad

pynmeagps reads the fields. Checksums, validity fields, ranges and empty fields are checked here. Angles and
times, whose width varies between makes, are parsed here. A sentence is accepted, or has a reason for its
rejection; unused kinds are ignored.
"""

import math
import re
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, NamedTuple

from pynmeagps import VALNONE, NMEAReader
from pynmeagps.nmeahelpers import calc_checksum

from trackslip_common.units import NS_PER_S
from trackslip_drivers.records import FixStatus

BITS_PER_CHAR = 10  # 8N1
LONGEST_LINE = 512  # bytes; 82 by the standard, which proprietary sentences exceed

RTK_FIXED, RTK_FLOAT = 4, 5  # quality of a fix
STATUS_OF_QUALITY = {
    1: FixStatus.SINGLE,
    2: FixStatus.DIFFERENTIAL,
    3: FixStatus.SINGLE,  # the military code
    RTK_FIXED: FixStatus.RTK,
    RTK_FLOAT: FixStatus.RTK,
    9: FixStatus.DIFFERENTIAL,  # corrections by satellite, of one make
}
_NO_FIX, _DEAD_RECKONING = 0, 6
_QUALITY_OF_MODE = {"N": 0, "A": 1, "D": 2, "P": 2, "R": 4, "F": 5, "E": 6, "M": 7, "S": 8}  # of GNS
_QUALITIES_BEST_FIRST = (RTK_FIXED, RTK_FLOAT, 2, 1, 6, 7, 8)
MAX_STDDEV = 1e4  # m
MAX_ALTITUDE = 1e5  # m, largest magnitude of an altitude
MAX_SPEED = 100.0  # m/s
_MAX_SPEED_WITHOUT_COURSE = 0.2  # m/s, up to which receivers omit the course
_KNOT, _KM_PER_H = 1852.0 / 3600.0, 1.0 / 3.6  # m/s
_TIME = re.compile(r"(\d{1,6})(?:\.(\d*))?")  # hhmmss.s; some makes omit leading zeros
_CHECKSUM = re.compile(rb"\s*([0-9A-Fa-f]{2})(?![0-9A-Za-z])")
_ANGLE = re.compile(r"(\d{1,5})(?:\.(\d*))?")  # dddmm.m; some makes omit leading zeros


class Rejection(Enum):
    """Reason for the rejection of a sentence."""

    OVERLONG = "no line end"
    NOT_NMEA = "no sentence"
    NO_CHECKSUM = "no checksum"
    CHECKSUM = "wrong checksum"
    MALFORMED = "malformed field"
    OUT_OF_RANGE = "out of range"
    NOT_METRES = "altitude is not in metres"
    NO_FIX = "no fix"
    DEAD_RECKONING = "dead reckoning"
    NOT_MEASURED = "manual or simulated"
    NO_HEADING = "no heading"
    NO_VELOCITY = "no speed or course"
    NO_PAIR = "heading to a base that does not move along"
    NOT_FIXED = "ambiguities of the heading are not fixed"
    NOT_TRUE_NORTH = "heading is not from true north"
    WARNING = "receiver's warning"


class Gga(NamedTuple):
    """Position with its quality."""

    time_ns: int | None
    latitude: float  # °, north
    longitude: float  # °, east
    altitude: float  # m above the ellipsoid; nan: unknown
    quality: int
    hdop: float  # 1; nan: unknown

    @property
    def status(self) -> FixStatus:
        """Status of the quality."""
        return STATUS_OF_QUALITY[self.quality]


class Gst(NamedTuple):
    """Standard deviations of a position, m; nan: unknown."""

    time_ns: int | None
    east: float
    north: float
    up: float


class Velocity(NamedTuple):
    """Velocity of the antenna over the ground."""

    time_ns: int | None
    east: float  # m/s
    north: float
    stddev: float  # m/s, of each; 0: unknown
    speed_without_course: float = 0.0  # m/s, speed of unknown direction, not part of east and north


class Rmc(NamedTuple):
    """Validity of a position, and velocity of the antenna."""

    time_ns: int | None
    velocity: Velocity | Rejection | None = None  # None: absent from the sentence


class Heading(NamedTuple):
    """Heading of the antenna pair."""

    time_ns: int | None
    yaw: float  # rad, ψ
    stddev: float  # rad; 0: unknown
    needs_fix: bool = False  # the sentence has no validity field of its own


Reading = Gga | Gst | Rmc | Heading | Velocity


class Sentence(NamedTuple):
    """One line with a correct checksum."""

    talker: str  # GN, GP, …; P of proprietary sentences
    kind: str  # GGA, …; PASHR, PTNL,AVR, … of proprietary ones
    reading: Reading | Rejection | None  # None: an unused kind


def read_sentence(line: bytes) -> Sentence | Rejection:
    """Decode one line, from its ``$`` on, without its end; text after the checksum is ignored."""
    content, star, behind = line.rstrip(b"\r").removeprefix(b"$").partition(b"*")
    stated = _CHECKSUM.match(behind)
    checksum = stated[1].upper() if stated else b""
    fields = content.decode("latin-1").split(",")
    talker, kind = _address(fields)
    decoder = _DECODERS.get(kind)
    if decoder is None:
        return Sentence(talker, kind, None) if star and content.isascii() else Rejection.NOT_NMEA
    if not star:
        return Rejection.NO_CHECKSUM
    if checksum != calc_checksum(content.decode("latin-1")).encode():
        return Rejection.CHECKSUM
    try:
        reading = decoder(_parse_fields(content, checksum), fields[1:])
    except Exception:  # noqa: BLE001 (whatever the library raises of an empty or wrong field)
        reading = Rejection.MALFORMED
    return Sentence(talker, kind, reading)


def yaw_of_heading(heading: float) -> float:
    """ψ in (−π, π] of h in °."""
    return math.pi - math.radians((heading + 90.0) % 360.0)


def heading_of_yaw(yaw: float) -> float:
    """h in [0, 360) ° of ψ in rad."""
    return (90.0 - math.degrees(yaw)) % 360.0


def _address(fields: Sequence[str]) -> tuple[str, str]:
    """(talker, kind)."""
    address = fields[0]
    if address == "KSXT":
        return "", address
    if not address.startswith("P"):
        return address[:2], address[2:]
    named = len(fields) > 1 and fields[1][:1].isalpha()  # PASHR,POS and such
    return "P", f"{address},{fields[1]}" if named else address


def _parse_fields(content: bytes, checksum: bytes) -> Any:
    """The fields parsed by pynmeagps, which cannot parse a PASHR without a time."""
    if content.startswith(b"PASHR,,"):
        content = content.replace(b",,", b",000000.00,", 1)
    return NMEAReader.parse(b"$" + content + b"*" + checksum, validate=VALNONE)


def _gga(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    if {getattr(parsed, "altUnit", ""), getattr(parsed, "sepUnit", "")} - {"M", ""}:
        return _quality_rejection(parsed.quality) or Rejection.NOT_METRES
    return _position(parsed.quality, fields, parsed.HDOP, (parsed.alt, parsed.sep))


def _gns(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """GNS: the mode has one letter for each satellite system; the best of them is used.

    The status is S safe, C caution, U unsafe, or V of receivers that state none, which are most.
    """
    if fields[12:] and fields[12] == "U":
        return Rejection.WARNING
    qualities = [_QUALITY_OF_MODE[letter] for letter in fields[5]]
    quality = next((one for one in _QUALITIES_BEST_FIRST if one in qualities), _NO_FIX)
    return _position(quality, fields, fields[7], (fields[8], fields[9]))


def _quality_rejection(quality: Any) -> Rejection | None:
    if quality in ("", _NO_FIX):
        return Rejection.NO_FIX
    if quality not in STATUS_OF_QUALITY:
        return Rejection.DEAD_RECKONING if quality == _DEAD_RECKONING else Rejection.NOT_MEASURED
    return None


def _position(
    quality: Any, fields: Sequence[str], dilution: Any, heights: tuple[Any, Any]
) -> Reading | Rejection:
    """A position; ``fields``: time, latitude, longitude, …; ``heights``: over the geoid, and of that, m."""
    if (rejection := _quality_rejection(quality)) is not None:
        return rejection
    latitude, longitude = _angle(fields[1], fields[2], "NS", 90.0), _angle(fields[3], fields[4], "EW", 180.0)
    if math.isnan(latitude) or math.isnan(longitude):
        return Rejection.OUT_OF_RANGE
    altitude = sum(map(_number, heights))
    if abs(altitude) > MAX_ALTITUDE:
        return Rejection.OUT_OF_RANGE
    hdop = _number(dilution)
    time_ns = time_of_day_ns(fields[0])
    return Gga(time_ns, latitude, longitude, altitude, quality, hdop if hdop > 0.0 else math.nan)


def _gst(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """GST: a standard deviation of 0 is impossible, and counts as unknown."""
    stated = [_number(value) for value in (parsed.stdLong, parsed.stdLat, parsed.stdAlt)]
    if any(value < 0.0 or value >= MAX_STDDEV for value in stated):
        return Rejection.OUT_OF_RANGE
    east, north, up = (value or math.nan for value in stated)
    return Gst(time_of_day_ns(fields[0]), east, north, up)


def _rmc(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    if parsed.status != "A":
        return Rejection.WARNING
    time_ns, speed, course = time_of_day_ns(fields[0]), _number(fields[6]), _number(fields[7])
    velocity = None if math.isnan(speed) else _velocity(time_ns, speed * _KNOT, course)
    return _mode_rejection(getattr(parsed, "posMode", ""), Rejection.WARNING) or Rmc(time_ns, velocity)


def _vtg(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """VTG: course and speed; old receivers omit units and mode."""
    if len(fields) < 8 or fields[1] not in ("T", "") or fields[7] not in ("K", ""):
        return Rejection.MALFORMED
    speed, knots = _number(fields[6]) * _KM_PER_H, _number(fields[4]) * _KNOT
    if math.isnan(speed):
        speed = knots
    rejected = _mode_rejection(fields[8] if len(fields) > 8 else "", Rejection.WARNING)
    return rejected or _velocity(None, speed, _number(fields[0]))


def _velocity(time_ns: int | None, speed: float, course: float) -> Velocity | Rejection:
    """Velocity of a speed in m/s and a course in ° clockwise from true north; nan: unknown."""
    if math.isnan(speed) or (math.isnan(course) and speed > _MAX_SPEED_WITHOUT_COURSE):
        return Rejection.NO_VELOCITY
    if not 0.0 <= speed < MAX_SPEED or course < 0.0 or course > 360.0:
        return Rejection.OUT_OF_RANGE
    if math.isnan(course):
        return Velocity(time_ns, 0.0, 0.0, 0.0, speed)
    yaw = yaw_of_heading(course)
    return Velocity(time_ns, speed * math.cos(yaw), speed * math.sin(yaw), 0.0)


def _mode_rejection(mode: str, invalid: Rejection) -> Rejection | None:
    """Rejection by a mode: N, V invalid, E estimated, M manual, S simulated; None for any other."""
    reasons = {"N": invalid, "V": invalid, "E": Rejection.DEAD_RECKONING}
    return reasons.get(mode) or (Rejection.NOT_MEASURED if mode in ("M", "S") else None)


def _hdt(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    return make_heading(None, parsed.headingT, parsed.headingTu, needs_fix=True)


def _ths(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    if parsed.mi == "":
        return Rejection.NO_HEADING
    return _mode_rejection(parsed.mi, Rejection.NO_HEADING) or make_heading(None, parsed.headt)


def _pashr(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    if getattr(parsed, "gnssQual", "") == _NO_FIX:
        return Rejection.NO_FIX
    time_ns, stddev = time_of_day_ns(fields[0]), heading_stddev(parsed.hdgAcc)
    return make_heading(time_ns, parsed.trueHdg, parsed.trueHdgInd, stddev)


def _avr(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """Trimble: quality 3 is RTK fixed."""
    if parsed.gpsQual in ("", _NO_FIX):
        return Rejection.NO_FIX
    if parsed.gpsQual != 3:
        return Rejection.NOT_FIXED
    heading = parsed.yaw % 360.0 if -180.0 <= parsed.yaw < 0.0 else parsed.yaw
    return make_heading(time_of_day_ns(fields[1]), heading)


def _hrp(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """Septentrio: modes 2 and 4 have fixed ambiguities, 1 and 3 float ones."""
    if parsed.attmode in ("", "0"):
        return Rejection.NO_HEADING
    if parsed.attmode not in ("2", "4"):
        return Rejection.NOT_FIXED
    return make_heading(time_of_day_ns(fields[1]), parsed.hdg, stddev=heading_stddev(parsed.hdgstd))


def _hpr(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """Hemisphere: type N is by GNSS, G by the gyro alone."""
    if fields[2] == "":
        return Rejection.NO_HEADING
    if fields[5] != "N":
        return Rejection.DEAD_RECKONING if fields[5] == "G" else Rejection.NO_HEADING
    return make_heading(time_of_day_ns(fields[1]), float(fields[2]))


def _ksxt(parsed: Any, fields: Sequence[str]) -> Reading | Rejection:
    """Unicore: heading quality 3 is fixed, 0 none; a date precedes the time."""
    if fields[10] in ("", "0"):
        return Rejection.NO_HEADING
    if fields[10] != "3":
        return Rejection.NOT_FIXED
    return make_heading(time_of_day_ns(fields[0][8:]), float(fields[4]))


def make_heading(
    time_ns: int | None, heading: Any, reference: str = "T", stddev: float = 0.0, needs_fix: bool = False
) -> Heading | Rejection:
    """The reading of h in °; ``reference``: T for true north."""
    if heading == "":
        return Rejection.NO_HEADING
    if reference != "T":
        return Rejection.NOT_TRUE_NORTH
    if not 0.0 <= heading <= 360.0:
        return Rejection.OUT_OF_RANGE
    return Heading(time_ns, yaw_of_heading(heading), stddev, needs_fix)


def heading_stddev(degrees: Any) -> float:
    """Standard deviation of a heading, rad; 0 if unknown."""
    stddev = _number(degrees)
    return math.radians(stddev) if 0.0 < stddev < 180.0 else 0.0


_DECODERS: dict[str, Callable[[Any, Sequence[str]], Reading | Rejection]] = {
    "GGA": _gga,
    "GNS": _gns,
    "GST": _gst,
    "RMC": _rmc,
    "VTG": _vtg,
    "HDT": _hdt,
    "THS": _ths,
    "PASHR": _pashr,
    "PTNL,AVR": _avr,
    "PSSN,HRP": _hrp,
    "PSAT,HPR": _hpr,
    "KSXT": _ksxt,
}


def _number(value: Any) -> float:
    """The number of a field; nan if it is empty."""
    number = math.nan if value == "" else float(value)
    return number if math.isfinite(number) else math.nan


def _angle(text: str, letter: str, letters: str, limit: float) -> float:
    """Degrees of dddmm.m, positive for the first of ``letters``; nan if out of range."""
    match = _ANGLE.fullmatch(text)
    if match is None or len(letter) != 1 or letter not in letters:
        raise ValueError(text)
    whole_degrees, minutes = divmod(int(match[1]), 100)
    degrees = whole_degrees + float(f"{minutes}.{match[2] or 0}") / 60.0
    side = 1.0 if letter == letters[0] else -1.0
    return side * degrees if minutes < 60 and degrees <= limit else math.nan


def time_of_day_ns(text: str) -> int | None:
    """u; None if the receiver does not know it, or in the leap second itself.

    Raises:
        ValueError: the text is no time of day.
    """
    if text == "":
        return None
    match = _TIME.fullmatch(text)
    if match is None:
        raise ValueError(text)
    hours, minutes, seconds = int(match[1]) // 10000, int(match[1]) // 100 % 100, int(match[1]) % 100
    if hours > 23 or minutes > 59 or seconds > 60:
        raise ValueError(text)
    fraction_ns = int((match[2] or "")[:9].ljust(9, "0"))
    return None if seconds == 60 else ((hours * 60 + minutes) * 60 + seconds) * NS_PER_S + fraction_ns
