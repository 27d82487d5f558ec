# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""NMEA 0183 sentences of GNSS receivers: what GGA, GST, RMC, HDT, THS and PASHR tell.

    $GNGGA,101530.20,3352.1234567,S,15112.7654321,E,4,18,0.6,41.20,M,22.10,M,1.0,0021*5C

    u     time of day that the receiver tells, UTC                                    ns
    h     heading of the pair of antennas, clockwise from true north                  °
    ψ     the same east = 0, counter-clockwise: ψ = 90° − h                           rad

Fields are read by pynmeagps; checksums, ranges and empty fields are checked here. A sentence is used or has a
reason why not; of kinds that are not asked for nothing is said.
"""

import math
from datetime import time
from enum import Enum
from typing import Any, NamedTuple

from pynmeagps import VALNONE, NMEAReader
from pynmeagps.nmeahelpers import calc_checksum

from trackslip_drivers.records import FixStatus

TERMINATOR = b"\n"
BITS_PER_CHAR = 10  # 8N1
LONGEST_LINE = 512  # bytes; 82 by the standard, which proprietary sentences exceed

RTK_FIXED, RTK_FLOAT = 4, 5  # quality of a fix
_STATUS_OF_QUALITY = {
    1: FixStatus.SINGLE,
    2: FixStatus.DIFFERENTIAL,
    3: FixStatus.SINGLE,  # the military code
    RTK_FIXED: FixStatus.RTK,
    RTK_FLOAT: FixStatus.RTK,
    9: FixStatus.DIFFERENTIAL,  # by satellite, as one make has it
}
_NO_FIX, _DEAD_RECKONING = 0, 6
_KINDS = ("GGA", "GST", "RMC", "HDT", "THS", "PASHR")
_WORST_STDDEV = 1e4  # m
_NS_PER_S = 1_000_000_000


class Rejection(Enum):
    """Why a sentence was not used."""

    OVERLONG = "no line end"
    NOT_NMEA = "no sentence"
    NO_CHECKSUM = "no checksum"
    CHECKSUM = "wrong checksum"
    MALFORMED = "malformed field"
    OUT_OF_RANGE = "out of range"
    NO_FIX = "no fix"
    DEAD_RECKONING = "dead reckoning"
    NOT_MEASURED = "manual or simulated position"
    NO_HEADING = "no heading"
    NOT_TRUE_NORTH = "heading is not from true north"
    WARNING = "receiver's warning"


class Gga(NamedTuple):
    """Position and how it was found."""

    time_ns: int | None
    latitude: float  # °, north
    longitude: float  # °, east
    altitude: float  # m above the ellipsoid; nan: unknown
    quality: int
    hdop: float  # 1; nan: unknown

    @property
    def status(self) -> FixStatus:
        """By its quality."""
        return _STATUS_OF_QUALITY[self.quality]


class Gst(NamedTuple):
    """Standard deviations of a position, m."""

    time_ns: int | None
    east: float
    north: float
    up: float  # nan: unknown


class Rmc(NamedTuple):
    """That the receiver finds its position valid."""

    time_ns: int | None


class Heading(NamedTuple):
    """Of the pair of antennas."""

    time_ns: int | None
    yaw: float  # rad, ψ
    stddev: float  # rad; 0: unknown


Reading = Gga | Gst | Rmc | Heading


def decode(line: bytes) -> Reading | Rejection | None:
    """What one line tells, without its end; None for a kind of sentence that is not asked for.

    What comes before the last ``$`` is noise, or a binary message on the same line.
    """
    _, start, content = line.rstrip(b"\r").rpartition(b"$")
    if not start:
        return Rejection.NOT_NMEA
    content, star, checksum = content.partition(b"*")
    address = content.partition(b",")[0].decode("latin-1")
    kind = address if address.startswith("P") else address[2:]
    if kind not in _KINDS or (content.startswith(b"PASHR,") and content[6:7].isalpha()):  # PASHR,POS and such
        return None if star and content.isascii() else Rejection.NOT_NMEA
    if not star:
        return Rejection.NO_CHECKSUM
    if checksum.strip().upper() != calc_checksum(content.decode("latin-1")).encode():
        return Rejection.CHECKSUM
    try:
        found = NMEAReader.parse(b"$" + content + b"*" + checksum, validate=VALNONE)
        return _DECODERS[kind](found)
    except Exception:  # noqa: BLE001 (whatever the library raises of an empty or wrong field)
        return Rejection.MALFORMED


def yaw_of_heading(heading: float) -> float:
    """ψ of h in °; in (−π, π]."""
    return math.pi - math.radians((heading + 90.0) % 360.0)


def heading_of_yaw(yaw: float) -> float:
    """h of ψ in rad; in [0, 360) °."""
    return (90.0 - math.degrees(yaw)) % 360.0


def _gga(found: Any) -> Reading | Rejection:
    quality = found.quality
    if quality in ("", _NO_FIX):
        return Rejection.NO_FIX
    if quality not in _STATUS_OF_QUALITY:
        return Rejection.DEAD_RECKONING if quality == _DEAD_RECKONING else Rejection.NOT_MEASURED
    if found.NS not in ("N", "S") or found.EW not in ("E", "W"):
        return Rejection.MALFORMED
    latitude, longitude = float(found.lat), float(found.lon)
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        return Rejection.OUT_OF_RANGE
    altitude = _number(found.alt) + _number(found.sep)
    hdop = _number(found.HDOP)
    return Gga(_time_ns(found.time), latitude, longitude, altitude, quality, hdop if hdop > 0.0 else math.nan)


def _gst(found: Any) -> Reading | Rejection:
    east, north, up = (_number(value) for value in (found.stdLong, found.stdLat, found.stdAlt))
    if not (0.0 < east < _WORST_STDDEV and 0.0 < north < _WORST_STDDEV):
        return Rejection.OUT_OF_RANGE
    return Gst(_time_ns(found.time), east, north, up if 0.0 < up < _WORST_STDDEV else math.nan)


def _rmc(found: Any) -> Reading | Rejection:
    return Rmc(_time_ns(found.time)) if found.status == "A" else Rejection.WARNING


def _hdt(found: Any) -> Reading | Rejection:
    return _heading(None, found.headingT, found.headingTu, 0.0)


def _ths(found: Any) -> Reading | Rejection:
    """Mode A is measured; others are estimated, manual, simulated or invalid."""
    if found.mi != "A":
        return Rejection.NO_HEADING if found.mi in ("V", "") else Rejection.NOT_MEASURED
    return _heading(None, found.headt, "T", 0.0)


def _pashr(found: Any) -> Reading | Rejection:
    stddev = _number(found.hdgAcc)
    known = 0.0 < stddev < 180.0
    return _heading(found.utctime, found.trueHdg, found.trueHdgInd, math.radians(stddev) if known else 0.0)


def _heading(of_day: Any, heading: Any, reference: Any, stddev: float) -> Reading | Rejection:
    if heading == "":
        return Rejection.NO_HEADING
    if reference != "T":
        return Rejection.NOT_TRUE_NORTH
    if not 0.0 <= heading <= 360.0:
        return Rejection.OUT_OF_RANGE
    return Heading(_time_ns(of_day), yaw_of_heading(heading), stddev)


_DECODERS = {"GGA": _gga, "GST": _gst, "RMC": _rmc, "HDT": _hdt, "THS": _ths, "PASHR": _pashr}


def _number(value: Any) -> float:
    """nan for an empty field."""
    number = math.nan if value == "" else float(value)
    return number if math.isfinite(number) else math.nan


def _time_ns(of_day: Any) -> int | None:
    """u; None where the receiver does not know it, or in the leap second itself."""
    if not isinstance(of_day, time):
        return None
    seconds = (of_day.hour * 60 + of_day.minute) * 60 + of_day.second
    return seconds * _NS_PER_S + of_day.microsecond * 1000
