# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One laser scan as input of the localizer, and its validity check."""

import math
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray

MOST_BEAMS = 20_000  # three times those of the finest scanners
FULL_TURN = 2.0 * np.pi + 1e-3  # rad, with the rounding of float32
SMALLEST_INCREMENT = 1e-5  # rad
LONGEST_SWEEP = 2.0  # s
LATEST_NS = (2**31 - 4) * 1_000_000_000  # the seconds of a ROS stamp end shortly after


@dataclass(frozen=True, eq=False)
class Scan:
    """Ranges (N,) in m, from ``angle_min`` on in the laser frame, rad.

    stamp_ns: of the first beam; time_increment: from one beam to the next, s. A range is +∞ without a return,
    NaN or −∞ if unknown (REP-117).
    """

    stamp_ns: int
    ranges: FloatArray
    angle_min: float
    angle_increment: float
    time_increment: float

    def to_counter_clockwise(self) -> "Scan":
        """Return the scan with its beams counter-clockwise: reversed if ``angle_increment`` < 0."""
        steps = self.ranges.size - 1
        last_ns = steps * self.time_increment * 1e9
        if not self.angle_increment < 0.0 or not math.isfinite(last_ns):
            return self
        return Scan(
            self.stamp_ns + round(last_ns),
            self.ranges[::-1],
            self.angle_min + steps * self.angle_increment,
            -self.angle_increment,
            -self.time_increment,
        )

    def is_usable(self) -> bool:
        """Whether shape, geometry and times are possible for a scanner; ranges are not checked."""
        if self.ranges.ndim != 1 or not 2 <= self.ranges.size <= MOST_BEAMS:
            return False
        steps = self.ranges.size - 1
        return (  # all false for NaN
            abs(self.angle_min) <= FULL_TURN
            and SMALLEST_INCREMENT <= self.angle_increment <= FULL_TURN / steps
            and abs(self.time_increment) <= LONGEST_SWEEP / steps
            and 0 <= self.stamp_ns < LATEST_NS
        )

    def angles(self) -> FloatArray:
        """Return the beam angles (N,), rad."""
        return self.angle_min + self.angle_increment * np.arange(self.ranges.size, dtype=np.float64)

    def beam_stamp_ns(self, beam: float) -> int:
        """Return the stamp of the beam of this index, or of a mean of indices, ns."""
        return self.stamp_ns + round(self.time_increment * 1e9 * beam)
