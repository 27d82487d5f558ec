# SPDX-License-Identifier: Apache-2.0
"""Turning and ICR models: Jacobians against differences, slips against kinematics, noise by steps."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from trackslip_estimation.filters import equations
from trackslip_estimation.filters.filter import Filter
from trackslip_estimation.filters.linear_algebra import wrap
from trackslip_estimation.filters.model import DRIVEN, POSE, SPROCKETS, YAW, YAW_RATE, Gaussian, rate_measured
from trackslip_estimation.filters.speed_model import (
    COMMON_SLIP,
    FIRST,
    GYRO_BIAS,
    RATE,
    ROTATION_OFFSET,
    SECOND,
    SIZE,
    SPEED,
    SpeedModel,
)
from trackslip_estimation.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip_parameters import load_slip_parameters, make_model

FloatArray = NDArray[np.float64]

RADIUS, TREAD = 0.159, 0.73  # m, those of config/pc05.yaml
EDGE = 1e-6  # of the central differences
MODELS = {name: make_model(load_slip_parameters({"model": name})) for name in ("turning", "icr")}
RECORDS = {name: Filter(model).constants[0] for name, model in MODELS.items()}
TURNING = MotionState(Motion.TURNING, changing=False)

both = pytest.mark.parametrize("model", ["turning", "icr"])
states = st.tuples(
    *[st.floats(-50.0, 50.0)] * 2,
    st.floats(-math.pi, math.pi),
    *[st.floats(-1.0, 1.0)] * 2,
    *[st.floats(-2.0, 2.0)] * 2,
    *[st.floats(-0.3, 0.3)] * 3,
).map(np.array)
speeds = st.floats(-4.0, 4.0)
times = st.floats(0.0, 0.5)


def differences(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences of a function whose third value, if it has more than three, is a heading."""
    columns = []
    for k in range(at.size):
        step = np.zeros(at.size)
        step[k] = EDGE
        change = function(at + step) - function(at - step)
        if change.size > YAW + 1:
            change[YAW] = wrap(change[YAW])
        columns.append(change / (2.0 * EDGE))
    return np.array(columns).T


@both
@given(x=states, dt=times)
def test_f_is_the_derivative_of_the_step(model: str, x: FloatArray, dt: float) -> None:
    c = RECORDS[model]
    expected = differences(lambda v: equations.move(v, 1.0, 2.0, dt, c), x)
    np.testing.assert_allclose(equations.transition(x, 1.0, 2.0, dt, c), expected, atol=1e-7)


@both
@pytest.mark.parametrize("kind", [SPROCKETS, YAW_RATE])
@given(x=states, left=speeds, right=speeds)
def test_h_is_the_derivative_of_the_measurement(
    model: str, kind: int, x: FloatArray, left: float, right: float
) -> None:
    c = RECORDS[model]
    expected = differences(lambda v: equations.expected(kind, v, left, right, c), x)
    np.testing.assert_allclose(equations.jacobian(kind, x, left, right, c), expected, atol=1e-7)


@both
@given(x=states, left=speeds, right=speeds)
def test_outputs_come_with_their_derivatives(model: str, x: FloatArray, left: float, right: float) -> None:
    x[SPEED] = math.copysign(abs(x[SPEED]) + 0.05, x[SPEED])  # clear of where the slip angle ends
    left, right = (math.copysign(abs(w) + 0.2, w) for w in (left, right))
    c, P = RECORDS[model], np.diag(np.arange(1.0, SIZE + 1.0)) * 1e-3
    twist, twist_covariance, slips, slip_covariance = equations.outputs(x, P, left, right, c)
    J = differences(lambda v: equations.outputs(v, P, left, right, c)[0], x)
    S = differences(lambda v: equations.outputs(v, P, left, right, c)[2], x)
    np.testing.assert_array_equal(twist, (x[SPEED], -x[RATE] * x[ROTATION_OFFSET], x[RATE]))
    np.testing.assert_allclose(twist_covariance, J @ P @ J.T, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(slip_covariance, S @ P @ S.T, rtol=1e-5, atol=1e-9)
    v_left, v_right = x[SPEED] - x[RATE] * TREAD / 2.0, x[SPEED] + x[RATE] * TREAD / 2.0
    v_j = RADIUS * np.array((left, right)) * (1.0 - slips[:2])  # (3.17), the definition of slip
    np.testing.assert_allclose(v_j, (v_left, v_right), atol=1e-12)
    assert math.tan(slips[2]) == pytest.approx(twist[1] / twist[0])


@both
def test_slips_of_a_track_that_stands_are_the_common_slip(model: str) -> None:
    x = np.zeros(SIZE)
    x[COMMON_SLIP] = 0.07
    _, _, slips, covariance = equations.outputs(x, np.eye(SIZE), 0.0, 0.0, RECORDS[model])
    np.testing.assert_array_equal(slips, (0.07, 0.07, 0.0))
    np.testing.assert_array_equal(covariance, ((1.0, 1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 0.0)))


@given(speeds, speeds, st.floats(0.05, 1.0), st.floats(0.0, 1.0), st.floats(-0.1, 0.1))
def test_the_turning_equations_hold_where_they_say(
    left: float, right: float, kappa: float, eta: float, common: float
) -> None:
    """v = (1 − i₀) V − η |D|/2, ω = κ D/B, and the mirrored turn mirrored."""
    x = np.zeros(SIZE)
    V, D = RADIUS * (left + right) / 2.0, RADIUS * (right - left)
    x[FIRST], x[SECOND], x[COMMON_SLIP] = kappa, eta, common
    x[SPEED], x[RATE] = (1.0 - common) * V - eta * abs(D) / 2.0, kappa * D / TREAD
    c = RECORDS["turning"]
    np.testing.assert_allclose(equations.expected(SPROCKETS, x, left, right, c), 0.0, atol=1e-12)
    x[RATE] = -x[RATE]
    np.testing.assert_allclose(equations.expected(SPROCKETS, x, right, left, c), 0.0, atol=1e-12)


@given(speeds, speeds, st.floats(0.2, 2.0), st.floats(-2.0, -0.2), st.floats(-0.1, 0.1))
def test_the_icr_equations_hold_where_they_say(
    left: float, right: float, y_left: float, y_right: float, common: float
) -> None:
    """r ω_j (1 − i₀) = v − ω y_j solved for v and ω."""
    x = np.zeros(SIZE)
    tracks = RADIUS * np.array((left, right)) * (1.0 - common)
    x[FIRST], x[SECOND], x[COMMON_SLIP] = y_left, y_right, common
    x[SPEED], x[RATE] = np.linalg.solve(((1.0, -y_left), (1.0, -y_right)), tracks)
    found = equations.expected(SPROCKETS, x, left, right, RECORDS["icr"])
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_both_models_without_slip_are_the_ideal_vehicle() -> None:
    """κ = 1 and η = 0, and y = ±B/2: the yaw rate (3.18)."""
    for model, pair in (("turning", (1.0, 0.0)), ("icr", (TREAD / 2.0, -TREAD / 2.0))):
        x = np.zeros(SIZE)
        x[FIRST], x[SECOND] = pair
        x[SPEED], x[RATE] = RADIUS * 1.5, RADIUS * 1.0 / TREAD
        found = equations.expected(SPROCKETS, x, 1.0, 2.0, RECORDS[model])
        np.testing.assert_allclose(found, 0.0, atol=1e-12)


@both
def test_noise_of_the_sprockets_by_hand(model: str) -> None:
    """Misfit and rounding of one track: of v half, of ω twice over B² in the turning model."""
    c = RECORDS[model]
    misfit = (c["straight_misfit"] * 1.5 * RADIUS + c["turning_misfit"] * RADIUS) ** 2 + c[
        "standing_misfit"
    ] ** 2
    misfit *= c["misfit_time"] / 0.01
    rounding = (RADIUS * c["encoder_resolution"] / 0.01) ** 2 / 6.0
    turning = np.diag((misfit + rounding / 2.0, (misfit + 2.0 * rounding) / TREAD**2))
    expected = turning if model == "turning" else np.eye(2) * (misfit + rounding)
    np.testing.assert_allclose(
        equations.noise(SPROCKETS, np.zeros((2, 2)), 1.0, 2.0, 0.01, True, c), expected
    )


@both
@pytest.mark.parametrize("motion", list(Motion))
def test_process_noise_does_not_depend_on_the_steps(model: str, motion: Motion) -> None:
    """Speeds that walk: σ² t³/3 of way in n steps lacks a share of about 3/(2n), as the model splits it."""
    filter_ = Filter(MODELS[model])

    def grown(steps: int) -> FloatArray:
        known = Gaussian(np.zeros(SIZE), np.zeros((SIZE, SIZE)))
        still = Speeds(0.0, 0.0, 0.0, differenced=False)
        for _ in range(steps):
            known = filter_.step(known, still, 0.1 / steps, MotionState(motion), DRIVEN).updated
        return np.diag(known.covariance)

    fine, coarse, single = grown(80), grown(8), grown(1)
    np.testing.assert_allclose(coarse[SPEED:], fine[SPEED:], rtol=1e-9)
    np.testing.assert_allclose(single[SPEED:], fine[SPEED:], rtol=1e-9)
    np.testing.assert_allclose(coarse[POSE], fine[POSE], rtol=0.25, atol=1e-12)


@both
@pytest.mark.parametrize(
    ("motion", "moving"),
    [
        (Motion.STANDING, []),
        (Motion.STRAIGHT, [COMMON_SLIP]),
        (Motion.TURNING, [FIRST, SECOND, COMMON_SLIP, ROTATION_OFFSET]),
    ],
)
def test_what_shows_in_turns_only_changes_in_turns_only(
    model: str, motion: Motion, moving: list[int]
) -> None:
    walk = MODELS[model].walk(MotionState(motion, changing=False))
    assert np.flatnonzero(walk).tolist() == sorted([SPEED, RATE, GYRO_BIAS, *moving])


@both
def test_a_start_knows_its_pose_and_doubts_the_rest(model: str) -> None:
    pose, R = np.array((1.0, 2.0, 3.0)), np.array(((4.0, 1.0, 0.5), (1.0, 5.0, 0.2), (0.5, 0.2, 6.0)))
    chosen = MODELS[model]
    assert isinstance(chosen, SpeedModel)
    mean, P = chosen.initial(pose, R)
    np.testing.assert_array_equal(mean[POSE], pose)
    np.testing.assert_array_equal(P[POSE, POSE], R)
    np.testing.assert_array_equal(P[POSE, SPEED:], 0.0)
    assert (np.diag(P)[SPEED:] > 0.0).all()
    assert mean[FIRST] > 0.0


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
@pytest.mark.parametrize("kappa", [None, 0.0, -4.0])
def test_a_step_repeats_every_bit(model: str, kappa: float | None) -> None:
    """Replay = live."""
    filter_ = Filter(make_model(load_slip_parameters({"model": model})), kappa)

    def drive() -> bytes:
        state = filter_.initial(np.array((1.0, 2.0, 3.0)), np.eye(3) * 1e-3)
        moving = Speeds(1.0, 2.0, 0.01, differenced=True)
        for _ in range(20):
            state = filter_.step(state, moving, 0.01, TURNING, DRIVEN).updated
            state = filter_.step(state, moving, 0.0, TURNING, rate_measured(0.2, 1e-4)).updated
        return state.mean.tobytes() + state.covariance.tobytes()

    assert drive() == drive()
