# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The rectangle fitted to the beams on it: pose of its centre in the laser frame, with its covariance.

    q = (x, y, ψ)  centre and heading of the rectangle     m, m, rad
    a, b           half sides along and across the heading m
    ρ_i(q)         range of beam i on the rectangle        m
    θ_R(q), θ_L(q) angles of its outline, right and left   rad
    σ              noise of one range, rounding included   m
    s              standard deviation of an end            rad

The measurement model is the ray cast itself: of the sides that face the laser a beam meets the last entered,
so ρ_i is the larger of the distances to their lines. The ends are measurements beside the ranges: the last
beam on the box hits and the next one passes, so θ_L is uniform between their angles (s = width/√12).

The most likely q is found by Gauss–Newton with Huber's weights. Near the view onto one side the outline has
a cusp (ψ and −ψ look alike) and the second side has no beam or one, so the curvature at the optimum misleads.
Therefore mean and covariance are those of the posterior itself: the likelihood is summed over a fixed
set of points spread about the optimum (importance sampling without chance: the same scan gives the same fix).
There the ends are uniform as they are; for the optimum alone they stand in as Gaussian of the same variance.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, log_ndtr, ndtri

from trackslip_common.compiled import compiled
from trackslip_estimation.box.clusters import Beams

FloatArray = NDArray[np.float64]

HUBER = 2.5  # standard deviations up to which a residual counts in full
TRIES = 6  # starts worth fitting from: the cost has kinks at which a fit gets stuck
STEP = 1e-6  # m and rad, of the numerical derivatives
FAINT = 1e-6  # information in 1/m² and 1/rad² where the beams give none
EDGE_SOFTNESS = 0.05  # of the beam spacing: a beam is not infinitely thin
POINTS = 512  # spread about the optimum
TAILS = 5.0  # degrees of freedom of the Student distribution the points are spread by
COOLING = (16.0, 4.0, 1.0, 1.0)  # temperature of each round
WIDENING = 1.3  # of the spread found in the round before
BLUR = 0.2  # of the intervals of the ends: least first spread
FEWEST_POINTS = 4.0  # effective number below which a round is without effect
LEAST_LOG, TINY = -1e300, 1e-300  # for weights that are all zero


@dataclass(frozen=True)
class Rectangle:
    """Sides of the box: along and across its heading, m."""

    length: float
    width: float

    @property
    def diagonal(self) -> float:
        """Longest extent, m."""
        return float(np.hypot(self.length, self.width))


@dataclass(frozen=True)
class Optimum:
    """The most likely pose (3,) of the box in the laser frame.

    information: (3, 3), the inverse covariance to first order. chi2: sum of squared normalised residuals,
    linear beyond HUBER, with ``freedom`` degrees of freedom.
    """

    pose: FloatArray
    information: FloatArray
    chi2: float
    freedom: int


def ray_cast(poses: FloatArray, box: Rectangle, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the laser would see of rectangles at ``poses`` (M, 3).

    Returns:
        ranges (M, N), m, for beams at ``angles`` (N,); a beam that passes by gets the range of the corner
        nearest to it, so that ranges stay continuous in the pose. Outline (M, 2): right and left angle, rad.
    """
    ranges, outline = np.empty((len(poses), len(angles))), np.empty((len(poses), 2))
    _cast(poses, np.array((box.length / 2.0, box.width / 2.0)), _directions(angles), ranges, outline)
    return ranges, outline


def _directions(angles: FloatArray) -> FloatArray:
    """(3, N): the angles, their cosines and sines."""
    return np.stack((angles, np.cos(angles), np.sin(angles)))


@compiled
def _cast(
    poses: FloatArray, half: FloatArray, directions: FloatArray, ranges: FloatArray, outline: FloatArray
) -> None:
    """Fill ``ranges`` and ``outline`` of ``ray_cast``; ``half`` (2,) are a and b."""
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
        ahead, beside = -(cos * x + sin * y), sin * x - cos * y  # of the laser, in the frame of the box
        for n in range(directions.shape[1]):
            angle, u, v = directions[0, n], directions[1, n], directions[2, n]
            if not right <= angle <= left:
                angle = min(max(angle, right), left)
                u, v = math.cos(angle), math.sin(angle)
            along = _distance(ahead, half[0], u * cos + v * sin)
            across = _distance(beside, half[1], v * cos - u * sin)
            ranges[m, n] = max(along, across, 0.0)


@compiled
def _distance(laser: float, half: float, direction: float) -> float:
    """Along a beam to the line of the side that faces the laser; −∞ where neither of the two sides does."""
    if abs(laser) <= half or direction == 0.0:
        return -math.inf
    return (math.copysign(half, laser) - laser) / direction


def residuals(poses: FloatArray, box: Rectangle, beams: Beams, range_stddev: float) -> FloatArray:
    """Normalised residuals (M, N + 2): one per beam, then the right and the left end."""
    ranges, outline = ray_cast(poses, box, beams.angles)
    intervals = np.array([beams.right, beams.left])
    ends = (outline - intervals.mean(axis=1)) / (np.diff(intervals, axis=1)[:, 0] / np.sqrt(12.0))
    return np.hstack([(ranges - beams.ranges) / range_stddev, ends])


def starts(headings: FloatArray, box: Rectangle, beams: Beams) -> FloatArray:
    """Poses (M, 3) with these headings, moved so that outline and mean range match the beams.

    Of the outline's ends the one that is hidden, or out of sight, says little and counts little.
    """
    ends, widths = np.mean((beams.right, beams.left), axis=1), np.ptp((beams.right, beams.left), axis=1)
    share = widths**-2.0 / (widths**-2.0).sum()
    middle = float(share @ ends)
    distance = np.full(headings.shape, float(beams.ranges.mean()) + 0.25 * (box.length + box.width))
    bearing = np.full(headings.shape, middle)
    for _ in range(2):
        poses = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing), headings])
        ranges, outline = ray_cast(poses, box, beams.angles)
        distance = distance + (beams.ranges - ranges).mean(axis=1)
        bearing = bearing + middle - outline @ share
    return np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing), headings])


def likely_starts(headings: FloatArray, box: Rectangle, beams: Beams, range_stddev: float) -> FloatArray:
    """The TRIES best fitting of ``starts`` (TRIES, 3), best first."""
    poses = starts(headings, box, beams)
    cost = _huber(residuals(poses, box, beams, range_stddev)).sum(axis=1)
    return poses[np.argsort(cost, kind="stable")[:TRIES]]


def _huber(residual: FloatArray) -> FloatArray:
    """Squared residual, growing linearly beyond HUBER."""
    size = np.abs(residual)
    return np.where(size <= HUBER, size**2, 2.0 * HUBER * size - HUBER**2)


def most_likely(
    start: FloatArray, box: Rectangle, beams: Beams, range_stddev: float, steps: int = 20
) -> Optimum:
    """At most so many steps of damped Gauss–Newton from a pose (3,) near the box."""
    stencil = np.vstack([np.zeros(3), STEP * np.eye(3), -STEP * np.eye(3)])

    def look(at: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        values = residuals(at + stencil, box, beams, range_stddev)
        jacobian = (values[1:4] - values[4:7]).T / (2.0 * STEP)
        weighted = jacobian.T * np.minimum(1.0, HUBER / np.maximum(np.abs(values[0]), HUBER))
        return float(_huber(values[0]).sum()), weighted @ jacobian, weighted @ values[0]

    pose, damping = start, 1e-3
    cost, information, gradient = look(pose)
    for _ in range(steps):
        damped = information + damping * np.diag(np.diag(information)) + FAINT * np.eye(3)
        move = np.linalg.solve(damped, -gradient)
        trial_cost, trial_information, trial_gradient = look(pose + move)
        if not trial_cost < cost:
            damping *= 10.0
            continue
        gain, pose = cost - trial_cost, pose + move
        cost, information, gradient = trial_cost, trial_information, trial_gradient
        damping *= 0.1
        if gain < 1e-4:
            break
    return Optimum(pose, information + FAINT * np.eye(3), cost, len(beams.ranges) + 2 - 3)


def posterior(
    optimum: Optimum, middle: float, box: Rectangle, beams: Beams, range_stddev: float
) -> tuple[FloatArray, FloatArray, float]:
    """Mean (3,) and covariance (3, 3) of the pose in the laser frame, heading within ±π/4 of ``middle``, rad.

    With them log E of the evidence, the likelihood integrated over these poses, up to a constant.

    Points spread by the widened first-order covariance are weighed by the likelihood to the power
    1/temperature; their moments spread the next round's. Cooling lets them find modes that the curvature
    does not show.
    """
    points, log_density = _spread_points()
    pose, covariance = optimum.pose, 4.0 * np.linalg.inv(optimum.information)
    blur = BLUR * float(np.ptp((beams.right, beams.left), axis=1).mean() * beams.ranges.mean())
    covariance = covariance + blur**2 * np.diag([1.0, 1.0, 4.0 / (box.length * box.width)])
    root, log_evidence = np.linalg.cholesky(covariance), -math.inf
    for temperature in COOLING:
        poses = pose + WIDENING * points @ root.T
        log_weight = _log_likelihood(poses, box, beams, range_stddev) / temperature - log_density
        log_weight[np.abs(poses[:, 2] - middle) > np.pi / 4.0] = -np.inf
        largest = max(float(log_weight.max()), LEAST_LOG)
        weight = np.exp(log_weight - largest)
        total = max(float(weight.sum()), TINY)
        log_evidence = largest + math.log(total) + float(np.log(np.diag(root)).sum())
        weight /= total
        if not TINY < weight @ weight <= 1.0 / FEWEST_POINTS:
            continue
        mean = weight @ poses
        offset = poses - mean
        spread = (weight[:, np.newaxis] * offset).T @ offset
        with suppress(np.linalg.LinAlgError):  # points on a line: as good as none
            root = np.linalg.cholesky(spread)
            pose, covariance = mean, spread
    return pose, covariance, log_evidence


def seen_through(
    pose: FloatArray, box: Rectangle, ranges: FloatArray, angles: FloatArray, margin: float
) -> int:
    """How many beams of the whole scan pass well inside the outline of a box at ``pose`` (3,) and end behind.

    ``margin``: range beyond the box's side that noise does not explain, m. One beam spacing within the
    outline is left out.
    """
    expected, outline = ray_cast(pose[np.newaxis], box, angles)
    spacing = angles[1] - angles[0]
    inside = (angles > outline[0, 0] + spacing) & (angles < outline[0, 1] - spacing)
    return int(np.count_nonzero(inside & (ranges > expected[0] + 0.5 * box.width + margin)))


def _log_likelihood(poses: FloatArray, box: Rectangle, beams: Beams, range_stddev: float) -> FloatArray:
    """Of the beams at poses (M, 3), up to a constant: ranges with Huber's tails, uniform ends."""
    ranges, outline = ray_cast(poses, box, beams.angles)
    intervals = np.array([beams.right, beams.left])
    soft = EDGE_SOFTNESS * beams.spacing
    inside = log_ndtr((outline - intervals[:, 0]) / soft) + log_ndtr((intervals[:, 1] - outline) / soft)
    squares = _huber((ranges - beams.ranges) / range_stddev)
    total: FloatArray = inside.sum(axis=1) - 0.5 * squares.sum(axis=1)
    return total


@cache
def _spread_points() -> tuple[FloatArray, FloatArray]:
    """Points (M, 3) of a normalised Student distribution, their log density (M,) up to a constant."""
    golden = 1.1673039782614187  # root of g⁵ = g + 1: steps of 1/g, … 1/g⁴ fill the unit cube evenly
    uniform = (0.5 + np.outer(np.arange(1, POINTS + 1), golden ** -np.arange(1.0, 5.0))) % 1.0
    radius2 = 2.0 / TAILS * gammaincinv(0.5 * TAILS, uniform[:, 3])
    points = ndtri(uniform[:, :3]) / np.sqrt(radius2)[:, np.newaxis]
    log_density = -0.5 * (TAILS + 3.0) * np.log1p((points**2).sum(axis=1) / TAILS)
    return points, log_density
