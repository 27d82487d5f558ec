# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fit of a rectangle to the beams on it: pose of its centre in the laser frame, with its covariance.

Symbols and model are those of ``measurement_model``.

The most likely q is found by Gauss–Newton with Huber's weights. Near the view onto one side the outline has
a cusp (ψ and −ψ look alike) and the second side has at most one beam: the curvature there is no information.
Mean and covariance are therefore moments of the posterior, by importance sampling over a fixed set of points
about the optimum (the same scan gives the same fix). The posterior has the uniform ends of the model; the
optimum has Gaussian ends of the same variance.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv, log_ndtr, ndtri

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.box.clusters import Beams, object_beams
from trackslip_estimation.box.measurement_model import (
    FitInput,
    Rectangle,
    cast_rays,
    costs,
    fit_input,
    normal_equations,
    predict_scan,
    range_costs,
    total_cost,
)

TRIES = 6  # starts of the fit: the cost has kinks at which a descent stops
LEAST_INFORMATION = 1e-6  # information in 1/m² and 1/rad², where the beams give none
EDGE_SOFTNESS = 0.05  # of the beam spacing: a beam is not infinitely thin
SAMPLES = 512  # samples about the optimum
DEGREES_OF_FREEDOM = 5.0  # degrees of freedom of the Student distribution of the samples
TEMPERATURES = (16.0, 4.0, 1.0, 1.0)  # temperature of each round
WIDENING = 1.3  # factor of the spread found in the previous round
LEAST_SPREAD = 0.2  # share of the intervals of the ends: least spread of the first round
FEWEST_SAMPLES = 4.0  # effective number of samples below which a round has no effect
LEAST_LOG, TINY = -1e300, 1e-300  # least logarithm and sum of the weights, in case all are zero


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


class Descent(NamedTuple):
    """Minimum of the cost."""

    pose: FloatArray  # (3,)
    information: FloatArray  # (3, 3)
    cost: float


class Posterior(NamedTuple):
    """Posterior of the pose of the box in the laser frame."""

    pose: FloatArray  # (3,) mean
    covariance: FloatArray  # (3, 3)
    log_evidence: float  # log E: the likelihood integrated over these poses, up to a constant


def starting_poses(headings: FloatArray, box: Rectangle, beams: Beams) -> FloatArray:
    """Return poses (M, 3) with these headings, moved so that outline and mean range match the beams.

    The ends of the outline are weighted by the inverse squared width of their intervals.
    """
    intervals = np.array((beams.right, beams.left))
    ends, weights = intervals.sum(axis=1) / 2.0, (intervals[:, 1] - intervals[:, 0]) ** -2.0
    share = weights / weights.sum()
    mean_bearing = float(share @ ends)
    distance = np.full(headings.shape, float(beams.ranges.mean()) + 0.25 * (box.length + box.width))
    bearing = np.full(headings.shape, mean_bearing)
    for _ in range(2):
        poses = _polar_poses(distance, bearing, headings)
        ranges, outline = cast_rays(poses, box.half, beams.directions)
        distance = distance + (beams.ranges - ranges).mean(axis=1)
        bearing = bearing + mean_bearing - outline @ share
    return _polar_poses(distance, bearing, headings)


def _polar_poses(distance: FloatArray, bearing: FloatArray, headings: FloatArray) -> FloatArray:
    """Return poses (M, 3) from polar coordinates."""
    poses = np.empty((len(headings), 3))
    poses[:, 0], poses[:, 1] = distance * np.cos(bearing), distance * np.sin(bearing)
    poses[:, 2] = headings
    return poses


def likely_starting_poses(
    headings: FloatArray, box: Rectangle, beams: Beams, range_stddev: float
) -> FloatArray:
    """Return the TRIES best fitting of ``starting_poses`` (TRIES, 3), best first."""
    poses = starting_poses(headings, box, beams)
    cost = costs(poses, fit_input(box, beams, range_stddev)).sum(axis=1)
    return poses[np.argsort(cost, kind="stable")[:TRIES]]


def fit_pose(
    start: FloatArray, box: Rectangle, beams: Beams, range_stddev: float, steps: int = 20
) -> Optimum:
    """Return the optimum after at most ``steps`` of damped Gauss–Newton from a pose (3,) near the box."""
    minimum = _descend(start, fit_input(box, beams, range_stddev), steps)
    information = minimum.information + LEAST_INFORMATION * np.eye(3)
    return Optimum(minimum.pose, information, minimum.cost, len(beams.ranges) + 2 - 3)


@compiled
def _descend(start: FloatArray, beams: FitInput, steps: int) -> Descent:
    """As ``fit_pose``."""
    pose, damping, cost = start, 1e-3, total_cost(start, beams)
    information, gradient = normal_equations(pose, beams)
    for _ in range(steps):
        damped = information.copy()
        for axis in range(3):
            damped[axis, axis] += damping * information[axis, axis]
            damped[axis, axis] += LEAST_INFORMATION
        trial = pose - np.linalg.solve(damped, gradient)
        trial_cost = total_cost(trial, beams)
        if not trial_cost < cost:
            damping *= 10.0
            continue
        gain, pose, cost = cost - trial_cost, trial, trial_cost
        information, gradient = normal_equations(pose, beams)
        damping *= 0.1
        if gain < 1e-4:
            break
    return Descent(pose, information, cost)


def posterior(
    optimum: Optimum, middle: float, box: Rectangle, beams: Beams, range_stddev: float
) -> Posterior:
    """Return the posterior of the poses whose heading is within ±π/4 of ``middle``, rad.

    Samples of the widened first-order covariance are weighted by the likelihood to the power 1/temperature;
    their moments spread the samples of the next round. Cooling finds modes that the curvature misses.
    """
    points, log_density = _student_samples()
    pose, covariance = optimum.pose, 4.0 * np.linalg.inv(optimum.information)
    blur = LEAST_SPREAD * float(np.ptp((beams.right, beams.left), axis=1).mean() * beams.ranges.mean())
    covariance = covariance + blur**2 * np.diag([1.0, 1.0, 4.0 / (box.length * box.width)])
    root, log_evidence = np.linalg.cholesky(covariance), -math.inf
    for temperature in TEMPERATURES:
        poses = pose + points @ root.T
        log_weight = _log_likelihood(poses, box, beams, range_stddev) / temperature - log_density
        log_weight[np.abs(poses[:, 2] - middle) > np.pi / 4.0] = -np.inf
        largest = max(float(log_weight.max()), LEAST_LOG)
        weight = np.exp(log_weight - largest)
        total = max(float(weight.sum()), TINY)
        log_evidence = largest + math.log(total) + float(np.log(np.diag(root)).sum())
        weight /= total
        if not TINY < weight @ weight <= 1.0 / FEWEST_SAMPLES:
            continue
        mean = weight @ poses
        offset = poses - mean
        spread = (weight[:, np.newaxis] * offset).T @ offset
        with suppress(np.linalg.LinAlgError):  # points on a line: without effect
            root = np.linalg.cholesky(spread)
            pose, covariance = mean, spread
    return Posterior(pose, covariance, log_evidence)


def count_beams_through(
    pose: FloatArray, box: Rectangle, ranges: FloatArray, angles: FloatArray, margin: float
) -> int:
    """Return how many beams of the scan pass inside the outline of a box at ``pose`` (3,) and end behind.

    ``margin``: range beyond the box's side that noise does not explain, m. One beam spacing within the
    outline is left out.
    """
    expected, outline = predict_scan(pose[np.newaxis], box, angles)
    spacing = angles[1] - angles[0]
    inside = (angles > outline[0, 0] + spacing) & (angles < outline[0, 1] - spacing)
    return int(np.count_nonzero(inside & (ranges > expected[0] + 0.5 * box.width + margin)))


def _log_likelihood(poses: FloatArray, box: Rectangle, beams: Beams, range_stddev: float) -> FloatArray:
    """Return the log likelihood at poses (M, 3), up to a constant: ranges with Huber tails, uniform ends."""
    squares, outline = range_costs(poses, fit_input(box, beams, range_stddev))
    intervals = np.array([beams.right, beams.left])
    soft = EDGE_SOFTNESS * beams.spacing
    inside = log_ndtr((outline - intervals[:, 0]) / soft) + log_ndtr((intervals[:, 1] - outline) / soft)
    total: FloatArray = inside.sum(axis=1) - 0.5 * squares.sum(axis=1)
    return total


def compile_fit() -> None:
    """Compile the fit by fitting a box in front of the laser; fast if the compiled code is cached."""
    box, stddev, angles = Rectangle(1.0, 1.0), 0.01, np.linspace(-0.1, 0.1, 5)
    (ranges,), _ = predict_scan(np.array([[5.0, 0.0, 0.0]]), box, angles)
    beams = object_beams(np.arange(5), ranges, angles, box.diagonal, 3.0 * stddev)
    start = likely_starting_poses(np.zeros(1), box, beams, stddev)[0]
    posterior(fit_pose(start, box, beams, stddev), 0.0, box, beams, stddev)


@cache
def _student_samples() -> tuple[FloatArray, FloatArray]:
    """Return points (M, 3) of a widened Student distribution, and their log density (M,) up to a constant."""
    golden = 1.1673039782614187  # root of g⁵ = g + 1: steps of 1/g, … 1/g⁴ fill the unit cube evenly
    uniform = (0.5 + np.outer(np.arange(1, SAMPLES + 1), golden ** -np.arange(1.0, 5.0))) % 1.0
    radius2 = 2.0 / DEGREES_OF_FREEDOM * gammaincinv(0.5 * DEGREES_OF_FREEDOM, uniform[:, 3])
    points = ndtri(uniform[:, :3]) / np.sqrt(radius2)[:, np.newaxis]
    log_density = -0.5 * (DEGREES_OF_FREEDOM + 3.0) * np.log1p((points**2).sum(axis=1) / DEGREES_OF_FREEDOM)
    return WIDENING * points, log_density
