# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Position of the antenna in metres east and north of a datum, from one fix.

    ϕ, λ, h      latitude, longitude, altitude above the ellipsoid     °, °, m
    E, N         east and north of the datum, on its tangent plane     m

The tangent plane is the map. At 1 km from the datum distances on it are shorter than on the ground by 10⁻⁸,
and a wrong altitude of 50 m moves a fix by 8 mm; at 100 m by 0.8 mm.
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np
import pymap3d

from trackslip_common.arrays import FloatArray
from trackslip_common.tally import Tally
from trackslip_estimation.covariance import is_covariance
from trackslip_estimation.gnss.parameters import GnssLocalizerParameters

Number = float | FloatArray

FIX = "fix"
_UNKNOWN_COVARIANCE = 0  # covariance type
_EARTH_RADIUS = 6.4e6  # m
_DATUM_TOLERANCE = 100.0  # m between fixes that agree on a datum
_UP_STDDEV_RATIO = 2.0  # ratio of the altitude's standard deviation to that of the position


class Reason(Enum):
    """Why a fix is rejected."""

    NO_FIX = "no fix"
    NOT_A_NUMBER = "not a number"
    OUT_OF_RANGE = "latitude or longitude out of range"
    ZERO = "latitude and longitude are 0"
    BAD_COVARIANCE = "covariance is not positive semidefinite"
    UNCERTAIN = "too uncertain"
    HEMISPHERE = "in another hemisphere than the datum"
    FAR = "too far from the datum"
    NO_DATUM = "waiting for the datum"


class Fix(NamedTuple):
    """Fix of a receiver."""

    stamp_ns: int
    latitude: float  # °
    longitude: float  # °
    altitude: float  # m above the ellipsoid; nan: unknown
    status: int  # as sensor_msgs/NavSatStatus: −1 none, 0, 1, 2
    covariance: FloatArray  # (2, 2) m², east and north
    covariance_type: int  # as sensor_msgs/NavSatFix: 0 unknown
    altitude_variance: float  # m²


class Datum(NamedTuple):
    """Origin of the map."""

    latitude: float  # °
    longitude: float  # °
    altitude: float  # m above the ellipsoid


class AntennaPosition(NamedTuple):
    """Position of an antenna on the map."""

    stamp_ns: int
    east: float  # m
    north: float  # m
    up: float  # m; nan: unknown
    covariance: FloatArray  # (2, 2) m², east and north
    up_variance: float  # m²


class GnssLocalizer:
    """Converts single fixes; the datum, given or from the first fixes, is the only state."""

    def __init__(self, parameters: GnssLocalizerParameters) -> None:
        self.tally = Tally()
        self._p = p = parameters
        datum = Datum(p.datum_latitude, p.datum_longitude, p.datum_altitude)
        self.datum: Datum | None = datum if p.has_datum else None
        self._candidate: Datum | None = None
        self._agreeing = 0

    def locate(self, fix: Fix) -> AntennaPosition | Reason:
        """Return the position of the antenna, or why the fix is rejected; rejections are counted."""
        result = self._rejection_reason(fix) or self._project(fix)
        if isinstance(result, Reason):
            self.tally.add(FIX, result)
        return result

    def _rejection_reason(self, fix: Fix) -> Reason | None:
        """Return why a fix is rejected independently of the datum, or None."""
        position = fix.latitude, fix.longitude
        if fix.status < 0:
            return Reason.NO_FIX
        if not all(map(math.isfinite, position)) or math.isinf(fix.altitude):
            return Reason.NOT_A_NUMBER
        if abs(fix.latitude) > 90.0 or abs(fix.longitude) > 180.0:
            return Reason.OUT_OF_RANGE
        if position == (0.0, 0.0):
            return Reason.ZERO
        covariance = self._covariance(fix)
        if not is_covariance(covariance):
            return Reason.BAD_COVARIANCE
        worst = max(covariance[0, 0], covariance[1, 1])
        return Reason.UNCERTAIN if worst > self._p.max_stddev**2 else None

    def _project(self, fix: Fix) -> AntennaPosition | Reason:
        if self.datum is None:
            self._propose_datum(fix)
        if self.datum is None:
            return Reason.NO_DATUM
        east, north, up = map(float, east_north_up(self.datum, fix.latitude, fix.longitude, fix.altitude))
        if math.hypot(east, north) > self._p.max_distance:
            return too_far_reason(self.datum, fix.latitude, fix.longitude)
        covariance = self._covariance(fix)
        up = math.nan if math.isnan(fix.altitude) else up
        return AntennaPosition(fix.stamp_ns, east, north, up, covariance, _up_variance(fix, covariance))

    def _propose_datum(self, fix: Fix) -> None:
        """Set the datum from fixes in a row that agree: one wrong fix at the start must not shift the map."""
        if self._candidate is None or math.hypot(*_east_north(self._candidate, fix)) > _DATUM_TOLERANCE:
            altitude = 0.0 if math.isnan(fix.altitude) else fix.altitude
            self._candidate, self._agreeing = Datum(fix.latitude, fix.longitude, altitude), 0
        self._agreeing += 1
        if self._agreeing >= self._p.datum_fixes:
            self.datum = self._candidate

    def _covariance(self, fix: Fix) -> FloatArray:
        """Return the covariance (2, 2) of a fix; if unknown or zero, the one assumed for its status."""
        if fix.covariance_type != _UNKNOWN_COVARIANCE and fix.covariance.any():
            return fix.covariance
        assumed = self._p.assumed_stddev
        stddev = (assumed.single, assumed.differential, assumed.rtk)[min(fix.status, 2)]
        return np.diag((stddev**2, stddev**2))


def _up_variance(fix: Fix, covariance: FloatArray) -> float:
    """Return the altitude variance, m²; by default that of twice the position's standard deviation.

    The altitude is less accurate because all satellites are above the antenna.
    """
    stated = fix.altitude_variance if fix.covariance_type != _UNKNOWN_COVARIANCE else 0.0
    if math.isfinite(stated) and stated > 0.0:
        return stated
    return _UP_STDDEV_RATIO**2 * float(np.max(np.diag(covariance)))


def too_far_reason(datum: Datum, latitude: float, longitude: float) -> Reason:
    """Return the reason to reject a position (°) that is too far from the datum."""
    is_other_hemisphere = latitude * datum.latitude < 0.0 or longitude * datum.longitude < 0.0
    return Reason.HEMISPHERE if is_other_hemisphere else Reason.FAR


def east_north_up(
    datum: Datum, latitude: Number, longitude: Number, altitude: Number
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return E, N, U, m, of positions (°, °, m; nan: altitude of the datum), numbers or arrays.

    E and N are infinite on the far side of the Earth, which would be projected onto the map, too.
    """
    altitudes = np.where(np.isnan(altitude), datum.altitude, altitude)
    east, north, up = pymap3d.geodetic2enu(latitude, longitude, altitudes, *datum)
    is_near = np.asarray(up) > -_EARTH_RADIUS
    return np.where(is_near, east, math.inf), np.where(is_near, north, math.inf), np.asarray(up)


def _east_north(datum: Datum, fix: Fix) -> tuple[float, float]:
    """Return E, N of a fix, m."""
    east, north, _ = east_north_up(datum, fix.latitude, fix.longitude, fix.altitude)
    return float(east), float(north)
