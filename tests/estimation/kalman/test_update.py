# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Algebra of the filters, without a vehicle."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.linear_algebra import (
    joseph,
    log_determinant,
    multiply,
    multiply_vector,
    root,
    sandwich,
    solve,
    weighted_square,
    wrap,
)
from trackslip_estimation.kalman.propagate import propagate_covariance
from trackslip_estimation.kalman.update import (
    Observation,
    correct,
    independent_observation,
    inflate_noise_to_gate,
    predicted_covariance,
)


def spd(rng: np.random.Generator, n: int, scale: float = 1.0) -> FloatArray:
    """A random covariance with eigenvalues over four decades."""
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    P: FloatArray = np.ascontiguousarray(scale * (q * 10.0 ** rng.uniform(-4.0, 0.0, n)) @ q.T)
    return (P + P.T) / 2.0


@given(st.floats(-50.0, 50.0))
def test_a_wrapped_angle_is_the_same_angle_within_a_turn(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("angle", "expected"),
    [
        (0.0, 0.0),
        (math.pi, math.pi),
        (-math.pi, math.pi),
        (3.5, 3.5 - 2 * math.pi),
        (-7.0, 2 * math.pi - 7.0),
    ],
)
def test_wrap_is_half_open_at_pi(angle: float, expected: float) -> None:
    assert wrap(angle) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_compiled_algebra_is_that_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B, v = rng.normal(size=(3, 7)), rng.normal(size=(7, 4)), rng.normal(size=7)
    A[rng.random(A.shape) < 0.5] = 0.0
    P, S = spd(rng, 7), spd(rng, 3)
    np.testing.assert_allclose(multiply(A, B), A @ B, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(multiply_vector(A, v), A @ v, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(sandwich(A, P), A @ P @ A.T, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(sandwich(A, P), sandwich(A, P).T)
    np.testing.assert_allclose(solve(root(S), A), np.linalg.solve(S, A), rtol=1e-9)
    assert weighted_square(root(S), v[:3].copy()) == pytest.approx(v[:3] @ np.linalg.solve(S, v[:3]))
    np.testing.assert_allclose(root(P), np.linalg.cholesky(P), rtol=0.0, atol=1e-12)
    assert log_determinant(root(S)) == pytest.approx(np.linalg.slogdet(S)[1])
    K, keep = rng.normal(size=(7, 3)), np.eye(7)
    H = A.copy()
    keep -= K @ H
    np.testing.assert_allclose(joseph(P, K, H, S), keep @ P @ keep.T + K @ S @ K.T, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("seed", range(2))
def test_the_covariance_is_propagated_as_by_numpy(seed: int) -> None:
    """F is full in its first rows and diagonal below: a pose driven by states that decay."""
    rng, n, coupled = np.random.default_rng(seed), 7, 3
    F = np.diag(rng.normal(size=n))
    F[:coupled] = rng.normal(size=(coupled, n)) * (rng.random((coupled, n)) < 0.7)
    P, Q = spd(rng, n), spd(rng, n)
    expected = F @ P @ F.T + Q
    propagate_covariance(P, F, Q, coupled)
    np.testing.assert_allclose(P, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_the_root_of_a_covariance_without_full_rank() -> None:
    """One state without variance, and two that are equal: Cholesky fails."""
    A = np.array(((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.5, 0.0)))
    P = A @ A.T
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(P)
    np.testing.assert_allclose(root(P) @ root(P).T, P, atol=1e-12)


def test_variance_lost_to_rounding_counts_as_zero() -> None:
    P = np.array(((1.0, 1.0), (1.0, 1.0 - 1e-16)))
    np.testing.assert_array_equal(root(P), ((1.0, 0.0), (1.0, 0.0)))
    np.testing.assert_array_equal(solve(root(P), np.ones((2, 1))), ((1.0,), (0.0,)))


def test_update_of_one_number_by_hand() -> None:
    """Prior 1 ± 2 and reading 3 ± 1: gain 4/5."""
    x, P = np.ones(1), np.array(((4.0,),))
    assert predicted_covariance(P, np.eye(1)) == pytest.approx(4.0)
    correct(x, P, independent_observation(np.array((2.0,)), np.eye(1), np.eye(1)))
    assert x[0] == pytest.approx(1.0 + 2.0 * 4.0 / 5.0)
    assert P[0, 0] == pytest.approx(4.0 / 5.0)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(2))
def test_joseph_is_the_optimal_form_and_the_information_form(m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, P = rng.normal(size=5), spd(rng, 5)
    nu, H, R = rng.normal(size=m), rng.normal(size=(m, 5)), spd(rng, m)
    mean, covariance = x.copy(), P.copy()
    correct(mean, covariance, independent_observation(nu, H, R))
    S = H @ P @ H.T + R
    np.testing.assert_allclose(predicted_covariance(P, H) + R, S, rtol=1e-12)
    K = P @ H.T @ np.linalg.inv(S)
    keep = np.eye(5) - K @ H
    np.testing.assert_allclose(covariance, keep @ P @ keep.T + K @ R @ K.T, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(mean, x + K @ nu, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(covariance, P - K @ S @ K.T, atol=1e-10)
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(covariance @ information, np.eye(5), atol=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_covariance_stays_symmetric_and_positive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, P = np.zeros(4), spd(rng, 4, 10.0 ** rng.uniform(-6.0, 4.0))
    for _ in range(30):
        if rng.random() < 0.5:
            P = sandwich(np.eye(4) + 0.2 * rng.normal(size=(4, 4)), P) + spd(rng, 4, 1e-3)
        m = int(rng.integers(1, 4))
        trace = np.trace(P)
        correct(x, P, independent_observation(rng.normal(size=m), rng.normal(size=(m, 4)), spd(rng, m)))
        assert np.trace(P) <= trace * (1.0 + 1e-9)
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0.0


def test_precise_measurement_leaves_a_positive_covariance() -> None:
    """P − K S Kᵀ would lose all its digits."""
    P = np.array(((1e8, 1e8 - 1.0), (1e8 - 1.0, 1e8)))
    correct(
        np.zeros(2), P, independent_observation(np.zeros(1), np.array(((1.0, 0.0),)), np.array(((1e-8,),)))
    )
    assert np.linalg.eigvalsh(P)[0] > 0.0
    assert P[0, 0] == pytest.approx(1e-8, rel=0.2)


@pytest.mark.parametrize("considered", [0, 1 << 2])
@pytest.mark.parametrize("is_correlated", [True, False])
def test_noise_equals_augmented_states_and_considered_states_stay(
    considered: int, *, is_correlated: bool
) -> None:
    """Against the update of the augmented state with a noise-free measurement."""
    random = np.random.default_rng(4)
    n, m = 5, 2
    root_of_joint = random.standard_normal((n + m, n + m))
    joint = root_of_joint @ root_of_joint.T + 10.0 * np.eye(n + m)
    H = random.standard_normal((m, n))
    if not is_correlated:
        joint[n:, :n] = joint[:n, n:] = 0.0
    P, C, R = joint[:n, :n].copy(), joint[n:, :n].copy(), joint[n:, n:].copy()
    innovation, whole = random.standard_normal(m), np.column_stack((H, np.eye(m)))
    K = joint @ whole.T @ np.linalg.inv(whole @ joint @ whole.T)
    if considered:
        K[2] = 0.0
    keep = np.eye(n + m) - K @ whole
    x = np.zeros(n)
    correct(x, P, Observation(innovation, H, R, considered, 0, C if is_correlated else np.zeros((0, n))))
    np.testing.assert_allclose(x, (K @ innovation)[:n], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(P, (keep @ joint @ keep.T)[:n, :n], rtol=1e-9, atol=1e-9)
    assert not considered or P[2, 2] == joint[2, 2]


@pytest.mark.parametrize("size", [1.0, 10.0])
def test_soft_gate_limits_the_nis(size: float) -> None:
    rng = np.random.default_rng(6)
    predicted, R, nu, limit = spd(rng, 2), spd(rng, 2), size * np.array((1.0, -0.5)), 9.0
    stated = R.copy()
    inflate_noise_to_gate(R, nu, predicted, limit)
    before = nu @ np.linalg.solve(predicted + stated, nu)
    after = nu @ np.linalg.solve(predicted + R, nu)
    assert after == pytest.approx(min(before, limit))
    assert (np.diag(R) >= np.diag(stated)).all()


def schmidt_update(P: FloatArray, H: FloatArray, R: FloatArray, known: int) -> tuple[FloatArray, FloatArray]:
    """x and P after an update of a zero state with innovations of 0.3."""
    x, P = np.zeros(len(P)), P.copy()
    correct(x, P, Observation(np.full(len(H), 0.3), H, R, 0, known, np.zeros((0, len(P)))))
    return x, P


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("known", [(2, 4), (4,), (1, 2, 4)])
def test_known_states_keep_their_moments_and_the_rest_is_corrected_given_them(
    seed: int, known: tuple[int, ...], m: int
) -> None:
    rng = np.random.default_rng(seed)
    P, H, R = spd(rng, 6), rng.normal(size=(m, 6)), spd(rng, m)
    x, after = schmidt_update(P, H, R, sum(1 << k for k in known))
    rest = [k for k in range(6) if k not in known]
    assert not x[list(known)].any()
    np.testing.assert_array_equal(after[np.ix_(known, known)], P[np.ix_(known, known)])
    conditional = P - P[:, known] @ np.linalg.inv(P[np.ix_(known, known)]) @ P[list(known)]
    h = H[:, rest]
    K = np.zeros((6, m))
    conditional = conditional[np.ix_(rest, rest)]
    K[rest] = conditional @ h.T @ np.linalg.inv(h @ conditional @ h.T + R)
    np.testing.assert_allclose(x, K @ np.full(m, 0.3), rtol=1e-7, atol=1e-12)
    keep = np.eye(6) - K @ H
    np.testing.assert_allclose(after, keep @ P @ keep.T + K @ R @ K.T, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("known", [1 << 2 | 1 << 4, 0])
def test_zero_variances_are_no_special_case(known: int) -> None:
    rng = np.random.default_rng(7)
    P, H, R = spd(rng, 6), rng.normal(size=(1, 6)), np.array(((0.01,),))
    if known:
        P[2] = P[:, 2] = P[4] = P[:, 4] = 0.0
    x, after = schmidt_update(P, H, R, known)
    y, plain = schmidt_update(P, H, R, 0)
    np.testing.assert_allclose(x, y, rtol=1e-12)
    np.testing.assert_allclose(after, plain, rtol=1e-12, atol=1e-15)


def test_two_identical_known_states_count_once() -> None:
    rng = np.random.default_rng(8)
    P, H, R = spd(rng, 6), rng.normal(size=(1, 6)), np.array(((0.01,),))
    P[4], H[0, 4] = P[2], 0.0
    P[:, 4] = P[:, 2]
    P[4, 4] = P[2, 2]
    x, after = schmidt_update(P, H, R, 1 << 2 | 1 << 4)
    one, without = schmidt_update(P, H, R, 1 << 2)
    np.testing.assert_allclose(np.delete(x, 4), np.delete(one, 4), rtol=1e-9, atol=1e-12)
    assert np.isfinite(after).all()
    assert np.isfinite(without).all()
