# SPDX-License-Identifier: Apache-2.0
"""The thesis' filter (Fig. 4.3): the Kalman filter where all is linear, honest, never indefinite."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import chi2
from trackslip_estimation.slip.filter import Filter

from trackslip_estimation.kalman import daf
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.model import (
    DRIVEN,
    YAW,
    Gaussian,
    Measured,
    pose_measured,
    rate_measured,
)
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters, make_model

FloatArray = NDArray[np.float64]

MODELS = {
    name: make_model(load_slip_parameters({"model": name})) for name in ("turning", "icr", "free_slips")
}
TURNING = MotionState(Motion.TURNING, changing=True)

each = pytest.mark.parametrize("model", list(MODELS))
kappas = pytest.mark.parametrize("kappa", [-4.0, 0.0, 2.0])


def covariance(rng: np.random.Generator, n: int, decades: float = 3.0) -> FloatArray:
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P: FloatArray = (q * 10.0 ** rng.uniform(-decades, 0.0, n)) @ q.T
    return np.ascontiguousarray(P + P.T) / 2.0


@kappas
@pytest.mark.parametrize("n", [7, 10])
def test_sigma_points_have_the_moments_they_stand_for(kappa: float, n: int) -> None:
    rng = np.random.default_rng(n)
    x, P = rng.normal(size=n), covariance(rng, n)
    points, weights = daf.sigma_points(x, P, kappa)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ points, x, atol=1e-12)
    np.testing.assert_allclose((points - x).T @ ((points - x) * weights[:, np.newaxis]), P, atol=1e-12)
    mean, departures, w = daf.moments(points, weights)
    np.testing.assert_allclose(mean, x, atol=1e-12)
    np.testing.assert_allclose((departures * w) @ departures.T, P, atol=1e-12)


@kappas
def test_a_square_has_the_mean_that_it_has(kappa: float) -> None:
    """What the first order of the EKF lacks: E x² = x̄² + σ², for any κ."""
    points, weights = daf.sigma_points(np.array((3.0, 0.0, 0.0, 0.0, 0.0)), np.eye(5) * 0.25, kappa)
    seen = np.ascontiguousarray(np.square(points[:, :1]))
    assert daf.moments(seen, weights)[0][0] == pytest.approx(9.25)


@pytest.mark.parametrize("angle", [math.pi, -math.pi + 0.01, 3.0])
def test_headings_are_averaged_the_short_way(angle: float) -> None:
    points, weights = daf.sigma_points(np.array((0.0, 0.0, angle)), np.eye(3) * 0.04, 0.0)
    points[:, YAW] = [wrap(a) for a in points[:, YAW]]
    mean, departures, w = daf.moments(points, weights)
    assert wrap(mean[YAW] - angle) == pytest.approx(0.0, abs=1e-12)
    assert (departures[YAW] ** 2 * w).sum() == pytest.approx(0.04)


@each
@kappas
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_linear_measurement_makes_it_the_kalman_filter(model: str, kappa: float, seed: int) -> None:
    """Poses are linear in every state: the update is the EKF's."""
    rng = np.random.default_rng(seed)
    n = MODELS[model].initial(np.zeros(3), np.eye(3)).mean.size
    state = Gaussian(rng.normal(size=n) * 0.3, covariance(rng, n) * 0.1)
    fix = pose_measured(state.mean[:3] + rng.normal(size=3) * 0.3, covariance(rng, 3) * 0.1, seed % 2 == 0)
    still = Speeds(0.0, 0.0, 0.0, differenced=False)
    frozen = MotionState(Motion.UNKNOWN)
    one, other = (Filter(MODELS[model], k).step(state, still, 0.0, frozen, fix) for k in (kappa, None))
    np.testing.assert_allclose(one.updated.mean, other.updated.mean, atol=1e-10)
    np.testing.assert_allclose(one.updated.covariance, other.updated.covariance, atol=1e-10)
    assert one.nis == pytest.approx(other.nis)


@kappas
def test_a_linear_step_makes_it_the_kalman_filter(kappa: float) -> None:
    """Straight on at a known heading: P' = F P Fᵀ + Q."""
    c = Filter(MODELS["turning"], kappa).constants[0]
    n, dt, drive = 10, 0.2, (1.0, 1.0)
    P = np.zeros((n, n))
    P[0, 0], P[1, 1], P[3, 3] = 0.1, 0.2, 0.3  # x, y, m_v
    state = Gaussian(np.array((1.0, 2.0, 0.7, 0.5, *np.zeros(6))), P)
    mean, covariance_ = daf.predict(*state, *drive, dt, 2, 0, 0.5, c)
    F = equations.transition(state.mean, *drive, dt, 2, c)
    Q = equations.process_noise(state.mean, P, *drive, dt, 2, 0, 0.5, c)
    np.testing.assert_allclose(mean, equations.move(state.mean, *drive, dt, 2, c), atol=1e-12)
    np.testing.assert_allclose(covariance_, F @ P @ F.T + Q, atol=1e-12)
    assert Q[3, 3] > 0.0


@each
@kappas
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_covariance_stays_symmetric_and_positive(model: str, kappa: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    filter_ = Filter(MODELS[model], kappa)
    state = filter_.initial(rng.normal(size=3), covariance(rng, 3, 6.0))
    for _ in range(60):
        measured = measurement(rng)
        speeds = Speeds(*rng.uniform(-4.0, 4.0, 2).tolist(), 0.01, differenced=bool(rng.random() < 0.5))
        motion = MotionState(Motion(int(rng.integers(4))), changing=bool(rng.random() < 0.5))
        state = filter_.step(state, speeds, float(rng.choice((0.0, 0.01, 0.3))), motion, measured).updated
        assert np.isfinite(state.mean).all()
        assert -math.pi <= state.mean[YAW] <= math.pi
        np.testing.assert_array_equal(state.covariance, state.covariance.T)
        deviations = np.sqrt(np.diag(state.covariance))
        correlation = state.covariance / np.outer(deviations, deviations)
        assert np.linalg.eigvalsh(correlation)[0] > -1e-12


def measurement(rng: np.random.Generator) -> Measured:
    """One of any kind and of any quality."""
    kind = rng.integers(3)
    if kind == 0:
        return DRIVEN
    if kind == 1:
        return rate_measured(float(rng.normal()), 10.0 ** rng.uniform(-8.0, 0.0))
    R = covariance(rng, 3, 6.0) * 10.0 ** rng.uniform(-4.0, 1.0)
    return pose_measured(rng.normal(size=3), R, bool(rng.random() < 0.5))


@each
@pytest.mark.parametrize("kappa", [None, 0.0, -4.0])
def test_it_is_honest_on_its_own_model(model: str, kappa: float | None) -> None:
    """Truth drawn from the model itself, 60 seeds: mean NEES of the whole state within its 99.8 % bounds."""
    near = {"model": model, "icr.initial_centre_stddev": 0.05, "icr.centre": 0.01}  # far from where they meet
    filter_ = Filter(make_model(load_slip_parameters(near)), kappa)
    c = filter_.constants[0]
    start = filter_.initial(np.zeros(3), np.diag((0.05, 0.05, 0.02)) ** 2)
    n = start.mean.size
    nees = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = rng.multivariate_normal(*start, method="cholesky")
        state = start
        for k in range(100):
            left, right = 2.0 + 0.8 * math.sin(k / 10.0), 2.0 - 0.8 * math.sin(k / 10.0)
            Q = equations.process_noise(truth, np.zeros((n, n)), left, right, 0.05, 3, 1, 0.0, c)
            truth = equations.move(truth, left, right, 0.05, 3, c) + rng.normal(size=n) @ _root(Q)
            seen = _seen(k, truth, left, right, c, rng)
            state = filter_.step(state, Speeds(left, right, 0.05, True), 0.05, TURNING, seen).updated
        error = state.mean - truth
        error[YAW] = wrap(error[YAW])
        nees.append(error @ np.linalg.solve(state.covariance, error))
    low, high = chi2.ppf((1e-3, 1.0 - 1e-3), n * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


def _root(Q: FloatArray) -> FloatArray:
    """(n, n) A with Aᵀ A = Q, which may be singular."""
    values, vectors = np.linalg.eigh(Q)
    root: FloatArray = np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T
    return root


def _seen(
    k: int, truth: FloatArray, left: float, right: float, c: np.void, rng: np.random.Generator
) -> Measured:
    """A fix at every tenth step, else the gyro, with the noise they claim."""
    if k % 10 == 9:
        R = np.diag((0.03, 0.03, 0.02)) ** 2
        return pose_measured(truth[:3] + rng.normal(size=3) @ np.sqrt(R), R, True)
    R = equations.noise(1, truth, np.array(((1e-4,),)), left, right, 0.05, True, c)
    rate = equations.expected(1, truth, left, right, c)[0] + rng.normal() * math.sqrt(R[0, 0])
    return rate_measured(float(rate), 1e-4)
