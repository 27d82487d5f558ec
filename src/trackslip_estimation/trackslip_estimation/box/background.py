# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a laser that stands still has seen beside the box: an object that was there before is not the box."""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.box.clusters import Beams

BESIDE = 2  # beams next to the box that may still be on it
SAME = 0.05  # of the beams' spacing, rad: beams no further apart are the same


@dataclass(frozen=True, eq=False)
class Background:
    """Last range (N,) of each beam that was not on the box, m; NaN where each was on it.

    free: (N,) how far along each beam no other thing stood, m; NaN where that is unknown. Of a beam that was
    always on the box that is to its side and the clearance behind it. angle_min, spacing: of the beams in the
    laser frame, rad; (0,) ranges: nothing is known.
    """

    angle_min: float
    spacing: float
    ranges: FloatArray
    free: FloatArray

    @classmethod
    def unknown(cls) -> "Background":
        """Of a laser that has seen nothing yet."""
        return cls(0.0, 0.0, np.zeros(0), np.zeros(0))

    def after(self, ranges: FloatArray, angles: FloatArray, box: Beams, clearance: float) -> "Background":
        """With one more scan (N,) in which the box is known; m and rad. ``clearance``: about the box, m."""
        last, free = (
            known.copy() if self._is_of(angles) else np.full(ranges.shape, np.nan)
            for known in (self.ranges, self.free)
        )
        known = ~np.isnan(ranges)
        known[max(0, box.indices[0] - BESIDE) : box.indices[-1] + BESIDE + 1] = False
        last[known] = free[known] = ranges[known]
        on_box = box.indices[np.isnan(last[box.indices])]
        free[on_box] = ranges[on_box] + clearance
        return Background(float(angles[0]), float(angles[1] - angles[0]), last, free)

    def holds(self, ranges: FloatArray, angles: FloatArray, margin: float) -> BoolArray:
        """(N,) which beams of a scan measure what they did before, within ``margin``, m."""
        if not self._is_of(angles):
            return np.zeros(ranges.shape, np.bool_)
        with np.errstate(invalid="ignore"):  # ∞ - ∞
            same: BoolArray = np.abs(self.ranges - ranges) < margin
        return same

    def was_free(self, ranges: FloatArray, angles: FloatArray, margin: float) -> BoolArray:
        """(N,) which beams end more than ``margin``, m, before where they went: what they hit is new."""
        if not self._is_of(angles):
            return np.zeros(ranges.shape, np.bool_)
        with np.errstate(invalid="ignore"):  # ∞ - ∞
            free: BoolArray = self.free - ranges > margin
        return free

    def _is_of(self, angles: FloatArray) -> bool:
        """Whether these are the same beams (N,)."""
        if self.ranges.shape != angles.shape:
            return False
        tolerance = SAME * self.spacing
        last = self.angle_min + self.spacing * (len(angles) - 1)
        return bool(abs(angles[0] - self.angle_min) < tolerance and abs(angles[-1] - last) < tolerance)
