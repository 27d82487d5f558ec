# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Decoded measurements of the sensors: SI units, FLU axes, stamps in integer ns.

A stamp is the time of the measurement on the host's clock, not of the arrival of its bytes.
"""

from enum import IntEnum
from typing import NamedTuple

from trackslip_common.arrays import FloatArray

Vector = tuple[float, float, float]


class SprocketSample(NamedTuple):
    """Both sprockets; positive drives forward. Positions are continuous (unwrapped).

    They are nan if absent, or if the distance turned since the previous ones is unknown.
    """

    stamp_ns: int
    left_position: float  # rad
    right_position: float  # rad
    left_velocity: float  # rad/s
    right_velocity: float  # rad/s


class HydraulicsSample(NamedTuple):
    """Travel motors: differential pressures, spool positions, supply pressure; nan if absent."""

    stamp_ns: int
    left_pressure: float  # Pa, positive drives forward
    right_pressure: float  # Pa
    left_spool: float  # -1 … 1
    right_spool: float  # -1 … 1
    supply_pressure: float  # Pa


class SwingSample(NamedTuple):
    """Angle of the upper structure relative to the undercarriage, counter-clockwise."""

    stamp_ns: int
    position: float  # rad, −π … π
    velocity: float  # rad/s


class ImuSample(NamedTuple):
    """One line of the inertial unit, in FLU axes."""

    stamp_ns: int
    acceleration: Vector  # m/s², specific force: level rest reads +g on z
    angular_velocity: Vector  # rad/s
    magnetic_field: Vector | None  # T; None if not measured
    over_range: bool  # a channel was at its limit


class ScanSample(NamedTuple):
    """One sweep of the laser scanner; the stamp is that of its first ray."""

    stamp_ns: int
    angle_min: float  # rad
    angle_increment: float  # rad, counter-clockwise
    time_increment: float  # s between neighbouring rays
    scan_time: float  # s between sweeps
    range_min: float  # m
    range_max: float  # m
    ranges: FloatArray  # (n,) m; +inf no return, -inf too close, nan invalid (REP-117)


class FixStatus(IntEnum):
    """Kind of a position; values of sensor_msgs/NavSatStatus."""

    SINGLE = 0
    DIFFERENTIAL = 1
    RTK = 2  # carrier phase, fixed or float: the variances differ


class CovarianceType(IntEnum):
    """Origin of a position's variances; values of sensor_msgs/NavSatFix."""

    UNKNOWN = 0
    APPROXIMATED = 1
    DIAGONAL_KNOWN = 2


class FixSample(NamedTuple):
    """Position of an antenna, WGS84."""

    stamp_ns: int
    latitude: float  # °, north
    longitude: float  # °, east
    altitude: float  # m above the ellipsoid; nan: unknown
    status: FixStatus
    variances: Vector  # m², east, north, up
    covariance_type: CovarianceType


class VelocitySample(NamedTuple):
    """Horizontal velocity of an antenna."""

    stamp_ns: int
    east: float  # m/s
    north: float
    stddev: float  # m/s, of each; 0: unknown


class HeadingSample(NamedTuple):
    """Heading of an antenna pair."""

    stamp_ns: int
    yaw: float  # rad in (−π, π], east = 0, counter-clockwise
    stddev: float  # rad; 0: unknown
