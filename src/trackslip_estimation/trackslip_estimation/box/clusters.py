# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Segmentation of a scan into objects, and the intervals in which each object's outline ends.

    β_i, ρ_i  angle and range of beam i in the laser frame  rad, m
    δ         angle between beams                           rad
    γ         smallest view angle of a side kept whole      rad
    σ         noise of one range                            m
    d         longest extent of the object sought           m

Neighbouring beams on one straight side seen at the angle γ are ρ δ / sin γ apart: a larger step is a gap
between objects. The outline of an object ends between its last beam and the first one beside it that passes
by; if a nearer object hides the end, that interval is as wide as the hiding object.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import BoolArray, FloatArray

IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Beams:
    """The beams on one object, counter-clockwise.

    angles, ranges: (N,) in the laser frame, rad and m; spacing: between neighbouring beams of the scan, rad.
    right, left: (lower, upper) angle of the interval within which the outline ends on either side, rad.
    """

    indices: IndexArray
    angles: FloatArray
    ranges: FloatArray
    spacing: float
    right: tuple[float, float]
    left: tuple[float, float]

    @cached_property
    def directions(self) -> FloatArray:
        """As ``directions``."""
        return directions(self.angles)

    def extent(self) -> float:
        """Return the distance of the first point from the last, m."""
        return _distance_between(self.ranges[0], self.ranges[-1], self.angles[-1] - self.angles[0])


def directions(angles: FloatArray) -> FloatArray:
    """Return (3, N): the angles, their cosines and sines."""
    return np.stack((angles, np.cos(angles), np.sin(angles)))


def segment_scan(
    ranges: FloatArray, angles: FloatArray, range_stddev: float, grazing_angle: float
) -> list[IndexArray]:
    """Beam indices of each object, counter-clockwise.

    Two beams without a return (+∞) separate objects; a single one is a dropout on a dark or wet side, and
    ignored as invalid beams are (NaN, −∞, 0).
    """
    valid = np.flatnonzero(np.isfinite(ranges) & (ranges > 0.0))
    if valid.size == 0:
        return []
    valid_ranges, valid_angles = ranges[valid], angles[valid]
    x, y = valid_ranges * np.cos(valid_angles), valid_ranges * np.sin(valid_angles)
    steps = np.sqrt((x[1:] - x[:-1]) ** 2 + (y[1:] - y[:-1]) ** 2)
    nearer = np.minimum(valid_ranges[:-1], valid_ranges[1:])
    noise = 3.0 * math.sqrt(2.0) * range_stddev
    allowed = nearer * (valid_angles[1:] - valid_angles[:-1]) / math.sin(grazing_angle) + noise
    empty_before = np.cumsum(ranges == math.inf)[valid]
    return split_at_gaps(valid, (steps > allowed) | (empty_before[1:] > empty_before[:-1] + 1))


def split_at_gaps(indices: IndexArray, gaps: BoolArray) -> list[IndexArray]:
    """Return the parts of (N,) indices, split at ``gaps`` (N − 1,)."""
    ends = [0, *(np.flatnonzero(gaps) + 1).tolist(), len(indices)]
    return [indices[begin:end] for begin, end in pairwise(ends)]


def rejoin_parts(
    parts: list[IndexArray], ranges: FloatArray, angles: FloatArray, extent: float
) -> list[IndexArray]:
    """Return objects that a nearer one cuts in two: pairs of parts with only nearer parts between them."""
    joined: list[IndexArray] = []
    farthest = [float(ranges[part].max()) for part in parts]
    for second, part in enumerate(parts):
        for first in range(second - 2, -1, -1):
            edge = min(ranges[parts[first][-1]], ranges[part[0]])
            if not max(farthest[first + 1 : second]) < edge:
                break
            right, left = parts[first][0], part[-1]
            if _distance_between(ranges[right], ranges[left], angles[left] - angles[right]) <= extent:
                joined.append(np.concatenate([parts[first], part]))
    return joined


def object_beams(
    indices: IndexArray, ranges: FloatArray, angles: FloatArray, extent: float, margin: float
) -> Beams:
    """Return one object's beams with the intervals of its ends.

    A beam passes by if its range exceeds that of any part of an object of this ``extent`` (m), plus
    ``margin`` (m) for noise. A shorter beam is no evidence: the object may continue behind it.
    """
    first, last = int(indices[0]), int(indices[-1])
    nearest = float(ranges[indices].min())
    passing = np.flatnonzero(ranges > nearest + extent + margin)
    spacing = float(angles[1] - angles[0])
    widest = max(2.0 * np.arcsin(min(1.0, extent / (2.0 * nearest))), angles[last] - angles[first] + spacing)
    lower, upper = float(angles[last] - widest), float(angles[first] + widest)
    if (before := passing[passing < first]).size:
        lower = max(lower, float(angles[before[-1]]))
    if (after := passing[passing > last]).size:
        upper = min(upper, float(angles[after[0]]))
    return Beams(
        indices=indices,
        angles=angles[indices],
        ranges=ranges[indices],
        spacing=spacing,
        right=(lower, float(angles[first])),
        left=(float(angles[last]), upper),
    )


def _distance_between(one: float, other: float, between: float) -> float:
    """Return the distance of two points, from their ranges and the angle between them."""
    return math.sqrt((one - other) ** 2 + one * other * (2.0 * math.sin(0.5 * between)) ** 2)
