# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Fixes with time-correlated errors: estimated from the fixes, and modelled by an offset.

An offset is a state (``source_offsets``); R of a sensor on the upper structure is inflated
(``adaptation.correlated_inflation``).
"""

import math
from typing import Any

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, drive, parameters, with_coarse_fixes
from fixtures.fault_cases.gnss_errors import gauss_markov
from fixtures.filter_steps import Gaussian, state_of
from fixtures.pose_errors import errors_over
from fixtures.records import assert_order_does_not_matter
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.adaptation import correlated_inflation, largest_correlated_inflation
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.correlated_errors import (
    MASSES,
    PRECISE,
    RECEIVER,
    DisplacementError,
    add_fix,
    quality_of,
    reset_receiver,
)
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import PoseFix
from trackslip_estimation.slip.models.model import GYRO_BIAS, SENSOR_ERRORS, SIZE, Y
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import PRIOR, UPDATE
from trackslip_estimation.slip.source_offsets import (
    begin_offset,
    prepare_offset,
    propagate_offsets,
    to_measured_position,
)

PERIOD, CORRELATION_TIME, SIGMA = 0.1, 10.0, 0.01  # s, s, m
C = make_config(load_slip_parameters())[0]
SOURCE, S = 0, 1_000_000_000
PLACE, OFFSET = slice(0, Y + 1), slice(SENSOR_ERRORS, SENSOR_ERRORS + 2)


def cap(P: float, R: float) -> float:
    """The limit of the inflation for one axis, from two equal ones."""
    return largest_correlated_inflation(P * np.eye(2), R * np.eye(2))


@given(st.floats(1e-6, 1.0), st.floats(1.001, 1e4))
def test_stated_variance_equals_the_error_after_a_fix_with_a_common_error(R: float, share: float) -> None:
    U = share * R
    P = R + U
    K = P / (P + cap(P, R) * R)
    variance, claimed = R + (1.0 - K) ** 2 * U, (1.0 - K) * P
    assert claimed == pytest.approx(variance, rel=1e-6)


def test_estimate_that_contains_the_whole_common_error_is_not_updated() -> None:
    assert cap(2.0, 1.0) == math.inf
    assert cap(0.1, 1.0) == math.inf


@pytest.mark.parametrize("walk", [0.0003, 0.003, 0.03])
def test_position_error_is_near_that_of_the_fixes_and_within_its_covariance(walk: float) -> None:
    """``walk``: error of dead reckoning in a period, m."""
    rng = np.random.default_rng(1)
    decay, runs = math.exp(-PERIOD / CORRELATION_TIME), 400
    slow, error, P = SIGMA * rng.normal(size=runs), np.zeros(runs), SIGMA**2
    error = slow.copy()
    squares, claimed = [], []
    for k in range(1500):
        slow = decay * slow + math.sqrt(1.0 - decay * decay) * SIGMA * rng.normal(size=runs)
        error, P = error + walk * rng.normal(size=runs), P + walk * walk
        R = min(correlated_inflation(round(PERIOD * 1e9), CORRELATION_TIME), cap(P, SIGMA**2)) * SIGMA**2
        K = P / (P + R)
        error, P = error + K * (slow - error), (1.0 - K) * P
        if k > 500:
            squares.append(np.mean(error**2))
            claimed.append(P)
    rms = math.sqrt(np.mean(squares))
    assert rms < 1.6 * SIGMA
    assert 0.3 < np.mean(squares) / np.mean(claimed) < 1.2


def random_gaussian() -> Gaussian:
    rng = np.random.default_rng(4)
    root = 0.1 * rng.normal(size=(SIZE, SIZE))
    return Gaussian(rng.normal(size=SIZE), root @ root.T)


def state_with_offset(gaussian: Gaussian, variance: float, g: float = 4.0, time: float = 30.0) -> Any:
    """A record of ``STATE`` with an offset of the source, whose last fixes stated 1 m."""
    state = state_of(gaussian)[0]
    offset = state["offsets"][0]
    errors = offset["errors"]
    errors["f"], errors["g"], errors["time"] = 0.5, g, time
    errors["g"][PRECISE] = 0.0
    offset["variance"], offset["stddev"] = variance, 1.0
    return state


def prior_of(state: Any) -> Any:
    prior = np.zeros(1, PRIOR)[0]
    prior["mean"], prior["covariance"] = state["mean"], state["covariance"]
    return prior


def test_transformation_to_the_offset_position_is_invertible() -> None:
    before = random_gaussian()
    x, P = before.mean.copy(), before.covariance.copy()
    to_measured_position(x, P, SOURCE, 1.0, C)
    T = np.eye(SIZE)
    T[PLACE, OFFSET] = np.eye(2)
    np.testing.assert_allclose(x, T @ before.mean, atol=1e-14)
    np.testing.assert_allclose(P, T @ before.covariance @ T.T, atol=1e-14)
    to_measured_position(x, P, SOURCE, -1.0, C)
    np.testing.assert_allclose(x, before.mean, atol=1e-14)
    np.testing.assert_allclose(P, before.covariance, atol=1e-14)


def test_first_coarse_fix_splits_its_error_between_position_and_offset() -> None:
    """In coordinates of the measured position its error is white and independent of the offset."""
    R = np.array(((0.9, 0.1), (0.1, 1.1)))
    state = state_with_offset(Gaussian(np.zeros(SIZE), np.zeros((SIZE, SIZE))), 0.0)
    state["covariance"][PLACE, PLACE] = R
    begin_offset(state, SOURCE, C)
    x, P = state["mean"].copy(), state["covariance"].copy()
    np.testing.assert_allclose(np.diag(P)[OFFSET], 4.0)
    np.testing.assert_allclose(np.diag(P)[PLACE], 0.5 * np.diag(R) + 4.0)
    to_measured_position(x, P, SOURCE, 1.0, C)
    np.testing.assert_allclose(P[PLACE, PLACE], 0.5 * R, atol=1e-14)
    np.testing.assert_allclose(P[PLACE, OFFSET], 0.0, atol=1e-14)


@given(st.floats(0.3, 10.0), st.floats(0.3, 10.0))
def test_new_prior_of_an_offset_acts_as_if_set_at_the_start(before: float, g: float) -> None:
    """Also if the new prior is wider, and if other states are correlated with the offset."""

    def informed(variance: float) -> FloatArray:
        P = np.eye(SIZE)
        P[OFFSET, OFFSET] = variance * np.eye(2)
        H = np.zeros((3, SIZE))
        H[0, [0, OFFSET.start]] = H[1, [1, OFFSET.start + 1]] = 1.0
        H[2, [0, 2]] = 1.0, 0.5
        return P - P @ H.T @ np.linalg.solve(H @ P @ H.T + 0.5 * np.eye(3), H @ P)

    state = state_with_offset(Gaussian(np.zeros(SIZE), informed(before)), before, g)
    prepare_offset(state, np.zeros(1, UPDATE)[0], prior_of(state), SOURCE, np.eye(2), False, C)
    np.testing.assert_allclose(state["covariance"], informed(g), atol=1e-9)
    assert state["offsets"]["variance"][0] == pytest.approx(g)


@pytest.mark.parametrize(("stddev", "variance"), [(0.02, 0.0), (0.4, 4.0 * 0.4**2), (3.0, 36.0)])
def test_change_of_fix_quality_resets_the_offset(stddev: float, variance: float) -> None:
    """Offsets of different solutions are independent; a precise solution has none."""
    state = state_with_offset(random_gaussian(), 4.0)
    update, prior, expected = np.zeros(1, UPDATE)[0], prior_of(state), state["covariance"].copy()
    prepare_offset(state, update, prior, SOURCE, stddev**2 * np.eye(2), False, C)
    assert state["offsets"]["variance"][0] == pytest.approx(variance)
    assert update["reset_states"] == 3 << SENSOR_ERRORS
    expected[OFFSET], expected[:, OFFSET], expected[OFFSET, OFFSET] = 0.0, 0.0, variance * np.eye(2)
    np.testing.assert_allclose(state["covariance"], expected)
    np.testing.assert_allclose(prior["covariance"], expected)


@given(st.floats(0.01, 200.0), st.floats(1.0, 30.0))
def test_an_offset_fades_as_a_first_order_process(dt: float, time: float) -> None:
    state = state_with_offset(random_gaussian(), 4.0, time=time)
    x, P = state["mean"].copy(), state["covariance"].copy()
    propagate_offsets(state, dt, C)
    F, Q, share = np.eye(SIZE), np.zeros((SIZE, SIZE)), math.exp(-dt / time)
    F[OFFSET, OFFSET] *= share
    Q[OFFSET, OFFSET] = 4.0 * (1.0 - share * share) * np.eye(2)
    np.testing.assert_allclose(state["mean"], F @ x, atol=1e-12)
    np.testing.assert_allclose(state["covariance"], F @ P @ F.T + Q, atol=1e-12)


@pytest.mark.parametrize("size", [1.0, 2.0])
@pytest.mark.parametrize("rate", [1, 10])  # Hz
def test_time_correlated_errors_of_precise_fixes_keep_the_estimate_consistent(rate: int, size: float) -> None:
    """The errors have a correlation time of ten seconds, and once or twice the stated standard deviation."""
    nees = []
    for seed in range(2):
        recorded, noise = drive(Machine(duration=120.0, seed=seed)), np.random.default_rng(seed)
        every = round(1.0 / rate / (recorded.t[1] - recorded.t[0]))
        times = recorded.t[::every]
        error = size * gauss_markov(times, 0.02, 10.0, noise) + 0.006 * noise.normal(size=(times.size, 2))
        fixes = [
            PoseFix(
                "box_pose", S + round(t * S), np.append(true + off, 0.0), np.diag((0.02**2, 0.02**2, 100.0))
            )
            for t, true, off in zip(times, recorded.poses[::every, :2], error, strict=True)
        ]
        others = [m for m in recorded.measurements if not isinstance(m, PoseFix)]
        p = parameters(**{"sources.box_pose.standing_share": 0.0})
        in_order = sorted([*others, *fixes], key=lambda m: m.stamp_ns)
        nees.append(errors_over(in_order, recorded, p)[0].between(40.0).nees(2).mean())
    assert np.mean(nees) < 5.0  # 2 if consistent


def estimated_errors(fixes: FloatArray, stddev: float, period: float) -> Any:
    """Estimated error model of fixes at standstill with the stated ``stddev``, m, at every ``period``, s."""
    receiver, masses = np.zeros(1, RECEIVER), np.zeros(1, MASSES)
    reset_receiver(receiver[0], C)
    for k, fix in enumerate(fixes):
        add_fix(
            receiver[0], masses[0], fix, stddev, DisplacementError(0.0, 0.0), S + round(k * period * S), C
        )
    return receiver[0]["errors"][quality_of(stddev, C)]


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_white_errors_are_found_to_be_white(factor: float) -> None:
    fixes = math.sqrt(factor) * 0.9 * np.random.default_rng(0).normal(size=(300, 2))
    errors = estimated_errors(fixes, 0.9, 1.0)
    assert errors["white"] > 0.8
    assert errors["f"] == pytest.approx(factor, rel=0.4)


@pytest.mark.parametrize(("stddev", "time"), [(2.0, 30.0), (5.0, 10.0)])
def test_large_time_correlated_errors_are_estimated(stddev: float, time: float) -> None:
    t = np.arange(0.0, 900.0, 1.0)
    errors = estimated_errors(gauss_markov(t, stddev, time, np.random.default_rng(0)), 0.9, 1.0)
    assert errors["white"] < 0.01
    assert errors["f"] < 0.5
    assert 0.3 < errors["g"] * 0.9**2 / stddev**2 < 3.0
    assert 0.3 < errors["time"] / time < 3.0


@pytest.mark.parametrize("period", [0.1, 1.0])
def test_errors_of_precise_fixes_count_as_white_until_shown_correlated(period: float) -> None:
    noise, t = np.random.default_rng(0), np.arange(0.0, 120.0, period)
    white = estimated_errors(0.02 * noise.normal(size=(t.size, 2)), 0.02, period)
    assert white["white"] > 0.9
    assert white["g"] == 0.0
    correlated = estimated_errors(gauss_markov(t, 0.04, 10.0, noise), 0.02, period)
    assert correlated["white"] < 0.1
    assert 0.2 < correlated["g"] * 0.02**2 / 0.04**2 < 5.0


@pytest.mark.parametrize("jump", [0.5, 100.0])
def test_jump_is_not_taken_for_a_time_correlated_error(jump: float) -> None:
    """Fixes after a jump of the machine must keep their weight."""
    fixes = 0.02 * np.random.default_rng(1).normal(size=(300, 2))
    fixes[100:] += jump
    assert estimated_errors(fixes, 0.02, 0.1)["white"] > 0.9


@pytest.mark.parametrize("off", [1.0, math.pi])
def test_wrong_start_heading_is_not_attributed_to_the_receiver(off: float) -> None:
    """Fixes beside the predicted path must not count as time-correlated errors."""
    recording = drive(Machine(duration=60.0, seed=2, fix_noise=0.05, fix_stated=0.05))
    initial = {"initial_yaw": float(recording.poses[0, 2]) + off, "initial_yaw_stddev": 0.02}
    estimator = SlipEstimator(parameters(**initial, **{"sources.box_pose.standing_share": 0.0}))
    estimator.process_all(recording.measurements)
    errors = estimator.window.receivers[estimator.window.count - 1, 0]["errors"][PRECISE]
    assert abs(math.remainder(estimator.estimate().pose[2] - recording.poses[-1, 2], math.tau)) < 0.05
    assert errors["white"] > 0.5


def test_receiver_errors_do_not_depend_on_the_order_of_arrival() -> None:
    recording = drive(Machine(duration=20.0, fix_noise=2.0, fix_stated=0.9, seed=7))
    assert_order_does_not_matter(parameters(), recording.measurements, latest=1.2, seed=7)


def test_wandering_receiver_does_not_turn_the_estimate_of_gyro_and_tracks() -> None:
    """The receiver states 0.9 m and wanders by 2.5 m within 20 s."""
    recording = drive(Machine(duration=240.0, track_error=0.02))
    found, estimator = errors_over(with_coarse_fixes(recording, 2.5, 20.0), recording, parameters())
    late = found.between(60.0)
    assert late.nees(2).mean() < 5.0
    assert late.heading_nees < 4.0
    assert late.heading_rms < 0.1
    last = estimator.window.best[estimator.window.count - 1]
    assert abs(last["mean"][GYRO_BIAS]) < 4.0 * math.sqrt(last["covariance"][GYRO_BIAS, GYRO_BIAS]) + 1e-3
