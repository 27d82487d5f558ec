# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A scan cut into objects, and what is known from each object's ends about its outline.

    β_i, ρ_i  angle and range of beam i in the laser frame  rad, m
    δ         angle between beams                           rad
    γ         flattest view of a side kept whole            rad
    σ         noise of one range                            m
    d         longest extent of the object sought           m

Neighbouring beams on one straight side seen at the angle γ are ρ δ / sin γ apart: a larger step is a gap
between objects. The outline of an object ends somewhere between its last beam and the first one beside it
that passes by; where a nearer object hides the end, that interval is as wide as the hiding object.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
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

    def points(self) -> FloatArray:
        """(N, 2) in the laser frame, m."""
        return _points(self.ranges, self.angles)

    @cached_property
    def directions(self) -> FloatArray:
        """As ``directions``."""
        return directions(self.angles)


def directions(angles: FloatArray) -> FloatArray:
    """(3, N): the angles, their cosines and sines."""
    return np.stack((angles, np.cos(angles), np.sin(angles)))


def clusters(
    ranges: FloatArray, angles: FloatArray, range_stddev: float, grazing_angle: float
) -> list[IndexArray]:
    """Beam indices of each object, counter-clockwise.

    A beam without a return (+∞) separates objects; invalid ones (NaN, −∞, 0) neither belong nor separate.
    """
    valid = np.flatnonzero(np.isfinite(ranges) & (ranges > 0.0))
    if valid.size == 0:
        return []
    points = _points(ranges[valid], angles[valid])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    nearer = np.minimum(ranges[valid][:-1], ranges[valid][1:])
    allowed = nearer * np.diff(angles[valid]) / np.sin(grazing_angle) + 3.0 * np.sqrt(2.0) * range_stddev
    empty_before = np.cumsum(np.isposinf(ranges))[valid]
    gaps = (steps > allowed) | (np.diff(empty_before) > 0)
    return list(np.split(valid, np.flatnonzero(gaps) + 1))


def rejoined(
    parts: list[IndexArray], ranges: FloatArray, angles: FloatArray, extent: float
) -> list[IndexArray]:
    """Objects that a nearer one cuts in two: pairs of parts with only nearer parts between them."""
    joined: list[IndexArray] = []
    for second, part in enumerate(parts):
        for first in range(second - 2, -1, -1):
            ends = np.array([parts[first][0], part[-1]])
            edge = min(ranges[parts[first][-1]], ranges[part[0]])
            if not all(ranges[between].max() < edge for between in parts[first + 1 : second]):
                break
            right, left = _points(ranges[ends], angles[ends])
            if np.linalg.norm(left - right) <= extent:
                joined.append(np.concatenate([parts[first], part]))
    return joined


def beams_on(
    indices: IndexArray, ranges: FloatArray, angles: FloatArray, extent: float, margin: float
) -> Beams:
    """One object's beams with the intervals of its ends.

    A beam passes by when it goes further than any part of an object of this ``extent`` (m) could reach,
    ``margin`` (m) for noise. Beams that stop before it prove nothing: the object may go on behind.
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


def _points(ranges: FloatArray, angles: FloatArray) -> FloatArray:
    return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])
