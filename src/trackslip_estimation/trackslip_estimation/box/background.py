# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Ranges of a stationary laser beside the box: an object that was there before is not the box."""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray
from trackslip_estimation.box.clusters import Beams

BEAMS_BESIDE = 2  # beams next to the box that may still be on it
BEAM_TOLERANCE = 0.05  # share of the beam spacing, within which beams are the same


@dataclass(frozen=True, eq=False)
class Background:
    """Last range (N,) of each beam that was not on the box, m; NaN where each was on it.

    free: (N,) distance along each beam without another object, m; NaN if unknown. For a beam that was always
    on the box it is its range plus the clearance. angle_min, spacing: of the beams in the laser frame, rad;
    (0,) ranges: empty background.
    """

    angle_min: float
    spacing: float
    ranges: FloatArray
    free: FloatArray

    @classmethod
    def empty(cls) -> "Background":
        """Return the empty background."""
        return cls(0.0, 0.0, np.zeros(0), np.zeros(0))

    def update(self, ranges: FloatArray, angles: FloatArray, box: Beams, clearance: float) -> "Background":
        """Return the background after a scan (N,), m and rad, with known box; ``clearance``: about it, m."""
        last, free = (
            before.copy() if self._has_same_beams(angles) else np.full(ranges.shape, np.nan)
            for before in (self.ranges, self.free)
        )
        beside = ~np.isnan(ranges)
        beside[max(0, box.indices[0] - BEAMS_BESIDE) : box.indices[-1] + BEAMS_BESIDE + 1] = False
        last[beside] = free[beside] = ranges[beside]
        on_box = box.indices[np.isnan(last[box.indices])]
        free[on_box] = ranges[on_box] + clearance
        return Background(float(angles[0]), float(angles[1] - angles[0]), last, free)

    def matching_beams(self, ranges: FloatArray, angles: FloatArray, margin: float) -> BoolArray:
        """Return which beams (N,) of a scan measure the same as before, within ``margin``, m."""
        if not self._has_same_beams(angles):
            return np.zeros(ranges.shape, np.bool_)
        with np.errstate(invalid="ignore"):  # ∞ - ∞
            matches: BoolArray = np.abs(self.ranges - ranges) < margin
        return matches

    def new_object_beams(self, ranges: FloatArray, angles: FloatArray, margin: float) -> BoolArray:
        """Return which beams (N,) end more than ``margin``, m, before their free distance, at new objects."""
        if not self._has_same_beams(angles):
            return np.zeros(ranges.shape, np.bool_)
        with np.errstate(invalid="ignore"):  # ∞ - ∞
            is_nearer: BoolArray = self.free - ranges > margin
        return is_nearer

    def _has_same_beams(self, angles: FloatArray) -> bool:
        """Whether the beams (N,) are those of the background."""
        if self.ranges.shape != angles.shape:
            return False
        tolerance = BEAM_TOLERANCE * self.spacing
        last = self.angle_min + self.spacing * (len(angles) - 1)
        return bool(abs(angles[0] - self.angle_min) < tolerance and abs(angles[-1] - last) < tolerance)
