# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sub-model 1: its Jacobians against differences, its step against fine steps, and results by hand."""

import math
from typing import Any

import numpy as np
import pytest
from fixtures import filter_steps
from fixtures.filter_steps import (
    Drive,
    Gaussian,
    Measured,
    config_of,
    differences,
    expected,
    filter_step,
    jacobian,
    observed,
    outputs_of,
    pose_measured,
    process_noise,
    rate_measured,
    start_of,
    state_of,
)
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.slip.config import ConfigRecord
from trackslip_estimation.slip.models import dispatch
from trackslip_estimation.slip.models.free_slips import ACTIVE, LEFT_SLIP, RIGHT_SLIP, SLIP_ANGLE
from trackslip_estimation.slip.models.model import GYRO_BIAS, SIZE, UNDERCARRIAGE_SIZE, YAW, X, Y
from trackslip_estimation.slip.models.model import POSE as POSE_SLICE
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.records import POSE, YAW_RATE

RADIUS, TREAD, COUNT = 0.159, 0.73, 2.0 * math.pi / (3 * 4096)
NOISE = {
    "encoder": 0.01,
    "slip_steady": 0.004,
    "slip_moving": 0.1,
    "slip_angle_steady": 0.003,
    "slip_angle_turning": 0.05,
    "gyro_bias": 1e-4,
    "initial_slip": 0.05,
    "initial_slip_angle": 0.02,
    "initial_gyro_bias": 0.01,
}
GIVEN = {"model": "free_slips", "encoder_resolution": COUNT, **{f"noise.{k}": v for k, v in NOISE.items()}}
CONFIG = config_of(GIVEN)
ENCODER_ONLY = config_of(GIVEN, noise__slip_steady=0.0, noise__slip_angle_steady=0.0, noise__gyro_bias=0.0)
C = CONFIG[0]
STRAIGHT = MotionState(Motion.STRAIGHT, changing=False)
NOTHING = np.zeros((SIZE, SIZE))
SLIPS = slice(LEFT_SLIP, SLIP_ANGLE + 1)

states = st.tuples(
    *[st.floats(-50.0, 50.0)] * 2,
    st.floats(-math.pi, math.pi),
    st.floats(-0.1, 0.1),
    *[st.floats(-1.0, 0.99)] * 2,
    st.floats(-0.8, 0.8),
    *[st.just(0.0)] * (SIZE - ACTIVE),
).map(np.array)
speeds = st.floats(-4.0, 4.0)
times = st.floats(0.0, 0.5)


def state(**values: float) -> FloatArray:
    x = np.zeros(SIZE)
    names = {"yaw": YAW, "left": LEFT_SLIP, "right": RIGHT_SLIP, "angle": SLIP_ANGLE, "bias": GYRO_BIAS}
    for name, value in values.items():
        x[names[name]] = value
    return x


def move(x: FloatArray, left: float, right: float, dt: float) -> FloatArray:
    return filter_steps.moved(x, Drive(left, right), dt, CONFIG)


def twist(x: FloatArray, left: float, right: float) -> FloatArray:
    return np.array(dispatch.twist(x, left, right, C))


@given(states, speeds, speeds, times)
def test_f_is_the_derivative_of_the_step_by_the_state(
    x: FloatArray, left: float, right: float, dt: float
) -> None:
    F = filter_steps.transition(x, Drive(left, right), dt, CONFIG)
    np.testing.assert_allclose(F, differences(lambda v: move(v, left, right, dt), x), atol=1e-7)


@given(states, speeds, speeds, st.floats(0.01, 0.5))
def test_encoder_noise_enters_by_the_derivative_of_the_step_by_the_speeds(
    x: FloatArray, left: float, right: float, dt: float
) -> None:
    G = differences(lambda v: move(x, v[0], v[1], dt), np.array((left, right)))
    variance = np.square((NOISE["encoder"] * left, NOISE["encoder"] * right)) / dt
    Q = process_noise(x, NOTHING, Drive(left, right), dt, ENCODER_ONLY)
    np.testing.assert_allclose(Q, (G * variance) @ G.T, atol=1e-8)


@pytest.mark.parametrize(("kind", "rows"), [(YAW_RATE, 1), (POSE, 2), (POSE, 3)])
@given(x=states, left=speeds, right=speeds)
def test_h_is_the_derivative_of_the_measurement(
    kind: int, rows: int, x: FloatArray, left: float, right: float
) -> None:
    by_differences = differences(lambda v: expected(kind, v, rows, (left, right), C), x)
    np.testing.assert_allclose(jacobian(kind, x, rows, (left, right), C), by_differences, atol=1e-7)


@given(states, speeds, speeds)
def test_expected_measurements_are_the_yaw_rate_and_the_pose(
    x: FloatArray, left: float, right: float
) -> None:
    rate = twist(x, left, right)[2] + x[GYRO_BIAS]
    np.testing.assert_allclose(expected(YAW_RATE, x, 1, (left, right), C), (rate,), atol=1e-15)
    for rows in (2, 3):
        at = np.array((*x[:YAW], wrap(x[YAW])))
        off = expected(POSE, x, rows, (left, right), C) - at[:rows]
        off[YAW:] = [wrap(angle) for angle in off[YAW:]]
        np.testing.assert_allclose(off, 0.0, atol=1e-12)


def test_rounding_of_positions_is_no_noise_of_the_gyro() -> None:
    """Otherwise the heading would follow the tracks, more so with coarser encoders."""
    for variance in (4e-4, 0.0):
        drive = state_of(Gaussian(state(), NOTHING), Speeds(1.0, 1.2, variance), STRAIGHT)
        found = observed(drive[0], rate_measured(0.0, 1e-4), C)
        assert found.noise[0, 0] == 1e-4
        assert found.innovation[0] == pytest.approx(-0.2 * RADIUS / TREAD)


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
def test_heading_innovation_is_the_shorter_angle(filter_: str) -> None:
    """From 3.1 rad a fix at −3.1 rad is 0.083 rad ahead; the middle is at 3.1416 rad."""
    at = Gaussian(state(yaw=3.1), np.diag(np.arange(SIZE) == YAW) * 1e-4)
    fix = pose_measured(np.array((0.0, 0.0, -3.1)), np.eye(3) * 1e-4, True)
    found = filter_step(config_of(GIVEN, filter=filter_), at, Speeds(0.0, 0.0), 0.0, STRAIGHT, fix)
    turn = 2 * math.pi - 6.2
    assert found.nis == pytest.approx(turn**2 / 2e-4)
    assert wrap(found.updated.mean[YAW] - 3.1) == pytest.approx(turn / 2.0)


@given(states, speeds, speeds)
def test_outputs_are_the_twist_and_the_slips(x: FloatArray, left: float, right: float) -> None:
    root = np.zeros((SIZE, SIZE))
    root[:ACTIVE, :ACTIVE] = np.arange(49.0).reshape(7, 7) % 11.0
    found = outputs_of(CONFIG, Gaussian(x, root @ root.T), Speeds(left, right))
    J = differences(lambda v: twist(v, left, right), x)
    np.testing.assert_array_equal(found["twist"], twist(x, left, right))
    np.testing.assert_allclose(found["twist_covariance"], J @ root @ root.T @ J.T, rtol=1e-5, atol=1e-4)
    np.testing.assert_array_equal(found["slips"], x[SLIPS])
    np.testing.assert_array_equal(found["slip_covariance"], (root @ root.T)[SLIPS, SLIPS])


def test_straight_on_with_slip_by_hand() -> None:
    """1 rad/s at 10 and 10 % slip for 2 s: 2 · 0.159 · 0.9 m along the heading."""
    x = move(state(yaw=math.pi / 6, left=0.1, right=0.1), 1.0, 1.0, 2.0)
    np.testing.assert_allclose(x[POSE_SLICE], (0.2862 * math.cos(math.pi / 6), 0.1431, math.pi / 6))
    np.testing.assert_allclose(x[SLIPS], (0.1, 0.1, 0.0))


def test_yaw_rate_is_the_difference_of_the_tracks() -> None:
    """Erratum 1 of (3.26), (6.1): i_L = 0.2, i_R = −0.1 at equal speeds turn left, not right."""
    v_x, v_y, rate = twist(state(left=0.2, right=-0.1), 2.0, 2.0)
    assert rate == pytest.approx(0.159 * 2.0 * 0.3 / 0.73)
    assert v_x == pytest.approx(0.159 * 2.0 * 0.95)
    assert v_y == 0.0


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi / 2, -2.5])
def test_slip_angle_moves_to_the_left_of_the_heading(yaw: float) -> None:
    """Erratum 1 again: y uses cos φ tan α. Direction of travel φ + α, to the left for α > 0."""
    x = move(state(yaw=yaw, angle=0.2), 1.0, 1.0, 1.0)
    assert math.atan2(x[Y], x[X]) == pytest.approx(wrap(yaw + 0.2))
    assert math.hypot(x[X], x[Y]) == pytest.approx(0.159 / math.cos(0.2))


def test_spot_turn_and_reverse_move_the_pose_as_computed_by_hand() -> None:
    x = move(state(), -1.0, 1.0, 1.0)
    np.testing.assert_allclose(x[POSE_SLICE], (0.0, 0.0, 2 * 0.159 / 0.73), atol=1e-15)
    x = move(state(), -1.0, -1.0, 1.0)
    np.testing.assert_allclose(x[POSE_SLICE], (-0.159, 0.0, 0.0))


@given(states, speeds, speeds)
def test_midpoint_step_matches_fine_steps(x: FloatArray, left: float, right: float) -> None:
    """Error of the chord: v dt (φ̇ dt)²/24 (1 + tan α …); that of an Euler step is v dt φ̇ dt/2."""
    dt = 0.1
    fine = x
    for _ in range(200):
        fine = move(fine, left, right, dt / 200)
    once = move(x, left, right, dt)
    v_x, v_y, rate = twist(x, left, right)
    bound = math.hypot(v_x, v_y) * dt * (rate * dt) ** 2 / 24.0
    assert math.hypot(*(once - fine)[:2]) <= 1.01 * bound + 1e-12
    assert wrap(once[YAW] - fine[YAW]) == pytest.approx(0.0, abs=1e-12)


@given(states, speeds, speeds, times)
def test_a_step_is_the_kalman_filter_in_numpy(x: FloatArray, left: float, right: float, dt: float) -> None:
    root = np.random.default_rng(0).normal(size=(SIZE, SIZE)) * 0.1
    root[UNDERCARRIAGE_SIZE:] = 0.0  # states that the test does not use
    P, R = root @ root.T, np.array(((1e-4,),))
    start = Gaussian(x, P)
    step = filter_step(CONFIG, start, Speeds(left, right), dt, STRAIGHT, rate_measured(0.3, 1e-4))
    drive = Drive(left, right)
    F = filter_steps.transition(x, drive, dt, CONFIG)
    P = F @ P @ F.T + process_noise(x, P, drive, dt, CONFIG)
    np.testing.assert_allclose(step.predicted.covariance, P, rtol=1e-12, atol=1e-12)
    x = move(x, left, right, dt)
    H = jacobian(YAW_RATE, x, 1, (left, right), C)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(SIZE) - K @ H
    corrected = x + K @ (0.3 - expected(YAW_RATE, x, 1, (left, right), C))
    corrected[YAW] = wrap(corrected[YAW])
    np.testing.assert_allclose(step.updated.mean, corrected, rtol=1e-12, atol=1e-12)
    joseph = A @ P @ A.T + K @ R @ K.T
    np.testing.assert_allclose(step.updated.covariance, joseph, rtol=1e-12, atol=1e-11)


def grown(drive: Drive, duration: float, steps: int, config: ConfigRecord = CONFIG) -> FloatArray:
    """Covariance after ``duration`` s in ``steps`` steps, from a start without uncertainty."""
    gaussian = Gaussian(state(left=0.1, right=0.05, angle=0.02), NOTHING)
    speeds_, motion = drive.parts
    for _ in range(steps):
        gaussian = filter_step(config, gaussian, speeds_, duration / steps, motion, Measured()).predicted
    return gaussian.covariance


@pytest.mark.parametrize("motion", [STRAIGHT, MotionState(Motion.TURNING, changing=True)])
@pytest.mark.parametrize(("left", "right"), [(2.0, 2.0), (1.0, 2.0), (2.0, -2.0)])
def test_process_noise_does_not_depend_on_the_steps(left: float, right: float, motion: MotionState) -> None:
    fine, coarse, single = (np.diag(grown(Drive(left, right, *motion[:2]), 0.1, n)) for n in (40, 4, 1))
    np.testing.assert_allclose(coarse[3:], fine[3:], rtol=1e-9)
    np.testing.assert_allclose(single[3:], fine[3:], rtol=1e-9)
    # Slips are constant within a step: of σ² t³/3, n steps lack a share of about 3/(2n).
    np.testing.assert_allclose(coarse[YAW], fine[YAW], rtol=0.3)
    assert coarse[:2].sum() == pytest.approx(fine[:2].sum(), rel=0.3)


@pytest.mark.parametrize(("left", "right"), [(2.0, 2.0), (1.0, 2.0), (2.0, -2.0)])
def test_encoder_noise_does_not_depend_on_the_steps(left: float, right: float) -> None:
    fine, single = (np.diag(grown(Drive(left, right), 0.1, n, ENCODER_ONLY)) for n in (100, 1))
    np.testing.assert_allclose(single[YAW], fine[YAW], rtol=1e-9)
    assert single[:2].sum() == pytest.approx(fine[:2].sum(), rel=0.002)


def test_encoder_noise_grows_with_distance_and_the_root_of_time() -> None:
    """(3.21): one second at equal speeds gives encoder·v/√2 along x, four seconds twice that."""
    for seconds, factor in ((1.0, 1.0), (4.0, 2.0)):
        P = grown(Drive(2.0, 2.0), seconds, 400, ENCODER_ONLY)
        slips = np.array((0.1, 0.05))
        deviation = 0.01 * np.hypot(*(RADIUS * 2.0 * (1.0 - slips))) / 2.0
        assert math.sqrt(P[X, X]) == pytest.approx(deviation * factor, rel=0.01)


def walk(motion: MotionState) -> FloatArray:
    Q = process_noise(np.zeros(SIZE), NOTHING, Drive(1.0, 1.0, *motion[:2]), 0.5, CONFIG)
    deviations: FloatArray = np.sqrt(np.diag(Q)[GYRO_BIAS:] / 0.5)
    return deviations


@pytest.mark.parametrize(
    ("motion", "slip", "angle"),
    [
        (MotionState(Motion.STRAIGHT, changing=False), NOISE["slip_steady"], NOISE["slip_angle_steady"]),
        (MotionState(Motion.STRAIGHT, changing=True), NOISE["slip_moving"], NOISE["slip_angle_turning"]),
        (MotionState(Motion.TURNING, changing=False), NOISE["slip_moving"], NOISE["slip_angle_turning"]),
        (MotionState(Motion.STANDING, changing=False), 0.0, 0.0),
        (MotionState(Motion.STANDING, changing=True), 0.0, 0.0),
    ],
)
def test_the_jump_hypothesis_switches_the_noise(motion: MotionState, slip: float, angle: float) -> None:
    np.testing.assert_allclose(walk(motion), (NOISE["gyro_bias"], slip, slip, angle, *np.zeros(SIZE - 7)))


def test_a_start_has_its_pose_and_wide_priors_of_the_rest() -> None:
    pose, R = np.array((1.0, 2.0, 3.0)), np.array(((4.0, 1.0, 0.5), (1.0, 5.0, 0.2), (0.5, 0.2, 6.0)))
    mean, P = start_of(CONFIG, pose, R)
    np.testing.assert_array_equal(mean, (1.0, 2.0, 3.0, *np.zeros(SIZE - 3)))
    expected_: Any = np.diag((*np.zeros(3), 0.01**2, 0.05**2, 0.05**2, 0.02**2, *np.zeros(SIZE - 7)))
    expected_[:3, :3] = R
    np.testing.assert_allclose(P, expected_)
