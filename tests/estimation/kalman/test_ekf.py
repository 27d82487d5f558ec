# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The filters' algebra, with no vehicle in it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trackslip_estimation.kalman.ekf import (
    correct,
    correct_knowing,
    correct_shared,
    propagate_covariance,
    variance_of,
)
from trackslip_estimation.kalman.linear_algebra import (
    apply,
    joseph,
    log_determinant,
    root,
    sandwich,
    solve,
    times,
    weighted_square,
    wrap,
)

FloatArray = NDArray[np.float64]


def spd(rng: np.random.Generator, n: int, scale: float = 1.0) -> FloatArray:
    """A random covariance, eigenvalues over four decades."""
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


@pytest.mark.parametrize("seed", range(5))
def test_compiled_algebra_is_that_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B, v = rng.normal(size=(3, 7)), rng.normal(size=(7, 4)), rng.normal(size=7)
    A[rng.random(A.shape) < 0.5] = 0.0
    P, S = spd(rng, 7), spd(rng, 3)
    np.testing.assert_allclose(times(A, B), A @ B, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(apply(A, v), A @ v, rtol=0.0, atol=1e-12)
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


@pytest.mark.parametrize("seed", range(5))
def test_the_covariance_is_propagated_as_by_numpy(seed: int) -> None:
    """F is full in its first rows and diagonal below, as that of a pose driven by states that decay."""
    rng, n, coupled = np.random.default_rng(seed), 7, 3
    F = np.diag(rng.normal(size=n))
    F[:coupled] = rng.normal(size=(coupled, n)) * (rng.random((coupled, n)) < 0.7)
    P, Q = spd(rng, n), spd(rng, n)
    expected = F @ P @ F.T + Q
    propagate_covariance(P, F, Q, coupled)
    np.testing.assert_allclose(P, expected, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(P, P.T)


def test_the_root_of_a_covariance_without_full_rank() -> None:
    """A state that is known, and two that are the same: what Cholesky refuses."""
    A = np.array(((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.5, 0.0)))
    P = A @ A.T
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(P)
    np.testing.assert_allclose(root(P) @ root(P).T, P, atol=1e-12)


def test_a_variance_lost_to_rounding_is_taken_as_none() -> None:
    P = np.array(((1.0, 1.0), (1.0, 1.0 - 1e-16)))
    np.testing.assert_array_equal(root(P), ((1.0, 0.0), (1.0, 0.0)))
    np.testing.assert_array_equal(solve(root(P), np.ones((2, 1))), ((1.0,), (0.0,)))


def test_update_of_one_number_by_hand() -> None:
    """Prior 1 ± 2 and reading 3 ± 1: gain 4/5."""
    x, P = np.ones(1), np.array(((4.0,),))
    nis, log_determinant_of_s = correct(x, P, np.array((2.0,)), np.eye(1), np.eye(1))
    assert log_determinant_of_s == pytest.approx(math.log(5.0))
    assert nis == pytest.approx(4.0 / 5.0)
    assert x[0] == pytest.approx(1.0 + 2.0 * 4.0 / 5.0)
    assert P[0, 0] == pytest.approx(4.0 / 5.0)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_joseph_is_the_optimal_form_and_the_information_form(m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, P = rng.normal(size=5), spd(rng, 5)
    nu, H, R = rng.normal(size=m), rng.normal(size=(m, 5)), spd(rng, m)
    mean, covariance = x.copy(), P.copy()
    nis, log_determinant_of_s = correct(mean, covariance, nu, H, R)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    keep = np.eye(5) - K @ H
    np.testing.assert_allclose(covariance, keep @ P @ keep.T + K @ R @ K.T, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(mean, x + K @ nu, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(covariance, P - K @ S @ K.T, atol=1e-10)
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(covariance @ information, np.eye(5), atol=1e-6)
    assert nis == pytest.approx(nu @ np.linalg.inv(S) @ nu)
    assert log_determinant_of_s == pytest.approx(np.linalg.slogdet(S)[1])


@given(st.integers(0, 2**32 - 1))
def test_covariance_stays_symmetric_and_positive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, P = np.zeros(4), spd(rng, 4, 10.0 ** rng.uniform(-6.0, 4.0))
    for _ in range(30):
        if rng.random() < 0.5:
            P = sandwich(np.eye(4) + 0.2 * rng.normal(size=(4, 4)), P) + spd(rng, 4, 1e-3)
        m = int(rng.integers(1, 4))
        trace = np.trace(P)
        correct(x, P, rng.normal(size=m), rng.normal(size=(m, 4)), spd(rng, m))
        assert np.trace(P) <= trace * (1.0 + 1e-9)
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0.0


def test_a_perfect_reading_leaves_no_negative_variance() -> None:
    """The case in which P − K S Kᵀ loses all its digits."""
    P = np.array(((1e8, 1e8 - 1.0), (1e8 - 1.0, 1e8)))
    correct(np.zeros(2), P, np.zeros(1), np.array(((1.0, 0.0),)), np.array(((1e-8,),)))
    assert np.linalg.eigvalsh(P)[0] > 0.0
    assert P[0, 0] == pytest.approx(1e-8, rel=0.2)


@pytest.mark.parametrize("kept", [-1, 2])
def test_errors_shared_with_the_state_are_as_states_of_their_own(kept: int) -> None:
    """Against the update of the state with those errors in it, the measurement having none beside them."""
    random = np.random.default_rng(4)
    n, m = 5, 2
    root_of_joint = random.standard_normal((n + m, n + m))
    joint = root_of_joint @ root_of_joint.T
    H = np.zeros((m, n))
    H[:, 2:] = random.standard_normal((m, n - 2))
    joint[2:n, n:] = joint[n:, 2:n] = 0.0  # H C = 0: only what H does not show
    joint += 10.0 * np.eye(n + m)
    P, C, R = joint[:n, :n].copy(), joint[:n, n:].copy(), joint[n:, n:].copy()
    innovation, whole = random.standard_normal(m), np.column_stack((H, np.eye(m)))
    K = joint @ whole.T @ np.linalg.inv(whole @ joint @ whole.T)
    if kept >= 0:
        K[kept] = 0.0
    keep = np.eye(n + m) - K @ whole
    x = np.zeros(n)
    correct_shared(x, P, (innovation, R), H, C, kept)
    np.testing.assert_allclose(x, (K @ innovation)[:n], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(P, (keep @ joint @ keep.T)[:n, :n], rtol=1e-9, atol=1e-9)


def corrected_knowing(
    P: FloatArray, H: FloatArray, R: float, known: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """x and P after an innovation of 0.3 from a zero state."""
    x, P = np.zeros(len(P)), P.copy()
    correct_knowing(x, P, 0.3, (H, R), known)
    return x, P


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("known", [(2, 4), (4, 4)])
def test_what_is_known_keeps_mean_and_variance_and_the_rest_is_corrected_given_it(
    seed: int, known: tuple[int, int]
) -> None:
    rng = np.random.default_rng(seed)
    P, H, R = spd(rng, 6), rng.normal(size=6), 0.01
    x, after = corrected_knowing(P, H, R, known)
    kept, rest = sorted(set(known)), [k for k in range(6) if k not in known]
    assert not x[kept].any()
    np.testing.assert_array_equal(after[np.ix_(kept, kept)], P[np.ix_(kept, kept)])
    given = P - P[:, kept] @ np.linalg.inv(P[np.ix_(kept, kept)]) @ P[kept]
    h = H[rest]
    K = np.zeros(6)
    K[rest] = given[np.ix_(rest, rest)] @ h / (h @ given[np.ix_(rest, rest)] @ h + R)
    np.testing.assert_allclose(x, 0.3 * K, rtol=1e-9, atol=1e-12)
    keep = np.eye(6) - np.outer(K, H)
    np.testing.assert_allclose(after, keep @ P @ keep.T + R * np.outer(K, K), rtol=1e-9, atol=1e-12)
    assert variance_of(P, H) == pytest.approx(H @ P @ H)


@pytest.mark.parametrize("known", [(2, 4), (-1, -1)])
def test_what_is_known_for_sure_and_what_is_not_are_no_special_cases(known: tuple[int, int]) -> None:
    rng = np.random.default_rng(7)
    P, H = spd(rng, 6), rng.normal(size=6)
    if known[0] >= 0:
        P[2] = P[:, 2] = P[4] = P[:, 4] = 0.0
    x, after = corrected_knowing(P, H, 0.01, known)
    y, plain = np.zeros(6), P.copy()
    correct(y, plain, np.array((0.3,)), H.reshape(1, -1), np.array(((0.01,),)))
    np.testing.assert_allclose(x, y, rtol=1e-12)
    np.testing.assert_allclose(after, plain, rtol=1e-12, atol=1e-15)


def test_two_known_states_that_are_one_count_once() -> None:
    rng = np.random.default_rng(8)
    P, H = spd(rng, 6), rng.normal(size=6)
    P[4], H[4] = P[2], 0.0
    P[:, 4] = P[:, 2]
    P[4, 4] = P[2, 2]
    x, after = corrected_knowing(P, H, 0.01, (2, 4))
    one, without = corrected_knowing(P, H, 0.01, (2, 2))
    np.testing.assert_allclose(np.delete(x, 4), np.delete(one, 4), rtol=1e-9, atol=1e-12)
    assert np.isfinite(after).all()
    assert np.isfinite(without).all()
