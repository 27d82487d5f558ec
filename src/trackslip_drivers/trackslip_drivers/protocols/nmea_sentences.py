# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""NMEA 0183 sentences as a receiver sends them, for the emulator and tests."""

import math
from typing import NamedTuple

from pynmeagps.nmeahelpers import calc_checksum

_DAY_NS = 86_400_000_000_000
_NS_PER_CENTISECOND = 10_000_000


class Position(NamedTuple):
    """A receiver's data of one epoch; without a fix ``quality`` is 0 and the rest has no meaning."""

    time_ns: int | None  # UTC, of any day; None: the clock is not set
    latitude: float = 0.0  # °
    longitude: float = 0.0  # °
    altitude: float = 0.0  # m above the ellipsoid
    quality: int = 0
    hdop: float = 0.6  # 1
    stddev: float = 0.0  # m, east and north
    up_stddev: float = 0.0  # m
    heading: float | None = None  # ° clockwise from true north
    heading_stddev: float = 0.0  # °
    speed: float | None = None  # m/s, horizontal
    course: float = 0.0  # ° clockwise from true north


def sentence(content: str) -> bytes:
    """The content with ``$``, checksum and line end."""
    return f"${content}*{calc_checksum(content)}\r\n".encode("ascii")


def gga(position: Position, geoid: float = 20.0) -> bytes:
    """GGA: position; minutes have 7 decimals, 0.2 mm."""
    time = _time(position.time_ns)
    if position.quality == 0:
        return sentence(f"GNGGA,{time},,,,,0,00,99.9,,,,,,")
    north, east = _angle(position.latitude, 2, "NS"), _angle(position.longitude, 3, "EW")
    height = f"{position.altitude - geoid:.4f},M,{geoid:.4f},M"
    return sentence(
        f"GNGGA,{time},{north},{east},{position.quality},18,{position.hdop:.1f},{height},1.0,0000"
    )


def gst(position: Position) -> bytes:
    """GST: standard deviations."""
    if position.quality == 0:
        return sentence(f"GNGST,{_time(position.time_ns)},,,,,,,")
    both = f"{position.stddev:.4f},{position.stddev:.4f}"
    return sentence(
        f"GNGST,{_time(position.time_ns)},{position.stddev:.4f},{both},0.0,{both},{position.up_stddev:.4f}"
    )


def rmc(position: Position) -> bytes:
    """RMC: validity of the position, speed in knots and course; without a date."""
    if position.quality == 0:
        return sentence(f"GNRMC,{_time(position.time_ns)},V,,,,,,,,,,N,V")
    north, east = _angle(position.latitude, 2, "NS"), _angle(position.longitude, 3, "EW")
    motion = (
        "," if position.speed is None else f"{position.speed * 3600.0 / 1852.0:.3f},{position.course:.2f}"
    )
    return sentence(f"GNRMC,{_time(position.time_ns)},A,{north},{east},{motion},,,,R,V")


def pashr(position: Position) -> bytes:
    """PASHR: heading with accuracy."""
    if position.heading is None:
        return sentence(f"PASHR,{_time(position.time_ns)},,T,,,,,,,{position.quality},0")
    angles = f"{position.heading:.4f},T,+0.00,+0.00,+0.00,0.100,0.100,{position.heading_stddev:.4f}"
    return sentence(f"PASHR,{_time(position.time_ns)},{angles},{position.quality},0")


def _time(time_ns: int | None) -> str:
    """hhmmss.ss; empty if unknown."""
    if time_ns is None:
        return ""
    seconds, centiseconds = divmod(time_ns % _DAY_NS // _NS_PER_CENTISECOND, 100)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:02d}{minutes:02d}{seconds:02d}.{centiseconds:02d}"


def _angle(degrees: float, digits: int, letters: str) -> str:
    """Degrees and minutes as NMEA writes them, with the letter of the side."""
    units = round(abs(degrees) * 60e7)
    whole, minutes = divmod(units, 60 * 10**7)
    letter = letters[math.copysign(1.0, degrees) < 0.0]
    return f"{whole:0{digits}d}{minutes // 10**7:02d}.{minutes % 10**7:07d},{letter}"
