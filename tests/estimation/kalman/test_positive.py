# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Rounding errors leave a covariance symmetric and positive semidefinite."""

import numpy as np
import pytest

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.positive import make_positive


def random_covariance(rng: np.random.Generator) -> FloatArray:
    """(9, 9) covariance with standard deviations over ten decades and any correlations."""
    A = rng.normal(size=(9, 9))
    P = A @ A.T * np.outer(*[10.0 ** rng.uniform(-5.0, 5.0, 9)] * 2)
    return np.ascontiguousarray((P + P.T) / 2.0)


def least_eigenvalue(P: FloatArray) -> float:
    """Least eigenvalue of the correlation matrix."""
    deviations = np.sqrt(np.diag(P))
    return float(np.linalg.eigvalsh(P / np.outer(deviations, deviations))[0])


@pytest.mark.parametrize("seed", range(2))
def test_positive_definite_covariance_keeps_every_bit(seed: int) -> None:
    P = random_covariance(np.random.default_rng(seed))
    before = P.copy()
    make_positive(P, before, 9)
    np.testing.assert_array_equal(P, before)


@pytest.mark.parametrize("lost", [1e-16, 1e-9, 1e-3, 0.5])
@pytest.mark.parametrize("seed", range(2))
def test_indefinite_covariance_becomes_definite_and_stays_bounded(lost: float, seed: int) -> None:
    """More than the variance along one direction is subtracted, by the share ``lost``."""
    rng = np.random.default_rng(seed)
    before = random_covariance(rng)
    h = rng.normal(size=9) / np.sqrt(np.diag(before))
    shared = before @ h
    P = before - np.outer(shared, shared) / (h @ shared) * (1.0 + lost)
    P[2, 5] *= 1.0 + 1e-12  # asymmetric
    make_positive(P, before, 9)
    np.testing.assert_array_equal(P, P.T)
    assert least_eigenvalue(P) > -1e-14
    if lost < 1e-6:  # the size of rounding errors
        assert (np.diag(P) <= (1.0 + 1e-6) * np.diag(before)).all()


def test_states_beyond_those_in_use_stay_as_they_are() -> None:
    P = np.full((4, 4), -1.0)
    P[:2, :2] = ((1.0, 2.0), (2.0, 1.0))
    make_positive(P, P.copy(), 2)
    assert np.linalg.eigvalsh(P[:2, :2])[0] >= 0.0
    assert (P[2:] == -1.0).all()


def test_certain_state_stays_certain() -> None:
    P = np.diag((1.0, 0.0, 2.0))
    make_positive(P, P.copy(), 3)
    np.testing.assert_array_equal(P, np.diag((1.0, 0.0, 2.0)))
