# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Turning and ICR models: Jacobians against differences, slips against kinematics, noise for any steps."""

import math
from functools import partial

import numpy as np
import pytest
from fixtures.filter_steps import (
    Drive,
    Gaussian,
    Measured,
    config_of,
    differences,
    expected,
    filter_step,
    jacobian,
    moved,
    outputs_of,
    process_noise,
    rate_measured,
    start_of,
    transition,
)
from hypothesis import given
from hypothesis import strategies as st

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_estimation.slip.models import dispatch
from trackslip_estimation.slip.models.model import (
    DOWNHILL,
    FIX_DELAY,
    GYRO_BIAS,
    POSE,
    SIZE,
    UNDERCARRIAGE_SIZE,
    YAW,
)
from trackslip_estimation.slip.models.speed import (
    COMMON_SLIP,
    ROTATION_OFFSET,
    SPEED_ERROR,
    TURN_STATE_1,
    TURN_STATE_2,
    YAW_RATE_ERROR,
)
from trackslip_estimation.slip.models.turning import EFFICIENCY, LOSS
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds
from trackslip_estimation.slip.parameters import load_slip_parameters
from trackslip_estimation.slip.records import YAW_RATE
from trackslip_estimation.soil.soil_parameters import load_soil_parameters

RADIUS, TREAD = 0.159, 0.73  # m, as in config/vehicles/pc05.yaml
CONFIGS = {name: config_of(model=name) for name in ("turning", "icr")}
RECORDS = {name: config[0] for name, config in CONFIGS.items()}
NOTHING = np.zeros((SIZE, SIZE))
SHARED = np.array(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)))  # common to both tracks
TURNING = MotionState(Motion.TURNING, changing=False)

both = pytest.mark.parametrize("model", ["turning", "icr"])
states = st.tuples(
    *[st.floats(-50.0, 50.0)] * 2,
    st.floats(-math.pi, math.pi),
    st.floats(-0.3, 0.3),
    *[st.floats(-1.0, 1.0)] * 2,
    st.floats(0.2, 2.0),
    st.floats(-2.0, -0.2),
    *[st.floats(-0.3, 0.3)] * 6,
    *[st.just(0.0)] * (SIZE - UNDERCARRIAGE_SIZE),
).map(np.array)
speeds = st.floats(-4.0, 4.0)
times = st.floats(0.0, 0.5)


@both
@pytest.mark.parametrize("motion", list(Motion))
@given(x=states, dt=times)
def test_f_is_the_derivative_of_the_step(model: str, motion: Motion, x: FloatArray, dt: float) -> None:
    config, drive = CONFIGS[model], Drive(1.0, 2.0, motion)
    by_differences = differences(lambda v: moved(v, drive, dt, config), x)
    np.testing.assert_allclose(transition(x, drive, dt, config), by_differences, atol=1e-7)


@both
@given(x=states, left=speeds, right=speeds)
def test_h_is_the_derivative_of_the_measurement(model: str, x: FloatArray, left: float, right: float) -> None:
    c, speeds_ = RECORDS[model], (left, right)
    by_differences = differences(lambda v: expected(YAW_RATE, v, 1, speeds_, c), x)
    np.testing.assert_allclose(jacobian(YAW_RATE, x, 1, speeds_, c), by_differences, atol=1e-7)


@both
@given(x=states, left=speeds, right=speeds)
def test_outputs_come_with_their_derivatives(model: str, x: FloatArray, left: float, right: float) -> None:
    left, right = (math.copysign(abs(w) + 0.2, w) for w in (left, right))
    config, P = CONFIGS[model], np.diag(np.arange(1.0, SIZE + 1.0)) * 1e-3
    measured = Speeds(left, right)
    v, _, rate = dispatch.twist(x, left, right, config[0])
    x[SPEED_ERROR] += math.copysign(0.05, v)  # below the limit of the slip angle
    v += math.copysign(0.05, v)
    found = outputs_of(config, Gaussian(x, P), measured)
    twist, slips = found["twist"], found["slips"]

    def output(at: FloatArray, name: str) -> FloatArray:
        values: FloatArray = outputs_of(config, Gaussian(at, P), measured)[name].copy()
        return values

    J, S = (differences(partial(output, name=name), x) for name in ("twist", "slips"))
    np.testing.assert_allclose(twist, (v, -rate * x[ROTATION_OFFSET], rate), atol=1e-12)
    np.testing.assert_allclose(found["twist_covariance"], J @ P @ J.T, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(found["slip_covariance"], S @ P @ S.T, rtol=1e-5, atol=1e-8)
    v_left, v_right = v - rate * TREAD / 2.0, v + rate * TREAD / 2.0
    v_j = RADIUS * np.array((left, right)) * (1.0 - slips[:2])  # (3.17), the definition of slip
    np.testing.assert_allclose(v_j, (v_left, v_right), atol=1e-12)
    assert math.tan(slips[2]) == pytest.approx(twist[1] / twist[0])


@both
def test_slip_of_a_track_at_standstill_is_the_common_slip(model: str) -> None:
    x = np.zeros(SIZE)
    x[COMMON_SLIP] = 0.07
    found = outputs_of(CONFIGS[model], Gaussian(x, np.eye(SIZE)), Speeds(0.0, 0.0))
    np.testing.assert_array_equal(found["slips"], (0.07, 0.07, 0.0))
    np.testing.assert_array_equal(found["slip_covariance"], np.diag((1.0, 1.0, 0.0)) + SHARED)


@both
def test_track_at_standstill_that_is_dragged_has_a_large_slip(model: str) -> None:
    """The soil estimator must not classify the track as driving."""
    config, P = CONFIGS[model], np.diag(np.arange(1.0, SIZE + 1.0)) * 1e-3
    x = np.zeros(SIZE)
    x[TURN_STATE_1], x[TURN_STATE_2], x[COMMON_SLIP], x[SPEED_ERROR] = 0.5, 0.1, 0.3, 0.1
    speeds_ = Speeds(0.0, 2.0)
    found = outputs_of(config, Gaussian(x, P), speeds_)
    (v, _, rate), slips = found["twist"], found["slips"]
    frame = v - rate * TREAD / 2.0
    assert abs(frame) > 0.03
    assert abs(frame / (1.0 - slips[0])) < load_soil_parameters().stall.least_speed
    S = differences(lambda at: outputs_of(config, Gaussian(at, P), speeds_)["slips"].copy(), x)
    np.testing.assert_allclose(found["slip_covariance"], S @ P @ S.T, rtol=1e-5, atol=1e-8)


@pytest.mark.slow
@both
def test_output_covariance_includes_the_rounding_of_counts(model: str) -> None:
    """Compared with many drives with rounded speeds and no other error."""
    config, rng = CONFIGS[model], np.random.default_rng(3)
    x = np.zeros(SIZE)
    x[TURN_STATE_1], x[TURN_STATE_2], x[COMMON_SLIP], x[ROTATION_OFFSET] = 0.7, -0.2, 0.05, 0.02
    variance = 4e-4  # (rad/s)²
    known = Gaussian(x, NOTHING)
    changing = MotionState(Motion.TURNING, departure=1.0)  # rad/s: the speeds are not low-passed
    found = outputs_of(config, known, Speeds(1.0, 2.0, variance), changing)
    errors = math.sqrt(variance) * rng.standard_normal((20_000, 2))
    drawn = [outputs_of(config, known, Speeds(1.0 + e, 2.0 + f)) for e, f in errors]
    for name, covariance in (("twist", "twist_covariance"), ("slips", "slip_covariance")):
        by_draws = np.cov(np.array([one[name] for one in drawn]).T)
        np.testing.assert_allclose(by_draws, found[covariance], rtol=0.05, atol=1e-9)


@given(speeds, speeds, st.floats(0.05, 1.0), st.floats(0.0, 1.0), st.floats(-0.1, 0.1))
def test_twist_of_the_turning_model_equals_its_equations(
    left: float, right: float, kappa: float, eta: float, common: float
) -> None:
    """v = (1 − i₀) (V − η s), ω = (1 − i₀) κ D/B; of mirrored or reversed speeds mirrored or reversed."""
    x = np.zeros(SIZE)
    V, D = RADIUS * (left + right) / 2.0, RADIUS * (right - left)
    x[TURN_STATE_1], x[TURN_STATE_2], x[COMMON_SLIP] = kappa, eta, common
    one_direction = left * right >= 0.0
    c, half = RECORDS["turning"], abs(D) / 2.0
    lost = math.copysign(half, V) if one_direction else V * abs(V / half) ** 2
    sharp = half / (half + float(c["turning"]["gentle_turn"]) * abs(V)) if half > 0.0 else 0.0
    expected = (1.0 - common) * np.array((V - eta * lost * sharp, 0.0, kappa * D / TREAD))
    np.testing.assert_allclose(dispatch.twist(x, -left, -right, c), -expected, atol=1e-12)
    np.testing.assert_allclose(dispatch.twist(x, left, right, c), expected, atol=1e-12)
    np.testing.assert_allclose(dispatch.twist(x, right, left, c), expected * (1, 1, -1), atol=1e-12)


@given(speeds, speeds, st.floats(0.2, 2.0), st.floats(-2.0, -0.2), st.floats(-0.1, 0.1))
def test_twist_of_the_icr_model_equals_its_equations(
    left: float, right: float, y_left: float, y_right: float, common: float
) -> None:
    """r ω_j (1 − i₀) = v − ω y_j solved for v and ω."""
    x = np.zeros(SIZE)
    tracks = RADIUS * np.array((left, right)) * (1.0 - common)
    x[TURN_STATE_1], x[TURN_STATE_2], x[COMMON_SLIP] = y_left, y_right, common
    v, _, rate = dispatch.twist(x, left, right, RECORDS["icr"])
    np.testing.assert_allclose(
        (v, rate), np.linalg.solve(((1.0, -y_left), (1.0, -y_right)), tracks), atol=1e-12
    )


def speed_loss(left: float, right: float) -> float:
    """Speed, m/s, that η = 1 takes from a machine without other slip."""
    x = np.zeros(SIZE)
    x[LOSS] = 1.0
    v, _, _ = dispatch.twist(x, left, right, RECORDS["turning"])
    return RADIUS * (left + right) / 2.0 - float(v)


def test_rounded_counts_hardly_slow_a_straight_drive() -> None:
    """Rounding alone gives |D| a mean above 0; in the law of a full turn it would cost 1 % of 0.22 m/s."""
    count = load_slip_parameters().encoder_resolution
    angles = np.floor(np.outer(np.arange(1001) * 0.01, (1.4, 1.4)) / count + (0.2, 0.7)) * count
    speeds_ = (np.diff(angles, axis=0) / 0.01).tolist()
    rectified = np.mean([RADIUS * abs(right - left) / 2.0 for left, right in speeds_])
    assert rectified > 0.008 * RADIUS * 1.4
    assert 0.0 < np.mean([speed_loss(*pair) for pair in speeds_]) < 0.5 * rectified


def test_lower_turning_efficiency_raises_the_speed_loss() -> None:
    """The prior correlation keeps κ + η at 0.8 ± 0.2."""
    config = CONFIGS["turning"]
    state, moving = start_of(config, np.zeros(3), 1e-4 * np.eye(3)), Speeds(1.0, 2.0)
    measured = rate_measured(0.1 * RADIUS / TREAD, 1e-8)
    for _ in range(100):
        state = filter_step(config, state, moving, 0.02, TURNING, measured).updated
    assert state.mean[EFFICIENCY] == pytest.approx(0.1, abs=0.02)
    assert state.mean[LOSS] == pytest.approx(0.7, abs=0.03)
    assert np.sqrt(state.covariance[LOSS, LOSS]) == pytest.approx(0.2, abs=0.02)


def test_both_models_without_slip_are_the_ideal_vehicle() -> None:
    """κ = 1 and η = 0, and y = ±B/2: the yaw rate (3.18)."""
    for model, pair in (("turning", (1.0, 0.0)), ("icr", (TREAD / 2.0, -TREAD / 2.0))):
        x = np.zeros(SIZE)
        x[TURN_STATE_1], x[TURN_STATE_2] = pair
        found = dispatch.twist(x, 1.0, 2.0, RECORDS[model])
        np.testing.assert_allclose(found, (RADIUS * 1.5, 0.0, RADIUS * 1.0 / TREAD), atol=1e-12)


@both
def test_velocity_errors_add_up_to_the_twist_and_fade(model: str) -> None:
    """After a correlation time 1/e of the errors is left; their mean over it is 1 − 1/e; silence differs."""
    c, x = RECORDS[model], np.zeros(SIZE)
    x[TURN_STATE_1], x[TURN_STATE_2], x[SPEED_ERROR], x[YAW_RATE_ERROR] = 1.0, -1.0, 0.1, 0.2
    np.testing.assert_allclose(dispatch.twist(x, 0.0, 0.0, c), (0.1, 0.0, 0.2))
    tau = float(c["velocity_errors"]["time"])
    after = moved(x, Drive(0.0, 0.0), tau, CONFIGS[model])
    np.testing.assert_allclose(after[SPEED_ERROR : YAW_RATE_ERROR + 1], (0.1 / math.e, 0.2 / math.e))
    assert math.hypot(*after[:YAW]) == pytest.approx(0.1 * tau * (1.0 - 1.0 / math.e))
    assert after[YAW] == pytest.approx(0.2 * tau * (1.0 - 1.0 / math.e))
    silent = moved(x, Drive(0.0, 0.0, Motion.UNKNOWN), tau, CONFIGS[model])
    unknown_time = float(c["unknown_time"])
    left = math.exp(-tau / unknown_time)
    np.testing.assert_allclose(silent[SPEED_ERROR : YAW_RATE_ERROR + 1], (0.1 * left, 0.2 * left))
    assert silent[YAW] == pytest.approx(0.2 * unknown_time * (1.0 - left))


@both
def test_size_of_the_velocity_errors_by_hand(model: str) -> None:
    """Variances from V, D and d, larger on soil that yields; after a long time the states have all of it.

    A slip of 1 leaves those of firm ground.
    """
    config, x = CONFIGS[model], np.zeros(SIZE)
    e = {name: float(config["velocity_errors"][name][0]) for name in config["velocity_errors"].dtype.names}
    x[TURN_STATE_1], x[TURN_STATE_2], x[COMMON_SLIP] = 1.0, -1.0, 2.0 * e["yielding_slip"]
    steady, changing = e["turning"] ** 2, (e["changing"] * 0.5) ** 2
    yielding = 1.0 + 4.0 * (1.0 - x[COMMON_SLIP]) ** 2
    of_speed = yielding * RADIUS**2 * (steady + changing) + e["standing"] ** 2
    of_rate = yielding * RADIUS**2 * (e["yaw_rate_ratio"] ** 2 * steady + changing) + e["standing"] ** 2
    long = 100.0 * e["time"]
    Q = process_noise(x, NOTHING, Drive(1.0, 2.0, Motion.TURNING, departure=0.5), long, config)
    assert Q[SPEED_ERROR, SPEED_ERROR] == pytest.approx(of_speed)
    assert Q[YAW_RATE_ERROR, YAW_RATE_ERROR] == pytest.approx(of_rate / TREAD**2)
    unsure = np.zeros((SIZE, SIZE))
    unsure[COMMON_SLIP, COMMON_SLIP] = e["yielding_slip"] ** 2
    Q = process_noise(x, unsure, Drive(2.0, 2.0), long, config)
    yielding = 1.0 + 5.0 * ((1.0 - x[COMMON_SLIP]) ** 2 + e["yielding_slip"] ** 2)
    in_straight = (RADIUS * e["straight"] * 2.0) ** 2
    assert Q[SPEED_ERROR, SPEED_ERROR] == pytest.approx(yielding * in_straight + e["standing"] ** 2)
    x[COMMON_SLIP] = 1.0
    Q = process_noise(x, NOTHING, Drive(2.0, 2.0), long, config)
    assert Q[SPEED_ERROR, SPEED_ERROR] == pytest.approx(in_straight + e["standing"] ** 2)


@both
@pytest.mark.parametrize("motion", [Motion.STANDING, Motion.STRAIGHT, Motion.TURNING])
def test_process_noise_does_not_depend_on_the_steps(model: str, motion: Motion) -> None:
    """Displacement by velocity errors is exact for any step; random walks differ a little between steps."""
    firm = {"model": model, f"{model}.yielding_slip": 1e6}  # growth of i₀ changes neither result
    config = config_of(firm)
    moving = Speeds(1.0, 1.0)

    def grown(steps: int) -> FloatArray:
        x = np.zeros(SIZE)
        x[TURN_STATE_1], x[TURN_STATE_2] = 1.0, -1.0
        known = Gaussian(x, NOTHING)
        for _ in range(steps):
            known = filter_step(config, known, moving, 0.2 / steps, MotionState(motion), Measured()).predicted
        return np.diag(known.covariance)

    fine, coarse, single = grown(80), grown(8), grown(1)
    np.testing.assert_allclose(coarse[SPEED_ERROR:], fine[SPEED_ERROR:], rtol=1e-9)
    np.testing.assert_allclose(single[SPEED_ERROR:], fine[SPEED_ERROR:], rtol=1e-9)
    np.testing.assert_allclose(coarse[POSE], fine[POSE], rtol=0.02, atol=1e-10)
    np.testing.assert_allclose(single[POSE], fine[POSE], rtol=0.2, atol=1e-9)


@both
@pytest.mark.parametrize(
    ("motion", "moving"),
    [
        (Motion.STANDING, []),
        (Motion.STRAIGHT, [COMMON_SLIP, DOWNHILL]),
        (Motion.TURNING, [TURN_STATE_1, TURN_STATE_2, COMMON_SLIP, ROTATION_OFFSET, DOWNHILL]),
    ],
)
def test_states_observable_only_in_turns_have_noise_only_in_turns(
    model: str, motion: Motion, moving: list[int]
) -> None:
    steady, walk = RECORDS[model]["process_noise"][motion]
    assert (steady <= walk).all()
    assert np.flatnonzero(walk).tolist() == sorted([GYRO_BIAS, FIX_DELAY, *moving])


@both
def test_a_start_has_its_pose_and_wide_priors_of_the_rest(model: str) -> None:
    pose, R = np.array((1.0, 2.0, 3.0)), np.array(((4.0, 1.0, 0.5), (1.0, 5.0, 0.2), (0.5, 0.2, 6.0)))
    mean, P = start_of(CONFIGS[model], pose, R)
    np.testing.assert_array_equal(mean[POSE], pose)
    np.testing.assert_array_equal(P[POSE, POSE], R)
    np.testing.assert_array_equal(P[POSE, GYRO_BIAS:], 0.0)
    active = dispatch.MODELS[model].ACTIVE
    assert (np.diag(P)[GYRO_BIAS:active] > 0.0).all()
    assert (np.diag(P)[active:] == 0.0).all()
    assert mean[TURN_STATE_1] > 0.0


@pytest.mark.parametrize("model", ["turning", "icr", "free_slips"])
@pytest.mark.parametrize("filter_", ["ekf", "daf"])
def test_a_step_repeats_every_bit(model: str, filter_: str) -> None:
    """Replays rely on it."""
    config = config_of(model=model, filter=filter_)

    def drive() -> bytes:
        state = start_of(config, np.array((1.0, 2.0, 3.0)), np.eye(3) * 1e-3)
        moving = Speeds(1.0, 2.0, 4e-4)
        for _ in range(20):
            state = filter_step(config, state, moving, 0.01, TURNING, Measured()).predicted
            state = filter_step(config, state, moving, 0.0, TURNING, rate_measured(0.2, 1e-4)).updated
        return state.mean.tobytes() + state.covariance.tobytes()

    assert drive() == drive()


@pytest.mark.parametrize("model", ["turning", "icr"])
def test_standing_velocity_error_above_1_m_per_s_is_refused(model: str) -> None:
    name = f"{model}.standing_velocity_error"
    assert load_slip_parameters({name: 1.0}) is not None
    with pytest.raises(InputError, match=f"{name}: 1e\\+30 is out of range; accepted: > 0 and <= 1 m/s"):
        load_slip_parameters({name: 1e30})
