# SPDX-License-Identifier: Apache-2.0
"""The filter's algebra, with no vehicle in it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trackslip_estimation.filters.ekf import Gaussian, Linearised, predict, update, weigh, wrap

FloatArray = NDArray[np.float64]


def spd(rng: np.random.Generator, n: int, scale: float = 1.0) -> FloatArray:
    """A random covariance, eigenvalues over four decades."""
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return scale * (q * 10.0 ** rng.uniform(-4.0, 0.0, n)) @ q.T


def measurement(rng: np.random.Generator, n: int, m: int) -> Linearised:
    return Linearised(rng.normal(size=m), rng.normal(size=(m, n)), spd(rng, m))


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


def test_prediction_carries_the_covariance_through_f() -> None:
    P, F, Q = np.diag((1.0, 4.0)), np.array(((1.0, 2.0), (0.0, 1.0))), np.diag((0.0, 0.5))
    moved = predict(Gaussian(np.zeros(2), P), np.array((3.0, 1.0)), F, Q)
    np.testing.assert_allclose(moved.mean, (3.0, 1.0))
    np.testing.assert_allclose(moved.covariance, ((17.0, 8.0), (8.0, 4.5)))


def test_update_of_one_number_by_hand() -> None:
    """Prior 1 ± 2 and reading 3 ± 1: gain 4/5."""
    state = Gaussian(np.array((1.0,)), np.array(((4.0,),)))
    seen = Linearised(np.array((2.0,)), np.eye(1), np.eye(1))
    held = weigh(state, seen)
    after = update(state, seen, held)
    assert held.covariance[0, 0] == pytest.approx(5.0)
    assert held.nis == pytest.approx(4.0 / 5.0)
    assert after.mean[0] == pytest.approx(1.0 + 2.0 * 4.0 / 5.0)
    assert after.covariance[0, 0] == pytest.approx(4.0 / 5.0)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_joseph_is_the_optimal_form_and_the_information_form(m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, seen = Gaussian(rng.normal(size=5), spd(rng, 5)), measurement(rng, 5, m)
    held = weigh(state, seen)
    after = update(state, seen, held)
    P, H, R = state.covariance, seen.jacobian, seen.noise
    K = P @ H.T @ np.linalg.inv(held.covariance)
    np.testing.assert_allclose(after.covariance, P - K @ held.covariance @ K.T, atol=1e-10)
    np.testing.assert_allclose(after.mean, state.mean + K @ seen.innovation, atol=1e-10)
    information = np.linalg.inv(P) + H.T @ np.linalg.inv(R) @ H
    np.testing.assert_allclose(after.covariance @ information, np.eye(5), atol=1e-6)
    assert held.nis == pytest.approx(seen.innovation @ np.linalg.inv(held.covariance) @ seen.innovation)


@given(st.integers(0, 2**32 - 1))
def test_covariance_stays_symmetric_and_positive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = Gaussian(np.zeros(4), spd(rng, 4, 10.0 ** rng.uniform(-6.0, 4.0)))
    for _ in range(30):
        if rng.random() < 0.5:
            state = predict(state, state.mean, np.eye(4) + 0.2 * rng.normal(size=(4, 4)), spd(rng, 4, 1e-3))
        seen = measurement(rng, 4, int(rng.integers(1, 4)))
        trace = np.trace(state.covariance)
        state = update(state, seen, weigh(state, seen))
        assert np.trace(state.covariance) <= trace * (1.0 + 1e-9)
        np.testing.assert_array_equal(state.covariance, state.covariance.T)
        assert np.linalg.eigvalsh(state.covariance)[0] > 0.0


def test_a_perfect_reading_leaves_no_negative_variance() -> None:
    """The case in which P − K S Kᵀ loses all its digits."""
    state = Gaussian(np.zeros(2), np.array(((1e8, 1e8 - 1.0), (1e8 - 1.0, 1e8))))
    seen = Linearised(np.zeros(1), np.array(((1.0, 0.0),)), np.array(((1e-8,),)))
    after = update(state, seen, weigh(state, seen))
    assert np.linalg.eigvalsh(after.covariance)[0] > 0.0
    assert after.covariance[0, 0] == pytest.approx(1e-8, rel=0.2)
