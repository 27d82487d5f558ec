# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The smoother against the batch solution of a linear Gaussian problem, and with the models; angles."""

import math

import numpy as np
import pytest
from fixtures.filter_steps import (
    Drive,
    FilterStep,
    Gaussian,
    Measured,
    config_of,
    differences,
    filter_step,
    moved,
    start_of,
    transition,
)

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.smoother import smooth_step
from trackslip_estimation.slip.config import ConfigRecord
from trackslip_estimation.slip.models.model import POSE, YAW
from trackslip_estimation.slip.motion import Motion

DT, COUNT = 0.1, 60
F = np.array(((1.0, DT, DT), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))  # position, speed, and a constant known speed
ANGLE = 1  # index of an angle; the speed stays far from π
DRIFT = 0.3  # that constant speed, m/s
NOISE = np.array((DT**2 / 2.0, DT, 0.0))  # gain of the only noise: Q has rank 1
START, SPREAD = np.array((1.0, -0.5, DRIFT)), np.diag((0.5**2, 0.2**2, 0.0))
SIGMA = 0.4  # m, of measured positions
HAS_FIX = np.array([k % 3 != 1 and not 25 <= k < 45 for k in range(COUNT)])  # gaps, and one long outage


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
    columns: list[list[FloatArray]] = [[], [], [], []]
    x, P = START, SPREAD
    for k in range(COUNT):
        if k:
            x, P = F @ x, F @ P @ F.T + np.outer(NOISE, NOISE)
        before = (x, P)
        if HAS_FIX[k]:
            gain = P[:, 0] / (P[0, 0] + SIGMA**2)
            x, P = x + gain * (measured[k] - x[0]), P - np.outer(gain, P[0])
        for column, value in zip(columns, (x, P, *before), strict=True):
            column.append(value)
    x, P, x_before, P_before = (np.array(column) for column in columns)
    return x, P, x_before, P_before


def batch(measured: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, 3) means and (k, 3, 3) covariances of all states at once, given the measurements."""
    mean = np.concatenate([np.linalg.matrix_power(F, k) @ START for k in range(COUNT)])
    columns = []
    for direction in np.sqrt(SPREAD):
        columns.append(np.concatenate([np.linalg.matrix_power(F, k) @ direction for k in range(COUNT)]))
    for j in range(1, COUNT):
        responses = [np.linalg.matrix_power(F, k - j) @ NOISE for k in range(j, COUNT)]
        columns.append(np.concatenate((np.zeros(3 * j), *responses)))
    prior = np.stack(columns, axis=-1) @ np.stack(columns)
    H = np.eye(3 * COUNT)[0::3][HAS_FIX]
    S = H @ prior @ H.T + SIGMA**2 * np.eye(len(H))
    K = np.linalg.solve(S, H @ prior).T
    mean = mean + K @ (measured[HAS_FIX] - H @ mean)
    whole = prior - K @ H @ prior
    blocks = [whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(COUNT)]
    return mean.reshape(-1, 3), np.array(blocks)


def smooth_back(
    states: tuple[FloatArray, ...], transitions: FloatArray, angle: int
) -> tuple[FloatArray, FloatArray]:
    """(k, n) smoothed means and (k, n, n) covariances from the filter's x, P, x⁻, P⁻."""
    x, P, x_before, P_before = states
    smoothed = (x[-1], P[-1])
    estimates = [smoothed]
    for k in range(len(x) - 1, 0, -1):
        smoothed = smooth_step(
            (x[k - 1], P[k - 1]), (x_before[k], P_before[k]), smoothed, transitions[k], angle
        )
        estimates.append(smoothed)
    means, covariances = zip(*reversed(estimates), strict=True)
    return np.array(means), np.array(covariances)


TRANSITIONS = np.tile(F, (COUNT, 1, 1))


def test_equals_the_batch_solution_with_singular_noise_and_a_certain_state(
    measured: FloatArray, filtered: tuple[FloatArray, ...]
) -> None:
    means, covariances = smooth_back(filtered, TRANSITIONS, ANGLE)
    expected, expected_covariances = batch(measured)
    np.testing.assert_allclose(means, expected, atol=1e-9)
    np.testing.assert_allclose(covariances, expected_covariances, atol=1e-9)
    np.testing.assert_allclose(means[:, 2], DRIFT, atol=1e-12)
    np.testing.assert_array_equal(covariances[:, 2], 0.0)


@pytest.fixture(scope="module", params=["turning", "icr", "free_slips"])
def config(request: pytest.FixtureRequest) -> ConfigRecord:
    return config_of(model=request.param)


DRIVE = Drive(1.0, 2.0, Motion.TURNING, departure=1.0)


def steps(config: ConfigRecord, heading: float) -> list[FilterStep]:
    """A turn that starts at ``heading`` with a wide prior and ends with a fix."""
    state = start_of(config, np.array((0.0, 0.0, heading)), np.diag((0.1, 0.1, 0.1)))
    history = [FilterStep(state, state)]
    speeds, motion = DRIVE.parts
    for k in range(10):
        before = state = filter_step(config, state, speeds, 0.1, motion, Measured()).predicted
        if k == 9:
            c, s = math.cos(heading), math.sin(heading)
            state = _corrected(state, np.array((0.3 * c - 0.1 * s, 0.3 * s + 0.1 * c, heading + 0.4)))
        history.append(FilterStep(before, state))
    return history


def _corrected(state: Gaussian, pose: FloatArray) -> Gaussian:
    """The state after a pose update of 1 mm and 1 mrad."""
    x, P = state
    K = np.linalg.solve(P[POSE, POSE] + 1e-6 * np.eye(3), P[POSE]).T
    innovation = pose - x[POSE]
    innovation[YAW] = math.remainder(innovation[YAW], 2.0 * math.pi)
    x = x + K @ innovation
    x[YAW] = math.remainder(x[YAW], 2.0 * math.pi)
    return Gaussian(x, P - K @ P[POSE])


def smoothed_means(history: list[FilterStep], transitions: FloatArray) -> tuple[FloatArray, FloatArray]:
    parts = (
        zip(*(step.updated for step in history), strict=True),
        zip(*(s.predicted for s in history), strict=True),
    )
    states = tuple(np.array(column) for part in parts for column in part)
    return smooth_back(states, transitions, YAW)


def transitions_of(history: list[FilterStep], config: ConfigRecord) -> FloatArray:
    """(k, n, n) F of each step; the first is not used."""
    transitions = [transition(step.updated.mean, DRIVE, 0.1, config) for step in history[:-1]]
    return np.array([np.eye(len(transitions[0])), *transitions])


def test_the_direction_of_the_site_frame_changes_nothing(config: ConfigRecord) -> None:
    """A turn across ±π and one far from it, half a turn apart, give the same result, turned."""
    across, along = (
        smoothed_means(history, transitions_of(history, config))[0]
        for history in (steps(config, math.pi - 0.05), steps(config, -0.05))
    )
    for a, b in zip(across, along, strict=True):
        assert math.remainder(a[YAW] - b[YAW] - math.pi, 2.0 * math.pi) == pytest.approx(0, abs=1e-9)
        assert -math.pi < a[YAW] <= math.pi
        np.testing.assert_allclose(a[:YAW], -b[:YAW], atol=1e-9)
        np.testing.assert_allclose(a[YAW + 1 :], b[YAW + 1 :], atol=1e-9)
    assert along[0][YAW] > 0.1, "the fix at the end turns the start too"


def test_smoother_uses_the_transition_of_the_filter_steps(config: ConfigRecord) -> None:
    """F from differences of the filter's prediction gives the same result."""
    history = steps(config, 0.3)
    transitions = [np.eye(history[0].updated.mean.size)]
    for before in history[:-1]:
        transitions.append(differences(lambda x: moved(x, DRIVE, 0.1, config), before.updated.mean))
    means, covariances = smoothed_means(history, np.array(transitions))
    expected, expected_covariances = smoothed_means(history, transitions_of(history, config))
    np.testing.assert_allclose(means, expected, atol=1e-6)
    np.testing.assert_allclose(covariances, expected_covariances, atol=1e-6)
