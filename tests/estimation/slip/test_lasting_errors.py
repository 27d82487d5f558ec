# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes whose errors last, as those of RTK do: averaged no more than is true, and never given away.

A source's own time is a state (``own_errors``); that of what sits above is weighed (``adaptation.repeats``).
"""

import math

import numpy as np
import pytest
from fixtures.filter_steps import Gaussian, state_of
from hypothesis import given
from hypothesis import strategies as st

from trackslip_estimation.slip.adaptation import repeats, shared_error
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.models.model import SENSOR_ERRORS, SIZE, Y
from trackslip_estimation.slip.own_errors import LASTING, begin_erring, meet_quality, to_erring, white
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import UPDATE

PERIOD, LASTS, SIGMA = 0.1, 10.0, 0.01  # s, s, m
C = make_config(load_slip_parameters({"sources.box_pose.correlation_time": LASTS}))[0]
SOURCE = 0
PLACE, ERRORS = slice(0, Y + 1), slice(SENSOR_ERRORS + 2, SENSOR_ERRORS + 4)


def cap(P: float, R: float) -> float:
    """Of one axis, as of two that are alike."""
    return shared_error(P * np.eye(2), R * np.eye(2))


@given(st.floats(1e-6, 1.0), st.floats(1.001, 1e4))
def test_what_is_claimed_is_what_a_fix_leaves_of_an_error_that_both_have(R: float, share: float) -> None:
    U = share * R
    P = R + U
    K = P / (P + cap(P, R) * R)
    left, claimed = R + (1.0 - K) ** 2 * U, (1.0 - K) * P
    assert claimed == pytest.approx(left, rel=1e-6)


def test_an_estimate_that_may_have_all_of_it_learns_nothing() -> None:
    assert cap(2.0, 1.0) == math.inf
    assert cap(0.1, 1.0) == math.inf


@pytest.mark.parametrize("walk", [0.0003, 0.001, 0.003, 0.01, 0.03])
def test_position_is_never_much_worse_than_the_fixes_and_claims_no_less_than_is_true(walk: float) -> None:
    """``walk``: error of dead reckoning in a period, m. It was 4.3 times the fixes' for 0.03 m."""
    rng = np.random.default_rng(1)
    kept, runs = math.exp(-PERIOD / LASTS), 400
    lasting, error, P = SIGMA * rng.normal(size=runs), np.zeros(runs), SIGMA**2
    error = lasting.copy()
    squares, claimed = [], []
    for k in range(1500):
        lasting = kept * lasting + math.sqrt(1.0 - kept * kept) * SIGMA * rng.normal(size=runs)
        error, P = error + walk * rng.normal(size=runs), P + walk * walk
        R = min(repeats(round(PERIOD * 1e9), LASTS), cap(P, SIGMA**2)) * SIGMA**2
        K = P / (P + R)
        error, P = error + K * (lasting - error), (1.0 - K) * P
        if k > 500:
            squares.append(np.mean(error**2))
            claimed.append(P)
    rms = math.sqrt(np.mean(squares))
    assert rms < 1.6 * SIGMA
    assert 0.3 < np.mean(squares) / np.mean(claimed) < 1.2


def made_up() -> Gaussian:
    rng = np.random.default_rng(4)
    root = 0.1 * rng.normal(size=(SIZE, SIZE))
    return Gaussian(rng.normal(size=SIZE), root @ root.T)


def test_the_place_that_a_fix_shows_and_back() -> None:
    known, R = made_up(), np.diag((0.04, 0.09))
    x, P = known.mean.copy(), known.covariance.copy()
    to_erring(x, P, SOURCE, R, 1.0, C)
    T = np.eye(SIZE)
    T[PLACE, ERRORS] = np.diag(np.sqrt(LASTING * np.diag(R)))
    np.testing.assert_allclose(x, T @ known.mean, atol=1e-14)
    np.testing.assert_allclose(P, T @ known.covariance @ T.T, atol=1e-14)
    to_erring(x, P, SOURCE, R, -1.0, C)
    np.testing.assert_allclose(x, known.mean, atol=1e-14)
    np.testing.assert_allclose(P, known.covariance, atol=1e-14)


def test_what_lasts_and_what_does_not_are_the_whole_fix() -> None:
    """Also of the fix that the estimate begins with: a second one at once adds little."""
    R = np.array(((0.04, 0.01), (0.01, 0.09)))
    x, P = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    P[ERRORS, ERRORS], P[PLACE, PLACE] = np.eye(2), R
    begin_erring(x, P, SOURCE, C)
    np.testing.assert_allclose(np.diag(P)[PLACE], np.diag(R))
    to_erring(x, P, SOURCE, R, 1.0, C)
    np.testing.assert_allclose(P[PLACE, PLACE], white(R, SOURCE, C), atol=1e-14)
    np.testing.assert_allclose(P[PLACE, ERRORS], 0.0, atol=1e-14)


def test_another_quality_has_another_error() -> None:
    """Floating ambiguities after fixed ones: what is known of the one error tells nothing of the other."""
    known = made_up()
    for before, stddev, renewed in ((0.01, 0.02, False), (0.01, 0.3, True), (0.3, 0.01, True)):
        state, update = state_of(known)[0], np.zeros(1, UPDATE)[0]
        update["prior_mean"], update["prior_covariance"], update["renewed"] = *known, 0
        state["fix_stddevs"][SOURCE] = before
        meet_quality(state, update, SOURCE, stddev**2 * np.eye(2), C)
        wanted = known.covariance.copy()
        if renewed:
            wanted[ERRORS], wanted[:, ERRORS], wanted[ERRORS, ERRORS] = 0.0, 0.0, np.eye(2)
        assert update["renewed"] == (3 << (SENSOR_ERRORS + 2) if renewed else 0)
        np.testing.assert_array_equal(state["covariance"], wanted)
        np.testing.assert_array_equal(update["prior_covariance"], wanted)
