# SPDX-License-Identifier: Apache-2.0
"""The smoother against the batch solution of a linear Gaussian problem; headings and breaks."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from trackslip_estimation.slip.filter import Filter

from trackslip_estimation.kalman.smoother import Step, smooth, smooth_back
from trackslip_estimation.slip.models.model import DRIVEN, POSE, YAW, Gaussian
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters, make_filter

FloatArray = NDArray[np.float64]

DT, COUNT = 0.1, 60
F = np.array(((1.0, DT, DT), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))  # position, speed, and a speed known exactly
DRIFT = 0.3  # that speed, m/s
NOISE = np.array((DT**2 / 2.0, DT, 0.0))  # what one random number does: Q has rank 1
START, SPREAD = np.array((1.0, -0.5, DRIFT)), np.diag((0.5**2, 0.2**2, 0.0))
SIGMA = 0.4  # of each measured position, m
SEEN = np.array([k % 3 != 1 and not 25 <= k < 45 for k in range(COUNT)])  # gaps, and one long outage


@pytest.fixture(scope="module")
def measured() -> FloatArray:
    rng = np.random.default_rng(7)
    x = rng.multivariate_normal(START, SPREAD)
    z = np.empty(COUNT)
    for k in range(COUNT):
        x = F @ x + NOISE * rng.normal() if k else x
        z[k] = x[0] + SIGMA * rng.normal()
    return z


@pytest.fixture(scope="module")
def filtered(measured: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """x, P, x⁻, P⁻ of the textbook filter."""
    found: list[list[FloatArray]] = [[], [], [], []]
    x, P = START, SPREAD
    for k in range(COUNT):
        if k:
            x, P = F @ x, F @ P @ F.T + np.outer(NOISE, NOISE)
        before = (x, P)
        if SEEN[k]:
            gain = P[:, 0] / (P[0, 0] + SIGMA**2)
            x, P = x + gain * (measured[k] - x[0]), P - np.outer(gain, P[0])
        for column, value in zip(found, (x, P, *before), strict=True):
            column.append(value)
    x, P, x_before, P_before = (np.array(column) for column in found)
    return x, P, x_before, P_before


def batch(measured: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, 3) means and (k, 3, 3) covariances of all states at once, given what was seen."""
    mean = np.concatenate([np.linalg.matrix_power(F, k) @ START for k in range(COUNT)])
    columns = []
    for direction in np.sqrt(SPREAD):
        columns.append(np.concatenate([np.linalg.matrix_power(F, k) @ direction for k in range(COUNT)]))
    for j in range(1, COUNT):
        later = [np.linalg.matrix_power(F, k - j) @ NOISE for k in range(j, COUNT)]
        columns.append(np.concatenate((np.zeros(3 * j), *later)))
    prior = np.stack(columns, axis=-1) @ np.stack(columns)
    H = np.eye(3 * COUNT)[0::3][SEEN]
    S = H @ prior @ H.T + SIGMA**2 * np.eye(len(H))
    K = np.linalg.solve(S, H @ prior).T
    mean = mean + K @ (measured[SEEN] - H @ mean)
    whole = prior - K @ H @ prior
    blocks = [whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(COUNT)]
    return mean.reshape(-1, 3), np.array(blocks)


def test_equals_the_batch_solution_with_singular_noise_and_a_certain_state(
    measured: FloatArray, filtered: tuple[FloatArray, ...]
) -> None:
    means, covariances = smooth_back(*filtered, np.tile(F, (COUNT, 1, 1)), np.ones(COUNT, dtype=bool))
    expected, expected_covariances = batch(measured)
    np.testing.assert_allclose(means, expected, atol=1e-9)
    np.testing.assert_allclose(covariances, expected_covariances, atol=1e-9)
    np.testing.assert_allclose(means[:, 2], DRIFT, atol=1e-12)
    np.testing.assert_array_equal(covariances[:, 2], 0.0)


def test_knows_more_than_the_filter_everywhere_but_at_the_end(filtered: tuple[FloatArray, ...]) -> None:
    means, covariances = smooth_back(*filtered, np.tile(F, (COUNT, 1, 1)), np.ones(COUNT, dtype=bool))
    gained = filtered[1] - covariances
    assert np.linalg.eigvalsh(gained).min() > -1e-12
    assert (gained[:-1, 0, 0] > 0.0).all()
    np.testing.assert_array_equal(means[-1], filtered[0][-1])
    np.testing.assert_array_equal(covariances[:-1], np.swapaxes(covariances[:-1], 1, 2))


def test_a_break_in_the_chain_keeps_both_sides_apart(filtered: tuple[FloatArray, ...]) -> None:
    follows, k = np.ones(COUNT, dtype=bool), 30
    follows[k] = False
    transitions = np.tile(F, (COUNT, 1, 1))
    means, covariances = smooth_back(*filtered, transitions, follows)
    alone = smooth_back(*(part[:k] for part in filtered), transitions[:k], follows[:k])
    np.testing.assert_array_equal(means[:k], alone[0])
    np.testing.assert_array_equal(covariances[:k], alone[1])
    np.testing.assert_array_equal(means[k - 1], filtered[0][k - 1])


@pytest.fixture(scope="module", params=["turning", "icr", "free_slips"])
def filter_(request: pytest.FixtureRequest) -> Filter:
    return make_filter(load_slip_parameters({"model": request.param}))


def steps(filter_: Filter, heading: float) -> list[Step]:
    """A turn that a vague filter begins at ``heading``; in the end it is told where it is."""
    speeds, motion = Speeds(1.0, 2.0, 0.1, differenced=False), MotionState(Motion.TURNING, changing=False)
    state = filter_.initial(np.array((0.0, 0.0, heading)), np.diag((0.1, 0.1, 0.1)))
    found = [Step(None, state, speeds, Motion.TURNING, 0.0)]
    for k in range(10):
        before = state = filter_.step(state, speeds, 0.1, motion, DRIVEN).predicted
        if k == 9:
            c, s = math.cos(heading), math.sin(heading)
            state = _told(state, np.array((0.3 * c - 0.1 * s, 0.3 * s + 0.1 * c, heading + 0.4)))
        found.append(Step(before, state, speeds, Motion.TURNING, 0.1))
    return found


def _told(state: Gaussian, pose: FloatArray) -> Gaussian:
    """Updated with a pose of 1 mm and 1 mrad."""
    x, P = state
    K = np.linalg.solve(P[POSE, POSE] + 1e-6 * np.eye(3), P[POSE]).T
    news = pose - x[POSE]
    news[YAW] = math.remainder(news[YAW], 2.0 * math.pi)
    x = x + K @ news
    x[YAW] = math.remainder(x[YAW], 2.0 * math.pi)
    return Gaussian(x, P - K @ P[POSE])


def test_the_direction_of_the_site_frame_changes_nothing(filter_: Filter) -> None:
    """Across ±π the same turn is smoothed as anywhere else, turned by half a turn."""
    across = smooth(steps(filter_, math.pi - 0.05), filter_)
    along = smooth(steps(filter_, -0.05), filter_)
    for a, b in zip(across, along, strict=True):
        assert math.remainder(a.mean[YAW] - b.mean[YAW] - math.pi, 2.0 * math.pi) == pytest.approx(
            0, abs=1e-9
        )
        assert -math.pi < a.mean[YAW] <= math.pi
        np.testing.assert_allclose(a.mean[:YAW], -b.mean[:YAW], atol=1e-9)
        np.testing.assert_allclose(a.mean[YAW + 1 :], b.mean[YAW + 1 :], atol=1e-9)
    assert along[0].mean[YAW] > 0.1, "the fix at the end turns the start too"


def test_goes_back_by_the_derivative_of_the_very_steps(filter_: Filter) -> None:
    """F by differences of the filter's own prediction gives the same."""
    taken, edge = steps(filter_, 0.3), 1e-6
    transitions = [np.eye(taken[0].filtered.mean.size)]
    for before, step in pairwise(taken):
        motion = MotionState(step.motion, changing=False)

        def moved(mean: FloatArray, step: Step = step, motion: MotionState = motion) -> FloatArray:
            return filter_.step(
                Gaussian(mean, np.eye(mean.size)), step.speeds, step.dt, motion, DRIVEN
            ).predicted.mean

        mean = before.filtered.mean
        shifts = edge * np.eye(mean.size)
        columns = [(moved(mean + shift) - moved(mean - shift)) / (2.0 * edge) for shift in shifts]
        transitions.append(np.column_stack(columns))
    before = [step.predicted or step.filtered for step in taken]
    parts = zip(*(step.filtered for step in taken), strict=True), zip(*before, strict=True)
    states = [np.array(column) for part in parts for column in part]
    means, covariances = smooth_back(*states, np.array(transitions), np.arange(len(taken)) > 0)
    smoothed = smooth(taken, filter_)
    np.testing.assert_allclose([state.mean for state in smoothed], means, atol=1e-6)
    np.testing.assert_allclose([state.covariance for state in smoothed], covariances, atol=1e-6)


def test_nothing_to_smooth(filter_: Filter) -> None:
    assert smooth([], filter_) == []
