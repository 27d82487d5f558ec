# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a laser that stands still has seen beside the box: an object that was there before is not the box."""

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.box.clusters import Beams

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BESIDE = 2  # beams next to the box that may still be on it


class Background:
    """Last range of each beam that was not on the box."""

    def __init__(self) -> None:
        self._ranges: FloatArray = np.zeros(0)

    def update(self, ranges: FloatArray, box: Beams) -> None:
        """Remember a scan (N,) in which the box is known; m."""
        if self._ranges.shape != ranges.shape:
            self._ranges = np.full(ranges.shape, np.nan)
        known = ~np.isnan(ranges)
        known[max(0, box.indices[0] - BESIDE) : box.indices[-1] + BESIDE + 1] = False
        self._ranges[known] = ranges[known]

    def holds(self, ranges: FloatArray, margin: float) -> BoolArray:
        """(N,) which beams of a scan measure what they did before, within ``margin``, m."""
        if self._ranges.shape != ranges.shape:
            return np.zeros(ranges.shape, np.bool_)
        with np.errstate(invalid="ignore"):  # ∞ - ∞
            same: BoolArray = np.abs(self._ranges - ranges) < margin
        return same
