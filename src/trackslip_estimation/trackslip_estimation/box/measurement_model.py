# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measurement model of the laser for a rectangle, and the residuals of the beams.

    q = (x, y, ψ)  centre and heading of the rectangle     m, m, rad
    a, b           half sides along and across the heading m
    ρ_i(q)         range of beam i on the rectangle        m
    θ_R(q), θ_L(q) angles of its outline, right and left   rad
    σ              noise of one range, rounding included   m
    s              standard deviation of an end            rad

The ranges are ray cast: of the sides that face the laser a beam hits the one whose line it crosses last, so
ρ_i is the larger of the distances to their lines. The ends are further measurements: the last beam on the box
hits and the next one passes, so θ_L is uniform between their angles (s = width/√12).

Sums over beams are rounded as numpy rounds them, so that a fit is bit-identical wherever its sums are
computed.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.box.clusters import Beams, directions

HUBER = 2.5  # standard deviations up to which the cost of a residual is its square
STEP = 1e-6  # m and rad, of the numerical derivatives


@dataclass(frozen=True)
class Rectangle:
    """Sides of the box: along and across its heading, m."""

    length: float
    width: float

    @property
    def diagonal(self) -> float:
        """Longest extent, m."""
        return float(np.hypot(self.length, self.width))

    @cached_property
    def half(self) -> FloatArray:
        """(2,) a and b."""
        return np.array((self.length / 2.0, self.width / 2.0))


class FitInput(NamedTuple):
    """Input of a fit: the size of the rectangle, and the beams on it."""

    half: FloatArray  # (2,) a and b
    directions: FloatArray  # (3, N) of the beams: angles, their cosines and sines
    ranges: FloatArray  # (N,)
    range_stddev: float  # σ
    ends: tuple[float, float]  # middles of the intervals of the right and the left end
    end_stddevs: tuple[float, float]  # s of each


class PredictedScan(NamedTuple):
    """Predicted measurements of rectangles at M poses."""

    ranges: FloatArray  # (M, N) of each beam, m
    outline: FloatArray  # (M, 2) right and left angle, rad


class RangeCosts(NamedTuple):
    """Costs of the ranges of rectangles at M poses."""

    costs: FloatArray  # (M, N) of each beam
    outline: FloatArray  # (M, 2) right and left angle, rad


class NormalEquations(NamedTuple):
    """Normal equations of the cost at a pose."""

    information: FloatArray  # (3, 3)
    gradient: FloatArray  # (3,)


def fit_input(box: Rectangle, beams: Beams, range_stddev: float) -> FitInput:
    """Return the input of a fit to a box's beams."""
    (right, right_end), (left, left_end) = beams.right, beams.left
    return FitInput(
        box.half,
        beams.directions,
        beams.ranges,
        range_stddev,
        ((right + right_end) / 2.0, (left + left_end) / 2.0),
        ((right_end - right) / math.sqrt(12.0), (left_end - left) / math.sqrt(12.0)),
    )


def predict_scan(poses: FloatArray, box: Rectangle, angles: FloatArray) -> PredictedScan:
    """Return the predicted measurements of rectangles at ``poses`` (M, 3), with beams at ``angles`` (N,).

    A beam that misses gets the range of the nearest end of the outline: ranges are continuous in the pose.
    """
    return cast_rays(poses, box.half, directions(angles))


@compiled
def costs(poses: FloatArray, beams: FitInput) -> FloatArray:
    """Return the costs (M, N + 2) of the residuals: squares, growing linearly beyond HUBER."""
    values = _residuals(poses, beams)
    for m in range(values.shape[0]):
        for n in range(values.shape[1]):
            values[m, n] = _huber(values[m, n])
    return values


@compiled
def range_costs(poses: FloatArray, beams: FitInput) -> RangeCosts:
    """Return the costs of the ranges alone, and the outline."""
    ranges, outline = cast_rays(poses, beams.half, beams.directions)
    for m in range(ranges.shape[0]):
        for n in range(ranges.shape[1]):
            ranges[m, n] = _huber((ranges[m, n] - beams.ranges[n]) / beams.range_stddev)
    return RangeCosts(ranges, outline)


@compiled
def total_cost(pose: FloatArray, beams: FitInput) -> float:
    """Return the sum of all ``costs`` of one pose (3,)."""
    return pairwise_sum(costs(pose.reshape((1, 3)), beams)[0])


@compiled
def normal_equations(pose: FloatArray, beams: FitInput) -> NormalEquations:
    """Return the normal equations of the cost at a pose (3,)."""
    poses = np.empty((7, 3))
    for axis in range(3):
        for m in range(7):
            poses[m, axis] = pose[axis]
        poses[1 + axis, axis] += STEP
        poses[4 + axis, axis] -= STEP
    values = _residuals(poses, beams)
    count = values.shape[1]
    slopes, weighted = np.empty((3, count)), np.empty((3, count))
    for n in range(count):
        weight = min(1.0, HUBER / max(abs(values[0, n]), HUBER))
        for axis in range(3):
            slopes[axis, n] = (values[1 + axis, n] - values[4 + axis, n]) / (2.0 * STEP)
            weighted[axis, n] = slopes[axis, n] * weight
    return NormalEquations(np.dot(weighted, slopes.T), np.dot(weighted, values[0]))


@compiled
def _residuals(poses: FloatArray, beams: FitInput) -> FloatArray:
    """Return the normalised residuals (M, N + 2): one per beam, then the right and the left end."""
    ranges, outline = cast_rays(poses, beams.half, beams.directions)
    count = ranges.shape[1]
    values = np.empty((ranges.shape[0], count + 2))
    for m in range(ranges.shape[0]):
        for n in range(count):
            values[m, n] = (ranges[m, n] - beams.ranges[n]) / beams.range_stddev
        for end in range(2):
            values[m, count + end] = (outline[m, end] - beams.ends[end]) / beams.end_stddevs[end]
    return values


@compiled
def _huber(residual: float) -> float:
    size = abs(residual)
    return size * size if size <= HUBER else 2.0 * HUBER * size - HUBER**2


@compiled
def cast_rays(poses: FloatArray, half: FloatArray, directions: FloatArray) -> PredictedScan:
    """As ``predict_scan``; ``half`` and ``directions`` as in ``FitInput``."""
    ranges, outline = np.empty((len(poses), directions.shape[1])), np.empty((len(poses), 2))
    for m in range(len(poses)):
        x, y = poses[m, 0], poses[m, 1]
        cos, sin = math.cos(poses[m, 2]), math.sin(poses[m, 2])
        bearing, right, left = math.atan2(y, x), math.inf, -math.inf
        for along in (half[0], -half[0]):
            for across in (half[1], -half[1]):
                corner_x, corner_y = x + cos * along - sin * across, y + sin * along + cos * across
                angle = math.atan2(x * corner_y - y * corner_x, x * corner_x + y * corner_y)
                right, left = min(right, angle), max(left, angle)
        right, left = bearing + right, bearing + left
        outline[m, 0], outline[m, 1] = right, left
        right_u, right_v, left_u, left_v = math.cos(right), math.sin(right), math.cos(left), math.sin(left)
        ahead, beside = -(cos * x + sin * y), sin * x - cos * y  # of the laser, in the frame of the box
        for n in range(directions.shape[1]):
            angle, u, v = directions[0, n], directions[1, n], directions[2, n]
            if angle < right:
                u, v = right_u, right_v
            elif angle > left:
                u, v = left_u, left_v
            along = _distance_to_side(ahead, half[0], u * cos + v * sin)
            across = _distance_to_side(beside, half[1], v * cos - u * sin)
            ranges[m, n] = max(along, across, 0.0)
    return PredictedScan(ranges, outline)


@compiled
def _distance_to_side(laser: float, half: float, direction: float) -> float:
    """Return the distance along a beam to the side that faces the laser; −∞ if neither of the two does."""
    if abs(laser) <= half or direction == 0.0:
        return -math.inf
    return (math.copysign(half, laser) - laser) / direction


@compiled
def pairwise_sum(values: FloatArray) -> float:
    """Return the sum of (K,) as ``numpy.sum`` does: eight parallel sums, and halves beyond 128 values."""
    count = len(values)
    if count > 128:
        half = count // 2 - count // 2 % 8
        return pairwise_sum(values[:half]) + pairwise_sum(values[half:])
    whole = count - count % 8
    total = 0.0
    if whole:
        sums = values[:8].copy()
        for n in range(8, whole):
            sums[n % 8] += values[n]
        total = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
    for n in range(whole, count):
        total += values[n]
    return total
