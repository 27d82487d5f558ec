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
from typing import Any, NamedTuple

from pyubx2 import UBX_MSGIDS, UBXReader

from trackslip_drivers.protocols.nmea import (
    RTK_FIXED,
    RTK_FLOAT,
    Heading,
    Rejection,
    Velocity,
    yaw_of_heading,
)

_MM = 1e-3
_MAX_STDDEV = 1e4  # m
_MAX_SPEED, _MAX_SPEED_STDDEV = 100.0, 10.0  # m/s, and of its standard deviation
_LEAP_MS = 18_000  # GPS ahead of UTC since 2017
_DAY_MS = 86_400_000
_NAV = 0x01
_KINDS = {0x07: "NAV-PVT", 0x14: "NAV-HPPOSLLH", 0x36: "NAV-COV", 0x3C: "NAV-RELPOSNED"}
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


def decode(frame: bytes) -> Reading | Rejection | None:
    """Decode a complete frame with a correct checksum; None for unused messages."""
    kind = kind_of(frame)
    if not kind:
        return None
    try:
        found = UBXReader.parse(frame)
        return _DECODERS[kind](found)
    except Exception:  # noqa: BLE001 (whatever the library raises of a message of the wrong length)
        return Rejection.MALFORMED


def _pvt(found: Any) -> Reading | Rejection:
    if not found.gnssFixOk or found.fixType not in (_TWO_D, _THREE_D, _COMBINED):
        return Rejection.DEAD_RECKONING if found.fixType == _DEAD_RECKONING else Rejection.NO_FIX
    if found.invalidLlh:
        return Rejection.NO_FIX
    quality = {_FIXED_AMBIGUITIES: RTK_FIXED, 1: RTK_FLOAT}.get(found.carrSoln, 2 if found.diffSoln else 1)
    altitude = math.nan if found.fixType == _TWO_D else found.height * _MM
    if (rejection := _position_rejection(found, altitude)) is not None:
        return rejection
    place = found.lat, found.lon, altitude
    return Pvt(_time_ns(found.iTOW), *place, quality, _accuracy(found), _velocity(found))


def _velocity(found: Any) -> Velocity | Rejection:
    """The velocity; an accuracy of 0 means unknown."""
    east, north, stddev = found.velE * _MM, found.velN * _MM, found.sAcc * _MM
    if math.hypot(east, north) >= _MAX_SPEED or stddev >= _MAX_SPEED_STDDEV:
        return Rejection.OUT_OF_RANGE
    return Velocity(_time_ns(found.iTOW), east, north, stddev)


def _fine_position(found: Any) -> Reading | Rejection:
    if found.invalidLlh:
        return Rejection.NO_FIX
    altitude = found.height * _MM
    rejection = _position_rejection(found, altitude)
    return rejection or FinePosition(_time_ns(found.iTOW), found.lat, found.lon, altitude, _accuracy(found))


def _covariance(found: Any) -> Reading | Rejection:
    if not found.posCovValid:
        return Rejection.NO_FIX
    variances = (found.posCovEE, found.posCovNN, found.posCovDD)
    if not all(0.0 < variance < _MAX_STDDEV**2 for variance in variances):
        return Rejection.OUT_OF_RANGE
    east, north, up = map(math.sqrt, variances)
    return Accuracy(_time_ns(found.iTOW), (east, north, up))


def _moving_base_heading(found: Any) -> Reading | Rejection:
    if not found.gnssFixOK:
        return Rejection.NO_FIX
    if not (found.relPosValid and getattr(found, "relPosHeadingValid", 0)):
        return Rejection.NO_HEADING
    if not found.isMoving:
        return Rejection.NO_PAIR
    if found.carrSoln != _FIXED_AMBIGUITIES:
        return Rejection.NOT_FIXED
    if not 0.0 <= found.relPosHeading <= 360.0:
        return Rejection.OUT_OF_RANGE
    stddev = math.radians(found.accHeading) if 0.0 < found.accHeading < 180.0 else 0.0
    return Heading(_time_ns(found.iTOW), yaw_of_heading(found.relPosHeading), stddev)


def _position_rejection(found: Any, altitude: float) -> Rejection | None:
    in_range = abs(found.lat) <= 90.0 and abs(found.lon) <= 180.0
    return None if in_range and not abs(altitude) > 1e5 else Rejection.OUT_OF_RANGE


def _accuracy(found: Any) -> Stddevs:
    """(east, north, up): hAcc for each horizontal axis, which is conservative; 0 means unknown."""
    horizontal, up = (
        value * _MM if 0.0 < value * _MM < _MAX_STDDEV else math.nan for value in (found.hAcc, found.vAcc)
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
