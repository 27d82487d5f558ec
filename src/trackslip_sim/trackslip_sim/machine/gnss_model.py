# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Model of a GNSS receiver: position by quality, velocity, heading of an antenna pair.

e     error of a position, east and north: white noise plus a first-order Gauss–Markov process
      of σ, τ; the error of the altitude is twice as large                                         m
q     quality as in GGA: 1 code only, 4 carrier phase with fixed ambiguities, 5 float

Faults reduce the quality to float, code only or no fix. Multipath adds a step to the position, which the
stated accuracy does not include. The heading from one antenna to the other needs no corrections.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pymap3d

from trackslip_common.arrays import FloatArray
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.units import NS_PER_S
from trackslip_drivers.protocols.nmea import heading_of_yaw
from trackslip_drivers.protocols.nmea_sentences import Position
from trackslip_sim.devices.nmea_device import FIXED, FLOAT, SINGLE, NmeaDeviceParameters
from trackslip_sim.machine import faults as f
from trackslip_sim.machine.faults import Faults
from trackslip_sim.machine.placement import Placement

_FIXED_CORRELATED_SHARE = 0.5  # time-correlated share of a fixed solution's variance; the rest is white
_FIXED_TIME = 5.0  # s, correlation time
_UP_RATIO = 2.0  # error of an altitude over that of the position
_CODE_STDDEV, _CODE_TIME = 1.5, 60.0  # m; s, correlation time
_VELOCITY_STEP_NS = 10_000_000  # half the interval of the central difference for the velocity


@dataclass(frozen=True, kw_only=True)
class GnssParameters(Parameters):
    """Receiver, mounting of its antennas, and its errors."""

    device: NmeaDeviceParameters
    latitude: float = parameter("latitude of the site's origin", unit="°", ge=-89.0, le=89.0)
    longitude: float = parameter("longitude of the site's origin", unit="°", ge=-180.0, le=180.0)
    altitude: float = parameter("height of the site's origin above the ellipsoid", unit="m")
    antenna_x: float = parameter("antenna ahead of base_link", unit="m")
    antenna_y: float = parameter("antenna left of base_link", unit="m")
    antenna_z: float = parameter("antenna above base_link", unit="m")
    heading_offset: float = parameter("direction of the antenna pair in base_link", unit="rad")
    heading_stddev: float = parameter("noise of the heading, white; 0: one antenna", unit="rad", ge=0.0)
    velocity_stddev: float = parameter(
        "noise of the Doppler velocity, east and north, white", unit="m/s", ge=0.0
    )
    fixed_stddev: float = parameter("error of a fixed solution, east and north", unit="m", gt=0.0)
    float_stddev: float = parameter("error of a floating solution", unit="m", gt=0.0)
    float_time: float = parameter("correlation time of that error", unit="s", gt=0.0)


class _GaussMarkov:
    """A first-order Gauss–Markov process, evaluated at increasing times."""

    def __init__(self, stddev: float, time: float) -> None:
        self._stddevs, self._time = stddev * np.array((1.0, 1.0, _UP_RATIO)), time
        self._value = np.zeros(3)
        self._last_time = -math.inf

    def advance(self, t: float, normal: FloatArray) -> FloatArray:
        """Advance to time ``t``, s; return the error (3,) east, north, up, m, from normal draws (3,)."""
        decay = math.exp(-abs(t - self._last_time) / self._time)
        self._value = decay * self._value + math.sqrt(1.0 - decay * decay) * self._stddevs * normal
        self._last_time = t
        return self._value


class GnssModel:
    """GNSS measurements of a drive, epoch by epoch.

    Args:
        p: mounting and errors.
        placement: true placement of the machine at a stamp.
        faults: faults of the receiver.
        seed: seed of the errors.
    """

    def __init__(
        self, p: GnssParameters, placement: Callable[[int], Placement], faults: Faults, seed: int
    ) -> None:
        self._p = p
        self._placement = placement
        self._faults = faults
        self._random = np.random.default_rng(seed)
        self._altitude_random = np.random.default_rng((seed, 1))  # separate: the other draws stay unchanged
        self._velocity_random = np.random.default_rng((seed, 2))
        self._correlated = {
            FIXED: _GaussMarkov(p.fixed_stddev * math.sqrt(_FIXED_CORRELATED_SHARE), _FIXED_TIME),
            FLOAT: _GaussMarkov(p.float_stddev, p.float_time),
            SINGLE: _GaussMarkov(_CODE_STDDEV, _CODE_TIME),
        }
        self._stddevs = {FIXED: p.fixed_stddev, FLOAT: p.float_stddev, SINGLE: _CODE_STDDEV}
        self._stuck_placement: Placement | None = None

    def measure(self, stamp_ns: int, best: int) -> Position:
        """The receiver's solution, of quality ``best`` or worse."""
        p, quality = self._p, self._quality(best, stamp_ns)
        east, north, up = self._position_error(stamp_ns, quality)
        heading_error = p.heading_stddev * self._random.standard_normal()
        clock_step = self._faults.active_fault(f.GNSS, f.CLOCK_STEP, stamp_ns)
        time_ns = stamp_ns + (round(clock_step.value * NS_PER_S) if clock_step is not None else 0)
        if quality == 0:
            return Position(time_ns)
        machine = self._true_placement(stamp_ns)
        x, y, z = machine.to_site(p.antenna_x, p.antenna_y, p.antenna_z)
        site = p.latitude, p.longitude, p.altitude
        latitude, longitude, altitude = pymap3d.enu2geodetic(x + east, y + north, z + up, *site)
        position = Position(
            time_ns,
            float(latitude),
            float(longitude),
            float(altitude),
            quality,
            stddev=self._stddevs[quality],
            up_stddev=_UP_RATIO * self._stddevs[quality],
        )
        speed, course = self._velocity(stamp_ns)
        position = position._replace(speed=speed, course=course)
        if p.heading_stddev == 0.0:
            return position
        heading = heading_of_yaw(machine.azimuth(p.heading_offset) + heading_error)
        return position._replace(heading=heading, heading_stddev=math.degrees(p.heading_stddev))

    def _velocity(self, stamp_ns: int) -> tuple[float, float]:
        """Speed, m/s, and course, °, of the antenna; a stuck receiver measures noise about 0."""
        arm = self._p.antenna_x, self._p.antenna_y, self._p.antenna_z
        error, velocity = self._p.velocity_stddev * self._velocity_random.standard_normal(2), np.zeros(2)
        if self._faults.active_fault(f.GNSS, f.STUCK, stamp_ns) is None:
            before, after = (
                np.array(self._placement(stamp_ns + offset_ns).to_site(*arm)[:2])
                for offset_ns in (-_VELOCITY_STEP_NS, _VELOCITY_STEP_NS)
            )
            velocity = (after - before) / (2e-9 * _VELOCITY_STEP_NS)
        east, north = (velocity + error).tolist()
        return math.hypot(east, north), heading_of_yaw(math.atan2(north, east))

    def _position_error(self, stamp_ns: int, quality: int) -> tuple[float, float, float]:
        """Position error east, north, up, m; all processes advance, whatever the quality."""
        count = len(self._correlated)
        normal = self._random.standard_normal((count, 2))
        normal_up = self._altitude_random.standard_normal((count, 1))
        errors = {0: np.zeros(3)} | {
            q: process.advance(stamp_ns / NS_PER_S, n)
            for (q, process), n in zip(self._correlated.items(), np.hstack((normal, normal_up)), strict=True)
        }
        white_stddev = self._p.fixed_stddev * math.sqrt(1.0 - _FIXED_CORRELATED_SHARE)
        white = white_stddev * np.array((1.0, 1.0, _UP_RATIO)) * self._random.standard_normal(3)
        step = self._faults.active_fault(f.GNSS, f.MULTIPATH, stamp_ns)
        multipath = np.array((0.0 if step is None else step.value, 0.0, 0.0))
        east, north, up = (errors[quality] + multipath + white).tolist()
        return east, north, up

    def _true_placement(self, stamp_ns: int) -> Placement:
        """The true placement; while stuck the one at the begin of the fault."""
        if self._faults.active_fault(f.GNSS, f.STUCK, stamp_ns) is None:
            self._stuck_placement = None
            return self._placement(stamp_ns)
        self._stuck_placement = self._stuck_placement or self._placement(stamp_ns)
        return self._stuck_placement

    def _quality(self, best: int, stamp_ns: int) -> int:
        if self._faults.active_fault(f.GNSS, f.NO_FIX, stamp_ns):
            return 0
        if best == SINGLE or self._faults.active_fault(f.GNSS, f.CODE_ONLY, stamp_ns):
            return SINGLE
        return FLOAT if best == FLOAT or self._faults.active_fault(f.GNSS, f.RTK_FLOAT, stamp_ns) else FIXED
