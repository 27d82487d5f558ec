# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The filter of the thesis (Fig. 4.3): equal to the Kalman filter on linear models, consistent, definite."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from fixtures.filter_steps import (
    STANDSTILL,
    Drive,
    Gaussian,
    Measured,
    config_of,
    expected,
    filter_step,
    gaussian_of,
    moved,
    observed,
    pose_measured,
    process_noise,
    rate_measured,
    start_of,
    state_of,
    transition,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman import daf
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.config import ConfigRecord
from trackslip_estimation.slip.models.dispatch import MODELS
from trackslip_estimation.slip.models.model import SIZE, YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.records import YAW_RATE
from trackslip_estimation.slip.step import propagate

TURNING = MotionState(
    Motion.TURNING, changing=True, departure=1e-9
)  # rad/s: above 0, so that speeds are not low-passed

models = pytest.mark.parametrize("model", list(MODELS))
kappas = pytest.mark.parametrize("kappa", [-4.0, 0.0, 2.0])


def with_kappa(kappa: float | None) -> dict[str, Any]:
    """Parameters of the DAF, or of the EKF for None."""
    return {"filter": "ekf"} if kappa is None else {"filter": "daf", "kappa": kappa}


CONFIGS = {
    (name, kappa): config_of(with_kappa(kappa), model=name)
    for name in MODELS
    for kappa in (None, -4.0, 0.0, 2.0)
}


def covariance(rng: np.random.Generator, n: int, decades: float = 3.0) -> FloatArray:
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P: FloatArray = (q * 10.0 ** rng.uniform(-decades, 0.0, n)) @ q.T
    return np.ascontiguousarray(P + P.T) / 2.0


@kappas
@pytest.mark.parametrize("n", [7, 10])
def test_sigma_points_have_mean_and_covariance_of_the_state(kappa: float, n: int) -> None:
    rng = np.random.default_rng(n)
    x, P = rng.normal(size=n), covariance(rng, n)
    points, weights = daf.sigma_points(x, P, kappa, n)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ points, x, atol=1e-12)
    np.testing.assert_allclose((points - x).T @ ((points - x) * weights[:, np.newaxis]), P, atol=1e-12)
    mean, departures, w = daf.moments(points, weights, YAW)
    np.testing.assert_allclose(mean, x, atol=1e-12)
    np.testing.assert_allclose((departures * w) @ departures.T, P, atol=1e-12)


@kappas
def test_mean_of_a_square_is_exact(kappa: float) -> None:
    """E x² = x̄² + σ² for any κ; the first-order EKF lacks σ²."""
    points, weights = daf.sigma_points(np.array((3.0, 0.0, 0.0, 0.0, 0.0)), np.eye(5) * 0.25, kappa, 5)
    squares = np.ascontiguousarray(np.square(points[:, :1]))
    assert daf.moments(squares, weights, YAW)[0][0] == pytest.approx(9.25)


@pytest.mark.parametrize("angle", [math.pi, -math.pi + 0.01, 3.0])
def test_headings_are_averaged_over_the_shorter_arc(angle: float) -> None:
    points, weights = daf.sigma_points(np.array((0.0, 0.0, angle)), np.eye(3) * 0.04, 0.0, 3)
    points[:, YAW] = [wrap(a) for a in points[:, YAW]]
    mean, departures, w = daf.moments(points, weights, YAW)
    assert wrap(mean[YAW] - angle) == pytest.approx(0.0, abs=1e-12)
    assert (departures[YAW] ** 2 * w).sum() == pytest.approx(0.04)


@models
@kappas
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_daf_equals_the_ekf_for_linear_measurements(model: str, kappa: float, seed: int) -> None:
    """Poses are linear in every state: the update equals that of the EKF."""
    rng = np.random.default_rng(seed)
    n = MODELS[model].ACTIVE
    prior = Gaussian(np.zeros(SIZE), np.zeros((SIZE, SIZE)))
    prior.mean[:n], prior.covariance[:n, :n] = rng.normal(size=n) * 0.3, covariance(rng, n) * 0.1
    fix = pose_measured(prior.mean[:3] + rng.normal(size=3) * 0.3, covariance(rng, 3) * 0.1, seed % 2 == 0)
    one, other = (
        filter_step(CONFIGS[model, k], prior, STANDSTILL, 0.0, MotionState(), fix) for k in (kappa, None)
    )
    np.testing.assert_allclose(one.updated.mean, other.updated.mean, atol=1e-10)
    np.testing.assert_allclose(one.updated.covariance, other.updated.covariance, atol=1e-10)
    assert one.nis == pytest.approx(other.nis)


@kappas
def test_a_linear_step_makes_it_the_kalman_filter(kappa: float) -> None:
    """Straight on at a known heading: P' = F P Fᵀ + Q."""
    config, dt, drive = CONFIGS["turning", kappa], 0.2, Drive(1.0, 1.0, departure=0.5)
    P = np.zeros((SIZE, SIZE))
    P[X, X], P[Y, Y], P[SPEED_ERROR, SPEED_ERROR] = 0.1, 0.2, 0.3
    prior = Gaussian(np.array((1.0, 2.0, 0.7, 0.0, 0.5, *np.zeros(SIZE - 5))), P)
    state = state_of(prior, *drive.parts)
    propagate(state[0], dt, config[0])
    F, Q = transition(prior.mean, drive, dt, config), process_noise(*prior, drive, dt, config)
    predicted = gaussian_of(state[0])
    np.testing.assert_allclose(predicted.mean, moved(prior.mean, drive, dt, config), atol=1e-12)
    np.testing.assert_allclose(predicted.covariance, F @ P @ F.T + Q, atol=1e-12)
    assert Q[SPEED_ERROR, SPEED_ERROR] > 0.0


@models
@kappas
@settings(max_examples=4)
@given(seed=st.integers(0, 2**32 - 1))
def test_covariance_stays_symmetric_and_positive(model: str, kappa: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    config, n = CONFIGS[model, kappa], MODELS[model].ACTIVE
    state = start_of(config, rng.normal(size=3), covariance(rng, 3, 6.0))
    for _ in range(60):
        measured = measurement(rng)
        left, right = rng.uniform(-4.0, 4.0, 2).tolist()
        speeds = Speeds(left, right, float(rng.choice((0.0, 4e-4))))
        motion = MotionState(Motion(int(rng.integers(4))), changing=bool(rng.random() < 0.5))
        state = filter_step(
            config, state, speeds, float(rng.choice((0.0, 0.01, 0.3))), motion, measured
        ).updated
        assert np.isfinite(state.mean).all()
        assert -math.pi <= state.mean[YAW] <= math.pi
        np.testing.assert_array_equal(state.covariance, state.covariance.T)
        np.testing.assert_array_equal(state.covariance[n:], 0.0)
        active = state.covariance[:n, :n]
        deviations = np.sqrt(np.diag(active))
        correlation = active / np.outer(deviations, deviations)
        assert np.linalg.eigvalsh(correlation)[0] > -1e-12


def measurement(rng: np.random.Generator) -> Measured:
    """A random measurement of any kind and variance."""
    kind = rng.integers(3)
    if kind == 0:
        return Measured()
    if kind == 1:
        return rate_measured(float(rng.normal()), 10.0 ** rng.uniform(-8.0, 0.0))
    R = covariance(rng, 3, 6.0) * 10.0 ** rng.uniform(-4.0, 1.0)
    return pose_measured(rng.normal(size=3), R, bool(rng.random() < 0.5))


NEAR = {"icr.initial_centre_stddev": 0.05, "icr.centre": 0.01}  # away from the point where the centres meet


@pytest.mark.slow
@models
@pytest.mark.parametrize("kappa", [None, 0.0, -4.0])
def test_daf_is_consistent_on_its_own_model(model: str, kappa: float | None) -> None:
    """Truth drawn from the model, 60 seeds: mean NEES of the whole state within its 99.8 % bounds."""
    config, n = config_of({"model": model, **NEAR}, with_kappa(kappa)), MODELS[model].ACTIVE
    nees = []
    for start, steps, truth in _drives(model):
        state = start
        for speeds, measured in steps:
            state = filter_step(config, state, speeds, 0.05, TURNING, measured).updated
        error = state.mean - truth
        error[YAW] = wrap(error[YAW])
        nees.append(error[:n] @ np.linalg.solve(state.covariance[:n, :n], error[:n]))
    low, high = chi2.ppf((1e-3, 1.0 - 1e-3), n * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


@cache
def _drives(model: str) -> list[tuple[Gaussian, list[tuple[Speeds, Measured]], FloatArray]]:
    """Start, steps and true end of 60 drives."""
    config = config_of({"model": model, **NEAR})
    start = start_of(config, np.zeros(3), np.diag((0.05, 0.05, 0.02)) ** 2)
    drives = []
    for seed in range(60):
        rng, steps = np.random.default_rng(seed), []
        truth = start.mean + rng.normal(size=SIZE) * np.sqrt(np.diag(start.covariance))
        for k in range(100):
            left, right = 2.0 + 0.8 * math.sin(k / 10.0), 2.0 - 0.8 * math.sin(k / 10.0)
            drive = Drive(left, right, *TURNING[:2], departure=TURNING.departure)
            Q = process_noise(truth, np.zeros((SIZE, SIZE)), drive, 0.05, config)
            truth = moved(truth, drive, 0.05, config) + rng.normal(size=SIZE) @ _root(Q)
            speeds = Speeds(left, right)
            steps.append((speeds, _measured(k, truth, speeds, config, rng)))
        drives.append((start, steps, truth))
    return drives


def _root(Q: FloatArray) -> FloatArray:
    """(n, n) A with Aᵀ A = Q; Q may be singular."""
    values, vectors = np.linalg.eigh(Q)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
    return root


def _measured(
    k: int, truth: FloatArray, speeds: Speeds, config: ConfigRecord, rng: np.random.Generator
) -> Measured:
    """A fix at every tenth step, otherwise a gyro reading, with their stated noise."""
    if k % 10 == 9:
        R = np.diag((0.03, 0.03, 0.02)) ** 2
        return pose_measured(truth[:3] + rng.normal(size=3) @ np.sqrt(R), R, True)
    state = state_of(Gaussian(truth, np.zeros((SIZE, SIZE))), speeds, TURNING)
    R = observed(state[0], rate_measured(0.0, 1e-4), config[0]).noise
    rate = expected(YAW_RATE, truth, 1, (speeds.left, speeds.right), config[0])[0]
    return rate_measured(float(rate + rng.normal() * math.sqrt(R[0, 0])), 1e-4)
