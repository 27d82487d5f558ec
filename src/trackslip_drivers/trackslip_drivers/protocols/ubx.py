# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""UBX messages of u-blox receivers: NAV-PVT, NAV-HPPOSLLH, NAV-COV and NAV-RELPOSNED, parsed by pyubx2.

    NAV-PVT         position, its quality and accuracy, velocity
    NAV-HPPOSLLH    the same position, and its accuracy, to 0.1 mm
    NAV-COV         covariance of the position, north, east, down
    NAV-RELPOSNED   vector from the moving base to the rover: the heading of an antenna pair

A message is accepted, or has a reason for its rejection; other messages are ignored.
"""

import math
import re
from typing import Any, NamedTuple

from pyubx2 import UBX_MSGIDS, UBXReader

from trackslip_drivers.protocols.nmea import (
    MAX_ALTITUDE,
    MAX_SPEED,
    MAX_STDDEV,
    RTK_FIXED,
    RTK_FLOAT,
    Heading,
    Rejection,
    Velocity,
    heading_stddev,
    make_heading,
)

_MM = 1e-3
_MAX_SPEED_STDDEV = 10.0  # m/s
_LEAP_MS = 18_000  # GPS ahead of UTC since 2017
_DAY_MS = 86_400_000
_NAV = 0x01
_KINDS = {0x07: "NAV-PVT", 0x14: "NAV-HPPOSLLH", 0x36: "NAV-COV", 0x3C: "NAV-RELPOSNED"}
_BEGIN = re.compile(rb"\xb5\x62\x01[\x07\x14\x36\x3c]")  # of the messages above
_DEAD_RECKONING, _TWO_D, _THREE_D, _COMBINED = 1, 2, 3, 4  # types of a fix
_FIXED_AMBIGUITIES = 2  # carrier-phase ambiguities; 1: float

Stddevs = tuple[float, float, float]  # m, east, north, up; nan: unknown


class Pvt(NamedTuple):
    """Position with quality, accuracy and velocity."""

    time_ns: int  # of day, UTC
    latitude: float  # °, north
    longitude: float  # °, east
    altitude: float  # m above the ellipsoid; nan: unknown
    quality: int  # as in GGA
    stddevs: Stddevs
    velocity: Velocity | Rejection


class FinePosition(NamedTuple):
    """The position of the Pvt of the same epoch, to 0.1 mm."""

    time_ns: int
    latitude: float
    longitude: float
    altitude: float
    stddevs: Stddevs


class Accuracy(NamedTuple):
    """Standard deviations of the position of the same epoch."""

    time_ns: int
    stddevs: Stddevs


Reading = Pvt | FinePosition | Accuracy | Heading


def kind_of(frame: bytes) -> str:
    """Name of a complete frame's message; empty for unused ones."""
    return _KINDS.get(frame[3], "") if frame[2] == _NAV else ""


def name_of(frame: bytes) -> str:
    """Name of any complete frame's message."""
    return str(UBX_MSGIDS.get(frame[2:4], "UBX"))


def count_damaged(noise: bytes) -> int:
    """Number of used messages that begin in bytes between complete messages: they are cut or changed."""
    return len(_BEGIN.findall(noise))


def decode(frame: bytes) -> Reading | Rejection | None:
    """Decode a complete frame with a correct checksum; None for unused messages."""
    kind = kind_of(frame)
    if not kind:
        return None
    try:
        return _DECODERS[kind](UBXReader.parse(frame))
    except Exception:  # noqa: BLE001 (whatever the library raises of a message of the wrong length)
        return Rejection.MALFORMED


def _pvt(message: Any) -> Reading | Rejection:
    if not message.gnssFixOk or message.fixType not in (_TWO_D, _THREE_D, _COMBINED):
        return Rejection.DEAD_RECKONING if message.fixType == _DEAD_RECKONING else Rejection.NO_FIX
    if message.invalidLlh:
        return Rejection.NO_FIX
    quality = {_FIXED_AMBIGUITIES: RTK_FIXED, 1: RTK_FLOAT}.get(
        message.carrSoln, 2 if message.diffSoln else 1
    )
    altitude = math.nan if message.fixType == _TWO_D else message.height * _MM
    if (rejection := _position_rejection(message, altitude)) is not None:
        return rejection
    place = message.lat, message.lon, altitude
    return Pvt(_time_ns(message.iTOW), *place, quality, _accuracy(message), _velocity(message))


def _velocity(message: Any) -> Velocity | Rejection:
    """The velocity; an accuracy of 0 means unknown."""
    east, north, stddev = message.velE * _MM, message.velN * _MM, message.sAcc * _MM
    if math.hypot(east, north) >= MAX_SPEED or stddev >= _MAX_SPEED_STDDEV:
        return Rejection.OUT_OF_RANGE
    return Velocity(_time_ns(message.iTOW), east, north, stddev)


def _fine_position(message: Any) -> Reading | Rejection:
    if message.invalidLlh:
        return Rejection.NO_FIX
    altitude = message.height * _MM
    rejection = _position_rejection(message, altitude)
    return rejection or FinePosition(
        _time_ns(message.iTOW), message.lat, message.lon, altitude, _accuracy(message)
    )


def _covariance(message: Any) -> Reading | Rejection:
    if not message.posCovValid:
        return Rejection.NO_FIX
    variances = (message.posCovEE, message.posCovNN, message.posCovDD)
    if not all(0.0 < variance < MAX_STDDEV**2 for variance in variances):
        return Rejection.OUT_OF_RANGE
    east, north, up = map(math.sqrt, variances)
    return Accuracy(_time_ns(message.iTOW), (east, north, up))


def _moving_base_heading(message: Any) -> Reading | Rejection:
    if not message.gnssFixOK:
        return Rejection.NO_FIX
    if not (message.relPosValid and getattr(message, "relPosHeadingValid", 0)):
        return Rejection.NO_HEADING
    if not message.isMoving:
        return Rejection.NO_PAIR
    if message.carrSoln != _FIXED_AMBIGUITIES:
        return Rejection.NOT_FIXED
    stddev = heading_stddev(message.accHeading)
    return make_heading(_time_ns(message.iTOW), message.relPosHeading, stddev=stddev)


def _position_rejection(message: Any, altitude: float) -> Rejection | None:
    in_range = abs(message.lat) <= 90.0 and abs(message.lon) <= 180.0
    return None if in_range and not abs(altitude) > MAX_ALTITUDE else Rejection.OUT_OF_RANGE


def _accuracy(message: Any) -> Stddevs:
    """(east, north, up): hAcc for each horizontal axis, which is conservative; 0 means unknown."""
    horizontal, up = (
        value * _MM if 0.0 < value * _MM < MAX_STDDEV else math.nan for value in (message.hAcc, message.vAcc)
    )
    return horizontal, horizontal, up


def _time_ns(time_of_week_ms: int) -> int:
    """Time of day in UTC, ns."""
    return (time_of_week_ms - _LEAP_MS) % _DAY_MS * 1_000_000


_DECODERS = {
    "NAV-PVT": _pvt,
    "NAV-HPPOSLLH": _fine_position,
    "NAV-COV": _covariance,
    "NAV-RELPOSNED": _moving_base_heading,
}
